//! Motion and sensor noise estimated from a limited memory of smoothed states.
//!
//! | symbol | name here       | shape    | meaning                                                        |
//! |--------|-----------------|----------|----------------------------------------------------------------|
//! | N      | `window`        |          | epochs in the memory                                           |
//! | Γ_i, r | `NoiseInput`    | n×rd     | how r independent noises of covariance Q enter over step i     |
//! | Q, R   | `q`, `r`        | d×d, m×m | covariances of the noise and of the measurement                |
//! | Q̄      |                 | rd×rd    | I_r ⊗ Q                                                        |
//! | x_i|k, P_i|k |           | n, n×n   | states of the window given all its data (U14–U16)              |
//! | Z_i    | `projection`    | rd×n     | Q̄ Γᵀ (P⁻)⁻¹: the mean of the noise of step i, if x_i were known, is Z (x_i − x⁻) |
//! | E_i    | `remainder`     | rd×rd    | Q̄ − Q̄ Γᵀ (P⁻)⁻¹ Γ Q̄: and this its covariance                  |
//!
//! w_i = x_i|k − F_i x_i−1|k,  e_i = L_i − h(x_i|k), summed over the N last epochs:
//! * `Map` (U17, the paper): Q̂ = mean Γ⁺ w wᵀ Γ⁺ᵀ,  R̂ = mean e eᵀ
//! * `Em` (U18, default): Q̂ = mean Γ⁺ [w wᵀ + P_i|k + F P_i−1|k Fᵀ − M Fᵀ − F Mᵀ] Γ⁺ᵀ,  R̂ = mean [e eᵀ + A P_i|k Aᵀ]
//!
//! Evaluated with u_i = Z (x_i|k − x⁻), which is Γ⁺ w, and Z P_i|k Zᵀ + E, which is the rest of the bracket seen through
//! Γ⁺: Z and E are known when the epoch is processed, and no lag-one covariance is needed. With r > 1, Q̂ is the mean of
//! the r diagonal blocks of d×d.
//!
//! `Map` maximises the joint density of states and noise, which is unbounded at Q = 0: it shrinks Q until the filter loses
//! a manoeuvring target. `Em` adds the covariances that it leaves out.
//! Both are clipped to eigenvalue limits (U19): a direction in which Q is zero never returns.
//! Only components that were used count; each of a diagonal R is averaged over the epochs where it was used, a full R over
//! the epochs that used all, at least m of them.
//!
//! Reference: Xi, Liu, Tao, Lu, eqs. (8)–(11); Shumway, Stoffer (1982) for the added terms. Spec labels U13–U19.
//! Deviation: the paper's elementwise limits (8), (9) do not keep a matrix positive semidefinite; they are eigenvalue limits.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use super::window::{Remembered, Sums, Walk};
use crate::error::{Error, Result, require_finite};
use crate::gaussian::{Gaussian, GaussianRef};
use crate::linalg::copy_rows;
use crate::linalg::kernel;
use crate::linalg::symmetric::clip_eigenvalues;
use crate::model::{Motion, Sensor, StateSpace};

/// How the residuals of the smoothed states become covariances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NoiseMethod {
    /// As printed in the paper: residuals alone.
    Map,
    /// Residuals and the covariances of the smoothed states.
    #[default]
    Em,
}

/// What of the motion noise is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum QForm {
    /// The covariance of what drives the motion, d×d: see [`crate::model::NoiseInput`].
    #[default]
    Input,
    /// The whole covariance of a step, n×n, as in the paper. It has no meaning where dt changes.
    Full,
}

/// What of the sensor noise is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RForm {
    /// The variances.
    #[default]
    Diagonal,
    /// The whole matrix.
    Full,
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
    /// Epochs in the memory for Q, at least 1.
    pub window: usize,
    /// The same for R; `None` for as many.
    pub r_window: Option<usize>,
    /// How the estimate is made.
    pub method: NoiseMethod,
    /// What is estimated of Q.
    pub q_form: QForm,
    /// What is estimated of R.
    pub r_form: RForm,
    /// Estimates are used once so many epochs have been processed.
    pub first_epoch: usize,
    /// Limits of Q.
    pub q_limits: EigenLimits,
    /// Limits of R.
    pub r_limits: EigenLimits,
}

impl Default for LimitedMemoryNoise {
    fn default() -> Self {
        Self {
            window: 20,
            r_window: None,
            method: NoiseMethod::Em,
            q_form: QForm::Input,
            r_form: RForm::Diagonal,
            first_epoch: 10,
            q_limits: EigenLimits { min: 1e-6, max: 1e2 },
            r_limits: EigenLimits { min: 1e-2, max: 1e4 },
        }
    }
}

