//! The tracker by intensity as its users see it.

use nalgebra::{DMatrix, DVector};
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::{LinearSensor, PositionSensor, RangeBearing};
use trackrs::model::{MotionModel, SensorModel};
use trackrs::rfs::prediction::{Birth, Spawn};
use trackrs::stats::stream::Stream;
use trackrs::tracker::phd::PhdTracker;
use trackrs::tracker::phd::config::{AdaptiveBirth, PhdConfig};
use trackrs::{Gaussian, Scan, Track};

const CLUTTER: f64 = 2.5e-6;

fn motion() -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Std(vec![2.0; 2])).unwrap())
}

fn birth(x: f64, y: f64) -> Birth {
    let diagonal = DVector::from_vec(vec![2500.0, 2500.0, 625.0, 625.0]);
    Birth {
        weight: 0.1,
        state: Gaussian::new(
            DVector::from_vec(vec![x, y, 0.0, 0.0]),
            DMatrix::from_diagonal(&diagonal),
        )
        .unwrap(),
    }
}

fn config(births: Vec<Birth>) -> PhdConfig {
    let sensor = SensorModel::Position(PositionSensor::new(vec![20.0; 2]).unwrap());
    PhdConfig::new(motion(), sensor, births, 10.0, CLUTTER)
}

/// Two targets that cross in the origin in clutter; `map` is applied to every position.
fn scans(count: usize, seed: u64, map: impl Fn([f64; 2]) -> Vec<f64>) -> Vec<Scan> {
    let mut stream = Stream::new(seed, 0);
    let mut out = Vec::new();
    for k in 0..count {
        let s = k as f64 - 15.0;
        let mut values = Vec::new();
        for centre in [[12.0 * s, 9.0 * s], [12.0 * s, -9.0 * s]] {
            for _ in 0..stream.poisson(10.0).unwrap() {
                let noise = [20.0 * stream.normal(), 20.0 * stream.normal()];
                values.push(DVector::from_vec(map([centre[0] + noise[0], centre[1] + noise[1]])));
            }
        }
        for _ in 0..stream.poisson(10.0).unwrap() {
            let place = [stream.between(-1000.0, 1000.0), stream.between(-1000.0, 1000.0)];
            values.push(DVector::from_vec(map(place)));
        }
        out.push(Scan::new(k as f64, "radar", values));
    }
    out
}

fn births() -> Vec<Birth> {
    vec![birth(-180.0, -135.0), birth(-180.0, 135.0)]
}

fn plain(position: [f64; 2]) -> Vec<f64> {
    position.to_vec()
}

#[test]
fn two_targets_keep_their_identities_through_a_crossing() {
    let mut kept = 0;
    for seed in 0..20 {
        let tracks = PhdTracker::new(config(births()))
            .unwrap()
            .run(&scans(31, seed, plain))
            .unwrap();
        let last = &tracks[30];
        let near = |track: &Track, y: f64| (track.state.mean[1] - y).abs() < 30.0;
        let first: Vec<bool> = tracks[3].iter().map(|track| near(track, -108.0)).collect();
        let end: Vec<bool> = last.iter().map(|track| near(track, 135.0)).collect();
        kept += usize::from(last.len() == 2 && last.iter().all(|t| t.id <= 2) && first == end);
    }
    assert!(kept >= 19, "{kept}");
}

#[test]
fn scan_by_scan_saved_and_in_one_run_are_the_same_bits() {
    let scans = scans(25, 3, plain);
    let whole = PhdTracker::new(config(births())).unwrap().run(&scans).unwrap();
    let mut tracker = PhdTracker::new(config(births())).unwrap();
    for (scan, expected) in scans.iter().zip(&whole) {
        assert_eq!(&tracker.step(scan).unwrap(), expected);
        tracker = PhdTracker::from_bytes(&tracker.to_bytes().unwrap()).unwrap();
    }
    tracker.ledger().check().unwrap();
}

