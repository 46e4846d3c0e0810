//! Covariances of extreme condition: Joseph form to 1e14, from there as square roots to 1e24.

use nalgebra::{DMatrix, DVector};
use trackrs::Gaussian;
use trackrs::error::Error;
use trackrs::event::EventCode;
use trackrs::filter::runner::Runner;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::square_root::Form;
use trackrs::linalg::cholesky::Cholesky;
use trackrs::model::motion::LinearMotion;
use trackrs::model::sensor::LinearSensor;
use trackrs::model::{MotionModel, SensorModel};

const STATES: usize = 4;
const UPDATES: usize = 200;
const TRIALS: usize = 20;

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

/// 200 measurements of two components of noise I/condition, of a state whose variances reach from 1 to 1/condition and whose
/// motion turns it out of its axes.
struct Trial {
    filter: Filter,
    initial: InitialState,
    times: Vec<f64>,
    values: Vec<DVector<f64>>,
}

fn trials(form: Form, condition: f64) -> Vec<Trial> {
    let mut draws = Draws(7);
    let trial = |_| {
        let h = DMatrix::from_fn(2, STATES, |_, _| draws.next());
        let mut turn = DMatrix::identity(STATES, STATES);
        for (i, j) in (0..STATES).flat_map(|i| (0..i).map(move |j| (i, j))) {
            let (sine, cosine) = (3.0 * draws.next()).sin_cos();
            let mut plane = DMatrix::identity(STATES, STATES);
            (plane[(i, i)], plane[(j, j)], plane[(i, j)], plane[(j, i)]) = (cosine, cosine, sine, -sine);
            turn = plane * turn;
        }
        let motion = LinearMotion::new(turn, DMatrix::zeros(STATES, STATES)).unwrap();
        let sensor = LinearSensor::new(h, DMatrix::identity(2, 2) / condition, DVector::zeros(2)).unwrap();
        let filter = Filter::kalman(MotionModel::Linear(motion), SensorModel::Linear(sensor)).unwrap();
        let variance = |i: usize| condition.powf(-(i as f64) / (STATES - 1) as f64);
        let mean = DVector::zeros(STATES);
        let cov = DMatrix::from_diagonal(&DVector::from_fn(STATES, |i, _| variance(i)));
        let mut value = || DVector::from_fn(2, |_, _| draws.next() / condition.sqrt());
        Trial {
            values: (0..UPDATES).map(|_| value()).collect(),
            times: (1..=UPDATES).map(|k| k as f64).collect(),
            filter: filter.with_form(form).unwrap(),
            initial: InitialState {
                time: 0.0,
                state: Gaussian { mean, cov },
            },
        }
    };
    (0..TRIALS).map(trial).collect()
}

/// How many trials are positive definite throughout, and how many became square roots on the way.
fn outcome(form: Form, condition: f64) -> [usize; 2] {
    let (mut definite, mut escalated) = (0, 0);
    for trial in trials(form, condition) {
        let mut runner = Runner::new(&trial.filter, &trial.initial).unwrap();
        let mut rows = trial.times.iter().zip(&trial.values).enumerate();
        let mut expected = Vec::new();
        let all = rows.all(|(row, (&time, z))| {
            let Ok(epoch) = runner.step(time, z.as_slice(), None) else {
                return false;
            };
            if epoch.escalated {
                escalated += 1;
                expected.push((EventCode::Escalated, time, Some(row)));
            }
            let cov = DMatrix::from_column_slice(STATES, STATES, epoch.posterior.cov);
            assert_eq!(cov, cov.transpose());
            match runner.factor() {
                // P = Uᵀ U with U triangular: definite if no number on the diagonal is zero.
                Some(u) => (0..STATES).all(|i| u[i * (STATES + 1)] != 0.0 && u[i * (STATES + 1)].is_finite()),
                None => Cholesky::new(&cov, "P").is_ok(),
            }
        });
        definite += usize::from(all);
        // A run says the same, and when.
        let run = |filter: &Filter| {
            let initial = Some(&trial.initial);
            filter.run(&trial.times, &trial.values, initial, None, History::Last)
        };
        let books = run(&trial.filter).unwrap().books;
        assert_eq!(
            (books.ledger.rows_in, books.ledger.used),
            (UPDATES as u64, UPDATES as u64)
        );
        let events: Vec<_> = books
            .events
            .recent()
            .map(|event| (event.code, event.time, event.row))
            .collect();
        assert_eq!(events, expected);
        let strict = run(&trial.filter.clone().with_strict());
        assert_eq!(matches!(strict, Err(Error::Strict { .. })), !expected.is_empty());
    }
    [definite, escalated]
}

#[test]
fn joseph_form_holds_to_a_condition_of_1e14() {
    for exponent in [0, 3, 6, 9, 12, 14] {
        assert_eq!(
            outcome(Form::Joseph, 10_f64.powi(exponent)),
            [TRIALS, 0],
            "1e{exponent}"
        );
    }
}

#[test]
fn beyond_it_runs_go_on_as_square_roots_to_1e24() {
    let mut before = 0;
    for exponent in [15, 16, 17, 18, 21, 24] {
        let [definite, escalated] = outcome(Form::Joseph, 10_f64.powi(exponent));
        assert_eq!(definite, TRIALS, "1e{exponent}");
        assert!(escalated >= before);
        before = escalated;
    }
    assert_eq!(before, TRIALS);
}

