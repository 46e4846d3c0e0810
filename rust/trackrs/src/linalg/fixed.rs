//! The operations of [`super::kernel`] and [`super::sparse`] on arrays of constant size: the same products in the same order,
//! so that the results are the same bits, with loops that unroll and without memory.
//!
//! Loops run to the constant size with the condition inside: so written they unroll, and indices need no checked arithmetic.

// Entries of small matrices are named by their indices, as the equations have them.
#![allow(clippy::needless_range_loop)]

use super::kernel;

/// `row` += `factor` × `other`.
#[inline(always)]
pub(crate) fn add_scaled<const N: usize>(row: &mut [f64; N], factor: f64, other: &[f64; N]) {
    kernel::add_scaled(row, factor, other);
}

/// An R×N matrix by its numbers that are not zero, row by row; as [`super::sparse::Sparse`].
#[derive(Debug, Clone)]
pub(crate) struct Lines<const R: usize, const N: usize> {
    counts: [usize; R],
    /// Column and value; behind the count they mean nothing.
    entries: [[(usize, f64); N]; R],
    /// Columns up to the last that had a number so far: those behind it are only looked over.
    width: usize,
}

impl<const R: usize, const N: usize> Lines<R, N> {
    /// Of zeros.
    pub(crate) fn new() -> Self {
        Self {
            counts: [0; R],
            entries: [[(0, 0.0); N]; R],
            width: 0,
        }
    }

    /// Takes over a matrix.
    #[inline]
    pub(crate) fn set(&mut self, matrix: &[[f64; N]; R]) {
        let any = |numbers: &[f64]| numbers.iter().fold(0, |bits, x| bits | x.to_bits() << 1) != 0;
        while self.width < N && matrix.iter().any(|row| any(&row[self.width..])) {
            self.width += 1;
        }
        for ((row, entries), to) in matrix.iter().zip(&mut self.entries).zip(&mut self.counts) {
            // Every number is written, and the next one over it if it is zero: without a branch on values.
            let mut count = 0_usize;
            for (k, &value) in row[..self.width.min(N)].iter().enumerate() {
                entries[count] = (k, value);
                count = count.wrapping_add(usize::from(value != 0.0));
            }
            *to = count;
        }
    }

    #[inline(always)]
    fn row(&self, index: usize) -> &[(usize, f64)] {
        &self.entries[index][..self.counts[index].min(N)]
    }

    /// Row `index` of A times a vector.
    #[inline(always)]
    pub(crate) fn row_dot(&self, index: usize, vector: &[f64; N]) -> f64 {
        self.row(index)
            .iter()
            .fold(0.0, |sum, &(k, value)| sum + value * vector[k])
    }

    /// A B.
    #[inline(always)]
    pub(crate) fn times<const C: usize>(&self, b: &[[f64; C]; N]) -> [[f64; C]; R] {
        let mut out = [[0.0; C]; R];
        for (a, out) in out.iter_mut().enumerate() {
            let mut sum = [0.0; C];
            for &(k, factor) in self.row(a) {
                add_scaled(&mut sum, factor, &b[k]);
            }
            *out = sum;
        }
        out
    }

    /// C + A B.
    #[inline(always)]
    pub(crate) fn times_plus<const C: usize>(&self, b: &[[f64; C]; N], c: &[[f64; C]; R]) -> [[f64; C]; R] {
        let mut out = *c;
        for (a, out) in out.iter_mut().enumerate() {
            let mut sum = *out;
            for &(k, factor) in self.row(a) {
                add_scaled(&mut sum, factor, &b[k]);
            }
            *out = sum;
        }
        out
    }
}

/// Whether two matrices are the same to the last bit.
#[inline(always)]
pub(crate) fn same_bits<const R: usize, const C: usize>(a: &[[f64; C]; R], b: &[[f64; C]; R]) -> bool {
    let differ = |(x, y): (&f64, &f64)| x.to_bits() ^ y.to_bits();
    // Row by row, and each without a branch.
    a.iter()
        .zip(b)
        .all(|(x, y)| x.iter().zip(y).map(differ).fold(0, |bits, x| bits | x) == 0)
}

/// A B.
#[inline(always)]
pub(crate) fn multiply<const R: usize, const K: usize, const C: usize>(
    a: &[[f64; K]; R],
    b: &[[f64; C]; K],
) -> [[f64; C]; R] {
    let mut out = [[0.0; C]; R];
    for (row, coefficients) in out.iter_mut().zip(a) {
        let mut sum = [0.0; C];
        for (&factor, other) in coefficients.iter().zip(b) {
            add_scaled(&mut sum, factor, other);
        }
        *row = sum;
    }
    out
}

