//! Rauch-Tung-Striebel smoothing of a filter run: fixed interval, fixed lag, limited memory.
//!
//! | symbol   | name here           | shape  | meaning                                                        |
//! |----------|---------------------|--------|----------------------------------------------------------------|
//! | x_i, P_i | `Epoch::filtered`   | n, n×n | estimate of epoch i given the data to i                        |
//! | x⁻, P⁻   | `Epoch::predicted`  | n, n×n | estimate of epoch i given the data to i−1                      |
//! | F, Q     | `transition`, `noise` | n×n  | of the step from i−1 to i                                      |
//! | C, D     | `Link`              | n×n    | gain from i to i−1; covariance of i−1 if i were known          |
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
//!   made exact. After a start of variance 3e9 against measurements of 1e-4 the difference has an eigenvalue of −1.3 % of
//!   the largest variance, the sum none below zero. Rounding of C moves both alike: the sum keeps definiteness, it does
//!   not bring back digits. `tests/smoother_numerics.rs` shows both.
//! - P⁻ may be singular without harm where F = I and Q = 0 (two measurements at one time, a constant): there every gain
//!   with C P⁻ = P⁻ is right, and C = I is taken. Elsewhere a pivot that is zero or only rounding is an error.

use std::collections::VecDeque;

use nalgebra::DMatrix;

use super::link::{Link, LinkScratch, Step};
use super::run::FilterRun;
use super::way_back::way_back;
use crate::error::{Error, Result, require_finite, require_size};
use crate::gaussian::{Gaussian, GaussianRef, Gaussians};
use crate::lanes::Level;
use crate::linalg::stack::Stack;
use crate::model::StateSpace;

/// What the smoother needs of one epoch of a filter.
#[derive(Debug, Clone, Copy)]
pub struct Epoch<'a> {
    /// Its number in the run, which errors name.
    pub step: usize,
    /// Where the states live.
    pub space: StateSpace,
    /// The estimate after the measurement.
    pub filtered: GaussianRef<'a>,
    /// The estimate before it.
    pub predicted: GaussianRef<'a>,
    /// F of the step that leads here, n×n row by row.
    pub transition: &'a [f64],
    /// Q of that step, n×n.
    pub noise: &'a [f64],
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
            let own = self.predicted.view(step);
            if step == self.start && own.mean.iter().any(|v| v.is_nan()) {
                self.filtered.view(step)
            } else {
                own
            }
        };
        Ok((self.start.min(count)..count)
            .map(|step| Epoch {
                step,
                space: self.space,
                filtered: self.filtered.view(step),
                predicted: predicted(step),
                transition: self.transitions.at(step),
                noise: self.motion_noises.at(step),
            })
            .collect())
    }
}

/// Smoothed estimates, in the order of time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SmoothedRun {
    /// One estimate per epoch.
    pub states: Gaussians,
    /// cov(x_{i+1}, x_i) at index i, n×n, given the data that estimate i is given; one fewer than the states.
    pub lag_one: Stack,
}

impl SmoothedRun {
    /// Nothing yet, for states of length n.
    pub fn new(n: usize) -> Self {
        Self {
            states: Gaussians::new(n),
            lag_one: Stack::square(n),
        }
    }

    /// Takes memory for so many more.
    pub fn reserve(&mut self, count: usize) {
        self.states.reserve(count);
        self.lag_one.reserve(count);
    }

    /// Adds the next estimate.
    pub fn push(&mut self, lagged: &LaggedEstimate) {
        self.states.push(&lagged.state);
        self.lag_one.push_matrix(&lagged.lag_one);
    }

    /// Adds what comes after.
    pub fn append(&mut self, tail: &Self) {
        self.states.means.extend(&tail.states.means, 0, tail.states.len());
        self.states.covs.extend(&tail.states.covs, 0, tail.states.len());
        self.lag_one.extend(&tail.lag_one, 0, tail.lag_one.len());
    }

    fn reverse(&mut self) {
        self.states.means.reverse();
        self.states.covs.reverse();
        self.lag_one.reverse();
    }
}

/// Every epoch given the data of all (U14 to U16).
pub fn fixed_interval(epochs: &[Epoch<'_>]) -> Result<SmoothedRun> {
    let Some(last) = epochs.last() else {
        return Ok(SmoothedRun::default());
    };
    let mut back = Backward::from(last.filtered);
    back.reserve(epochs.len());
    back.through(epochs)?;
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
    let mut run = SmoothedRun::new(epochs.first().map_or(0, |epoch| epoch.filtered.dim()));
    for epoch in epochs {
        if let Some(lagged) = smoother.push(epoch)? {
            run.push(&lagged);
        }
    }
    run.append(&smoother.tail());
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
        let mut scratch = LinkScratch::new(epoch.filtered.dim());
        if let Some(before) = &self.last {
            self.links.push_back(link(before.into(), epoch, &mut scratch)?);
        }
        self.last = Some(epoch.filtered.to_owned());
        if self.links.len() < self.lag {
            return Ok(None);
        }
        let mut back = Backward::from(epoch.filtered);
        for link in self.links.iter().skip(1).rev() {
            back.move_to(link);
        }
        Ok(self.links.pop_front().map(|link| {
            back.step(&link);
            LaggedEstimate {
                state: back.now.clone(),
                lag_one: back.run.lag_one.matrix(0),
            }
        }))
    }

    /// The epochs not given yet, at most L, given all data so far.
    pub fn tail(&self) -> SmoothedRun {
        let Some(last) = &self.last else {
            return SmoothedRun::default();
        };
        let mut back = Backward::from(last.into());
        for link in self.links.iter().rev() {
            back.step(link);
        }
        back.finish()
    }
}

