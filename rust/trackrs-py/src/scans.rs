//! Scans in, tracks out: what the trackers share.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::{Duration, Instant};

use nalgebra::DMatrix;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use trackrs::event::{Event, EventLog, Ledger};
use trackrs::tracker::in_order::Late;
use trackrs::{Extent, Scan, TrackRef};

use crate::array::{self, frozen};
use crate::error::{compute, exception};

/// Work between two looks for Ctrl-C.
const CHUNK: Duration = Duration::from_millis(50);

/// Tracks of one or more scans: those of scan k are rows `offsets[k]..offsets[k + 1]`.
#[derive(IntoPyObject)]
pub(crate) struct Columns<'py> {
    scan_times: Bound<'py, PyArray1<f64>>,
    sensors: Bound<'py, PyTuple>,
    offsets: Bound<'py, PyArray1<i64>>,
    times: Bound<'py, PyArray1<f64>>,
    ids: Bound<'py, PyArray1<u64>>,
    means: Bound<'py, PyArray2<f64>>,
    covs: Bound<'py, PyArray3<f64>>,
    last_hits: Bound<'py, PyArray1<f64>>,
    hits: Bound<'py, PyArray1<u64>>,
    existences: Option<Bound<'py, PyArray1<f64>>>,
    extents: Option<Bound<'py, PyArray3<f64>>>,
    healths: Option<Bound<'py, PyArray1<i8>>>,
}

/// What becomes of late scans: a kind, and the window where it has one.
pub(crate) fn late((kind, window): &(String, f64)) -> trackrs::Result<Late> {
    let window = *window;
    match kind.as_str() {
        "drop_late" => Ok(Late::Drop),
        "reorder" => Ok(Late::Reorder { window }),
        "replay" => Ok(Late::Replay { window }),
        other => {
            let requirement = "must be drop_late, reorder or replay";
            Err(trackrs::Error::invalid("late", other, requirement))
        }
    }
}

/// A scan of the facade.
#[derive(FromPyObject)]
pub(crate) struct ScanArrays<'py> {
    time: f64,
    sensor: String,
    values: PyReadonlyArray2<'py, f64>,
    platform: Option<PyReadonlyArray1<'py, f64>>,
    times: Option<PyReadonlyArray1<'py, f64>>,
}

#[derive(IntoPyObject)]
pub(crate) struct EventRecord {
    code: &'static str,
    time: f64,
    sensor: String,
    row: Option<usize>,
    reason: String,
}

impl From<&Event> for EventRecord {
    fn from(event: &Event) -> Self {
        Self {
            code: event.code.name(),
            time: event.time,
            sensor: event.sensor.clone(),
            row: event.row,
            reason: event.reason.clone(),
        }
    }
}

#[derive(IntoPyObject)]
pub(crate) struct LedgerRecord {
    rows_in: u64,
    used: u64,
    late: u64,
    duplicate: u64,
    waiting: u64,
    rejected: BTreeMap<&'static str, u64>,
}

impl LedgerRecord {
    pub(crate) fn of(ledger: &Ledger) -> Self {
        let rejected = ledger.rejected.iter().map(|(code, rows)| (code.name(), *rows));
        Self {
            rows_in: ledger.rows_in,
            used: ledger.used,
            late: ledger.late,
            duplicate: ledger.duplicate,
            waiting: ledger.waiting,
            rejected: rejected.collect(),
        }
    }
}

pub(crate) fn recent(log: &EventLog) -> Vec<EventRecord> {
    log.recent().map(EventRecord::from).collect()
}

pub(crate) fn counts(log: &EventLog) -> BTreeMap<&'static str, u64> {
    log.counts().iter().map(|(code, count)| (code.name(), *count)).collect()
}

/// The tracker, unless another thread is using it.
pub(crate) fn lock<'a, T>(py: Python<'_>, tracker: &'a Mutex<T>) -> PyResult<MutexGuard<'a, T>> {
    match tracker.try_lock() {
        Ok(guard) => Ok(guard),
        Err(TryLockError::WouldBlock) => Err(exception(
            py,
            "BusyError",
            "this tracker is in use by another thread".into(),
        )),
        Err(TryLockError::Poisoned(_)) => Err(exception(
            py,
            "InternalError",
            "this tracker failed before; restore it from saved bytes".into(),
        )),
    }
}

/// Steps through scans in pieces between which Ctrl-C is looked for.
pub(crate) fn each(
    py: Python<'_>,
    scans: &[Scan],
    mut step: impl FnMut(&Scan) -> trackrs::Result<()> + Send,
) -> PyResult<()> {
    let mut left = scans.iter();
    while left.len() > 0 {
        compute(py, || {
            let start = Instant::now();
            while start.elapsed() < CHUNK {
                let Some(scan) = left.next() else { break };
                step(scan)?;
            }
            Ok(())
        })?;
        py.check_signals()?;
    }
    Ok(())
}

/// A scan of the facade as one of the core.
pub(crate) fn to_scan(given: &ScanArrays<'_>) -> PyResult<Scan> {
    let mut scan = Scan::default();
    read_scan(given, &mut scan)?;
    Ok(scan)
}

