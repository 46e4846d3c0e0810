//! Studies: the same on any number of threads, what does not fit is refused, failures are counted, values are known.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::DVector;
use trackrs::association::associator::Associator;
use trackrs::filter::lead::Lead;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{MotionModel, SensorModel};
use trackrs::sim::close_targets::{CloseTargets, CloseTargetsSettings};
use trackrs::sim::study::{
    Drawn, Estimate, Method, Named, Oversight, Scene, Study, StudyMetric, Trial, score_step, score_tracks,
};
use trackrs::sim::turning::{Turning, TurningSettings};
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::lifecycle::{Initiator, MofN};
use trackrs::tracker::multi_target::MultiTargetTracker;

const OSPA: StudyMetric = StudyMetric::Ospa {
    cutoff: 60.0,
    order: 2.0,
};

fn close() -> CloseTargets {
    let settings = CloseTargetsSettings {
        clutter: 0.1,
        ..CloseTargetsSettings::default()
    };
    CloseTargets::new(settings).unwrap()
}

fn scans() -> Scene {
    Scene::CloseTargets {
        scene: close(),
        scan_size: 1,
    }
}

/// A tracker that knows all targets and lets no two tracks share a report; `sensor` is what it calls the radar.
fn tracker(sensor: &str, known: usize) -> Method {
    let motion = ConstantVelocity::new(KinematicNoise::Std(vec![2.0; 2])).unwrap();
    let radar = SensorModel::RangeBearing(close().radar().clone());
    let sensors = BTreeMap::from([(sensor.to_owned(), radar)]);
    let mut config = TrackerConfig::new(MotionModel::ConstantVelocity(motion), sensors, 150.0).unwrap();
    config.associator = Associator::GlobalNearestNeighbour;
    config.initiator = Initiator::MofN(MofN {
        m: 3,
        n: 5,
        max_speed: 150.0,
        min_displacement: 0.0,
        min_separation: 0.0,
        pair_within: None,
    });
    let start = |i| InitialState {
        time: 0.0,
        state: close().initial(i),
    };
    config.initial = (0..known).map(start).collect();
    Method::Tracker(Box::new(MultiTargetTracker::new(config).unwrap()))
}

fn filter() -> Filter {
    let motion = ConstantAcceleration::new(KinematicNoise::Psd(vec![1.0])).unwrap();
    let sensor = PositionSensor::new(vec![0.0724]).unwrap();
    Filter::kalman(MotionModel::ConstantAcceleration(motion), SensorModel::Position(sensor)).unwrap()
}

fn angle() -> Scene {
    Scene::Turning(Turning::new(TurningSettings::turntable()).unwrap())
}

fn named(name: &str, method: Method) -> Named {
    Named {
        name: name.to_owned(),
        method,
    }
}

/// Bits, because NaN is not equal to itself.
fn bits(trials: &[Trial]) -> Vec<u64> {
    trials
        .iter()
        .flat_map(|trial| trial.values.iter().map(|v| v.to_bits()))
        .collect()
}

#[test]
fn any_number_of_threads_gives_the_same() {
    let methods = vec![named("known", tracker("radar", 3)), named("none", tracker("radar", 0))];
    let study = Study::new(scans(), methods, vec![OSPA, StudyMetric::Cardinality]).unwrap();
    let one = study.run_all(7, 0..9, 1).unwrap();
    assert_eq!(one.len(), 9);
    for threads in [0, 2, 3, 20] {
        assert_eq!(bits(&study.run_all(7, 0..9, threads).unwrap()), bits(&one));
    }
    assert_eq!(bits(&study.run_all(7, 4..6, 2).unwrap()), bits(&one[4..6]));
    assert_eq!(bits(&[study.run(7, 5).unwrap()]), bits(&one[5..6]));
    assert_ne!(bits(&study.run_all(8, 0..9, 1).unwrap()), bits(&one));
    assert!(study.run_all(7, 0..0, 2).unwrap().is_empty());
}

