//! Sensor models. A sensor knows which of its components are angles; every residual of them wraps.

mod camera;
mod camera_fix;
mod camera_start;
pub mod closed_form;
mod curvature;
mod direct_fix;
mod fix;
mod heard;
mod linear;
mod nuisance;
mod pose;
mod position;
mod position_fix;
mod presets;
mod range_array;
mod range_bearing;
mod sound_speed;
mod stack;

use std::fmt::Debug;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Vector3};
use serde::{Deserialize, Serialize};

use super::Motion;
use super::rotation::vector_between;
use crate::error::{Result, require_size};
use crate::gaussian::Gaussian;

pub use camera::{CameraSensor, Intrinsics};
pub use curvature::Curvature;
pub use fix::{Fix, MIRROR_GAP, Side};
pub use linear::LinearSensor;
pub use nuisance::Nuisance;
pub use pose::{AttitudeForm, PoseSensor};
pub use position::PositionSensor;
pub use position_fix::{PositionFix, VAGUE};
pub use range_array::{RangeArray, RangeArraySettings};
pub use range_bearing::RangeBearing;
pub use sound_speed::{Slowness, SoundSpeed, SpeedProfile};

/// How a sensor sees a state. `platform` is the position of the moving body that carries the sensor, where there is one.
pub trait Sensor: Debug + Send + Sync {
    /// Length m of a measurement.
    fn measurement_dim(&self) -> usize;
    /// Names of the measurement's components, length m.
    fn labels(&self) -> Vec<String>;
    /// Whether states of this motion can be observed; the error says why not.
    fn check(&self, motion: &dyn Motion) -> Result<()>;
    /// h(x), length m.
    fn observe(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DVector<f64>>;
    /// ∂h/∂x at `state`, m×n.
    fn jacobian(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>>;
    /// Writes h(x), length m, and ∂h/∂x, m×n row by row, where they are wanted. A sensor that is used in long runs does
    /// better than this default, which takes memory for both.
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        let (h, slope) = (self.observe(state, platform)?, self.jacobian(state, platform)?);
        require_size("expected measurement", expected.len(), h.len())?;
        require_size("sensor Jacobian rows", expected.len(), slope.nrows())?;
        require_size("sensor Jacobian columns", state.len(), slope.ncols())?;
        expected.copy_from_slice(h.as_slice());
        for (row, out) in slope.row_iter().zip(jacobian.chunks_exact_mut(state.len().max(1))) {
            out.iter_mut().zip(row.iter()).for_each(|(x, &value)| *x = value);
        }
        Ok(())
    }
    /// Writes h of several states of length n, one after the other in `states`, where they are wanted.
    fn observe_all(&self, states: &[f64], n: usize, platform: Option<&DVector<f64>>, out: &mut [f64]) -> Result<()> {
        let m = self.measurement_dim().max(1);
        for (state, out) in states.chunks_exact(n.max(1)).zip(out.chunks_exact_mut(m)) {
            let seen = self.observe(&DVector::from_column_slice(state), platform)?;
            require_size("expected measurement", out.len(), seen.len())?;
            out.copy_from_slice(seen.as_slice());
        }
        Ok(())
    }
    /// R, m×m.
    fn noise(&self) -> DMatrix<f64>;
    /// Which components are angles, in radians.
    fn angles(&self) -> &[usize] {
        &[]
    }
    /// Index of the first of three components that are a rotation vector, where there is one.
    fn rotation(&self) -> Option<usize> {
        None
    }
    /// Index in the state of the rotation vector that this sensor needs it to have, where it needs one.
    fn attitude(&self) -> Option<usize> {
        None
    }
    /// Whether h is linear, so that the plain Kalman filter applies.
    fn is_linear(&self) -> bool {
        false
    }
    /// Whether changes of the state and residuals of the measurement are related by a fixed matrix, also where these turn: then
    /// the derivative is all that there is to know, and sigma points find nothing else.
    fn is_linear_in_changes(&self) -> bool {
        self.is_linear()
    }
    /// Of measurements one after the other the first component that no target could cause, such as a negative range beyond its
    /// noise.
    fn impossible(&self, _measurements: &[f64]) -> Option<usize> {
        None
    }
    /// Number of coordinates a platform position must have, where the sensor can stand on one.
    fn platform_dims(&self) -> Option<usize> {
        None
    }
    /// The position that one measurement gives by itself, with its covariance, where it gives one.
    fn locate(&self, _measurement: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Option<Gaussian> {
        None
    }
    /// The sensor as one whose measurements fix positions well enough, and test them, for a filter to start by itself.
    fn position_fix(&self) -> Option<&dyn PositionFix> {
        None
    }
    /// Errors of the sensor that a filter estimates with the target, as extra components behind the kinematic state.
    fn nuisance(&self) -> Option<Nuisance> {
        None
    }
    /// What the curvature of h adds where the state is Gaussian; for the second-order filter, where the sensor has it.
    fn curvature(&self, _prior: &Gaussian) -> Option<Result<Curvature>> {
        None
    }
}

/// z − ẑ with the angles wrapped into (−π, π], and the rotation that leads from ẑ to z in place of the difference of rotation
/// vectors. A rotation vector with a NaN was not observed.
pub fn residual(sensor: &dyn Sensor, measured: &DVector<f64>, predicted: &DVector<f64>) -> DVector<f64> {
    let mut out = measured.clone();
    residual_into(sensor, measured.as_slice(), predicted.as_slice(), out.as_mut_slice());
    out
}

/// The same, length m each, without taking memory.
pub fn residual_into(sensor: &dyn Sensor, measured: &[f64], predicted: &[f64], out: &mut [f64]) {
    for ((r, z), expected) in out.iter_mut().zip(measured).zip(predicted) {
        *r = z - expected;
    }
    for &i in sensor.angles() {
        out[i] = wrap_angle(out[i]);
    }
    if let Some(at) = sensor.rotation() {
        let [z, expected] = [measured, predicted].map(|v| Vector3::from_column_slice(&v[at..at + 3]));
        let turn = if z.iter().all(|v| v.is_finite()) {
            vector_between(&expected, &z)
        } else {
            // An infinite component stays to be refused.
            z.map(|v| if v.is_infinite() { v } else { f64::NAN })
        };
        out[at..at + 3].copy_from_slice(turn.as_slice());
    }
}

/// The angle in (−π, π]; NaN stays NaN.
pub fn wrap_angle(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle > -PI && angle <= PI {
        return angle;
    }
    let wrapped = PI - (PI - angle).rem_euclid(TAU);
    // rem_euclid may round up to a full turn.
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

/// Checks that a platform position is finite and of the size that this sensor takes.
pub fn check_platform(sensor: &dyn Sensor, platform: Option<&DVector<f64>>) -> Result<()> {
    let Some(platform) = platform else {
        return Ok(());
    };
    require_size("platform", sensor.platform_dims().unwrap_or(0), platform.len())?;
    crate::error::require_finite("platform", platform.iter())
}

/// A sensor model held by value: one of the library's own, which can be saved, or the user's.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "kind")]
#[non_exhaustive]
pub enum SensorModel {
    /// See [`PositionSensor`].
    Position(PositionSensor),
    /// See [`RangeBearing`].
    RangeBearing(RangeBearing),
    /// See [`RangeArray`].
    RangeArray(RangeArray),
    /// See [`PoseSensor`].
    Pose(PoseSensor),
    /// See [`CameraSensor`].
    Camera(CameraSensor),
    /// See [`LinearSensor`].
    Linear(LinearSensor),
    /// A model from outside the library. It cannot be saved.
    #[serde(skip)]
    Custom(Arc<dyn Sensor>),
}

impl SensorModel {
    fn as_sensor(&self) -> &dyn Sensor {
        match self {
            Self::Position(s) => s,
            Self::RangeBearing(s) => s,
            Self::RangeArray(s) => s,
            Self::Pose(s) => s,
            Self::Camera(s) => s,
            Self::Linear(s) => s,
            Self::Custom(s) => s.as_ref(),
        }
    }
}

impl Sensor for SensorModel {
    fn measurement_dim(&self) -> usize {
        self.as_sensor().measurement_dim()
    }
    fn labels(&self) -> Vec<String> {
        self.as_sensor().labels()
    }
    fn check(&self, motion: &dyn Motion) -> Result<()> {
        self.as_sensor().check(motion)
    }
    fn observe(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        self.as_sensor().observe(state, platform)
    }
    fn jacobian(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        self.as_sensor().jacobian(state, platform)
    }
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        self.as_sensor().linearise_into(state, platform, expected, jacobian)
    }
    fn observe_all(&self, states: &[f64], n: usize, platform: Option<&DVector<f64>>, out: &mut [f64]) -> Result<()> {
        self.as_sensor().observe_all(states, n, platform, out)
    }
    fn noise(&self) -> DMatrix<f64> {
        self.as_sensor().noise()
    }
    fn angles(&self) -> &[usize] {
        self.as_sensor().angles()
    }
    fn rotation(&self) -> Option<usize> {
        self.as_sensor().rotation()
    }
    fn attitude(&self) -> Option<usize> {
        self.as_sensor().attitude()
    }
    fn is_linear(&self) -> bool {
        self.as_sensor().is_linear()
    }
    fn is_linear_in_changes(&self) -> bool {
        self.as_sensor().is_linear_in_changes()
    }
    fn impossible(&self, measurements: &[f64]) -> Option<usize> {
        self.as_sensor().impossible(measurements)
    }
    fn platform_dims(&self) -> Option<usize> {
        self.as_sensor().platform_dims()
    }
    fn locate(&self, measurement: &DVector<f64>, platform: Option<&DVector<f64>>) -> Option<Gaussian> {
        self.as_sensor().locate(measurement, platform)
    }
    fn position_fix(&self) -> Option<&dyn PositionFix> {
        self.as_sensor().position_fix()
    }
    fn nuisance(&self) -> Option<Nuisance> {
        self.as_sensor().nuisance()
    }
    fn curvature(&self, prior: &Gaussian) -> Option<Result<Curvature>> {
        self.as_sensor().curvature(prior)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    #[test]
    fn angles_wrap_into_the_half_open_turn() {
        for (angle, expected) in [
            (0.0, 0.0),
            (PI, PI),
            (-PI, PI),
            (1.5 * PI, -0.5 * PI),
            (-3.5 * PI, 0.5 * PI),
        ] {
            assert!((wrap_angle(angle) - expected).abs() < 1e-14, "{angle}");
        }
        for k in -5..=5 {
            let wrapped = wrap_angle(0.7 + TAU * f64::from(k));
            assert!((wrapped - 0.7).abs() < 1e-14);
        }
        assert!(wrap_angle(f64::NAN).is_nan());
    }
}
