//! A filter run epoch by epoch: predict, screen, update, adapt, and restart after a lock-out.
//!
//! For each epoch:
//! 1. the state is predicted with the motion noise in force;
//! 2. the innovation is screened, where a screen is set ([`super::screen`]); rejected components count as not observed;
//! 3. the state is updated with the sensor noise in force;
//! 4. what was used goes into the memory of the noise estimator, where one is set ([`super::noise`]), which changes the
//!    noise of the next epoch (U19); rejected data never adapt it;
//! 5. a filter that is lost finds its way back (`recovery.rs`): after a lock-out it starts anew from the fixes of the
//!    last epochs, and the smoother's link is cut (F = 0); measurements that meet a prediction too vague to use them are held
//!    until together they give a start, and the link stays.
//!
//! A covariance that comes close to being singular is carried as its square root from then on (`escalation.rs`).
//!
//! Reference: Xi, Liu, Tao, Lu, Tracking submarine moving target with the adaptive estimation methodology; spec labels
//! U19, U24–U28.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::adaptation::{Adaptation, Corrected};
use super::booking::Place;
use super::extended::Method;
use super::fixed::{FixedRows, Now, fixed};
use super::look::{Look, Target};
use super::noise::ProcessedEpoch;
use super::prediction::{Course, Prediction, Steps};
use super::recovery::{Recovery, Row};
use super::run::FilterRun;
use super::screen::{Screened, Verdict};
use super::sequence::{Filter, History, InitialState, Sequence};
use super::square_root::factor_of;
use crate::error::{Error, Result};
use crate::gaussian::{Gaussian, GaussianRef};
use crate::interrupt::ahead;
use crate::model::{Motion, Sensor};

/// A filter with its state, between two epochs. The memory that an epoch works in serves the next one again.
pub struct Runner<'a> {
    pub(super) filter: &'a Filter,
    /// The filter's, and after an escalation that of roots.
    pub(super) method: Method,
    /// Whether covariances are looked at.
    pub(super) watch: bool,
    time: f64,
    pub(super) state: Gaussian,
    /// Its factor, in square-root form.
    pub(super) factor: Option<Vec<f64>>,
    pub(super) prediction: Prediction,
    /// For predictions ahead.
    pub(super) ahead: Prediction,
    between: Gaussian,
    pub(super) look: Look,
    pub(super) memory: Option<Adaptation>,
    gain: Vec<f64>,
    screened: Option<Screened>,
    allowance: f64,
    /// The measurement with NaN in place of what was rejected.
    used: Vec<f64>,
    recovery: Recovery<'a>,
    /// The rows that need nothing beyond a prediction and an update, where the filter is of a common size.
    pub(super) fixed: Option<Box<dyn FixedRows>>,
}

/// What one epoch gives, until the next one.
#[derive(Debug, Clone, Copy)]
pub struct Epoch<'a> {
    /// Before the measurement.
    pub prediction: &'a Prediction,
    /// After it: the new state.
    pub posterior: GaussianRef<'a>,
    /// Measured minus predicted, NaN where not observed or rejected; length m.
    pub innovation: &'a DVector<f64>,
    /// Its covariance for all m components.
    pub innovation_cov: &'a DMatrix<f64>,
    /// Normalised innovation squared of the used components.
    pub nis: f64,
    /// Number of used components.
    pub dof: usize,
    /// ln N of the used components.
    pub log_likelihood: f64,
    /// The verdicts, where a screen is set.
    pub screened: Option<&'a Screened>,
    /// Whether the posterior is a new start instead of the update's.
    pub restarted: bool,
    /// Whether the measurement waits, because the prediction is too vague to use it by.
    pub held: bool,
    /// Whether covariances are carried as square roots from here on, because one came close to being singular.
    pub escalated: bool,
}

/// What became of an epoch.
#[derive(Clone, Copy, Default)]
struct Outcome {
    restarted: bool,
    held: bool,
    escalated: bool,
}

impl<'a> Runner<'a> {
    /// A run of `filter` that begins at `initial`.
    pub fn new(filter: &'a Filter, initial: &InitialState) -> Result<Self> {
        let state = filter.complete(&initial.state)?;
        let memory = filter.new_memory(&state)?;
        let allowance = filter
            .screen()
            .map_or(0.0, |screen| screen.allowance_for(filter.sensor()));
        let space = filter.motion().space();
        let n = space.dim;
        let method = *filter.method();
        Ok(Self {
            filter,
            method,
            watch: filter.escalates(),
            time: initial.time,
            factor: factor_of(method.form, &state.cov)?,
            between: state.clone(),
            state,
            prediction: Prediction::new(space, method.rule, method.form),
            ahead: Prediction::new(space, method.rule, method.form),
            look: Look::new(space, filter.sensor(), &method)?,
            gain: vec![
                0.0;
                if memory.is_some() {
                    n * filter.sensor().measurement_dim()
                } else {
                    0
                }
            ],
            memory,
            screened: None,
            allowance,
            used: Vec::with_capacity(filter.sensor().measurement_dim()),
            recovery: Recovery::default(),
            fixed: fixed(filter),
        })
    }

