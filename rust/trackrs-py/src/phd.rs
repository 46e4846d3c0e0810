//! Trackers by intensity.

use std::collections::BTreeMap;
use std::sync::Mutex;

use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use trackrs::model::Motion as _;
use trackrs::rfs::mixture::Reduction;
use trackrs::rfs::prediction::{Birth, Fate, Spawn};
use trackrs::rfs::rate::Rate;
use trackrs::tracker::in_order::InOrder;
use trackrs::tracker::phd::PhdTracker;
use trackrs::tracker::phd::config::{AdaptiveBirth, Confirmation, PhdConfig, Watch};
use trackrs::{Scan, TrackRef};

use crate::array;
use crate::error::{compute, count, to_python};
use crate::model::{Motion, Sensor};
use crate::phd_update::IntensityUpdate;
use crate::scans::{
    Columns, EventRecord, LedgerRecord, Rows, ScanArrays, counts, each, extents, late, lock, recent, to_scan,
};
use crate::tracker::{filter, small};

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct IntensityTracker {
    pub(crate) inner: Mutex<InOrder<PhdTracker>>,
}

/// Tracks of scans, and the expected number of targets after each.
#[derive(IntoPyObject)]
pub(crate) struct IntensityColumns<'py> {
    tracks: Columns<'py>,
    expected_targets: Bound<'py, PyArray1<f64>>,
}

/// A mixture.
#[derive(IntoPyObject)]
pub(crate) struct MixtureColumns<'py> {
    weights: Bound<'py, PyArray1<f64>>,
    means: Bound<'py, PyArray2<f64>>,
    covs: Bound<'py, PyArray3<f64>>,
    detection_rates: Bound<'py, PyArray1<f64>>,
    extents: Option<Bound<'py, PyArray3<f64>>>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct WeightedState<'py> {
    weight: f64,
    mean: PyReadonlyArray1<'py, f64>,
    cov: PyReadonlyArray2<'py, f64>,
}

fn weighted(items: &[WeightedState<'_>]) -> PyResult<Vec<Birth>> {
    let one = |item: &WeightedState<'_>| {
        Ok(Birth {
            weight: item.weight,
            state: array::gaussian(&item.mean, &item.cov)?,
        })
    };
    items.iter().map(one).collect()
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct AdaptiveItems {
    weight: f64,
    max_speed: f64,
    min_measurements: i64,
}

/// Everything that is no model.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct PhdSettings<'py> {
    filter: String,
    survival_probability: f64,
    /// By sensor.
    detection_probability: BTreeMap<String, f64>,
    /// By sensor.
    clutter_density: BTreeMap<String, f64>,
    births: Vec<WeightedState<'py>>,
    adaptive_birth: Option<AdaptiveItems>,
    spawns: Vec<WeightedState<'py>>,
    /// Of a newborn; for point targets without meaning.
    detections_per_target: f64,
    rate_shape: f64,
    prune: f64,
    merge: f64,
    max_components: i64,
    confirm_after: i64,
    end_after: i64,
    strict: bool,
    /// Kind and window, seconds.
    late: (String, f64),
}

#[pymethods]
impl IntensityTracker {
    #[new]
    #[pyo3(signature = (motion, sensors, update, settings, initial, time = None))]
    fn new(
        py: Python<'_>,
        motion: &Motion,
        sensors: BTreeMap<String, PyRef<'_, Sensor>>,
        update: &IntensityUpdate,
        settings: PhdSettings<'_>,
        initial: Vec<WeightedState<'_>>,
        time: Option<f64>,
    ) -> PyResult<Self> {
        let births = weighted(&settings.births)?;
        let initial = weighted(&initial)?;
        let spawns = settings.spawns.iter().map(|item| {
            Ok(Spawn {
                weight: item.weight,
                offset: array::vector(&item.mean, "spawn offset")?,
                cov: array::matrix(&item.cov, "spawn cov")?,
            })
        });
        let spawns = spawns.collect::<PyResult<Vec<Spawn>>>()?;
        let sensors: Vec<_> = sensors
            .into_iter()
            .map(|(name, sensor)| (name, sensor.model.clone()))
            .collect();
        let (motion, update) = (motion.model.clone(), update.core.clone());
        let rate = Rate::with_mean(settings.detections_per_target, settings.rate_shape);
        let PhdSettings {
            filter: rule,
            survival_probability,
            detection_probability,
            clutter_density,
            adaptive_birth,
            prune,
            merge,
            max_components,
            confirm_after,
            end_after,
            strict,
            late: policy,
            ..
        } = settings;
        let tracker = compute(py, move || {
            let given = |map: &BTreeMap<String, f64>, name: &str, what: &str| {
                let requirement = "must be given for every sensor";
                let value = map.get(name).copied();
                value.ok_or_else(|| trackrs::Error::invalid(&format!("{what} of \"{name}\""), "None", requirement))
            };
            for (map, what) in [
                (&detection_probability, "detection_probability"),
                (&clutter_density, "clutter_density"),
            ] {
                let known = |name: &&String| sensors.iter().any(|(sensor, _)| sensor == *name);
                if let Some(name) = map.keys().find(|name| !known(name)) {
                    let what = format!("{what} of \"{name}\"");
                    return Err(trackrs::Error::invalid(
                        &what,
                        map[name],
                        "must be of a sensor that is there",
                    ));
                }
            }
            let mut watches = BTreeMap::new();
            for (name, sensor) in sensors {
                let watch = Watch {
                    sensor,
                    detection_probability: given(&detection_probability, &name, "detection_probability")?,
                    clutter_density: given(&clutter_density, &name, "clutter_density")?,
                };
                watches.insert(name, watch);
            }
            let adaptive_birth = match adaptive_birth {
                None => None,
                Some(items) => Some(AdaptiveBirth {
                    weight: items.weight,
                    max_speed: items.max_speed,
                    min_measurements: count("min_measurements", items.min_measurements)?,
                }),
            };
            let config = PhdConfig {
                motion,
                watches,
                filter: filter(&rule)?,
                fate: Fate {
                    survival_probability,
                    births,
                    birth_rate: rate,
                    spawns,
                },
                adaptive_birth,
                update,
                reduction: Reduction {
                    prune,
                    merge,
                    max_components: count("max_components", max_components)?,
                },
                confirmation: Confirmation {
                    confirm_after: small("confirm_after", confirm_after)?,
                    end_after: small("end_after", end_after)?,
                },
                strict,
            };
            let tracker = match time {
                None => PhdTracker::new(config)?,
                Some(time) => PhdTracker::starting(config, &initial, time)?,
            };
            InOrder::new(tracker, late(&policy)?)
        })?;
        Ok(Self {
            inner: Mutex::new(tracker),
        })
    }

