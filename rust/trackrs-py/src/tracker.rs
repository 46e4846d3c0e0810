//! The multi-target tracker.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::{Duration, Instant};

use nalgebra::DVector;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use trackrs::event::Event;
use trackrs::filter::sequence::InitialState;
use trackrs::gating::mahalanobis::Gate;
use trackrs::model::Motion as _;
use trackrs::tracker::clutter_map::ClutterMap;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::lifecycle::{Deletion, Existence, Initiator, MofN};
use trackrs::tracker::moments::TrackFilter;
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::{Scan, Track};

use crate::array;
use crate::associator::{AssociatorItems, associator};
use crate::error::{compute, count, exception, to_python};
use crate::model::{Motion, Sensor};

/// Work between two looks for Ctrl-C.
const CHUNK: Duration = Duration::from_millis(50);

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Tracker {
    inner: Mutex<MultiTargetTracker>,
}

/// Tracks of one or more scans: those of scan k are rows `offsets[k]..offsets[k + 1]`.
#[derive(IntoPyObject)]
pub(crate) struct Columns<'py> {
    offsets: Vec<usize>,
    times: Bound<'py, PyArray1<f64>>,
    ids: Bound<'py, PyArray1<u64>>,
    means: Bound<'py, PyArray2<f64>>,
    covs: Bound<'py, PyArray3<f64>>,
    last_hits: Bound<'py, PyArray1<f64>>,
    hits: Bound<'py, PyArray1<u64>>,
    existences: Option<Bound<'py, PyArray1<f64>>>,
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

/// An initiator of the facade, one kind or the other.
#[derive(FromPyObject)]
pub(crate) enum InitiatorItems {
    #[pyo3(from_item_all)]
    MofN {
        m: i64,
        n: i64,
        max_speed: f64,
        min_displacement: f64,
        min_separation: f64,
        pair_within: Option<f64>,
    },
    #[pyo3(from_item_all)]
    Existence {
        max_speed: f64,
        initial: f64,
        confirm: f64,
        drop: f64,
        lifetime: f64,
        min_displacement: f64,
        min_separation: f64,
        pair_within: Option<f64>,
    },
}

/// The parameters that are no models.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Settings {
    filter: String,
    associator: AssociatorItems,
    initiator: InitiatorItems,
    /// By sensor.
    detection_probability: BTreeMap<String, f64>,
    /// By sensor.
    clutter_density: BTreeMap<String, f64>,
    gate_probability: f64,
    /// Misses, seconds.
    deletion: Option<(i64, Option<f64>)>,
    /// Radius, dwell, minimum of reports, memory.
    clutter_map: Option<(f64, f64, i64, f64)>,
    max_gap: Option<f64>,
    max_tracks: i64,
    strict: bool,
}

fn filter(name: &str) -> trackrs::Result<TrackFilter> {
    match name {
        "extended" => Ok(TrackFilter::Extended),
        "second_order" => Ok(TrackFilter::SecondOrder),
        "unscented" => Ok(TrackFilter::Unscented),
        other => {
            let requirement = "must be extended, second_order or unscented";
            Err(trackrs::Error::invalid("filter", other, requirement))
        }
    }
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
    rejected: BTreeMap<&'static str, u64>,
}

fn small(name: &str, value: i64) -> trackrs::Result<u32> {
    u32::try_from(count(name, value)?).map_err(|_| trackrs::Error::invalid(name, value, "is too large"))
}

fn initiator(items: &InitiatorItems) -> trackrs::Result<Initiator> {
    match *items {
        InitiatorItems::MofN {
            m,
            n,
            max_speed,
            min_displacement,
            min_separation,
            pair_within,
        } => Ok(Initiator::MofN(MofN {
            m: small("m", m)?,
            n: small("n", n)?,
            max_speed,
            min_displacement,
            min_separation,
            pair_within,
        })),
        InitiatorItems::Existence {
            max_speed,
            initial,
            confirm,
            drop,
            lifetime,
            min_displacement,
            min_separation,
            pair_within,
        } => Ok(Initiator::Existence(Existence {
            max_speed,
            initial,
            confirm,
            drop,
            lifetime,
            min_displacement,
            min_separation,
            pair_within,
        })),
    }
}

#[pymethods]
impl Tracker {
    /// `initial` are (time, mean, covariance) of tracks that are there from the beginning.
    #[new]
    fn new(
        py: Python<'_>,
        motion: &Motion,
        sensors: BTreeMap<String, PyRef<'_, Sensor>>,
        settings: Settings,
        initial: Vec<(f64, PyReadonlyArray1<'_, f64>, PyReadonlyArray2<'_, f64>)>,
    ) -> PyResult<Self> {
        let sensors = sensors
            .into_iter()
            .map(|(name, sensor)| (name, sensor.model.clone()))
            .collect();
        let start = |(time, mean, cov): (f64, PyReadonlyArray1<'_, f64>, PyReadonlyArray2<'_, f64>)| {
            Ok(InitialState {
                time,
                state: array::gaussian(&mean, &cov)?,
            })
        };
        let initial = initial.into_iter().map(start).collect::<PyResult<_>>()?;
        let motion = motion.model.clone();
        let tracker = compute(py, move || {
            let initiator = initiator(&settings.initiator)?;
            let mut config = TrackerConfig::new(motion, sensors, initiator.max_speed())?;
            config.filter = filter(&settings.filter)?;
            config.associator = associator(&settings.associator)?;
            config.initiator = initiator;
            config.detection_probability = settings.detection_probability;
            config.clutter_density = settings.clutter_density;
            config.gate = Gate::new(settings.gate_probability)?;
            if let Some((max_misses, max_time)) = settings.deletion {
                let max_misses = small("max_misses", max_misses)?;
                config.deletion = Some(Deletion { max_misses, max_time });
            }
            if let Some((radius, dwell, min_reports, memory)) = settings.clutter_map {
                let min_reports = small("min_reports", min_reports)?;
                config.clutter_map = Some(ClutterMap {
                    radius,
                    dwell,
                    min_reports,
                    memory,
                });
            }
            config.max_gap = settings.max_gap;
            config.max_tracks = count("max_tracks", settings.max_tracks)?;
            config.strict = settings.strict;
            config.initial = initial;
            MultiTargetTracker::new(config)
        })?;
        Ok(Self {
            inner: Mutex::new(tracker),
        })
    }

