//! Motion and sensor noise estimated from a limited memory of smoothed states.
//!
//! | symbol | name here       | shape    | meaning                                                        |
//! |--------|-----------------|----------|----------------------------------------------------------------|
//! | N      | `window`        |          | epochs in the memory                                           |
//! | Γ_i    | `gain`          | n×d      | how the noise enters the state over step i                     |
//! | Q, R   | `q`, `r`        | d×d, m×m | covariances of the noise and of the measurement                |
//! | x_i|k  | `smoothed`      | n        | states of the window given all its data (U14–U16)              |
//! | M_i    | `lag_one`       | n×n      | cov(x_i|k, x_i−1|k) = P_i|k C_iᵀ                                |
//!
//! w_i = x_i|k − F_i x_i−1|k,  e_i = L_i − h(x_i|k), summed over the N last epochs:
//! * `Map` (U17, the paper): Q̂ = mean Γ⁺ w wᵀ Γ⁺ᵀ,  R̂ = mean e eᵀ
//! * `Em` (U18, default): Q̂ = mean Γ⁺ [w wᵀ + P_i|k + F P_i−1|k Fᵀ − M Fᵀ − F Mᵀ] Γ⁺ᵀ,  R̂ = mean [e eᵀ + A P_i|k Aᵀ]
//!
//! `Map` maximises the joint density of states and noise, which is unbounded at Q = 0: it shrinks Q until the filter loses
//! a manoeuvring target. `Em` adds the covariances that it leaves out.
//! Both are clipped to eigenvalue limits (U19): a direction in which Q is zero never returns.
//! Only components that were used count; R is diagonal, each component averaged over the epochs where it was used.
//!
//! Reference: Xi, Liu, Tao, Lu, eqs. (8)–(11); Shumway, Stoffer (1982) for the added terms. Spec labels U13–U19.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use super::smoother::{self, SmoothedRun};
use crate::error::{Error, Result, require_finite};
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::{clip_eigenvalues, symmetrise};
use crate::model::{Sensor, sensor};

/// How the residuals of the smoothed states become covariances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NoiseMethod {
    /// As printed in the paper: residuals alone.
    Map,
    /// Residuals and the covariances of the smoothed states.
    #[default]
    Em,
}

/// Lower and upper limit of the eigenvalues of an estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EigenLimits {
    /// Positive: rank lost in Q or R would never return.
    pub min: f64,
    /// At least `min`.
    pub max: f64,
}

/// Noise estimation from the last epochs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimitedMemoryNoise {
    /// Epochs in the memory, at least 1.
    pub window: usize,
    /// How the estimate is made.
    pub method: NoiseMethod,
    /// Estimates are used once so many epochs have been processed.
    pub first_epoch: usize,
    /// Limits of Q.
    pub q_limits: EigenLimits,
    /// Limits of R.
    pub r_limits: EigenLimits,
}

impl LimitedMemoryNoise {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        if self.window == 0 {
            return Err(Error::invalid("window", 0, "must be at least 1"));
        }
        for (name, limits) in [("q_limits", self.q_limits), ("r_limits", self.r_limits)] {
            require_finite(name, [&limits.min, &limits.max])?;
            if !(limits.min > 0.0 && limits.max >= limits.min) {
                let value = format!("{} to {}", limits.min, limits.max);
                return Err(Error::invalid(name, value, "must be positive and in order"));
            }
        }
        Ok(())
    }
}

/// One processed epoch, as the estimator needs it.
#[derive(Debug, Clone)]
pub struct ProcessedEpoch {
    /// State before the measurement.
    pub predicted: Gaussian,
    /// State after it.
    pub filtered: Gaussian,
    /// F from the epoch before.
    pub transition: DMatrix<f64>,
    /// Γ Q Γᵀ of the step from the epoch before.
    pub noise: DMatrix<f64>,
    /// Γ of the step from the epoch before.
    pub gain: DMatrix<f64>,
    /// The measurement, NaN where a component was missing or rejected.
    pub measurement: DVector<f64>,
    /// Position of the sensor's platform, where it moves.
    pub platform: Option<DVector<f64>>,
}

/// The estimates after an epoch.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseEstimate {
    /// Q̂ before clipping, d×d.
    pub q: DMatrix<f64>,
    /// R̂ before clipping, m×m; component pairs never used together are NaN.
    pub r: DMatrix<f64>,
}

/// The memory of a [`LimitedMemoryNoise`] and the noise in force.
#[derive(Debug, Clone)]
pub struct NoiseMemory {
    rule: LimitedMemoryNoise,
    prior: Gaussian,
    epochs: VecDeque<ProcessedEpoch>,
    processed: usize,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
}

impl NoiseMemory {
    /// A memory that begins at `start`, with the noise to begin with.
    pub fn new(rule: LimitedMemoryNoise, start: Gaussian, q: DMatrix<f64>, r: DMatrix<f64>) -> Result<Self> {
        rule.check()?;
        Ok(Self {
            rule,
            prior: start,
            epochs: VecDeque::with_capacity(rule.window),
            processed: 0,
            q,
            r,
        })
    }

    /// Q in force for the next epoch.
    pub fn q(&self) -> &DMatrix<f64> {
        &self.q
    }

    /// R in force for the next epoch.
    pub fn r(&self) -> &DMatrix<f64> {
        &self.r
    }

