//! Filters and smoothers of states with an attitude: consistency, free turns, invariance, and what is not observed.

mod draws;

use approx::assert_relative_eq;
use draws::normal;
use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use trackrs::filter::extended::Rule;
use trackrs::filter::lead::Lead;
use trackrs::filter::noise::LimitedMemoryNoise;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::sigma_points::SigmaPoints;
use trackrs::filter::smoother::fixed_interval;
use trackrs::filter::square_root::Form;
use trackrs::metric::consistency::average_band;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk, Singer};
use trackrs::model::sensor::{AttitudeForm, CameraSensor, Intrinsics, PoseSensor};
use trackrs::model::{Motion, MotionModel, Rotation, Sensor, SensorModel, StateSpace};
use trackrs::Gaussian;

fn pose(position: Option<f64>, angle: f64, form: AttitudeForm) -> SensorModel {
    SensorModel::Pose(PoseSensor::new(position.map(|s| [s; 3]), [angle; 3], form).unwrap())
}

fn camera(pixel_std: f64) -> SensorModel {
    let points = [0.1, 0.0, 0.0, -0.1, 0.1, 0.02, 0.0, -0.1, 0.05, -0.1, -0.05, -0.04, 0.05, 0.08, 0.03];
    let intrinsics = Intrinsics::new([1000.0; 2], [640.0, 480.0]).unwrap();
    SensorModel::Camera(CameraSensor::new(DMatrix::from_row_slice(5, 3, &points), intrinsics, pixel_std).unwrap())
}

/// A body whose position and attitude accelerate for a while at a time; 18 states.
fn body() -> MotionModel {
    let std = |a: f64, b: f64| vec![a, a, a, b, b, b];
    MotionModel::Singer(Singer::new(std(0.5, 20.0), std(0.3, 0.3), std(1e-3, 0.1)).unwrap())
}

fn turning(psd: f64) -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![psd; 3])).unwrap())
}

/// Every kind of filter that takes an attitude, with its name.
fn filters(motion: &MotionModel, sensor: &SensorModel) -> Vec<(String, Filter)> {
    let (motion, sensor) = (|| motion.clone(), || sensor.clone());
    let points = |points| Filter::sigma_points(motion(), sensor(), points).unwrap();
    let plain = [
        ("extended", Filter::extended(motion(), sensor()).unwrap()),
        ("unscented", points(SigmaPoints::unscented(1.0))),
        ("cubature", points(SigmaPoints::cubature())),
    ];
    let forms = [(Form::Joseph, ""), (Form::SquareRoot, ", square root")];
    let each = |(name, filter): (&str, Filter)| {
        forms.map(|(form, suffix)| (format!("{name}{suffix}"), filter.clone().with_form(form).unwrap()))
    };
    plain.into_iter().flat_map(each).collect()
}

fn draw(cov: &DMatrix<f64>, rng: &mut Pcg64) -> DVector<f64> {
    let root = nalgebra::Cholesky::new(cov.clone()).unwrap().l();
    root * DVector::from_fn(cov.nrows(), |_, _| normal(rng))
}

/// A measurement of `state` with noise.
fn measured(sensor: &SensorModel, state: &DVector<f64>, rng: &mut Pcg64) -> DVector<f64> {
    let expected = sensor.observe(state, None).unwrap();
    let space = StateSpace {
        dim: expected.len(),
        attitude: sensor.rotation(),
    };
    space.retract(&expected, &draw(&sensor.noise(), rng))
}

struct Recording {
    times: Vec<f64>,
    truth: Vec<DVector<f64>>,
    values: Vec<DVector<f64>>,
    initial: InitialState,
}

/// A motion simulated from a random state of this distribution, and what the sensor reports of it every `dt` seconds.
fn record(filter: &Filter, start: &Gaussian, dt: f64, count: usize, rng: &mut Pcg64) -> Recording {
    let (motion, space) = (filter.motion(), filter.motion().space());
    let mut state = space.retract(&start.mean, &draw(&start.cov, rng));
    let mut out = Recording {
        times: (1..=count).map(|k| k as f64 * dt).collect(),
        truth: Vec::new(),
        values: Vec::new(),
        initial: InitialState {
            time: 0.0,
            state: start.clone(),
        },
    };
    for _ in 0..count {
        let noise = draw(&motion.noise_at(&state, dt), rng);
        state = space.retract(&motion.propagate(&state, dt), &noise);
        out.values.push(measured(filter.sensor(), &state, rng));
        out.truth.push(state.clone());
    }
    out
}

