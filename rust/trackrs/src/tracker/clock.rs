//! Which times to believe: a stamp far in the future, and a clock that was set back.
//!
//! | symbol | name here   | meaning                                                                                     |
//! |--------|-------------|---------------------------------------------------------------------------------------------|
//! | T      | `newest`    | newest time that is believed                                                                |
//! | g      | `gap`       | a longer step is a jump: the tracker's `max_gap`, or [`JUMP`] where it has none             |
//! | w      | `window`    | how far behind T a scan may come; 0 where late ones are dropped                             |
//! | b      | `behind`    | a scan so far behind T may be of a clock that was set back: g, or the window of waiting if longer |
//! | f      | `Clock::trial` | time of a scan with f − T > g, which is on trial                                         |
//!
//! 1. A scan more than g ahead of T is on trial until the next one, of time t. It was wrong, and is taken back, if t < f − w and
//!    |t − T| ≤ g: the next one goes on from T, and would be late otherwise. If not, it is believed, and T = f.
//! 2. Scans more than b behind T are late. After [`ENOUGH`] of them in a row, each within g of the one before, with that sensor
//!    among them whose scan made T (or after [`PLENTY`] without it), the clock was set back: T is the time of the last one.
//!    A burst of old scans of one sensor among several does not do that, as the others go on in between.
//!
//! Two scans in a row from the future are believed; then rule 2 finds the way back.

use serde::{Deserialize, Serialize};

use crate::error::{Result, require_finite};

/// A longer step is a jump where the tracker has no longest gap, seconds.
pub(super) const JUMP: f64 = 600.0;
/// So many scans in a row make a clock that was set back.
const ENOUGH: u32 = 5;
/// So many where the sensor of the newest scan is not heard any more.
const PLENTY: u32 = 50;

/// What is believed of time.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Clock {
    pub(super) newest: Option<f64>,
    /// Sensor of that scan.
    sensor: String,
    /// Time of the scan that is on trial.
    pub(super) trial: Option<f64>,
    back: Option<Back>,
}

/// Scans from far behind, in a row.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Back {
    count: u32,
    last: f64,
    /// Whether the sensor of the newest scan is among them.
    heard: bool,
}

/// What a scan says of the one before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trial {
    /// There was none on trial.
    None,
    Believed,
    Wrong,
}

/// What the scan itself is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// Ordinary; perhaps late.
    Usual,
    /// On trial from now on.
    Ahead,
    /// The first of a clock that was set back.
    SetBack,
}

impl Clock {
    /// One that stands at a time.
    pub(super) fn at(newest: Option<f64>) -> Self {
        Self {
            newest,
            ..Self::default()
        }
    }

    /// Decides about the scan on trial, if there is one.
    pub(super) fn decide(&mut self, time: f64, gap: f64, window: f64) -> Trial {
        let Some(future) = self.trial.take() else {
            return Trial::None;
        };
        if time < future - window && self.newest.is_some_and(|newest| (time - newest).abs() <= gap) {
            return Trial::Wrong;
        }
        self.newest = Some(future);
        Trial::Believed
    }

    /// Takes in the time of a scan.
    pub(super) fn take(&mut self, time: f64, sensor: &str, gap: f64, behind: f64) -> Step {
        let Some(newest) = self.newest else {
            self.start(time, sensor);
            return Step::Usual;
        };
        if newest - time > behind {
            let heard = sensor == self.sensor;
            let back = match self.back {
                Some(back) if (time - back.last).abs() <= gap => Back {
                    count: back.count.saturating_add(1),
                    last: time,
                    heard: back.heard || heard,
                },
                _ => Back {
                    count: 1,
                    last: time,
                    heard,
                },
            };
            self.back = Some(back);
            if back.count >= PLENTY || back.count >= ENOUGH && (back.heard || self.sensor.is_empty()) {
                self.start(time, sensor);
                return Step::SetBack;
            }
            return Step::Usual;
        }
        self.back = None;
        if time - newest > gap {
            self.trial = Some(time);
            sensor.clone_into(&mut self.sensor);
            return Step::Ahead;
        }
        if time >= newest {
            self.newest = Some(time);
            sensor.clone_into(&mut self.sensor);
        }
        Step::Usual
    }

    /// Whether its times are numbers.
    pub(super) fn check_restored(&self) -> Result<()> {
        let back = self.back.map(|back| back.last);
        require_finite("clock", self.newest.iter().chain(&self.trial).chain(&back))
    }

    /// Begins with this time.
    fn start(&mut self, time: f64, sensor: &str) {
        *self = Self::at(Some(time));
        sensor.clone_into(&mut self.sensor);
    }
}
