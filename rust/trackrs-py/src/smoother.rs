//! Smoothing of a filter run.

use numpy::{PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trackrs::error::require_size;
use trackrs::filter::run::FilterRun;
use trackrs::filter::smoother::{Backward, Epoch, FixedLagSmoother, SmoothedRun};
use trackrs::linalg::stack::Stack;

use crate::array;
use crate::error::{compute, to_python};

/// Steps back between two looks for Ctrl-C.
const CHUNK: usize = 4096;

/// What smoothing gives.
#[derive(IntoPyObject)]
pub(crate) struct Smoothed<'py> {
    means: Bound<'py, PyArray2<f64>>,
    covs: Bound<'py, PyArray3<f64>>,
    lag_one_covs: Bound<'py, PyArray3<f64>>,
}

#[allow(clippy::too_many_arguments)]
#[pyfunction]
#[pyo3(signature = (means, covs, predicted_means, predicted_covs, transitions, motion_noises, lag=None, attitude=None))]
pub(crate) fn smooth<'py>(
    py: Python<'py>,
    means: PyReadonlyArray2<'py, f64>,
    covs: PyReadonlyArray3<'py, f64>,
    predicted_means: PyReadonlyArray2<'py, f64>,
    predicted_covs: PyReadonlyArray3<'py, f64>,
    transitions: PyReadonlyArray3<'py, f64>,
    motion_noises: PyReadonlyArray3<'py, f64>,
    lag: Option<usize>,
    attitude: Option<usize>,
) -> PyResult<Smoothed<'py>> {
    let n = means.shape()[1];
    let mut run = FilterRun::new(n, 0);
    run.space.attitude = attitude.filter(|at| at + 3 <= n);
    for (stack, array, name) in [
        (&mut run.filtered.means, &means, "means"),
        (&mut run.predicted.means, &predicted_means, "predicted_means"),
    ] {
        fill(py, stack, array::c_slice(array, name)?, array.shape(), name)?;
    }
    for (stack, array, name) in [
        (&mut run.filtered.covs, &covs, "covs"),
        (&mut run.predicted.covs, &predicted_covs, "predicted_covs"),
        (&mut run.transitions, &transitions, "transitions"),
        (&mut run.motion_noises, &motion_noises, "motion_noises"),
    ] {
        fill(py, stack, array::c_slice(array, name)?, array.shape(), name)?;
    }
    for (covs, name) in [(&run.filtered.covs, "covs"), (&run.predicted.covs, "predicted_covs")] {
        compute(py, || require_size(name, run.filtered.len(), covs.len()))?;
    }
    let epochs = compute(py, || run.epochs())?;
    let out = match lag {
        None => fixed_interval(py, &epochs, n)?,
        Some(lag) => fixed_lag(py, &epochs, lag, n)?,
    };
    Ok(Smoothed {
        means: array::from_vectors(py, out.states.means)?,
        covs: array::from_matrices(py, out.states.covs)?,
        lag_one_covs: array::from_matrices(py, out.lag_one)?,
    })
}

/// Copies an array of vectors (k, n) or matrices (k, n, n).
fn fill(py: Python<'_>, stack: &mut Stack, values: &[f64], shape: &[usize], name: &str) -> PyResult<()> {
    let n = stack.shape()[1];
    for &size in &shape[1..] {
        require_size(name, n, size).map_err(|error| to_python(py, &error))?;
    }
    stack.reserve(shape[0]);
    values
        .chunks_exact((stack.shape()[0] * n).max(1))
        .for_each(|one| stack.push(one));
    Ok(())
}

/// `smoother::fixed_interval`, looking for Ctrl-C; neighbouring pieces share an epoch.
fn fixed_interval(py: Python<'_>, epochs: &[Epoch<'_>], n: usize) -> PyResult<SmoothedRun> {
    let Some(last) = epochs.last() else {
        return Ok(SmoothedRun::new(n));
    };
    let mut back = Backward::from(last.filtered);
    let mut to = epochs.len() - 1;
    loop {
        let from = to.saturating_sub(CHUNK);
        compute(py, || back.through(&epochs[from..=to]))?;
        py.check_signals()?;
        to = from;
        if to == 0 {
            return Ok(back.finish());
        }
    }
}

/// `smoother::fixed_lag`, looking for Ctrl-C.
fn fixed_lag(py: Python<'_>, epochs: &[Epoch<'_>], lag: usize, n: usize) -> PyResult<SmoothedRun> {
    let mut run = SmoothedRun::new(n);
    let mut smoother = compute(py, || FixedLagSmoother::new(lag))?;
    for piece in epochs.chunks((CHUNK / lag).max(1)) {
        compute(py, || {
            for epoch in piece {
                if let Some(lagged) = smoother.push(epoch)? {
                    run.push(&lagged);
                }
            }
            Ok(())
        })?;
        py.check_signals()?;
    }
    let tail = compute(py, || Ok(smoother.tail()))?;
    run.append(&tail);
    Ok(run)
}