/// An affine change of the measurements' axes, with the sensor and its noise changed likewise, changes no track: distances
/// are Mahalanobis distances everywhere.
#[test]
fn axes_do_not_matter() {
    let change = DMatrix::from_row_slice(2, 2, &[3.0, 1.0, -0.5, 0.25]);
    let turned = |p: [f64; 2]| (&change * DVector::from_row_slice(&p)).as_slice().to_vec();
    let mut h = DMatrix::zeros(2, 4);
    h.view_mut((0, 0), (2, 2)).copy_from(&change);
    let noise = &change * change.transpose() * 400.0;
    let mut other = config(births());
    let sensor = SensorModel::Linear(LinearSensor::new(h, noise, DVector::zeros(2)).unwrap());
    let watch = other.watches.get_mut("").unwrap();
    watch.sensor = sensor;
    watch.clutter_density = CLUTTER / change.determinant().abs();
    let expected = PhdTracker::new(config(births()))
        .unwrap()
        .run(&scans(25, 5, plain))
        .unwrap();
    let found = PhdTracker::new(other).unwrap().run(&scans(25, 5, turned)).unwrap();
    for (a, b) in expected.iter().flatten().zip(found.iter().flatten()) {
        assert_eq!(a.id, b.id);
        assert!((&a.state.mean - &b.state.mean).amax() < 1e-6, "{a:?} {b:?}");
    }
}

