//! States and inputs of the motion alone made those of a filter whose sensor has lasting errors.

use nalgebra::DVector;

use super::sequence::Filter;
use crate::error::{Result, require_size};
use crate::gaussian::Gaussian;
use crate::model::{Motion, Sensor};

impl Filter {
    /// A state of the motion alone made one of the filter: the lasting errors of the sensor follow as known beforehand.
    pub(super) fn complete(&self, state: &Gaussian) -> Result<Gaussian> {
        let n = self.motion().state_dim();
        match self.sensor().nuisance() {
            Some(nuisance) if state.dim() + nuisance.dim() == n => Ok(nuisance.extend(state)),
            _ => require_size("initial state", n, state.dim()).map(|()| state.clone()),
        }
    }

    /// A known input of the motion alone made one of the filter: the lasting errors of the sensor have none.
    pub(super) fn complete_input(&self, input: &DVector<f64>) -> DVector<f64> {
        let missing = self.motion().state_dim().saturating_sub(input.len());
        input.clone().insert_rows(input.len(), missing, 0.0)
    }

    /// Inputs with or without the lasting errors of the sensor, one after the other.
    pub(super) fn flatten_inputs(&self, rows: &[DVector<f64>]) -> Result<Vec<f64>> {
        self.require_states("input", rows)?;
        let complete: Vec<_> = rows.iter().map(|row| self.complete_input(row)).collect();
        flatten("input", &complete, self.motion().state_dim())
    }

    /// Length of a state or input without the lasting errors of the sensor.
    pub fn kinematic_dim(&self) -> usize {
        self.motion().state_dim() - self.sensor().nuisance().map_or(0, |nuisance| nuisance.dim())
    }

    /// Checks lengths that may leave out the lasting errors of the sensor.
    pub(super) fn require_states<'a>(
        &self,
        what: &str,
        states: impl IntoIterator<Item = &'a DVector<f64>>,
    ) -> Result<()> {
        let (n, kinematic) = (self.motion().state_dim(), self.kinematic_dim());
        let odd = states
            .into_iter()
            .map(DVector::len)
            .find(|&len| len != n && len != kinematic);
        odd.map_or(Ok(()), |found| require_size(what, n, found))
    }
}

/// Vectors of one length, one after the other.
pub(super) fn flatten(name: &str, rows: &[DVector<f64>], width: usize) -> Result<Vec<f64>> {
    let mut flat = Vec::with_capacity(rows.len() * width);
    for row in rows {
        require_size(name, width, row.len())?;
        flat.extend_from_slice(row.as_slice());
    }
    Ok(flat)
}
