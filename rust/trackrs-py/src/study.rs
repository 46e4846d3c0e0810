//! Studies.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::DVector;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use numpy::{PyUntypedArrayMethods, ndarray};
use pyo3::prelude::*;
use trackrs::Error;
use trackrs::error::require_size;
use trackrs::filter::lead::Lead;
use trackrs::interrupt;
use trackrs::sim::study::{self, Estimate, Method, Named, Oversight, Scene, StudyMetric, Summary};

use crate::array;
use crate::error::{compute, count, raised, to_python};
use crate::filter::Filter;
use crate::phd::IntensityTracker;
use crate::scans::lock;
use crate::sim::{CloseTargets, Turning, Underwater};
use crate::sim_extended::ExtendedTargets;
use crate::tracker::Tracker;

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Study {
    core: study::Study,
}

/// A scenario of the library.
#[derive(FromPyObject)]
pub(crate) enum SceneItem<'py> {
    CloseTargets(PyRef<'py, CloseTargets>),
    ExtendedTargets(PyRef<'py, ExtendedTargets>),
    Underwater(PyRef<'py, Underwater>),
    Turning(PyRef<'py, Turning>),
}

/// A method of the library.
#[derive(FromPyObject)]
pub(crate) enum MethodItem<'py> {
    Tracker(PyRef<'py, Tracker>),
    Intensity(PyRef<'py, IntensityTracker>),
    Filter(PyRef<'py, Filter>),
}

/// Kind, numbers, and the least number of a step that counts.
pub(crate) type MetricItem = (String, Vec<f64>, i64);

fn metric((kind, numbers, first): MetricItem) -> trackrs::Result<StudyMetric> {
    let first = count("first", first)?;
    match (kind.as_str(), numbers.as_slice()) {
        ("ospa", &[cutoff, order]) => Ok(StudyMetric::Ospa { cutoff, order }),
        ("gospa", &[cutoff, order, alpha]) => Ok(StudyMetric::Gospa { cutoff, order, alpha }),
        ("cardinality", &[]) => Ok(StudyMetric::Cardinality),
        ("identity", &[separation]) => Ok(StudyMetric::Identity { separation }),
        ("position", &[]) => Ok(StudyMetric::Position { first }),
        ("lead", &[]) => Ok(StudyMetric::Lead {
            lead: Lead::Midpoint,
            first,
        }),
        ("lead", &[seconds]) => Ok(StudyMetric::Lead {
            lead: Lead::Seconds(seconds),
            first,
        }),
        _ => Err(Error::invalid("metric", kind, "must be one that studies know")),
    }
}

fn metrics(items: Vec<MetricItem>) -> trackrs::Result<Vec<StudyMetric>> {
    items.into_iter().map(metric).collect()
}

/// What some runs gave, a row each; failures as run, method and reason.
#[derive(IntoPyObject)]
pub(crate) struct Runs<'py> {
    values: Bound<'py, PyArray2<f64>>,
    seconds: Bound<'py, PyArray2<f64>>,
    failures: Vec<(u64, usize, String)>,
}

#[pymethods]
impl Study {
    #[new]
    fn new(
        py: Python<'_>,
        scene: SceneItem<'_>,
        scan_size: i64,
        methods: Vec<(String, MethodItem<'_>)>,
        items: Vec<MetricItem>,
    ) -> PyResult<Self> {
        let size = count("scan_size", scan_size).map_err(|error| to_python(py, &error))?;
        let scene = match scene {
            SceneItem::CloseTargets(scene) => Scene::CloseTargets {
                scene: scene.core.clone(),
                scan_size: size,
            },
            SceneItem::ExtendedTargets(scene) => Scene::ExtendedTargets(scene.core.clone()),
            SceneItem::Underwater(scene) => Scene::Underwater(Box::new(scene.core.clone())),
            SceneItem::Turning(scene) => Scene::Turning(scene.core.clone()),
        };
        let mut named = Vec::with_capacity(methods.len());
        for (name, item) in methods {
            let method = match item {
                MethodItem::Tracker(tracker) => Method::Tracker(Box::new(lock(py, &tracker.inner)?.tracker().clone())),
                MethodItem::Intensity(tracker) => {
                    Method::Intensity(Box::new(lock(py, &tracker.inner)?.tracker().clone()))
                }
                MethodItem::Filter(filter) => Method::Filter(Box::new(filter.filter.clone())),
            };
            named.push(Named { name, method });
        }
        let core = compute(py, || study::Study::new(scene, named, metrics(items)?))?;
        Ok(Self { core })
    }

    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.core.times())
    }

    /// Some runs, one after the other, in this thread; fewer if it was stopped.
    fn run<'py>(&self, py: Python<'py>, seed: u64, first: u64, runs: u64, stop: &StudyStop) -> PyResult<Runs<'py>> {
        let end = first.saturating_add(runs);
        let trials = compute(py, || {
            // What a method does in one call ends as well: trackers are copies, and whatever was half done is dropped.
            let trials = (first..end).map(|run| {
                let set = Arc::clone(&stop.set);
                let go_on = move || !set.load(Ordering::Relaxed);
                match interrupt::until(go_on, || self.core.run_under(stop, seed, run)) {
                    Err(Error::Interrupted) => Ok(None),
                    other => other,
                }
            });
            trials
                .map_while(trackrs::Result::transpose)
                .collect::<trackrs::Result<Vec<_>>>()
        })?;
        let methods = self.core.methods().len();
        let width = methods * self.core.columns().len() * self.core.times().len();
        let mut failures = Vec::new();
        for (run, trial) in (first..end).zip(&trials) {
            failures.extend(trial.failures.iter().map(|f| (run, f.method, f.reason.clone())));
        }
        let values = trials.iter().flat_map(|trial| trial.values.iter().copied());
        let seconds = trials.iter().flat_map(|trial| trial.seconds.iter().copied());
        Ok(Runs {
            values: PyArray1::from_iter(py, values).reshape([trials.len(), width])?,
            seconds: PyArray1::from_iter(py, seconds).reshape([trials.len(), methods])?,
            failures,
        })
    }
}

/// Makes runs leave off, from another thread.
#[pyclass(frozen, module = "trackrs._trackrs")]
#[derive(Default)]
pub(crate) struct StudyStop {
    set: Arc<AtomicBool>,
}

#[pymethods]
impl StudyStop {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    fn set(&self) {
        self.set.store(true, Ordering::Relaxed);
    }

    fn is_set(&self) -> bool {
        self.set.load(Ordering::Relaxed)
    }
}

impl Oversight for StudyStop {
    fn stopped(&self) -> bool {
        self.is_set()
    }

    /// What a model written in Python has raised.
    fn fault(&self) -> Option<String> {
        let error = raised()?;
        Some(error.to_string())
    }
}

/// Names and summaries of what these metrics record.
#[pyfunction]
pub(crate) fn study_columns(py: Python<'_>, items: Vec<MetricItem>) -> PyResult<Vec<(&'static str, &'static str)>> {
    let metrics = compute(py, || metrics(items))?;
    let columns = metrics.iter().flat_map(StudyMetric::columns);
    let summary = |summary| match summary {
        Summary::Mean => "mean",
        Summary::Rms => "rms",
        Summary::Last => "last",
    };
    Ok(columns.map(|column| (column.name, summary(column.summary))).collect())
}

/// The scores of a tracker of one's own, columns×S: truth S×N×d, NaN where a target is not there; what was found at step k
/// has rows `offsets[k]` to `offsets[k + 1]`.
#[pyfunction]
pub(crate) fn score_tracks<'py>(
    py: Python<'py>,
    items: Vec<MetricItem>,
    truth: PyReadonlyArray3<'py, f64>,
    offsets: Vec<usize>,
    ids: PyReadonlyArray1<'py, u64>,
    positions: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (steps, dims) = (truth.shape()[0], truth.shape()[2]);
    let at = |row: ndarray::ArrayView1<'_, f64>| DVector::from_iterator(row.len(), row.iter().copied());
    let places: Vec<Vec<Option<DVector<f64>>>> = truth
        .as_array()
        .outer_iter()
        .map(|targets| {
            targets
                .outer_iter()
                .map(|row| Some(at(row)).filter(|p| !p.iter().any(|v| v.is_nan())))
                .collect()
        })
        .collect();
    let rows = array::rows(&positions, "positions")?;
    let ids: Vec<u64> = ids.as_array().iter().copied().collect();
    let out = compute(py, || {
        require_size("offsets", steps + 1, offsets.len())?;
        require_size("ids", rows.len(), ids.len())?;
        let mut found = Vec::with_capacity(steps);
        for pair in offsets.windows(2) {
            let part = pair[0]..pair[1];
            let (Some(ids), Some(rows)) = (ids.get(part.clone()), rows.get(part)) else {
                return Err(Error::invalid(
                    "offsets",
                    pair[1],
                    "must not decrease or pass the number of rows",
                ));
            };
            let mut step = Vec::with_capacity(ids.len());
            for (&id, position) in ids.iter().zip(rows) {
                require_size("position", dims, position.len())?;
                step.push(Estimate {
                    id,
                    position: position.clone(),
                });
            }
            found.push(step);
        }
        study::score_tracks(&metrics(items)?, &places, &found)
    })?;
    let columns = out.len().checked_div(steps).unwrap_or(0);
    PyArray1::from_vec(py, out).reshape([columns, steps])
}
