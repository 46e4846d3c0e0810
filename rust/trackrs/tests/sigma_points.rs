//! Sigma points against the sums over the points written out, and against the Kalman filter.

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use trackrs::filter::extended::{Rule, update};
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::sigma_points::SigmaPoints;
use trackrs::filter::square_root::Form;
use trackrs::linalg::cholesky::Cholesky;
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::{RangeBearing, residual, wrap_angle};
use trackrs::model::{Motion, MotionModel, Sensor, SensorModel};
use trackrs::{Gaussian, Result};

/// A turn at a rate in the state: x y vx vy rate.
#[derive(Debug)]
struct Turn;

impl Motion for Turn {
    fn state_dim(&self) -> usize {
        5
    }
    fn position_dims(&self) -> usize {
        2
    }
    fn labels(&self) -> Vec<String> {
        ["x", "y", "vx", "vy", "rate"].map(String::from).to_vec()
    }
    fn propagate(&self, s: &DVector<f64>, dt: f64) -> DVector<f64> {
        let (c, k) = ((s[4] * dt).cos(), (s[4] * dt).sin());
        let (vx, vy) = (c * s[2] - k * s[3], k * s[2] + c * s[3]);
        DVector::from_vec(vec![s[0] + dt * vx, s[1] + dt * vy, vx, vy, s[4]])
    }
    fn jacobian(&self, s: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        let step = 1e-6;
        let mut out = DMatrix::zeros(5, 5);
        for j in 0..5 {
            let (mut a, mut b) = (s.clone(), s.clone());
            a[j] += step;
            b[j] -= step;
            out.set_column(j, &((self.propagate(&a, dt) - self.propagate(&b, dt)) / (2.0 * step)));
        }
        out
    }
    fn noise(&self, dt: f64) -> DMatrix<f64> {
        DMatrix::from_diagonal(&DVector::from_vec(vec![0.1, 0.1, 0.2, 0.2, 1e-3])) * dt
    }
    fn is_linear(&self) -> bool {
        false
    }
}

fn prior(values: &[f64]) -> Gaussian {
    let b = DMatrix::from_fn(5, 5, |i, j| values[(5 * i + j) % values.len()]);
    let mut cov = &b * b.transpose() + DMatrix::identity(5, 5) * 0.2;
    cov[(4, 4)] += 0.01;
    let mut cov = cov * 0.3;
    trackrs::linalg::symmetric::symmetrise(&mut cov);
    Gaussian {
        mean: DVector::from_vec(vec![-60.0, values[0], 5.0, -3.0, 0.2]),
        cov,
    }
}

/// The usual sums: weights of mean and covariance, and the points.
struct Textbook {
    points: Vec<DVector<f64>>,
    of_mean: Vec<f64>,
    of_cov: Vec<f64>,
}

fn textbook(state: &Gaussian, kappa: f64, scale: Option<(f64, f64)>) -> Textbook {
    let n = state.dim();
    let size = n as f64;
    let (alpha, beta) = scale.unwrap_or((1.0, 0.0));
    let lambda = alpha * alpha * (size + kappa) - size;
    let l = Cholesky::new(&state.cov, "P").unwrap().lower().clone() * (size + lambda).sqrt();
    let mut points = vec![state.mean.clone()];
    points.extend((0..n).map(|j| &state.mean + l.column(j)));
    points.extend((0..n).map(|j| &state.mean - l.column(j)));
    let mut of_mean = vec![0.5 / (size + lambda); 2 * n + 1];
    of_mean[0] = lambda / (size + lambda);
    let mut of_cov = of_mean.clone();
    of_cov[0] += if scale.is_some() {
        1.0 - alpha * alpha + beta
    } else {
        0.0
    };
    Textbook {
        points,
        of_mean,
        of_cov,
    }
}

/// Kappa, alpha and beta where scaled, and the points.
type Case = (f64, Option<(f64, f64)>, SigmaPoints);

