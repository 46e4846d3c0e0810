//! Rows and smoothers of compiled sizes against those of any size, bit for bit: a runner that goes step by step, and a
//! fixed-lag smoother that lags behind by the whole run, take the general path.

use nalgebra::{DMatrix, DVector};
use trackrs::event::EventCode;
use trackrs::filter::extended::Rule;
use trackrs::filter::run::FilterRun;
use trackrs::filter::runner::Runner;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::sigma_points::SigmaPoints;
use trackrs::filter::smoother::{FixedLagSmoother, SmoothedRun, fixed_interval};
use trackrs::gaussian::Gaussians;
use trackrs::linalg::stack::{Repeats, Stack};
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, LinearMotion};
use trackrs::model::sensor::{LinearSensor, PositionSensor, RangeArray, RangeArraySettings, RangeBearing};
use trackrs::model::{Motion, MotionModel, Sensor, SensorModel};
use trackrs::stats::stream::Stream;
use trackrs::{Error, Gaussian};

fn matrix(rows: usize, columns: usize, stream: &mut Stream) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| stream.normal())
}

fn definite(n: usize, scale: f64, stream: &mut Stream) -> DMatrix<f64> {
    let root = matrix(n, n, stream);
    let mut cov = (&root * root.transpose() + DMatrix::identity(n, n)) * scale;
    cov.fill_upper_triangle_with_lower_triangle();
    cov
}

/// F with ones on its diagonal and numbers above some of them, or any.
fn linear_motion(n: usize, upper: bool, scale: f64, stream: &mut Stream) -> MotionModel {
    let f = DMatrix::from_fn(n, n, |i, k| match (k.cmp(&i), (i + k) % 2) {
        (std::cmp::Ordering::Equal, _) => 1.0,
        (std::cmp::Ordering::Greater, 1) => 0.2,
        (std::cmp::Ordering::Less, 1) if !upper => -0.1,
        _ => 0.0,
    });
    MotionModel::Linear(LinearMotion::new(f, definite(n, 0.1 * scale, stream)).unwrap())
}

fn linear_sensor(n: usize, m: usize, dense: bool, scale: f64, stream: &mut Stream) -> SensorModel {
    let mut h = matrix(m, n, stream);
    if !dense {
        h = DMatrix::from_fn(m, n, |i, k| if i == k % m && k < 2 * m { 1.0 } else { 0.0 });
    }
    let r = definite(m, scale, stream);
    SensorModel::Linear(LinearSensor::new(h, r, DVector::from_element(m, 0.3)).unwrap())
}

/// Times with intervals of zero, and a long part at one interval.
fn times(count: usize) -> Vec<f64> {
    let mut time = 0.0;
    (0..count)
        .map(|k| {
            time += if k < count / 2 {
                [1.0, 0.3, 0.0, 2.5][k % 4]
            } else {
                0.5
            };
            time
        })
        .collect()
}

/// Measurements about what is expected of the start, some of their components missing where `gaps` says so.
fn measurements(
    filter: &Filter,
    initial: &InitialState,
    count: usize,
    gaps: bool,
    stream: &mut Stream,
) -> Vec<DVector<f64>> {
    let expected = filter.sensor().observe(&initial.state.mean, None).unwrap();
    (0..count)
        .map(|k| {
            let mut z = expected.map(|x| x + 0.01 * stream.normal());
            if gaps && k % 7 == 3 {
                z[k % expected.len()] = f64::NAN;
            }
            if gaps && k % 11 == 5 {
                z.fill(f64::NAN);
            }
            z
        })
        .collect()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| x.to_bits()).collect()
}

fn stack(a: &Stack, b: &Stack, what: &str) {
    assert_eq!((a.len(), bits(a.values())), (b.len(), bits(b.values())), "{what}");
}

fn gaussians(a: &Gaussians, b: &Gaussians, what: &str) {
    stack(&a.means, &b.means, what);
    stack(&a.covs, &b.covs, what);
}

