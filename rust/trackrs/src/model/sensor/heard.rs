//! What a position fix has to go by: the heard components of a measurement, refused where no position could make them.
//!
//! Two ranges S_i, S_j to hydrophones a distance d apart: |S_i − S_j| ≤ d ≤ S_i + S_j. A range to a hydrophone at depth ζ
//! and the target's depth Z: |Z − ζ| ≤ S. All of it up to [`ABSURD`] standard deviations; smaller contradictions are for
//! the test of redundancy.

use nalgebra::DVector;

use super::{RangeArray, Sensor};
use crate::error::{Error, Result, require_size};

/// Ranges that no position explains even with errors of so many standard deviations are refused.
pub(super) const ABSURD: f64 = 6.0;

/// One measurement of a [`RangeArray`], sorted.
pub(super) struct Heard {
    /// Components of the measurement that are not NaN.
    pub(super) observed: Vec<usize>,
    /// Those of them that are hydrophones, and their ranges in metres.
    pub(super) channels: Vec<usize>,
    pub(super) ranges: Vec<f64>,
    pub(super) depth: Option<f64>,
}

impl RangeArray {
    /// What was heard, with ranges that a position could have.
    pub(super) fn heard(&self, measurement: &DVector<f64>) -> Result<Heard> {
        let heard = self.sorted(measurement)?;
        self.refuse_absurd(&heard)?;
        Ok(heard)
    }

    /// What was heard, enough of it for a position.
    pub(super) fn sorted(&self, measurement: &DVector<f64>) -> Result<Heard> {
        self.check_values(measurement)?;
        let depth = measurement.get(self.channels()).copied().filter(|z| !z.is_nan());
        let observed: Vec<usize> = (0..measurement.len()).filter(|&i| !measurement[i].is_nan()).collect();
        let channels: Vec<usize> = observed.iter().copied().filter(|&i| i < self.channels()).collect();
        let needed = if depth.is_some() { self.dims() - 1 } else { self.dims() };
        if channels.len() < needed {
            return Err(unobservable(format!(
                "a position fix needs {needed} ranges, {} heard (channels {channels:?})",
                channels.len()
            )));
        }
        Ok(Heard {
            ranges: channels
                .iter()
                .map(|&i| measurement[i] * self.metres_per_unit(i, depth))
                .collect(),
            observed,
            channels,
            depth,
        })
    }

    /// Refuses a measurement of the wrong size, an infinite value or a negative range.
    pub(super) fn check_values(&self, measurement: &DVector<f64>) -> Result<()> {
        require_size("measurement", self.measurement_dim(), measurement.len())?;
        if let Some(index) = measurement.iter().position(|v| v.is_infinite()) {
            return Err(Error::NonFinite {
                what: "measurement".into(),
                index,
            });
        }
        if let Some(i) = (0..self.channels()).find(|&i| measurement[i] < 0.0) {
            let name = format!("measurement of channel {i}");
            return Err(Error::invalid(&name, measurement[i], "must not be negative"));
        }
        Ok(())
    }

    /// Refuses ranges that break the triangle inequality by far, and names the channel that breaks it most often.
    fn refuse_absurd(&self, heard: &Heard) -> Result<()> {
        let spread = match (&self.settings.sound_speed, heard.depth) {
            (Some(speed), None) => speed.spread(),
            _ => 0.0,
        };
        // Lasting errors may be in it as well.
        let std = |slot: usize| {
            let (channel, range) = (heard.channels[slot], heard.ranges[slot]);
            let lasting = libm::hypot(self.bias_std(channel), self.scale_std() * range);
            libm::hypot(self.range_std(channel), lasting)
        };
        let count = heard.channels.len();
        let mut broken = vec![0_usize; count];
        for i in 0..count {
            let (own, s) = (self.hydrophone(heard.channels[i]), heard.ranges[i]);
            if let (Some(depth), Some(depth_std)) = (heard.depth, self.settings.depth_std) {
                let slack = ABSURD * libm::hypot(std(i), depth_std) + spread * s;
                if s + slack < (depth - own[self.dims() - 1]).abs() {
                    broken[i] += count;
                }
            }
            for j in 0..i {
                let (d, t) = ((self.hydrophone(heard.channels[j]) - &own).norm(), heard.ranges[j]);
                let slack = ABSURD * libm::hypot(std(i), std(j)) + spread * (s + t);
                if s + t + slack < d || (s - t).abs() > d + slack {
                    broken[i] += 1;
                    broken[j] += 1;
                }
            }
        }
        let worst = broken.iter().copied().max().unwrap_or(0);
        if worst == 0 {
            return Ok(());
        }
        let culprits: Vec<usize> = (0..count).filter(|&i| broken[i] == worst).collect();
        let channels: Vec<usize> = culprits.iter().map(|&i| heard.channels[i]).collect();
        let ranges: Vec<f64> = culprits.iter().map(|&i| heard.ranges[i]).collect();
        Err(Error::invalid(
            &format!("range of channel {}", list(&channels)),
            format!("{} m", list(&ranges)),
            "no position agrees with it and the other channels",
        ))
    }
}

pub(super) fn unobservable(reason: String) -> Error {
    Error::Unobservable {
        sensor: "RangeArray".into(),
        reason,
    }
}

pub(super) fn list<T: ToString>(values: &[T]) -> String {
    let texts: Vec<String> = values.iter().map(ToString::to_string).collect();
    texts.join(", ")
}
