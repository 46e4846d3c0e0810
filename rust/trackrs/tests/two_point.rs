//! Tracks that two reports begin (N14), against the golden vector, the rule written out again, and what it must not do.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use serde_json::Value;
use trackrs::association::associator::Associator;
use trackrs::association::npda::{Bookkeeping, Npda, PartialCovariance};
use trackrs::event::EventCode;
use trackrs::gating::mahalanobis::Gate;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk};
use trackrs::model::sensor::{PositionSensor, RangeBearing};
use trackrs::model::{MotionModel, SensorModel};
use trackrs::stats::stream::Stream;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::lifecycle::{Deletion, Initiator, MofN};
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::{Error, Scan, Track};

const MAX_SPEED: f64 = 100.0;
const WITHIN: f64 = 30.0;
/// Order of the state in the golden vector: x vx y vy.
const BLOCKS: [usize; 4] = [0, 2, 1, 3];

fn velocity() -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Std(vec![2.0; 2])).unwrap())
}

/// One hit confirms, so that a track is seen at the time of the pair; no report lies in the gate of a track.
fn config(motion: MotionModel) -> TrackerConfig {
    let radar = SensorModel::RangeBearing(RangeBearing::new([0.0, 0.0], 20.0, 1e-3).unwrap());
    let lidar = SensorModel::Position(PositionSensor::new(vec![1.0, 1.0]).unwrap());
    let sensors = BTreeMap::from([("radar".to_string(), radar), ("lidar".to_string(), lidar)]);
    let mut config = TrackerConfig::new(motion, sensors, MAX_SPEED).unwrap();
    config.gate = Gate::new(1e-12).unwrap();
    config.initiator = Initiator::MofN(MofN {
        m: 1,
        n: 1,
        max_speed: MAX_SPEED,
        min_displacement: 0.0,
        min_separation: 0.0,
        pair_within: Some(WITHIN),
    });
    config.deletion = Some(Deletion {
        max_misses: 1000,
        max_time: None,
    });
    config.associator = Associator::Npda(Npda {
        clutter_probability: Some(0.0),
        covariance: PartialCovariance::Moment,
        bookkeeping: Bookkeeping::Each,
    });
    config
}

fn tracker() -> MultiTargetTracker {
    MultiTargetTracker::new(config(velocity())).unwrap()
}

fn scan(time: f64, sensor: &str, rows: &[[f64; 2]]) -> Scan {
    let values = rows.iter().map(|row| DVector::from_row_slice(row)).collect();
    Scan::new(time, sensor, values)
}

fn assert_close(found: &DMatrix<f64>, expected: &DMatrix<f64>) {
    let error = (found - expected).amax() / expected.amax();
    assert!(error <= 1e-9, "{error}: {found} {expected}");
}

#[test]
fn golden_track_of_two_reports() {
    let path = format!(
        "{}/../../tests/data/npda_wrap_and_initiation.json",
        env!("CARGO_MANIFEST_DIR")
    );
    let data: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let golden = &data["initiation"];
    let number = |value: &Value| value.as_f64().unwrap();
    let mut tracker = tracker();
    let mut tracks = Vec::new();
    for k in 0..2 {
        assert!(tracks.is_empty());
        let row = [number(&golden["z"][k][0]), number(&golden["z"][k][1])];
        tracks = tracker.step(&scan(number(&golden["t"][k]), "radar", &[row])).unwrap();
    }
    let [track] = tracks.as_slice() else {
        panic!("{tracks:?}");
    };
    for i in 0..4 {
        assert!((track.state.mean[i] - number(&golden["x"][BLOCKS[i]])).abs() <= 1e-9);
    }
    let cov = DMatrix::from_fn(4, 4, |i, j| number(&golden["P"][BLOCKS[i]][BLOCKS[j]]));
    assert_close(&track.state.cov, &cov);
    assert_eq!((track.hits, track.last_hit), (2, 3.0));
}

/// The rule, written out again for reports that come one by one.
#[derive(Default)]
struct Rule {
    points: Vec<(f64, Vector2<f64>, Matrix2<f64>)>,
}

