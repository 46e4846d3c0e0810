//! Symmetric matrices: exact symmetry, and the check that a covariance is one.

use nalgebra::{DMatrix, DVector};

use super::kernel;
use crate::error::{Error, Result, require_finite, require_size};

/// Replaces `matrix` by (A + Aᵀ)/2, so that it is symmetric bit for bit.
pub fn symmetrise(matrix: &mut DMatrix<f64>) {
    for j in 0..matrix.ncols() {
        for i in j + 1..matrix.nrows() {
            let mean = 0.5 * (matrix[(i, j)] + matrix[(j, i)]);
            matrix[(i, j)] = mean;
            matrix[(j, i)] = mean;
        }
    }
}

/// The smallest and largest eigenvalue of a symmetric matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EigenRange {
    /// Smallest eigenvalue.
    pub min: f64,
    /// Largest eigenvalue.
    pub max: f64,
}

/// Extreme eigenvalues of a symmetric matrix (its lower half is read).
pub fn eigen_range(matrix: &DMatrix<f64>) -> Result<EigenRange> {
    let n = matrix.nrows();
    let view = faer::MatRef::from_column_major_slice(matrix.as_slice(), n, n);
    let failed = |_| Error::NonFinite {
        what: "eigenvalues".into(),
        index: 0,
    };
    let values = view.self_adjoint_eigenvalues(faer::Side::Lower).map_err(failed)?;
    Ok(EigenRange {
        min: values.iter().copied().fold(f64::INFINITY, f64::min),
        max: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    })
}

/// A symmetric matrix taken apart: A = V diag(λ) Vᵀ.
#[derive(Debug, Clone, PartialEq)]
pub struct SymmetricEigen {
    /// λ, not decreasing.
    pub values: DVector<f64>,
    /// V, orthogonal: its columns are the eigenvectors.
    pub vectors: DMatrix<f64>,
}

/// Eigenvalues and eigenvectors of a symmetric matrix (its lower half is read).
pub fn symmetric_eigen(matrix: &DMatrix<f64>) -> Result<SymmetricEigen> {
    let n = matrix.nrows();
    if n == 0 {
        let (values, vectors) = (DVector::zeros(0), DMatrix::zeros(0, 0));
        return Ok(SymmetricEigen { values, vectors });
    }
    let view = faer::MatRef::from_column_major_slice(matrix.as_slice(), n, n);
    let eigen = view
        .self_adjoint_eigen(faer::Side::Lower)
        .map_err(|_| Error::NonFinite {
            what: "eigenvalues".into(),
            index: 0,
        })?;
    Ok(SymmetricEigen {
        values: DVector::from_fn(n, |i, _| eigen.S()[i]),
        vectors: DMatrix::from_fn(n, n, |i, j| eigen.U()[(i, j)]),
    })
}

/// The matrix with its eigenvalues clipped into [`min`, `max`] (its lower half is read). A matrix whose eigenvalues lie
/// strictly between is returned as it is: A − min I and max I − A then have Cholesky factors.
pub fn clip_eigenvalues(matrix: &DMatrix<f64>, min: f64, max: f64) -> Result<DMatrix<f64>> {
    let n = matrix.nrows();
    let mut shifted = matrix.as_slice().to_vec();
    (0..n).for_each(|i| shifted[i * (n + 1)] -= min);
    if kernel::cholesky(n, &mut shifted).is_ok() {
        for (x, a) in shifted.iter_mut().zip(matrix.iter()) {
            *x = -a;
        }
        (0..n).for_each(|i| shifted[i * (n + 1)] += max);
        if kernel::cholesky(n, &mut shifted).is_ok() {
            return Ok(matrix.clone());
        }
    }
    let SymmetricEigen { values, vectors } = symmetric_eigen(matrix)?;
    let clipped = DMatrix::from_diagonal(&values.map(|value| value.clamp(min, max)));
    let mut out = &vectors * clipped * vectors.transpose();
    symmetrise(&mut out);
    Ok(out)
}

/// Checks a covariance given by the user: n×n, finite, symmetric to 1e-9 of its scale, and positive
/// semidefinite to rounding.
pub fn require_covariance(what: &str, matrix: &DMatrix<f64>, n: usize) -> Result<()> {
    require_size(what, n, matrix.nrows())?;
    require_size(what, n, matrix.ncols())?;
    require_finite(what, matrix.transpose().iter())?;
    let scale = matrix.amax();
    if (matrix - matrix.transpose()).amax() > 1e-9 * scale {
        return Err(Error::invalid(what, "given", "must be symmetric"));
    }
    let smallest = if n == 0 { 0.0 } else { eigen_range(matrix)?.min };
    if smallest < -1e-9 * scale {
        return Err(Error::invalid(
            what,
            format!("given with eigenvalue {smallest:e}"),
            "must be positive semidefinite",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covariance_check_names_the_fault() {
        let good = DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 2.0]);
        assert!(require_covariance("cov", &good, 2).is_ok());
        let skew = DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 0.0, 2.0]);
        assert!(matches!(
            require_covariance("cov", &skew, 2),
            Err(Error::InvalidParameter { .. })
        ));
        let indefinite = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0]);
        assert!(matches!(
            require_covariance("cov", &indefinite, 2),
            Err(Error::InvalidParameter { .. })
        ));
        assert!(matches!(
            require_covariance("cov", &good, 3),
            Err(Error::DimensionMismatch { .. })
        ));
    }
}
