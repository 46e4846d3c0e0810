//! What a tracker takes in: scans and rows are checked, what is refused is booked and told.

use std::collections::BTreeMap;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::look::Row;
use crate::error::{Error, Result, require_finite};
use crate::event::{Books, Event, EventCode, EventLog, Ledger};
use crate::linalg::same_bits;
use crate::model::sensor::check_platform;
use crate::model::{Sensor, SensorModel};
use crate::scan::Scan;

/// An odd number without pattern: 2⁶⁴ over the golden ratio.
const MIX: u64 = 0x9E37_79B9_7F4A_7C15;

/// The clock and the books of a tracker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Intake {
    pub(super) time: Option<f64>,
    last_scans: BTreeMap<String, Scan>,
    pub(super) events: EventLog,
    pub(super) ledger: Ledger,
}

/// The clock without the books: what is put back where time is.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct IntakeState {
    time: Option<f64>,
    last_scans: BTreeMap<String, Scan>,
}

/// What reports must have to take part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Needs {
    /// One component; times of their own are welcome.
    Something,
    /// All components, and the time of the scan.
    Everything,
}

/// An error that names a sensor the tracker does not have.
pub(super) fn unknown_sensor<'a>(sensor: &str, known: impl Iterator<Item = &'a String>) -> Error {
    let known: Vec<String> = known.map(|name| format!("\"{name}\"")).collect();
    Error::UnknownSensor {
        sensor: sensor.into(),
        known: known.join(", "),
    }
}

impl Intake {
    /// A strict one turns the first event into an error.
    pub(super) fn new(time: Option<f64>, strict: bool) -> Self {
        Self {
            time,
            last_scans: BTreeMap::new(),
            events: EventLog::new(strict),
            ledger: Ledger::default(),
        }
    }

    /// Records an event about a track, which is no error in strict mode either.
    pub(super) fn note(&mut self, scan: &Scan, code: EventCode, reason: &str) {
        self.events.note(Event {
            code,
            time: scan.time,
            sensor: scan.sensor.clone(),
            row: None,
            reason: reason.into(),
        });
    }

    /// Checks what was read back.
    pub(super) fn check_restored(&self) -> Result<()> {
        self.time.map_or(Ok(()), |time| require_finite("time", [&time]))?;
        self.events.check_restored()?;
        self.ledger.check_restored()
    }

    /// Where the clock stands.
    pub(super) fn state(&self) -> IntakeState {
        IntakeState {
            time: self.time,
            last_scans: self.last_scans.clone(),
        }
    }

    /// Puts the clock back; the books stay.
    pub(super) fn set_state(&mut self, state: IntakeState) {
        self.time = state.time;
        self.last_scans = state.last_scans;
    }

    /// Forgets the time and the scans before.
    pub(super) fn forget(&mut self) {
        self.time = None;
        self.last_scans.clear();
    }

    /// Puts other books in the place of its own.
    pub(super) fn swap_books(&mut self, books: &mut Books) {
        std::mem::swap(&mut self.events, &mut books.events);
        std::mem::swap(&mut self.ledger, &mut books.ledger);
    }

    /// Takes over what other books have.
    pub(super) fn absorb(&mut self, later: &Books) {
        self.events.absorb(&later.events);
        self.ledger.absorb(&later.ledger);
    }

    /// Drops a whole scan.
    pub(super) fn refuse(&mut self, scan: &Scan, code: EventCode, reason: &str) -> Result<()> {
        let rows = scan.values.len() as u64;
        self.ledger.rows_in += rows;
        self.ledger.drop_rows(code, rows);
        self.record(scan, code, None, reason)
    }

