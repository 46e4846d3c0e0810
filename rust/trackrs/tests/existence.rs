//! JIPDA against the enumeration of existence, detection and association.

use trackrs::association::existence::{ExistenceModel, Prospect, joint_existence};
use trackrs::association::marginals::{Candidate, Options};
use trackrs::stats::stream::Stream;

/// One way the world can be: per track absent (`None`), or present with a report or without.
type World = Vec<Option<Option<usize>>>;

fn worlds(prospects: &[Prospect]) -> Vec<(World, f64)> {
    let mut found: Vec<(World, f64)> = vec![(Vec::new(), 1.0)];
    for prospect in prospects {
        let mut longer = Vec::new();
        for (world, weight) in &found {
            let mut add = |of_track: Option<Option<usize>>, factor: f64| {
                let mut world = world.clone();
                world.push(of_track);
                longer.push((world, weight * factor));
            };
            add(None, 1.0 - prospect.existence);
            add(Some(None), prospect.existence * (1.0 - prospect.detection));
            for candidate in &prospect.candidates {
                if !world.contains(&Some(Some(candidate.report))) {
                    add(
                        Some(Some(candidate.report)),
                        prospect.existence * candidate.weight.exp(),
                    );
                }
            }
        }
        found = longer;
    }
    found
}

#[test]
fn existence_is_that_of_the_enumeration() {
    for run in 0..3000 {
        let mut stream = Stream::new(1, run);
        let sizes = [0, 1, 2, 3, 4];
        let (tracks, reports) = (*stream.choice(&sizes).unwrap(), *stream.choice(&sizes).unwrap());
        let mut prospects = Vec::new();
        for _ in 0..tracks {
            let mut candidates = Vec::new();
            for report in 0..reports {
                if stream.uniform() < 0.7 {
                    let weight = stream.between(-3.0, 3.0);
                    candidates.push(Candidate { report, weight });
                }
            }
            let detection = if run % 5 == 0 && !candidates.is_empty() {
                1.0
            } else {
                stream.uniform()
            };
            let existence = match run % 7 {
                0 => 0.0,
                1 if detection < 1.0 => 1.0,
                _ => stream.uniform(),
            };
            prospects.push(Prospect {
                existence,
                detection,
                candidates,
            });
        }
        let worlds = worlds(&prospects);
        let total: f64 = worlds.iter().map(|(_, weight)| weight).sum();
        let share = |holds: &dyn Fn(&World) -> bool| {
            let kept = worlds.iter().filter(|(world, _)| holds(world));
            kept.map(|(_, weight)| weight).sum::<f64>() / total
        };
        let found = joint_existence(&prospects, reports, &Options::default()).unwrap();
        assert!((found.log_total - total.ln()).abs() < 1e-11);
        for (track, existing) in found.tracks.iter().enumerate() {
            let existence = share(&|world| world[track].is_some());
            assert!(
                (existing.existence - existence).abs() < 1e-12,
                "{} {existence}",
                existing.existence
            );
            let missed = share(&|world| world[track] == Some(None));
            assert!((existing.missed * existing.existence - missed).abs() < 1e-12);
            let candidates = prospects[track].candidates.iter().zip(&existing.candidates);
            for (candidate, p) in candidates {
                let q = share(&|world| world[track] == Some(Some(candidate.report)));
                assert!((p * existing.existence - q).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn prediction_is_a_markov_chain() {
    let model = ExistenceModel::new(0.98, 0.01).unwrap();
    assert_eq!((model.predict(1.0), model.predict(0.0)), (0.98, 0.01));
    assert!((model.predict(0.5) - 0.495).abs() < 1e-15);
}

#[test]
fn errors_name_the_culprit() {
    let prospect = |existence: f64, detection: f64| Prospect {
        existence,
        detection,
        candidates: Vec::new(),
    };
    let message = |p: Prospect| joint_existence(&[p], 0, &Options::default()).unwrap_err().to_string();
    assert!(message(prospect(1.5, 0.5)).contains("existence[0]"));
    assert!(message(prospect(0.5, f64::NAN)).contains("detection[0]"));
    assert!(message(prospect(1.0, 1.0)).contains("weights[0, 0]"));
    assert!(ExistenceModel::new(1.1, 0.0).is_err());
}
