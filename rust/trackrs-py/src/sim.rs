//! Scenarios.

use nalgebra::DMatrix;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;
use trackrs::Error;
use trackrs::model::{Sensor as _, SensorModel};
use trackrs::sim::close_targets::{self, CloseTargetsSettings, Order};
use trackrs::sim::course::{Course, Leg};
use trackrs::sim::extended_targets::{self, ExtendedTarget, ExtendedTargetsSettings};
use trackrs::sim::shape::Shape;
use trackrs::sim::turning::{self, TurningSettings};
use trackrs::sim::underwater::{self, Truth, UnderwaterSettings, bats_hydrophones, toss_hydrophones};

use crate::array;
use crate::error::{compute, count};
use crate::model::Sensor;

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Underwater {
    pub(crate) core: underwater::Underwater,
}

/// What a run recorded.
#[derive(IntoPyObject)]
pub(crate) struct Recording<'py> {
    values: Bound<'py, PyArray2<f64>>,
    gross: Bound<'py, PyArray2<bool>>,
    truth: Bound<'py, PyArray2<f64>>,
}

/// Where a vessel goes; duration, turn rate and sink rate of each leg.
#[derive(FromPyObject, IntoPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct CourseItems {
    start: [f64; 3],
    heading: f64,
    speed: f64,
    ramp: f64,
    legs: Vec<(f64, f64, f64)>,
}

#[pymethods]
impl Underwater {
    #[allow(clippy::too_many_arguments)]
    #[staticmethod]
    #[pyo3(signature = (array, course, dt, gross, missing, jerk_std=None))]
    fn make(
        py: Python<'_>,
        array: &Sensor,
        course: CourseItems,
        dt: f64,
        gross: f64,
        missing: f64,
        jerk_std: Option<f64>,
    ) -> PyResult<Self> {
        let leg = |(duration, turn_rate, sink_rate)| Leg {
            duration,
            turn_rate,
            sink_rate,
        };
        let course = Course {
            start: course.start,
            heading: course.heading,
            speed: course.speed,
            ramp: course.ramp,
            legs: course.legs.into_iter().map(leg).collect(),
        };
        let core = compute(py, || {
            let SensorModel::RangeArray(array) = &array.model else {
                return Err(Error::invalid("array", "another sensor", "must be a RangeArray"));
            };
            underwater::Underwater::new(UnderwaterSettings {
                array: array.clone(),
                course,
                truth: jerk_std.map_or(Truth::Course, |jerk_std| Truth::Drawn { jerk_std }),
                dt,
                gross,
                missing,
            })
        })?;
        Ok(Self { core })
    }

    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.core.times())
    }

    /// Without rows where every run has its own.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        match self.core.truth() {
            Some(truth) => array::from_matrix(py, &truth.states),
            None => array::from_matrix(py, &DMatrix::zeros(0, 9)),
        }
    }

    fn draw<'py>(&self, py: Python<'py>, seed: u64, run: u64) -> PyResult<Recording<'py>> {
        let out = compute(py, || self.core.draw(seed, run))?;
        let m = self.core.array().measurement_dim();
        let gross = PyArray1::from_vec(py, out.gross.concat()).reshape([out.gross.len(), m])?;
        Ok(Recording {
            values: array::from_rows(py, out.values.iter(), m)?,
            gross,
            truth: array::from_matrix(py, &out.truth.states)?,
        })
    }
}

/// The course of the reference scenario.
#[pyfunction]
pub(crate) fn reference_course() -> CourseItems {
    let course = Course::default();
    let leg = |leg: &Leg| (leg.duration, leg.turn_rate, leg.sink_rate);
    CourseItems {
        start: course.start,
        heading: course.heading,
        speed: course.speed,
        ramp: course.ramp,
        legs: course.legs.iter().map(leg).collect(),
    }
}

/// The hydrophones of the reference arrays.
#[derive(IntoPyObject)]
pub(crate) struct Hydrophones<'py> {
    bats: Bound<'py, PyArray2<f64>>,
    toss: Bound<'py, PyArray2<f64>>,
}