#[test]
fn what_does_not_fit_is_refused() {
    let refused = |scene, method, metric| {
        let found = Study::new(scene, vec![named("mine", method)], vec![metric]);
        found.unwrap_err().to_string()
    };
    let position = StudyMetric::Position { first: 0 };
    let one = Method::Filter(Box::new(filter()));
    for (text, found) in [
        ("mine", refused(scans(), one.clone(), OSPA)),
        ("mine", refused(angle(), tracker("radar", 3), position.clone())),
        ("ospa", refused(angle(), one.clone(), OSPA)),
        ("error", refused(scans(), tracker("radar", 3), position)),
        (
            "all 3 targets",
            refused(scans(), tracker("radar", 2), StudyMetric::Identity { separation: 9.0 }),
        ),
        (
            "separation",
            refused(scans(), tracker("radar", 3), StudyMetric::Identity { separation: 0.0 }),
        ),
        (
            "lead = -1",
            refused(
                angle(),
                one,
                StudyMetric::Lead {
                    lead: Lead::Seconds(-1.0),
                    first: 0,
                },
            ),
        ),
    ] {
        assert!(found.contains(text), "{found}");
    }
    let scene = Scene::CloseTargets {
        scene: close(),
        scan_size: 0,
    };
    assert!(refused(scene, tracker("radar", 3), OSPA).contains("scan_size"));
}

#[test]
fn a_method_that_fails_is_named_and_the_others_go_on() {
    let methods = vec![
        named("good", tracker("radar", 3)),
        named("deaf", tracker("sonar", 3)),
        named("again", tracker("radar", 3)),
    ];
    let study = Study::new(scans(), methods, vec![OSPA]).unwrap();
    for trial in study.run_all(7, 0..3, 2).unwrap() {
        let width = trial.values.len() / 3;
        assert_eq!(trial.failures.len(), 1);
        assert_eq!(trial.failures[0].method, 1);
        assert!(trial.failures[0].reason.contains("radar"));
        assert!(trial.values[width..2 * width].iter().all(|v| v.is_nan()));
        assert_eq!(trial.values[..width], trial.values[2 * width..]);
    }
}

/// Stops at the n-th look, or says that every method is at fault.
struct Watch {
    looks: AtomicUsize,
    fault: Option<&'static str>,
}

impl Oversight for Watch {
    fn stopped(&self) -> bool {
        self.looks
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1))
            .is_err()
    }

    fn fault(&self) -> Option<String> {
        self.fault.map(str::to_owned)
    }
}

#[test]
fn a_run_is_stopped_between_scans_and_told_of_faults() {
    let study = Study::new(scans(), vec![named("known", tracker("radar", 3))], vec![OSPA]).unwrap();
    let watch = |looks, fault| Watch {
        looks: AtomicUsize::new(looks),
        fault,
    };
    let steps = study.times().len();
    assert!(study.run_under(&watch(0, None), 7, 0).unwrap().is_none());
    assert!(study.run_under(&watch(steps - 1, None), 7, 0).unwrap().is_none());
    let whole = study.run_under(&watch(steps, None), 7, 0).unwrap().unwrap();
    assert_eq!(bits(&[whole]), bits(&[study.run(7, 0).unwrap()]));
    let faulty = study.run_under(&watch(steps, Some("boom")), 7, 0).unwrap().unwrap();
    assert_eq!(faulty.failures[0].reason, "boom");
    assert!(faulty.values.iter().all(|v| v.is_nan()));
}

