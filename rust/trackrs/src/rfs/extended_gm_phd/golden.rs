//! The update against the vectors of an independent implementation, step by step.

use serde_json::Value;

mod case;

use case::{Case, gaussian, indices, mixture, number, numbers};

use super::super::group::{Hypothesis, MeanField, Verdict};
use super::super::mixture::Reduction;
use super::super::prediction::{Birth, Fate};
use super::*;
use crate::filter::extended::Rule;
use crate::model::motion::ConstantVelocity;
use crate::model::motion::KinematicNoise;
use crate::model::sensor::PositionSensor;
use crate::partition::Partition;
use crate::partition::tree::Tree;

fn sensor() -> PositionSensor {
    PositionSensor::new(vec![20.0; 2]).unwrap()
}

fn sight<'a>(sensor: &'a PositionSensor, case: &Case) -> Sight<'a> {
    Sight {
        detection_probability: number(&case.value["pD"]),
        clutter_density: libm::exp(case.log_clutter()),
        sensor,
        platform: None,
        rule: Rule::Once,
    }
}

fn scene<'a>(case: &'a Case, predicted: &'a [Component], sight: &'a Sight<'a>) -> Scene<'a> {
    let noise = Noise::of(sight.sensor).unwrap();
    let view = |c: &Component| Seen::new(c, sight, &noise, 6).unwrap();
    let views = predicted.iter().map(view).collect();
    Scene::new(&case.update, predicted.iter().collect(), views, noise, sight, 6)
}

fn members(value: &Value) -> Vec<Vec<usize>> {
    value.as_array().unwrap().iter().map(indices).collect()
}

fn close(found: f64, expected: f64, what: &str) {
    // Below e^−700 only "very small" is meant; entries near 0 come from differences of hundreds.
    if expected < -700.0 {
        assert!(found < -690.0, "{what}: {found} {expected}");
    } else {
        assert!((found - expected).abs() < 1e-8, "{what}: {found} {expected}");
    }
}

#[test]
fn prediction_and_reduction() {
    for case in Case::all() {
        let motion = ConstantVelocity::new(KinematicNoise::Std(vec![2.0; 2])).unwrap();
        let births = mixture(&case.value["birth"]);
        let fate = Fate {
            survival_probability: number(&case.value["pS"]),
            birth_rate: births[0].rate,
            births: births
                .iter()
                .map(|c| Birth {
                    weight: c.weight,
                    state: c.state.clone(),
                })
                .collect(),
            spawns: vec![],
        };
        let mut label = 10;
        let mut found = mixture(&case.value["prior"]);
        let rates = case.update.rates;
        fate.survive(&mut found, &motion, Rule::Once, rates, 1.0, &mut label)
            .unwrap();
        fate.bear(&mut found, &[], &mut label);
        let plain = Case { constant: None, ..case };
        plain.assert_mixture(&found, &plain.value["predicted"], "predicted");
        let reduction = Reduction {
            prune: number(&plain.value["prune"]),
            merge: number(&plain.value["merge"]),
            max_components: 100,
        };
        let reduced = reduction.reduce(mixture(&plain.value["posterior"]));
        let reduced: Vec<Component> = reduced.into_iter().map(|merged| merged.component).collect();
        plain.assert_mixture(&reduced, &plain.value["reduced"], "reduced");
        let copies: usize = reduced.iter().map(Component::copies).sum();
        assert_eq!(copies, plain.value["extracted"].as_array().unwrap().len());
    }
}

/// Cells, their weights and shares, and the posterior, for divisions that the file gives.
fn check_divisions(case: &Case, part: &Value, make: impl FnOnce(&mut Cells) -> Divisions, what: &str) {
    let (sensor, predicted, z) = (sensor(), case.predicted(), case.measurements());
    let sight = sight(&sensor, case);
    let scene = scene(case, &predicted, &sight);
    let mut cells = Cells::singles(&z, &scene.noise);
    let divisions = make(&mut cells);
    let likelihoods = scene.log_likelihoods(&cells);
    let log_weights = scene.log_weights(&cells, &likelihoods);
    let sum = divisions.sum(&log_weights);
    let expected = Expected::of(part, &case.value);
    for (i, members) in expected.cells.iter().enumerate() {
        let partition = Partition::from_labels(
            &(0..z.len() / 2)
                .map(|z| usize::from(!members.contains(&z)))
                .collect::<Vec<_>>(),
            2,
        );
        let Divisions::Flat(cells_of) = cells.flat(&[partition]) else {
            panic!()
        };
        let cell = cells_of[0][usize::from(!members.contains(&0))];
        let clutter = case.log_clutter() * members.len() as f64;
        close(
            log_weights[cell] - clutter,
            expected.log_weights[i],
            &format!("{what} d {members:?}"),
        );
        close(
            sum.log_shares[cell],
            expected.log_shares[i],
            &format!("{what} q {members:?}"),
        );
        if let Some(rows) = &expected.likelihoods {
            for (j, &row) in rows[i].iter().enumerate() {
                close(
                    likelihoods[cell * 3 + j] - clutter,
                    row,
                    &format!("{what} L {members:?} {j}"),
                );
            }
        }
    }
    let block = Block {
        measurements: (0..z.len() / 2).collect(),
        members: vec![],
    };
    let mut out = predicted.clone();
    case.update.update(&mut out, &[], &sight).unwrap();
    scene.weigh(&block, &z, &cells, &divisions, &mut out);
    case.assert_mixture(&out, &part["posterior"], what);
}

