//! What a run gives, kept flat: one piece of memory per quantity, whatever the number of epochs.

use nalgebra::DMatrix;

use super::adaptation::Adaptation;
use super::runner::Epoch;
use super::screen::{Screened, Verdict};
use super::search::Start;
use super::sequence::{Filter, History};
use crate::error::Result;
use crate::event::Books;
use crate::gaussian::{Gaussian, GaussianRef, Gaussians};
use crate::linalg::stack::{Repeats, Stack};
use crate::model::{Motion, Sensor, StateSpace};

/// Everything a run gives. Sequences have one element per kept time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FilterRun {
    /// Estimates after the measurement.
    pub filtered: Gaussians,
    /// Estimates before it; only with [`History::Full`].
    pub predicted: Gaussians,
    /// F of the step to every time, from the time before or, at the first, from the initial state; n×n each, only with
    /// [`History::Full`].
    pub transitions: Repeats,
    /// Q of the same steps.
    pub motion_noises: Repeats,
    /// Innovations, length m each, NaN where not observed.
    pub innovations: Stack,
    /// Innovation covariances, m×m each.
    pub innovation_covs: Stack,
    /// Normalised innovation squared of every row; NaN where nothing was observed.
    pub nis: Vec<f64>,
    /// Observed components of every row.
    pub dof: Vec<usize>,
    /// Verdict on every component of every row, with its test; only with a screen.
    pub screened: Vec<Screened>,
    /// Q of the noise estimator in force after every row, d×d; only with one.
    pub q_hat: Stack,
    /// R in force after every row, m×m; only with a noise estimator.
    pub r_hat: Stack,
    /// Rows at which the filter started anew after a lock-out.
    pub restarts: Vec<usize>,
    /// Times of the predictions ahead, seconds; only of a run with leads.
    pub lead_times: Vec<f64>,
    /// The predictions ahead, made after every measurement for its time and lead.
    pub leads: Gaussians,
    /// Sum of the log-likelihoods of all rows.
    pub log_likelihood: f64,
    /// First row of the run with an estimate: 0 when an initial state was given. Rows before it are NaN.
    pub start: usize,
    /// Where the states live.
    pub space: StateSpace,
    /// Where every row went, and what happened on the way.
    pub books: Books,
}

/// What every row gives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimates<'a> {
    pub(super) predicted: GaussianRef<'a>,
    pub(super) transition: &'a [f64],
    pub(super) motion_noise: &'a [f64],
    pub(super) filtered: GaussianRef<'a>,
    pub(super) innovation: &'a [f64],
    pub(super) innovation_cov: &'a [f64],
    /// NaN where nothing was observed.
    pub(super) nis: f64,
    pub(super) dof: usize,
}

impl FilterRun {
    /// No rows yet, for states of length n and measurements of length m.
    pub fn new(n: usize, m: usize) -> Self {
        Self {
            filtered: Gaussians::new(n),
            predicted: Gaussians::new(n),
            transitions: Repeats::square(n),
            motion_noises: Repeats::square(n),
            innovations: Stack::vectors(m),
            innovation_covs: Stack::square(m),
            leads: Gaussians::new(n),
            space: StateSpace::euclidean(n),
            ..Self::default()
        }
    }

    /// No rows yet, for what this filter gives.
    pub fn of(filter: &Filter) -> Self {
        let (n, m) = (filter.motion().state_dim(), filter.sensor().measurement_dim());
        Self {
            q_hat: Stack::square(filter.adapted_dim()),
            r_hat: Stack::square(m),
            space: filter.motion().space(),
            books: Books::new(filter.strict()),
            ..Self::new(n, m)
        }
    }

    /// Takes memory for so many more rows.
    pub fn reserve(&mut self, rows: usize, history: History) {
        if history == History::Last {
            return;
        }
        self.filtered.reserve(rows);
        self.innovations.reserve(rows);
        self.innovation_covs.reserve(rows);
        self.nis.reserve(rows);
        self.dof.reserve(rows);
        if history == History::Full {
            self.predicted.reserve(rows);
            self.transitions.reserve(rows);
            self.motion_noises.reserve(rows);
        }
    }