fn repeats(a: &Repeats, b: &Repeats, what: &str) {
    assert_eq!(a.len(), b.len(), "{what}");
    for (a, b) in a.iter().zip(b.iter()) {
        assert_eq!(bits(a), bits(b), "{what}");
    }
}

/// A run against steps, and its smoother against that which knows no sizes.
fn compare(filter: &Filter, initial: &InitialState, times: &[f64], values: &[DVector<f64>], what: &str) {
    let run = filter.run(times, values, Some(initial), None, History::Full).unwrap();
    let mut steps = FilterRun::of(filter);
    let mut runner = Runner::new(filter, initial).unwrap();
    for (&time, value) in times.iter().zip(values) {
        let epoch = runner.step(time, value.as_slice(), None).unwrap();
        steps.predicted.push(&epoch.prediction.state);
        steps.transitions.push(epoch.prediction.transition());
        steps.motion_noises.push(epoch.prediction.noise());
        steps.filtered.push(epoch.posterior);
        steps.innovations.push(epoch.innovation.as_slice());
        steps.innovation_covs.push(epoch.innovation_cov.as_slice());
        steps.nis.push(if epoch.dof > 0 { epoch.nis } else { f64::NAN });
        steps.dof.push(epoch.dof);
        if epoch.dof > 0 {
            steps.log_likelihood += epoch.log_likelihood;
        }
    }
    gaussians(&run.filtered, &steps.filtered, what);
    gaussians(&run.predicted, &steps.predicted, what);
    repeats(&run.transitions, &steps.transitions, what);
    repeats(&run.motion_noises, &steps.motion_noises, what);
    stack(&run.innovations, &steps.innovations, what);
    stack(&run.innovation_covs, &steps.innovation_covs, what);
    assert_eq!(bits(&run.nis), bits(&steps.nis), "{what}");
    assert_eq!(run.dof, steps.dof, "{what}");
    assert_eq!(run.log_likelihood.to_bits(), steps.log_likelihood.to_bits(), "{what}");

    let last = filter.run(times, values, Some(initial), None, History::Last).unwrap();
    assert_eq!(last.filtered.len(), 1);
    assert_eq!(last.filtered.last(), steps.filtered.last());
    assert_eq!(last.log_likelihood.to_bits(), run.log_likelihood.to_bits());

    let epochs = run.epochs().unwrap();
    match (fixed_interval(&epochs), smoothed(&run)) {
        (Ok(fixed), Ok(general)) => {
            gaussians(&fixed.states, &general.states, what);
            stack(&fixed.lag_one, &general.lag_one, what);
        }
        (fixed, general) => assert_eq!(fixed.unwrap_err().to_string(), general.unwrap_err().to_string()),
    }
}

fn smoothed(run: &FilterRun) -> Result<SmoothedRun, Error> {
    let epochs = run.epochs()?;
    let mut lagging = FixedLagSmoother::new(epochs.len())?;
    // The error of the last epoch that has one, as a smoother that comes from the end finds it.
    let mut failed = None;
    for epoch in &epochs {
        failed = lagging.push(epoch).err().or(failed);
    }
    failed.map_or_else(|| Ok(lagging.tail()), Err)
}

fn start(n: usize, scale: f64, stream: &mut Stream) -> InitialState {
    let mean = DVector::from_fn(n, |_, _| scale.sqrt() * stream.normal());
    InitialState {
        time: 0.0,
        state: Gaussian::new(mean, definite(n, 10.0 * scale, stream)).unwrap(),
    }
}

