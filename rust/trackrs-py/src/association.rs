//! Assignment.

use numpy::{PyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use trackrs::association::assignment;

use crate::array;
use crate::error::compute;

/// Assigned column of each row (−1 = none) and the total cost.
#[pyfunction]
pub(crate) fn assign<'py>(
    py: Python<'py>,
    costs: PyReadonlyArray2<'py, f64>,
) -> PyResult<(Bound<'py, PyArray1<i64>>, f64)> {
    let matrix = array::matrix(&costs, "costs")?.transpose();
    let solved = compute(py, || {
        assignment::assign(matrix.as_slice(), matrix.ncols(), matrix.nrows())
    })?;
    let columns = solved
        .row_to_column
        .iter()
        .map(|c| c.map_or(-1, |c| i64::try_from(c).unwrap_or(i64::MAX)));
    Ok((PyArray1::from_iter(py, columns), solved.cost))
}
