//! The health of tracks: silent while the model is right, and quick when it is wrong.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use trackrs::event::EventCode;
use trackrs::filter::sequence::InitialState;
use trackrs::gating::mahalanobis::Gate;
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{MotionModel, SensorModel};
use trackrs::stats::stream::Stream;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::lifecycle::Deletion;
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::{Gaussian, Health, Scan};

/// Distance of two targets: no report is ever another's.
const APART: f64 = 1e6;
const DETECTION: f64 = 0.9;
/// A gate that lets a bias through.
const WIDE: f64 = 1.0 - 1e-9;

fn tracker(psd: f64, gate: f64, targets: usize) -> MultiTargetTracker {
    let motion = MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![psd; 2])).unwrap());
    let position = || SensorModel::Position(PositionSensor::new(vec![1.0; 2]).unwrap());
    let sensors = BTreeMap::from([("a".to_string(), position()), ("b".to_string(), position())]);
    let mut config = TrackerConfig::new(motion, sensors, 1e3).unwrap();
    config.gate = Gate::new(gate).unwrap();
    config.deletion = Some(Deletion {
        max_misses: 40,
        max_time: None,
    });
    config.initial = (0..targets)
        .map(|k| InitialState {
            time: 0.0,
            state: Gaussian::new(
                DVector::from_vec(vec![APART * k as f64, 0.0, 10.0, 0.0]),
                DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 1.0, 1.0, 1.0])),
            )
            .unwrap(),
        })
        .collect();
    MultiTargetTracker::new(config).unwrap()
}

/// Targets that move as constant velocity with this noise says, from the distribution of the initial states.
struct Truth {
    states: Vec<[f64; 4]>,
    stream: Stream,
}

impl Truth {
    fn new(targets: usize, seed: u64) -> Self {
        let mut stream = Stream::new(seed, 0);
        let mut draw = |mean: f64| mean + stream.normal();
        let states = (0..targets)
            .map(|k| [draw(APART * k as f64), draw(0.0), draw(10.0), draw(0.0)])
            .collect();
        Self { states, stream }
    }

    /// One second later: noise of covariance psd (1/3 1/2; 1/2 1), by its Cholesky factor (1/√3 0; √3/2 1/2).
    fn advance(&mut self, psd: f64, acceleration: [f64; 2]) {
        let root = psd.sqrt();
        for state in &mut self.states {
            for axis in 0..2 {
                let (u, v) = (self.stream.normal(), self.stream.normal());
                state[axis] += state[axis + 2] + 0.5 * acceleration[axis] + root * u / 3.0_f64.sqrt();
                state[axis + 2] += acceleration[axis] + root * (0.75_f64.sqrt() * u + 0.5 * v);
            }
        }
    }

    fn scan(&mut self, time: f64, sensor: &str, bias: f64) -> Scan {
        let mut values = Vec::new();
        for state in &self.states {
            let noise = [self.stream.normal(), self.stream.normal()];
            if self.stream.uniform() < DETECTION {
                values.push(DVector::from_vec(vec![state[0] + noise[0] + bias, state[1] + noise[1]]));
            }
        }
        Scan::new(time, sensor, values)
    }
}

/// After how many scans from the onset at scan 40 each target's track was no longer healthy, at most, in 30 runs; healthy before.
fn latest_alarm(psd: f64, true_psd: f64, gate: f64, onset: impl Fn(usize) -> ([f64; 2], f64)) -> (usize, Vec<Health>) {
    let mut latest = 0;
    let mut healths = Vec::new();
    for seed in 0..30 {
        let mut tracker = tracker(psd, gate, 1);
        let mut truth = Truth::new(1, seed);
        let two = onset(41).1 != 0.0;
        let mut alarm = None;
        for k in 1..=80 {
            let wrong = k > 40;
            let (acceleration, bias) = if wrong { onset(k) } else { ([0.0, 0.0], 0.0) };
            truth.advance(if wrong { true_psd } else { psd }, acceleration);
            let scan = truth.scan(
                k as f64,
                if two && k % 2 == 1 { "b" } else { "a" },
                if k % 2 == 0 { 0.0 } else { bias },
            );
            let tracks = tracker.step(&scan).unwrap();
            let health = tracks.iter().find(|track| track.id == 1).and_then(|track| track.health);
            if !wrong {
                assert_eq!(health, Some(Health::Healthy), "seed {seed} scan {k}");
            } else if alarm.is_none() && health != Some(Health::Healthy) {
                alarm = Some(k - 40);
                healths.extend(health);
            }
        }
        latest = latest.max(alarm.unwrap_or(usize::MAX));
    }
    (latest, healths)
}

