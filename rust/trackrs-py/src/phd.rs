//! Trackers by intensity.

use std::collections::BTreeMap;
use std::sync::Mutex;

use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use trackrs::model::Motion as _;
use trackrs::rfs::extended_gm_phd::ExtendedUpdate;
use trackrs::rfs::mixture::Reduction;
use trackrs::rfs::prediction::{Birth, Fate, Spawn};
use trackrs::rfs::rate::{Rate, RateModel};
use trackrs::tracker::phd::PhdTracker;
use trackrs::tracker::phd::config::{AdaptiveBirth, Confirmation, PhdConfig, Watch};

use crate::array;
use crate::error::{compute, count, to_python};
use crate::model::{Motion, Sensor};
use crate::partition::{OutlierFilter, Partitioner};
use crate::scans::{Columns, EventRecord, LedgerRecord, ScanArrays, counts, each, lock, recent, to_columns, to_scan};
use crate::tracker::{filter, small};

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct IntensityTracker {
    inner: Mutex<PhdTracker>,
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
}

/// Mean, shape, forgetting, floor; shape and what follows only where it is learnt.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct RateItems {
    mean: f64,
    learnt: bool,
    shape: f64,
    forgetting: f64,
    floor: f64,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct WeightedState<'py> {
    weight: f64,
    mean: PyReadonlyArray1<'py, f64>,
    cov: PyReadonlyArray2<'py, f64>,
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
    rate: RateItems,
    superposition: bool,
    prune: f64,
    merge: f64,
    max_components: i64,
    confirm_after: i64,
    end_after: i64,
    strict: bool,
}

#[pymethods]
impl IntensityTracker {
    #[new]
    fn new(
        py: Python<'_>,
        motion: &Motion,
        sensors: BTreeMap<String, PyRef<'_, Sensor>>,
        partition: &Partitioner,
        clutter_filter: Option<PyRef<'_, OutlierFilter>>,
        settings: PhdSettings<'_>,
    ) -> PyResult<Self> {
        let births = settings.births.iter().map(|item| {
            Ok(Birth {
                weight: item.weight,
                state: array::gaussian(&item.mean, &item.cov)?,
            })
        });
        let births = births.collect::<PyResult<Vec<Birth>>>()?;
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
        let (motion, partition) = (motion.model.clone(), partition.core.clone());
        let clutter_filter = clutter_filter.map(|filter| filter.core.clone());
        let rate = &settings.rate;
        let (rates, shape) = if rate.learnt {
            let (forgetting, floor) = (rate.forgetting, rate.floor);
            (RateModel::Learnt { forgetting, floor }, rate.shape)
        } else {
            (RateModel::Known, 1.0)
        };
        let rate = Rate::with_mean(rate.mean, shape);
        let PhdSettings {
            filter: rule,
            survival_probability,
            detection_probability,
            clutter_density,
            adaptive_birth,
            superposition,
            prune,
            merge,
            max_components,
            confirm_after,
            end_after,
            strict,
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
            PhdTracker::new(PhdConfig {
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
                update: ExtendedUpdate {
                    rates,
                    partition,
                    clutter_filter,
                    superposition,
                    prune,
                },
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
            })
        })?;
        Ok(Self {
            inner: Mutex::new(tracker),
        })
    }

    #[staticmethod]
    fn from_bytes(py: Python<'_>, data: &[u8]) -> PyResult<Self> {
        Ok(Self {
            inner: Mutex::new(compute(py, || PhdTracker::from_bytes(data))?),
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
        let tracker = &mut *guard;
        let tracks = compute(py, || tracker.step(&scan))?;
        columns(py, tracker, &[tracks], &[tracker.expected_targets()])
    }

    fn run<'py>(&self, py: Python<'py>, scans: Vec<ScanArrays<'py>>) -> PyResult<IntensityColumns<'py>> {
        let scans = scans.iter().map(to_scan).collect::<PyResult<Vec<_>>>()?;
        let mut guard = lock(py, &self.inner)?;
        let tracker = &mut *guard;
        compute(py, || tracker.check_run(&scans))?;
        let mut expected = Vec::with_capacity(scans.len());
        let tracks = each(py, &scans, |scan| {
            let tracks = tracker.step(scan)?;
            expected.push(tracker.expected_targets());
            Ok(tracks)
        })?;
        compute(py, || tracker.ledger().check())?;
        columns(py, tracker, &tracks, &expected)
    }

    fn mixture<'py>(&self, py: Python<'py>) -> PyResult<MixtureColumns<'py>> {
        let tracker = lock(py, &self.inner)?;
        let (n, mixture) = (tracker.config().motion.state_dim(), tracker.mixture());
        Ok(MixtureColumns {
            weights: PyArray1::from_iter(py, mixture.iter().map(|c| c.weight)),
            means: array::from_rows(py, mixture.iter().map(|c| &c.state.mean), n)?,
            covs: array::from_symmetric(py, mixture.iter().map(|c| &c.state.cov), n)?,
            detection_rates: PyArray1::from_iter(py, mixture.iter().map(|c| c.rate.mean())),
        })
    }

    fn labels(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(lock(py, &self.inner)?.config().motion.labels())
    }

    fn events(&self, py: Python<'_>) -> PyResult<Vec<EventRecord>> {
        Ok(recent(lock(py, &self.inner)?.events()))
    }

    fn event_counts(&self, py: Python<'_>) -> PyResult<BTreeMap<&'static str, u64>> {
        Ok(counts(lock(py, &self.inner)?.events()))
    }

    fn ledger(&self, py: Python<'_>) -> PyResult<LedgerRecord> {
        Ok(LedgerRecord::of(lock(py, &self.inner)?.ledger()))
    }
}

fn columns<'py>(
    py: Python<'py>,
    tracker: &PhdTracker,
    tracks: &[Vec<trackrs::Track>],
    expected: &[f64],
) -> PyResult<IntensityColumns<'py>> {
    Ok(IntensityColumns {
        tracks: to_columns(py, tracker.config().motion.state_dim(), true, tracks)?,
        expected_targets: PyArray1::from_slice(py, expected),
    })
}