/// The same in the memory of another.
pub(crate) fn read_scan(given: &ScanArrays<'_>, scan: &mut Scan) -> PyResult<()> {
    let numbers = |array: &Option<PyReadonlyArray1<'_, f64>>, name: &str| {
        let slice = array.as_ref().map(|array| array::c_slice(array, name)).transpose()?;
        Ok::<_, PyErr>(slice.map(<[f64]>::to_vec))
    };
    scan.time = given.time;
    scan.sensor.clone_from(&given.sensor);
    array::read_rows(&given.values, "values", &mut scan.values)?;
    scan.platform = numbers(&given.platform, "platform")?;
    scan.times = numbers(&given.times, "times")?;
    Ok(())
}

/// The extents of some targets, where extents of so many dimensions are learnt.
pub(crate) fn extents<'py, 'a>(
    py: Python<'py>,
    dims: Option<usize>,
    all: impl Iterator<Item = Option<&'a Extent>>,
) -> PyResult<Option<Bound<'py, PyArray3<f64>>>> {
    let Some(d) = dims else { return Ok(None) };
    let covs: Vec<&DMatrix<f64>> = all.flatten().map(|extent| &extent.cov).collect();
    array::from_symmetric(py, covs.into_iter(), d).map(Some)
}

/// The tracks of scans, row by row.
pub(crate) struct Rows {
    /// Length of a state, and number of dimensions of an extent where extents are learnt.
    n: usize,
    dims: Option<usize>,
    scan_times: Vec<f64>,
    sensors: Vec<String>,
    offsets: Vec<i64>,
    times: Vec<f64>,
    ids: Vec<u64>,
    means: Vec<f64>,
    covs: Vec<f64>,
    last_hits: Vec<f64>,
    hits: Vec<u64>,
    existences: Option<Vec<f64>>,
    extents: Vec<f64>,
    healths: Option<Vec<i8>>,
}

impl Rows {
    pub(crate) fn new(n: usize, existence: bool, dims: Option<usize>) -> Self {
        Self {
            n,
            dims,
            scan_times: Vec::new(),
            sensors: Vec::new(),
            offsets: vec![0],
            times: Vec::new(),
            ids: Vec::new(),
            means: Vec::new(),
            covs: Vec::new(),
            last_hits: Vec::new(),
            hits: Vec::new(),
            existences: existence.then(Vec::new),
            extents: Vec::new(),
            healths: None,
        }
    }

    /// With the health of every track.
    pub(crate) fn with_health(mut self) -> Self {
        self.healths = Some(Vec::new());
        self
    }

    /// Takes in the tracks after one more scan.
    pub(crate) fn push<'a>(&mut self, scan: &Scan, tracks: impl Iterator<Item = TrackRef<'a>> + Clone) {
        let (count, n) = (tracks.clone().count(), self.n);
        self.times.reserve(count);
        self.healths.iter_mut().for_each(|healths| healths.reserve(count));
        self.ids.reserve(count);
        self.means.reserve(count * n);
        self.covs.reserve(count * n * n);
        self.last_hits.reserve(count);
        self.hits.reserve(count);
        self.scan_times.push(scan.time);
        self.sensors.push(scan.sensor.clone());
        for track in tracks {
            self.times.push(track.time);
            self.ids.push(track.id);
            self.means.extend_from_slice(track.state.mean.as_slice());
            self.covs.extend_from_slice(track.state.cov.as_slice());
            self.last_hits.push(track.last_hit);
            self.hits.push(track.hits);
            if let Some(existences) = &mut self.existences {
                existences.push(track.existence.unwrap_or(1.0));
            }
            if let (Some(healths), Some(health)) = (&mut self.healths, track.health) {
                healths.push(health as i8);
            }
            if let Some(extent) = track.extent {
                self.extents.extend_from_slice(extent.cov.as_slice());
            }
        }
        self.offsets.push(i64::try_from(self.ids.len()).unwrap_or(i64::MAX));
    }

    /// The columns, read-only; their memory is handed over.
    pub(crate) fn into_columns(self, py: Python<'_>) -> PyResult<Columns<'_>> {
        let (count, n) = (self.ids.len(), self.n);
        let extents = |d: usize| {
            let found = self.extents.len() / (d * d).max(1);
            frozen(PyArray1::from_vec(py, self.extents).reshape([found, d, d])?)
        };
        Ok(Columns {
            scan_times: frozen(PyArray1::from_vec(py, self.scan_times))?,
            sensors: PyTuple::new(py, self.sensors)?,
            offsets: frozen(PyArray1::from_vec(py, self.offsets))?,
            times: frozen(PyArray1::from_vec(py, self.times))?,
            ids: frozen(PyArray1::from_vec(py, self.ids))?,
            means: frozen(PyArray1::from_vec(py, self.means).reshape([count, n])?)?,
            covs: frozen(PyArray1::from_vec(py, self.covs).reshape([count, n, n])?)?,
            last_hits: frozen(PyArray1::from_vec(py, self.last_hits))?,
            hits: frozen(PyArray1::from_vec(py, self.hits))?,
            healths: self
                .healths
                .map(|healths| frozen(PyArray1::from_vec(py, healths)))
                .transpose()?,
            extents: self.dims.map(extents).transpose()?,
            existences: self
                .existences
                .map(|existences| frozen(PyArray1::from_vec(py, existences)))
                .transpose()?,
        })
    }
}
