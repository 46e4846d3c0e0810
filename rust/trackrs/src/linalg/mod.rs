//! Dense linear algebra that names what failed.

pub mod cholesky;
pub(crate) mod fixed;
pub(crate) mod kernel;
pub mod saved;
pub(crate) mod sparse;
pub mod stack;
pub mod symmetric;

use nalgebra::DMatrix;

/// Writes a matrix row by row.
pub(crate) fn copy_rows(matrix: &DMatrix<f64>, out: &mut [f64]) {
    for (row, out) in matrix.row_iter().zip(out.chunks_exact_mut(matrix.ncols().max(1))) {
        out.iter_mut().zip(row.iter()).for_each(|(x, &value)| *x = value);
    }
}

/// Whether both hold the same numbers, bit for bit; NaN equals NaN.
pub(crate) fn same_bits(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}
