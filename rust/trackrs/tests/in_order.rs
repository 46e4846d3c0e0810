//! Scans that come in any order give what they give in order, bit for bit; clocks that jump are survived; no row is lost.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trackrs::event::EventCode;
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{MotionModel, SensorModel};
use trackrs::rfs::prediction::Birth;
use trackrs::state::to_bytes;
use trackrs::tracker::clutter_map::ClutterMap;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::engine::Engine;
use trackrs::tracker::in_order::{InOrder, Late};
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::tracker::phd::PhdTracker;
use trackrs::tracker::phd::config::{PhdConfig, Watch};
use trackrs::{Error, Gaussian, Scan, Track};

const WINDOW: f64 = 3.0;

fn motion() -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![0.5; 2])).unwrap())
}

fn position(std: f64) -> SensorModel {
    SensorModel::Position(PositionSensor::new(vec![std; 2]).unwrap())
}

fn config() -> TrackerConfig {
    let sensors = BTreeMap::from([
        ("lidar".to_string(), position(0.5)),
        ("radar".to_string(), position(2.0)),
    ]);
    let mut config = TrackerConfig::new(motion(), sensors, 20.0).unwrap();
    config.clutter_map = Some(ClutterMap {
        radius: 5.0,
        dwell: 4.0,
        min_reports: 3,
        memory: 10.0,
    });
    config.max_gap = Some(20.0);
    config
}

fn points() -> MultiTargetTracker {
    MultiTargetTracker::new(config()).unwrap()
}

fn intensity() -> PhdTracker {
    let birth = Birth {
        weight: 0.1,
        state: Gaussian::new(DVector::zeros(4), DMatrix::identity(4, 4) * 400.0).unwrap(),
    };
    let mut config = PhdConfig::new(motion(), position(2.0), vec![birth], 1.0, 1e-4);
    let watch = |std| Watch {
        sensor: position(std),
        detection_probability: 0.9,
        clutter_density: 1e-4,
    };
    config.watches = BTreeMap::from([("lidar".into(), watch(0.5)), ("radar".into(), watch(2.0))]);
    PhdTracker::new(config).unwrap()
}

/// Two targets, an echo, clutter, rows that are refused, scans that are refused, scans twice, several at one time.
fn scans(rng: &mut Pcg64, count: usize) -> Vec<Scan> {
    let mut out: Vec<Scan> = Vec::new();
    let mut time = 100.0;
    for _ in 0..count {
        time += [0.0, 0.25, 0.5, 1.0][rng.random_range(0..4)];
        let mut values = vec![vec![3.0, 40.0]];
        for target in [[2.0, 1.0], [-1.0, 2.0]] {
            if rng.random_range(0..10) > 0 {
                let at = |v: f64, rng: &mut Pcg64| v * (time - 100.0) + rng.random_range(-1.0..1.0);
                values.push(vec![at(target[0], rng), at(target[1], rng)]);
            }
        }
        match rng.random_range(0..8) {
            0 => values.push(vec![f64::NAN, f64::NAN]),
            1 => values.push(vec![f64::INFINITY, 0.0]),
            2 => values.push(values[0].clone()),
            3 => values.push(vec![rng.random_range(-50.0..50.0), rng.random_range(-50.0..50.0)]),
            4 => values.clear(),
            _ => {}
        }
        let sensor = ["lidar", "radar", "radar", "lidar", "sonar"][rng.random_range(0..5).min(rng.random_range(0..5))];
        let values = values.into_iter().map(DVector::from_vec).collect();
        let scan = Scan::new(time, sensor, values);
        if rng.random_range(0..6) == 0 {
            out.push(scan.clone());
        }
        out.push(scan);
    }
    out
}

/// In an order in which none comes more than the window behind another.
fn shuffled(scans: &[Scan], rng: &mut Pcg64) -> Vec<Scan> {
    let mut keyed: Vec<(f64, u64, &Scan)> = scans
        .iter()
        .map(|scan| (scan.time + rng.random_range(0.0..WINDOW), rng.next_u64(), scan))
        .collect();
    keyed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    keyed.into_iter().map(|(_, _, scan)| scan.clone()).collect()
}

