//! What of a filter the lanes take over: its structure, and its steps axis by axis.

use crate::filter::extended::Rule;
use crate::filter::sequence::Filter;
use crate::filter::square_root::Form;
use crate::lanes::tracks::{AxisNoise, RawStep};
use crate::model::{Motion, MotionModel, SensorModel};

/// Dimensions and derivatives of what lanes know.
pub(super) fn structure(filter: &Filter) -> Option<(usize, usize)> {
    let plain = !filter.adapts()
        && filter.screen().is_none()
        && filter.steps() == 1
        && filter.method().form == Form::Joseph
        && !matches!(filter.method().rule, Rule::SecondOrder)
        && matches!(filter.sensor(), SensorModel::Position(_));
    let order = match filter.motion() {
        MotionModel::RandomWalk(_) => 1,
        MotionModel::ConstantVelocity(_) => 2,
        MotionModel::ConstantAcceleration(_) => 3,
        _ => return None,
    };
    plain.then(|| (filter.motion().position_dims(), order))
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
