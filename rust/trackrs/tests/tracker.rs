//! The tracker against arbitrary input: nothing panics, no row is lost, nothing that is not finite comes out, and a saved
//! tracker goes on bit for bit.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trackrs::event::{Event, EventCode};
use trackrs::filter::sequence::InitialState;
use trackrs::linalg::cholesky::Cholesky;
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::{PositionSensor, RangeBearing};
use trackrs::model::{MotionModel, SensorModel};
use trackrs::tracker::clutter_map::ClutterMap;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::lifecycle::Initiator;
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::{Error, Gaussian, Scan};

fn tracker() -> MultiTargetTracker {
    let motion = ConstantVelocity::new(KinematicNoise::Psd(vec![0.5; 2])).unwrap();
    let sensors = BTreeMap::from([
        (
            "lidar".to_string(),
            SensorModel::Position(PositionSensor::new(vec![1.0, 1.0]).unwrap()),
        ),
        (
            "radar".to_string(),
            SensorModel::RangeBearing(RangeBearing::new([0.0, 0.0], 5.0, 0.01).unwrap()),
        ),
    ]);
    let mut config = TrackerConfig::new(MotionModel::ConstantVelocity(motion), sensors, 20.0).unwrap();
    config.clutter_map = Some(ClutterMap {
        radius: 5.0,
        dwell: 10.0,
        min_reports: 4,
        memory: 30.0,
    });
    config.max_tracks = 50;
    MultiTargetTracker::new(config).unwrap()
}

/// The same, where tracks begin from pairs of reports.
fn by_pairs() -> MultiTargetTracker {
    let mut config = tracker().config().clone();
    if let Initiator::MofN(rule) = &mut config.initiator {
        rule.pair_within = Some(20.0);
    }
    MultiTargetTracker::new(config).unwrap()
}

/// A number that a broken sensor might send.
fn wild(rng: &mut Pcg64) -> f64 {
    match rng.random_range(0..12) {
        0 => f64::NAN,
        1 => f64::INFINITY,
        2 => -1e300,
        3 => 5e-324,
        4 => 0.0,
        _ => rng.random_range(-100.0..100.0),
    }
}

fn wild_scan(rng: &mut Pcg64, time: f64) -> Scan {
    let sensor = ["lidar", "radar", "lidar", "radar", "sonar"][rng.random_range(0..5)];
    let rows = rng.random_range(0..6);
    let width = |rng: &mut Pcg64| if rng.random_range(0..20) == 0 { 3 } else { 2 };
    let mut values: Vec<DVector<f64>> = Vec::new();
    for _ in 0..rows {
        let width = width(rng);
        values.push(DVector::from_fn(width, |_, _| wild(rng)));
    }
    let time = match rng.random_range(0..30) {
        0 => wild(rng),
        1 => time - 5.0,
        2 => 1e12,
        _ => time,
    };
    let scan = Scan::new(time, sensor, values);
    match rng.random_range(0..4) {
        0 => scan.from_platform(&[wild(rng), wild(rng)]),
        1 => scan.from_platform(&[1.0]),
        _ => scan,
    }
}

#[test]
fn no_input_breaks_it_and_no_row_is_lost() {
    for seed in 0..300 {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut tracker = if seed % 3 == 0 { by_pairs() } else { tracker() };
        for k in 0..60 {
            let scan = wild_scan(&mut rng, f64::from(k));
            for track in tracker.step(&scan).unwrap() {
                assert!(
                    track
                        .state
                        .mean
                        .iter()
                        .chain(track.state.cov.iter())
                        .all(|v| v.is_finite())
                );
            }
            tracker.ledger().check().unwrap();
        }
        let bytes = tracker.to_bytes().unwrap();
        let mut copy = MultiTargetTracker::from_bytes(&bytes).unwrap();
        assert_eq!(copy.to_bytes().unwrap(), bytes);
        for k in 60..90 {
            let scan = wild_scan(&mut rng, 2e12 + f64::from(k));
            assert_eq!(copy.step(&scan).unwrap(), tracker.step(&scan).unwrap());
        }
    }
}

