//! The multi-target tracker.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use trackrs::Scan;
use trackrs::filter::sequence::InitialState;
use trackrs::gating::mahalanobis::Gate;
use trackrs::model::Motion as _;
use trackrs::tracker::clutter_map::ClutterMap;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::in_order::InOrder;
use trackrs::tracker::lifecycle::{Deletion, Existence, Initiator, MofN};
use trackrs::tracker::moments::TrackFilter;
use trackrs::tracker::multi_target::MultiTargetTracker;

use crate::array;
use crate::associator::{AssociatorItems, associator};
use crate::error::{compute, count, to_python};
use crate::model::{Motion, Sensor};
use crate::scans::{
    Columns, EventRecord, LedgerRecord, Rows, ScanArrays, counts, each, late, lock, read_scan, recent, to_scan,
};

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Tracker {
    pub(crate) inner: Mutex<InOrder<MultiTargetTracker>>,
    /// Memory for the scan of a step; used by who has the tracker.
    scan: Mutex<Scan>,
}

impl Tracker {
    fn new_from(tracker: InOrder<MultiTargetTracker>) -> Self {
        Self {
            inner: Mutex::new(tracker),
            scan: Mutex::default(),
        }
    }
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
    /// Kind and window, seconds.
    late: (String, f64),
}

pub(crate) fn filter(name: &str) -> trackrs::Result<TrackFilter> {
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

pub(crate) fn small(name: &str, value: i64) -> trackrs::Result<u32> {
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
            InOrder::new(MultiTargetTracker::new(config)?, late(&settings.late)?)
        })?;
        Ok(Self::new_from(tracker))
    }

    #[staticmethod]
    fn from_bytes(py: Python<'_>, data: &[u8]) -> PyResult<Self> {
        Ok(Self::new_from(compute(py, || InOrder::from_bytes(data))?))
    }

    /// Another one that stands where this one does.
    fn copy(&self, py: Python<'_>) -> PyResult<Self> {
        Ok(Self::new_from(lock(py, &self.inner)?.clone()))
    }

    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let tracker = lock(py, &self.inner)?;
        Ok(PyBytes::new(
            py,
            &tracker.to_bytes().map_err(|error| to_python(py, &error))?,
        ))
    }

    fn step<'py>(&self, py: Python<'py>, scan: ScanArrays<'py>) -> PyResult<Columns<'py>> {
        let mut guard = lock(py, &self.inner)?;
        let mut memory = self.scan.lock().unwrap_or_else(PoisonError::into_inner);
        read_scan(&scan, &mut memory)?;
        let (inner, scan) = (&mut *guard, &*memory);
        let mut rows = rows(inner.tracker().config());
        compute(py, || {
            inner.step(scan, |tracker, scan| rows.push(scan, tracker.track_refs()))
        })?;
        rows.into_columns(py)
    }

    /// Takes in what waits.
    fn flush<'py>(&self, py: Python<'py>) -> PyResult<Columns<'py>> {
        let mut guard = lock(py, &self.inner)?;
        let inner = &mut *guard;
        let mut rows = rows(inner.tracker().config());
        compute(py, || {
            inner.flush(|tracker, scan| rows.push(scan, tracker.track_refs()))
        })?;
        rows.into_columns(py)
    }

    fn run<'py>(&self, py: Python<'py>, scans: Vec<ScanArrays<'py>>) -> PyResult<Columns<'py>> {
        let scans = scans.iter().map(to_scan).collect::<PyResult<Vec<_>>>()?;
        let mut guard = lock(py, &self.inner)?;
        let inner = &mut *guard;
        compute(py, || inner.check_run(&scans))?;
        let mut rows = rows(inner.tracker().config());
        each(py, &scans, |scan| {
            inner.queue(scan, |tracker, scan| rows.push(scan, tracker.track_refs()))
        })?;
        compute(py, || {
            inner.flush(|tracker, scan| rows.push(scan, tracker.track_refs()))?;
            inner.ledger().check()
        })?;
        rows.into_columns(py)
    }

    fn labels(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(lock(py, &self.inner)?.tracker().config().motion.labels())
    }

    fn events(&self, py: Python<'_>) -> PyResult<Vec<EventRecord>> {
        Ok(recent(&lock(py, &self.inner)?.events()))
    }

    fn event_counts(&self, py: Python<'_>) -> PyResult<BTreeMap<&'static str, u64>> {
        Ok(counts(&lock(py, &self.inner)?.events()))
    }

    fn ledger(&self, py: Python<'_>) -> PyResult<LedgerRecord> {
        Ok(LedgerRecord::of(&lock(py, &self.inner)?.ledger()))
    }
}

fn rows(config: &TrackerConfig) -> Rows {
    let existence = matches!(config.initiator, Initiator::Existence(_));
    Rows::new(config.motion.state_dim(), existence, None).with_health()
}
