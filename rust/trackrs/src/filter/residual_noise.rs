//! Noise estimated from the residuals of the last measurements.
//!
//! | symbol | name here    | shape | meaning                                                    |
//! |--------|--------------|-------|------------------------------------------------------------|
//! | ν      | `innovation` | m     | z − h(x⁻)                                                  |
//! | ε      |              | m     | z − h(x⁺)                                                  |
//! | H      |              | m×n   | ∂h/∂x at x⁺                                                |
//! | C_ν, C_ε | `of_innovations`, `of_residuals` | m×m | mean of ν νᵀ and ε εᵀ over the memory     |
//! | K      | `gain`       | n×m   | gain of the last update                                    |
//!
//! memory (H18): cumulative 1/k, the last N epochs, or fading C ← C + (1−λ)/(1−λᵏ) (e eᵀ − C)
//! R (H19): `Paper` C_ε − H P⁺ Hᵀ, `Resid` C_ε + H P⁺ Hᵀ, `Innov` C_ν − H P⁻ Hᵀ; then its eigenvalues are clipped
//! Q (H20): `Paper` K C_ε Kᵀ, `Innovation` K C_ν Kᵀ, plus a floor of a spectral density. It is added once per prediction
//! step, whatever its length.
//!
//! `Paper` has the sign of R wrong: in an optimal filter E ε εᵀ = R − H P⁺ Hᵀ, so R falls until it meets its lower limit and
//! the filter repeats its measurements. K C Kᵀ has one direction per measured component and shrinks with the gains it makes.
//! A fixed density, or [`super::nis_noise`], serves better; this file is for comparison with the paper.
//!
//! Reference: Sun, Zhang (2015), Pose prediction method for moving helmet based on Kalman filtering, eqs. (17)–(20); Mohamed,
//! Schwarz (1999) for `Innovation`. Spec labels H17–H20.
//! Deviations: the limits and the floor, about which the paper says nothing; other memories than the cumulative one. Epochs
//! that did not use all components count for a diagonal R alone, each component for itself, and for no Q.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use super::adaptation::Corrected;
use super::nis_noise::entered;
use super::noise::{EigenLimits, ProcessedEpoch};
use crate::error::{Error, Result, require_finite, require_non_negative};
use crate::linalg::copy_rows;
use crate::linalg::symmetric::clip_eigenvalues;
use crate::model::sensor::residual_into;
use crate::model::{Motion, Sensor};

/// Which residuals count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Memory {
    /// All, equally: the paper.
    Cumulative,
    /// The last so many, at least 1.
    Window(usize),
    /// All, each λ times as much as the one after it; λ in (0, 1).
    Fading(f64),
}

/// How R is made of the residuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RFrom {
    /// As printed, with the wrong sign.
    Paper,
    /// From the residuals after the update.
    Resid,
    /// From the innovations.
    Innov,
}

/// How Q is made of the residuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QFrom {
    /// As printed, of residuals after the update.
    Paper,
    /// Of the innovations.
    Innovation,
}

/// Noise from residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualNoise {
    /// Which residuals count.
    pub memory: Memory,
    /// How R is made.
    pub r: RFrom,
    /// How Q is made; `None`: the motion's own.
    pub q: Option<QFrom>,
    /// Limits of the eigenvalues of R.
    pub r_limits: EigenLimits,
    /// Density of white noise added to Q on every axis.
    pub q_floor: f64,
    /// Whether R is kept diagonal.
    pub diagonal: bool,
    /// Estimates are used once so many epochs have been processed.
    pub first_epoch: usize,
}

impl ResidualNoise {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        match self.memory {
            Memory::Window(0) => return Err(Error::invalid("window", 0, "must be at least 1")),
            Memory::Fading(factor) if !(factor > 0.0 && factor < 1.0) => {
                return Err(Error::invalid("fading", factor, "must lie strictly between 0 and 1"));
            }
            _ => {}
        }
        let EigenLimits { min, max } = self.r_limits;
        require_finite("r_limits", [&min, &max])?;
        if !(min > 0.0 && max >= min) {
            let value = format!("{min} to {max}");
            return Err(Error::invalid("r_limits", value, "must be positive and in order"));
        }
        require_non_negative("q_floor_psd", self.q_floor)
    }
}

/// Running means of e eᵀ, each component pair by its own count.
#[derive(Debug, Clone)]
struct Mean {
    memory: Memory,
    recent: VecDeque<DVector<f64>>,
    counts: DMatrix<f64>,
    cov: DMatrix<f64>,
}

impl Mean {
    fn new(memory: Memory, m: usize) -> Self {
        Self {
            memory,
            recent: VecDeque::new(),
            counts: DMatrix::zeros(m, m),
            cov: DMatrix::zeros(m, m),
        }
    }

    /// Takes in a residual; NaN components do not count.
    fn push(&mut self, residual: DVector<f64>) {
        if let Memory::Window(size) = self.memory {
            if self.recent.len() == size {
                self.recent.pop_front();
            }
            self.recent.push_back(residual);
            self.counts.fill(0.0);
            self.cov.fill(0.0);
            for i in 0..self.recent.len() {
                let e = self.recent[i].clone();
                self.add(&e, |count| 1.0 / count);
            }
            return;
        }
        match self.memory {
            Memory::Fading(factor) => self.add(&residual, |k| (1.0 - factor) / (1.0 - libm::pow(factor, k))),
            _ => self.add(&residual, |count| 1.0 / count),
        }
    }

