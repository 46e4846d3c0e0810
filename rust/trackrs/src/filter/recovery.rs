//! A way back for a filter that is lost: a new start after a lock-out, and ranges held while the prediction is too vague.
//!
//! Lock-out (U28): after three epochs in a row whose rejections left no more components than the position has coordinates,
//! the filter starts anew from these epochs, if they pass their redundancy test: then the data agree among themselves and
//! the prediction is wrong. Where single epochs cannot fix a position, the same from the first rejection on, as long as at
//! least every second epoch is rejected.
//!
//! Fixes that nothing can contradict, as reported positions, must agree with one another, one more of them than the state has
//! derivatives: three gross errors in a row are not a target.
//!
//! Long gap: a prediction too vague to linearise the measurement at ([`crate::model::sensor::PositionFix::vague`]) is kept
//! as it is, and the measurements are held until together they give a start ([`super::search`]); the lasting errors of the
//! sensor enter it as they are known. The prediction was not wrong, so the smoother's link stays: it bridges the gap from
//! both sides. Held measurements count as missing.
//!
//! Reference: spec label U28. Deviations: the paper has no restart; U28 has it only when fewer components are left than
//! coordinates, but a filter that has lost its redundancy to one channel, rejected for ever, does not find back by itself
//! either.

use nalgebra::DVector;

use super::screen::{ChiSquareScreen, Screened, Verdict};
use super::search::Starter;
use super::sequence::Filter;
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::model::{Motion, Sensor};

/// What the runner knows of an epoch beside its own estimates.
pub(super) struct Row<'a> {
    pub(super) time: f64,
    pub(super) measurement: &'a [f64],
    pub(super) input: Option<&'a [f64]>,
}

/// The searches for a new start.
#[derive(Default)]
pub(super) struct Recovery<'a> {
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
pub(super) struct Held {
    /// The state at its time, if the held measurements give one.
    pub(super) start: Option<Gaussian>,
}

impl<'a> Recovery<'a> {
    /// Holds a measurement, if the prediction is too vague to use it, or has been since those before.
    pub(super) fn hold(&mut self, filter: &'a Filter, row: &Row<'_>, prediction: &Gaussian) -> Result<Option<Held>> {
        let fixer = filter.sensor().position_fix();
        let Some(fixer) = fixer.filter(|_| filter.screen().is_some_and(ChiSquareScreen::restarts)) else {
            return Ok(None);
        };
        if self.held.is_none() {
            if !fixer.vague(prediction, row.measurement) {
                return Ok(None);
            }
            let Ok(starter) = filter.starter() else {
                return Ok(None);
            };
            self.held = Some(starter.with_errors_of(prediction));
            self.locked = None;
        }
        let Some(search) = &mut self.held else {
            return Ok(None);
        };
        let start = push(search, row)?;
        if start.is_some() {
            self.held = None;
        }
        Ok(Some(Held { start }))
    }

    /// A new start, if the filter has locked itself out and the last epochs' own fixes agree (U28); `used` components of
    /// this epoch passed its screening.
    pub(super) fn restart(
        &mut self,
        filter: &'a Filter,
        row: &Row<'_>,
        screened: Option<&Screened>,
        used: usize,
    ) -> Result<Option<Gaussian>> {
        let Some(screened) = screened.filter(|_| filter.screen().is_some_and(ChiSquareScreen::restarts)) else {
            return Ok(None);
        };
        let rejected = screened.verdicts.contains(&Verdict::Rejected);
        let free = !rejected || used > filter.motion().position_dims();
        if free && self.locked.is_none() {
            return Ok(None);
        }
        let fixer = filter.sensor().position_fix();
        let sufficient = fixer.is_some_and(|fixer| fixer.sufficient(row.measurement));
        let free = match &mut self.locked {
            Some(lock) if !sufficient => {
                lock.epochs += usize::from(row.measurement.iter().any(|v| !v.is_nan()));
                lock.rejecting += usize::from(rejected);
                2 * lock.rejecting < lock.epochs
            }
            _ => free,
        };
        if free {
            self.locked = None;
            return Ok(None);
        }
        if self.locked.is_none() {
            self.locked = filter.starter().ok().map(|search| LockOut {
                search: search.with_agreement(),
                epochs: 1,
                rejecting: 1,
            });
        }
        let Some(LockOut { search, .. }) = &mut self.locked else {
            return Ok(None);
        };
        let start = push(search, row)?;
        if start.is_some() {
            self.locked = None;
        }
        Ok(start)
    }
}

fn push(search: &mut Starter<'_>, row: &Row<'_>) -> Result<Option<Gaussian>> {
    let input = row.input.map(DVector::from_column_slice);
    let measurement = DVector::from_column_slice(row.measurement);
    let start = search.push(row.time, &measurement, input.as_ref())?;
    Ok(start.map(|initial| initial.state))
}