    /// Whether a run over these scans would be accepted: known sensors, finite times that never decrease from that of before on.
    pub(super) fn check_run<'a>(
        scans: &[Scan],
        before: Option<f64>,
        find: impl Fn(&str) -> Result<&'a SensorModel>,
    ) -> Result<()> {
        let mut previous = before.unwrap_or(f64::NEG_INFINITY);
        for scan in scans {
            find(&scan.sensor)?;
            require_finite("scan time", [&scan.time])?;
            if scan.time < previous {
                return Err(Error::TimeReversed {
                    time: scan.time,
                    previous,
                });
            }
            previous = scan.time;
        }
        Ok(())
    }

    /// The rows of a scan that take part, in the order of their times; every row is booked. None if the scan cannot be used;
    /// without a sensor it cannot, for the reason given.
    pub(super) fn admit<'a>(
        &mut self,
        scan: &'a Scan,
        sensor: std::result::Result<&SensorModel, String>,
        needs: Needs,
    ) -> Result<Option<Vec<Row<'a>>>> {
        self.ledger.rows_in += scan.values.len() as u64;
        let admitted = match sensor {
            Err(unknown) => Err((EventCode::UnknownSensor, unknown)),
            Ok(sensor) => self.refusal(scan, sensor, needs).map_or(Ok(sensor), Err),
        };
        match admitted {
            Err((code, reason)) => {
                self.ledger.drop_rows(code, scan.values.len() as u64);
                self.record(scan, code, None, &reason)?;
                Ok(None)
            }
            Ok(sensor) => {
                let rows = self.usable_rows(scan, sensor.measurement_dim(), needs)?;
                self.ledger.used += rows.len() as u64;
                match self.last_scans.get_mut(&scan.sensor) {
                    Some(last) => last.copy_from(scan),
                    None => drop(self.last_scans.insert(scan.sensor.clone(), scan.clone())),
                }
                Ok(Some(rows))
            }
        }
    }

    pub(super) fn record(&mut self, scan: &Scan, code: EventCode, row: Option<usize>, reason: &str) -> Result<()> {
        self.events.record(Event {
            code,
            time: scan.time,
            sensor: scan.sensor.clone(),
            row,
            reason: reason.into(),
        })
    }

    /// Records that steps of a track, without an identity while it is tentative, are done by roots.
    pub(super) fn tell_rooted(&mut self, scan: &Scan, id: Option<u64>) -> Result<()> {
        let name = id.map_or("a tentative track".into(), |id| format!("track {id}"));
        let reason = format!("the covariance of {name} is nearly singular: such steps are done by its root");
        self.record(scan, EventCode::Escalated, None, &reason)
    }

    /// Why a scan cannot be used whenever it had come, if so.
    pub(super) fn fault(scan: &Scan, sensor: &SensorModel, needs: Needs) -> Option<(EventCode, String)> {
        if !scan.time.is_finite() {
            return Some((EventCode::BadScan, format!("its time is {}", scan.time)));
        }
        let platform = scan.platform.as_ref().map(|p| DVector::from_row_slice(p));
        if let Err(error) = check_platform(sensor, platform.as_ref()) {
            return Some((EventCode::BadScan, error.to_string()));
        }
        if let Some(times) = scan.times.as_ref().filter(|times| times.len() != scan.values.len()) {
            let reason = format!("it has {} reports and {} times", scan.values.len(), times.len());
            return Some((EventCode::BadScan, reason));
        }
        if needs == Needs::Everything && scan.times.is_some() {
            return Some((EventCode::BadScan, "its reports have times of their own".into()));
        }
        None
    }

    /// Why a whole scan cannot be used, if so.
    fn refusal(&self, scan: &Scan, sensor: &SensorModel, needs: Needs) -> Option<(EventCode, String)> {
        if let Some(fault) = Self::fault(scan, sensor, needs) {
            return Some(fault);
        }
        let last = self.last_scans.get(&scan.sensor);
        if last.is_some_and(|last| last.same_content(scan)) {
            return Some((EventCode::Duplicate, "it repeats the sensor's last scan".into()));
        }
        match self.time {
            Some(now) if scan.time < now => Some((EventCode::LateScan, format!("the tracker stands at {now} s"))),
            _ => None,
        }
    }

    /// The rows that take part, in the order of their times; the others are booked.
    fn usable_rows<'a>(&mut self, scan: &'a Scan, width: usize, needs: Needs) -> Result<Vec<Row<'a>>> {
        let repeated = repeated(scan);
        let mut rows = Vec::with_capacity(scan.values.len());
        for (index, row) in scan.values.iter().enumerate() {
            let time = scan.times.as_ref().map_or(scan.time, |times| times[index]);
            let fault = if row.len() != width {
                Some((
                    EventCode::WrongSize,
                    format!("it has {} values instead of {width}", row.len()),
                ))
            } else if row.iter().any(|v| v.is_infinite()) {
                Some((EventCode::NonFinite, "it holds an infinite value".into()))
            } else if row.iter().all(|v| v.is_nan()) {
                Some((EventCode::NotObserved, "no component was observed".into()))
            } else if needs == Needs::Everything && row.iter().any(|v| v.is_nan()) {
                Some((EventCode::NotObserved, "a component was not observed".into()))
            } else if !(time <= scan.time && time > f64::NEG_INFINITY) {
                Some((
                    EventCode::BadTime,
                    format!("its time is {time}, that of the scan {}", scan.time),
                ))
            } else if let Some(now) = self.time.filter(|&now| time < now) {
                Some((
                    EventCode::LateReport,
                    format!("it is of {time} s, the tracker stands at {now} s"),
                ))
            } else if repeated[index] {
                Some((EventCode::Duplicate, "it repeats a row of its scan".into()))
            } else {
                None
            };
            match fault {
                None => rows.push(Row { time, value: row }),
                Some((code, reason)) => {
                    self.ledger.drop_rows(code, 1);
                    self.record(scan, code, Some(index), &reason)?;
                }
            }
        }
        rows.sort_by(|a, b| a.time.total_cmp(&b.time));
        Ok(rows)
    }
}

