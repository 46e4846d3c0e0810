//! Fixes of sensors that report a position or pose as it is, and of a camera.

use nalgebra::DVector;

use super::camera::unobservable;
use super::camera_fix::{POINTS, whole};
use super::{CameraSensor, Fix, PoseSensor, PositionFix, PositionSensor, Sensor};
use crate::error::Result;
use crate::gaussian::Gaussian;

/// The measurement itself.
fn reported(sensor: &dyn Sensor, measurement: &DVector<f64>) -> Result<Fix> {
    crate::error::require_size("measurement", sensor.measurement_dim(), measurement.len())?;
    crate::error::require_finite("measurement", measurement.iter())?;
    Ok(Fix {
        position: Gaussian {
            mean: measurement.clone(),
            cov: sensor.noise(),
        },
        statistic: 0.0,
        dof: 0,
        p_value: 1.0,
        mirror: None,
    })
}

impl PositionFix for PositionSensor {
    fn fix(&self, measurement: &DVector<f64>) -> Result<Fix> {
        reported(self, measurement)
    }
    fn gathers(&self) -> bool {
        true
    }
}

impl PositionFix for PoseSensor {
    fn fix(&self, measurement: &DVector<f64>) -> Result<Fix> {
        reported(self, measurement)
    }
    fn angles(&self) -> &[usize] {
        Sensor::angles(self)
    }
}

impl PositionFix for CameraSensor {
    fn fix(&self, measurement: &DVector<f64>) -> Result<Fix> {
        let fix = CameraSensor::fix(self, measurement)?;
        if fix.mirror.is_some() {
            let reason = "the image fits two attitudes nearly as well, as that of a plane far away does";
            return Err(unobservable(reason.into()));
        }
        Ok(fix)
    }
    fn redundancy(&self) -> usize {
        self.measurement_dim().saturating_sub(6)
    }
    fn sufficient(&self, measurement: &[f64]) -> bool {
        whole(measurement).len() >= POINTS
    }
}
