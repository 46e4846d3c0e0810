//! A linear motion given by its matrices: x⁺ = F x + w, w ~ N(0, Q), once per positive time step whatever its length.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{Motion, NoiseInput};
use crate::error::{Result, require_finite, require_size};
use crate::linalg::symmetric::require_covariance;

/// Motion by fixed matrices F and Q (n×n), for series sampled at a fixed step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinearMotion {
    #[serde(with = "crate::linalg::saved::matrix")]
    transition: DMatrix<f64>,
    #[serde(with = "crate::linalg::saved::matrix")]
    noise: DMatrix<f64>,
}

impl LinearMotion {
    /// The model x⁺ = F x + w with w ~ N(0, Q).
    pub fn new(transition: DMatrix<f64>, noise: DMatrix<f64>) -> Result<Self> {
        let n = transition.nrows();
        require_size("F", n, transition.ncols())?;
        require_finite("F", transition.iter())?;
        require_covariance("Q", &noise, n)?;
        Ok(Self { transition, noise })
    }
}

impl Motion for LinearMotion {
    fn state_dim(&self) -> usize {
        self.transition.nrows()
    }
    fn position_dims(&self) -> usize {
        self.state_dim()
    }
    fn labels(&self) -> Vec<String> {
        (0..self.state_dim()).map(|i| format!("x{i}")).collect()
    }
    fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
        if dt == 0.0 {
            return state.clone();
        }
        &self.transition * state
    }
    fn jacobian(&self, _state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        if dt == 0.0 {
            return DMatrix::identity(self.state_dim(), self.state_dim());
        }
        self.transition.clone()
    }
    fn noise(&self, dt: f64) -> DMatrix<f64> {
        if dt == 0.0 {
            return DMatrix::zeros(self.state_dim(), self.state_dim());
        }
        self.noise.clone()
    }
    fn is_linear(&self) -> bool {
        true
    }
    fn same_over(&self, dt: f64, other: f64) -> bool {
        (dt == 0.0) == (other == 0.0)
    }
    fn noise_input(&self, dt: f64) -> Option<NoiseInput> {
        let n = self.state_dim();
        Some(NoiseInput {
            gain: if dt == 0.0 {
                DMatrix::zeros(n, n)
            } else {
                DMatrix::identity(n, n)
            },
            repeat: 1,
            cov: self.noise.clone(),
            rest: None,
        })
    }
}
