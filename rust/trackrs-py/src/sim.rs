//! Scenarios of targets that are points.

use nalgebra::DMatrix;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;
use trackrs::Error;
use trackrs::model::{Sensor as _, SensorModel};
use trackrs::sim::close_targets::{self, CloseTargetsSettings, Order};
use trackrs::sim::course::{Course, Leg};
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
pub(crate) fn origin(target: Option<usize>) -> i64 {
    target.map_or(-1, |i| i64::try_from(i).unwrap_or(i64::MAX))
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