    #[staticmethod]
    fn from_bytes(py: Python<'_>, data: &[u8]) -> PyResult<Self> {
        Ok(Self {
            inner: Mutex::new(compute(py, || MultiTargetTracker::from_bytes(data))?),
        })
    }

    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let tracker = self.lock(py)?;
        Ok(PyBytes::new(
            py,
            &tracker.to_bytes().map_err(|error| to_python(py, &error))?,
        ))
    }

    fn step<'py>(&self, py: Python<'py>, scan: ScanArrays<'py>) -> PyResult<Columns<'py>> {
        let scan = to_scan(&scan)?;
        let mut guard = self.lock(py)?;
        let tracker = &mut *guard;
        let tracks = compute(py, || tracker.step(&scan))?;
        to_columns(py, tracker.config(), &[tracks])
    }

    fn run<'py>(&self, py: Python<'py>, scans: Vec<ScanArrays<'py>>) -> PyResult<Columns<'py>> {
        let scans = scans.iter().map(to_scan).collect::<PyResult<Vec<_>>>()?;
        let mut guard = self.lock(py)?;
        let tracker = &mut *guard;
        compute(py, || tracker.check_run(&scans))?;
        let mut tracks = Vec::with_capacity(scans.len());
        while tracks.len() < scans.len() {
            compute(py, || {
                let start = Instant::now();
                while tracks.len() < scans.len() && start.elapsed() < CHUNK {
                    tracks.push(tracker.step(&scans[tracks.len()])?);
                }
                Ok(())
            })?;
            py.check_signals()?;
        }
        compute(py, || tracker.ledger().check())?;
        to_columns(py, tracker.config(), &tracks)
    }

    fn labels(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(self.lock(py)?.config().motion.labels())
    }

    fn events(&self, py: Python<'_>) -> PyResult<Vec<EventRecord>> {
        Ok(self.lock(py)?.events().recent().map(EventRecord::from).collect())
    }

    fn event_counts(&self, py: Python<'_>) -> PyResult<BTreeMap<&'static str, u64>> {
        Ok(self
            .lock(py)?
            .events()
            .counts()
            .iter()
            .map(|(code, count)| (code.name(), *count))
            .collect())
    }

    fn ledger(&self, py: Python<'_>) -> PyResult<LedgerRecord> {
        let tracker = self.lock(py)?;
        let ledger = tracker.ledger();
        Ok(LedgerRecord {
            rows_in: ledger.rows_in,
            used: ledger.used,
            late: ledger.late,
            duplicate: ledger.duplicate,
            rejected: ledger
                .rejected
                .iter()
                .map(|(code, rows)| (code.name(), *rows))
                .collect(),
        })
    }
}

impl Tracker {
    /// The tracker, unless another thread is using it.
    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, MultiTargetTracker>> {
        match self.inner.try_lock() {
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
}

fn to_scan(scan: &ScanArrays<'_>) -> PyResult<Scan> {
    let platform = scan
        .platform
        .as_ref()
        .map(|p| array::vector(p, "platform"))
        .transpose()?;
    let times = scan.times.as_ref().map(|t| array::vector(t, "times")).transpose()?;
    let empty = scan.values.shape()[0] == 0;
    Ok(Scan {
        time: scan.time,
        sensor: scan.sensor.clone(),
        values: if empty {
            Vec::new()
        } else {
            array::rows(&scan.values, "values")?
        },
        platform: platform.map(|p: DVector<f64>| p.as_slice().to_vec()),
        times: times.map(|t: DVector<f64>| t.as_slice().to_vec()),
    })
}

fn to_columns<'py>(py: Python<'py>, config: &TrackerConfig, scans: &[Vec<Track>]) -> PyResult<Columns<'py>> {
    let n = config.motion.state_dim();
    let existence = matches!(config.initiator, Initiator::Existence(_));
    let all: Vec<&Track> = scans.iter().flatten().collect();
    let mut offsets = vec![0];
    for tracks in scans {
        offsets.push(offsets[offsets.len() - 1] + tracks.len());
    }
    Ok(Columns {
        offsets,
        times: PyArray1::from_iter(py, all.iter().map(|t| t.time)),
        ids: PyArray1::from_iter(py, all.iter().map(|t| t.id)),
        means: array::from_rows(py, all.iter().map(|t| &t.state.mean), n)?,
        covs: array::from_symmetric(py, all.iter().map(|t| &t.state.cov), n)?,
        last_hits: PyArray1::from_iter(py, all.iter().map(|t| t.last_hit)),
        hits: PyArray1::from_iter(py, all.iter().map(|t| t.hits)),
        existences: existence.then(|| PyArray1::from_iter(py, all.iter().map(|t| t.existence.unwrap_or(1.0)))),
    })
}
