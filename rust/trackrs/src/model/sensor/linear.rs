//! A linear sensor given by its matrices: z = H x + d + v, v ~ N(0, R).

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{Motion, Sensor};
use crate::error::{Result, require_finite, require_size};
use crate::linalg::symmetric::require_covariance;

/// A sensor by fixed matrices H (m×n) and R (m×m) and an offset d (m).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinearSensor {
    #[serde(with = "crate::linalg::saved::matrix")]
    matrix: DMatrix<f64>,
    #[serde(with = "crate::linalg::saved::matrix")]
    noise: DMatrix<f64>,
    #[serde(with = "crate::linalg::saved::vector")]
    offset: DVector<f64>,
}

impl LinearSensor {
    /// The sensor z = H x + d + v with v ~ N(0, R).
    pub fn new(matrix: DMatrix<f64>, noise: DMatrix<f64>, offset: DVector<f64>) -> Result<Self> {
        require_finite("H", matrix.iter())?;
        require_covariance("R", &noise, matrix.nrows())?;
        require_size("offset", matrix.nrows(), offset.len())?;
        require_finite("offset", offset.iter())?;
        Ok(Self { matrix, noise, offset })
    }

    /// H, m×n.
    pub fn matrix(&self) -> &DMatrix<f64> {
        &self.matrix
    }

    /// d, m.
    pub fn offset(&self) -> &DVector<f64> {
        &self.offset
    }
}

impl Sensor for LinearSensor {
    fn measurement_dim(&self) -> usize {
        self.matrix.nrows()
    }
    fn labels(&self) -> Vec<String> {
        (0..self.matrix.nrows()).map(|i| format!("z{i}")).collect()
    }
    fn check(&self, motion: &dyn Motion) -> Result<()> {
        require_size("state of the motion model", self.matrix.ncols(), motion.state_dim())
    }
    fn observe(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        Ok(&self.matrix * state + &self.offset)
    }
    fn jacobian(&self, _state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        Ok(self.matrix.clone())
    }
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        _platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        for (i, (value, row)) in expected
            .iter_mut()
            .zip(jacobian.chunks_exact_mut(state.len().max(1)))
            .enumerate()
        {
            *value = 0.0;
            for (j, x) in row.iter_mut().enumerate() {
                *x = self.matrix[(i, j)];
                *value += *x * state[j];
            }
            *value += self.offset[i];
        }
        Ok(())
    }
    fn noise(&self) -> DMatrix<f64> {
        self.noise.clone()
    }
    fn is_linear(&self) -> bool {
        true
    }
}
