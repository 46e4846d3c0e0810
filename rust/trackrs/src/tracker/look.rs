//! One scan while the tracker works on it, and what becomes of its reports.

use std::ops::Range;

use nalgebra::DVector;

use crate::gaussian::Gaussian;
use crate::model::{Sensor, SensorModel};
use crate::scan::Scan;

/// A report that takes part.
#[derive(Clone, Copy)]
pub(super) struct Row<'a> {
    pub(super) time: f64,
    pub(super) value: &'a DVector<f64>,
}

/// One scan while it is being worked on.
pub(super) struct Look<'a> {
    pub(super) scan: &'a Scan,
    pub(super) sensor: SensorModel,
    pub(super) sensor_index: usize,
    pub(super) platform: Option<DVector<f64>>,
    /// In the order of their times.
    pub(super) rows: Vec<Row<'a>>,
    /// The times at which there are reports, increasing, and at the end that of the scan.
    pub(super) epochs: Vec<f64>,
    pub(super) fates: Vec<Fate>,
}

impl<'a> Look<'a> {
    pub(super) fn new(scan: &'a Scan, sensor_index: usize, sensor: SensorModel, rows: Vec<Row<'a>>) -> Self {
        let platform = scan.platform.as_ref().map(|p| DVector::from_row_slice(p));
        let mut epochs: Vec<f64> = rows.iter().map(|row| row.time).chain([scan.time]).collect();
        epochs.dedup();
        Self {
            epochs,
            fates: vec![Fate::default(); rows.len()],
            scan,
            sensor,
            sensor_index,
            platform,
            rows,
        }
    }

    /// The rows of an epoch.
    pub(super) fn rows_of(&self, epoch: usize) -> Range<usize> {
        let time = self.epochs[epoch];
        let from = self.rows.partition_point(|row| row.time < time);
        from..from + self.rows[from..].partition_point(|row| row.time <= time)
    }

    /// Where a report lies, where its sensor can tell.
    pub(super) fn position(&self, row: usize) -> Option<Gaussian> {
        self.sensor.locate(self.rows[row].value, self.platform.as_ref())
    }
}

/// What became of one report.
#[derive(Clone, Copy, Default)]
pub(super) struct Fate {
    pub(super) taker: Option<Taker>,
    pub(super) near_confirmed: bool,
    pub(super) echo: bool,
    /// Probability that it is of a track.
    pub(super) explained: f64,
}

/// The track that took a report: the likeliest, where it is more likely than not that the report is of a track.
#[derive(Clone, Copy)]
pub(super) struct Taker {
    pub(super) track: usize,
    pub(super) confirmed: bool,
}

impl Fate {
    /// Whether the report may start a track that is to be confirmed by counting.
    pub(super) fn is_free(&self) -> bool {
        self.taker.is_none() && !self.near_confirmed && !self.echo
    }
}
