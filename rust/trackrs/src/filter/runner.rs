//! A filter run epoch by epoch: predict, screen, update, adapt, and restart after a lock-out.
//!
//! For each epoch:
//! 1. the state is predicted with the motion noise in force;
//! 2. the innovation is screened, where a screen is set ([`super::screen`]); rejected components count as not observed;
//! 3. the state is updated with the sensor noise in force;
//! 4. what was used goes into the memory of the noise estimator, where one is set ([`super::noise`]), which changes the
//!    noise of the next epoch (U19); rejected data never adapt it;
//! 5. after three epochs in a row whose rejections left no more components than the position has coordinates, the filter
//!    starts anew from the fixes of these epochs, if they pass their redundancy test (U28): then the data agree among
//!    themselves and the prediction is wrong. The smoother's link across a restart is cut (F = 0). Where single epochs
//!    cannot fix a position, the same from the first rejection on, as long as at least every second epoch is rejected.
//!
//! With a screen there is also a way back after a long gap: a prediction too vague to linearise the measurement at
//! ([`crate::model::sensor::PositionFix::vague`]) is kept as it is, and the measurements are held until together they give
//! a start ([`super::search`]); the lasting errors of the sensor enter it as they are known. The prediction was not wrong,
//! so the smoother's link stays: it bridges the gap from both sides. Held measurements count as missing.
//!
//! Reference: Xi, Liu, Tao, Lu, Tracking submarine moving target with the adaptive estimation methodology; spec labels
//! U19, U24–U28. Deviations: the paper has no restart; U28 has it only when fewer components are left than coordinates, but
//! a filter that has lost its redundancy to one channel, rejected for ever, does not find back by itself either.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::kalman::{Prediction, Update};
use super::noise::{NoiseMemory, ProcessedEpoch};
use super::screen::{ChiSquareScreen, Screened, Verdict};
use super::search::Starter;
use super::sequence::{Filter, FilterRun, History, InitialState, Sequence};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::model::{Motion, Sensor, sensor};

/// A filter with its state, between two epochs.
pub struct Runner<'a> {
    filter: &'a Filter,
    time: f64,
    state: Gaussian,
    memory: Option<NoiseMemory>,
    allowance: f64,
    /// Epochs in which the filter rejects what it should use, and the search for a start among them.
    locked: Option<LockOut<'a>>,
    /// The search among the measurements that are held.
    held: Option<Starter<'a>>,
}

struct LockOut<'a> {
    search: Starter<'a>,
    epochs: usize,
    rejecting: usize,
}

/// A measurement that is not used because the prediction is too vague.
struct Held {
    /// The state at its time, if the held measurements give one.
    start: Option<Gaussian>,
}

/// What one epoch gives.
#[derive(Debug, Clone)]
pub struct EpochResult {
    /// Before the measurement.
    pub prediction: Prediction,
    /// The update; its posterior is the new state, its NIS and innovation are over the used components.
    pub update: Update,
    /// The verdicts, where a screen is set.
    pub screened: Option<Screened>,
    /// Whether the posterior is a new start instead of the update's.
    pub restarted: bool,
}

impl<'a> Runner<'a> {
    /// A run of `filter` that begins at `initial`.
    pub fn new(filter: &'a Filter, initial: &InitialState) -> Result<Self> {
        let state = filter.complete(&initial.state)?;
        let memory = filter.new_memory(&state)?;
        let allowance = filter
            .screen()
            .map_or(0.0, |screen| screen.allowance_for(filter.sensor()));
        Ok(Self {
            filter,
            time: initial.time,
            state,
            memory,
            allowance,
            locked: None,
            held: None,
        })
    }

    /// The noise estimator, where one is set.
    pub fn memory(&self) -> Option<&NoiseMemory> {
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
        for row in rows {
            let input = data.inputs.map(|inputs| &inputs[row]);
            let epoch = self.step(data.times[row], &data.measurements[row], input)?;
            run.push(row, epoch, self.memory(), history);
        }
        Ok(())
    }