fn rules() -> Vec<Case> {
    let scaled = |alpha, beta, kappa| {
        (
            kappa,
            Some((alpha, beta)),
            SigmaPoints::scaled(alpha, beta, kappa).unwrap(),
        )
    };
    vec![
        (0.0, None, SigmaPoints::cubature()),
        (1.0, None, SigmaPoints::unscented(1.0)),
        (-2.0, None, SigmaPoints::unscented(-2.0)),
        scaled(0.5, 2.0, 0.0),
        scaled(0.1, 2.0, 1.0),
    ]
}

fn close(a: &DMatrix<f64>, b: &DMatrix<f64>) -> bool {
    (a - b).amax() < 1e-9 * b.amax().max(1.0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn prediction_and_update_are_the_textbook_sums(values in prop::collection::vec(-2.0..2.0_f64, 25)) {
        let prior = prior(&values);
        let radar = RangeBearing::new([0.0, 0.0], 1.0, 0.02).unwrap();
        for (kappa, scale, rule) in rules() {
            let filter = Filter::sigma_points(
                MotionModel::Custom(std::sync::Arc::new(Turn)), SensorModel::RangeBearing(radar.clone()), rule).unwrap();
            let t = textbook(&prior, kappa, scale);
            let moved: Vec<_> = t.points.iter().map(|p| Turn.propagate(p, 0.7)).collect();
            let mean: DVector<f64> = moved.iter().zip(&t.of_mean).map(|(p, w)| p * *w).sum();
            let cov: DMatrix<f64> = moved.iter().zip(&t.of_cov).map(|(p, w)| (p - &mean) * (p - &mean).transpose() * *w).sum();
            let found = filter.predict(&prior, 0.7, None).unwrap();
            prop_assert!((&found.mean - &mean).amax() < 1e-9 * mean.amax());
            prop_assert!(close(&found.cov, &(cov + Turn.noise(0.7))));

            // Near the seam of the bearing: means and differences about the centre's.
            let seen: Vec<_> = t.points.iter().map(|p| radar.observe(p, None).unwrap()).collect();
            let offsets: Vec<_> = seen.iter().map(|y| residual(&radar, y, &seen[0])).collect();
            let mean: DVector<f64> = offsets.iter().zip(&t.of_mean).map(|(y, w)| y * *w).sum();
            let (mut s, mut cross) = (radar.noise(), DMatrix::zeros(5, 2));
            for ((y, p), w) in offsets.iter().zip(&t.points).zip(&t.of_cov) {
                s += (y - &mean) * (y - &mean).transpose() * *w;
                cross += (p - &prior.mean) * (y - &mean).transpose() * *w;
            }
            let z = DVector::from_vec(vec![62.0, 3.1]);
            let expected = &seen[0] + &mean;
            let innovation = DVector::from_vec(vec![z[0] - expected[0], wrap_angle(z[1] - expected[1])]);
            let gain = &cross * s.clone().try_inverse().unwrap();
            let found = filter.update(&prior, &z, None).unwrap();
            prop_assert!((&found.innovation - &innovation).amax() < 1e-9);
            prop_assert!(close(&found.innovation_cov, &s));
            let posterior = &prior.mean + &gain * &innovation;
            prop_assert!((&found.posterior.mean - &posterior).amax() < 1e-8 * posterior.amax());
            prop_assert!(close(&found.posterior.cov, &(&prior.cov - &gain * s * gain.transpose())));
        }
    }

    #[test]
    fn square_root_form_is_the_same_filter(values in prop::collection::vec(-2.0..2.0_f64, 25)) {
        let prior = prior(&values);
        let radar = RangeBearing::new([0.0, 0.0], 1.0, 0.02).unwrap();
        let models = || (MotionModel::Custom(std::sync::Arc::new(Turn)), SensorModel::RangeBearing(radar.clone()));
        let build = |rule: Option<SigmaPoints>| {
            let (motion, sensor) = models();
            rule.map_or_else(|| Filter::extended(motion.clone(), sensor.clone()),
                |rule| Filter::sigma_points(motion.clone(), sensor.clone(), rule)).unwrap()
        };
        let times: Vec<f64> = (0..12).map(|k| 0.3 * f64::from(k)).collect();
        let zs: Vec<_> = (0..12).map(|k| {
            let range = if k == 4 { f64::NAN } else { 60.0 + 0.1 * f64::from(k) };
            DVector::from_vec(vec![range, if k == 7 { f64::NAN } else { 3.0 + 0.01 * f64::from(k) }])
        }).collect();
        let initial = InitialState { time: 0.0, state: prior };
        for rule in [None, Some(SigmaPoints::cubature()), Some(SigmaPoints::scaled(0.3, 2.0, 0.0).unwrap())] {
            let plain = build(rule);
            let root = plain.clone().with_form(Form::SquareRoot).unwrap();
            let run = |filter: &Filter| filter.run(&times, &zs, Some(&initial), None, History::Full).unwrap();
            let (a, b) = (run(&plain), run(&root));
            for row in 0..times.len() {
                let (x, y) = (a.filtered.at(row), b.filtered.at(row));
                prop_assert!((&x.mean - &y.mean).amax() < 1e-7 * x.mean.amax(), "row {}", row);
                prop_assert!((&x.cov - &y.cov).amax() < 1e-7 * x.cov.amax());
                prop_assert_eq!(&y.cov, &y.cov.transpose());
            }
            prop_assert!((a.log_likelihood - b.log_likelihood).abs() < 1e-6 * a.log_likelihood.abs());
        }
    }
}

#[test]
fn a_singular_covariance_has_points_and_an_indefinite_one_an_error() {
    let radar = RangeBearing::new([0.0, 0.0], 1.0, 0.02).unwrap();
    let motion = ConstantVelocity::new(KinematicNoise::Psd(vec![0.1; 2])).unwrap();
    let filter = Filter::sigma_points(
        MotionModel::ConstantVelocity(motion),
        SensorModel::RangeBearing(radar),
        SigmaPoints::cubature(),
    );
    let filter = filter.unwrap();
    let mut state = Gaussian {
        mean: DVector::from_vec(vec![30.0, 40.0, 1.0, 2.0]),
        cov: DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 2.0, 0.0, 0.0])),
    };
    let z = DVector::from_vec(vec![51.0, 0.9]);
    let found = filter.update(&state, &z, None).unwrap().posterior;
    assert_eq!(found.mean.rows(2, 2), state.mean.rows(2, 2));
    let rule = Rule::SigmaPoints(SigmaPoints::cubature());
    let again: Result<_> = update(&state, filter.sensor(), &z, None, rule);
    assert_eq!(again.unwrap().posterior, found);
    state.cov[(0, 0)] = -1.0;
    let error = filter.update(&state, &z, None).unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with("covariance of the sigma points is not positive definite")
    );
}

#[test]
fn points_that_do_not_exist_are_named() {
    let motion = ConstantVelocity::new(KinematicNoise::Psd(vec![0.1; 2])).unwrap();
    let radar = RangeBearing::new([0.0, 0.0], 1.0, 0.02).unwrap();
    let build = |points| {
        Filter::sigma_points(
            MotionModel::ConstantVelocity(motion.clone()),
            SensorModel::RangeBearing(radar.clone()),
            points,
        )
    };
    for kappa in [-4.0, -5.0, f64::NAN] {
        let error = build(SigmaPoints::unscented(kappa)).unwrap_err();
        assert!(error.to_string().starts_with("kappa = "), "{error}");
    }
    for points in [SigmaPoints::unscented(-1.0), SigmaPoints::cubature().carried()] {
        let error = build(points).unwrap().with_form(Form::SquareRoot).unwrap_err();
        assert!(error.to_string().starts_with("form = "), "{error}");
    }
    assert!(SigmaPoints::scaled(0.0, 2.0, 0.0).is_err());
}
