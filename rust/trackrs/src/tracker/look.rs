//! One scan while the tracker works on it, and what becomes of its reports.

use nalgebra::DVector;

use crate::gaussian::Gaussian;
use crate::model::{Sensor, SensorModel};
use crate::scan::Scan;

/// One scan while it is being worked on.
pub(super) struct Look<'a> {
    pub(super) scan: &'a Scan,
    pub(super) sensor: SensorModel,
    pub(super) sensor_index: usize,
    pub(super) platform: Option<DVector<f64>>,
    pub(super) reports: Vec<DVector<f64>>,
    /// Where each report lies, where its sensor can tell.
    pub(super) positions: Vec<Option<Gaussian>>,
    pub(super) fates: Vec<Fate>,
}

impl<'a> Look<'a> {
    pub(super) fn new(scan: &'a Scan, sensor_index: usize, sensor: SensorModel, reports: Vec<DVector<f64>>) -> Self {
        let platform = scan.platform.as_ref().map(|p| DVector::from_row_slice(p));
        Self {
            positions: reports
                .iter()
                .map(|report| sensor.locate(report, platform.as_ref()))
                .collect(),
            fates: vec![Fate::default(); reports.len()],
            scan,
            sensor,
            sensor_index,
            platform,
            reports,
        }
    }
}

/// What became of one report.
#[derive(Clone, Copy, Default)]
pub(super) struct Fate {
    pub(super) taker: Option<Taker>,
    pub(super) near_confirmed: bool,
    pub(super) echo: bool,
}

/// The track that took a report.
#[derive(Clone, Copy)]
pub(super) struct Taker {
    pub(super) track: usize,
    pub(super) confirmed: bool,
}

impl Fate {
    /// Whether the report may start a track.
    pub(super) fn is_free(&self) -> bool {
        self.taker.is_none() && !self.near_confirmed && !self.echo
    }
}
