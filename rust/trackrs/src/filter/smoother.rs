//! Rauch-Tung-Striebel smoothing of a filter run: fixed interval, fixed lag, limited memory.
//!
//! | symbol   | name here           | shape  | meaning                                                        |
//! |----------|---------------------|--------|----------------------------------------------------------------|
//! | x_i, P_i | `Epoch::filtered`   | n, n×n | estimate of epoch i given the data to i                        |
//! | x⁻, P⁻   | `Epoch::predicted`  | n, n×n | estimate of epoch i given the data to i−1                      |
//! | F, Q     | `transition`, `noise` | n×n  | of the step from i−1 to i                                      |
//! | C        | `Link::gain`        | n×n    | smoother gain from i to i−1                                    |
//! | D        | `Link::rest`        | n×n    | covariance of epoch i−1 if epoch i were known and no data after i−1 |
//! | k        |                     |        | the last epoch whose data are used                             |
//!
//! gain       C = P_{i−1} Fᵀ (P⁻)⁻¹, by solving with the Cholesky factor of P⁻                       (U14)
//! backwards from x_{k|k} = x_k:  x_{i−1|k} = x_{i−1} + C (x_{i|k} − x⁻)                             (U15)
//!            P_{i−1|k} = D + C P_{i|k} Cᵀ,  D = (I − C F) P_{i−1} (I − C F)ᵀ + C Q Cᵀ               (U15)
//! lag one    M_i = cov(x_i, x_{i−1} | data to k) = P_{i|k} Cᵀ                                       (U16)
//! Fixed interval: k is the end of the run. Fixed lag L: epoch i has k = i + L, or the end if that comes first. Limited
//! memory: the last N + 1 epochs up to k, begun with the filtered estimate of the first of them (U13).
//!
//! Reference: Rauch, Tung, Striebel (1965), Maximum likelihood estimates of linear dynamic systems, AIAA Journal 3(8);
//! labels U13 to U16 as in the underwater paper by Xi, Liu, Tao, Lu.
//!
//! Deviations:
//! - (U15) has P_{i−1|k} = P_{i−1} + C (P_{i|k} − P⁻) Cᵀ, which is the same, because C P⁻ = P_{i−1} Fᵀ, but is a difference
//!   of large matrices where the data after i−1 say much. Here it is a sum of positive semidefinite terms, and symmetry is
//!   made exact. After a start of variance 1e9 against measurements of 1e-4 the difference has an eigenvalue of −0.7 % of
//!   the largest variance, the sum none below zero. Rounding of C moves both alike: the sum keeps definiteness, it does
//!   not bring back digits. `tests/smoother_numerics.rs` shows both.
//! - P⁻ may be singular without harm where F = I and Q = 0 (two measurements at one time, a constant): there every gain
//!   with C P⁻ = P⁻ is right, and C = I is taken. Elsewhere a pivot that is zero or only rounding is an error.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use super::sequence::FilterRun;
use crate::error::{Error, Result, require_finite, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::symmetrise;

/// What the smoother needs of one epoch of a filter.
#[derive(Debug, Clone, Copy)]
pub struct Epoch<'a> {
    /// Its number in the run, which errors name.
    pub step: usize,
    /// The estimate after the measurement.
    pub filtered: &'a Gaussian,
    /// The estimate before it.
    pub predicted: &'a Gaussian,
    /// F of the step that leads here, n×n.
    pub transition: &'a DMatrix<f64>,
    /// Q of that step, n×n.
    pub noise: &'a DMatrix<f64>,
}

impl FilterRun {
    /// The epochs of a run with [`History::Full`](super::sequence::History::Full), from the row that starts it on.
    pub fn epochs(&self) -> Result<Vec<Epoch<'_>>> {
        let count = self.filtered.len();
        if [self.predicted.len(), self.transitions.len(), self.motion_noises.len()] != [count; 3] {
            return Err(Error::invalid(
                "history",
                "filtered or last",
                "smoothing needs the predictions of a run with full history",
            ));
        }
        // A run that starts itself has no prediction of its first state; nothing before that state is smoothed either.
        let predicted = |step: usize| {
            let own = &self.predicted[step];
            if step == self.start && own.mean.iter().any(|v| v.is_nan()) {
                &self.filtered[step]
            } else {
                own
            }
        };
        Ok((self.start.min(count)..count)
            .map(|step| Epoch {
                step,
                filtered: &self.filtered[step],
                predicted: predicted(step),
                transition: &self.transitions[step],
                noise: &self.motion_noises[step],
            })
            .collect())
    }
}