    #[staticmethod]
    fn from_bytes(py: Python<'_>, data: &[u8]) -> PyResult<Self> {
        Ok(Self {
            inner: Mutex::new(compute(py, || InOrder::from_bytes(data))?),
        })
    }

    /// Another one that stands where this one does.
    fn copy(&self, py: Python<'_>) -> PyResult<Self> {
        Ok(Self {
            inner: Mutex::new(lock(py, &self.inner)?.clone()),
        })
    }

    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let tracker = lock(py, &self.inner)?;
        Ok(PyBytes::new(
            py,
            &tracker.to_bytes().map_err(|error| to_python(py, &error))?,
        ))
    }

    fn step<'py>(&self, py: Python<'py>, scan: ScanArrays<'py>) -> PyResult<IntensityColumns<'py>> {
        let scan = to_scan(&scan)?;
        let mut guard = lock(py, &self.inner)?;
        let inner = &mut *guard;
        let mut found = Found::new(inner.tracker());
        compute(py, || inner.step(&scan, |tracker, scan| found.push(tracker, scan)))?;
        found.into_columns(py)
    }

    /// Takes in what waits.
    fn flush<'py>(&self, py: Python<'py>) -> PyResult<IntensityColumns<'py>> {
        let mut guard = lock(py, &self.inner)?;
        let inner = &mut *guard;
        let mut found = Found::new(inner.tracker());
        compute(py, || inner.flush(|tracker, scan| found.push(tracker, scan)))?;
        found.into_columns(py)
    }

    fn run<'py>(&self, py: Python<'py>, scans: Vec<ScanArrays<'py>>) -> PyResult<IntensityColumns<'py>> {
        let scans = scans.iter().map(to_scan).collect::<PyResult<Vec<_>>>()?;
        let mut guard = lock(py, &self.inner)?;
        let inner = &mut *guard;
        compute(py, || inner.check_run(&scans))?;
        let mut found = Found::new(inner.tracker());
        each(py, &scans, |scan| {
            inner.queue(scan, |tracker, scan| found.push(tracker, scan))
        })?;
        compute(py, || {
            inner.flush(|tracker, scan| found.push(tracker, scan))?;
            inner.ledger().check()
        })?;
        found.into_columns(py)
    }

    fn mixture<'py>(&self, py: Python<'py>) -> PyResult<MixtureColumns<'py>> {
        let guard = lock(py, &self.inner)?;
        let tracker = guard.tracker();
        let (n, mixture) = (tracker.config().motion.state_dim(), tracker.mixture());
        Ok(MixtureColumns {
            weights: PyArray1::from_iter(py, mixture.iter().map(|c| c.weight)),
            means: array::from_rows(py, mixture.iter().map(|c| &c.state.mean), n)?,
            covs: array::from_symmetric(py, mixture.iter().map(|c| &c.state.cov), n)?,
            detection_rates: PyArray1::from_iter(py, mixture.iter().map(|c| c.rate.mean())),
            extents: extents(py, tracker.extent_dims(), mixture.iter().map(|c| c.extent.as_ref()))?,
        })
    }

    fn cardinality<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray1<f64>>>> {
        let guard = lock(py, &self.inner)?;
        let found = guard.tracker().cardinality();
        Ok(found.map(|cardinality| PyArray1::from_vec(py, cardinality.probabilities())))
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

/// Tracks and expected numbers of targets, scan by scan.
struct Found {
    rows: Rows,
    expected: Vec<f64>,
}

impl Found {
    fn new(tracker: &PhdTracker) -> Self {
        Self {
            rows: Rows::new(tracker.config().motion.state_dim(), true, tracker.extent_dims()),
            expected: Vec::new(),
        }
    }

    fn push(&mut self, tracker: &PhdTracker, scan: &Scan) {
        self.rows.push(scan, tracker.tracks().iter().map(TrackRef::from));
        self.expected.push(tracker.expected_targets());
    }

    fn into_columns(self, py: Python<'_>) -> PyResult<IntensityColumns<'_>> {
        Ok(IntensityColumns {
            tracks: self.rows.into_columns(py)?,
            expected_targets: PyArray1::from_vec(py, self.expected),
        })
    }
}
