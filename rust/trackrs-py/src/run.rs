//! What a run of a filter gives, as arrays.

use std::collections::BTreeMap;

use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use trackrs::filter::run::FilterRun;
use trackrs::filter::screen::Verdict;

use crate::array;
use crate::scans::{EventRecord, LedgerRecord, counts, recent};

/// What a run gives.
#[derive(IntoPyObject)]
pub(crate) struct Run<'py> {
    means: Bound<'py, PyArray2<f64>>,
    covs: Bound<'py, PyArray3<f64>>,
    predicted_means: Bound<'py, PyArray2<f64>>,
    predicted_covs: Bound<'py, PyArray3<f64>>,
    transitions: Bound<'py, PyArray3<f64>>,
    motion_noises: Bound<'py, PyArray3<f64>>,
    innovations: Bound<'py, PyArray2<f64>>,
    innovation_covs: Bound<'py, PyArray3<f64>>,
    nis: Bound<'py, PyArray1<f64>>,
    dof: Bound<'py, PyArray1<i64>>,
    /// 0 missing, 1 used, 2 rejected.
    verdicts: Bound<'py, PyArray2<i8>>,
    statistics: Bound<'py, PyArray1<f64>>,
    p_values: Bound<'py, PyArray1<f64>>,
    q_hat: Bound<'py, PyArray3<f64>>,
    r_hat: Bound<'py, PyArray3<f64>>,
    lead_times: Bound<'py, PyArray1<f64>>,
    lead_means: Bound<'py, PyArray2<f64>>,
    lead_covs: Bound<'py, PyArray3<f64>>,
    restarts: Vec<usize>,
    events: Vec<EventRecord>,
    event_counts: BTreeMap<&'static str, u64>,
    ledger: LedgerRecord,
    log_likelihood: f64,
    start: usize,
    /// Index of the rotation vector in the state.
    attitude: Option<usize>,
}

impl<'py> Run<'py> {
    /// Its memory is handed over.
    pub(crate) fn new(py: Python<'py>, run: FilterRun) -> PyResult<Self> {
        let m = run.innovations.shape()[1];
        Ok(Self {
            means: array::from_vectors(py, run.filtered.means)?,
            covs: array::from_matrices(py, run.filtered.covs)?,
            predicted_means: array::from_vectors(py, run.predicted.means)?,
            predicted_covs: array::from_matrices(py, run.predicted.covs)?,
            transitions: array::from_repeats(py, run.transitions)?,
            motion_noises: array::from_repeats(py, run.motion_noises)?,
            innovations: array::from_vectors(py, run.innovations)?,
            innovation_covs: array::from_matrices(py, run.innovation_covs)?,
            nis: PyArray1::from_vec(py, run.nis),
            dof: PyArray1::from_iter(py, run.dof.iter().map(|&d| i64::try_from(d).unwrap_or(i64::MAX))),
            verdicts: PyArray1::from_iter(
                py,
                run.screened.iter().flat_map(|s| s.verdicts.iter().map(|&v| code(v))),
            )
            .reshape([run.screened.len(), m])?,
            statistics: PyArray1::from_iter(py, run.screened.iter().map(|s| s.statistic)),
            p_values: PyArray1::from_iter(py, run.screened.iter().map(|s| s.p_value)),
            q_hat: array::from_matrices(py, run.q_hat)?,
            r_hat: array::from_matrices(py, run.r_hat)?,
            lead_times: PyArray1::from_vec(py, run.lead_times),
            lead_means: array::from_vectors(py, run.leads.means)?,
            lead_covs: array::from_matrices(py, run.leads.covs)?,
            restarts: run.restarts,
            events: recent(&run.books.events),
            event_counts: counts(&run.books.events),
            ledger: LedgerRecord::of(&run.books.ledger),
            log_likelihood: run.log_likelihood,
            start: run.start,
            attitude: run.space.attitude,
        })
    }
}

/// A verdict as the facade's `Verdict` numbers it.
fn code(verdict: Verdict) -> i8 {
    match verdict {
        Verdict::Missing => 0,
        Verdict::Used => 1,
        Verdict::Rejected => 2,
    }
}
