//! Components of intensities whose covariances are of extreme condition: Joseph form to 1e14, from there steps by roots.

use nalgebra::{DMatrix, DVector};
use trackrs::error::Error;
use trackrs::event::EventCode;
use trackrs::gating::mahalanobis::Gate;
use trackrs::linalg::cholesky::Cholesky;
use trackrs::model::motion::{ConstantVelocity, KinematicNoise, LinearMotion};
use trackrs::model::sensor::{LinearSensor, PositionSensor};
use trackrs::model::{MotionModel, SensorModel};
use trackrs::rfs::cphd::CphdUpdate;
use trackrs::rfs::gm_phd::PointUpdate;
use trackrs::rfs::mixture::Component;
use trackrs::rfs::prediction::{Birth, Spawn};
use trackrs::stats::stream::Stream;
use trackrs::tracker::moments::TrackFilter;
use trackrs::tracker::phd::PhdTracker;
use trackrs::tracker::phd::config::{IntensityUpdate, PhdConfig};
use trackrs::{Gaussian, Scan};

const STATES: usize = 4;
const UPDATES: usize = 200;
const TRIALS: usize = 10;

fn point() -> PointUpdate {
    PointUpdate {
        gate: Gate::new(0.999).unwrap(),
        prune: 1e-6,
    }
}

