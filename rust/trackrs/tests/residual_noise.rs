//! Noise from residuals: R by the sums of (H18), (H19) over every memory, and what is refused.

use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector};
use trackrs::filter::noise::EigenLimits;
use trackrs::filter::residual_noise::{Memory, RFrom, ResidualNoise};
use trackrs::filter::run::FilterRun;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{MotionModel, SensorModel};
use trackrs::stats::stream::Stream;
use trackrs::{Error, Gaussian};

const ROWS: usize = 12;
const MEMORIES: [Memory; 3] = [Memory::Cumulative, Memory::Window(4), Memory::Fading(0.8)];

fn filter() -> Filter {
    let motion = ConstantVelocity::new(KinematicNoise::Psd(vec![0.5, 0.5])).unwrap();
    let sensor = PositionSensor::new(vec![1.0, 2.0]).unwrap();
    Filter::kalman(MotionModel::ConstantVelocity(motion), SensorModel::Position(sensor)).unwrap()
}

fn rule(memory: Memory, r: RFrom, diagonal: bool) -> ResidualNoise {
    ResidualNoise {
        memory,
        r,
        q: None,
        r_limits: EigenLimits { min: 1e-3, max: 1e3 },
        q_floor: 0.0,
        diagonal,
        first_epoch: 1,
    }
}

fn measurements(missing: bool) -> Vec<DVector<f64>> {
    let mut stream = Stream::new(5, 0);
    let mut values: Vec<_> = (0..ROWS)
        .map(|k| DVector::from_fn(2, |_, _| k as f64 + 3.0 * stream.normal()))
        .collect();
    if missing {
        values[3][0] = f64::NAN;
        values[6].fill(f64::NAN);
    }
    values
}

fn run(rule: ResidualNoise, values: &[DVector<f64>]) -> FilterRun {
    let times: Vec<f64> = (1..=ROWS).map(|k| k as f64).collect();
    let state = Gaussian {
        mean: DVector::zeros(4),
        cov: DMatrix::identity(4, 4) * 4.0,
    };
    let initial = InitialState { time: 0.0, state };
    let filter = filter().with_adaptation(rule).unwrap();
    filter.run(&times, values, Some(&initial), None, History::Full).unwrap()
}

/// The mean of what is remembered of these products, oldest first.
fn mean(memory: Memory, products: &[f64]) -> f64 {
    let n = products.len();
    let weight = |i: usize| match memory {
        Memory::Cumulative => 1.0,
        Memory::Window(size) => f64::from(u8::from(i + size >= n)),
        Memory::Fading(factor) => libm::pow(factor, (n - 1 - i) as f64),
    };
    let sum: f64 = products
        .iter()
        .enumerate()
        .map(|(i, product)| weight(i) * product)
        .sum();
    sum / (0..n).map(weight).sum::<f64>()
}

fn r_hat(run: &FilterRun, row: usize) -> DMatrix<f64> {
    DMatrix::from_row_slice(2, 2, run.r_hat.at(row))
}

fn cov(stack: &trackrs::gaussian::Gaussians, row: usize) -> DMatrix<f64> {
    stack.at(row).cov.view((0, 0), (2, 2)).into_owned()
}

#[test]
fn residuals_after_the_update_give_r_in_every_memory() {
    let values = measurements(false);
    for memory in MEMORIES {
        let run = run(rule(memory, RFrom::Resid, false), &values);
        let mut residuals: Vec<DVector<f64>> = Vec::new();
        for (row, value) in values.iter().enumerate() {
            residuals.push(value - run.filtered.at(row).mean.rows(0, 2));
            let of = |i: usize, j: usize| residuals.iter().map(|e| e[i] * e[j]).collect::<Vec<_>>();
            let written_out = DMatrix::from_fn(2, 2, |i, j| mean(memory, &of(i, j))) + cov(&run.filtered, row);
            assert_relative_eq!(r_hat(&run, row), written_out, epsilon = 1e-9);
        }
    }
}

/// Each component counts for itself, a missing one not at all; what falls below its lower limit stands there.
#[test]
fn innovations_give_a_diagonal_r_component_by_component() {
    let values = measurements(true);
    let mut clamped = 0;
    for memory in [MEMORIES[0], MEMORIES[2]] {
        let run = run(rule(memory, RFrom::Innov, true), &values);
        for i in 0..2 {
            let (mut squares, mut expected) = (Vec::new(), [1.0, 4.0][i]);
            for (row, value) in values.iter().enumerate() {
                if !value[i].is_nan() {
                    squares.push(run.innovations.at(row)[i].powi(2));
                }
                if value.iter().any(|v| !v.is_nan()) {
                    let raw = mean(memory, &squares) - cov(&run.predicted, row)[(i, i)];
                    clamped += usize::from(raw < 1e-3);
                    expected = raw.clamp(1e-3, 1e3);
                }
                assert_relative_eq!(r_hat(&run, row)[(i, i)], expected, epsilon = 1e-9);
            }
        }
    }
    assert!(clamped > 0, "the limit is never met");
}

#[test]
fn parameters_are_refused_by_name() {
    let good = rule(Memory::Cumulative, RFrom::Paper, false);
    let limits = |min, max| ResidualNoise {
        r_limits: EigenLimits { min, max },
        ..good
    };
    for (rule, culprit) in [
        (rule(Memory::Window(0), RFrom::Resid, false), "window"),
        (rule(Memory::Fading(1.0), RFrom::Resid, false), "fading"),
        (rule(Memory::Fading(f64::NAN), RFrom::Resid, false), "fading"),
        (limits(0.0, 1.0), "r_limits"),
        (limits(2.0, 1.0), "r_limits"),
        (ResidualNoise { q_floor: -1.0, ..good }, "q_floor_psd"),
    ] {
        match filter().with_adaptation(rule).unwrap_err() {
            Error::InvalidParameter { name, .. } => assert_eq!(name, culprit),
            other => panic!("{other:?}"),
        }
    }
}
