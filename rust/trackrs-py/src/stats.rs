//! Chi-square distribution.

use pyo3::prelude::*;
use trackrs::stats::chi_square;

use crate::error::compute;

#[pyfunction]
pub(crate) fn chi_square_quantile(py: Python<'_>, probability: f64, dof: usize) -> PyResult<f64> {
    compute(py, || chi_square::quantile(probability, dof))
}
