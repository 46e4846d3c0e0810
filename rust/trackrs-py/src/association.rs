//! Assignment and joint association.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trackrs::association::assignment::sparse::{self, Candidate};
use trackrs::association::marginals::{Domain, Marginals, Method, Options, Weights};
use trackrs::association::{assignment, k_best as ranking, marginals as joint};
use trackrs::error::require_size;

use crate::array;
use crate::error::{compute_long, count, to_python};

fn column(column: Option<usize>) -> i64 {
    column.map_or(-1, |c| i64::try_from(c).unwrap_or(i64::MAX))
}

/// Assigned column of each row (−1 = none) and the total cost.
#[pyfunction]
pub(crate) fn assign<'py>(
    py: Python<'py>,
    costs: PyReadonlyArray2<'py, f64>,
) -> PyResult<(Bound<'py, PyArray1<i64>>, f64)> {
    let (rows, columns) = (costs.shape()[0], costs.shape()[1]);
    let costs = array::c_slice(&costs, "costs")?;
    let solved = compute_long(py, || assignment::assign(costs, rows, columns))?;
    let columns = solved.row_to_column.iter().map(|&c| column(c));
    Ok((PyArray1::from_iter(py, columns), solved.cost))
}

/// The same with the allowed pairs as lists of rows, columns and costs.
#[pyfunction]
pub(crate) fn assign_sparse<'py>(
    py: Python<'py>,
    rows: PyReadonlyArray1<'py, i64>,
    columns: PyReadonlyArray1<'py, i64>,
    costs: PyReadonlyArray1<'py, f64>,
    shape: (i64, i64),
) -> PyResult<(Bound<'py, PyArray1<i64>>, f64)> {
    let costs = array::c_slice(&costs, "costs")?;
    let (rows, columns) = (rows.as_array(), columns.as_array());
    for (name, size) in [("rows", rows.len()), ("columns", columns.len())] {
        require_size(name, costs.len(), size).map_err(|error| to_python(py, &error))?;
    }
    // What is no index lies outside of every shape.
    let index = |&at: &i64| usize::try_from(at).unwrap_or(usize::MAX);
    let pairs = rows.iter().map(index).zip(columns.iter().map(index)).zip(costs);
    let candidates: Vec<Candidate> = pairs
        .map(|((row, column), &cost)| Candidate { row, column, cost })
        .collect();
    let solved = compute_long(py, || {
        sparse::assign_sparse(&candidates, count("rows", shape.0)?, count("columns", shape.1)?)
    })?;
    let columns = solved.row_to_column.iter().map(|&c| column(c));
    Ok((PyArray1::from_iter(py, columns), solved.cost))
}

/// Assigned columns and total cost of each of the k best assignments.
#[pyfunction]
#[pyo3(signature = (costs, k, miss_costs=None))]
pub(crate) fn k_best<'py>(
    py: Python<'py>,
    costs: PyReadonlyArray2<'py, f64>,
    k: i64,
    miss_costs: Option<PyReadonlyArray1<'py, f64>>,
) -> PyResult<Vec<(Bound<'py, PyArray1<i64>>, f64)>> {
    let (rows, columns) = (costs.shape()[0], costs.shape()[1]);
    let costs = array::c_slice(&costs, "costs")?;
    let misses = miss_costs
        .as_ref()
        .map(|m| array::c_slice(m, "miss_costs"))
        .transpose()?;
    let found = compute_long(py, || {
        let k = count("k", k)?;
        match misses {
            None => ranking::k_best(costs, rows, columns, k),
            Some(misses) => ranking::k_best_with_misses(costs, rows, columns, misses, k),
        }
    })?;
    let columns = |row_to_column: &[Option<usize>]| PyArray1::from_iter(py, row_to_column.iter().map(|&c| column(c)));
    Ok(found
        .iter()
        .map(|ranked| (columns(&ranked.row_to_column), ranked.cost))
        .collect())
}

/// What `marginals` hands to the facade.
type Found<'py> = (Bound<'py, PyArray2<f64>>, &'static str, Option<f64>, f64);

/// Probabilities (tracks, 1 + reports), method, bound of the error and ln of the total weight.
#[pyfunction]
pub(crate) fn marginals<'py>(
    py: Python<'py>,
    weights: PyReadonlyArray2<'py, f64>,
    log: bool,
    budget: i64,
    prune: bool,
) -> PyResult<Found<'py>> {
    let (tracks, columns) = (weights.shape()[0], weights.shape()[1]);
    let values = array::c_slice(&weights, "weights")?;
    let domain = if log { Domain::Log } else { Domain::Linear };
    let budget = count("budget", budget).map_err(|error| to_python(py, &error))?;
    let (table, found) = compute_long(py, || {
        let table = Weights::from_dense(values, tracks, columns, domain)?;
        let found = joint::marginals(&table, &Options { budget, prune })?;
        Ok((table, found))
    })?;
    let method = match found.method {
        Method::Exact => "exact",
        Method::MBest => "m_best",
        Method::Belief => "belief",
    };
    let probabilities = dense(py, &table, &found)?;
    Ok((probabilities, method, found.error_bound, found.log_total))
}

fn dense<'py>(py: Python<'py>, table: &Weights, found: &Marginals) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let columns = table.reports() + 1;
    let mut values = vec![0.0; table.tracks() * columns];
    for (track, row) in values.chunks_exact_mut(columns).enumerate() {
        row[0] = found.missed[track];
        for (candidate, &p) in table.candidates(track).iter().zip(found.candidates(track)) {
            row[candidate.report + 1] = p;
        }
    }
    PyArray1::from_vec(py, values).reshape([table.tracks(), columns])
}
