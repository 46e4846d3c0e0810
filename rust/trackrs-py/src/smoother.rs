//! Smoothing of a filter run.

use nalgebra::{DMatrix, DVector};
use numpy::{PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trackrs::error::require_size;
use trackrs::filter::sequence::FilterRun;
use trackrs::filter::smoother::{Epoch, FixedLagSmoother, SmoothedRun, fixed_interval_from};
use trackrs::{Gaussian, Result};

use crate::array;
use crate::error::compute;

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
#[pyo3(signature = (means, covs, predicted_means, predicted_covs, transitions, motion_noises, lag=None))]
pub(crate) fn smooth<'py>(
    py: Python<'py>,
    means: PyReadonlyArray2<'py, f64>,
    covs: PyReadonlyArray3<'py, f64>,
    predicted_means: PyReadonlyArray2<'py, f64>,
    predicted_covs: PyReadonlyArray3<'py, f64>,
    transitions: PyReadonlyArray3<'py, f64>,
    motion_noises: PyReadonlyArray3<'py, f64>,
    lag: Option<usize>,
) -> PyResult<Smoothed<'py>> {
    let n = means.shape()[1];
    let filtered = (array::rows(&means, "means")?, array::matrices(&covs, "covs")?);
    let predicted = (
        array::rows(&predicted_means, "predicted_means")?,
        array::matrices(&predicted_covs, "predicted_covs")?,
    );
    let transitions = array::matrices(&transitions, "transitions")?;
    let motion_noises = array::matrices(&motion_noises, "motion_noises")?;
    let run = compute(py, || {
        Ok(FilterRun {
            filtered: gaussians(filtered, "covs")?,
            predicted: gaussians(predicted, "predicted_covs")?,
            transitions,
            motion_noises,
            ..FilterRun::default()
        })
    })?;
    let epochs = compute(py, || run.epochs())?;
    let out = match lag {
        None => fixed_interval(py, &epochs)?,
        Some(lag) => fixed_lag(py, &epochs, lag)?,
    };
    Ok(Smoothed {
        means: array::from_rows(py, out.states.iter().map(|g| &g.mean), n)?,
        covs: array::from_symmetric(py, out.states.iter().map(|g| &g.cov), n)?,
        lag_one_covs: array::from_square(py, out.lag_one.iter(), n)?,
    })
}

fn gaussians((means, covs): (Vec<DVector<f64>>, Vec<DMatrix<f64>>), name: &str) -> Result<Vec<Gaussian>> {
    require_size(name, means.len(), covs.len())?;
    Ok(means
        .into_iter()
        .zip(covs)
        .map(|(mean, cov)| Gaussian { mean, cov })
        .collect())
}

/// `smoother::fixed_interval` in pieces from the end; neighbouring pieces share an epoch.
fn fixed_interval(py: Python<'_>, epochs: &[Epoch<'_>]) -> PyResult<SmoothedRun> {
    let Some(last) = epochs.last() else {
        return Ok(SmoothedRun::default());
    };
    let mut end = last.filtered.clone();
    let mut states = vec![end.clone()];
    let mut lag_one = Vec::new();
    let mut to = epochs.len() - 1;
    loop {
        let from = to.saturating_sub(CHUNK);
        let piece = compute(py, || fixed_interval_from(&epochs[from..=to], end))?;
        states.extend(piece.states.into_iter().rev().skip(1));
        lag_one.extend(piece.lag_one.into_iter().rev());
        py.check_signals()?;
        end = states[states.len() - 1].clone();
        to = from;
        if to == 0 {
            break;
        }
    }
    states.reverse();
    lag_one.reverse();
    Ok(SmoothedRun { states, lag_one })
}

/// `smoother::fixed_lag`, looking for Ctrl-C.
fn fixed_lag(py: Python<'_>, epochs: &[Epoch<'_>], lag: usize) -> PyResult<SmoothedRun> {
    let mut run = SmoothedRun::default();
    let mut smoother = compute(py, || FixedLagSmoother::new(lag))?;
    for piece in epochs.chunks((CHUNK / lag).max(1)) {
        compute(py, || {
            for epoch in piece {
                if let Some(lagged) = smoother.push(epoch)? {
                    run.states.push(lagged.state);
                    run.lag_one.push(lagged.lag_one);
                }
            }
            Ok(())
        })?;
        py.check_signals()?;
    }
    let tail = compute(py, || Ok(smoother.tail()))?;
    run.states.extend(tail.states);
    run.lag_one.extend(tail.lag_one);
    Ok(run)
}