/// Smoothed estimates, in the order of time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SmoothedRun {
    /// One estimate per epoch.
    pub states: Vec<Gaussian>,
    /// cov(x_{i+1}, x_i) at index i, n×n, given the data that estimate i is given; one fewer than the states.
    pub lag_one: Vec<DMatrix<f64>>,
}

/// Every epoch given the data of all (U14 to U16).
pub fn fixed_interval(epochs: &[Epoch<'_>]) -> Result<SmoothedRun> {
    match epochs.last() {
        None => Ok(SmoothedRun::default()),
        Some(last) => fixed_interval_from(epochs, last.filtered.clone()),
    }
}

/// The same where the smoothed estimate of the last of these epochs is known: a long run can be smoothed in pieces from
/// its end, each piece ending with the epoch with which the piece after it begins.
pub fn fixed_interval_from(epochs: &[Epoch<'_>], end: Gaussian) -> Result<SmoothedRun> {
    let Some(last) = epochs.last() else {
        return Ok(SmoothedRun::default());
    };
    epochs.iter().try_for_each(check)?;
    require_size("smoothed state", last.filtered.dim(), end.dim())?;
    let mut back = Backward::from(end);
    for pair in epochs.windows(2).rev() {
        back.step(&Link::new(pair[0].filtered, &pair[1])?);
    }
    Ok(back.finish())
}

/// The last `window` + 1 epochs given the data of all, begun with the filtered estimate of the first of them (U13).
/// While there are fewer, all of them.
pub fn limited_memory(epochs: &[Epoch<'_>], window: usize) -> Result<SmoothedRun> {
    let first = epochs.len().saturating_sub(window.saturating_add(1));
    fixed_interval(&epochs[first..])
}

/// Epoch k−L given the data to k, for all k; the last L epochs given all data. Equal to [`FixedLagSmoother`] bit for bit.
pub fn fixed_lag(epochs: &[Epoch<'_>], lag: usize) -> Result<SmoothedRun> {
    let mut smoother = FixedLagSmoother::new(lag)?;
    let mut run = SmoothedRun::default();
    for epoch in epochs {
        if let Some(lagged) = smoother.push(epoch)? {
            run.states.push(lagged.state);
            run.lag_one.push(lagged.lag_one);
        }
    }
    let mut tail = smoother.tail();
    run.states.append(&mut tail.states);
    run.lag_one.append(&mut tail.lag_one);
    Ok(run)
}

/// An estimate that lags behind the data.
#[derive(Debug, Clone, PartialEq)]
pub struct LaggedEstimate {
    /// Epoch k−L given the data to k.
    pub state: Gaussian,
    /// cov(x_{k−L+1}, x_{k−L}) given the same data, n×n.
    pub lag_one: DMatrix<f64>,
}

/// Fixed-lag smoothing epoch by epoch. It holds L epochs, whatever the length of the run.
#[derive(Debug, Clone)]
pub struct FixedLagSmoother {
    lag: usize,
    links: VecDeque<Link>,
    last: Option<Gaussian>,
}

impl FixedLagSmoother {
    /// A smoother that lags `lag` epochs behind, at least 1.
    pub fn new(lag: usize) -> Result<Self> {
        if lag == 0 {
            return Err(Error::invalid("lag", lag, "must be at least 1 epoch"));
        }
        Ok(Self {
            lag,
            links: VecDeque::new(),
            last: None,
        })
    }

    /// Takes the next epoch k and gives epoch k−L, once there is one. After an error the smoother is as it was before.
    pub fn push(&mut self, epoch: &Epoch<'_>) -> Result<Option<LaggedEstimate>> {
        check(epoch)?;
        if let Some(before) = &self.last {
            self.links.push_back(Link::new(before, epoch)?);
        }
        self.last = Some(epoch.filtered.clone());
        if self.links.len() < self.lag {
            return Ok(None);
        }
        let mut state = epoch.filtered.clone();
        for link in self.links.iter().skip(1).rev() {
            state = link.back(&state);
        }
        Ok(self.links.pop_front().map(|link| LaggedEstimate {
            state: link.back(&state),
            lag_one: link.lag_one(&state),
        }))
    }

    /// The epochs not given yet, at most L, given all data so far.
    pub fn tail(&self) -> SmoothedRun {
        let Some(last) = &self.last else {
            return SmoothedRun::default();
        };
        let mut back = Backward::from(last.clone());
        for link in self.links.iter().rev() {
            back.step(link);
        }
        back.finish()
    }
}

/// A smoothed run that grows from its end.
struct Backward {
    states: Vec<Gaussian>,
    lag_one: Vec<DMatrix<f64>>,
    first: Gaussian,
}

impl Backward {
    fn from(end: Gaussian) -> Self {
        Self {
            states: Vec::new(),
            lag_one: Vec::new(),
            first: end,
        }
    }

    fn step(&mut self, link: &Link) {
        let before = link.back(&self.first);
        self.lag_one.push(link.lag_one(&self.first));
        self.states.push(std::mem::replace(&mut self.first, before));
    }

    fn finish(mut self) -> SmoothedRun {
        self.states.push(self.first);
        self.states.reverse();
        self.lag_one.reverse();
        SmoothedRun {
            states: self.states,
            lag_one: self.lag_one,
        }
    }
}

/// The way from epoch i back to i−1: x_{i−1} = x + C (x_i − x⁻) + N(0, D). It does not depend on data after i−1.
#[derive(Debug, Clone)]
struct Link {
    before: DVector<f64>,
    predicted: DVector<f64>,
    gain: DMatrix<f64>,
    rest: DMatrix<f64>,
}

impl Link {
    fn new(before: &Gaussian, after: &Epoch<'_>) -> Result<Self> {
        let (n, f) = (after.predicted.dim(), after.transition);
        if before.dim() != n {
            return Err(Error::dimension(
                &format!("state at step {}", after.step),
                before.dim(),
                n,
            ));
        }
        let identity = DMatrix::identity(n, n);
        let no_time = *f == identity && after.noise.iter().all(|&q| q == 0.0);
        let gain = if no_time {
            identity.clone()
        } else {
            factor(&after.predicted.cov, after.step)?
                .solve(&(f * &before.cov))
                .transpose()
        };
        let left = identity - &gain * f;
        Ok(Self {
            rest: &left * &before.cov * left.transpose() + &gain * after.noise * gain.transpose(),
            before: before.mean.clone(),
            predicted: after.predicted.mean.clone(),
            gain,
        })
    }

    fn back(&self, smoothed: &Gaussian) -> Gaussian {
        let mean = &self.before + &self.gain * (&smoothed.mean - &self.predicted);
        let mut cov = &self.rest + &self.gain * &smoothed.cov * self.gain.transpose();
        symmetrise(&mut cov);
        Gaussian { mean, cov }
    }

    fn lag_one(&self, smoothed: &Gaussian) -> DMatrix<f64> {
        &smoothed.cov * self.gain.transpose()
    }
}

/// The factor of P⁻. A pivot within rounding of zero is refused too: the gain would be noise, and whether a singular
/// matrix leaves +1e-17 or −1e-17 there is chance.
fn factor(cov: &DMatrix<f64>, step: usize) -> Result<Cholesky> {
    let refused = |pivot, value| Error::NotPositiveDefinite {
        what: format!("predicted covariance at step {step}"),
        pivot,
        value,
    };
    let factor = Cholesky::new(cov, "predicted covariance").map_err(|error| match error {
        Error::NotPositiveDefinite { pivot, value, .. } => refused(pivot, value),
        other => other,
    })?;
    let rounding = cov.nrows() as f64 * f64::EPSILON;
    for (pivot, root) in factor.lower().diagonal().iter().enumerate() {
        let value = root * root;
        if value <= rounding * cov[(pivot, pivot)] {
            return Err(refused(pivot, value));
        }
    }
    Ok(factor)
}

fn check(epoch: &Epoch<'_>) -> Result<()> {
    let n = epoch.filtered.dim();
    let name = |what: &str| format!("{what} at step {}", epoch.step);
    if epoch.predicted.dim() != n {
        return require_size(&name("predicted mean"), n, epoch.predicted.dim());
    }
    for (what, matrix) in [
        ("filtered covariance", &epoch.filtered.cov),
        ("predicted covariance", &epoch.predicted.cov),
        ("transition", epoch.transition),
        ("motion noise", epoch.noise),
    ] {
        if matrix.shape() != (n, n) {
            let found = if matrix.nrows() == n {
                matrix.ncols()
            } else {
                matrix.nrows()
            };
            return require_size(&name(what), n, found);
        }
        if matrix.iter().any(|v| !v.is_finite()) {
            return require_finite(&name(what), matrix.transpose().iter());
        }
    }
    for (what, mean) in [
        ("filtered mean", &epoch.filtered.mean),
        ("predicted mean", &epoch.predicted.mean),
    ] {
        if mean.iter().any(|v| !v.is_finite()) {
            return require_finite(&name(what), mean.iter());
        }
    }
    Ok(())
}
