//! Kalman prediction and update in Joseph form.
//!
//! | symbol | name here            | shape    | meaning                                    |
//! |--------|----------------------|----------|--------------------------------------------|
//! | x, P   | `prior`, `posterior` | n, n×n   | state estimate and its covariance          |
//! | F, Q   | `Motion`             | n×n      | transition and motion noise over dt        |
//! | H, R   | `jacobian`, `noise`  | m×n, m×m | sensor matrix and noise                    |
//! | r      | `innovation`         | m        | measured minus predicted, angles wrapped   |
//! | S      | `innovation_cov`     | m×m      | its covariance, S = L Lᵀ                   |
//! | K      | `gain`               | n×m      | P Hᵀ S⁻¹, by solving with L                |
//!
//! predict:  x⁻ = f(x) + u,  P⁻ = F P Fᵀ + Q
//! update:   S = H P Hᵀ + R,  x⁺ = x + K r,  P⁺ = (I − K H) P (I − K H)ᵀ + K R Kᵀ
//! ν = L⁻¹ r is the whitened innovation, |ν|² the NIS, ln N(r; 0, S) = −½ (|ν|² + ln det S + m ln 2π).
//!
//! The Joseph form is evaluated as B = P − K (H P), P⁺ = B + (K R − B Hᵀ) Kᵀ: the same products in another
//! order, n²m instead of n³ operations.
//!
//! A NaN in the measurement means that this component was not observed: its row is left out.
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §5.2; Joseph form ibid. (5.2.3-18).

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::symmetrise;
use crate::model::Motion;

const LN_TAU: f64 = 1.837_877_066_409_345_3;

/// A prediction and the matrices that made it, which a smoother needs again.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// The estimate before the measurement.
    pub state: Gaussian,
    /// F, n×n.
    pub transition: DMatrix<f64>,
    /// Q, n×n.
    pub noise: DMatrix<f64>,
}

impl Prediction {
    /// The prediction `dt` seconds ahead; `input` (length n) is added to the predicted state.
    pub fn new(prior: &Gaussian, motion: &dyn Motion, dt: f64, input: Option<&DVector<f64>>) -> Self {
        Self::with_noise(prior, motion, dt, input, motion.noise(dt))
    }

    /// The same with this Q instead of the model's own.
    pub fn with_noise(
        prior: &Gaussian,
        motion: &dyn Motion,
        dt: f64,
        input: Option<&DVector<f64>>,
        noise: DMatrix<f64>,
    ) -> Self {
        let transition = motion.jacobian(&prior.mean, dt);
        let mut mean = motion.propagate(&prior.mean, dt);
        if let Some(input) = input {
            mean += input;
        }
        let mut cov = &transition * &prior.cov * transition.transpose() + &noise;
        symmetrise(&mut cov);
        Self {
            state: Gaussian { mean, cov },
            transition,
            noise,
        }
    }
}

/// The estimate `dt` seconds later; `input` (length n) is added to the predicted state.
pub fn predict(prior: &Gaussian, motion: &dyn Motion, dt: f64, input: Option<&DVector<f64>>) -> Gaussian {
    Prediction::new(prior, motion, dt, input).state
}

/// Result of one measurement update.
#[derive(Debug, Clone, PartialEq)]
pub struct Update {
    /// The estimate after the measurement.
    pub posterior: Gaussian,
    /// Measured minus predicted, angles wrapped; NaN where not observed. Length m.
    pub innovation: DVector<f64>,
    /// Covariance of the innovation of all m components.
    pub innovation_cov: DMatrix<f64>,
    /// L⁻¹ × innovation over the observed components; NaN where not observed. Length m.
    pub whitened: DVector<f64>,
    /// Normalised innovation squared, chi-square with `dof` degrees of freedom if the model is right.
    pub nis: f64,
    /// Number of observed components.
    pub dof: usize,
    /// ln N(innovation; 0, S) over the observed components.
    pub log_likelihood: f64,
}

/// What a sensor is expected to report of one state: everything of an update that does not depend on the report.
#[derive(Debug, Clone)]
pub struct MeasurementPrediction {
    jacobian: DMatrix<f64>,
    noise: DMatrix<f64>,
    cross: DMatrix<f64>,
    cov: DMatrix<f64>,
    factor: Cholesky,
}

