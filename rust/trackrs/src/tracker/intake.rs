//! What the tracker takes in: scans and rows are checked, what is refused is booked and told.

use std::collections::HashSet;

use nalgebra::DVector;

use super::look::Row;
use super::multi_target::MultiTargetTracker;
use crate::error::Result;
use crate::event::{Event, EventCode};
use crate::model::Sensor;
use crate::model::sensor::check_platform;
use crate::scan::{Scan, bit_pattern};

impl MultiTargetTracker {
    pub(super) fn record(&mut self, scan: &Scan, code: EventCode, row: Option<usize>, reason: &str) -> Result<()> {
        self.events.record(Event {
            code,
            time: scan.time,
            sensor: scan.sensor.clone(),
            row,
            reason: reason.into(),
        })
    }

    /// Why a whole scan cannot be used, if so.
    pub(super) fn refusal(&self, scan: &Scan) -> Option<(EventCode, String)> {
        let Some(sensor) = self.config.sensors.get(&scan.sensor) else {
            return Some((
                EventCode::UnknownSensor,
                self.config.unknown_sensor(&scan.sensor).to_string(),
            ));
        };
        if !scan.time.is_finite() {
            return Some((EventCode::BadScan, format!("its time is {}", scan.time)));
        }
        let platform = scan.platform.as_ref().map(|p| DVector::from_row_slice(p));
        if let Err(error) = check_platform(sensor, platform.as_ref()) {
            return Some((EventCode::BadScan, error.to_string()));
        }
        if self
            .last_scans
            .get(&scan.sensor)
            .is_some_and(|last| last.same_content(scan))
        {
            return Some((EventCode::Duplicate, "it repeats the sensor's last scan".into()));
        }
        if let Some(times) = scan.times.as_ref().filter(|times| times.len() != scan.values.len()) {
            let reason = format!("it has {} reports and {} times", scan.values.len(), times.len());
            return Some((EventCode::BadScan, reason));
        }
        match self.time {
            Some(now) if scan.time < now => Some((EventCode::LateScan, format!("the tracker stands at {now} s"))),
            _ => None,
        }
    }

    /// The rows that take part, in the order of their times; the others are booked.
    pub(super) fn usable_rows(&mut self, scan: &Scan) -> Result<Vec<Row>> {
        let width = self.config.sensors.get(&scan.sensor).map_or(0, Sensor::measurement_dim);
        let mut seen = HashSet::new();
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
            } else if !seen.insert((time.to_bits(), bit_pattern(row.as_slice()))) {
                Some((EventCode::Duplicate, "it repeats a row of its scan".into()))
            } else {
                None
            };
            match fault {
                None => rows.push(Row {
                    time,
                    value: row.clone(),
                }),
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
