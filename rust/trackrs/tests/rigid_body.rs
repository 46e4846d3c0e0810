//! Rigid bodies: their Jacobians on the manifold, free turns, noise, and motions that are none.

use crate::draws::normal;
use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, LinearMotion, RigidBody, Singer};
use trackrs::model::sensor::{AttitudeForm, CameraSensor, Intrinsics, PoseSensor, residual};
use trackrs::model::{Motion, MotionModel, Rotation, Sensor};

fn accelerating() -> MotionModel {
    let psd = vec![1.0, 2.0, 3.0, 0.4, 0.5, 0.6];
    MotionModel::ConstantAcceleration(ConstantAcceleration::new(KinematicNoise::Psd(psd)).unwrap())
}

fn singer() -> MotionModel {
    MotionModel::Singer(Singer::new(vec![3.0, 2.0, 1.0], vec![0.2, 0.3, 0.4], vec![0.1; 3]).unwrap())
}

fn turning() -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![0.5; 3])).unwrap())
}

fn random_state(n: usize, rng: &mut Pcg64) -> DVector<f64> {
    DVector::from_fn(n, |_, _| 1.5 * normal(rng))
}

#[test]
fn jacobian_is_the_derivative_on_the_manifold() {
    let mut rng = Pcg64::seed_from_u64(1);
    for (base, attitude) in [(accelerating(), 3), (singer(), 0), (turning(), 0)] {
        let body = RigidBody::around(base, attitude).unwrap();
        let (space, n) = (body.space(), body.state_dim());
        for _ in 0..30 {
            let state = random_state(n, &mut rng);
            let after = body.propagate(&state, 0.4);
            let jacobian = body.jacobian(&state, 0.4);
            for k in 0..n {
                let mut step = DVector::zeros(n);
                step[k] = 1e-5;
                let ahead = space.difference(&body.propagate(&space.retract(&state, &step), 0.4), &after);
                let behind = space.difference(&body.propagate(&space.retract(&state, &-step), 0.4), &after);
                assert_relative_eq!(jacobian.column(k).into_owned(), (ahead - behind) / 2e-5, epsilon = 1e-8);
            }
        }
    }
}

/// A turn at a constant rate about a fixed axis is exact for any step, through half turns and beyond.
#[test]
fn free_turns_are_exact() {
    let body = RigidBody::around(turning(), 0).unwrap();
    let (start, rate) = (Vector3::new(0.4, -1.0, 2.0), Vector3::new(1.0, 2.0, -0.5));
    let state = DVector::from_iterator(6, start.iter().chain(rate.iter()).copied());
    let mut stepped = state.clone();
    for _ in 0..500 {
        stepped = body.propagate(&stepped, 0.02);
    }
    let expected = (Rotation::from_vector(&start) * Rotation::from_vector(&(rate * 10.0))).vector();
    assert_relative_eq!(stepped.fixed_rows::<3>(0).into_owned(), expected, epsilon = 1e-12);
    assert_relative_eq!(body.propagate(&state, 10.0), stepped, epsilon = 1e-12);
    assert_relative_eq!(body.propagate(&state, 0.0), state, epsilon = 1e-14);
    assert_relative_eq!(body.jacobian(&state, 0.0), DMatrix::identity(6, 6), epsilon = 1e-15);
}

/// Noise drawn from the base and added to y gives the covariance of Q at the state.
#[test]
fn noise_enters_the_turn_of_the_step() {
    let mut rng = Pcg64::seed_from_u64(2);
    let body = RigidBody::around(singer(), 0).unwrap();
    let mut state = random_state(9, &mut rng);
    state.fixed_rows_mut::<3>(3).copy_from(&Vector3::new(4.0, -5.0, 3.0));
    let (dt, shrink, draws) = (0.3, 1e-3, 20_000);
    let q = body.base().noise(dt);
    let root = nalgebra::Cholesky::new(q.clone()).unwrap().l();
    let mut turned = state.clone();
    turned.fixed_rows_mut::<3>(0).fill(0.0);
    let y = body.base().propagate(&turned, dt);
    let after = body.propagate(&state, dt);
    let mut sum = DMatrix::zeros(9, 9);
    for _ in 0..draws {
        let w = &root * DVector::from_fn(9, |_, _| normal(&mut rng)) * shrink;
        let mut noisy = &y + w;
        let attitude = Rotation::from_vector(&state.fixed_rows::<3>(0).into_owned())
            * Rotation::from_vector(&noisy.fixed_rows::<3>(0).into_owned());
        noisy.fixed_rows_mut::<3>(0).copy_from(&attitude.vector());
        let change = body.space().difference(&noisy, &after) / shrink;
        sum += &change * change.transpose();
    }
    let expected = body.noise_at(&state, dt);
    let size = expected.diagonal().map(f64::sqrt);
    let apart = (sum / f64::from(draws) - &expected).component_div(&(&size * size.transpose()));
    // Correlations of this many draws have standard deviations of at most sqrt(2/N) = 0.01.
    assert!(apart.amax() < 0.045, "{}", apart.amax());
    assert!((&expected - &q).component_div(&(&size * size.transpose())).amax() > 0.2);
    assert_eq!(expected, expected.transpose());
    assert_eq!(body.noise(dt), q);
}

