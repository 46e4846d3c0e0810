//! Extended Kalman update: the sensor linearised at the predicted state, or again and again at the posterior.
//!
//! | symbol | name here    | shape | meaning                                             |
//! |--------|--------------|-------|-----------------------------------------------------|
//! | x⁻, P⁻ | `prior`      | n, n×n | the state before the measurement                   |
//! | z, h   | `measurement`, `expected` | m | reported, and expected of a state           |
//! | H_i    | `jacobian`   | m×n   | ∂h/∂x at x_i                                        |
//! | K_i    |              | n×m   | the gain of H_i and P⁻                              |
//!
//! r = z − h(x⁻) with angles wrapped, H = ∂h/∂x at x⁻; then the update of [`super::kalman`].
//! For a linear sensor this is the Kalman update itself.
//! Second order: the mean and variance that the curvature of h adds, [`Sensor::curvature`], count as well: h(x⁻) + ½ tr(G P)
//! is expected, with R + ½ tr(G P G P). It matters where the state is as uncertain as the ray is long.
//!
//! Iterated (`iterations` > 1): x_0 = x⁻,  x_{i+1} = x⁻ + K_i (z − h(x_i) − H_i (x⁻ − x_i)): Gauss-Newton on
//! ‖x − x⁻‖² in P⁻ plus ‖z − h(x)‖² in R. It ends with the count, or when no component of x moves by more than
//! [`SMALL_STEP`] of its standard deviation before the measurement. Innovation, NIS and likelihood are those at x⁻; the
//! covariance is that of the last H.
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §10.3, second order §10.3.2, iterated §10.5.2; Bell, Cathey (1993), The
//! iterated Kalman filter update as a Gauss-Newton method, IEEE Trans. AC 38(2).
//! Deviation: a linear sensor is not linearised twice, so that iterating changes no bit there.

use nalgebra::DVector;

use super::correction::Correction;
use super::kalman::{MeasurementPrediction, Update, copy_rows};
use crate::error::{Result, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::kernel;
use crate::model::Sensor;
use crate::model::sensor::wrap_angle;

/// An iteration that moves every component of the state by less than this share of its standard deviation is the last.
pub const SMALL_STEP: f64 = 1e-9;

/// How a sensor that is not linear is linearised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// At the state before the measurement.
    Once,
    /// At most so many times, at least once.
    Iterated(usize),
    /// At the state before the measurement, with the sensor's curvature.
    SecondOrder,
}

/// What a sensor is expected to report of one state, linearised there.
#[derive(Debug, Clone)]
pub struct Linearised {
    /// h(x⁻), length m.
    pub expected: DVector<f64>,
    /// Covariances and gain.
    pub prediction: MeasurementPrediction,
}

impl Linearised {
    fn sized(n: usize, m: usize) -> Self {
        Self {
            expected: DVector::zeros(m),
            prediction: MeasurementPrediction::sized(n, m),
        }
    }

    /// h and H at `mean`.
    fn at(&mut self, mean: &DVector<f64>, sensor: &dyn Sensor, platform: Option<&DVector<f64>>) -> Result<()> {
        let (expected, jacobian) = (self.expected.as_mut_slice(), &mut self.prediction.jacobian);
        sensor.linearise_into(mean, platform, expected, jacobian)
    }
}

/// Linearises `sensor` at the mean of `prior`.
pub fn linearise(prior: &Gaussian, sensor: &dyn Sensor, platform: Option<&DVector<f64>>) -> Result<Linearised> {
    let mut out = Linearised::sized(prior.dim(), sensor.measurement_dim());
    out.at(&prior.mean, sensor, platform)?;
    copy_rows(&sensor.noise(), &mut out.prediction.noise);
    out.prediction.prepare(prior.cov.as_slice())?;
    Ok(out)
}

/// Updates `prior` by one measurement of length m by this rule; NaN components were not observed.
pub fn update(
    prior: &Gaussian,
    sensor: &dyn Sensor,
    measurement: &DVector<f64>,
    platform: Option<&DVector<f64>>,
    rule: Rule,
) -> Result<Update> {
    require_size("measurement", sensor.measurement_dim(), measurement.len())?;
    let mut look = Look::new(prior.dim(), sensor);
    let target = Target {
        prior,
        sensor,
        platform,
    };
    look.expect(&target, measurement.as_slice(), rule)?;
    look.correct(&target, measurement.as_slice(), rule)?;
    Ok(look.record())
}