/// A B of an A of many zeros, whose rows of B are left out.
#[inline(always)]
pub(crate) fn multiply_sparse<const R: usize, const K: usize, const C: usize>(
    a: &[[f64; K]; R],
    b: &[[f64; C]; K],
) -> [[f64; C]; R] {
    let mut out = [[0.0; C]; R];
    for (row, coefficients) in out.iter_mut().zip(a) {
        let mut sum = [0.0; C];
        for (&factor, other) in coefficients.iter().zip(b) {
            if factor != 0.0 {
                add_scaled(&mut sum, factor, other);
            }
        }
        *row = sum;
    }
    out
}

/// Aᵀ.
#[inline(always)]
pub(crate) fn transpose<const N: usize>(a: &[[f64; N]; N]) -> [[f64; N]; N] {
    let mut out = [[0.0; N]; N];
    for (i, row) in a.iter().enumerate() {
        for (to, &value) in out.iter_mut().zip(row) {
            to[i] = value;
        }
    }
    out
}

/// Copies the lower half of A to the upper one.
#[inline(always)]
pub(crate) fn mirror<const N: usize>(a: &mut [[f64; N]; N]) {
    for i in 0..N {
        for j in 0..N {
            if j < i {
                a[j][i] = a[i][j];
            }
        }
    }
}

/// Adds the lower half of A B to that of `out`.
#[inline(always)]
pub(crate) fn add_product_lower<const N: usize>(a: &[[f64; N]; N], b: &[[f64; N]; N], out: &mut [[f64; N]; N]) {
    for (row, coefficients) in out.iter_mut().zip(a) {
        let mut sum = *row;
        for (&factor, other) in coefficients.iter().zip(b) {
            // The upper half is made too, whole rows being faster, and means nothing.
            add_scaled(&mut sum, factor, other);
        }
        *row = sum;
    }
}

/// Replaces A by (A + Aᵀ)/2; see [`kernel::symmetrise`].
#[inline(always)]
pub(crate) fn symmetrise<const N: usize>(a: &mut [[f64; N]; N]) {
    for i in 0..N {
        for j in 0..N {
            if j < i {
                let mean = 0.5 * (a[i][j] + a[j][i]);
                (a[i][j], a[j][i]) = (mean, mean);
            }
        }
    }
}

/// |C| of a covariance, unless [`kernel::little_left`]; 0 where something is exactly known.
#[inline(always)]
pub(crate) fn determinant_unless_little_left<const N: usize>(part: f64, cov: &[[f64; N]; N]) -> Option<f64> {
    let mut a = *cov;
    let mut determinant = 1.0;
    for j in 0..N {
        let pivot = a[j][j];
        determinant *= pivot;
        if pivot <= part * cov[j][j] {
            if cov[j].iter().all(|&x| x == 0.0) {
                continue;
            }
            return None;
        }
        let inverse = 1.0 / pivot;
        for i in 0..N {
            if i > j {
                let factor = a[i][j] * inverse;
                for k in 0..N {
                    if k > j && k <= i {
                        a[i][k] -= factor * a[k][j];
                    }
                }
            }
        }
    }
    Some(determinant)
}

/// Of the product of its variances so much in every leading minor puts a covariance far from [`kernel::little_anywhere`]: of its
/// matrix of correlations R all eigenvalues but the least have a product below (n/(n − 1))ⁿ⁻¹ < e, so that the least is |R|/e or
/// more, and rounding is a hundredth of this.
const FAR_FROM_SINGULAR: f64 = 1e-11;

/// Whether a covariance of four components is surely not [`kernel::little_anywhere`]: by its leading minors, without a division.
#[inline]
pub(crate) fn far_from_singular(a: &[f64; 16]) -> bool {
    let minor = |i: usize, j: usize, k: usize, l: usize| a[4 * i + k] * a[4 * j + l] - a[4 * i + l] * a[4 * j + k];
    let (upper, lower) = (|k, l| minor(0, 1, k, l), |k, l| minor(2, 3, k, l));
    let two = upper(0, 1);
    let three = a[10] * two - a[9] * upper(0, 2) + a[8] * upper(1, 2);
    // Laplace: pairs of columns of the first two rows and of the others.
    let four = two * lower(2, 3) - upper(0, 2) * lower(1, 3) + upper(0, 3) * lower(1, 2) + upper(1, 2) * lower(0, 3)
        - upper(1, 3) * lower(0, 2)
        + upper(2, 3) * lower(0, 1);
    let (of_two, of_three) = (a[0] * a[5], a[0] * a[5] * a[10]);
    let least = FAR_FROM_SINGULAR * of_three * a[15];
    // What has overflowed, lost digits by its smallness or is no number is not sure.
    a[0] > 0.0
        && two > FAR_FROM_SINGULAR * of_two
        && three > FAR_FROM_SINGULAR * of_three
        && four > least
        && least >= f64::MIN_POSITIVE
}