fn ordered(scans: &[Scan]) -> Vec<Scan> {
    let bits = |scan: &Scan| -> Vec<u64> { scan.values.iter().flatten().map(|v| v.to_bits()).collect() };
    let mut scans = scans.to_vec();
    scans.sort_by(|a, b| {
        let times = a.time.total_cmp(&b.time).then_with(|| a.sensor.cmp(&b.sensor));
        let rows = times.then_with(|| a.values.len().cmp(&b.values.len()));
        rows.then_with(|| bits(a).cmp(&bits(b)))
    });
    scans
}

trait Reports: Engine {
    fn found(&self) -> Vec<Track>;
}

impl Reports for MultiTargetTracker {
    fn found(&self) -> Vec<Track> {
        self.tracks()
    }
}

impl Reports for PhdTracker {
    fn found(&self) -> Vec<Track> {
        self.tracks().to_vec()
    }
}

/// The tracks after every scan in order, by the tracker alone; scans that have no place give none.
fn oracle<T: Reports>(mut tracker: T, scans: &[Scan]) -> (T, Vec<Vec<Track>>) {
    let mut found = Vec::new();
    for scan in ordered(scans) {
        tracker.update(&scan).unwrap();
        if tracker.has_a_place_for(&scan) {
            found.push(tracker.found());
        }
    }
    (tracker, found)
}

/// Whether both hold the same: state bit for bit, rows, events.
fn assert_same<T: Reports>(stream: &InOrder<T>, tracker: &T) {
    assert_eq!(
        to_bytes(&stream.tracker().state()).unwrap(),
        to_bytes(&tracker.state()).unwrap()
    );
    assert_eq!(stream.ledger(), *tracker.ledger());
    assert_eq!(stream.events().counts(), tracker.events().counts());
    stream.ledger().check().unwrap();
}

/// Saves and reads back.
fn saved<T: Reports>(stream: &InOrder<T>) -> InOrder<T> {
    let bytes = stream.to_bytes().unwrap();
    let back = InOrder::from_bytes(&bytes).unwrap();
    assert_eq!(back.to_bytes().unwrap(), bytes);
    back
}