fn nees(space: StateSpace, truth: &DVector<f64>, estimate: &Gaussian) -> f64 {
    let error = space.difference(truth, &estimate.mean);
    let factor = nalgebra::Cholesky::new(estimate.cov.clone()).unwrap();
    error.dot(&factor.solve(&error))
}

fn start_of_body() -> Gaussian {
    let mut mean = DVector::zeros(18);
    mean[2] = 1.5;
    mean[4] = 1.0;
    let std = |i: usize| [0.1, 0.1, 0.1, 0.5, 0.5, 2.0][i / 3];
    Gaussian {
        mean,
        cov: DMatrix::from_fn(18, 18, |i, j| if i == j { std(i) * std(i) } else { 0.0 }),
    }
}

/// Errors by `difference` have the covariance that the filter states: of a body that turns through the half turn, from poses
/// and from image points.
#[test]
fn filters_are_consistent() {
    let runs = 300;
    let band = average_band(18, runs, 0.99).unwrap();
    for (sensor, what) in [
        (pose(Some(2e-3), 0.01, AttitudeForm::Quaternion), "pose"),
        (camera(0.5), "camera"),
    ] {
        for (name, filter) in filters(&body(), &sensor) {
            let space = filter.motion().space();
            let (mut rng, mut sum, mut turned) = (Pcg64::seed_from_u64(5), 0.0, 0.0_f64);
            for _ in 0..runs {
                let data = record(&filter, &start_of_body(), 0.05, 25, &mut rng);
                let run = filter
                    .run(&data.times, &data.values, Some(&data.initial), None, History::Last)
                    .unwrap();
                sum += nees(space, &data.truth[24], &run.filtered.at(0));
                for state in &data.truth {
                    turned = turned.max(state.fixed_rows::<3>(3).norm());
                }
            }
            let mean = sum / runs as f64;
            println!("NEES of 18 states, {what}, {name}: {mean:.2}, band {:.2} to {:.2}", band.lower, band.upper);
            assert!(turned > 3.1, "{turned}");
            assert!((band.lower..band.upper).contains(&mean), "{what}, {name}: {mean}");
        }
    }
}

/// A correction turns the axes that the covariance stands in: without the change of `chart.rs` this is 13.
#[test]
fn large_corrections_turn_the_covariance() {
    let (runs, std) = (4000, [0.3, 0.3, 0.01]);
    let band = average_band(3, runs, 0.99).unwrap();
    let walk = MotionModel::RandomWalk(RandomWalk::new(KinematicNoise::Psd(vec![0.0; 3])).unwrap());
    let start = Gaussian {
        mean: DVector::from_vec(vec![0.3, -2.0, 1.0]),
        cov: DMatrix::from_fn(3, 3, |i, j| if i == j { std[i] * std[i] } else { 0.0 }),
    };
    let filter = Filter::extended(walk, pose(None, 0.05, AttitudeForm::Quaternion)).unwrap();
    let space = filter.motion().space();
    let (mut rng, mut sum, mut without) = (Pcg64::seed_from_u64(8), 0.0, 0.0);
    for _ in 0..runs {
        let truth = space.retract(&start.mean, &draw(&start.cov, &mut rng));
        let z = measured(filter.sensor(), &truth, &mut rng);
        let posterior = filter.update(&start, &z, None).unwrap().posterior;
        sum += nees(space, &truth, &posterior);
        let gain = start.cov.clone() * (&start.cov + filter.sensor().noise()).try_inverse().unwrap();
        let cov = (DMatrix::identity(3, 3) - gain) * &start.cov;
        let mean = posterior.mean;
        without += nees(space, &truth, &Gaussian { mean, cov });
    }
    let (with, without) = (sum / runs as f64, without / runs as f64);
    println!("NEES of one large correction: {with:.2} with the change of chart, {without:.2} without");
    assert!((band.lower..band.upper).contains(&with), "{with} not in {band:?}");
    assert!(without > 2.0 * with, "{without}");
}
