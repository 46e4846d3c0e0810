//! NPDA and its rivals against golden weights, and the tracker that uses them against the laws they must obey.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use serde_json::Value;
use trackrs::association::associator::Associator;
use trackrs::association::jpda;
use trackrs::association::nearest::Nearness;
use trackrs::association::npda::{Bookkeeping, Npda, PartialCovariance, betas};
use trackrs::association::odds::{Odds, shares};
use trackrs::filter::sequence::InitialState;
use trackrs::gating::mahalanobis::{GatedPair, GatedTrack};
use trackrs::linalg::symmetric::eigen_range;
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{MotionModel, SensorModel};
use trackrs::stats::stream::Stream;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::lifecycle::{Existence, Initiator};
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::{Error, Gaussian, Scan};

fn golden() -> Value {
    let path = format!("{}/../../tests/data/npda_d300.json", env!("CARGO_MANIFEST_DIR"));
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn assert_close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() <= 1e-10, "{found:?} {expected:?}");
    }
}

#[test]
fn golden_weights_of_single_reports() {
    let data = golden();
    let odds = |density| Odds {
        detection: 0.3,
        gate: 1.0,
        density,
    };
    for (case, clutter, log_rest) in [
        ("npda_mm", Some(0.0), 0.0),
        ("npda_pc0.1_gate16", Some(0.1), 0.0),
        ("npda_mm_gate16_longstep", Some(0.0), 0.0),
        ("jpda1_lambda0", None, odds(0.0).log_clutter()),
        ("jpda1_lambda1e-3_pd0.3", None, odds(1e-3).log_clutter()),
    ] {
        for step in data["cases"][case]["steps"].as_array().unwrap() {
            let gates = step["gate"]
                .as_array()
                .unwrap()
                .iter()
                .map(|gate| gate.as_bool().unwrap());
            let gated: Vec<usize> = gates.enumerate().filter(|(_, gate)| *gate).map(|(i, _)| i).collect();
            let logs: Vec<f64> = gated.iter().map(|&i| numbers(&step["logf"])[i]).collect();
            let found = clutter.map_or_else(|| shares(&logs, log_rest), |p| betas(&logs, p));
            let expected: Vec<f64> = gated.iter().map(|&i| numbers(&step["beta"])[i]).collect();
            assert_close(&found, &expected);
            let kept = clutter.map_or(found.iter().sum(), |p| 1.0 - p);
            assert!(found.is_empty() || (found.iter().sum::<f64>() - kept).abs() < 1e-15);
        }
    }
}

#[test]
fn golden_weights_of_scans() {
    let data = golden();
    for (case, detection, density) in [("jpda_scan", 1.0, 0.0), ("jpda_scan_pd0.9_lambda1e-3", 0.9, 1e-3)] {
        for step in data["cases"][case]["steps"].as_array().unwrap() {
            let clutter: f64 = if density > 0.0 { density } else { 1.0 };
            let rows: Vec<Vec<f64>> = step["logf"].as_array().unwrap().iter().map(numbers).collect();
            let pairs =
                |i: usize| -> Vec<GatedPair> { (0..rows.len()).map(|j| pair(j, rows[j][i] + clutter.ln())).collect() };
            let pairs: Vec<Vec<GatedPair>> = (0..3).map(pairs).collect();
            let odds = Odds {
                detection,
                gate: 1.0,
                density,
            };
            let track = |pairs| GatedTrack {
                pairs,
                ..GatedTrack::default()
            };
            let tracks: Vec<GatedTrack> = pairs.iter().map(|pairs| track(pairs)).collect();
            let found = jpda::associate(&tracks, rows.len(), &odds, false).unwrap();
            let shares = found.missed.iter().zip(found.pairs.chunks_exact(rows.len()));
            for ((&missed, pairs), expected) in shares.zip(step["beta"].as_array().unwrap()) {
                assert_close(&[&[missed], pairs].concat(), &numbers(expected));
            }
        }
    }
}

fn pair(report: usize, log_likelihood: f64) -> GatedPair {
    GatedPair {
        report,
        nis: 0.0,
        log_likelihood,
        log_density: log_likelihood,
    }
}

fn associators() -> Vec<Associator> {
    let npda = |clutter_probability, covariance, bookkeeping| {
        Associator::Npda(Npda {
            clutter_probability,
            covariance,
            bookkeeping,
        })
    };
    let both = [false, true];
    let mut out = vec![
        Associator::NearestNeighbour(Nearness::Distance),
        Associator::GlobalNearestNeighbour,
        Associator::Pda,
        npda(Some(0.2), PartialCovariance::Moment, Bookkeeping::Each),
        npda(Some(0.0), PartialCovariance::Paper, Bookkeeping::Paper),
        npda(None, PartialCovariance::Joseph, Bookkeeping::Paper),
    ];
    out.extend(both.map(|coalescence_free| Associator::Jpda { coalescence_free }));
    out.extend(both.map(|coalescence_free| Associator::Jipda { coalescence_free }));
    out
}

