//! Covariances of extreme condition: Joseph form to 1e14, square-root form to 1e24.

use nalgebra::{DMatrix, DVector};
use trackrs::Gaussian;
use trackrs::filter::runner::Runner;
use trackrs::filter::sequence::{Filter, InitialState};
use trackrs::filter::square_root::Form;
use trackrs::linalg::cholesky::Cholesky;
use trackrs::model::motion::LinearMotion;
use trackrs::model::sensor::LinearSensor;
use trackrs::model::{MotionModel, SensorModel};

const STATES: usize = 4;
const UPDATES: usize = 200;

/// Numbers in (−1, 1), the same at every run.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// Trials whose covariance stopped being positive definite, of 20: 200 updates of two components of noise I/condition, of a
/// state whose variances reach from 1 to 1/condition.
fn failures(form: Form, condition: f64) -> usize {
    let mut draws = Draws(7);
    let mut failed = 0;
    for _ in 0..20 {
        let h = DMatrix::from_fn(2, STATES, |_, _| draws.next());
        let motion = LinearMotion::new(DMatrix::identity(STATES, STATES), DMatrix::zeros(STATES, STATES)).unwrap();
        let sensor = LinearSensor::new(h, DMatrix::identity(2, 2) / condition, DVector::zeros(2)).unwrap();
        let filter = Filter::kalman(MotionModel::Linear(motion), SensorModel::Linear(sensor)).unwrap();
        let filter = filter.with_form(form).unwrap();
        let variance = |i: usize| condition.powf(-(i as f64) / (STATES - 1) as f64);
        let state = Gaussian {
            mean: DVector::zeros(STATES),
            cov: DMatrix::from_diagonal(&DVector::from_fn(STATES, |i, _| variance(i))),
        };
        let mut runner = Runner::new(&filter, &InitialState { time: 0.0, state }).unwrap();
        let definite = (0..UPDATES).all(|k| {
            let z = [draws.next() / condition.sqrt(), draws.next() / condition.sqrt()];
            let Ok(epoch) = runner.step(k as f64, &z, None) else {
                return false;
            };
            let cov = DMatrix::from_column_slice(STATES, STATES, epoch.posterior.cov);
            assert_eq!(cov, cov.transpose());
            match runner.factor() {
                // P = Uᵀ U with U triangular: definite if no number on the diagonal is zero.
                Some(u) => (0..STATES).all(|i| u[i * (STATES + 1)] != 0.0 && u[i * (STATES + 1)].is_finite()),
                None => Cholesky::new(&cov, "P").is_ok(),
            }
        });
        failed += usize::from(!definite);
    }
    failed
}

#[test]
fn joseph_form_holds_to_a_condition_of_1e14() {
    for exponent in [0, 3, 6, 9, 12, 14] {
        assert_eq!(failures(Form::Joseph, 10_f64.powi(exponent)), 0, "1e{exponent}");
    }
}

#[test]
fn square_root_form_holds_to_a_condition_of_1e24() {
    for exponent in [0, 6, 12, 15, 18, 21, 24] {
        assert_eq!(failures(Form::SquareRoot, 10_f64.powi(exponent)), 0, "1e{exponent}");
    }
}