impl Rule {
    /// The track that the report begins: mean and covariance.
    fn take(&mut self, t: f64, z: [f64; 2]) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let (sin, cos) = z[1].sin_cos();
        let p = Vector2::new(z[0] * cos, z[0] * sin);
        let j = Matrix2::new(cos, -z[0] * sin, sin, z[0] * cos);
        let c = j * Matrix2::new(400.0, 0.0, 0.0, 1e-6) * j.transpose();
        self.points.retain(|(t0, ..)| t - t0 <= WITHIN);
        let fits = |(t0, p0, c0): &(f64, Vector2<f64>, Matrix2<f64>)| {
            let bound = MAX_SPEED * (t - t0) + 3.0 * (c + c0).trace().sqrt();
            t > *t0 && (p - p0).norm() <= bound
        };
        // The rule leaves open which of several of one time: the nearest.
        let nearness = |&i: &usize| (self.points[i].0, -(p - self.points[i].1).norm());
        let fitting = (0..self.points.len()).filter(|&i| fits(&self.points[i]));
        let Some(partner) = fitting.max_by(|a, b| nearness(a).partial_cmp(&nearness(b)).unwrap()) else {
            self.points.push((t, p, c));
            return None;
        };
        let (t0, p0, c0) = self.points.remove(partner);
        let dt = t - t0;
        let v = (p - p0) / dt;
        let mut cov = DMatrix::zeros(4, 4);
        cov.view_mut((0, 0), (2, 2)).copy_from(&c);
        cov.view_mut((0, 2), (2, 2)).copy_from(&(c / dt));
        cov.view_mut((2, 0), (2, 2)).copy_from(&(c / dt));
        cov.view_mut((2, 2), (2, 2)).copy_from(&((c + c0) / (dt * dt)));
        Some((DVector::from_vec(vec![p.x, p.y, v.x, v.y]), cov))
    }
}

/// The tracks of a scan that have only just been confirmed.
fn newest(tracks: &[Track], before: u64) -> Vec<&Track> {
    tracks.iter().filter(|track| track.id > before).collect()
}

#[test]
fn single_reports_begin_the_tracks_of_the_rule() {
    let (mut begun, mut fast) = (0, 0);
    for seed in 0..100 {
        for associator in [config(velocity()).associator, Associator::GlobalNearestNeighbour] {
            let mut stream = Stream::new(seed, 0);
            let mut config = config(velocity());
            config.associator = associator;
            let mut tracker = MultiTargetTracker::new(config).unwrap();
            let (mut rule, mut time, mut confirmed) = (Rule::default(), 0.0, 0);
            for _ in 0..60 {
                // Now and then two reports have one time, and now and then there is a gap.
                time += stream.choice(&[0.0, 1.0, 3.0, 3.0, 12.0]).unwrap();
                let row = [stream.between(500.0, 3000.0), stream.between(0.0, 1.5)];
                let tracks = tracker.step(&scan(time, "radar", &[row])).unwrap();
                let new = newest(&tracks, confirmed);
                let expected = rule.take(time, row);
                // One that is too fast for a target is begun, and not confirmed.
                let Some((mean, cov)) = expected.filter(|(mean, _)| mean.rows(2, 2).norm() <= MAX_SPEED) else {
                    fast += usize::from(new.is_empty());
                    assert!(new.is_empty());
                    continue;
                };
                assert_eq!(new.len(), 1);
                assert!((&new[0].state.mean - mean).amax() <= 1e-9 * 3000.0);
                assert_close(&new[0].state.cov, &cov);
                confirmed = new[0].id;
                begun += 1;
            }
            tracker.ledger().check().unwrap();
        }
    }
    assert!(begun > 1000 && fast > 1000, "{begun} {fast}");
}

#[test]
fn the_order_of_the_rows_says_nothing() {
    for seed in 0..50 {
        let mut stream = Stream::new(seed, 0);
        let (mut plain, mut mixed) = (tracker(), tracker());
        for k in 0..15 {
            let rows: Vec<[f64; 2]> = (0..8)
                .map(|_| [stream.between(-500.0, 500.0), stream.between(-500.0, 500.0)])
                .collect();
            let turned: Vec<[f64; 2]> = (0..8).map(|i| rows[(5 * i + k) % 8]).collect();
            let time = 2.0 * k as f64;
            let by_place = |mut tracks: Vec<Track>| {
                tracks.sort_by(|a, b| a.state.mean[0].total_cmp(&b.state.mean[0]));
                tracks.into_iter().map(|track| track.state).collect::<Vec<_>>()
            };
            let (a, b) = (scan(time, "lidar", &rows), scan(time, "lidar", &turned));
            assert_eq!(by_place(plain.step(&a).unwrap()), by_place(mixed.step(&b).unwrap()));
        }
        assert!(!plain.tracks().is_empty());
    }
}

