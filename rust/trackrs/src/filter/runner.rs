//! A filter run epoch by epoch: predict, screen, update, adapt, and restart after a lock-out.
//!
//! For each epoch:
//! 1. the state is predicted with the motion noise in force;
//! 2. the innovation is screened, where a screen is set ([`super::screen`]); rejected components count as not observed;
//! 3. the state is updated with the sensor noise in force;
//! 4. what was used goes into the memory of the noise estimator, where one is set ([`super::noise`]), which changes the
//!    noise of the next epoch (U19); rejected data never adapt it;
//! 5. after [`LOCK_OUT`] epochs in a row whose rejections left no more components than the position has coordinates, the
//!    filter starts anew from the fixes of these epochs, if they pass their redundancy test (U28): then the data agree
//!    among themselves and the prediction is wrong. The smoother's link across a restart is cut (F = 0).
//!
//! Reference: Xi, Liu, Tao, Lu, Tracking submarine moving target with the adaptive estimation methodology; spec labels
//! U19, U24–U28. Deviations: the paper has no restart; U28 has it only when fewer components are left than coordinates, but
//! a filter that has lost its redundancy to one channel, rejected for ever, does not find back by itself either.

use std::collections::VecDeque;
use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::extended::linearise_with_noise;
use super::kalman::{Prediction, Update};
use super::noise::{NoiseMemory, ProcessedEpoch};
use super::screen::{ChiSquareScreen, Screened, Verdict};
use super::sequence::{Filter, FilterRun, History, InitialState, Sequence};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::model::{Motion, Sensor, sensor};

/// Epochs in a row with too few used components after which a restart is tried.
pub const LOCK_OUT: usize = 3;

/// A filter with its state, between two epochs.
pub struct Runner<'a> {
    filter: &'a Filter,
    time: f64,
    state: Gaussian,
    memory: Option<NoiseMemory>,
    allowance: f64,
    /// The epochs in a row with too few used components.
    locked: VecDeque<(f64, DVector<f64>)>,
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
        let memory = filter.new_memory(&initial.state)?;
        let allowance = filter
            .screen()
            .map_or(0.0, |screen| screen.allowance_for(filter.sensor()));
        Ok(Self {
            filter,
            time: initial.time,
            state: initial.state.clone(),
            memory,
            allowance,
            locked: VecDeque::with_capacity(LOCK_OUT),
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
        let noise_input = self.memory.as_ref().and_then(|_| motion.noise_input(dt));
        let motion_noise = match (&self.memory, &noise_input) {
            (Some(memory), Some(entry)) => &entry.gain * memory.q() * entry.gain.transpose(),
            _ => motion.noise(dt),
        };
        let sensor_noise = self
            .memory
            .as_ref()
            .map_or_else(|| sensor_model.noise(), |memory| memory.r().clone());
        let prediction = Prediction::with_noise(&self.state, motion, dt, input, motion_noise);
        let linearised = linearise_with_noise(&prediction.state, sensor_model, None, sensor_noise)?;
        let innovation = sensor::residual(sensor_model, measurement, &linearised.expected);
        let mut used = measurement.clone();
        let mut kept = innovation.clone();
        let mut screened = None;
        if let Some(screen) = self.filter.screen() {
            let (cov, jacobian) = (linearised.prediction.cov(), linearised.prediction.jacobian());
            let outcome = screen.screen(&innovation, cov, jacobian, motion.position_dims(), self.allowance)?;
            kept = outcome.keep_used(&innovation);
            used = outcome.keep_used(measurement);
            screened = Some(outcome);
        }
        let update = linearised.prediction.update(&prediction.state, &kept)?;
        self.time = time;
        self.state = update.posterior.clone();
        let mut result = EpochResult {
            prediction,
            update,
            screened,
            restarted: false,
        };
        if let Some(start) = self.restart(time, measurement, &result)? {
            result.cut(&start);
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

    /// A new start, if the filter has locked itself out and the last epochs' own fixes agree (U28).
    fn restart(&mut self, time: f64, measurement: &DVector<f64>, result: &EpochResult) -> Result<Option<Gaussian>> {
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
        if used > self.filter.motion().position_dims() || !rejected {
            self.locked.clear();
            return Ok(None);
        }
        if self.locked.len() == LOCK_OUT {
            self.locked.pop_front();
        }
        self.locked.push_back((time, measurement.clone()));
        if self.locked.len() < LOCK_OUT {
            return Ok(None);
        }
        let Ok(mut starter) = self.filter.starter() else {
            return Ok(None);
        };
        let (times, measurements): (Vec<f64>, Vec<DVector<f64>>) = self.locked.iter().cloned().unzip();
        let Some(start) = starter.search(&times, &measurements)? else {
            return Ok(None);
        };
        self.locked.clear();
        Ok(Some(start.initial.state))
    }
}

impl EpochResult {
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
