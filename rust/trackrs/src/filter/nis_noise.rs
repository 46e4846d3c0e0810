//! One scalar of motion noise that follows the normalised innovations.
//!
//! | symbol | name here | shape | meaning                                                 |
//! |--------|-----------|-------|---------------------------------------------------------|
//! | q      | `density` |       | spectral density of the noisiest axis                   |
//! | Q₁     |           | d×d   | the motion's own densities over the largest of them     |
//! | η      | `eta`     |       | rate                                                    |
//! | ε, m   | `nis`, `dof` |    | normalised innovation squared and its degrees of freedom |
//!
//! ln q ← clip(ln q + η (min(ε/m, cap) − 1), ln q_min, ln q_max): q grows while innovations are larger than expected.
//! R stays as it is: its errors up to a factor of 4 are made up for, but a larger R puts the filter to sleep.
//! Reference: spec label H24; the paper has nothing of the kind.

use nalgebra::{DMatrix, DVector};

use super::adaptation::Corrected;
use crate::error::{Error, Result, require_positive};
use crate::linalg::copy_rows;
use crate::model::{Motion, NoiseInput};

/// Motion noise scaled by the innovations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NisScaledNoise {
    /// Lowest and highest density of the noisiest axis.
    pub psd_limits: [f64; 2],
    /// Rate, in (0, 1].
    pub eta: f64,
    /// Largest ε/m that counts, above 1.
    pub cap: f64,
}

impl NisScaledNoise {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        let [min, max] = self.psd_limits;
        require_positive("psd_limits", min)?;
        require_positive("psd_limits", max)?;
        if max < min {
            return Err(Error::invalid(
                "psd_limits",
                format!("{min} to {max}"),
                "must be in order",
            ));
        }
        if !(self.eta > 0.0 && self.eta <= 1.0) {
            return Err(Error::invalid("eta", self.eta, "must be above 0 and at most 1"));
        }
        if !(self.cap > 1.0 && self.cap.is_finite()) {
            return Err(Error::invalid("cap", self.cap, "must be finite and above 1"));
        }
        Ok(())
    }
}

/// The noise in force.
#[derive(Debug, Clone)]
pub struct NisMemory {
    rule: NisScaledNoise,
    own: DMatrix<f64>,
    largest: f64,
    density: f64,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    step_noise: Vec<f64>,
}

impl NisMemory {
    pub(super) fn new(rule: NisScaledNoise, motion: &dyn Motion, r: DMatrix<f64>) -> Result<Self> {
        let own = motion
            .noise_input(1.0)
            .map_or_else(|| DMatrix::zeros(0, 0), |input| input.cov);
        let largest = own.diagonal().iter().copied().fold(0.0, f64::max);
        require_positive("noise of the motion", largest)?;
        let n = motion.state_dim();
        let [min, max] = rule.psd_limits;
        let density = largest.clamp(min, max);
        Ok(Self {
            rule,
            q: &own * (density / largest),
            own,
            largest,
            density,
            r,
            step_noise: vec![0.0; n * n],
        })
    }

    pub(super) fn q(&self) -> &DMatrix<f64> {
        &self.q
    }

    pub(super) fn r(&self) -> &DMatrix<f64> {
        &self.r
    }

    pub(super) fn step_noise(&mut self, motion: &dyn Motion, state: &DVector<f64>, dt: f64) -> &[f64] {
        match motion.noise_input_at(state, dt) {
            Some(input) => copy_rows(&entered(&input, &self.q), &mut self.step_noise),
            None => copy_rows(&motion.noise_at(state, dt), &mut self.step_noise),
        }
        &self.step_noise
    }

    pub(super) fn push(&mut self, corrected: &Corrected<'_>) {
        if corrected.dof == 0 {
            return;
        }
        let ratio = (corrected.nis / corrected.dof as f64).min(self.rule.cap);
        let [min, max] = self.rule.psd_limits;
        self.density = (self.density * libm::exp(self.rule.eta * (ratio - 1.0))).clamp(min, max);
        self.q = &self.own * (self.density / self.largest);
    }
}

/// Γ (I_r ⊗ C) Γᵀ + rest with this C.
pub(super) fn entered(input: &NoiseInput, cov: &DMatrix<f64>) -> DMatrix<f64> {
    let whole = DMatrix::identity(input.repeat, input.repeat).kronecker(cov);
    let noise = &input.gain * whole * input.gain.transpose();
    match &input.rest {
        Some(rest) => noise + rest,
        None => noise,
    }
}
