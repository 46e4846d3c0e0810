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
//! covariance is that of the last H. With an attitude in the state all x_i are changes of x⁻, and H_i becomes H_i J_r(x_i − x⁻)
//! on its columns; where the result stands, the covariance is counted anew (`chart.rs`).
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §10.3, second order §10.3.2, iterated §10.5.2; Bell, Cathey (1993), The
//! iterated Kalman filter update as a Gauss-Newton method, IEEE Trans. AC 38(2).
//! Deviation: a linear sensor is not linearised twice, so that iterating changes no bit there.

use nalgebra::DVector;

use super::kalman::{MeasurementPrediction, Update};
use super::look::{Look, Target};
use super::sigma_points::SigmaPoints;
use super::square_root::{Form, factor_of};
use crate::error::{Result, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::copy_rows;
use crate::model::{Sensor, StateSpace};

/// An iteration that moves every component of the state by less than this share of its standard deviation is the last.
pub const SMALL_STEP: f64 = 1e-9;

/// How models that are not linear are linearised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rule {
    /// At the state before the measurement.
    Once,
    /// At most so many times, at least once.
    Iterated(usize),
    /// At the state before the measurement, with the sensor's curvature.
    SecondOrder,
    /// Not at all: moments come from sigma points ([`super::sigma_points`]), of the motion too.
    SigmaPoints(SigmaPoints),
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
    pub(super) fn sized(n: usize, m: usize) -> Self {
        Self {
            expected: DVector::zeros(m),
            prediction: MeasurementPrediction::sized(n, m),
        }
    }

    /// h and H at `mean`.
    pub(super) fn at(
        &mut self,
        mean: &DVector<f64>,
        sensor: &dyn Sensor,
        platform: Option<&DVector<f64>>,
    ) -> Result<()> {
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

/// What `sensor` is expected to report of `prior`, in whose space everything adds, by any rule: an iterated one linearises
/// at the mean.
pub fn expect(
    prior: &Gaussian,
    sensor: &dyn Sensor,
    platform: Option<&DVector<f64>>,
    rule: Rule,
) -> Result<Linearised> {
    if rule == Rule::Once {
        return linearise(prior, sensor, platform);
    }
    let mut expecting = Expecting::new(prior.dim(), sensor, rule)?;
    expecting.of(prior, sensor, platform)?;
    Ok(expecting.look.linearised)
}

/// The same of one state after another, in memory that serves them all.
#[derive(Debug)]
pub(crate) struct Expecting {
    look: Look,
}

impl Expecting {
    /// Of states of length n.
    pub(crate) fn new(n: usize, sensor: &dyn Sensor, rule: Rule) -> Result<Self> {
        Ok(Self {
            look: Look::new(StateSpace::euclidean(n), sensor, &rule.into())?,
        })
    }

    /// What that sensor is expected to report of `prior`.
    pub(crate) fn of(
        &mut self,
        prior: &Gaussian,
        sensor: &dyn Sensor,
        platform: Option<&DVector<f64>>,
    ) -> Result<&Linearised> {
        let target = Target {
            prior,
            factor: None,
            carried: None,
            sensor,
            platform,
        };
        self.look.expect_alone(&target)?;
        Ok(&self.look.linearised)
    }

    /// Memory for what [`Self::of`] found last.
    pub(crate) fn slot(&self) -> Linearised {
        self.look.linearised.clone()
    }

    /// Keeps what it found last in such a slot.
    pub(crate) fn keep(&mut self, slot: &mut Linearised) {
        std::mem::swap(&mut self.look.linearised, slot);
    }
}

/// How a filter finds the moments of its models and carries its covariances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Method {
    /// How the moments are found.
    pub rule: Rule,
    /// How covariances are carried.
    pub form: Form,
}

impl From<Rule> for Method {
    fn from(rule: Rule) -> Self {
        Self {
            rule,
            form: Form::Joseph,
        }
    }
}

/// Updates `prior`, in whose space everything adds, by one measurement of length m by this method; NaN components were not
/// observed.
pub fn update(
    prior: &Gaussian,
    sensor: &dyn Sensor,
    measurement: &DVector<f64>,
    platform: Option<&DVector<f64>>,
    method: impl Into<Method>,
) -> Result<Update> {
    update_in(
        StateSpace::euclidean(prior.dim()),
        prior,
        sensor,
        measurement,
        platform,
        method.into(),
    )
}

/// The same in any space.
pub fn update_in(
    space: StateSpace,
    prior: &Gaussian,
    sensor: &dyn Sensor,
    measurement: &DVector<f64>,
    platform: Option<&DVector<f64>>,
    method: Method,
) -> Result<Update> {
    require_size("state", space.dim, prior.dim())?;
    require_size("measurement", sensor.measurement_dim(), measurement.len())?;
    let mut look = Look::new(space, sensor, &method)?;
    let factor = factor_of(method.form, &prior.cov)?;
    let target = Target {
        prior,
        factor: factor.as_deref(),
        carried: None,
        sensor,
        platform,
    };
    look.expect(&target, measurement.as_slice())?;
    look.correct(&target, measurement.as_slice())?;
    Ok(look.record())
}