#[test]
fn reports_of_one_time_or_one_scan_never_pair() {
    let mut tracker = tracker();
    assert!(tracker.step(&scan(1.0, "lidar", &[[5.0, 0.0]])).unwrap().is_empty());
    assert!(tracker.step(&scan(1.0, "radar", &[[5.0, 0.0]])).unwrap().is_empty());
    let apart = scan(2.0, "lidar", &[[300.0, 0.0], [301.0, 0.0]]).at_times(&[1.5, 2.0]);
    assert!(tracker.step(&apart).unwrap().is_empty());
    // Both sensors' reports still wait, and each begins a track with one of these.
    assert_eq!(
        tracker
            .step(&scan(2.0, "radar", &[[5.0, 0.0], [6.0, 0.0]]))
            .unwrap()
            .len(),
        2
    );
}

#[test]
fn a_report_waits_so_long_and_no_longer_and_not_across_a_reset() {
    let both = |gap: f64, reset: Option<f64>| {
        let mut config = config(velocity());
        config.max_gap = reset;
        let mut tracker = MultiTargetTracker::new(config).unwrap();
        tracker.step(&scan(0.0, "lidar", &[[0.0, 0.0]])).unwrap();
        tracker.step(&scan(gap, "lidar", &[[gap, 0.0]])).unwrap().len()
    };
    assert_eq!(both(WITHIN, None), 1);
    assert_eq!(both(WITHIN + 1e-9, None), 0);
    assert_eq!(both(WITHIN, Some(WITHIN - 1.0)), 0);
}

#[test]
fn both_reports_are_hits_and_the_third_counts_from_there() {
    let mut config = config(velocity());
    config.gate = Gate::new(0.99).unwrap();
    let Initiator::MofN(rule) = &mut config.initiator else {
        panic!();
    };
    (rule.m, rule.n) = (3, 4);
    let mut tracker = MultiTargetTracker::new(config).unwrap();
    let counts: Vec<usize> = (0..4)
        .map(|k| {
            let x = 10.0 * f64::from(k);
            tracker.step(&scan(f64::from(k), "lidar", &[[x, 0.0]])).unwrap().len()
        })
        .collect();
    assert_eq!(counts, [0, 0, 1, 1]);
    assert_eq!(tracker.tracks()[0].hits, 4);
}

#[test]
fn a_track_that_is_begun_between_scans_is_brought_to_the_time_of_its_scan() {
    let mut tracker = tracker();
    tracker.step(&scan(0.0, "lidar", &[[0.0, 0.0]])).unwrap();
    let late = scan(5.0, "lidar", &[[20.0, 0.0]]).at_times(&[2.0]);
    let tracks = tracker.step(&late).unwrap();
    assert!((tracks[0].state.mean[0] - 50.0).abs() < 1e-9);
    assert_eq!((tracks[0].time, tracks[0].last_hit), (5.0, 2.0));
}

#[test]
fn accelerations_are_unknown_and_a_motion_without_velocity_is_refused() {
    let noise = || KinematicNoise::Psd(vec![1.0; 2]);
    let motion = MotionModel::ConstantAcceleration(ConstantAcceleration::new(noise()).unwrap());
    let mut tracker = MultiTargetTracker::new(config(motion)).unwrap();
    tracker.step(&scan(0.0, "lidar", &[[0.0, 0.0]])).unwrap();
    let tracks = tracker.step(&scan(2.0, "lidar", &[[6.0, -8.0]])).unwrap();
    let state = &tracks[0].state;
    assert!((&state.mean - DVector::from_vec(vec![6.0, -8.0, 3.0, -4.0, 0.0, 0.0])).amax() < 1e-12);
    assert_eq!((state.cov[(4, 4)], state.cov[(0, 4)]), (100.0, 0.0));
    let walk = MotionModel::RandomWalk(RandomWalk::new(noise()).unwrap());
    for (motion, within) in [(walk, 30.0), (velocity(), 0.0), (velocity(), f64::NAN)] {
        let mut config = config(motion);
        if let Initiator::MofN(rule) = &mut config.initiator {
            rule.pair_within = Some(within);
        }
        let made = MultiTargetTracker::new(config);
        assert!(matches!(made, Err(Error::InvalidParameter { name, .. }) if name == "pair_within"));
    }
}

/// The velocity of two reports one after the other has a variance beyond all numbers: no track, an event, and the next scan.
#[test]
fn a_pair_whose_velocity_is_no_number_begins_no_track() {
    let mut config = config(velocity());
    let vague = SensorModel::Position(PositionSensor::new(vec![1e150, 1e150]).unwrap());
    config.sensors.insert("lidar".into(), vague);
    let mut tracker = MultiTargetTracker::new(config).unwrap();
    for time in [0.0, 1e-6] {
        assert!(tracker.step(&scan(time, "lidar", &[[0.0, 0.0]])).unwrap().is_empty());
    }
    assert_eq!(tracker.events().counts()[&EventCode::TrackDiverged], 1);
    tracker.ledger().check().unwrap();
}
