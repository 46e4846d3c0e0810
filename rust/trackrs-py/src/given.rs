//! What a run of a filter is given, in pieces that are copied: another thread may write to the arrays meanwhile.

use std::ops::Range;

use nalgebra::DVector;
use pyo3::prelude::*;
use trackrs::filter::search::Start;
use trackrs::filter::sequence::{Filter, Sequence};
use trackrs::model::Sensor as _;

use crate::error::{compute, to_python};

/// Rows taken at once while a start is sought: a position fix costs tens of updates.
const START_CHUNK: usize = 256;

/// The arrays given to a run.
pub(crate) struct Given<'a> {
    pub(crate) leads: Option<&'a [f64]>,
    pub(crate) times: &'a [f64],
    pub(crate) values: &'a [f64],
    pub(crate) inputs: Option<&'a [f64]>,
}

/// A copy of some of their rows.
pub(crate) struct Piece {
    leads: Option<Vec<f64>>,
    times: Vec<f64>,
    values: Vec<f64>,
    inputs: Option<Vec<f64>>,
    first_row: usize,
}

impl Given<'_> {
    pub(crate) fn piece(&self, rows: Range<usize>, m: usize, n: usize) -> Piece {
        let part = |array: &[f64], width: usize| array[rows.start * width..rows.end * width].to_vec();
        Piece {
            leads: self.leads.map(|leads| part(leads, 1)),
            times: part(self.times, 1),
            values: part(self.values, m),
            inputs: self.inputs.map(|inputs| part(inputs, n)),
            first_row: rows.start,
        }
    }

    /// The start of a run without an initial state, looking for Ctrl-C; n is the length of its inputs.
    pub(crate) fn find_start(&self, py: Python<'_>, filter: &Filter, n: usize) -> PyResult<Start> {
        let m = filter.sensor().measurement_dim();
        let mut starter = compute(py, || filter.starter())?;
        let count = self.times.len();
        for from in (0..count).step_by(START_CHUNK) {
            let part = from..(from + START_CHUNK).min(count);
            let rows = |flat: &[f64], width: usize| -> Vec<_> {
                part.clone()
                    .map(|row| DVector::from_column_slice(&flat[row * width..(row + 1) * width]))
                    .collect()
            };
            let (times, values) = (self.times[part.clone()].to_vec(), rows(self.values, m));
            let inputs = self.inputs.map(|inputs| rows(inputs, n));
            let found = compute(py, || starter.search(&times, &values, inputs.as_deref()))?;
            if let Some(start) = found {
                return Ok(Start {
                    row: from + start.row,
                    ..start
                });
            }
            py.check_signals()?;
        }
        Err(to_python(py, &starter.failure()))
    }
}

impl Piece {
    pub(crate) fn sequence(&self) -> Sequence<'_> {
        Sequence {
            times: &self.times,
            measurements: &self.values,
            inputs: self.inputs.as_deref(),
            leads: self.leads.as_deref(),
            first_row: self.first_row,
        }
    }
}