/// Whether each row repeats an earlier one of its scan, at the same time. What is wrong with a row is wrong with all its
/// repetitions.
fn repeated(scan: &Scan) -> Vec<bool> {
    let time = |row: usize| scan.times.as_ref().map_or(0, |times| times[row].to_bits());
    let same =
        |a: usize, b: usize| time(a) == time(b) && same_bits(scan.values[a].as_slice(), scan.values[b].as_slice());
    let key = |row: usize| {
        let mix = |sum: u64, bits: u64| (sum ^ bits).wrapping_mul(MIX).rotate_left(29);
        scan.values[row].iter().fold(time(row), |sum, v| mix(sum, v.to_bits()))
    };
    // What has the same key stands together, in the order of the rows.
    let mut keys: Vec<(u64, usize)> = (0..scan.values.len()).map(|row| (key(row), row)).collect();
    keys.sort_unstable();
    let mut out = vec![false; keys.len()];
    for alike in keys.chunk_by(|a, b| a.0 == b.0) {
        for (index, &(_, row)) in alike.iter().enumerate() {
            out[row] = alike[..index].iter().rev().any(|&(_, earlier)| same(earlier, row));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_repeated_by_the_same_bits_at_the_same_time() {
        let rows = [[1.0, 2.0], [0.0, 2.0], [1.0, 2.0], [-0.0, 2.0], [1.0, 2.0]];
        let scan = Scan::new(1.0, "radar", rows.map(|row| DVector::from_row_slice(&row)).to_vec());
        assert_eq!(repeated(&scan), [false, false, true, false, true]);
        let timed = scan.at_times(&[0.1, 0.1, 0.2, 0.1, 0.1]);
        assert_eq!(repeated(&timed), [false, false, false, false, true]);
        assert!(repeated(&Scan::new(1.0, "radar", vec![])).is_empty());
    }
}