/// L of A = L Lᵀ in the lower half, with one over every number of its diagonal.
pub(crate) struct Factor<const M: usize> {
    lower: [[f64; M]; M],
    inverse: [f64; M],
}

impl<const M: usize> Factor<M> {
    /// Of a symmetric matrix; nothing where a pivot is not positive and finite.
    #[inline(always)]
    pub(crate) fn new(matrix: &[[f64; M]; M]) -> Option<Self> {
        let mut a = *matrix;
        let mut inverse = [0.0; M];
        for i in 0..M {
            for j in 0..M {
                if j > i {
                    continue;
                }
                let mut sum = a[i][j];
                for k in 0..M {
                    if k < j {
                        sum -= a[i][k] * a[j][k];
                    }
                }
                if j < i {
                    a[i][j] = sum / a[j][j];
                } else if sum > 0.0 && sum.is_finite() {
                    a[j][j] = sum.sqrt();
                    inverse[j] = 1.0 / a[j][j];
                } else {
                    return None;
                }
            }
        }
        Some(Self { lower: a, inverse })
    }

    /// det A.
    #[inline(always)]
    pub(crate) fn determinant(&self) -> f64 {
        let mut product = 1.0;
        for i in 0..M {
            product *= self.lower[i][i] * self.lower[i][i];
        }
        product
    }

    /// The rows of B become those of L⁻¹ B.
    #[inline(always)]
    pub(crate) fn solve_lower<const C: usize>(&self, b: &mut [[f64; C]; M]) {
        for i in 0..M {
            let mut row = b[i];
            for k in 0..M {
                if k < i {
                    add_scaled(&mut row, -self.lower[i][k], &b[k]);
                }
            }
            for x in &mut row {
                *x *= self.inverse[i];
            }
            b[i] = row;
        }
    }

    /// The rows of B become those of L⁻ᵀ B.
    #[inline(always)]
    pub(crate) fn solve_upper<const C: usize>(&self, b: &mut [[f64; C]; M]) {
        for i in (0..M).rev() {
            let mut row = b[i];
            for k in 0..M {
                if k > i {
                    add_scaled(&mut row, -self.lower[k][i], &b[k]);
                }
            }
            for x in &mut row {
                *x *= self.inverse[i];
            }
            b[i] = row;
        }
    }

    /// A number of the diagonal of L.
    #[inline(always)]
    pub(crate) fn diagonal(&self, index: usize) -> f64 {
        self.lower[index][index]
    }

    /// ln det A.
    #[inline(always)]
    pub(crate) fn log_determinant(&self) -> f64 {
        kernel::log_determinant(M, self.lower.as_flattened())
    }
}

#[cfg(test)]
mod tests {
    use std::array;

    use super::*;

    /// Numbers in (−1, 1).
    fn numbers(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }
    }

    #[test]
    fn what_is_far_from_singular_is_not_nearly_so() {
        let mut next = numbers(7);
        let (mut far, mut near, mut indefinite) = (0, 0, 0);
        for round in 0..20_000 {
            // B Λ Bᵀ: eigenvalues down to 1e-18 of the largest, some negative, in units that differ by up to 1e12.
            let b: [f64; 16] = array::from_fn(|_| next());
            let spread = f64::from(round % 19);
            let lambda: [f64; 4] = array::from_fn(|k| {
                let size = libm::pow(10.0, -spread * next().abs());
                if round % 5 == 0 && k % 2 == 1 { -size } else { size }
            });
            let unit: [f64; 4] = array::from_fn(|_| libm::pow(10.0, 6.0 * next()));
            let mut a = [0.0; 16];
            for i in 0..4 {
                for j in 0..=i {
                    let sum: f64 = (0..4).map(|k| b[4 * i + k] * lambda[k] * b[4 * j + k]).sum();
                    a[4 * i + j] = sum * unit[i] * unit[j];
                    a[4 * j + i] = a[4 * i + j];
                }
            }
            let mut work = [0.0; 16];
            let little = kernel::little_anywhere::<4>(4, kernel::NEARLY_SINGULAR, &a, &mut work);
            let sure = far_from_singular(&a);
            assert!(!(sure && little), "{a:?}");
            far += usize::from(sure);
            near += usize::from(little);
            indefinite += usize::from(little && round % 5 == 0);
        }
        assert!(
            far > 5_000 && near > 3_000 && indefinite > 3_000,
            "{far} {near} {indefinite}"
        );
        for x in [0.0, f64::NAN, f64::INFINITY, 1e-80, 1e80] {
            let one = array::from_fn(|k| if k % 5 == 0 { x } else { 0.0 });
            // In doubt it is not sure.
            assert!(!far_from_singular(&one), "{x}");
        }
    }
}
