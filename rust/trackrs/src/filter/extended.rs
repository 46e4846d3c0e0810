//! Extended Kalman update: the sensor linearised at the predicted state.
//!
//! H = ∂h/∂x at x⁻, r = z − h(x⁻) with angles wrapped; then the update of [`super::kalman`].
//! For a linear sensor this is the Kalman update itself.
//! Second order: the mean and variance that the curvature of h adds, [`Sensor::curvature`], count as well: h(x⁻) + ½ tr(G P)
//! is expected, with R + ½ tr(G P G P). It matters where the state is as uncertain as the ray is long.
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §10.3; second order §10.3.2.

use nalgebra::{DMatrix, DVector};

use super::kalman::{MeasurementPrediction, Update};
use crate::error::{Result, require_size};
use crate::gaussian::Gaussian;
use crate::model::{Sensor, sensor};

/// What a sensor is expected to report of one state, linearised there.
#[derive(Debug, Clone)]
pub struct Linearised {
    /// h(x⁻), length m.
    pub expected: DVector<f64>,
    /// Covariances and gain.
    pub prediction: MeasurementPrediction,
}

/// Linearises `sensor` at the mean of `prior`.
pub fn linearise(prior: &Gaussian, sensor: &dyn Sensor, platform: Option<&DVector<f64>>) -> Result<Linearised> {
    linearise_with_noise(prior, sensor, platform, sensor.noise())
}

/// The same with this R instead of the sensor's own.
pub fn linearise_with_noise(
    prior: &Gaussian,
    sensor: &dyn Sensor,
    platform: Option<&DVector<f64>>,
    noise: DMatrix<f64>,
) -> Result<Linearised> {
    let jacobian = sensor.jacobian(&prior.mean, platform)?;
    Ok(Linearised {
        expected: sensor.observe(&prior.mean, platform)?,
        prediction: MeasurementPrediction::new(prior, jacobian, noise)?,
    })
}

/// The same with the curvature of the sensor, where it has one.
pub fn linearise_second_order(
    prior: &Gaussian,
    sensor: &dyn Sensor,
    platform: Option<&DVector<f64>>,
    noise: DMatrix<f64>,
) -> Result<Linearised> {
    let Some(curvature) = sensor.curvature(prior).transpose()? else {
        return linearise_with_noise(prior, sensor, platform, noise);
    };
    let mut out = linearise_with_noise(prior, sensor, platform, noise + curvature.noise)?;
    out.expected += curvature.shift;
    Ok(out)
}

/// Updates `prior` by one measurement of length m; NaN components were not observed.
pub fn update(
    prior: &Gaussian,
    sensor: &dyn Sensor,
    measurement: &DVector<f64>,
    platform: Option<&DVector<f64>>,
) -> Result<Update> {
    linearise(prior, sensor, platform)?.update(prior, sensor, measurement)
}

impl Linearised {
    /// Updates the `prior` that was linearised at by one measurement of length m; NaN components were not observed.
    pub fn update(&self, prior: &Gaussian, sensor: &dyn Sensor, measurement: &DVector<f64>) -> Result<Update> {
        require_size("measurement", sensor.measurement_dim(), measurement.len())?;
        let innovation = sensor::residual(sensor, measurement, &self.expected);
        self.prediction.update(prior, &innovation)
    }
}
