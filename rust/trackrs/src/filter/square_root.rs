//! Covariances as factors: what the square-root form of a filter keeps and how it is made triangular again.
//!
//! | symbol | name here | shape  | meaning                                                            |
//! |--------|-----------|--------|--------------------------------------------------------------------|
//! | U      | `factor`  | n×n    | P = Uᵀ U, rows of a factor; lower triangular after a prediction    |
//! | V      | `seen`    | n×m    | U Hᵀ                                                               |
//! | W      | `weights` | m×m    | R = Wᵀ W, lower                                                    |
//!
//! predict:  rows of U Fᵀ and of a factor of Q, turned by reflections into n rows U⁻: U⁻ᵀ U⁻ = F P Fᵀ + Q
//! update:   [U V; 0 W] turned by rotations into [U⁺ 0; K̄ᵀ W⁺]:  W⁺ᵀ W⁺ = S,  K = K̄ W⁺⁻ᵀ,  x⁺ = x + K̄ W⁺⁻ᵀ r
//!
//! Nothing is subtracted, so that P = Uᵀ U is a covariance whatever the condition: half the digits of P are lost in U where
//! all would be lost in P. Reflections pass over the zeros of a column, and rotations go down the rows of U: both keep a
//! triangle triangular, so that the cost is about that of the plain form.
//! Reference: Kailath, Sayed, Hassibi (2000), Linear Estimation, ch. 12; Golub, Van Loan (2013), §5.1.

use nalgebra::DMatrix;

use crate::error::{Error, Result};
use crate::linalg::kernel::{self, known, sized};

/// How a covariance is carried from epoch to epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Form {
    /// As it is, updated in Joseph form: positive definite up to a condition of 1e14.
    #[default]
    Joseph,
    /// As a factor, updated by orthogonal transformations: up to 1e24.
    SquareRoot,
}

/// Replaces the lower half of a covariance by its factor L, the upper half by zeros. A pivot within rounding of zero makes a
/// column of zeros: P may be singular, but not indefinite.
pub(super) fn lower_cholesky(n: usize, a: &mut [f64], what: &str) -> Result<()> {
    for j in 0..n {
        let diagonal = a[j * n + j];
        let pivot = (0..j).fold(diagonal, |sum, k| sum - a[j * n + k] * a[j * n + k]);
        let rounding = n as f64 * f64::EPSILON * diagonal.abs();
        if !pivot.is_finite() || pivot < -rounding {
            return Err(Error::NotPositiveDefinite {
                what: what.into(),
                pivot: j,
                value: pivot,
            });
        }
        if pivot <= rounding {
            (j..n).for_each(|i| a[i * n + j] = 0.0);
            continue;
        }
        let root = pivot.sqrt();
        a[j * n + j] = root;
        for i in j + 1..n {
            let sum = (0..j).fold(a[i * n + j], |sum, k| sum - a[i * n + k] * a[j * n + k]);
            a[i * n + j] = sum / root;
        }
    }
    for i in 0..n {
        a[i * n + i + 1..(i + 1) * n].fill(0.0);
    }
    Ok(())
}

/// U lower with A = Uᵀ U of a covariance; `work` is n×n.
pub(super) fn lower_root(n: usize, a: &[f64], work: &mut [f64], out: &mut [f64], what: &str) -> Result<()> {
    // The Cholesky factor of the matrix read backwards.
    for (x, y) in work.iter_mut().zip(a.iter().rev()) {
        *x = *y;
    }
    lower_cholesky(n, work, what)?;
    for i in 0..n {
        for j in 0..n {
            out[i * n + j] = work[(n - 1 - j) * n + (n - 1 - i)];
        }
    }
    Ok(())
}

/// Reflects rows into a triangle. Its memory serves one triangle after another.
#[derive(Debug, Clone, Default)]
pub(super) struct Reflector {
    /// Σ v_i a_i.
    sum: Vec<f64>,
    /// Row and value of what is to vanish from a column: of sparse rows little.
    column: Vec<(usize, f64)>,
}