fn any_order_is_the_order<T: Reports>(tracker: &T, seed: u64, count: usize) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let scans = shuffled(&scans(&mut rng, count), &mut rng);
    let (oracle_tracker, expected) = oracle(tracker.clone(), &scans);

    // Reorder: in pieces, saved on the way.
    let mut stream = InOrder::new(tracker.clone(), Late::Reorder { window: WINDOW }).unwrap();
    let mut found = Vec::new();
    for scan in &scans {
        stream.step(scan, |tracker, _| found.push(tracker.found())).unwrap();
        stream.ledger().check().unwrap();
        if rng.random_range(0..5) == 0 {
            stream = saved(&stream);
        }
    }
    stream.flush(|tracker, _| found.push(tracker.found())).unwrap();
    assert_eq!(found, expected);
    assert_same(&stream, &oracle_tracker);

    // Replay: after every step as if the scans so far had come in order.
    let mut stream = InOrder::new(tracker.clone(), Late::Replay { window: WINDOW }).unwrap();
    for (k, scan) in scans.iter().enumerate() {
        let mut last = Vec::new();
        stream.step(scan, |tracker, _| last.push(tracker.found())).unwrap();
        let (sorted, _) = oracle(tracker.clone(), &scans[..=k]);
        assert_same(&stream, &sorted);
        assert_eq!(last, [sorted.found()]);
        if rng.random_range(0..5) == 0 {
            stream = saved(&stream);
        }
    }

    // All at once, from where a stream stands.
    for late in [Late::Reorder { window: WINDOW }, Late::Replay { window: WINDOW }] {
        let mut stream = InOrder::new(tracker.clone(), late).unwrap();
        let mut found = Vec::new();
        for scan in &scans {
            stream.queue(scan, |tracker, _| found.push(tracker.found())).unwrap();
        }
        stream.flush(|tracker, _| found.push(tracker.found())).unwrap();
        assert_eq!(found, expected);
        assert_same(&stream, &oracle_tracker);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn any_order_within_the_window_is_the_order_of_time(seed: u64, count in 1_usize..45) {
        any_order_is_the_order(&points(), seed, count);
    }

    #[test]
    fn the_same_by_intensity(seed: u64, count in 1_usize..25) {
        any_order_is_the_order(&intensity(), seed, count);
    }

    /// What comes later than the window is dropped and counted, and nothing else.
    #[test]
    fn beyond_the_window_every_row_is_late(seed: u64, count in 1_usize..40) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut scans = shuffled(&scans(&mut rng, count), &mut rng);
        for _ in 0..count / 3 {
            let (from, to) = (rng.random_range(0..scans.len()), rng.random_range(0..scans.len()));
            scans.swap(from, to);
        }
        scans.retain(|scan| scan.sensor != "sonar");
        let (mut newest, mut late, mut kept) = (f64::NEG_INFINITY, 0, Vec::new());
        for scan in &scans {
            if scan.time < newest - WINDOW {
                late += scan.values.len() as u64;
            } else {
                newest = scan.time.max(newest);
                kept.push(scan.clone());
            }
        }
        // Long gaps make trials of scans; here there shall be none.
        let mut config = config();
        config.max_gap = Some(1e3);
        let tracker = MultiTargetTracker::new(config).unwrap();
        let (sorted, _) = oracle(tracker.clone(), &kept);
        for kind in [Late::Reorder { window: WINDOW }, Late::Replay { window: WINDOW }] {
            let mut stream = InOrder::new(tracker.clone(), kind).unwrap();
            for scan in &scans {
                stream.step(scan, |_, _| ()).unwrap();
                stream.ledger().check().unwrap();
            }
            stream.flush(|_, _| ()).unwrap();
            let mut ledger = stream.ledger();
            prop_assert_eq!(ledger.late, late);
            ledger.late = 0;
            ledger.rows_in -= late;
            prop_assert_eq!(&ledger, sorted.ledger());
            prop_assert_eq!(to_bytes(&stream.tracker().state()).unwrap(), to_bytes(&sorted.state()).unwrap());
        }
    }

    /// One wrong stamp anywhere changes nothing but the books, in each way of treating late scans.
    #[test]
    fn one_stamp_from_the_future_is_taken_back(seed: u64, ahead in prop_oneof![Just(86_400.0), Just(1e300), 30.0..1e9]) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let good: Vec<Scan> = (0..40).map(|k| two_targets(100.0 + f64::from(k), &mut rng)).collect();
        let at = rng.random_range(1..39);
        let mut wrong = two_targets(0.0, &mut rng);
        wrong.time = good[at - 1].time + ahead;
        let mut given = good.clone();
        given.insert(at, wrong.clone());
        let (sorted, _) = oracle(points(), &good);
        for late in [Late::Drop, Late::Reorder { window: WINDOW }, Late::Replay { window: WINDOW }] {
            let mut stream = InOrder::new(points(), late).unwrap();
            for scan in &given {
                stream.step(scan, |_, _| ()).unwrap();
                stream = saved(&stream);
                stream.ledger().check().unwrap();
            }
            stream.flush(|_, _| ()).unwrap();
            prop_assert_eq!(to_bytes(&stream.tracker().state()).unwrap(), to_bytes(&sorted.state()).unwrap());
            let events = stream.events();
            let mut expected = sorted.events().counts().clone();
            expected.insert(EventCode::FutureScan, 1);
            prop_assert_eq!(events.counts(), &expected);
            let ledger = stream.ledger();
            prop_assert_eq!(ledger.rejected[&EventCode::FutureScan], wrong.values.len() as u64);
            prop_assert_eq!(ledger.used, sorted.ledger().used);
        }
    }
}