#[test]
fn square_root_form_holds_to_a_condition_of_1e24() {
    for exponent in [0, 6, 12, 15, 18, 21, 24] {
        assert_eq!(
            outcome(Form::SquareRoot, 10_f64.powi(exponent)),
            [TRIALS, 0],
            "1e{exponent}"
        );
    }
}

/// The motion turns the axes: as a matrix P⁻ could not hold the smaller variance any more.
#[test]
fn an_escalated_run_keeps_the_digits_that_joseph_form_loses() {
    let (c, s) = (0.6, 0.8);
    let turn = DMatrix::from_row_slice(2, 2, &[c, s, -s, c]);
    let motion = LinearMotion::new(turn, DMatrix::zeros(2, 2)).unwrap();
    let sensor = LinearSensor::new(
        DMatrix::identity(1, 2),
        DMatrix::identity(1, 1) * 1e6,
        DVector::zeros(1),
    )
    .unwrap();
    let filter = Filter::kalman(MotionModel::Linear(motion), SensorModel::Linear(sensor)).unwrap();
    let state = Gaussian {
        mean: DVector::zeros(2),
        cov: DMatrix::from_diagonal(&DVector::from_column_slice(&[1.0, 1e-20])),
    };
    let mut runner = Runner::new(&filter, &InitialState { time: 0.0, state }).unwrap();
    let epoch = runner.step(1.0, &[f64::NAN], None).unwrap();
    assert!(epoch.escalated);
    let factor = DMatrix::from_row_slice(2, 2, runner.factor().unwrap());
    // det P = λ₁ λ₂, with λ₁ = 1.
    let small = factor.determinant() * factor.determinant();
    assert!((small / 1e-20 - 1.0).abs() < 1e-5, "{small:e}");
}

/// Units are no matter of condition, and neither is what is exactly known.
#[test]
fn graded_variances_and_known_components_stay_in_joseph_form() {
    let motion = LinearMotion::new(DMatrix::identity(3, 3), DMatrix::zeros(3, 3)).unwrap();
    let h = DMatrix::from_row_slice(1, 3, &[1.0, 0.5e-10, 1.0]);
    let sensor = LinearSensor::new(h, DMatrix::identity(1, 1), DVector::zeros(1)).unwrap();
    let filter = Filter::kalman(MotionModel::Linear(motion), SensorModel::Linear(sensor)).unwrap();
    let state = Gaussian {
        mean: DVector::zeros(3),
        cov: DMatrix::from_diagonal(&DVector::from_column_slice(&[1.0, 1e20, 0.0])),
    };
    let initial = InitialState { time: 0.0, state };
    let values = vec![DVector::from_element(1, 0.3); 5];
    let times = [1.0, 2.0, 3.0, 4.0, 5.0];
    let run = filter
        .run(&times, &values, Some(&initial), None, History::Full)
        .unwrap();
    assert!(run.books.events.counts().is_empty());
    assert_eq!(run.filtered.at(4).cov[(2, 2)], 0.0);
}

/// A covariance that is singular as given, or indefinite by rounding, is carried as a root from the first row on.
#[test]
fn a_singular_start_is_a_root_from_the_first_row() {
    let motion = LinearMotion::new(DMatrix::identity(2, 2), DMatrix::zeros(2, 2)).unwrap();
    let sensor = LinearSensor::new(DMatrix::identity(1, 2), DMatrix::identity(1, 1), DVector::zeros(1)).unwrap();
    let filter = Filter::kalman(MotionModel::Linear(motion), SensorModel::Linear(sensor)).unwrap();
    for below in [0.0, 1e-12] {
        let cov = DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, 1.0 - below]);
        let state = Gaussian::new(DVector::zeros(2), cov).unwrap();
        let initial = InitialState { time: 0.0, state };
        let values = vec![DVector::from_element(1, 1.0); 3];
        let run = filter
            .run(&[0.0, 1.0, 2.0], &values, Some(&initial), None, History::Full)
            .unwrap();
        assert_eq!(run.books.events.counts().get(&EventCode::Escalated), Some(&1));
        // Both components are the same: three measurements of variance 1 beside a prior of variance 1.
        let last = run.filtered.at(2);
        assert!(
            (&last.mean - DVector::from_element(2, 0.75)).amax() < 1e-11,
            "{}",
            last.mean
        );
        assert!(
            (&last.cov - DMatrix::from_element(2, 2, 0.25)).amax() < 1e-11,
            "{}",
            last.cov
        );
    }
}

/// One step is made by roots too where it has to be, and strict filters say so.
#[test]
fn single_steps_are_made_by_roots_where_they_must() {
    let trial = trials(Form::Joseph, 1e18).remove(0);
    let predicted = trial.filter.predict(&trial.initial.state, 1.0, None).unwrap();
    let plain = trial.filter.clone().with_form(Form::SquareRoot).unwrap();
    assert_eq!(predicted, plain.predict(&trial.initial.state, 1.0, None).unwrap());
    let strict = trial.filter.clone().with_strict();
    let refused = strict.predict(&trial.initial.state, 1.0, None);
    assert!(matches!(refused, Err(Error::Strict { .. })));
}