    /// Forgets the epochs and begins again at `start`; the noise in force stays. For a restart of the filter.
    pub fn restart(&mut self, start: Gaussian) {
        self.prior = start;
        self.epochs.clear();
    }

    /// Takes in an epoch and updates the noise in force. The estimate is returned before clipping.
    pub fn push(&mut self, epoch: ProcessedEpoch, sensor: &dyn Sensor) -> Result<NoiseEstimate> {
        if self.epochs.len() == self.rule.window
            && let Some(oldest) = self.epochs.pop_front()
        {
            self.prior = oldest.filtered;
        }
        self.epochs.push_back(epoch);
        self.processed += 1;
        let estimate = self.estimate(sensor)?;
        if self.processed < self.rule.first_epoch {
            return Ok(estimate);
        }
        let (low, high) = (self.rule.q_limits.min, self.rule.q_limits.max);
        self.q = clip_eigenvalues(&estimate.q, low, high)?;
        let enough = (self.rule.first_epoch / 2).max(1);
        for i in 0..self.r.nrows() {
            let uses = self
                .epochs
                .iter()
                .filter(|epoch| !epoch.measurement[i].is_nan())
                .count();
            if uses >= enough {
                self.r[(i, i)] = estimate.r[(i, i)].clamp(self.rule.r_limits.min, self.rule.r_limits.max);
            }
        }
        Ok(estimate)
    }

    fn estimate(&self, sensor: &dyn Sensor) -> Result<NoiseEstimate> {
        let m = sensor.measurement_dim();
        let d = self.q.nrows();
        let mut q = DMatrix::zeros(d, d);
        let mut r = DMatrix::zeros(m, m);
        let mut uses = DMatrix::<f64>::zeros(m, m);
        let smoothed = self.smooth()?;
        let mut steps = 0.0;
        for (index, epoch) in self.epochs.iter().enumerate() {
            let (before, after) = (&smoothed.states[index], &smoothed.states[index + 1]);
            let filtered_before = if index == 0 {
                &self.prior
            } else {
                &self.epochs[index - 1].filtered
            };
            // The predicted mean is f(x): its difference to F x covers inputs and nonlinear motion to first order.
            let f = &epoch.transition;
            let w = &after.mean - (&epoch.predicted.mean + f * (&before.mean - &filtered_before.mean));
            let mut sum = &w * w.transpose();
            if self.rule.method == NoiseMethod::Em {
                let cross = &smoothed.lag_one[index] * f.transpose();
                sum += &after.cov + f * &before.cov * f.transpose() - &cross - cross.transpose();
            }
            // Between two measurements at one time no noise enters: they say nothing about Q.
            if epoch.gain.iter().any(|&g| g != 0.0) {
                q += through_gain(&sum, &epoch.gain)?;
                steps += 1.0;
            }
            add_measurement(&mut r, &mut uses, epoch, after, sensor, self.rule.method)?;
        }
        if steps == 0.0 {
            q.copy_from(&self.q);
        } else {
            q /= steps;
        }
        symmetrise(&mut q);
        r.zip_apply(&uses, |sum, count| *sum /= count);
        Ok(NoiseEstimate { q, r })
    }

    /// The window smoothed, beginning with the filtered state before its first epoch (U13).
    fn smooth(&self) -> Result<SmoothedRun> {
        let n = self.prior.dim();
        let (identity, nothing) = (DMatrix::identity(n, n), DMatrix::zeros(n, n));
        let mut epochs = vec![smoother::Epoch {
            step: 0,
            filtered: &self.prior,
            predicted: &self.prior,
            transition: &identity,
            noise: &nothing,
        }];
        epochs.extend(self.epochs.iter().enumerate().map(|(index, epoch)| smoother::Epoch {
            step: index + 1,
            filtered: &epoch.filtered,
            predicted: &epoch.predicted,
            transition: &epoch.transition,
            noise: &epoch.noise,
        }));
        smoother::fixed_interval(&epochs)
    }
}

/// Γ⁺ W Γ⁺ᵀ.
fn through_gain(matrix: &DMatrix<f64>, gain: &DMatrix<f64>) -> Result<DMatrix<f64>> {
    let gram = Cholesky::new(&(gain.transpose() * gain), "noise gain")?;
    let pseudo = gram.solve(&gain.transpose());
    Ok(&pseudo * matrix * pseudo.transpose())
}

/// Adds e eᵀ (+ A P Aᵀ) of one epoch over its used components, and counts them.
fn add_measurement(
    r: &mut DMatrix<f64>,
    uses: &mut DMatrix<f64>,
    epoch: &ProcessedEpoch,
    smoothed: &Gaussian,
    sensor: &dyn Sensor,
    method: NoiseMethod,
) -> Result<()> {
    let platform = epoch.platform.as_ref();
    let e = sensor::residual(sensor, &epoch.measurement, &sensor.observe(&smoothed.mean, platform)?);
    let mut spread = DMatrix::zeros(e.len(), e.len());
    if method == NoiseMethod::Em {
        let a = sensor.jacobian(&smoothed.mean, platform)?;
        spread = &a * &smoothed.cov * a.transpose();
    }
    for i in 0..e.len() {
        for j in 0..e.len() {
            if !e[i].is_nan() && !e[j].is_nan() {
                r[(i, j)] += e[i] * e[j] + spread[(i, j)];
                uses[(i, j)] += 1.0;
            }
        }
    }
    Ok(())
}