/// How a filter lives on the manifold: predict with `jacobian` and `noise_at`, innovate with `residual`, correct with
/// `retract`. Its errors, by `difference`, have the covariance that it states.
#[test]
fn a_filter_on_the_manifold_is_consistent() {
    let points = DMatrix::from_row_slice(
        4,
        3,
        &[0.1, 0.0, 0.0, -0.1, 0.1, 0.02, 0.0, -0.1, 0.05, -0.1, -0.05, -0.04],
    );
    let intrinsics = Intrinsics::new([1000.0; 2], [640.0, 480.0]).unwrap();
    let sensors: [&dyn Sensor; 2] = [
        &PoseSensor::new(Some([2e-3; 3]), [0.01; 3], AttitudeForm::Quaternion).unwrap(),
        &CameraSensor::new(points, intrinsics, 0.5).unwrap(),
    ];
    let base = Singer::new(
        vec![0.5, 0.5, 0.5, 20.0, 20.0, 20.0],
        vec![0.3; 6],
        vec![1e-3, 1e-3, 1e-3, 0.1, 0.1, 0.1],
    );
    let body = RigidBody::around(MotionModel::Singer(base.unwrap()), 3).unwrap();
    let (space, n, dt) = (body.space(), 18, 0.05);
    for sensor in sensors {
        let (mut rng, mut nees, mut turned, runs) = (Pcg64::seed_from_u64(9), 0.0, 0.0_f64, 300);
        for _ in 0..runs {
            let mut mean = DVector::zeros(n);
            mean[2] = 1.5;
            let mut cov = DMatrix::identity(n, n) * 0.01;
            let mut truth = space.retract(&mean, &DVector::from_fn(n, |_, _| 0.1 * normal(&mut rng)));
            for _ in 0..25 {
                let draw = |cov: &DMatrix<f64>, rng: &mut Pcg64| {
                    let root = nalgebra::Cholesky::new(cov.clone()).unwrap().l();
                    root * DVector::from_fn(cov.nrows(), |_, _| normal(rng))
                };
                let noise = draw(&body.noise_at(&truth, dt), &mut rng);
                truth = space.retract(&body.propagate(&truth, dt), &noise);
                let expected = sensor.observe(&truth, None).unwrap();
                let error = draw(&sensor.noise(), &mut rng);
                let z = match sensor.rotation() {
                    Some(at) => {
                        let space = trackrs::model::StateSpace {
                            dim: expected.len(),
                            attitude: Some(at),
                        };
                        space.retract(&expected, &error)
                    }
                    None => expected + error,
                };
                let f = body.jacobian(&mean, dt);
                cov = &f * cov * f.transpose() + body.noise_at(&mean, dt);
                mean = body.propagate(&mean, dt);
                // A second linearisation at the corrected mean, as the first image is seen from 0.1 rad beside.
                let (prior, spread) = (mean.clone(), cov.clone());
                for _ in 0..3 {
                    let h = sensor.jacobian(&mean, None).unwrap();
                    let s = &h * &spread * h.transpose() + sensor.noise();
                    let gain = &spread * h.transpose() * s.try_inverse().unwrap();
                    let back = space.difference(&mean, &prior);
                    let nu = residual(sensor, &z, &sensor.observe(&mean, None).unwrap()) + &h * &back;
                    mean = space.retract(&prior, &(&gain * nu));
                    let left = DMatrix::identity(n, n) - &gain * h;
                    cov = &left * &spread * left.transpose() + &gain * sensor.noise() * gain.transpose();
                }
                turned = turned.max(truth.fixed_rows::<3>(3).norm());
            }
            let error = space.difference(&truth, &mean);
            nees += error.dot(&(cov.try_inverse().unwrap() * &error));
        }
        // Attitudes went through the half turn, and the mean of 300 chi-squares of 18 degrees of freedom is 18 ± 0.35.
        assert!(turned > 3.0, "{turned}");
        assert!(
            (nees / f64::from(runs) - 18.0).abs() < 1.4,
            "{}",
            nees / f64::from(runs)
        );
    }
}

#[test]
fn labels_say_what_turns() {
    let body = RigidBody::around(accelerating(), 3).unwrap();
    let text = "x y z rx ry rz vx vy vz wx wy wz ax ay az alphax alphay alphaz";
    assert_eq!(body.labels().join(" "), text);
    let head = RigidBody::around(turning(), 0).unwrap();
    assert_eq!(head.labels().join(" "), "rx ry rz wx wy wz");
    let bytes = trackrs::state::to_bytes(&MotionModel::RigidBody(Box::new(head))).unwrap();
    let back: MotionModel = trackrs::state::from_bytes(&bytes).unwrap();
    assert_eq!((back.labels().len(), back.space().attitude), (6, Some(0)));
}

#[test]
fn motions_and_sensors_that_do_not_fit_are_refused() {
    assert!(RigidBody::around(turning(), 3).is_err());
    let tied = DMatrix::from_fn(3, 3, |i, j| if i == j { 0.9 } else { 0.0 });
    let tied = MotionModel::Linear(LinearMotion::new(tied, DMatrix::identity(3, 3)).unwrap());
    let error = RigidBody::around(tied, 0).unwrap_err().to_string();
    assert!(error.starts_with("motion"), "{error}");
    let once = RigidBody::around(turning(), 0).unwrap();
    assert!(RigidBody::around(MotionModel::RigidBody(Box::new(once.clone())), 0).is_err());
    let quaternion = PoseSensor::new(None, [0.1; 3], AttitudeForm::Quaternion).unwrap();
    let angles = PoseSensor::new(None, [0.1; 3], AttitudeForm::Euler).unwrap();
    assert!(quaternion.check(&once).is_ok() && angles.check(&turning()).is_ok());
    assert!(quaternion.check(&turning()).is_err() && angles.check(&once).is_err());
}