/// One state and the sensor that sees it.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    pub(super) prior: &'a Gaussian,
    pub(super) sensor: &'a dyn Sensor,
    pub(super) platform: Option<&'a DVector<f64>>,
}

/// A measurement compared with what was expected of it. Its memory serves one epoch after another.
#[derive(Debug, Clone)]
pub(super) struct Look {
    pub(super) linearised: Linearised,
    /// NaN where not observed; a screen may set more of them before the correction.
    pub(super) innovation: DVector<f64>,
    pub(super) correction: Correction,
    again: Linearised,
    point: DVector<f64>,
    pseudo: Vec<f64>,
}

impl Look {
    /// Memory for one kind of state and one sensor, whose own R is set.
    pub(super) fn new(n: usize, sensor: &dyn Sensor) -> Self {
        let m = sensor.measurement_dim();
        let mut linearised = Linearised::sized(n, m);
        copy_rows(&sensor.noise(), &mut linearised.prediction.noise);
        Self {
            again: linearised.clone(),
            linearised,
            innovation: DVector::zeros(m),
            correction: Correction::new(n, m),
            point: DVector::zeros(n),
            pseudo: vec![0.0; m],
        }
    }

    /// Sets R, m×m, for the epochs to come.
    pub(super) fn set_noise(&mut self, noise: &[f64]) {
        for linearised in [&mut self.linearised, &mut self.again] {
            linearised.prediction.noise.copy_from_slice(noise);
        }
    }

    /// Linearises at the prior and forms the innovation.
    pub(super) fn expect(&mut self, target: &Target<'_>, measurement: &[f64], rule: Rule) -> Result<()> {
        let linearised = &mut self.linearised;
        linearised.at(&target.prior.mean, target.sensor, target.platform)?;
        if rule == Rule::SecondOrder
            && let Some(curvature) = target.sensor.curvature(target.prior).transpose()?
        {
            linearised.expected += curvature.shift;
            // R of the epoch; what it adds to is kept in `again`, which this rule does not use.
            let own = &self.again.prediction.noise;
            for (i, noise) in linearised.prediction.noise.iter_mut().enumerate() {
                *noise = own[i] + curvature.noise.as_slice()[i];
            }
        }
        linearised.prediction.prepare(target.prior.cov.as_slice())?;
        residual_into(
            target.sensor,
            measurement,
            linearised.expected.as_slice(),
            self.innovation.as_mut_slice(),
        );
        Ok(())
    }

    /// Corrects the prior by the innovation.
    pub(super) fn correct(&mut self, target: &Target<'_>, measurement: &[f64], rule: Rule) -> Result<()> {
        let prior = target.prior;
        let iterations = if let Rule::Iterated(count) = rule { count } else { 1 };
        self.correction
            .apply(&self.linearised.prediction, prior.into(), self.innovation.as_slice())?;
        if target.sensor.is_linear() || self.correction.dof == 0 {
            return Ok(());
        }
        for _ in 1..iterations {
            self.point.copy_from(&self.correction.posterior.mean);
            self.again.at(&self.point, target.sensor, target.platform)?;
            self.again.prediction.prepare(prior.cov.as_slice())?;
            residual_into(
                target.sensor,
                measurement,
                self.again.expected.as_slice(),
                &mut self.pseudo,
            );
            let n = prior.dim();
            for (r, h) in self
                .pseudo
                .iter_mut()
                .zip(self.again.prediction.jacobian.chunks_exact(n.max(1)))
            {
                *r -= kernel::dot(h, prior.mean.as_slice()) - kernel::dot(h, self.point.as_slice());
            }
            self.correction
                .again(&self.again.prediction, prior.into(), &self.pseudo)?;
            let moved = |i: usize| {
                let step = self.correction.posterior.mean[i] - self.point[i];
                step * step > SMALL_STEP * SMALL_STEP * prior.cov[(i, i)]
            };
            if !(0..n).any(moved) {
                break;
            }
        }
        Ok(())
    }

    fn record(self) -> Update {
        self.correction.record(&self.linearised.prediction, self.innovation)
    }
}

/// z − h with angles wrapped, NaN where z is.
fn residual_into(sensor: &dyn Sensor, measurement: &[f64], expected: &[f64], out: &mut [f64]) {
    for ((r, z), h) in out.iter_mut().zip(measurement).zip(expected) {
        *r = z - h;
    }
    for &i in sensor.angles() {
        out[i] = wrap_angle(out[i]);
    }
}