/// A smoothed run that grows from its end. A long run can be smoothed in pieces: each begins with the epoch at which the
/// one after it ends.
#[derive(Debug, Clone)]
pub struct Backward {
    run: SmoothedRun,
    now: Gaussian,
    earlier: Gaussian,
    lag_one: Vec<f64>,
    scratch: LinkScratch,
}

impl Backward {
    /// Begins with the smoothed, which is the filtered, estimate of the last epoch.
    pub fn from(end: GaussianRef<'_>) -> Self {
        let n = end.dim();
        Self {
            run: SmoothedRun::new(n),
            now: end.to_owned(),
            earlier: end.to_owned(),
            lag_one: vec![0.0; n * n],
            scratch: LinkScratch::new(n),
        }
    }

    /// Takes memory for so many more epochs.
    pub fn reserve(&mut self, count: usize) {
        self.run.reserve(count);
    }

    /// Goes through these epochs from the last, at which it stands, to the first.
    pub fn through(&mut self, epochs: &[Epoch<'_>]) -> Result<()> {
        epochs.iter().try_for_each(check)?;
        if let Some(last) = epochs.last() {
            require_size("smoothed state", last.filtered.dim(), self.now.dim())?;
        }
        let mut fixed = way_back(self.now.dim(), Level::chosen_arch()?);
        let known = self.run.states.len();
        let mut rest = epochs;
        loop {
            if let Some(fixed) = &mut fixed {
                let taken = fixed.through(rest, &mut self.now, &mut self.run);
                rest = &rest[..rest.len() - taken];
            }
            let [.., before, after] = rest else {
                return match self.run.states.first_not_finite(known) {
                    None => self.now.require_finite("smoothed state"),
                    Some(_) => Err(Error::Overflow {
                        what: "smoothed state".into(),
                    }),
                };
            };
            let link = link(before.filtered, after, &mut self.scratch)?;
            self.step(&link);
            rest = &rest[..rest.len() - 1];
        }
    }

    fn step(&mut self, link: &Link) {
        link.lag_one((&self.now).into(), &mut self.lag_one);
        self.run.lag_one.push(&self.lag_one);
        self.run.states.push(&self.now);
        self.move_to(link);
    }

    fn move_to(&mut self, link: &Link) {
        let (mean, cov) = (self.earlier.mean.as_mut_slice(), self.earlier.cov.as_mut_slice());
        link.back((&self.now).into(), &mut self.scratch, mean, cov);
        std::mem::swap(&mut self.now, &mut self.earlier);
    }

    /// The smoothed run, from the epoch at which it stands to the end.
    pub fn finish(mut self) -> SmoothedRun {
        self.run.states.push(&self.now);
        self.run.reverse();
        self.run
    }
}

fn link(before: GaussianRef<'_>, after: &Epoch<'_>, scratch: &mut LinkScratch) -> Result<Link> {
    let n = after.predicted.dim();
    if before.dim() != n {
        return Err(Error::dimension(
            &format!("state at step {}", after.step),
            before.dim(),
            n,
        ));
    }
    let mut link = Link::new(after.space);
    let step = Step {
        number: after.step,
        predicted: after.predicted,
        transition: after.transition,
        noise: after.noise,
    };
    link.set(before, &step, scratch)?;
    Ok(link)
}

fn check(epoch: &Epoch<'_>) -> Result<()> {
    let n = epoch.space.dim;
    let name = |what: &str| format!("{what} at step {}", epoch.step);
    for (what, values, size) in [
        ("predicted mean", epoch.predicted.mean, n),
        ("filtered covariance", epoch.filtered.cov, n * n),
        ("predicted covariance", epoch.predicted.cov, n * n),
        ("transition", epoch.transition, n * n),
        ("motion noise", epoch.noise, n * n),
        ("filtered mean", epoch.filtered.mean, n),
    ] {
        if values.len() != size {
            return require_size(&name(what), size, values.len());
        }
        // Without a branch for each of them.
        if !values.iter().fold(true, |all, v| all & v.is_finite()) {
            return require_finite(&name(what), values);
        }
    }
    Ok(())
}