#[test]
fn bytes_that_pass_the_checksum_are_still_checked() {
    let mut tracker = by_pairs();
    let values = vec![DVector::from_vec(vec![3.0, 4.0])];
    tracker.step(&Scan::new(0.0, "radar", values)).unwrap();
    let bytes = tracker.to_bytes().unwrap();
    let mut rng = Pcg64::seed_from_u64(7);
    let mut refused = 0;
    for _ in 0..20_000 {
        let mut altered = bytes.clone();
        let body = altered.len() - 4;
        for _ in 0..rng.random_range(1..4) {
            altered[rng.random_range(8..body)] = rng.random();
        }
        let checksum = crc32fast::hash(&altered[..body]).to_le_bytes();
        altered[body..].copy_from_slice(&checksum);
        match MultiTargetTracker::from_bytes(&altered) {
            Err(Error::CorruptState { .. }) => refused += 1,
            Err(other) => panic!("{other}"),
            // A changed number can be a valid one; the tracker it gives must work.
            Ok(mut tracker) => drop(tracker.step(&Scan::new(1.0, "lidar", vec![DVector::zeros(2)]))),
        }
    }
    assert!(refused > 10_000, "{refused}");
}

#[test]
fn the_number_of_tracks_is_bounded_and_said() {
    for mut tracker in [tracker(), by_pairs()] {
        let values = (0..80)
            .map(|k| DVector::from_vec(vec![100.0 * f64::from(k), 0.0]))
            .collect();
        tracker.step(&Scan::new(0.0, "lidar", values)).unwrap();
        let counts: Vec<u64> = tracker.events().counts().values().copied().collect();
        assert_eq!(counts, [30]);
    }
}

/// After a long gap a track's position has next to nothing of its own.
#[test]
fn a_track_close_to_singular_stays_definite() {
    let motion = ConstantVelocity::new(KinematicNoise::Psd(vec![1e-40; 2])).unwrap();
    let sensor = SensorModel::Position(PositionSensor::new(vec![1e-5; 2]).unwrap());
    let sensors = BTreeMap::from([("lidar".to_string(), sensor)]);
    let mut config = TrackerConfig::new(MotionModel::ConstantVelocity(motion), sensors, 20.0).unwrap();
    let state = Gaussian::new(DVector::zeros(4), DMatrix::identity(4, 4)).unwrap();
    config.initial = vec![InitialState { time: 0.0, state }];
    let times = (1..=20).map(f64::from).chain((0..20).map(|k| 1e9 + f64::from(k)));
    let scans: Vec<Scan> = times
        .map(|time| Scan::new(time, "lidar", vec![DVector::zeros(2)]))
        .collect();
    let mut tracker = MultiTargetTracker::new(config.clone()).unwrap();
    for (k, scan) in scans.iter().enumerate() {
        let tracks = tracker.step(scan).unwrap();
        assert_eq!((tracks.len(), tracks[0].hits), (1, k as u64 + 1));
        let cov = &tracks[0].state.cov;
        assert_eq!(*cov, cov.transpose());
        assert!(Cholesky::new(cov, "P").is_ok(), "scan {k}: {cov}");
    }
    let escalated = |event: &&Event| event.code == EventCode::Escalated;
    let events: Vec<f64> = tracker
        .events()
        .recent()
        .filter(escalated)
        .map(|event| event.time)
        .collect();
    assert_eq!(events, [1e9]);
    let copy = MultiTargetTracker::from_bytes(&tracker.to_bytes().unwrap()).unwrap();
    assert_eq!(copy.to_bytes().unwrap(), tracker.to_bytes().unwrap());
    config.strict = true;
    let strict = MultiTargetTracker::new(config).unwrap().run(&scans);
    assert!(matches!(strict, Err(Error::Strict { .. })));
}

#[test]
fn a_model_from_outside_cannot_be_saved_and_says_so() {
    let motion = ConstantVelocity::new(KinematicNoise::Psd(vec![0.5; 2])).unwrap();
    let mut config = tracker().config().clone();
    config.motion = MotionModel::Custom(std::sync::Arc::new(motion));
    let tracker = MultiTargetTracker::new(config).unwrap();
    assert!(matches!(tracker.to_bytes(), Err(Error::CannotSave { .. })));
}