#[test]
fn a_model_that_is_right_gives_no_alarm() {
    for (seed, gate) in [(1, 1.0 - 1e-6), (2, 1.0 - 1e-7), (3, WIDE)] {
        let (targets, scans) = (40, 1000);
        let mut tracker = tracker(0.1, gate, targets);
        let mut truth = Truth::new(targets, seed);
        let mut judged = 0;
        for k in 1..=scans {
            truth.advance(0.1, [0.0, 0.0]);
            let scan = truth.scan(f64::from(k), if k % 3 == 0 { "a" } else { "b" }, 0.0);
            let tracks = tracker.step(&scan).unwrap();
            judged += tracks.len();
            assert!(
                tracks.iter().all(|track| track.health == Some(Health::Healthy)),
                "{gate}, scan {k}"
            );
        }
        assert!(judged > 30_000, "{judged}");
        assert!(!tracker.events().counts().contains_key(&EventCode::TrackDegraded));
    }
}

#[test]
fn noise_ten_thousand_times_too_small_is_found_within_twenty_scans() {
    for gate in [0.99, 0.9999] {
        let (latest, _) = latest_alarm(1e-3, 10.0, gate, |_| ([0.0, 0.0], 0.0));
        assert!(latest <= 20, "{gate}: {latest}");
    }
}

#[test]
fn a_manoeuvre_is_found_within_twenty_scans() {
    for gate in [0.99, 0.9999] {
        let (latest, _) = latest_alarm(0.01, 0.01, gate, |_| ([0.0, 3.0], 0.0));
        assert!(latest <= 20, "{gate}: {latest}");
    }
}

#[test]
fn a_biased_sensor_is_found_within_twenty_scans() {
    let (latest, healths) = latest_alarm(0.01, 0.01, WIDE, |_| ([0.0, 0.0], 6.0));
    assert!(latest <= 20, "{latest}");
    assert!(healths.contains(&Health::Degraded));
}

/// Too much noise is a fault too: the covariance is too large.
#[test]
fn noise_ten_thousand_times_too_large_is_found_within_twenty_scans() {
    for seed in 0..30 {
        let mut tracker = tracker(1e3, 0.99, 1);
        let mut truth = Truth::new(1, seed);
        let mut alarm = None;
        for k in 1..=20 {
            truth.advance(0.1, [0.0, 0.0]);
            let tracks = tracker.step(&truth.scan(f64::from(k), "a", 0.0)).unwrap();
            if tracks[0].health == Some(Health::Degraded) {
                alarm = Some(k);
            }
        }
        assert!(alarm.is_some(), "seed {seed}");
        assert!(tracker.events().counts()[&EventCode::TrackDegraded] >= 1);
    }
}

/// A bias that ends leaves a healthy track, once it has left the window; strict mode raises nothing of this.
#[test]
fn health_returns_and_is_no_error_in_strict_mode() {
    let mut config = tracker(0.01, WIDE, 1).config().clone();
    config.strict = true;
    let mut tracker = MultiTargetTracker::new(config).unwrap();
    let mut truth = Truth::new(1, 4);
    let mut healths = Vec::new();
    for k in 1..=140 {
        truth.advance(0.01, [0.0, 0.0]);
        let biased = (40..70).contains(&k) && k % 2 == 1;
        let scan = truth.scan(
            f64::from(k),
            if k % 2 == 0 { "a" } else { "b" },
            if biased { 6.0 } else { 0.0 },
        );
        healths.push(tracker.step(&scan).unwrap()[0].health.unwrap());
        // What is saved goes on with the same judgement.
        tracker = MultiTargetTracker::from_bytes(&tracker.to_bytes().unwrap()).unwrap();
    }
    assert!(healths[..40].iter().all(|health| *health == Health::Healthy));
    assert!(healths[40..70].iter().any(|health| *health > Health::Healthy));
    assert!(healths[110..].iter().all(|health| *health == Health::Healthy));
    assert!(
        tracker
            .events()
            .recent()
            .any(|event| event.reason.contains("the NIS of its last 10 updates"))
    );
}
