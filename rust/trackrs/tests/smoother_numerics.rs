//! Smoothing where numbers are difficult, what it refuses, and the golden vectors.

use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector};
use serde_json::Value;
use trackrs::filter::run::FilterRun;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::smoother::{Epoch, FixedLagSmoother, fixed_interval, fixed_lag, limited_memory};
use trackrs::linalg::symmetric::eigen_range;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{Motion, MotionModel, SensorModel};
use trackrs::{Error, Gaussian};

/// Covariances by (U15) as it stands, the gain by Cholesky factors.
fn textbook_covs(epochs: &[Epoch<'_>]) -> Vec<DMatrix<f64>> {
    let mut covs = vec![epochs[epochs.len() - 1].filtered.to_owned().cov];
    for pair in epochs.windows(2).rev() {
        let (p, next) = (pair[0].filtered.to_owned().cov, pair[1].predicted.to_owned().cov);
        let factor = next.clone().cholesky().unwrap();
        let f = DMatrix::from_row_slice(p.nrows(), p.nrows(), pair[1].transition);
        let c = factor.solve(&(f * &p)).transpose();
        let cov = p + &c * (&covs[covs.len() - 1] - next) * c.transpose();
        covs.push((&cov + cov.transpose()) * 0.5);
    }
    covs.reverse();
    covs
}

/// A straight track measured to a centimetre after a start known to 50 km: the reason for the form of the covariance.
#[test]
fn covariance_stays_positive_definite_where_the_textbook_loses_it() {
    let noise = KinematicNoise::Std(vec![1e-6]);
    let motion = MotionModel::ConstantAcceleration(ConstantAcceleration::new(noise).unwrap());
    let sensor = SensorModel::Position(PositionSensor::new(vec![0.01]).unwrap());
    let start = |variance: f64| InitialState {
        time: 0.0,
        state: Gaussian {
            mean: DVector::zeros(3),
            cov: DMatrix::identity(3, 3) * variance,
        },
    };
    let times: Vec<f64> = (0..30).map(f64::from).collect();
    let values = vec![DVector::zeros(1); 30];
    let filter = Filter::kalman(motion, sensor).unwrap();
    let smallest = |covs: &[DMatrix<f64>]| {
        covs.iter()
            .map(|c| eigen_range(c).unwrap().min)
            .fold(f64::MAX, f64::min)
    };
    let covs = |variance: f64, form: &dyn Fn(&[Epoch<'_>]) -> Vec<DMatrix<f64>>| {
        let run = filter
            .run(&times, &values, Some(&start(variance)), None, History::Full)
            .unwrap();
        form(&run.epochs().unwrap())
    };
    let sum = |epochs: &[Epoch<'_>]| -> Vec<DMatrix<f64>> {
        let smoothed = fixed_interval(epochs).unwrap();
        smoothed.states.iter().map(|s| s.cov).collect()
    };
    // A start known to 100 m says as little about the smoothed track, and there both forms are right.
    let reference = covs(1e4, &sum);
    assert_relative_eq!(
        smallest(&reference),
        smallest(&covs(1e4, &textbook_covs)),
        max_relative = 0.01
    );
    let (ours, textbook) = (covs(3e9, &sum), covs(3e9, &textbook_covs));
    assert!(smallest(&textbook) < -1e-3 * reference[0].amax());
    assert_relative_eq!(smallest(&ours), smallest(&reference), max_relative = 0.05);
    // The gain's rounding moves both forms alike: the sum keeps definiteness, it does not bring back digits.
    assert_relative_eq!(ours[0], reference[0], epsilon = 0.05 * reference[0].amax());
}

#[test]
fn a_constant_known_exactly_in_part_is_smoothed() {
    let noise = KinematicNoise::Std(vec![0.0, 0.0]);
    let filter = Filter::kalman(
        MotionModel::RandomWalk(RandomWalk::new(noise).unwrap()),
        SensorModel::Position(PositionSensor::new(vec![1.0, 1.0]).unwrap()),
    );
    let initial = InitialState {
        time: 0.0,
        state: Gaussian {
            mean: DVector::zeros(2),
            cov: DMatrix::from_diagonal(&DVector::from_vec(vec![4.0, 0.0])),
        },
    };
    let values = vec![DVector::from_element(2, 1.0); 5];
    let run = filter
        .unwrap()
        .run(&[1.0, 2.0, 3.0, 4.0, 5.0], &values, Some(&initial), None, History::Full)
        .unwrap();
    for state in fixed_interval(&run.epochs().unwrap()).unwrap().states.iter() {
        assert_relative_eq!(state.mean, run.filtered.at(4).mean, epsilon = 1e-15);
        assert_eq!(state.cov, run.filtered.at(4).cov);
    }
}

#[test]
fn errors_name_the_culprit() {
    // Piecewise-constant acceleration from an exactly known state reaches one direction only.
    let noise = KinematicNoise::Std(vec![0.3]);
    let motion = MotionModel::ConstantVelocity(ConstantVelocity::new(noise).unwrap());
    let sensor = SensorModel::Position(PositionSensor::new(vec![1.0]).unwrap());
    let filter = Filter::kalman(motion, sensor).unwrap();
    let initial = InitialState {
        time: 0.0,
        state: Gaussian {
            mean: DVector::zeros(2),
            cov: DMatrix::zeros(2, 2),
        },
    };
    let values = vec![DVector::zeros(1); 4];
    let run = |history| {
        filter
            .run(&[0.0, 0.7, 1.4, 2.1], &values, Some(&initial), None, history)
            .unwrap()
    };
    let full = run(History::Full);
    let epochs = full.epochs().unwrap();
    let error = fixed_interval(&epochs).unwrap_err();
    assert!(matches!(error, Error::NotPositiveDefinite { pivot: 1, .. }), "{error}");
    assert!(
        error
            .to_string()
            .starts_with("predicted covariance at step 1 is not positive definite")
    );
    let mut smoother = FixedLagSmoother::new(2).unwrap();
    smoother.push(&epochs[0]).unwrap();
    let before = smoother.tail();
    assert_eq!(smoother.push(&epochs[1]).unwrap_err(), error);
    assert_eq!(smoother.tail(), before);

    assert!(
        run(History::Filtered)
            .epochs()
            .unwrap_err()
            .to_string()
            .contains("full history")
    );
    assert!(run(History::Last).epochs().is_err());
    assert_eq!(
        FixedLagSmoother::new(0).unwrap_err().to_string(),
        "lag = 0 is invalid: must be at least 1 epoch"
    );

    let bad = Epoch {
        transition: &[1.0, 0.0],
        ..epochs[2]
    };
    let error = fixed_interval(&[epochs[1], bad]).unwrap_err();
    assert_eq!(error.to_string(), "transition at step 2 has size 2, expected 4");
    let broken = Gaussian {
        mean: DVector::from_vec(vec![0.0, f64::NAN]),
        cov: DMatrix::identity(2, 2),
    };
    let bad = Epoch {
        filtered: (&broken).into(),
        ..epochs[2]
    };
    let error = fixed_lag(&[bad], 1).unwrap_err();
    assert_eq!(error.to_string(), "filtered mean at step 2 is not finite at index 1");
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        Value::Null => Vec::new(),
        number => vec![number.as_f64().unwrap()],
    }
}

/// `tests/data/underwater_bats_smoother.json`: nine states, jerk noise, unequal steps before the window.
#[test]
fn limited_memory_matches_the_golden_file() {
    let text = include_str!(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../tests/data/underwater_bats_smoother.json"
    ));
    let file: Value = serde_json::from_str(text).unwrap();
    let vector = |key: &str, i: usize| DVector::from_vec(numbers(&file[key][i]));
    let square = |key: &str, i: usize| DMatrix::from_row_slice(9, 9, &numbers(&file[key][i]));
    let state = |mean: &str, cov: &str, i: usize| Gaussian {
        mean: vector(mean, i),
        cov: square(cov, i),
    };
    let steps = numbers(&file["dt_window"]);
    let window = usize::try_from(file["N"].as_u64().unwrap()).unwrap();
    let jerk_std: Vec<f64> = (0..3).map(|i| file["Q"][i][i].as_f64().unwrap().sqrt()).collect();
    let motion = ConstantAcceleration::new(KinematicNoise::Std(jerk_std)).unwrap();
    let mut run = FilterRun::new(9, 4);
    for i in 0..7 {
        // The window begins with a filtered estimate; the step to it is not used and not in the file.
        let (names, dt) = if i == 0 {
            (("xf", "Pf"), 1.0)
        } else {
            (("xp", "Pp"), steps[i - 1])
        };
        run.filtered.push(&state("xf", "Pf", i));
        run.predicted.push(&state(names.0, names.1, i));
        run.transitions
            .push(motion.jacobian(&vector("xf", i), dt).transpose().as_slice());
        run.motion_noises.push(motion.noise(dt).as_slice());
    }
    let smoothed = limited_memory(&run.epochs().unwrap(), window).unwrap();
    assert_eq!(smoothed.states.len(), 7);
    for (i, state) in smoothed.states.iter().enumerate() {
        let (mean, cov) = (vector("xs", i), square("Ps", i));
        assert_relative_eq!(state.mean, mean, max_relative = 1e-9, epsilon = 1e-9 * mean.amax());
        assert_relative_eq!(state.cov, cov, max_relative = 1e-9, epsilon = 1e-9 * cov.amax());
    }
    for i in 0..smoothed.lag_one.len() {
        let expected = square("lag_one", i + 1);
        assert_relative_eq!(
            smoothed.lag_one.matrix(i),
            expected,
            max_relative = 1e-9,
            epsilon = 1e-9 * expected.amax()
        );
    }
}