impl LimitedMemoryNoise {
    /// The paper as printed, (10) and (11): residuals alone, full Q and R, used from the first epoch on. It loses a
    /// manoeuvring target. The limits (8), (9) are those of the eigenvalues.
    pub fn as_printed(window: usize) -> Self {
        Self {
            window,
            method: NoiseMethod::Map,
            q_form: QForm::Full,
            r_form: RForm::Full,
            first_epoch: 1,
            ..Self::default()
        }
    }

    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        for (name, window) in [("window", self.window), ("r_window", self.r_window())] {
            if window == 0 {
                return Err(Error::invalid(name, 0, "must be at least 1"));
            }
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

    pub(super) fn r_window(&self) -> usize {
        self.r_window.unwrap_or(self.window)
    }
}

/// One processed epoch, as the estimator needs it.
#[derive(Debug, Clone, Copy)]
pub struct ProcessedEpoch<'a> {
    /// State before the measurement.
    pub predicted: GaussianRef<'a>,
    /// State after it.
    pub filtered: GaussianRef<'a>,
    /// F from the epoch before, n×n row by row.
    pub transition: &'a [f64],
    /// Q of that step, n×n: what [`NoiseMemory::step_noise`] gave for it.
    pub noise: &'a [f64],
    /// The measurement, NaN where a component was missing or rejected.
    pub measurement: &'a [f64],
    /// Position of the sensor's platform, where it moves.
    pub platform: Option<&'a DVector<f64>>,
}

/// The estimates after an epoch.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseEstimate {
    /// Q̂ before clipping, d×d.
    pub q: DMatrix<f64>,
    /// R̂ before clipping, m×m; component pairs never used together are NaN.
    pub r: DMatrix<f64>,
}

/// How the noise enters over the step in hand.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    dt: f64,
    /// Γᵀ, rd×n row by row; zero where no noise enters.
    pub(super) gain: Vec<f64>,
    rest: Option<Vec<f64>>,
    /// r.
    pub(super) repeat: usize,
    /// Whether any noise enters.
    pub(super) enters: bool,
}

/// The memory of a [`LimitedMemoryNoise`] and the noise in force.
#[derive(Debug, Clone)]
pub struct NoiseMemory {
    rule: LimitedMemoryNoise,
    space: StateSpace,
    last: Gaussian,
    epochs: VecDeque<Remembered>,
    processed: usize,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    entry: Entry,
    /// The first step that took time, for a full Q.
    full_dt: Option<f64>,
    step_noise: Vec<f64>,
    sums: Sums,
    walk: Walk,
}

impl NoiseMemory {
    /// A memory that begins at `start`, with the noise to begin with: `q` is d×d, `r` m×m. A full Q (n×n) begins with the
    /// model's own noise over the first step instead.
    pub fn new(rule: LimitedMemoryNoise, start: GaussianRef<'_>, q: DMatrix<f64>, r: DMatrix<f64>) -> Result<Self> {
        rule.check()?;
        let n = start.dim();
        Ok(Self {
            rule,
            space: StateSpace::euclidean(n),
            last: start.to_owned(),
            epochs: VecDeque::with_capacity(rule.window.max(rule.r_window()).min(1024)),
            processed: 0,
            sums: Sums::new(q.nrows(), r.nrows()),
            q,
            r,
            entry: Entry {
                dt: f64::NAN,
                gain: Vec::new(),
                rest: None,
                repeat: 1,
                enters: false,
            },
            full_dt: None,
            step_noise: vec![0.0; n * n],
            walk: Walk::new(n),
        })
    }

    /// Q in force for the next epoch; NaN for a full Q before its first step.
    pub fn q(&self) -> &DMatrix<f64> {
        &self.q
    }

    /// R in force for the next epoch.
    pub fn r(&self) -> &DMatrix<f64> {
        &self.r
    }

    /// The estimates after the last epoch, before clipping.
    pub fn estimate(&self) -> NoiseEstimate {
        self.sums.estimate()
    }

    /// Forgets the epochs and begins again at `start`; the noise in force stays. For a restart of the filter.
    pub fn restart(&mut self, start: GaussianRef<'_>) {
        self.last = start.to_owned();
        self.epochs.clear();
    }

    /// The same memory for states of another space than one in which everything adds.
    #[must_use]
    pub fn in_space(mut self, space: StateSpace) -> Self {
        self.space = space;
        self
    }

