//! One scan while the tracker works on it, and what becomes of its reports.

use nalgebra::DVector;

use crate::gaussian::Gaussian;
use crate::model::{Sensor, SensorModel};
use crate::scan::Scan;

/// A report that takes part.
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
    /// Where each report lies, where its sensor can tell.
    pub(super) positions: Vec<Option<Gaussian>>,
    pub(super) fates: Vec<Fate>,
}

impl<'a> Look<'a> {
    pub(super) fn new(scan: &'a Scan, sensor_index: usize, sensor: SensorModel, rows: Vec<Row<'a>>) -> Self {
        let platform = scan.platform.as_ref().map(|p| DVector::from_row_slice(p));
        Self {
            positions: rows
                .iter()
                .map(|row| sensor.locate(row.value, platform.as_ref()))
                .collect(),
            fates: vec![Fate::default(); rows.len()],
            scan,
            sensor,
            sensor_index,
            platform,
            rows,
        }
    }

    /// The times at which there are reports, increasing, and at the end that of the scan.
    pub(super) fn epochs(&self) -> Vec<f64> {
        let mut out: Vec<f64> = self.rows.iter().map(|row| row.time).collect();
        out.push(self.scan.time);
        out.dedup();
        out
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