    /// Goes on to a measurement (length m, NaN = not observed) at `time`, not before the last one; `input` (length n) is
    /// added to the predicted state.
    pub fn step(&mut self, time: f64, measurement: &DVector<f64>, input: Option<&DVector<f64>>) -> Result<EpochResult> {
        let (motion, sensor_model) = (self.filter.motion(), self.filter.sensor());
        let dt = time - self.time;
        let input = input.map(|input| self.filter.complete_input(input));
        let noise_input = self.memory.as_ref().and_then(|_| motion.noise_input(dt));
        let motion_noise = match (&self.memory, &noise_input) {
            (Some(memory), Some(entry)) => &entry.gain * memory.q() * entry.gain.transpose(),
            _ => motion.noise(dt),
        };
        let sensor_noise = self
            .memory
            .as_ref()
            .map_or_else(|| sensor_model.noise(), |memory| memory.r().clone());
        let prediction = Prediction::with_noise(&self.state, motion, dt, input.as_ref(), motion_noise);
        let held = self.hold(time, measurement, input.as_ref(), &prediction.state)?;
        let nothing = DVector::from_element(measurement.len(), f64::NAN);
        let usable = if held.is_some() { &nothing } else { measurement };
        let linearised = self.filter.linearise(&prediction.state, None, sensor_noise)?;
        let innovation = sensor::residual(sensor_model, usable, &linearised.expected);
        let mut used = usable.clone();
        let mut kept = innovation.clone();
        let mut screened = None;
        if let Some(screen) = self.filter.screen() {
            let (cov, jacobian) = (linearised.prediction.cov(), linearised.prediction.jacobian());
            let outcome = screen.screen(&innovation, cov, jacobian, motion.position_dims(), self.allowance)?;
            kept = outcome.keep_used(&innovation);
            used = outcome.keep_used(usable);
            screened = Some(outcome);
        }
        let update = linearised.prediction.update(&prediction.state, &kept)?;
        self.time = time;
        self.state.clone_from(&update.posterior);
        let mut result = EpochResult {
            prediction,
            update,
            screened,
            restarted: false,
        };
        let found = match held {
            Some(held) => held.start.inspect(|start| result.begin(start)),
            None => self
                .restart(time, measurement, input.as_ref(), &result)?
                .inspect(|start| result.cut(start)),
        };
        if let Some(start) = found {
            self.state = start;
            if let Some(memory) = &mut self.memory {
                memory.restart(self.state.clone());
            }
        } else if let (Some(memory), Some(entry)) = (&mut self.memory, noise_input) {
            let epoch = ProcessedEpoch {
                predicted: result.prediction.state.clone(),
                filtered: self.state.clone(),
                transition: result.prediction.transition.clone(),
                noise: result.prediction.noise.clone(),
                gain: entry.gain,
                measurement: used,
                platform: None,
            };
            memory.push(epoch, sensor_model)?;
        }
        Ok(result)
    }

    /// Holds a measurement, if the prediction is too vague to use it, or has been since those before.
    fn hold(
        &mut self,
        time: f64,
        measurement: &DVector<f64>,
        input: Option<&DVector<f64>>,
        prediction: &Gaussian,
    ) -> Result<Option<Held>> {
        if !self.filter.screen().is_some_and(ChiSquareScreen::restarts) {
            return Ok(None);
        }
        if self.held.is_none() {
            let fixer = self.filter.sensor().position_fix();
            if fixer.is_none_or(|fixer| !fixer.vague(prediction, measurement)) {
                return Ok(None);
            }
            let Ok(starter) = self.filter.starter() else {
                return Ok(None);
            };
            self.held = Some(starter.with_errors_of(prediction));
            self.locked = None;
        }
        let Some(search) = &mut self.held else {
            return Ok(None);
        };
        let start = search.push(time, measurement, input)?.map(|initial| initial.state);
        if start.is_some() {
            self.held = None;
        }
        Ok(Some(Held { start }))
    }

    /// A new start, if the filter has locked itself out and the last epochs' own fixes agree (U28).
    fn restart(
        &mut self,
        time: f64,
        measurement: &DVector<f64>,
        input: Option<&DVector<f64>>,
        result: &EpochResult,
    ) -> Result<Option<Gaussian>> {
        let Some(screened) = &result.screened else {
            return Ok(None);
        };
        if !self.filter.screen().is_some_and(ChiSquareScreen::restarts) {
            return Ok(None);
        }
        let rejected = screened.verdicts.contains(&Verdict::Rejected);
        let used = screened
            .verdicts
            .iter()
            .filter(|&&verdict| verdict == Verdict::Used)
            .count();
        let fixer = self.filter.sensor().position_fix();
        let sufficient = fixer.is_some_and(|fixer| fixer.sufficient(measurement));
        let free = match &mut self.locked {
            Some(lock) if !sufficient => {
                lock.epochs += usize::from(measurement.iter().any(|v| !v.is_nan()));
                lock.rejecting += usize::from(rejected);
                2 * lock.rejecting < lock.epochs
            }
            _ => !rejected || used > self.filter.motion().position_dims(),
        };
        if free {
            self.locked = None;
            return Ok(None);
        }
        if self.locked.is_none() {
            self.locked = self.filter.starter().ok().map(|search| LockOut {
                search,
                epochs: 1,
                rejecting: 1,
            });
        }
        let Some(LockOut { search, .. }) = &mut self.locked else {
            return Ok(None);
        };
        let start = search.push(time, measurement, input)?;
        if start.is_some() {
            self.locked = None;
        }
        Ok(start.map(|initial| initial.state))
    }
}

impl EpochResult {
    /// Makes the epoch a new start after a vague prediction, which stays.
    fn begin(&mut self, start: &Gaussian) {
        self.update.posterior = start.clone();
        self.restarted = true;
    }

    /// Makes the epoch a new start: the state before the measurement is the start itself, reached from nothing.
    fn cut(&mut self, start: &Gaussian) {
        let n = start.dim();
        self.prediction = Prediction {
            state: start.clone(),
            transition: DMatrix::zeros(n, n),
            noise: start.cov.clone(),
        };
        self.update.posterior = start.clone();
        self.restarted = true;
    }
}
