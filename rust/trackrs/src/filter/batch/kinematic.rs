//! What of a filter the lanes take over: its structure, and its steps axis by axis.

use crate::filter::extended::Rule;
use crate::filter::sequence::Filter;
use crate::filter::square_root::Form;
use crate::lanes::linear::MOST;
use crate::lanes::tracks::{AxisNoise, RawSensor, RawStep};
use crate::linalg::cholesky::Cholesky;
use crate::model::sensor::LinearSensor;
use crate::model::{Motion, MotionModel, Sensor, SensorModel};

/// Of a component's noise given the components before it, as a part of its own variance: with less, taking one after the other
/// loses digits.
const INDEPENDENT: f64 = 1e-6;

/// What lanes know of a filter.
pub(super) struct Structure {
    /// Axes.
    pub(super) dims: usize,
    /// Blocks of the state.
    pub(super) order: usize,
    pub(super) sensor: RawSensor,
}

/// `None` for filters that are not for lanes.
pub(super) fn structure(filter: &Filter) -> Option<Structure> {
    let plain = !filter.adapts()
        && filter.screen().is_none()
        && filter.steps() == 1
        && filter.method().form == Form::Joseph
        && !matches!(filter.method().rule, Rule::SecondOrder);
    let order = match filter.motion() {
        MotionModel::RandomWalk(_) => 1,
        MotionModel::ConstantVelocity(_) => 2,
        MotionModel::ConstantAcceleration(_) => 3,
        _ => return None,
    };
    let sensor = match filter.sensor() {
        SensorModel::Position(sensor) => RawSensor::Positions(sensor.noise().diagonal().as_slice().to_vec()),
        SensorModel::Linear(sensor) => linear(sensor)?,
        _ => return None,
    };
    plain.then(|| Structure {
        dims: filter.motion().position_dims(),
        order,
        sensor,
    })
}

/// `None` where there are too many components or they are nearly dependent.
fn linear(sensor: &LinearSensor) -> Option<RawSensor> {
    let noise = sensor.noise();
    let root = Cholesky::new(&noise, "R").ok()?;
    let root = root.lower();
    let independent = |k: usize| root[(k, k)] * root[(k, k)] >= INDEPENDENT * noise[(k, k)];
    let fits = (1..=MOST).contains(&noise.nrows()) && (0..noise.nrows()).all(independent);
    // Row by row; R is symmetric.
    fits.then(|| RawSensor::Linear {
        rows: sensor.matrix().transpose().as_slice().to_vec(),
        offset: sensor.offset().as_slice().to_vec(),
        noise: noise.as_slice().to_vec(),
    })
}

/// Time steps and the noise of each, axis by axis.
pub(super) fn steps(motion: &MotionModel, start: f64, times: &[f64]) -> Vec<RawStep> {
    let dims = motion.position_dims();
    let order = motion.state_dim() / dims;
    let mut previous = start;
    let mut last: Option<RawStep> = None;
    let mut out = Vec::with_capacity(times.len());
    for &time in times {
        let dt = time - previous;
        previous = time;
        let step = match last {
            Some(step) if step.dt.to_bits() == dt.to_bits() => step,
            _ => {
                let q = motion.noise(dt);
                let mut noise: AxisNoise = [[0.0; 3]; 6];
                let pairs = (0..order).flat_map(|row| (0..=row).map(move |column| (row, column)));
                for (entry, (row, column)) in noise.iter_mut().zip(pairs) {
                    for (axis, value) in entry.iter_mut().enumerate().take(dims) {
                        *value = q[(row * dims + axis, column * dims + axis)];
                    }
                }
                RawStep { dt, noise }
            }
        };
        last = Some(step);
        out.push(step);
    }
    out
}