#[pyfunction]
pub(crate) fn reference_hydrophones(py: Python<'_>) -> PyResult<Hydrophones<'_>> {
    Ok(Hydrophones {
        bats: array::from_matrix(py, &bats_hydrophones())?,
        toss: array::from_matrix(py, &toss_hydrophones())?,
    })
}

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct CloseTargets {
    pub(crate) core: close_targets::CloseTargets,
}

/// What a run reported; origin −1 = false.
#[derive(IntoPyObject)]
pub(crate) struct Reports<'py> {
    values: Bound<'py, PyArray2<f64>>,
    origins: Bound<'py, PyArray1<i64>>,
}

#[pymethods]
impl CloseTargets {
    #[staticmethod]
    fn make(
        py: Python<'_>,
        targets: i64,
        separation: f64,
        reports: i64,
        interval: f64,
        order: &str,
        clutter: f64,
    ) -> PyResult<Self> {
        compute(py, || {
            let order = match order {
                "cyclic" => Order::Cyclic,
                "boustrophedon" => Order::Boustrophedon,
                "random" => Order::Random,
                other => {
                    let requirement = "must be cyclic, boustrophedon or random";
                    return Err(Error::invalid("order", other, requirement));
                }
            };
            let settings = CloseTargetsSettings {
                targets: count("targets", targets)?,
                separation,
                reports: count("reports", reports)?,
                interval,
                order,
                clutter,
            };
            let core = close_targets::CloseTargets::new(settings)?;
            Ok(Self { core })
        })
    }

    /// Standard deviations of range and bearing.
    fn noise(&self) -> (f64, f64) {
        let noise = self.core.radar().noise();
        (noise[(0, 0)].sqrt(), noise[(1, 1)].sqrt())
    }

    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_iter(py, (0..self.core.settings().reports).map(|k| self.core.time(k)))
    }

    /// Target after target at each time, (T N)×4.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let pairs =
            (0..self.core.settings().reports).flat_map(|k| (0..self.core.settings().targets).map(move |i| (k, i)));
        let states: Vec<_> = pairs.map(|(k, i)| self.core.truth(i, self.core.time(k))).collect();
        array::from_rows(py, states.iter(), 4)
    }

    /// Mean and variances at time 0 of each target, 2×4.
    fn initial<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyArray2<f64>>>> {
        let of = |i| {
            let start = self.core.initial(i);
            array::from_rows(py, [&start.mean, &start.cov.diagonal()].into_iter(), 4)
        };
        (0..self.core.settings().targets).map(of).collect()
    }

    fn clutter_area(&self) -> f64 {
        self.core.clutter_area()
    }

    fn draw<'py>(&self, py: Python<'py>, seed: u64, run: u64) -> PyResult<Reports<'py>> {
        let out = compute(py, || self.core.draw(seed, run))?;
        Ok(Reports {
            values: array::from_rows(py, out.values.iter(), 2)?,
            origins: PyArray1::from_iter(py, out.origins.into_iter().map(origin)),
        })
    }
}

/// −1 where there is none.
fn origin(target: Option<usize>) -> i64 {
    target.map_or(-1, |i| i64::try_from(i).unwrap_or(i64::MAX))
}

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

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Turning {
    pub(crate) core: turning::Turning,
}

/// Mean and variances that a filter begins with, and what it is fed.
#[derive(IntoPyObject)]
pub(crate) struct Angles<'py> {
    mean: Bound<'py, PyArray1<f64>>,
    cov: Bound<'py, PyArray2<f64>>,
    values: Bound<'py, PyArray1<f64>>,
}

#[pymethods]
impl Turning {
    #[staticmethod]
    fn make(py: Python<'_>, rate: f64, swings: Vec<[f64; 2]>, period: f64, samples: i64, std: f64) -> PyResult<Self> {
        let core = compute(py, || {
            turning::Turning::new(TurningSettings {
                rate,
                swings,
                period,
                samples: count("samples", samples)?,
                std,
            })
        })?;
        Ok(Self { core })
    }

    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_vec(py, self.core.times())
    }

    fn truth<'py>(&self, py: Python<'py>, times: PyReadonlyArray1<'py, f64>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_iter(py, times.as_array().iter().map(|&time| self.core.truth(time)))
    }

    fn draw<'py>(&self, py: Python<'py>, seed: u64, run: u64) -> PyResult<Angles<'py>> {
        let out = compute(py, || Ok(self.core.draw(seed, run)))?;
        Ok(Angles {
            mean: array::from_vector(py, &out.initial.state.mean),
            cov: array::from_matrix(py, &out.initial.state.cov)?,
            values: PyArray1::from_vec(py, out.values),
        })
    }
}
