//! Squared Mahalanobis distances of many tracks and reports.

use numpy::{PyArray1, PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trackrs::Result;
use trackrs::error::require_size;
use trackrs::gating::distances::{Expected, pairs_within, squared_distances};

use crate::array::c_slice;
use crate::error::compute_long;
use crate::partition::integers;

#[derive(IntoPyObject)]
pub(crate) struct PairColumns<'py> {
    tracks: Bound<'py, PyArray1<i64>>,
    reports: Bound<'py, PyArray1<i64>>,
    distances: Bound<'py, PyArray1<f64>>,
}

/// The sizes must agree: means (T, m), covs (T, m, m), reports (M, m).
fn check(means: &[usize], covs: &[usize], reports: &[usize]) -> Result<()> {
    let sizes = [
        ("covs", means[0], covs[0]),
        ("rows of covs", means[1], covs[1]),
        ("columns of covs", means[1], covs[2]),
        ("columns of reports", means[1], reports[1]),
    ];
    sizes
        .into_iter()
        .try_for_each(|(what, expected, found)| require_size(what, expected, found))
}

#[pyfunction]
pub(crate) fn gate_distances(
    py: Python<'_>,
    means: PyReadonlyArray2<'_, f64>,
    covs: PyReadonlyArray3<'_, f64>,
    reports: PyReadonlyArray2<'_, f64>,
    mut out: PyReadwriteArray2<'_, f64>,
) -> PyResult<()> {
    let sizes = check(means.shape(), covs.shape(), reports.shape());
    let dims = means.shape()[1];
    let (means, covs) = (c_slice(&means, "means")?, c_slice(&covs, "covs")?);
    let reports = c_slice(&reports, "reports")?;
    let out = out.as_slice_mut()?;
    compute_long(py, || {
        sizes?;
        squared_distances(&Expected { dims, means, covs }, reports, out)
    })
}

#[pyfunction]
pub(crate) fn gate_pairs<'py>(
    py: Python<'py>,
    means: PyReadonlyArray2<'py, f64>,
    covs: PyReadonlyArray3<'py, f64>,
    reports: PyReadonlyArray2<'py, f64>,
    threshold: f64,
) -> PyResult<PairColumns<'py>> {
    let sizes = check(means.shape(), covs.shape(), reports.shape());
    let dims = means.shape()[1];
    let (means, covs) = (c_slice(&means, "means")?, c_slice(&covs, "covs")?);
    let reports = c_slice(&reports, "reports")?;
    let pairs = compute_long(py, || {
        sizes?;
        pairs_within(&Expected { dims, means, covs }, reports, threshold)
    })?;
    Ok(PairColumns {
        tracks: integers(py, &pairs.tracks),
        reports: integers(py, &pairs.reports),
        distances: PyArray1::from_vec(py, pairs.distances),
    })
}
