//! Chi-square distribution, and regular times.

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use trackrs::stats::{chi_square, regular};

use crate::array;
use crate::error::compute;

#[pyfunction]
pub(crate) fn chi_square_quantile(py: Python<'_>, probability: f64, dof: usize) -> PyResult<f64> {
    compute(py, || chi_square::quantile(probability, dof))
}

/// Times on a regular clock.
#[derive(IntoPyObject)]
pub(crate) struct RegularTimes<'py> {
    times: Bound<'py, PyArray1<f64>>,
    period: f64,
    steps: Bound<'py, PyArray1<i64>>,
    jitter: f64,
}

#[pyfunction]
#[pyo3(signature = (times, period=None))]
pub(crate) fn regularise<'py>(
    py: Python<'py>,
    times: PyReadonlyArray1<'py, f64>,
    period: Option<f64>,
) -> PyResult<RegularTimes<'py>> {
    let times = array::vector(&times, "times")?;
    let out = compute(py, || regular::regularise(times.as_slice(), period))?;
    Ok(RegularTimes {
        times: PyArray1::from_vec(py, out.times),
        period: out.period,
        steps: PyArray1::from_vec(py, out.steps),
        jitter: out.jitter,
    })
}