fn tracker(associator: Associator) -> MultiTargetTracker {
    let motion = ConstantVelocity::new(KinematicNoise::Psd(vec![0.5; 2])).unwrap();
    let sensor = PositionSensor::new(vec![2.0, 2.0]).unwrap();
    let sensors = BTreeMap::from([("radar".to_string(), SensorModel::Position(sensor))]);
    let mut config = TrackerConfig::new(MotionModel::ConstantVelocity(motion), sensors, 20.0).unwrap();
    config.associator = associator;
    config.clutter_density = BTreeMap::from([("radar".to_string(), 1e-4)]);
    if matches!(associator, Associator::Jipda { .. }) {
        config.initiator = Initiator::Existence(Existence {
            max_speed: 20.0,
            initial: 0.1,
            confirm: 0.9,
            drop: 0.01,
            lifetime: 60.0,
            min_displacement: 0.0,
            min_separation: 0.0,
            pair_within: None,
        });
    }
    config.initial = [0.0, 6.0]
        .map(|y| InitialState {
            time: 0.0,
            state: Gaussian::new(DVector::from_vec(vec![0.0, y, 3.0, 0.0]), DMatrix::identity(4, 4) * 4.0).unwrap(),
        })
        .to_vec();
    MultiTargetTracker::new(config).unwrap()
}

/// The same, where tracks begin from nothing but pairs of reports.
fn by_pairs(associator: Associator) -> MultiTargetTracker {
    let mut config = tracker(associator).config().clone();
    config.initial.clear();
    match &mut config.initiator {
        Initiator::MofN(rule) => rule.pair_within = Some(5.0),
        Initiator::Existence(rule) => rule.pair_within = Some(5.0),
    }
    MultiTargetTracker::new(config).unwrap()
}

/// Two targets 6 m apart and false reports, some scans empty, reports at times of their own.
fn scans(seed: u64) -> Vec<Scan> {
    let mut stream = Stream::new(seed, 0);
    (1..60)
        .map(|k| {
            let (mut values, mut times) = (Vec::new(), Vec::new());
            for target in 0..2 {
                let time = f64::from(k) - stream.uniform();
                let y = 6.0 * f64::from(target) + 2.0 * stream.normal();
                let seen = DVector::from_vec(vec![3.0 * time + 2.0 * stream.normal(), y]);
                if stream.uniform() < 0.8 && k % 9 != 0 {
                    values.push(seen);
                    times.push(time);
                }
            }
            for _ in 0..stream.poisson(3.0).unwrap() * usize::from(k % 9 != 0) {
                let x = 3.0 * f64::from(k) + stream.between(-50.0, 50.0);
                values.push(DVector::from_vec(vec![x, stream.between(-50.0, 50.0)]));
                times.push(f64::from(k));
            }
            Scan::new(f64::from(k), "radar", values).at_times(&times)
        })
        .collect()
}

#[test]
fn every_associator_keeps_its_covariances_its_ledger_and_its_bits() {
    for associator in associators() {
        for seed in 0..4 {
            let scans = scans(seed);
            let rows: u64 = scans.iter().map(|scan| scan.values.len() as u64).sum();
            let (first, second) = scans.split_at(30);
            for mut tracker in [tracker(associator), by_pairs(associator)] {
                let mut seen = 0;
                for track in tracker.run(first).unwrap().into_iter().flatten() {
                    assert!(eigen_range(&track.state.cov).unwrap().min > 0.0, "{associator:?}");
                    assert_eq!(
                        track.existence.is_some(),
                        matches!(associator, Associator::Jipda { .. })
                    );
                    assert!(track.existence.is_none_or(|r| (0.0..=1.0).contains(&r)));
                    seen += 1;
                }
                assert!(seen > 0, "{associator:?}");
                let mut copy = MultiTargetTracker::from_bytes(&tracker.to_bytes().unwrap()).unwrap();
                let after = tracker.run(second).unwrap();
                assert_eq!(copy.run(second).unwrap(), after, "{associator:?}");
                assert_eq!(copy.to_bytes().unwrap(), tracker.to_bytes().unwrap());
                assert_eq!((tracker.ledger().rows_in, tracker.ledger().used), (rows, rows));
            }
        }
    }
}

#[test]
fn a_scan_of_reports_at_its_own_time_is_a_plain_scan() {
    for associator in associators() {
        let (mut plain, mut timed) = (tracker(associator), tracker(associator));
        for scan in scans(9) {
            let same = Scan::new(scan.time, "radar", scan.values.clone());
            let times = vec![scan.time; scan.values.len()];
            assert_eq!(
                plain.step(&same).unwrap(),
                timed.step(&same.clone().at_times(&times)).unwrap()
            );
        }
    }
}

#[test]
fn what_an_associator_lacks_is_named() {
    for associator in associators() {
        let mut config = tracker(associator).config().clone();
        config.clutter_density.clear();
        let made = MultiTargetTracker::new(config);
        if associator.needs_density() {
            assert!(
                matches!(made, Err(Error::InvalidParameter { name, .. }) if name == "clutter_density of \"radar\"")
            );
        } else {
            assert!(made.is_ok());
        }
    }
}