    /// A factor U of the state's covariance Uᵀ U, n×n row by row, in square-root form.
    pub fn factor(&self) -> Option<&[f64]> {
        self.factor.as_deref()
    }

    /// The noise estimator, where one is set.
    pub fn memory(&self) -> Option<&Adaptation> {
        self.memory.as_ref()
    }

    /// Goes through these rows of a sequence and adds what they give to `run`.
    pub fn advance(
        &mut self,
        data: &Sequence<'_>,
        rows: Range<usize>,
        history: History,
        run: &mut FilterRun,
    ) -> Result<()> {
        let (n, m) = (self.state.dim(), self.filter.sensor().measurement_dim());
        let (end, known) = (data.first_row + rows.end, run.filtered.len());
        let mut rows = rows;
        while !rows.is_empty() {
            if let Some(fixed) = &mut self.fixed
                && data.inputs.is_none()
                && data.leads.is_none()
            {
                let now = Now {
                    time: &mut self.time,
                    state: &mut self.state,
                };
                let taken = fixed.advance(self.filter, now, data, rows.clone(), history, run)?;
                run.books.ledger.rows_in += taken as u64;
                run.books.ledger.used += taken as u64;
                rows.start += taken;
            }
            let Some(row) = rows.next() else {
                break;
            };
            ahead(n * n * n);
            let input = data.inputs.map(|inputs| &inputs[row * n..(row + 1) * n]);
            let measurement = &data.measurements[row * m..(row + 1) * m];
            let outcome = self.advance_to(data.times[row], measurement, input)?;
            let place = Place {
                row: data.first_row + row,
                time: self.time,
            };
            let epoch = self.epoch(outcome);
            run.book(&place, measurement, &epoch)?;
            run.push(place.row, &epoch, self.memory.as_ref(), history);
            if let Some(leads) = data.leads {
                self.look_ahead(leads[row], history, run)?;
            }
        }
        run.books.ledger.check()?;
        // Those of the last row alone where no other is kept.
        let known = if history == History::Last { 0 } else { known };
        match run.filtered.first_not_finite(known) {
            None => Ok(()),
            Some(at) => Err(Error::Overflow {
                what: format!("estimate at row {}", end - (run.filtered.len() - at)),
            }),
        }
    }

    /// Adds to `run` the prediction by `lead` seconds from where the runner is.
    pub fn look_ahead(&mut self, lead: f64, history: History, run: &mut FilterRun) -> Result<()> {
        let motion = self.filter.motion();
        let noise = match &mut self.memory {
            Some(memory) => Some(memory.step_noise(motion, &self.state.mean, lead)?),
            None => None,
        };
        let course = Course {
            motion,
            dt: lead,
            input: None,
            noise,
        };
        self.ahead.predict(&self.state, self.factor.as_deref(), &course)?;
        self.ahead.state.require_finite("prediction ahead")?;
        run.push_lead(self.time + lead, &self.ahead.state, history);
        Ok(())
    }

    /// Predicts the state to `dt` seconds later, in as many steps as the filter takes.
    pub(super) fn predict(&mut self, dt: f64, input: Option<&[f64]>) -> Result<()> {
        let motion = self.filter.motion();
        let steps = self.filter.steps();
        let dt = dt / steps as f64;
        let mut earlier: Option<Steps> = None;
        for step in 0..steps {
            let from = if step == 0 { &self.state } else { &self.prediction.state };
            let noise = match &mut self.memory {
                Some(memory) => Some(memory.step_noise(motion, &from.mean, dt)?),
                None => None,
            };
            let course = Course {
                motion,
                dt,
                input: input.filter(|_| step + 1 == steps),
                noise,
            };
            if step == 0 {
                self.prediction.predict(&self.state, self.factor.as_deref(), &course)?;
            } else {
                self.between.clone_from(&self.prediction.state);
                let factor = self.prediction.factor().map(<[f64]>::to_vec);
                self.prediction.predict(&self.between, factor.as_deref(), &course)?;
            }
            if let Some(earlier) = &earlier {
                self.prediction.join(earlier);
            }
            if step + 1 < steps {
                earlier = Some(Steps::from(&self.prediction));
            }
        }
        Ok(())
    }

