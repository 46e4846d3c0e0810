//! Bodies that turn, the sensors that see them, and simulated recordings.

use nalgebra::{DMatrix, DVector};
use rand_pcg::Pcg64;
use trackrs::Gaussian;
use trackrs::filter::sequence::{Filter, InitialState};
use trackrs::filter::sigma_points::SigmaPoints;
use trackrs::filter::square_root::Form;
use trackrs::model::motion::Singer;
use trackrs::model::sensor::{AttitudeForm, CameraSensor, Intrinsics, PoseSensor};
use trackrs::model::{Motion, MotionModel, Sensor, SensorModel, StateSpace};

use crate::draws::normal;

pub(crate) fn pose(position: Option<f64>, angle: f64, form: AttitudeForm) -> SensorModel {
    SensorModel::Pose(PoseSensor::new(position.map(|s| [s; 3]), [angle; 3], form).unwrap())
}

pub(crate) fn camera(pixel_std: f64) -> SensorModel {
    let points = [
        0.1, 0.0, 0.0, -0.1, 0.1, 0.02, 0.0, -0.1, 0.05, -0.1, -0.05, -0.04, 0.05, 0.08, 0.03,
    ];
    let intrinsics = Intrinsics::new([1000.0; 2], [640.0, 480.0]).unwrap();
    SensorModel::Camera(CameraSensor::new(DMatrix::from_row_slice(5, 3, &points), intrinsics, pixel_std).unwrap())
}

/// A body whose position and attitude accelerate for a while at a time; 18 states.
pub(crate) fn body() -> MotionModel {
    let std = |a: f64, b: f64| vec![a, a, a, b, b, b];
    MotionModel::Singer(Singer::new(std(0.5, 20.0), std(0.3, 0.3), std(1e-3, 0.1)).unwrap())
}

/// Every kind of filter that takes an attitude, with its name.
pub(crate) fn filters(motion: &MotionModel, sensor: &SensorModel) -> Vec<(String, Filter)> {
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

pub(crate) fn draw(cov: &DMatrix<f64>, rng: &mut Pcg64) -> DVector<f64> {
    let root = nalgebra::Cholesky::new(cov.clone()).unwrap().l();
    root * DVector::from_fn(cov.nrows(), |_, _| normal(rng))
}

/// A measurement of `state` with noise.
pub(crate) fn measured(sensor: &SensorModel, state: &DVector<f64>, rng: &mut Pcg64) -> DVector<f64> {
    let expected = sensor.observe(state, None).unwrap();
    let space = StateSpace {
        dim: expected.len(),
        attitude: sensor.rotation(),
    };
    space.retract(&expected, &draw(&sensor.noise(), rng))
}

pub(crate) struct Recording {
    pub(crate) times: Vec<f64>,
    pub(crate) truth: Vec<DVector<f64>>,
    pub(crate) values: Vec<DVector<f64>>,
    pub(crate) initial: InitialState,
}

/// A motion simulated from a random state of this distribution, and what the sensor reports of it every `dt` seconds.
pub(crate) fn record(filter: &Filter, start: &Gaussian, dt: f64, count: usize, rng: &mut Pcg64) -> Recording {
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

pub(crate) fn nees(space: StateSpace, truth: &DVector<f64>, estimate: &Gaussian) -> f64 {
    let error = space.difference(truth, &estimate.mean);
    let factor = nalgebra::Cholesky::new(estimate.cov.clone()).unwrap();
    error.dot(&factor.solve(&error))
}

pub(crate) fn start_of_body() -> Gaussian {
    let mut mean = DVector::zeros(18);
    mean[2] = 1.5;
    mean[4] = 1.0;
    let std = |i: usize| [0.1, 0.1, 0.1, 0.5, 0.5, 2.0][i / 3];
    Gaussian {
        mean,
        cov: DMatrix::from_fn(18, 18, |i, j| if i == j { std(i) * std(i) } else { 0.0 }),
    }
}