/// A radar whose targets stand on the seam of the bearing sees as many as one that is turned away from it.
#[test]
fn the_seam_of_an_angle_is_no_border() {
    let radar = |side: f64| {
        let sensor = RangeBearing::new([0.0, 0.0], 10.0, 0.02).unwrap();
        let mut config = config(vec![birth(side * 600.0, 0.0)]);
        let watch = config.watches.get_mut("").unwrap();
        watch.sensor = SensorModel::RangeBearing(sensor);
        watch.clutter_density = 1e-3;
        config
    };
    let scans = |side: f64| {
        let mut stream = Stream::new(4, 0);
        (0..12)
            .map(|k| {
                let values = (0..10).map(|_| {
                    let (range, bearing) = (600.0 + 10.0 * stream.normal(), 0.02 * stream.normal());
                    let bearing = if side > 0.0 {
                        bearing
                    } else {
                        (std::f64::consts::PI + bearing + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
                            - std::f64::consts::PI
                    };
                    DVector::from_vec(vec![range, bearing])
                });
                Scan::new(f64::from(k), "radar", values.collect())
            })
            .collect::<Vec<Scan>>()
    };
    let [ahead, behind] = [1.0, -1.0].map(|side| {
        let mut tracker = PhdTracker::new(radar(side)).unwrap();
        let tracks = tracker.run(&scans(side)).unwrap();
        (tracks[11].len(), tracker.expected_targets())
    });
    assert_eq!(ahead.0, 1);
    assert_eq!(behind.0, 1);
    assert!((ahead.1 - behind.1).abs() < 1e-9, "{ahead:?} {behind:?}");
}

#[test]
fn targets_are_found_where_nobody_expects_them() {
    let mut adaptive = config(vec![]);
    adaptive.adaptive_birth = Some(AdaptiveBirth {
        weight: 0.1,
        max_speed: 40.0,
        min_measurements: 2,
    });
    let mut tracker = PhdTracker::new(adaptive).unwrap();
    let tracks = tracker.run(&scans(14, 11, plain)).unwrap();
    assert_eq!(tracks[13].len(), 2, "{:?}", tracks[13]);
    assert!((tracker.expected_targets() - 2.0).abs() < 0.2);
}

#[test]
fn a_target_gives_off_another() {
    let mut stream = Stream::new(2, 0);
    let mut spawning = config(vec![birth(0.0, 0.0)]);
    spawning.fate.spawns = vec![Spawn {
        weight: 0.05,
        offset: DVector::zeros(4),
        cov: DMatrix::from_diagonal(&DVector::from_vec(vec![400.0, 400.0, 900.0, 900.0])),
    }];
    let mut scans = Vec::new();
    for k in 0..25 {
        let t = f64::from(k);
        let mut values = Vec::new();
        let mut centres = vec![[10.0 * t, 0.0]];
        if k >= 10 {
            centres.push([10.0 * t, 30.0 * (t - 10.0)]);
        }
        for centre in centres {
            for _ in 0..10 {
                values.push(DVector::from_vec(vec![
                    centre[0] + 20.0 * stream.normal(),
                    centre[1] + 20.0 * stream.normal(),
                ]));
            }
        }
        scans.push(Scan::new(t, "radar", values));
    }
    let tracks = PhdTracker::new(spawning).unwrap().run(&scans).unwrap();
    assert_eq!((tracks[9].len(), tracks[24].len()), (1, 2));
}

#[test]
fn every_edge_is_defined() {
    let scans = scans(8, 1, plain);
    let run = |change: fn(&mut PhdConfig), scans: &[Scan]| {
        let mut config = config(births());
        change(&mut config);
        let mut tracker = PhdTracker::new(config).unwrap();
        let tracks = tracker.run(scans).unwrap();
        assert!(tracker.expected_targets().is_finite());
        for component in tracker.mixture() {
            assert!(component.weight >= 0.0 && component.state.mean.iter().all(|v| v.is_finite()));
        }
        tracks.iter().map(Vec::len).max().unwrap_or(0)
    };
    assert_eq!(run(|_| (), &scans), 2);
    // Nothing survives, so that nothing is confirmed.
    assert_eq!(run(|c| c.fate.survival_probability = 0.0, &scans), 0);
    assert_eq!(run(|c| c.fate.births.clear(), &scans), 0);
    run(|c| c.watches.get_mut("").unwrap().detection_probability = 1.0, &scans);
    run(|c| c.watches.get_mut("").unwrap().clutter_density = 0.0, &scans);
    let empty: Vec<Scan> = (0..5).map(|k| Scan::new(f64::from(k), "radar", vec![])).collect();
    assert_eq!(run(|_| (), &empty), 0);
    let same = |n: usize| vec![DVector::from_vec(vec![-180.0, -135.0]); n];
    // Rows that repeat one are refused; so the pile is a hair wide.
    let pile: Vec<Scan> = (0..4)
        .map(|k| {
            let mut values = same(12);
            values.iter_mut().enumerate().for_each(|(i, v)| v[0] += 1e-9 * i as f64);
            Scan::new(f64::from(k), "radar", values)
        })
        .collect();
    assert_eq!(run(|_| (), &pile), 1);
    let line: Vec<Scan> = (0..4)
        .map(|k| {
            let values = (0..60)
                .map(|i| DVector::from_vec(vec![f64::from(i) - 200.0, -135.0]))
                .collect();
            Scan::new(f64::from(k), "radar", values)
        })
        .collect();
    run(|_| (), &line);
}

#[test]
fn what_cannot_be_used_is_booked() {
    let mut tracker = PhdTracker::new(config(births())).unwrap();
    let rows = vec![
        DVector::from_vec(vec![1.0, f64::NAN]),
        DVector::from_vec(vec![1.0]),
        DVector::from_vec(vec![f64::INFINITY, 0.0]),
        DVector::from_vec(vec![1.0, 2.0]),
    ];
    tracker.step(&Scan::new(5.0, "radar", rows.clone())).unwrap();
    tracker.step(&Scan::new(4.0, "radar", rows.clone())).unwrap();
    tracker
        .step(&Scan::new(6.0, "radar", rows[3..].to_vec()).at_times(&[5.5]))
        .unwrap();
    assert_eq!(tracker.ledger().used, 1);
    assert_eq!(tracker.ledger().rows_in, 9);
    tracker.ledger().check().unwrap();
    assert_eq!(tracker.events().recent().count(), 5);
}

#[test]
fn bad_parameters_name_themselves() {
    let message = |change: fn(&mut PhdConfig)| {
        let mut config = config(births());
        change(&mut config);
        PhdTracker::new(config).unwrap_err().to_string()
    };
    assert!(message(|c| c.fate.survival_probability = 1.5).contains("survival_probability"));
    assert!(message(|c| c.fate.birth_rate.shape = f64::NAN).contains("detections_per_target"));
    assert!(message(|c| c.watches.clear()).contains("sensors"));
    assert!(message(|c| c.confirmation.end_after = 0).contains("end_after"));
    assert!(message(|c| c.reduction.max_components = 0).contains("max_components"));
    assert!(message(|c| c.watches.get_mut("").unwrap().detection_probability = 0.0).contains("detection_probability"));
}