    fn add(&mut self, e: &DVector<f64>, share: impl Fn(f64) -> f64) {
        for i in 0..e.len() {
            for j in 0..e.len() {
                let product = e[i] * e[j];
                if !product.is_nan() {
                    self.counts[(i, j)] += 1.0;
                    let b = share(self.counts[(i, j)]);
                    self.cov[(i, j)] += b * (product - self.cov[(i, j)]);
                }
            }
        }
    }

    fn clear(&mut self) {
        self.recent.clear();
        self.counts.fill(0.0);
        self.cov.fill(0.0);
    }
}

/// The residuals so far and the noise in force.
#[derive(Debug, Clone)]
pub struct ResidualHistory {
    rule: ResidualNoise,
    of_residuals: Mean,
    of_innovations: Mean,
    processed: usize,
    /// K C Kᵀ, once it is in force.
    q_raw: Option<DMatrix<f64>>,
    /// The noise of the last step that took time.
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    step_noise: Vec<f64>,
}

impl ResidualHistory {
    pub(super) fn new(rule: ResidualNoise, n: usize, r: DMatrix<f64>) -> Self {
        let m = r.nrows();
        let size = if rule.q.is_some() { n } else { 0 };
        Self {
            rule,
            of_residuals: Mean::new(rule.memory, m),
            of_innovations: Mean::new(rule.memory, m),
            processed: 0,
            q_raw: None,
            q: DMatrix::from_element(size, size, f64::NAN),
            r,
            step_noise: vec![0.0; n * n],
        }
    }

    pub(super) fn q(&self) -> &DMatrix<f64> {
        &self.q
    }

    pub(super) fn r(&self) -> &DMatrix<f64> {
        &self.r
    }

    pub(super) fn step_noise(&mut self, motion: &dyn Motion, state: &DVector<f64>, dt: f64) -> &[f64] {
        let noise = self.noise_of(motion, state, dt);
        copy_rows(&noise, &mut self.step_noise);
        if self.rule.q.is_some() && dt > 0.0 {
            self.q = noise;
        }
        &self.step_noise
    }

    fn noise_of(&self, motion: &dyn Motion, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        let Some(raw) = &self.q_raw else {
            return motion.noise_at(state, dt);
        };
        if dt == 0.0 {
            return DMatrix::zeros(raw.nrows(), raw.ncols());
        }
        match motion.noise_input_at(state, dt) {
            Some(input) if self.rule.q_floor > 0.0 => {
                let d = input.cov.nrows();
                raw + entered(&input, &(DMatrix::identity(d, d) * self.rule.q_floor))
            }
            _ => raw.clone(),
        }
    }

    pub(super) fn push(
        &mut self,
        epoch: &ProcessedEpoch<'_>,
        corrected: &Corrected<'_>,
        sensor: &dyn Sensor,
    ) -> Result<()> {
        if corrected.dof == 0 {
            return Ok(());
        }
        let (n, m) = (epoch.filtered.dim(), self.r.nrows());
        let mut jacobian = vec![0.0; m * n];
        let mut expected = vec![0.0; m];
        let filtered = epoch.filtered.to_owned();
        sensor.linearise_into(&filtered.mean, epoch.platform, &mut expected, &mut jacobian)?;
        let h = DMatrix::from_row_slice(m, n, &jacobian);
        let mut residual = DVector::zeros(m);
        residual_into(sensor, epoch.measurement, &expected, residual.as_mut_slice());
        if corrected.dof == m || self.rule.diagonal {
            self.of_residuals.push(residual);
            self.of_innovations
                .push(DVector::from_column_slice(corrected.innovation));
        }
        self.processed += 1;
        if self.processed < self.rule.first_epoch || self.of_residuals.counts[(0, 0)] == 0.0 && !self.rule.diagonal {
            return Ok(());
        }
        let raw = match self.rule.r {
            RFrom::Paper => &self.of_residuals.cov - &h * &filtered.cov * h.transpose(),
            RFrom::Resid => &self.of_residuals.cov + &h * &filtered.cov * h.transpose(),
            RFrom::Innov => &self.of_innovations.cov - &h * epoch.predicted.to_owned().cov * h.transpose(),
        };
        let EigenLimits { min, max } = self.rule.r_limits;
        if self.rule.diagonal {
            for i in 0..m {
                if self.of_residuals.counts[(i, i)] > 0.0 {
                    self.r[(i, i)] = raw[(i, i)].clamp(min, max);
                }
            }
        } else {
            self.r = clip_eigenvalues(&((&raw + raw.transpose()) * 0.5), min, max)?;
        }
        let Some(q) = self.rule.q else {
            return Ok(());
        };
        if corrected.dof == m {
            let cov = match q {
                QFrom::Paper => &self.of_residuals.cov,
                QFrom::Innovation => &self.of_innovations.cov,
            };
            let gain = DMatrix::from_column_slice(n, m, corrected.gain);
            let mut noise = &gain * cov * gain.transpose();
            crate::linalg::symmetric::symmetrise(&mut noise);
            self.q_raw = Some(noise);
        }
        Ok(())
    }

    pub(super) fn restart(&mut self) {
        self.of_residuals.clear();
        self.of_innovations.clear();
    }
}