impl Reflector {
    /// Turns the rows of `a` (at least n of length n) so that the first n are lower triangular and the rest zero; the
    /// product Aᵀ A stays.
    pub(super) fn triangularise(&mut self, n: usize, a: &mut [f64]) {
        let Self { sum, column } = self;
        sum.resize(n, 0.0);
        for j in (0..n).rev() {
            column.clear();
            let mut largest = 0.0_f64;
            for (i, row) in a.chunks_exact(n).enumerate() {
                let value = row[j];
                if value != 0.0 && (i < j || i >= n) {
                    largest = largest.max(value.abs());
                    column.push((i, value));
                }
            }
            if column.is_empty() {
                continue;
            }
            let pivot = a[j * n + j];
            let largest = largest.max(pivot.abs());
            let square = |x: f64| (x / largest) * (x / largest);
            let squares = column.iter().fold(square(pivot), |sum, &(_, x)| sum + square(x));
            let norm = largest * squares.sqrt();
            let lead = pivot + if pivot < 0.0 { -norm } else { norm };
            let sum = &mut sum[..j];
            sum.copy_from_slice(&a[j * n..j * n + j]);
            // The reflection is v = (1, a_i/lead): scaled so that nothing overflows.
            for (i, value) in column.iter_mut() {
                *value /= lead;
                kernel::add_scaled(sum, *value, &a[*i * n..*i * n + j]);
            }
            let factor = lead.abs() / norm;
            kernel::add_scaled(&mut a[j * n..j * n + j], -factor, sum);
            for &(i, v) in column.iter() {
                kernel::add_scaled(&mut a[i * n..i * n + j], -factor * v, sum);
                a[i * n + j] = 0.0;
            }
            a[j * n + j] = if pivot < 0.0 { norm } else { -norm };
        }
    }
}

/// `out` = Uᵀ U, symmetric bit for bit.
pub(super) fn square(n: usize, factor: &[f64], out: &mut [f64]) {
    sized!(square_of(n, factor, out));
}

fn square_of<const N: usize>(n: usize, factor: &[f64], out: &mut [f64]) {
    let n = known::<N>(n);
    for (i, row) in out.chunks_exact_mut(n.max(1)).enumerate() {
        let terms = factor.chunks_exact(n.max(1)).map(|other| (other[i], other));
        kernel::combine::<N>(None, terms.filter(|&(x, _)| x != 0.0), row);
    }
    kernel::mirror(n, out);
}

/// The array of an update: rows [U V] and [0 W].
pub(super) struct Array<'a> {
    /// U, n×n.
    pub(super) factor: &'a mut [f64],
    /// V, n×m.
    pub(super) seen: &'a mut [f64],
    /// K̄ᵀ, m×n, zero at first.
    pub(super) gain: &'a mut [f64],
    /// W, m×m lower.
    pub(super) weights: &'a mut [f64],
}

impl Array<'_> {
    /// Turns V into zero. A lower triangular U stays one.
    pub(super) fn rotate(&mut self, n: usize, m: usize) {
        let lower = (0..n).all(|i| self.factor[i * n + i + 1..(i + 1) * n].iter().all(|&x| x == 0.0));
        for c in (0..m).rev() {
            for i in 0..n {
                let x = self.seen[i * m + c];
                if x == 0.0 {
                    continue;
                }
                let w = self.weights[c * m + c];
                let square = w * w + x * x;
                // The root of a square that neither overflows nor loses digits is that of `hypot`, in a third of the time.
                let norm = if (1e-280..1e280).contains(&square) {
                    square.sqrt()
                } else {
                    libm::hypot(w, x)
                };
                let (cosine, sine) = (w / norm, x / norm);
                let end = if lower { i + 1 } else { n };
                turn(
                    cosine,
                    sine,
                    &mut self.gain[c * n..c * n + end],
                    &mut self.factor[i * n..i * n + end],
                );
                turn(
                    cosine,
                    sine,
                    &mut self.weights[c * m..c * m + c],
                    &mut self.seen[i * m..i * m + c],
                );
                (self.weights[c * m + c], self.seen[i * m + c]) = (norm, 0.0);
            }
        }
    }
}