    /// Goes on to a measurement (length m, NaN = not observed) at `time`, not before the last one; `input` (length n) is
    /// added to the predicted state.
    pub fn step(&mut self, time: f64, measurement: &[f64], input: Option<&[f64]>) -> Result<Epoch<'_>> {
        let outcome = self.advance_to(time, measurement, input)?;
        let epoch = self.epoch(outcome);
        if self.filter.strict() {
            FilterRun::of(self.filter).book(&Place { row: 0, time }, measurement, &epoch)?;
        }
        Ok(epoch)
    }

    fn epoch(&self, outcome: Outcome) -> Epoch<'_> {
        let correction = &self.look.correction;
        Epoch {
            prediction: &self.prediction,
            posterior: (&self.state).into(),
            innovation: &self.look.innovation,
            innovation_cov: self.look.linearised.prediction.cov(),
            nis: correction.nis,
            dof: correction.dof,
            log_likelihood: correction.log_likelihood,
            screened: self.screened.as_ref(),
            restarted: outcome.restarted,
            held: outcome.held,
            escalated: outcome.escalated,
        }
    }

    fn advance_to(&mut self, time: f64, measurement: &[f64], input: Option<&[f64]>) -> Result<Outcome> {
        let (motion, sensor) = (self.filter.motion(), self.filter.sensor());
        let (n, dt) = (self.state.dim(), time - self.time);
        let mut outcome = Outcome::default();
        self.predict(dt, input)?;
        if self.watch && self.prediction.state.is_nearly_singular() {
            outcome.escalated = self.escalate(dt, input);
        }
        if let Some(memory) = &self.memory {
            self.look.set_noise(memory.r().as_slice())?;
        }
        let row = Row {
            time,
            measurement,
            input,
        };
        let held = self.recovery.hold(self.filter, &row, &self.prediction.state)?;
        outcome.held = held.is_some();
        self.used.clear();
        match held {
            Some(_) => self.used.resize(measurement.len(), f64::NAN),
            None => self.used.extend_from_slice(measurement),
        }
        let target = Target::of(&self.prediction, sensor);
        self.look.expect(&target, &self.used)?;
        if let Some(screen) = self.filter.screen() {
            let expected = &self.look.linearised.prediction;
            let jacobian = DMatrix::from_row_slice(measurement.len(), n, expected.jacobian());
            let dims = motion.position_dims();
            let outcome = screen.screen(&self.look.innovation, expected.cov(), &jacobian, dims, self.allowance)?;
            for (i, verdict) in outcome.verdicts.iter().enumerate() {
                if *verdict != Verdict::Used {
                    (self.look.innovation[i], self.used[i]) = (f64::NAN, f64::NAN);
                }
            }
            self.screened = Some(outcome);
        }
        self.look.correct(&target, &self.used)?;
        if self.watch && self.look.correction.posterior.is_nearly_singular() && self.escalate(dt, input) {
            outcome.escalated = true;
            let target = Target::of(&self.prediction, sensor);
            self.look.expect(&target, &self.used)?;
            self.look.correct(&target, &self.used)?;
        }
        self.time = time;
        std::mem::swap(&mut self.state, &mut self.look.correction.posterior);
        if let (Some(factor), Some(found)) = (
            &mut self.factor,
            self.look.correction.factor().or(self.prediction.factor()),
        ) {
            factor.copy_from_slice(found);
        }
        let found = if let Some(held) = held {
            held.start
        } else {
            let used = self.look.correction.dof;
            let start = self.recovery.restart(self.filter, &row, self.screened.as_ref(), used)?;
            // The state before the measurement is the start itself, reached from nothing.
            start.inspect(|start| self.prediction.cut(start))
        };
        if let Some(start) = found {
            self.factor = factor_of(self.method.form, &start.cov)?;
            self.state = start;
            if let Some(memory) = &mut self.memory {
                memory.restart((&self.state).into());
            }
            outcome.restarted = true;
            return Ok(outcome);
        }
        if let Some(memory) = &mut self.memory {
            let epoch = ProcessedEpoch {
                predicted: (&self.prediction.state).into(),
                filtered: (&self.state).into(),
                transition: self.prediction.transition(),
                noise: self.prediction.noise(),
                measurement: &self.used,
                platform: None,
            };
            let correction = &self.look.correction;
            correction.gain_into(n, &mut self.gain);
            let corrected = Corrected {
                innovation: self.look.innovation.as_slice(),
                gain: &self.gain,
                nis: correction.nis,
                dof: correction.dof,
            };
            memory.push(&epoch, &corrected, sensor)?;
        }
        Ok(outcome)
    }
}
