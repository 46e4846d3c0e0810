//! Scenarios of extended targets.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use trackrs::Error;
use trackrs::sim::extended_targets::{self, ExtendedTarget, ExtendedTargetsSettings};
use trackrs::sim::shape::Shape;

use crate::array;
use crate::error::{compute, count};
use crate::sim::origin;

/// Kind and sizes.
type ShapeItems = (String, Vec<f64>);

fn shape((kind, sizes): ShapeItems) -> trackrs::Result<Shape> {
    match (kind.as_str(), sizes.as_slice()) {
        ("blob", &[spread]) => Ok(Shape::Blob { spread }),
        ("ellipse", &[length, width]) => Ok(Shape::Ellipse { length, width }),
        ("rectangle", &[length, width]) => Ok(Shape::Rectangle { length, width }),
        ("l", &[arm]) => Ok(Shape::L { arm }),
        _ => Err(Error::invalid("shape", kind, "must be blob, ellipse, rectangle or l")),
    }
}

fn shapes<const N: usize>(items: [ShapeItems; N]) -> trackrs::Result<[Shape; N]> {
    let made: trackrs::Result<Vec<Shape>> = items.into_iter().map(shape).collect();
    let wrong = |_| Error::invalid("shapes", "another number", "must be one per target");
    made?.try_into().map_err(wrong)
}

/// Start, first, last, rate.
type Life = ([f64; 4], f64, f64, f64);

/// The targets of a reference scenario.
#[derive(IntoPyObject)]
pub(crate) struct Lives {
    lives: Vec<Life>,
    sensor_std: Option<f64>,
}

impl From<ExtendedTargetsSettings> for Lives {
    fn from(settings: ExtendedTargetsSettings) -> Self {
        let targets = settings.targets.iter();
        Self {
            lives: targets.map(|t| (t.start, t.first, t.last, t.rate)).collect(),
            sensor_std: settings.sensor_std,
        }
    }
}

#[pyfunction]
pub(crate) fn crossing_targets(py: Python<'_>, kinds: [ShapeItems; 3], rates: [f64; 3]) -> PyResult<Lives> {
    compute(py, || Ok(extended_targets::crossing(shapes(kinds)?, rates).into()))
}

#[pyfunction]
pub(crate) fn parallel_targets(
    py: Python<'_>,
    kinds: [ShapeItems; 2],
    rates: [f64; 2],
    spacing: f64,
) -> PyResult<Lives> {
    compute(py, || {
        Ok(extended_targets::parallel(shapes(kinds)?, rates, spacing).into())
    })
}

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct ExtendedTargets {
    pub(crate) core: extended_targets::ExtendedTargets,
}

/// What a run detects, scan after scan; scan k has rows `offsets[k]` to `offsets[k + 1]`, origin −1 = clutter.
#[derive(IntoPyObject)]
pub(crate) struct Detections<'py> {
    values: Bound<'py, PyArray2<f64>>,
    origins: Bound<'py, PyArray1<i64>>,
    offsets: Vec<usize>,
}

#[pymethods]
impl ExtendedTargets {
    #[allow(clippy::too_many_arguments)]
    #[staticmethod]
    #[pyo3(signature = (lives, kinds, births, scans, interval, clutter, detection_probability, noise_std, sensor_std=None))]
    fn make(
        py: Python<'_>,
        lives: Vec<Life>,
        kinds: Vec<ShapeItems>,
        births: Vec<[f64; 2]>,
        scans: i64,
        interval: f64,
        clutter: f64,
        detection_probability: f64,
        noise_std: f64,
        sensor_std: Option<f64>,
    ) -> PyResult<Self> {
        let core = compute(py, || {
            let target = |((start, first, last, rate), kind): (Life, ShapeItems)| {
                Ok(ExtendedTarget {
                    start,
                    first,
                    last,
                    rate,
                    shape: shape(kind)?,
                })
            };
            let targets: trackrs::Result<Vec<_>> = lives.into_iter().zip(kinds).map(target).collect();
            extended_targets::ExtendedTargets::new(ExtendedTargetsSettings {
                targets: targets?,
                births,
                scans: count("scans", scans)?,
                interval,
                clutter,
                detection_probability,
                noise_std,
                sensor_std,
            })
        })?;
        Ok(Self { core })
    }

    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_iter(py, (0..self.core.settings().scans).map(|k| self.core.time(k)))
    }

    /// Target after target at each time, (T N)×4; NaN where one does not live.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (scans, targets) = (self.core.settings().scans, self.core.settings().targets.len());
        let states = (0..scans * targets).flat_map(|row| {
            let state = self.core.truth(row % targets, self.core.time(row / targets));
            state.unwrap_or([f64::NAN; 4])
        });
        PyArray1::from_iter(py, states).reshape([scans * targets, 4])
    }

    /// Mean and variances of each, 2×4.
    fn births<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyArray2<f64>>>> {
        let births = self.core.births();
        let of = |birth: &trackrs::Gaussian| array::from_rows(py, [&birth.mean, &birth.cov.diagonal()].into_iter(), 4);
        births.iter().map(of).collect()
    }

    fn clutter_density(&self) -> f64 {
        self.core.clutter_density()
    }

    fn detections_per_target(&self) -> f64 {
        self.core.detections_per_target()
    }

    fn sensor_std(&self) -> f64 {
        self.core.sensor_std()
    }

    fn draw<'py>(&self, py: Python<'py>, seed: u64, run: u64) -> PyResult<Detections<'py>> {
        let scans = compute(py, || self.core.draw(seed, run))?;
        let offset = |end: &mut usize, scan: &extended_targets::Detections| {
            *end += scan.origins.len();
            Some(*end)
        };
        let offsets: Vec<usize> = std::iter::once(0).chain(scans.iter().scan(0, offset)).collect();
        let values: Vec<f64> = scans
            .iter()
            .flat_map(|d| d.scan.values.iter().flatten().copied())
            .collect();
        let origins: Vec<Option<usize>> = scans.into_iter().flat_map(|d| d.origins).collect();
        Ok(Detections {
            values: PyArray1::from_vec(py, values).reshape([origins.len(), 2])?,
            origins: PyArray1::from_iter(py, origins.into_iter().map(origin)),
            offsets,
        })
    }
}