/// An innovation seen through the covariance it should have.
#[derive(Debug, Clone, PartialEq)]
pub struct WhitenedInnovation {
    /// L⁻¹ r.
    pub whitened: DVector<f64>,
    /// |L⁻¹ r|².
    pub nis: f64,
    /// Length of r.
    pub dof: usize,
    /// ln N(r; 0, S).
    pub log_likelihood: f64,
}

impl MeasurementPrediction {
    /// Prepares the update of `prior` by a sensor with this Jacobian and noise.
    pub fn new(prior: &Gaussian, jacobian: DMatrix<f64>, noise: DMatrix<f64>) -> Result<Self> {
        require_size("sensor Jacobian columns", prior.dim(), jacobian.ncols())?;
        require_size("sensor noise", jacobian.nrows(), noise.nrows())?;
        let cross = &prior.cov * jacobian.transpose();
        let mut cov = &jacobian * &cross + &noise;
        symmetrise(&mut cov);
        let factor = Cholesky::new(&cov, "innovation covariance")?;
        Ok(Self {
            jacobian,
            noise,
            cross,
            cov,
            factor,
        })
    }

    /// H, m×n.
    pub fn jacobian(&self) -> &DMatrix<f64> {
        &self.jacobian
    }

    /// S, m×m.
    pub fn cov(&self) -> &DMatrix<f64> {
        &self.cov
    }

    /// ln det S.
    pub fn log_determinant(&self) -> f64 {
        self.factor.log_determinant()
    }

    /// The innovation whitened by S; all components observed.
    pub fn whiten(&self, innovation: &DVector<f64>) -> WhitenedInnovation {
        let whitened = self.factor.whiten(innovation);
        let nis = whitened.norm_squared();
        let dof = innovation.len();
        WhitenedInnovation {
            whitened,
            nis,
            dof,
            log_likelihood: -0.5 * (nis + self.factor.log_determinant() + dof as f64 * LN_TAU),
        }
    }

    /// The same prediction for some of the components only.
    pub fn select(&self, prior: &Gaussian, components: &[usize]) -> Result<Self> {
        let noise = self.noise.select_rows(components).select_columns(components);
        Self::new(prior, self.jacobian.select_rows(components), noise)
    }

    /// The posterior for a fully observed innovation.
    pub fn posterior(&self, prior: &Gaussian, innovation: &DVector<f64>) -> Gaussian {
        let gain = self.factor.solve(&self.cross.transpose()).transpose();
        let mean = &prior.mean + &gain * innovation;
        let left = &prior.cov - &gain * self.cross.transpose();
        let rest = &gain * &self.noise - &left * self.jacobian.transpose();
        let mut cov = left + rest * gain.transpose();
        symmetrise(&mut cov);
        Gaussian { mean, cov }
    }

    /// The whole update record; NaN components of the innovation count as not observed.
    pub fn update(&self, prior: &Gaussian, innovation: &DVector<f64>) -> Result<Update> {
        require_size("innovation", self.cov.nrows(), innovation.len())?;
        if let Some(index) = innovation.iter().position(|v| v.is_infinite()) {
            return Err(Error::NonFinite {
                what: "measurement".into(),
                index,
            });
        }
        let observed: Vec<usize> = (0..innovation.len()).filter(|&i| !innovation[i].is_nan()).collect();
        let mut whitened = DVector::from_element(innovation.len(), f64::NAN);
        let (posterior, white) = if observed.len() == innovation.len() {
            (self.posterior(prior, innovation), self.whiten(innovation))
        } else {
            let part = self.select(prior, &observed)?;
            let innovation = innovation.select_rows(&observed);
            (part.posterior(prior, &innovation), part.whiten(&innovation))
        };
        for (slot, &i) in observed.iter().enumerate() {
            whitened[i] = white.whitened[slot];
        }
        Ok(Update {
            posterior: if observed.is_empty() { prior.clone() } else { posterior },
            innovation: innovation.clone(),
            innovation_cov: self.cov.clone(),
            whitened,
            nis: white.nis,
            dof: white.dof,
            log_likelihood: white.log_likelihood,
        })
    }
}
