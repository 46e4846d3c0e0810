//! A Gaussian: mean and covariance.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite};
use crate::linalg::symmetric::{require_covariance, symmetrise};

/// A Gaussian distribution, mean of length n and covariance n×n, symmetric bit for bit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct Gaussian {
    /// Mean, length n.
    pub mean: DVector<f64>,
    /// Covariance, n×n.
    pub cov: DMatrix<f64>,
}

impl Gaussian {
    /// A checked Gaussian: finite mean, finite symmetric positive semidefinite covariance of its size.
    pub fn new(mean: DVector<f64>, mut cov: DMatrix<f64>) -> Result<Self> {
        require_finite("mean", mean.iter())?;
        require_covariance("cov", &cov, mean.len())?;
        symmetrise(&mut cov);
        Ok(Self { mean, cov })
    }

    /// Length of the mean.
    pub fn dim(&self) -> usize {
        self.mean.len()
    }

    /// The marginal of the first `n` components.
    #[must_use]
    pub fn leading(&self, n: usize) -> Self {
        Self {
            mean: self.mean.rows(0, n).into_owned(),
            cov: self.cov.view((0, 0), (n, n)).into_owned(),
        }
    }
}

/// What is saved of a Gaussian: the mean and the lower half of the covariance, row by row.
#[derive(Serialize, Deserialize)]
struct Parts {
    mean: Vec<f64>,
    lower: Vec<f64>,
}

impl From<Gaussian> for Parts {
    fn from(g: Gaussian) -> Self {
        let lower = (0..g.dim()).flat_map(|i| (0..=i).map(move |j| (i, j)));
        Self {
            lower: lower.map(|index| g.cov[index]).collect(),
            mean: g.mean.as_slice().to_vec(),
        }
    }
}

impl TryFrom<Parts> for Gaussian {
    type Error = Error;

    fn try_from(parts: Parts) -> Result<Self> {
        let n = parts.mean.len();
        crate::error::require_size("saved covariance", n * (n + 1) / 2, parts.lower.len())?;
        require_finite("saved mean", &parts.mean)?;
        require_finite("saved covariance", &parts.lower)?;
        let cov = DMatrix::from_fn(n, n, |i, j| {
            let (row, column) = (i.max(j), i.min(j));
            parts.lower[row * (row + 1) / 2 + column]
        });
        Ok(Self {
            mean: DVector::from_vec(parts.mean),
            cov,
        })
    }
}