    /// Adds what one epoch gave, row `row` of the run.
    pub(super) fn push(&mut self, row: usize, epoch: &Epoch<'_>, memory: Option<&Adaptation>, history: History) {
        if epoch.dof > 0 && !epoch.restarted {
            self.log_likelihood += epoch.log_likelihood;
        }
        if epoch.restarted {
            self.restarts.push(row);
        }
        self.push_estimates(
            &Estimates {
                predicted: (&epoch.prediction.state).into(),
                transition: epoch.prediction.transition(),
                motion_noise: epoch.prediction.noise(),
                filtered: epoch.posterior,
                innovation: epoch.innovation.as_slice(),
                innovation_cov: epoch.innovation_cov.as_slice(),
                nis: if epoch.dof > 0 { epoch.nis } else { f64::NAN },
                dof: epoch.dof,
            },
            history,
        );
        self.screened.extend(epoch.screened.cloned());
        if let Some(memory) = memory {
            self.q_hat.push(memory.q().as_slice());
            self.r_hat.push(memory.r().as_slice());
        }
    }

    /// Adds the estimates of one row.
    #[inline(always)]
    pub(super) fn push_estimates(&mut self, row: &Estimates<'_>, history: History) {
        if history == History::Last {
            self.forget();
        }
        if history == History::Full {
            self.predicted.push(row.predicted);
            self.transitions.push(row.transition);
            self.motion_noises.push(row.motion_noise);
        }
        self.filtered.push(row.filtered);
        self.innovations.push(row.innovation);
        self.innovation_covs.push(row.innovation_cov);
        self.nis.push(row.nis);
        self.dof.push(row.dof);
    }

    /// Adds a prediction ahead.
    pub(super) fn push_lead(&mut self, time: f64, state: &Gaussian, history: History) {
        if history == History::Last {
            self.lead_times.clear();
            self.leads.clear();
        }
        self.lead_times.push(time);
        self.leads.push(state);
    }

    /// Adds the rows up to and with the one that starts a run; that one's prediction ahead is not among them.
    pub(super) fn push_start(&mut self, filter: &Filter, start: &Start, history: History, leads: bool) -> Result<()> {
        self.book_start(start)?;
        let rows = if history == History::Last { 1 } else { start.row + 1 };
        self.start = start.row;
        self.filtered.fill_unknown(rows - 1);
        self.filtered.push(&start.initial.state);
        if leads {
            self.lead_times = vec![f64::NAN; rows - 1];
            self.leads.fill_unknown(rows - 1);
        }
        self.innovations.fill(f64::NAN, rows);
        self.innovation_covs.fill(f64::NAN, rows);
        self.nis = vec![f64::NAN; rows];
        self.dof = vec![0; rows];
        if filter.screen().is_some() {
            let untested = Screened {
                verdicts: vec![Verdict::Missing; filter.sensor().measurement_dim()],
                statistic: f64::NAN,
                dof: 0,
                p_value: f64::NAN,
            };
            self.screened = vec![untested; rows];
        }
        if let Ok(Some(memory)) = filter.new_memory(&start.initial.state) {
            for _ in 0..rows {
                self.q_hat.push(memory.q().as_slice());
                self.r_hat.push(memory.r().as_slice());
            }
        }
        if history == History::Full {
            let n = filter.motion().state_dim();
            self.predicted.fill_unknown(rows);
            let (identity, nothing) = (DMatrix::identity(n, n), DMatrix::zeros(n, n));
            for _ in 0..rows {
                self.transitions.push(identity.as_slice());
                self.motion_noises.push(nothing.as_slice());
            }
        }
        Ok(())
    }

    fn forget(&mut self) {
        self.filtered.clear();
        self.innovations.clear();
        self.innovation_covs.clear();
        self.nis.clear();
        self.dof.clear();
        self.screened.clear();
        self.q_hat.clear();
        self.r_hat.clear();
    }
}