#[test]
fn linear_models_of_every_size() {
    for (n, m) in [
        (2, 1),
        (2, 2),
        (3, 1),
        (3, 2),
        (3, 3),
        (4, 1),
        (4, 2),
        (4, 3),
        (5, 2),
        (6, 2),
        (6, 3),
        (6, 4),
        (9, 3),
        (9, 4),
        (18, 6),
    ] {
        for (upper, dense, gaps, scale) in [
            (true, false, false, 1.0),
            (false, true, false, 1.0),
            (true, true, true, 1.0),
            (false, false, true, 1e-12),
            (true, false, true, 1e12),
        ] {
            let mut stream = Stream::new(7, (100 * n + m) as u64);
            let motion = linear_motion(n, upper, scale, &mut stream);
            let sensor = linear_sensor(n, m, dense, scale, &mut stream);
            let filter = Filter::kalman(motion, sensor).unwrap();
            let initial = start(n, scale, &mut stream);
            let times = times(120);
            let values = measurements(&filter, &initial, 120, gaps, &mut stream);
            compare(
                &filter,
                &initial,
                &times,
                &values,
                &format!("{n}/{m} {upper} {dense} {gaps} {scale}"),
            );
        }
    }
}

#[test]
fn kinematic_motions_and_sensors_that_are_not_linear() {
    let psd = |dims: usize| KinematicNoise::Psd(vec![0.3; dims]);
    let hydrophones = DMatrix::from_row_slice(3, 3, &[0.0, 0.0, 250.0, 1000.0, 0.0, 252.0, 500.0, 866.0, 248.0]);
    let ranges = RangeArray::new(RangeArraySettings {
        hydrophones,
        range_std: vec![1.0],
        survey_std: Vec::new(),
        depth_std: Some(0.5),
        sound_speed: None,
        side: None,
    });
    let velocity = |dims: usize| MotionModel::ConstantVelocity(ConstantVelocity::new(psd(dims)).unwrap());
    let acceleration = |dims: usize| MotionModel::ConstantAcceleration(ConstantAcceleration::new(psd(dims)).unwrap());
    let bearing = RangeBearing::new([-500.0, -900.0], 5.0, 0.01).unwrap();
    let positions = |dims: usize| SensorModel::Position(PositionSensor::new(vec![1.5; dims]).unwrap());
    let ranges = SensorModel::RangeArray(ranges.unwrap());
    let bearing = SensorModel::RangeBearing(bearing);
    let points = SigmaPoints::unscented(0.0);
    let filters = [
        Filter::kalman(velocity(1), positions(1)),
        Filter::kalman(velocity(2), positions(2)),
        Filter::kalman(acceleration(2), positions(2)),
        Filter::kalman(velocity(3), positions(3)),
        Filter::sigma_points(acceleration(3), positions(3), points),
        Filter::extended(velocity(3), ranges.clone()),
        Filter::extended(acceleration(3), ranges.clone()),
        Filter::extended(acceleration(3), ranges.clone()).and_then(|filter| filter.with_iterations(1)),
        // Not plain: they keep to the general path.
        Filter::extended(acceleration(3), ranges.clone()).and_then(|filter| filter.with_iterations(3)),
        Filter::sigma_points(velocity(3), ranges, points),
        Filter::extended(velocity(2), bearing),
    ];
    for (index, filter) in filters.into_iter().enumerate() {
        let filter = filter.unwrap();
        assert_ne!(filter.method().rule, Rule::SecondOrder);
        for gaps in [false, true] {
            let mut stream = Stream::new(11, index as u64);
            let initial = start(filter.motion().state_dim(), 1.0, &mut stream);
            let times = times(150);
            let values = measurements(&filter, &initial, 150, gaps, &mut stream);
            compare(&filter, &initial, &times, &values, &format!("filter {index} {gaps}"));
        }
    }
}

