//! Smoothing of a filter run.

use std::ops::Range;

use numpy::{PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trackrs::error::require_size;
use trackrs::filter::run::FilterRun;
use trackrs::filter::smoother::{Backward, FixedLagSmoother, SmoothedRun};

use crate::array;
use crate::error::{compute, to_python};

/// Steps back between two looks for Ctrl-C: their rows fit into a fast part of the memory.
const CHUNK: usize = 256;

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
    let count = means.shape()[0];
    let mut given = Given {
        n,
        attitude: attitude.filter(|at| at + 3 <= n),
        vectors: [&[]; 2],
        covs: [&[]; 2],
        steps: [&[]; 2],
    };
    let vectors = [(&means, "means"), (&predicted_means, "predicted_means")];
    for (to, (array, name)) in given.vectors.iter_mut().zip(vectors) {
        *to = numbers(py, array::c_slice(array, name)?, array.shape(), [count, n], name)?;
    }
    let covs = [(&covs, "covs"), (&predicted_covs, "predicted_covs")];
    for (to, (array, name)) in given.covs.iter_mut().zip(covs) {
        *to = numbers(py, array::c_slice(array, name)?, array.shape(), [count, n, n], name)?;
    }
    let steps = [(&transitions, "transitions"), (&motion_noises, "motion_noises")];
    for (to, (array, name)) in given.steps.iter_mut().zip(steps) {
        let given = if array.shape()[0] == 1 { 1 } else { count };
        *to = numbers(py, array::c_slice(array, name)?, array.shape(), [given, n, n], name)?;
    }
    let out = match lag {
        None => fixed_interval(py, &given, count)?,
        Some(lag) => fixed_lag(py, &given, count, lag)?,
    };
    Ok(Smoothed {
        means: array::from_vectors(py, out.states.means)?,
        covs: array::from_matrices(py, out.states.covs)?,
        lag_one_covs: array::from_matrices(py, out.lag_one)?,
    })
}

/// The arrays given.
struct Given<'a> {
    n: usize,
    attitude: Option<usize>,
    /// Means, and predicted means.
    vectors: [&'a [f64]; 2],
    /// Covariances, and predicted covariances.
    covs: [&'a [f64]; 2],
    /// F and Q, of each step or one for all.
    steps: [&'a [f64]; 2],
}

impl Given<'_> {
    /// Some of the rows as a run. A copy, because another thread may write to the arrays while the interpreter is released.
    fn copy(&self, rows: Range<usize>, run: &mut FilterRun) {
        run.space.attitude = self.attitude;
        let vectors = [&mut run.filtered.means, &mut run.predicted.means];
        let covs = [&mut run.filtered.covs, &mut run.predicted.covs];
        let vectors = vectors.into_iter().zip(self.vectors).map(|pair| (pair, self.n));
        let covs = covs.into_iter().zip(self.covs).map(|pair| (pair, self.n * self.n));
        for ((stack, values), width) in vectors.chain(covs) {
            stack.clear();
            stack.append(&values[rows.start * width..rows.end * width]);
        }
        let steps = [&mut run.transitions, &mut run.motion_noises];
        for (repeats, values) in steps.into_iter().zip(self.steps) {
            let width = self.n * self.n;
            repeats.clear();
            for row in rows.clone() {
                let from = if values.len() == width { 0 } else { row * width };
                repeats.push(&values[from..from + width]);
            }
        }
    }
}

/// The numbers of an array of this shape.
fn numbers<'a>(
    py: Python<'_>,
    values: &'a [f64],
    found: &[usize],
    shape: impl IntoIterator<Item = usize>,
    name: &str,
) -> PyResult<&'a [f64]> {
    for (expected, &found) in shape.into_iter().zip(found) {
        require_size(name, expected, found).map_err(|error| to_python(py, &error))?;
    }
    Ok(values)
}

/// `smoother::fixed_interval`, looking for Ctrl-C; neighbouring pieces share an epoch.
fn fixed_interval(py: Python<'_>, given: &Given<'_>, count: usize) -> PyResult<SmoothedRun> {
    let mut piece = FilterRun::new(given.n, 0);
    let Some(mut to) = count.checked_sub(1) else {
        return Ok(SmoothedRun::new(given.n));
    };
    given.copy(to..count, &mut piece);
    let mut back = Backward::from(piece.filtered.view(0));
    back.reserve(count);
    loop {
        let from = to.saturating_sub(CHUNK);
        given.copy(from..to + 1, &mut piece);
        compute(py, || {
            let mut epochs = piece.epochs()?;
            for epoch in &mut epochs {
                epoch.step += from;
            }
            back.through(&epochs)
        })?;
        py.check_signals()?;
        to = from;
        if to == 0 {
            return Ok(back.finish());
        }
    }
}

/// `smoother::fixed_lag`, looking for Ctrl-C.
fn fixed_lag(py: Python<'_>, given: &Given<'_>, count: usize, lag: usize) -> PyResult<SmoothedRun> {
    let mut run = SmoothedRun::new(given.n);
    run.reserve(count);
    let mut smoother = compute(py, || FixedLagSmoother::new(lag))?;
    let mut piece = FilterRun::new(given.n, 0);
    let size = (CHUNK / lag).max(1);
    for from in (0..count).step_by(size) {
        given.copy(from..count.min(from + size), &mut piece);
        compute(py, || {
            for mut epoch in piece.epochs()? {
                epoch.step += from;
                if let Some(lagged) = smoother.push(&epoch)? {
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