/// (a, b) ← (c a + s b, c b − s a).
#[inline(always)]
fn turn(cosine: f64, sine: f64, a: &mut [f64], b: &mut [f64]) {
    for (x, y) in a.iter_mut().zip(b.iter_mut()) {
        (*x, *y) = (cosine * *x + sine * *y, cosine * *y - sine * *x);
    }
}

/// The rows of the lower triangular W (m×m) solve Wᵀ y = r in place.
pub(super) fn solve_root(m: usize, weights: &[f64], r: &mut [f64]) {
    for i in (0..m).rev() {
        let tail = (i + 1..m).fold(r[i], |sum, k| sum - weights[k * m + i] * r[k]);
        r[i] = tail / weights[i * m + i];
    }
}

/// The rows of `b` (n×w) become those of L⁻ᵀ B; rows of a zero pivot become zero.
pub(super) fn solve_transposed(n: usize, w: usize, lower: &[f64], b: &mut [f64]) {
    for i in (0..n).rev() {
        let (start, after) = b.split_at_mut((i + 1) * w);
        let row = &mut start[i * w..];
        for (k, other) in after.chunks_exact(w.max(1)).enumerate() {
            kernel::add_scaled(row, -lower[(i + 1 + k) * n + i], other);
        }
        let pivot = lower[i * n + i];
        let inverse = if pivot == 0.0 { 0.0 } else { 1.0 / pivot };
        for x in row.iter_mut() {
            *x *= inverse;
        }
    }
}

/// The rows of `b` (n×w) become those of L⁻¹ B; rows of a zero pivot become zero.
pub(super) fn solve_forward(n: usize, w: usize, lower: &[f64], b: &mut [f64]) {
    for i in 0..n {
        let (before, rest) = b.split_at_mut(i * w);
        let row = &mut rest[..w];
        for (k, other) in before.chunks_exact(w.max(1)).enumerate() {
            kernel::add_scaled(row, -lower[i * n + k], other);
        }
        let pivot = lower[i * n + i];
        let inverse = if pivot == 0.0 { 0.0 } else { 1.0 / pivot };
        for x in row.iter_mut() {
            *x *= inverse;
        }
    }
}

/// In square-root form, U of a covariance.
pub(super) fn factor_of(form: Form, cov: &DMatrix<f64>) -> Result<Option<Vec<f64>>> {
    let n = cov.nrows();
    if form == Form::Joseph {
        return Ok(None);
    }
    let (mut work, mut out) = (vec![0.0; n * n], vec![0.0; n * n]);
    lower_root(n, cov.as_slice(), &mut work, &mut out, "covariance")?;
    Ok(Some(out))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn numbers(count: usize) -> Vec<f64> {
        (0..count).map(|i| ((i * 37 + 11) % 23) as f64 - 10.3).collect()
    }

    #[test]
    fn reflections_keep_the_product_and_pass_over_zeros() {
        for (n, rows) in [(1, 1), (3, 3), (4, 9), (6, 12)] {
            let mut a = numbers(rows * n);
            for (i, x) in a.iter_mut().enumerate() {
                if (i / n + i % n) % 3 == 0 {
                    *x = 0.0;
                }
            }
            let before = DMatrix::from_row_slice(rows, n, &a);
            Reflector::default().triangularise(n, &mut a);
            let after = DMatrix::from_row_slice(rows, n, &a);
            assert!((before.transpose() * before - after.transpose() * &after).amax() < 1e-11 * 1e3);
            for i in 0..rows {
                for j in 0..n {
                    assert!((i < n && j <= i) || after[(i, j)] == 0.0);
                }
            }
        }
    }

    #[test]
    fn roots_of_singular_and_indefinite_matrices() {
        let a = [4.0, 2.0, 2.0, 1.0];
        let (mut work, mut u) = ([0.0; 4], [0.0; 4]);
        lower_root(2, &a, &mut work, &mut u, "P").unwrap();
        let mut back = [0.0; 4];
        square(2, &u, &mut back);
        assert!(a.iter().zip(back).all(|(x, y)| (x - y).abs() < 1e-14));
        let bad = lower_root(2, &[1.0, 2.0, 2.0, 1.0], &mut work, &mut u, "P").unwrap_err();
        assert!(bad.to_string().starts_with("P is not positive definite"));
    }
}