#[test]
fn a_steady_state_is_left_when_something_changes() {
    let motion = MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![0.3; 3])).unwrap());
    let sensor = SensorModel::Position(PositionSensor::new(vec![1.3; 3]).unwrap());
    let filter = Filter::kalman(motion, sensor).unwrap();
    let mut stream = Stream::new(3, 0);
    let initial = InitialState {
        time: 0.0,
        state: Gaussian::new(DVector::zeros(6), DMatrix::identity(6, 6) * 10.0).unwrap(),
    };
    let mut values = measurements(&filter, &initial, 400, false, &mut stream);
    let mut times: Vec<f64> = (1..=400).map(f64::from).collect();
    times.iter_mut().skip(200).for_each(|time| *time += 0.5);
    values[300][1] = f64::NAN;
    compare(&filter, &initial, &times, &values, "steady");
    let run = filter
        .run(&times, &values, Some(&initial), None, History::Filtered)
        .unwrap();
    // It is steady to the last bit before each change and at the end, and what follows a change is not.
    for (row, steady) in [(199, true), (200, false), (299, true), (300, false), (399, true)] {
        assert_eq!(
            run.filtered.covs.at(row) == run.filtered.covs.at(row - 1),
            steady,
            "row {row}"
        );
    }
}

/// A long gap leaves the position next to nothing of its own: from there on the run goes on as square roots, on either path.
#[test]
fn an_escalation_is_that_of_any_size() {
    let noise = KinematicNoise::Psd(vec![1e-40; 2]);
    let motion = MotionModel::ConstantVelocity(ConstantVelocity::new(noise).unwrap());
    let sensor = SensorModel::Position(PositionSensor::new(vec![1e-5; 2]).unwrap());
    let filter = Filter::kalman(motion, sensor).unwrap();
    let initial = InitialState {
        time: 0.0,
        state: Gaussian::new(DVector::zeros(4), DMatrix::identity(4, 4)).unwrap(),
    };
    let times: Vec<f64> = (1..=20)
        .map(f64::from)
        .chain((0..20).map(|k| 1e9 + f64::from(k)))
        .collect();
    let values = vec![DVector::zeros(2); 40];
    compare(&filter, &initial, &times, &values, "escalated");
    let run = filter
        .run(&times, &values, Some(&initial), None, History::Last)
        .unwrap();
    let events: Vec<_> = run.books.events.recent().map(|event| (event.code, event.row)).collect();
    assert_eq!(events, [(EventCode::Escalated, Some(20))]);
    assert_eq!(run.books.ledger.used, 40);
}

#[test]
fn failures_are_those_of_any_size() {
    let n = 4;
    let mut stream = Stream::new(5, 0);
    let motion = linear_motion(n, true, 1.0, &mut stream);
    let h = DMatrix::from_fn(2, n, |_, k| if k == 0 { 1.0 } else { 0.0 });
    let sensor = LinearSensor::new(h, DMatrix::zeros(2, 2), DVector::zeros(2)).unwrap();
    let filter = Filter::kalman(motion, SensorModel::Linear(sensor)).unwrap();
    let initial = start(n, 1.0, &mut stream);
    for value in [[0.0, 0.0], [f64::INFINITY, 0.0]] {
        let value = DVector::from_column_slice(&value);
        let run = filter.run(
            &[1.0],
            std::slice::from_ref(&value),
            Some(&initial),
            None,
            History::Full,
        );
        let mut runner = Runner::new(&filter, &initial).unwrap();
        let step = runner.step(1.0, value.as_slice(), None);
        let (run, step) = (run.unwrap_err(), step.unwrap_err());
        assert_eq!(run.to_string(), step.to_string());
        assert!(matches!(
            run,
            Error::NotPositiveDefinite { .. } | Error::NonFinite { .. }
        ));
    }
    // A prediction from nothing cannot be smoothed: the same error, which names the step.
    let still = LinearMotion::new(DMatrix::identity(2, 2) * 0.5, DMatrix::zeros(2, 2)).unwrap();
    let sensor = PositionSensor::new(vec![1.0; 2]).unwrap();
    let filter = Filter::kalman(MotionModel::Linear(still), SensorModel::Position(sensor)).unwrap();
    let initial = InitialState {
        time: 0.0,
        state: Gaussian::new(DVector::zeros(2), DMatrix::zeros(2, 2)).unwrap(),
    };
    let values = vec![DVector::zeros(2); 5];
    compare(&filter, &initial, &[1.0, 2.0, 2.0, 3.0, 4.0], &values, "singular");
}
