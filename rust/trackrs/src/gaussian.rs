//! A Gaussian: mean and covariance.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, all_finite, require_finite};
use crate::linalg::fixed::far_from_singular;
use crate::linalg::kernel::{self, sized};
use crate::linalg::stack::Stack;
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

    /// An error where the numbers have grown too large to be told.
    pub(crate) fn require_finite(&self, what: &str) -> Result<()> {
        if all_finite(self.mean.as_slice()) && all_finite(self.cov.as_slice()) {
            return Ok(());
        }
        Err(Error::Overflow { what: what.into() })
    }

    /// Whether a component's variance, given those before it, is 1e-14 of its variance or less.
    pub(crate) fn is_nearly_singular(&self) -> bool {
        fn of<const N: usize>(n: usize, cov: &[f64], work: &mut [f64]) -> bool {
            kernel::little_left::<N>(n, kernel::NEARLY_SINGULAR, cov, work)
        }
        self.with_work(|n, cov, work| sized!(of(n, cov, work)))
    }

    /// Whether the matrix of correlations has an eigenvalue of 1e-14 or less: what is kept as a matrix is not definite then
    /// but for rounding.
    pub(crate) fn is_barely_definite(&self) -> bool {
        fn of<const N: usize>(n: usize, cov: &[f64], work: &mut [f64]) -> bool {
            kernel::little_anywhere::<N>(n, kernel::NEARLY_SINGULAR, cov, work)
        }
        if let Ok(four) = self.cov.as_slice().try_into()
            && far_from_singular(four)
        {
            return false;
        }
        self.with_work(|n, cov, work| sized!(of(n, cov, work)))
    }

    fn with_work(&self, ask: impl Fn(usize, &[f64], &mut [f64]) -> bool) -> bool {
        let (mut little, mut much) = ([0.0; 81], Vec::new());
        let work = if self.cov.len() <= little.len() {
            &mut little[..]
        } else {
            much.resize(self.cov.len(), 0.0);
            &mut much
        };
        ask(self.dim(), self.cov.as_slice(), work)
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

/// A Gaussian in somebody else's memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussianRef<'a> {
    /// Mean, length n.
    pub mean: &'a [f64],
    /// Covariance, n×n, symmetric.
    pub cov: &'a [f64],
}

impl GaussianRef<'_> {
    /// Length of the mean.
    pub fn dim(&self) -> usize {
        self.mean.len()
    }

    /// The Gaussian by value.
    pub fn to_owned(&self) -> Gaussian {
        let n = self.dim();
        Gaussian {
            mean: DVector::from_column_slice(self.mean),
            cov: DMatrix::from_column_slice(n, n, self.cov),
        }
    }
}

impl<'a> From<&'a Gaussian> for GaussianRef<'a> {
    fn from(g: &'a Gaussian) -> Self {
        Self {
            mean: g.mean.as_slice(),
            cov: g.cov.as_slice(),
        }
    }
}

/// Gaussians of one dimension, kept in two pieces of memory.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Gaussians {
    /// Their means, vectors of length n.
    pub means: Stack,
    /// Their covariances, n×n.
    pub covs: Stack,
}

impl Gaussians {
    /// None yet, of dimension n.
    pub fn new(n: usize) -> Self {
        Self {
            means: Stack::vectors(n),
            covs: Stack::square(n),
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Gaussian `index` by value; `index` as in a slice.
    pub fn at(&self, index: usize) -> Gaussian {
        self.view(index).to_owned()
    }

    /// Gaussian `index` where it stands.
    pub fn view(&self, index: usize) -> GaussianRef<'_> {
        GaussianRef {
            mean: self.means.at(index),
            cov: self.covs.at(index),
        }
    }

    /// The last, by value.
    pub fn last(&self) -> Option<Gaussian> {
        self.len().checked_sub(1).map(|index| self.at(index))
    }

    /// All, by value.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Gaussian> {
        (0..self.len()).map(|index| self.at(index))
    }

    /// The first one from `from` on with a number that is not finite.
    pub(crate) fn first_not_finite(&self, from: usize) -> Option<usize> {
        let all = |stack: &Stack| all_finite(stack.after(from));
        if all(&self.means) && all(&self.covs) {
            return None;
        }
        (from..self.len()).find(|&i| !(all_finite(self.means.at(i)) && all_finite(self.covs.at(i))))
    }

    /// Adds one.
    #[inline]
    pub fn push<'a>(&mut self, state: impl Into<GaussianRef<'a>>) {
        let state = state.into();
        self.means.push(state.mean);
        self.covs.push(state.cov);
    }

    /// Takes memory for so many more.
    pub fn reserve(&mut self, count: usize) {
        self.means.reserve(count);
        self.covs.reserve(count);
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.means.clear();
        self.covs.clear();
    }

    /// Adds one that is NaN throughout, `count` times.
    pub fn fill_unknown(&mut self, count: usize) {
        self.means.fill(f64::NAN, count);
        self.covs.fill(f64::NAN, count);
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
