//! Estimates fused, and states from position fixes.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use trackrs::filter::fusion::{self, Criterion};
use trackrs::filter::paper_start::paper_start as by_paper;
use trackrs::filter::sequence::InitialState;
use trackrs::filter::start::{self, TimedFix};
use trackrs::{Error, Gaussian};

use crate::array;
use crate::error::compute;
use crate::model::Motion;

/// Mean and covariance, in.
type Given<'py> = (PyReadonlyArray1<'py, f64>, PyReadonlyArray2<'py, f64>);

/// Mean and covariance, out.
type Moments<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

fn gaussians(states: &[Given<'_>]) -> PyResult<Vec<Gaussian>> {
    states.iter().map(|(mean, cov)| array::gaussian(mean, cov)).collect()
}

fn moments<'py>(py: Python<'py>, state: &Gaussian) -> PyResult<Moments<'py>> {
    Ok((array::from_vector(py, &state.mean), array::from_matrix(py, &state.cov)?))
}

#[pyfunction]
#[pyo3(signature = (states, criterion, weights=None))]
pub(crate) fn covariance_intersection<'py>(
    py: Python<'py>,
    states: Vec<Given<'py>>,
    criterion: &str,
    weights: Option<PyReadonlyArray1<'py, f64>>,
) -> PyResult<Moments<'py>> {
    let estimates = gaussians(&states)?;
    let weights = weights.map(|w| array::vector(&w, "weights")).transpose()?;
    let out = compute(py, || {
        let criterion = match criterion {
            "trace" => Criterion::Trace,
            "determinant" => Criterion::Determinant,
            other => return Err(Error::invalid("criterion", other, "must be trace or determinant")),
        };
        fusion::covariance_intersection(&estimates, weights.as_ref(), criterion)
    })?;
    moments(py, &out.state)
}

fn timed(times: &PyReadonlyArray1<'_, f64>, fixes: &[Given<'_>]) -> PyResult<Vec<TimedFix>> {
    let times = array::vector(times, "times")?;
    let fix = |(&time, position): (&f64, Gaussian)| TimedFix { time, position };
    Ok(times.iter().zip(gaussians(fixes)?).map(fix).collect())
}

#[pyfunction]
#[pyo3(signature = (times, fixes, order, motion=None))]
pub(crate) fn start_state<'py>(
    py: Python<'py>,
    times: PyReadonlyArray1<'py, f64>,
    fixes: Vec<Given<'py>>,
    order: i64,
    motion: Option<&Motion>,
) -> PyResult<Moments<'py>> {
    let fixes = timed(&times, &fixes)?;
    let out = compute(py, || {
        let order = crate::error::count("order", order)?;
        start::start_state(&fixes, order, motion.map(|m| &m.model as &dyn trackrs::model::Motion))
    })?;
    moments(py, &out.state)
}

#[pyfunction]
pub(crate) fn paper_start<'py>(
    py: Python<'py>,
    times: PyReadonlyArray1<'py, f64>,
    fixes: Vec<Given<'py>>,
    velocity_std: f64,
    accel_std: f64,
) -> PyResult<Moments<'py>> {
    let fixes = timed(&times, &fixes)?;
    let out: InitialState = compute(py, || by_paper(&fixes, velocity_std, accel_std))?;
    moments(py, &out.state)
}