fn two_targets(time: f64, rng: &mut Pcg64) -> Scan {
    let noise = |rng: &mut Pcg64| rng.random_range(-0.5..0.5);
    let values = [[2.0, 1.0], [-1.0, 2.0]].map(|v| {
        let s = time - 100.0;
        DVector::from_vec(vec![v[0] * s + noise(rng), v[1] * s + noise(rng)])
    });
    Scan::new(time, "lidar", values.to_vec())
}

/// A clock that is set, by any amount, costs five scans at most; then there are tracks again.
#[test]
fn a_clock_that_is_set_is_followed() {
    for late in [
        Late::Drop,
        Late::Reorder { window: WINDOW },
        Late::Replay { window: WINDOW },
    ] {
        for shift in [-100.0, -3600.0, -1.7e9, 86_400.0, 1e15] {
            let mut rng = Pcg64::seed_from_u64(3);
            let mut stream = InOrder::new(points(), late).unwrap();
            for k in 0..60 {
                let mut scan = two_targets(100.0 + f64::from(k), &mut rng);
                scan.time += if k < 30 { 0.0 } else { shift };
                stream.step(&scan, |_, _| ()).unwrap();
                stream.ledger().check().unwrap();
            }
            stream.flush(|_, _| ()).unwrap();
            let ledger = stream.ledger();
            let dropped = if shift < 0.0 { 8 } else { 0 };
            assert_eq!((ledger.late, ledger.used), (dropped, 120 - dropped), "{late:?} {shift}");
            let tracks = stream.tracker().tracks();
            assert_eq!(tracks.len(), 2);
            assert_eq!(tracks[0].time, 159.0 + shift);
            let code = if shift < 0.0 {
                EventCode::ClockSetBack
            } else {
                EventCode::GapReset
            };
            assert_eq!(stream.events().counts()[&code], 1);
        }
    }
}

/// A stamp of the epoch's beginning, two that agree on a wrong future, and a burst of one sensor's old scans.
#[test]
fn other_jumps_of_clocks() {
    let mut rng = Pcg64::seed_from_u64(5);
    let mut stream = InOrder::new(points(), Late::Drop).unwrap();
    // The first stamp of all is zero, then the clock is set.
    let times = [0.0].into_iter().chain((0..20).map(|k| 1.7e9 + f64::from(k)));
    for time in times {
        let mut scan = two_targets(100.0, &mut rng);
        scan.time = time;
        stream.step(&scan, |_, _| ()).unwrap();
    }
    assert_eq!(stream.ledger().late, 0);
    // One zero among the others.
    let mut scan = two_targets(100.0, &mut rng);
    scan.time = 0.0;
    stream.step(&scan, |_, _| ()).unwrap();
    assert_eq!((stream.ledger().late, stream.tracker().time()), (2, Some(1.7e9 + 19.0)));

    // Two in a row are believed; the way back takes five scans.
    let mut stream = InOrder::new(points(), Late::Drop).unwrap();
    for time in (0..10)
        .map(f64::from)
        .chain([1e300, 1e301])
        .chain((10..30).map(f64::from))
    {
        let mut scan = two_targets(100.0 + time.min(1e3), &mut rng);
        scan.time = time;
        stream.step(&scan, |_, _| ()).unwrap();
    }
    assert_eq!((stream.ledger().late, stream.tracker().time()), (8, Some(29.0)));

    // The radar sends what it had kept while the lidar goes on: no reason to start anew.
    let mut stream = InOrder::new(points(), Late::Drop).unwrap();
    for k in 0..20 {
        stream
            .step(&two_targets(100.0 + f64::from(k), &mut rng), |_, _| ())
            .unwrap();
    }
    let state = to_bytes(&stream.tracker().state()).unwrap();
    for k in 0..20 {
        let mut old = two_targets(50.0 + f64::from(k), &mut rng);
        old.sensor = "radar".into();
        stream.step(&old, |_, _| ()).unwrap();
    }
    assert_eq!(stream.ledger().late, 40);
    assert_eq!(to_bytes(&stream.tracker().state()).unwrap(), state);
}