    /// The motion noise of a step of length `dt` from `state` with the Q in force, n×n: Γ Q̄ Γᵀ and what is not estimated.
    pub fn step_noise(&mut self, motion: &dyn Motion, state: &DVector<f64>, dt: f64) -> Result<&[f64]> {
        if dt != self.entry.dt || self.space.attitude.is_some() {
            self.set_entry(motion, state, dt)?;
        }
        let n = self.last.dim();
        let Entry { gain, rest, .. } = &self.entry;
        match rest {
            Some(rest) => self.step_noise.copy_from_slice(rest),
            None => self.step_noise.fill(0.0),
        }
        let d = self.q.nrows();
        if self.entry.enters {
            // Σ over blocks and pairs of Q_ab γ_a γ_bᵀ, where γ_a is a row of Γᵀ, mostly zeros.
            for block in gain.chunks_exact((d * n).max(1)) {
                for (a, left) in block.chunks_exact(n).enumerate() {
                    for (b, right) in block.chunks_exact(n).enumerate() {
                        let q = self.q[(a, b)];
                        if q != 0.0 {
                            for (i, &x) in left.iter().enumerate().filter(|(_, x)| **x != 0.0) {
                                kernel::add_scaled(&mut self.step_noise[i * n..(i + 1) * n], q * x, right);
                            }
                        }
                    }
                }
            }
        }
        Ok(&self.step_noise)
    }

    fn set_entry(&mut self, motion: &dyn Motion, state: &DVector<f64>, dt: f64) -> Result<()> {
        let n = self.last.dim();
        let entry = &mut self.entry;
        entry.dt = f64::NAN;
        match (self.rule.q_form, motion.noise_input_at(state, dt)) {
            (QForm::Input, Some(input)) => {
                entry.gain.resize(input.gain.ncols() * n, 0.0);
                copy_rows(&input.gain.transpose(), &mut entry.gain);
                entry.rest = input.rest.map(|rest| rest.as_slice().to_vec());
                entry.repeat = input.repeat;
            }
            (QForm::Input, None) => {
                return Err(Error::invalid(
                    "adapt",
                    "given",
                    "needs a motion that says how its noise enters",
                ));
            }
            (QForm::Full, _) => {
                entry.gain.resize(n * n, 0.0);
                for (i, x) in entry.gain.iter_mut().enumerate() {
                    *x = if i.is_multiple_of(n + 1) && dt != 0.0 { 1.0 } else { 0.0 };
                }
                if dt != 0.0 {
                    let first = *self.full_dt.get_or_insert(dt);
                    if (dt - first).abs() > 1e-9 * first {
                        let requirement = format!("needs equal time steps: {first} s at first, later {dt} s");
                        return Err(Error::invalid("q_form", "full", &requirement));
                    }
                    if self.q.iter().any(|q| q.is_nan()) {
                        self.q = motion.noise_at(state, dt);
                    }
                }
            }
        }
        entry.enters = entry.gain.iter().any(|&g| g != 0.0);
        entry.dt = dt;
        Ok(())
    }

    /// Takes in an epoch and updates the noise in force.
    pub fn push(&mut self, epoch: &ProcessedEpoch<'_>, sensor: &dyn Sensor) -> Result<()> {
        let full = self.epochs.len() == self.rule.window.max(self.rule.r_window());
        let oldest = if full { self.epochs.pop_front() } else { None };
        let mut remembered = oldest.unwrap_or_else(|| Remembered::new(self.space, self.r.nrows()));
        self.processed += 1;
        remembered.set(
            (&self.last).into(),
            epoch,
            &self.entry,
            &self.q,
            self.processed,
            self.walk.link_scratch(),
        )?;
        self.epochs.push_back(remembered);
        self.last.mean.as_mut_slice().copy_from_slice(epoch.filtered.mean);
        self.last.cov.as_mut_slice().copy_from_slice(epoch.filtered.cov);
        self.walk
            .back(&self.rule, &self.epochs, epoch.filtered, sensor, &mut self.sums)?;
        self.sums.finish(&self.q);
        if self.processed < self.rule.first_epoch {
            return Ok(());
        }
        self.adopt()
    }

    fn adopt(&mut self) -> Result<()> {
        let limits = self.rule.q_limits;
        if self.sums.steps > 0.0 {
            self.q = clip_eigenvalues(self.sums.q(), limits.min, limits.max)?;
        }
        let limits = self.rule.r_limits;
        let m = self.r.nrows();
        match self.rule.r_form {
            RForm::Diagonal => {
                let enough = (self.rule.first_epoch / 2).max(1) as f64;
                for i in 0..m {
                    if self.sums.uses(i) >= enough {
                        self.r[(i, i)] = self.sums.r()[(i, i)].clamp(limits.min, limits.max);
                    }
                }
            }
            RForm::Full => {
                if self.sums.complete >= m as f64 {
                    self.r = clip_eigenvalues(self.sums.r_complete(), limits.min, limits.max)?;
                }
            }
        }
        Ok(())
    }
}
