//! Properties of the Kalman update: the textbook formula, symmetry, and positive definiteness of ill-conditioned problems.

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use trackrs::filter::kalman::{MeasurementPrediction, predict};
use trackrs::linalg::cholesky::Cholesky;
use trackrs::model::motion::{ConstantAcceleration, KinematicNoise};
use trackrs::{Error, Gaussian};

fn matrix(rows: usize, columns: usize, values: &[f64]) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |i, j| values[(i * columns + j) % values.len()])
}

fn spd(n: usize, values: &[f64]) -> DMatrix<f64> {
    let b = matrix(n, n, values);
    &b * b.transpose() + DMatrix::identity(n, n) * 0.1
}

proptest! {
    #[test]
    fn update_is_the_textbook_formula(
        n in 1_usize..9, m in 1_usize..5, values in prop::collection::vec(-3.0..3.0_f64, 97)
    ) {
        let prior = Gaussian { mean: DVector::from_column_slice(&values[..n]), cov: spd(n, &values) };
        let (h, r) = (matrix(m, n, &values[11..]), spd(m, &values[5..]));
        let innovation = DVector::from_column_slice(&values[20..20 + m]);
        let update = MeasurementPrediction::new(&prior, &h, &r).unwrap()
            .update(&prior, &innovation).unwrap();
        let s = &h * &prior.cov * h.transpose() + &r;
        let inverse = s.clone().try_inverse().unwrap();
        let k = &prior.cov * h.transpose() * &inverse;
        let cov = &prior.cov - &k * &s * k.transpose();
        prop_assert!((update.posterior.mean - (&prior.mean + &k * &innovation)).amax() < 1e-9 * (1.0 + k.amax()) * 10.0);
        prop_assert!((&update.posterior.cov - cov).amax() < 1e-9 * prior.cov.amax());
        prop_assert_eq!(&update.posterior.cov, &update.posterior.cov.transpose());
        let nis = (innovation.transpose() * &inverse * &innovation)[(0, 0)];
        prop_assert!((update.nis - nis).abs() < 1e-8 * (1.0 + nis));
        let m_ln_tau = m as f64 * std::f64::consts::TAU.ln();
        let log_likelihood = -0.5 * (nis + s.determinant().ln() + m_ln_tau);
        prop_assert!((update.log_likelihood - log_likelihood).abs() < 1e-8 * (1.0 + log_likelihood.abs()));
        // The measurement never makes the estimate worse: P⁻ − P⁺ is positive semidefinite.
        let gain = &prior.cov - &update.posterior.cov + DMatrix::identity(n, n) * (1e-9 * prior.cov.amax());
        prop_assert!(Cholesky::new(&gain, "difference").is_ok());
    }

    #[test]
    fn one_update_by_m_components_is_m_updates_by_one(values in prop::collection::vec(-3.0..3.0_f64, 97)) {
        let (n, m) = (6, 3);
        let prior = Gaussian { mean: DVector::from_column_slice(&values[..n]), cov: spd(n, &values) };
        let h = matrix(m, n, &values[11..]);
        let r = DMatrix::from_diagonal(&DVector::from_vec(vec![0.5, 1.0, 2.0]));
        let z = DVector::from_column_slice(&values[30..30 + m]);
        let together = MeasurementPrediction::new(&prior, &h, &r).unwrap()
            .posterior(&prior, &(&z - &h * &prior.mean));
        let mut state = prior;
        for i in 0..m {
            let (row, noise) = (h.rows(i, 1).into_owned(), r.view((i, i), (1, 1)).into_owned());
            let innovation = z.rows(i, 1) - &row * &state.mean;
            state = MeasurementPrediction::new(&state, &row, &noise).unwrap().posterior(&state, &innovation);
        }
        prop_assert!((together.mean - state.mean).amax() < 1e-8);
        prop_assert!((together.cov - state.cov).amax() < 1e-8);
    }
}

/// Fault 1: with cond(P₀) up to 1e14 the covariance stays symmetric and positive definite through 200 updates.
#[test]
fn covariance_stays_positive_definite_up_to_condition_1e14() {
    let mut seed = 1_u64;
    let mut random = move || {
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / 2.0_f64.powi(53) * 2.0 - 1.0
    };
    for exponent in [0, 3, 6, 9, 12, 14] {
        let condition = 10.0_f64.powi(exponent);
        for _ in 0..50 {
            let mut state = Gaussian {
                mean: DVector::zeros(4),
                cov: DMatrix::identity(4, 4),
            };
            let r = DMatrix::identity(2, 2) / condition;
            for _ in 0..200 {
                let h = DMatrix::from_fn(2, 4, |_, _| random());
                let prediction = MeasurementPrediction::new(&state, &h, &r).unwrap();
                state = prediction.posterior(&state, &DVector::zeros(2));
                assert!(Cholesky::new(&state.cov, "posterior").is_ok(), "condition 1e{exponent}");
                assert_eq!(state.cov, state.cov.transpose());
            }
        }
    }
}

#[test]
fn prediction_over_no_time_is_the_identity() {
    let motion = ConstantAcceleration::new(KinematicNoise::Psd(vec![1.0, 2.0])).unwrap();
    let values: Vec<f64> = (0..40).map(|k| f64::from(k % 7) - 3.0).collect();
    let state = Gaussian {
        mean: DVector::from_column_slice(&values[..6]),
        cov: spd(6, &values),
    };
    assert_eq!(predict(&state, &motion, 0.0, None).unwrap(), state);
}

#[test]
fn a_sensor_without_noise_seeing_twice_is_an_error_that_names_the_pivot() {
    let prior = Gaussian {
        mean: DVector::zeros(1),
        cov: DMatrix::identity(1, 1),
    };
    let twice = MeasurementPrediction::new(&prior, &DMatrix::from_element(2, 1, 1.0), &DMatrix::zeros(2, 2));
    assert!(matches!(twice, Err(Error::NotPositiveDefinite { pivot: 1, .. })));
}