/// How measurements become targets, by name; none is that of extended targets.
fn updates() -> [(&'static str, Option<IntensityUpdate>); 3] {
    let cardinalised = CphdUpdate {
        point: point(),
        max_targets: 5,
    };
    [
        ("point", Some(IntensityUpdate::Point(point()))),
        ("cardinalised", Some(IntensityUpdate::Cardinalised(cardinalised))),
        ("extended", None),
    ]
}

/// One target at 0, two numbers of which are measured with noise I/condition; its variances reach from 1 to 1/condition, and its
/// motion turns it out of its axes.
fn trial(update: Option<IntensityUpdate>, condition: f64, number: usize) -> (PhdConfig, Birth, Vec<Scan>) {
    let mut stream = Stream::new(7, number as u64);
    let mut draw = || stream.between(-1.0, 1.0);
    let h = DMatrix::from_fn(2, STATES, |_, _| draw());
    let mut turn = DMatrix::identity(STATES, STATES);
    for (i, j) in (0..STATES).flat_map(|i| (0..i).map(move |j| (i, j))) {
        let (sine, cosine) = (3.0 * draw()).sin_cos();
        let mut plane = DMatrix::identity(STATES, STATES);
        (plane[(i, i)], plane[(j, j)], plane[(i, j)], plane[(j, i)]) = (cosine, cosine, sine, -sine);
        turn = plane * turn;
    }
    let motion = LinearMotion::new(turn, DMatrix::zeros(STATES, STATES)).unwrap();
    let sensor = LinearSensor::new(h, DMatrix::identity(2, 2) / condition, DVector::zeros(2)).unwrap();
    let (motion, sensor) = (MotionModel::Linear(motion), SensorModel::Linear(sensor));
    let reports = if update.is_none() { 3 } else { 1 };
    let mut config = PhdConfig::new(motion, sensor, Vec::new(), 3.0, 0.0);
    config.fate.survival_probability = 1.0;
    if let Some(update) = update {
        config.update = update;
    }
    let variance = |i: usize| condition.powf(-(i as f64) / (STATES - 1) as f64);
    let target = Birth {
        weight: 1.0,
        state: Gaussian {
            mean: DVector::zeros(STATES),
            cov: DMatrix::from_diagonal(&DVector::from_fn(STATES, |i, _| variance(i))),
        },
    };
    let mut value = |_| DVector::from_fn(2, |_, _| draw() / condition.sqrt());
    let scans = (1..=UPDATES).map(|k| Scan::new(k as f64, "", (0..reports).map(&mut value).collect()));
    let scans = scans.collect();
    (config, target, scans)
}

/// Whether it is symmetric, and its correlations have a Cholesky factor.
fn is_definite(cov: &DMatrix<f64>) -> bool {
    let scale = |i: usize| cov[(i, i)].sqrt();
    let correlations = DMatrix::from_fn(cov.nrows(), cov.ncols(), |i, j| cov[(i, j)] / (scale(i) * scale(j)));
    *cov == cov.transpose() && Cholesky::new(&correlations, "P").is_ok()
}

/// Times of the events.
fn escalations(tracker: &PhdTracker) -> Vec<f64> {
    let events = tracker.events().recent();
    events
        .filter(|event| event.code == EventCode::Escalated)
        .map(|event| event.time)
        .collect()
}

/// How many trials are positive definite and finite throughout, and how many told that steps were done by roots.
fn outcome(update: Option<&IntensityUpdate>, filter: TrackFilter, condition: f64) -> [usize; 2] {
    let (mut definite, mut told) = (0, 0);
    for number in 0..TRIALS {
        let (mut config, target, scans) = trial(update.cloned(), condition, number);
        config.filter = filter;
        let mut tracker = PhdTracker::starting(config.clone(), std::slice::from_ref(&target), 0.0).unwrap();
        let good = |c: &Component| c.weight.is_finite() && is_definite(&c.state.cov);
        let all = scans.iter().all(|scan| {
            tracker.step(scan).unwrap();
            !tracker.mixture().is_empty() && tracker.mixture().iter().all(good)
        });
        definite += usize::from(all);
        let times = escalations(&tracker);
        if all {
            assert!(times.len() <= 1, "{times:?}");
            let counts = tracker.events().counts();
            assert_eq!(counts.values().sum::<u64>(), times.len() as u64, "{counts:?}");
        }
        told += times.len();
        config.strict = true;
        let mut strict = PhdTracker::starting(config, &[target], 0.0).unwrap();
        assert_eq!(
            matches!(strict.run(&scans), Err(Error::Strict { .. })),
            !times.is_empty()
        );
    }
    [definite, told]
}

#[test]
fn components_stay_definite_to_a_condition_of_1e24() {
    for (name, update) in updates() {
        for filter in [TrackFilter::Extended, TrackFilter::SecondOrder, TrackFilter::Unscented] {
            for exponent in [9, 15, 18, 24] {
                let [definite, told] = outcome(update.as_ref(), filter, 10_f64.powi(exponent));
                let what = format!("{name} {filter:?} 1e{exponent}: {definite} definite, {told} told");
                assert_eq!(definite, TRIALS, "{what}");
                assert!(exponent < 18 || told == TRIALS, "{what}");
                assert!(exponent > 9 || told == 0, "{what}");
            }
        }
    }
}

/// Targets whose positions have next to nothing of their own after a long gap, and what they give off.
fn gap(update: Option<IntensityUpdate>) -> (PhdConfig, Birth, Vec<Scan>) {
    let motion = ConstantVelocity::new(KinematicNoise::Psd(vec![1e-40; 2])).unwrap();
    let sensor = SensorModel::Position(PositionSensor::new(vec![1e-5; 2]).unwrap());
    let mut config = PhdConfig::new(MotionModel::ConstantVelocity(motion), sensor, Vec::new(), 3.0, 0.0);
    if let Some(update) = update {
        config.update = update;
    }
    let state = Gaussian::new(DVector::zeros(4), DMatrix::identity(4, 4)).unwrap();
    let times = (1..=20).map(f64::from).chain((0..20).map(|k| 1e9 + f64::from(k)));
    let scan = |time| Scan::new(time, "", vec![DVector::zeros(2)]);
    (config, Birth { weight: 1.0, state }, times.map(scan).collect())
}

#[test]
fn a_long_gap_is_told_once_of_a_target() {
    for (name, update) in updates() {
        let (config, target, scans) = gap(update);
        let mut tracker = PhdTracker::starting(config, &[target], 0.0).unwrap();
        for scan in &scans {
            tracker.step(scan).unwrap();
            assert!(
                tracker.mixture().iter().all(|c| is_definite(&c.state.cov)),
                "{name} {}",
                scan.time
            );
            // A save in between loses nothing of it.
            tracker = PhdTracker::from_bytes(&tracker.to_bytes().unwrap()).unwrap();
        }
        assert_eq!(escalations(&tracker), [1e9], "{name}");
    }
}

#[test]
fn what_is_given_off_stays_definite() {
    let (mut config, target, scans) = gap(Some(IntensityUpdate::Point(point())));
    config.fate.spawns = vec![Spawn {
        weight: 0.01,
        offset: DVector::from_element(4, 1.0),
        cov: DMatrix::zeros(4, 4),
    }];
    // All stay apart.
    config.reduction.merge = 0.0;
    let (mut rooted, mut tracker) = (false, PhdTracker::starting(config, &[target], 0.0).unwrap());
    for scan in &scans {
        tracker.step(scan).unwrap();
        rooted |= tracker.mixture().iter().any(|c| c.label != 0 && c.rooted);
        assert!(
            tracker.mixture().iter().all(|c| is_definite(&c.state.cov)),
            "{}",
            scan.time
        );
    }
    assert!(rooted);
}