#[test]
fn values_are_those_of_a_run_by_hand() {
    let first = 20;
    let metrics = vec![
        StudyMetric::Position { first },
        StudyMetric::Lead {
            lead: Lead::Midpoint,
            first,
        },
    ];
    let study = Study::new(
        angle(),
        vec![named("kalman", Method::Filter(Box::new(filter())))],
        metrics,
    )
    .unwrap();
    let names: Vec<&str> = study.columns().iter().map(|column| column.name).collect();
    assert_eq!(names, ["error", "nees", "nis", "lead_error"]);
    let trial = study.run(7, 3).unwrap();
    let Drawn::Sequence { values, initial, .. } = study.scene().draw(7, 3).unwrap() else {
        panic!("an angle is a sequence");
    };
    let times = study.times();
    let run = filter()
        .run_ahead(
            times,
            &values,
            initial.as_ref(),
            None,
            Some(&Lead::Midpoint),
            History::Full,
        )
        .unwrap();
    for k in 0..times.len() {
        let at = |column: usize| trial.values[column * times.len() + k];
        if k < first {
            assert!((0..4).all(|column| at(column).is_nan()));
            continue;
        }
        let state = run.filtered.at(k);
        // Ten degrees a second; the prediction half a frame ahead.
        let error = state.mean[0] - 10.0 * times[k];
        assert!((at(0) - error).abs() < 1e-12);
        assert!((at(1) - error * error / state.cov[(0, 0)]).abs() < 1e-9);
        assert!((at(2) - run.nis[k]).abs() < 1e-12);
        let ahead = run.leads.at(k).mean[0] - 10.0 * (times[k] + 0.025);
        assert!((at(3) - ahead).abs() < 1e-9);
    }
}

fn place(x: f64) -> DVector<f64> {
    DVector::from_vec(vec![x, 0.0])
}

fn estimate(id: u64, x: f64) -> Estimate {
    Estimate { id, position: place(x) }
}

#[test]
fn known_values_of_one_step() {
    let truth = [Some(place(0.0)), None, Some(place(100.0))];
    // Distances 3 and 4, one track too many: √((9 + 16 + 60²) / 3).
    let found = [estimate(5, 3.0), estimate(6, 104.0), estimate(7, 900.0)];
    let ospa = score_step(&OSPA, &truth, &found).unwrap();
    let total = ((9.0 + 16.0 + 3600.0) / 3.0_f64).sqrt();
    assert!((ospa[0] - total).abs() < 1e-12);
    assert_eq!(
        score_step(&StudyMetric::Cardinality, &truth, &found).unwrap(),
        [3.0, 1.0]
    );

    let truth = [Some(place(0.0)), Some(place(100.0))];
    let identity = |a: f64, b: f64| {
        let metric = StudyMetric::Identity { separation: 50.0 };
        score_step(&metric, &truth, &[estimate(2, b), estimate(1, a)]).unwrap()
    };
    assert_eq!(identity(3.0, 104.0), [12.5_f64.sqrt(), 1.0, 0.0, 0.0]);
    assert_eq!(identity(104.0, 3.0)[1..], [0.0, 0.0, 1.0]);
    assert_eq!(identity(30.0, 70.0)[1..], [0.0, 1.0, 0.0]);
    assert_eq!(identity(10.0, 40.0)[1..], [0.0, 1.0, 0.0]);
    let lost = score_step(&StudyMetric::Identity { separation: 50.0 }, &truth, &[estimate(1, 0.0)]).unwrap();
    assert!(lost[0].is_nan());
    assert_eq!(lost[1..], [0.0, 0.0, 0.0]);
}

#[test]
fn steps_that_do_not_match_are_refused() {
    let truth = vec![vec![Some(place(0.0))]; 2];
    assert!(score_tracks(&[OSPA], &truth, &[vec![]]).is_err());
    let scores = score_tracks(&[OSPA], &truth, &[vec![], vec![estimate(1, 0.0)]]).unwrap();
    assert_eq!(scores, [60.0, 0.0, 0.0, 0.0, 60.0, 0.0]);
}

#[test]
fn reports_of_one_scan_keep_their_times() {
    let scene = Scene::CloseTargets {
        scene: close(),
        scan_size: 7,
    };
    let Drawn::Scans { scans, truth } = scene.draw(7, 0).unwrap() else {
        panic!("targets side by side are seen in scans");
    };
    let sizes: Vec<usize> = scans.iter().map(|scan| scan.values.len()).collect();
    assert_eq!(sizes, [7, 7, 7, 7, 7, 7, 7, 7, 4]);
    assert_eq!(scene.times().last(), Some(&180.0));
    assert_eq!(truth.len(), scans.len());
}
