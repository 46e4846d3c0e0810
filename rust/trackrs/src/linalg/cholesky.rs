//! Cholesky factorisation that names the failing pivot.
//!
//! | symbol | name here | shape | meaning                          |
//! |--------|-----------|-------|----------------------------------|
//! | A      | `matrix`  | n×n   | symmetric; the lower half is read |
//! | L      | `lower`   | n×n   | lower triangular, A = L Lᵀ       |
//!
//! Row by row: L_jj = sqrt(A_jj − Σ_k L_jk²),  L_ij = (A_ij − Σ_k L_ik L_jk) / L_jj.
//! A non-positive or non-finite pivot ends it with [`Error::NotPositiveDefinite`].
//! Above [`DENSE_SIZE`] rows the blocked factorisation of faer takes over.
//!
//! Reference: Golub, Van Loan (2013), Matrix Computations, §4.2.

use faer::linalg::solvers::{Llt, LltError};
use nalgebra::{DMatrix, DVector};

use super::kernel;
use super::symmetric::symmetrise;
use crate::error::{Error, Result, require_size};

/// Matrices with more rows than this are factorised by faer.
pub const DENSE_SIZE: usize = 32;

/// The lower Cholesky factor of a symmetric positive definite matrix.
#[derive(Debug, Clone)]
pub struct Cholesky {
    lower: DMatrix<f64>,
}

impl Cholesky {
    /// Factorises `matrix`, reading its lower half; `what` names it in the error.
    pub fn new(matrix: &DMatrix<f64>, what: &str) -> Result<Self> {
        let n = matrix.nrows();
        require_size(what, n, matrix.ncols())?;
        let lower = if n > DENSE_SIZE {
            factor_dense(matrix)
        } else {
            factor(matrix)
        };
        match lower {
            Ok(lower) => Ok(Self { lower }),
            Err((pivot, value)) => Err(Error::NotPositiveDefinite {
                what: what.into(),
                pivot,
                value,
            }),
        }
    }

    /// The factor L.
    pub fn lower(&self) -> &DMatrix<f64> {
        &self.lower
    }

    /// L⁻¹ v: a vector of covariance A becomes one of unit covariance.
    #[must_use]
    pub fn whiten(&self, v: &DVector<f64>) -> DVector<f64> {
        let mut out = v.clone();
        for i in 0..out.len() {
            let mut sum = out[i];
            for k in 0..i {
                sum -= self.lower[(i, k)] * out[k];
            }
            out[i] = sum / self.lower[(i, i)];
        }
        out
    }

    /// L⁻¹ B L⁻ᵀ of a symmetric matrix B: the same in axes in which A is 1; exactly symmetric.
    #[must_use]
    pub fn whiten_both(&self, b: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = b.clone();
        // One side after the other.
        for _ in 0..2 {
            for mut column in out.column_iter_mut() {
                let whitened = self.whiten(&column.clone_owned());
                column.copy_from(&whitened);
            }
            out.transpose_mut();
        }
        symmetrise(&mut out);
        out
    }

    /// A⁻¹ B, by the two triangular systems.
    #[must_use]
    pub fn solve(&self, b: &DMatrix<f64>) -> DMatrix<f64> {
        let n = self.lower.nrows();
        let mut out = b.clone();
        for mut column in out.column_iter_mut() {
            for i in 0..n {
                let mut sum = column[i];
                for k in 0..i {
                    sum -= self.lower[(i, k)] * column[k];
                }
                column[i] = sum / self.lower[(i, i)];
            }
            for i in (0..n).rev() {
                let mut sum = column[i];
                for k in i + 1..n {
                    sum -= self.lower[(k, i)] * column[k];
                }
                column[i] = sum / self.lower[(i, i)];
            }
        }
        out
    }

    /// ln det A.
    pub fn log_determinant(&self) -> f64 {
        2.0 * self.lower.diagonal().iter().map(|&d| libm::log(d)).sum::<f64>()
    }
}

fn factor(matrix: &DMatrix<f64>) -> std::result::Result<DMatrix<f64>, (usize, f64)> {
    let n = matrix.nrows();
    let mut lower = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            lower[i * n + j] = matrix[(i, j)];
        }
    }
    kernel::cholesky(n, &mut lower).map_err(|pivot| (pivot.index, pivot.value))?;
    Ok(DMatrix::from_row_slice(n, n, &lower))
}

fn factor_dense(matrix: &DMatrix<f64>) -> std::result::Result<DMatrix<f64>, (usize, f64)> {
    let n = matrix.nrows();
    let view = faer::MatRef::from_column_major_slice(matrix.as_slice(), n, n);
    match Llt::new(view, faer::Side::Lower) {
        Ok(llt) => {
            let factor = llt.L();
            Ok(DMatrix::from_fn(n, n, |i, j| if i < j { 0.0 } else { factor[(i, j)] }))
        }
        Err(LltError::NonPositivePivot { index }) => {
            let pivot = index.min(n - 1);
            Err((pivot, matrix[(pivot, pivot)]))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn spd(n: usize) -> DMatrix<f64> {
        let b = DMatrix::from_fn(n, n, |i, j| ((i * 7 + j * 13) % 11) as f64 - 5.0);
        &b * b.transpose() + DMatrix::identity(n, n)
    }

    #[test]
    fn factor_times_its_transpose_is_the_matrix_in_both_paths() {
        for n in [1, 2, 5, 9, DENSE_SIZE, DENSE_SIZE + 9] {
            let a = spd(n);
            let l = Cholesky::new(&a, "a").unwrap();
            assert_relative_eq!(l.lower() * l.lower().transpose(), a, epsilon = 1e-9 * a.amax());
            let b = DMatrix::from_fn(n, 2, |i, j| (i + j) as f64);
            assert_relative_eq!(&a * l.solve(&b), b, epsilon = 1e-8 * a.amax());
        }
    }

    #[test]
    fn failing_pivot_is_named() {
        for n in [4, DENSE_SIZE + 4] {
            let mut a = DMatrix::identity(n, n);
            a[(2, 2)] = -1.0;
            match Cholesky::new(&a, "innovation covariance") {
                Err(Error::NotPositiveDefinite { what, pivot, .. }) => {
                    assert_eq!((what.as_str(), pivot), ("innovation covariance", 2));
                }
                other => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn nan_is_an_error_and_not_a_result() {
        let mut a = spd(3);
        a[(1, 0)] = f64::NAN;
        assert!(Cholesky::new(&a, "a").is_err());
    }
}