struct Expected {
    cells: Vec<Vec<usize>>,
    log_weights: Vec<f64>,
    log_shares: Vec<f64>,
    likelihoods: Option<Vec<Vec<f64>>>,
}

impl Expected {
    fn of(part: &Value, case: &Value) -> Self {
        Self {
            cells: members(&part["cells"]),
            log_weights: numbers(&part["log_dW"]),
            log_shares: numbers(&part["log_q"]),
            likelihoods: (part == case)
                .then(|| part["log_likelihood"].as_array().unwrap().iter().map(numbers).collect()),
        }
    }
}

#[test]
fn partitions_weigh_as_they_must() {
    for case in Case::all() {
        let partitions: Vec<Partition> = case.value["partitions"]
            .as_array()
            .unwrap()
            .iter()
            .map(|partition| {
                let cells = members(partition);
                let label = |z| cells.iter().position(|cell| cell.contains(&z)).unwrap();
                Partition::from_labels(&(0..6).map(label).collect::<Vec<_>>(), cells.len())
            })
            .collect();
        check_divisions(&case, &case.value, |cells| cells.flat(&partitions), "partitions");
    }
}

#[test]
fn trees_weigh_as_they_must() {
    for case in Case::all() {
        let trees: Vec<Tree> = case.value["tree"]["trees"]
            .as_array()
            .unwrap()
            .iter()
            .map(|tree| {
                let children: Vec<[usize; 2]> = members(&tree["children"]).iter().map(|c| [c[0], c[1]]).collect();
                Tree {
                    points: 6,
                    heights: vec![0.0; children.len()],
                    children,
                    roots: indices(&tree["roots"]),
                }
            })
            .collect();
        check_divisions(&case, &case.value["tree"], |cells| cells.cuts(trees), "trees");
    }
}

#[test]
fn blocks_and_the_mean_field() {
    for case in Case::all() {
        let (sensor, predicted, z) = (sensor(), mixture(&case.value["predicted"]), case.measurements());
        let sight = sight(&sensor, &case);
        let scene = scene(&case, &predicted, &sight);
        let blocks = scene.blocks(&z).unwrap();
        for (block, expected) in blocks.iter().zip(case.value["blocks"].as_array().unwrap()) {
            assert_eq!(block.measurements, indices(&expected["measurements"]));
            assert_eq!(block.members, indices(&expected["components"]));
        }
        let field = &case.value["joint_vb"];
        let z = &z[..10];
        let members: Vec<Member<'_>> = [0, 1]
            .map(|j| Member {
                offsets: scene.offsets(j, z),
                spread: &scene.seen[j].view.spread,
                log_volume: scene.noise.log_volume,
                scattered: false,
                rate: predicted[j].rate.mean(),
                existence: Member::existence(predicted[j].weight),
            })
            .into();
        let model = Superposition {
            log_clutter: scene.log_clutter,
            detection_probability: 0.99,
            dims: 2,
        };
        let chosen: Vec<&Member<'_>> = members.iter().collect();
        let MeanField { bound, found } = model.mean_field(&chosen);
        close(bound - 5.0 * case.log_clutter(), number(&field["elbo"]), "bound");
        for (j, expected) in numbers(&field["counts"]).iter().enumerate() {
            assert!(
                (found[j].count - expected).abs() < 1e-9,
                "{} {expected}",
                found[j].count
            );
            let state = scene.seen[j]
                .view
                .posterior(&predicted[j].state, &found[j].mean, found[j].count)
                .state;
            let expected = gaussian(&field["m"][j], &field["P"][j]);
            assert!((&state.mean - &expected.mean).amax() < 1e-9 * expected.mean.amax());
            assert!((&state.cov - &expected.cov).amax() < 1e-9 * expected.cov.amax());
        }
    }
}

#[test]
fn the_whole_update() {
    for case in Case::all() {
        let sensor = sensor();
        let sight = sight(&sensor, &case);
        let predicted = case.predicted();
        let mut found = predicted.clone();
        case.update.update(&mut found, &case.measurements(), &sight).unwrap();
        let part = &case.value["group_update"];
        case.assert_mixture(&found, &part["posterior"], "update");
        let scene = scene(&case, &predicted, &sight);
        let joint: f64 = verdict(&scene, &case)
            .hypotheses
            .iter()
            .map(|h: &Hypothesis| h.log_weight.exp())
            .sum();
        let expected = number(&part["joint"][0][1]);
        assert!((joint - expected).abs() < 1e-9, "{joint} {expected}");
    }
}

fn verdict(scene: &Scene<'_>, case: &Case) -> Verdict {
    let z = &case.measurements()[..10];
    let points = Points::whitened(z, 2, scene.noise.cov()).unwrap();
    let PartitionModel::Tree(tree) = &case.update.partition else {
        panic!()
    };
    let mut cells = Cells::singles(z, &scene.noise);
    let divisions = cells.cuts(tree.trees(&points).unwrap());
    let sum = divisions.sum(&scene.log_weights(&cells, &scene.log_likelihoods(&cells)));
    scene.verdict(&[0, 1], z, sum.log_evidence)
}
