//! Single steps of filters with an attitude: known inputs, steps of a prediction, iterated corrections, carried points.

use crate::draws::normal;
use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use trackrs::Gaussian;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::sigma_points::SigmaPoints;
use trackrs::filter::square_root::Form;
use trackrs::metric::consistency::average_band;
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::{AttitudeForm, CameraSensor, Intrinsics, PoseSensor, residual};
use trackrs::model::{Motion, MotionModel, Rotation, Sensor, SensorModel};

fn turning(psd: f64) -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![psd; 3])).unwrap())
}

fn quaternion(std: f64) -> SensorModel {
    SensorModel::Pose(PoseSensor::new(None, [std; 3], AttitudeForm::Quaternion).unwrap())
}

fn draw(cov: &DMatrix<f64>, rng: &mut Pcg64) -> DVector<f64> {
    let root = nalgebra::Cholesky::new(cov.clone()).unwrap().l();
    root * DVector::from_fn(cov.nrows(), |_, _| normal(rng))
}

fn start() -> Gaussian {
    let std = [0.05, 0.2, 0.1, 0.3, 0.1, 0.5];
    Gaussian {
        mean: DVector::from_vec(vec![1.0, -2.0, 0.5, 2.0, 1.0, -3.0]),
        cov: DMatrix::from_fn(6, 6, |i, j| if i == j { std[i] * std[i] } else { 0.0 }),
    }
}

fn all(sensor: &SensorModel) -> Vec<(&'static str, Filter)> {
    let points = |points| Filter::sigma_points(turning(0.2), sensor.clone(), points).unwrap();
    let extended = Filter::extended(turning(0.2), sensor.clone()).unwrap();
    let unscented = points(SigmaPoints::unscented(0.0));
    vec![
        ("extended root", extended.clone().with_form(Form::SquareRoot).unwrap()),
        ("unscented root", unscented.clone().with_form(Form::SquareRoot).unwrap()),
        ("three steps", unscented.clone().with_steps(3).unwrap()),
        ("extended", extended),
        ("unscented", unscented),
        ("carried", points(SigmaPoints::unscented(0.0).carried())),
    ]
}

/// A body that is turned by a known angle on top of its own motion: the errors turn with it.
#[test]
fn known_turns_move_mean_and_covariance() {
    let (runs, dt, turn) = (400, 0.05, Vector3::new(0.9, -0.4, 0.7));
    let band = average_band(6, runs, 0.99).unwrap();
    let input = DVector::from_iterator(6, turn.iter().copied().chain([0.1, 0.0, -0.2]));
    for (name, filter) in all(&quaternion(0.02)) {
        let space = filter.motion().space();
        let (mut rng, mut sum) = (Pcg64::seed_from_u64(3), 0.0);
        for _ in 0..runs {
            let mut state = space.retract(&start().mean, &draw(&start().cov, &mut rng));
            let (mut times, mut values) = (Vec::new(), Vec::new());
            for k in 1..=4 {
                let noise = draw(&filter.motion().noise_at(&state, dt), &mut rng);
                state = space.retract(&space.retract(&filter.motion().propagate(&state, dt), &noise), &input);
                times.push(dt * f64::from(k));
                // The last is a prediction only, so that the turn of its covariance shows.
                let error = DVector::from_fn(3, |_, _| 0.02 * normal(&mut rng));
                let seen = space
                    .retract(&state, &error.insert_rows(3, 3, 0.0))
                    .rows(0, 3)
                    .into_owned();
                values.push(if k < 4 {
                    seen
                } else {
                    DVector::from_element(3, f64::NAN)
                });
            }
            let initial = InitialState {
                time: 0.0,
                state: start(),
            };
            let inputs = vec![input.clone(); 4];
            let run = filter
                .run(&times, &values, Some(&initial), Some(&inputs), History::Full)
                .unwrap();
            let last = run.filtered.at(3);
            let error = space.difference(&state, &last.mean);
            sum += error.dot(&nalgebra::Cholesky::new(last.cov).unwrap().solve(&error));
        }
        let mean = sum / runs as f64;
        assert!((band.lower..band.upper).contains(&mean), "{name}: {mean}");
    }
    let filter = Filter::extended(turning(0.2), quaternion(0.02)).unwrap();
    let moved = filter.predict(&start(), 0.0, Some(&input)).unwrap();
    let back = Rotation::from_vector(&turn).matrix().transpose();
    let expected = back * start().cov.fixed_view::<3, 3>(0, 0) * back.transpose();
    assert_relative_eq!(
        moved.cov.fixed_view::<3, 3>(0, 0).into_owned(),
        expected,
        epsilon = 1e-14
    );
    assert_relative_eq!(
        moved.mean,
        filter.motion().space().retract(&start().mean, &input),
        epsilon = 1e-14
    );
}

/// The iterated posterior is where |difference to the prior|² in P plus |residual|² in R is least.
#[test]
fn iterating_finds_the_most_likely_pose() {
    let points = DMatrix::from_row_slice(
        4,
        3,
        &[0.1, 0.0, 0.0, -0.1, 0.1, 0.02, 0.0, -0.1, 0.05, -0.1, -0.05, -0.04],
    );
    let intrinsics = Intrinsics::new([1000.0; 2], [640.0, 480.0]).unwrap();
    let camera = CameraSensor::new(points, intrinsics, 3.0).unwrap();
    let motion = MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![0.1; 6])).unwrap());
    for form in [Form::Joseph, Form::SquareRoot] {
        let filter = Filter::extended(motion.clone(), SensorModel::Camera(camera.clone())).unwrap();
        let filter = filter.with_iterations(50).unwrap().with_form(form).unwrap();
        let space = filter.motion().space();
        let mut mean = DVector::zeros(12);
        mean[2] = 0.5;
        let root = DMatrix::from_fn(12, 12, |i, j| {
            if i == j {
                0.3
            } else {
                0.02 * ((i * 5 + j * 3) % 7) as f64
            }
        });
        let prior = Gaussian {
            mean,
            cov: &root * root.transpose() * 0.2,
        };
        let mut truth = prior.mean.clone();
        truth
            .rows_mut(0, 6)
            .copy_from_slice(&[0.05, -0.04, 0.55, 0.4, -0.5, 0.6]);
        let z = camera.observe(&truth, None).unwrap();
        let found = filter.update(&prior, &z, None).unwrap().posterior;
        let factor = nalgebra::Cholesky::new(prior.cov.clone()).unwrap();
        let objective = |state: &DVector<f64>| {
            let change = space.difference(state, &prior.mean);
            let nu = residual(&camera, &z, &camera.observe(state, None).unwrap());
            change.dot(&factor.solve(&change)) + nu.norm_squared() / 9.0
        };
        let size = found.cov.diagonal().map(f64::sqrt);
        for k in 0..12 {
            let mut step = DVector::zeros(12);
            step[k] = 1e-4 * size[k];
            let ahead = objective(&space.retract(&found.mean, &step));
            let behind = objective(&space.retract(&found.mean, &-&step));
            // The slope per standard deviation.
            let slope = (ahead - behind) / 2e-4;
            assert!(slope.abs() < 1e-4, "{form:?}, component {k}: {slope}");
        }
    }
}