/// Memory is that of the window: what is kept does not grow with the run.
#[test]
fn what_is_kept_is_bounded_by_the_window() {
    for late in [Late::Reorder { window: WINDOW }, Late::Replay { window: WINDOW }] {
        let mut rng = Pcg64::seed_from_u64(9);
        let mut stream = InOrder::new(points(), late).unwrap();
        let mut sizes = Vec::new();
        for k in 0..400 {
            stream
                .step(&two_targets(100.0 + f64::from(k), &mut rng), |_, _| ())
                .unwrap();
            sizes.push(stream.to_bytes().unwrap().len());
        }
        let most = |sizes: &[usize]| sizes.iter().copied().max().unwrap();
        assert!(most(&sizes[300..]) < most(&sizes[100..200]) + 200, "{late:?}");
    }
}

/// In strict mode the first event is an error, and a scan that makes one leaves everything as it was.
#[test]
fn strict_mode_takes_the_culprit_out_again() {
    let mut config = config();
    config.strict = true;
    let mut rng = Pcg64::seed_from_u64(1);
    let mut stream = InOrder::new(
        MultiTargetTracker::new(config).unwrap(),
        Late::Replay { window: WINDOW },
    )
    .unwrap();
    for k in 0..20 {
        stream
            .step(&two_targets(100.0 + f64::from(k), &mut rng), |_, _| ())
            .unwrap();
    }
    let before = to_bytes(&stream.tracker().state()).unwrap();
    let bad = Scan::new(117.5, "lidar", vec![DVector::from_vec(vec![f64::INFINITY, 0.0])]);
    assert!(matches!(stream.step(&bad, |_, _| ()), Err(Error::Strict { .. })));
    assert_eq!(to_bytes(&stream.tracker().state()).unwrap(), before);
    let old = two_targets(110.0, &mut rng);
    assert!(matches!(stream.step(&old, |_, _| ()), Err(Error::Strict { .. })));
    assert_eq!(to_bytes(&stream.tracker().state()).unwrap(), before);
}

#[test]
fn bytes_of_a_tracker_alone_are_read_too() {
    let mut rng = Pcg64::seed_from_u64(2);
    let mut tracker = points();
    for k in 0..20 {
        tracker.step(&two_targets(100.0 + f64::from(k), &mut rng)).unwrap();
    }
    let mut stream = InOrder::<MultiTargetTracker>::from_bytes(&tracker.to_bytes().unwrap()).unwrap();
    for k in 20..40 {
        let scan = two_targets(100.0 + f64::from(k), &mut rng);
        tracker.step(&scan).unwrap();
        stream.step(&scan, |_, _| ()).unwrap();
    }
    assert_same(&stream, &tracker);
}

#[test]
fn bytes_that_pass_the_checksum_are_still_checked() {
    let mut rng = Pcg64::seed_from_u64(7);
    let mut stream = InOrder::new(points(), Late::Replay { window: WINDOW }).unwrap();
    for k in 0..4 {
        stream
            .step(&two_targets(100.0 + f64::from(k), &mut rng), |_, _| ())
            .unwrap();
    }
    let bytes = stream.to_bytes().unwrap();
    let mut refused = 0;
    for _ in 0..5_000 {
        let mut altered = bytes.clone();
        let body = altered.len() - 4;
        for _ in 0..rng.random_range(1..4) {
            altered[rng.random_range(8..body)] = rng.random();
        }
        let checksum = crc32fast::hash(&altered[..body]).to_le_bytes();
        altered[body..].copy_from_slice(&checksum);
        match InOrder::<MultiTargetTracker>::from_bytes(&altered) {
            Err(Error::CorruptState { .. }) => refused += 1,
            Err(other) => panic!("{other}"),
            // A changed number can be a valid one; what it gives must work.
            Ok(mut stream) => {
                for time in [102.5, 104.0] {
                    drop(stream.step(&two_targets(time, &mut rng), |_, _| ()));
                }
            }
        }
    }
    assert!(refused > 1_000, "{refused}");
}

#[test]
fn windows_are_lengths_of_time() {
    for window in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(InOrder::new(points(), Late::Reorder { window }).is_err());
    }
}
