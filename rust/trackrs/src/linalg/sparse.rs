//! A matrix by its numbers that are not zero: the products of a filter with F and H.
//!
//! Sums go row by row and from the first column to the last, as those of [`super::kernel`] do.

use super::fixed::add_scaled;
use super::kernel::{accumulate, combine};

/// The numbers of a matrix that are not zero, row by row, for one that is used again and again.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sparse {
    /// Where each row ends among the entries.
    ends: Vec<usize>,
    /// Column and value; behind the last end they mean nothing.
    entries: Vec<(usize, f64)>,
    /// Columns up to the last that had a number so far: those behind it are only looked over.
    width: usize,
    /// The matrix, and the length of its rows.
    matrix: Vec<f64>,
    n: usize,
}

impl Sparse {
    /// Takes over a matrix of rows of length n.
    pub(crate) fn set(&mut self, n: usize, matrix: &[f64]) {
        // Most matrices are set again as they were. A NaN differs from itself, and the zeros of both signs are left out.
        if self.n == n && self.matrix == matrix {
            return;
        }
        self.n = n;
        self.matrix.clear();
        self.matrix.extend_from_slice(matrix);
        let rows = matrix.chunks_exact(n.max(1));
        let any = |numbers: &[f64]| numbers.iter().fold(0, |bits, x| bits | x.to_bits() << 1) != 0;
        while self.width < n && rows.clone().any(|row| any(&row[self.width..])) {
            self.width += 1;
        }
        self.ends.clear();
        // Every number is written, and the next one over it if it is zero: without a branch on values.
        self.entries.resize(matrix.len() + 1, (0, 0.0));
        let mut count = 0;
        for row in rows {
            for (k, &value) in row[..self.width.min(n)].iter().enumerate() {
                self.entries[count] = (k, value);
                count += usize::from(value != 0.0);
            }
            self.ends.push(count);
        }
    }

    /// Column and value of the numbers of every row.
    #[inline(always)]
    fn rows(&self) -> impl Iterator<Item = &[(usize, f64)]> {
        let mut from = 0;
        self.ends.iter().map(move |&to| {
            let row = &self.entries[from..to];
            from = to;
            row
        })
    }

    /// `out` = A B, B with rows of length n; N is n where that is a constant, else 0.
    #[inline(always)]
    pub(crate) fn multiply<const N: usize>(&self, n: usize, b: &[f64], out: &mut [f64]) {
        for (row, entries) in out.chunks_exact_mut(n.max(1)).zip(self.rows()) {
            let terms = entries.iter().map(|&(k, factor)| (factor, &b[k * n..][..n]));
            combine::<N>(None, terms, row);
        }
    }

    /// `out` = (A B)ᵀ of two n×n matrices.
    #[inline(always)]
    pub(crate) fn multiply_transposed<const N: usize>(&self, n: usize, b: &[f64], work: &mut [f64], out: &mut [f64]) {
        let (work, out) = (&mut work[..n], &mut out[..n * n]);
        for (i, entries) in (0..n).zip(self.rows()) {
            let terms = entries.iter().map(|&(k, factor)| (factor, &b[k * n..][..n]));
            combine::<N>(None, terms, work);
            for j in 0..n {
                out[j * n + i] = work[j];
            }
        }
    }

    /// `out` = C + A B, B and C with rows of length n.
    #[inline(always)]
    pub(crate) fn add_product<const N: usize>(&self, n: usize, c: &[f64], b: &[f64], out: &mut [f64]) {
        let rows = out.chunks_exact_mut(n.max(1)).zip(c.chunks_exact(n.max(1)));
        for ((row, start), entries) in rows.zip(self.rows()) {
            let terms = entries.iter().map(|&(k, factor)| (factor, &b[k * n..][..n]));
            combine::<N>(Some(start), terms, row);
        }
    }

    /// Row `index` of A times a vector.
    #[inline(always)]
    pub(crate) fn row_dot(&self, index: usize, vector: &[f64]) -> f64 {
        let from = if index == 0 { 0 } else { self.ends[index - 1] };
        let entries = &self.entries[from..self.ends[index]];
        entries.iter().fold(0.0, |sum, &(k, value)| sum + value * vector[k])
    }
}

/// A matrix with ones on its diagonal and zeros below it, as the transitions of kinematic motions are: by its numbers above.
#[derive(Debug, Clone, Default)]
pub(crate) struct UnitUpper {
    /// Row, column and value.
    above: Vec<(usize, usize, f64)>,
}

impl UnitUpper {
    /// Of an n×n matrix, if it is such a one, in the memory of another.
    pub(crate) fn renew(kept: &mut Option<Self>, n: usize, matrix: &[f64]) {
        let mut upper = kept.take().unwrap_or_default();
        upper.above.clear();
        for (i, row) in matrix.chunks_exact(n.max(1)).enumerate() {
            for (k, &value) in row.iter().enumerate() {
                if k > i && value != 0.0 {
                    upper.above.push((i, k, value));
                } else if k <= i && value != f64::from(u8::from(k == i)) {
                    return;
                }
            }
        }
        *kept = Some(upper);
    }

    /// The same in new memory.
    #[cfg(test)]
    pub(crate) fn of(n: usize, matrix: &[f64]) -> Option<Self> {
        let mut upper = None;
        Self::renew(&mut upper, n, matrix);
        upper
    }

    /// Puts A times a vector at the end of `out`.
    #[inline(always)]
    pub(crate) fn extend_product(&self, vector: &[f64], out: &mut Vec<f64>) {
        let from = out.len();
        out.extend_from_slice(vector);
        let row = &mut out[from..];
        for &(i, k, factor) in &self.above {
            row[i] += factor * vector[k];
        }
    }

    /// `out` = A B Aᵀ + C of n×n matrices, B and C symmetric: the rows of A B first, from the top down, then the columns,
    /// from the left to the right, all where they stand.
    #[inline(always)]
    pub(crate) fn congruence<const N: usize>(&self, n: usize, b: &[f64], c: &[f64], out: &mut [f64]) {
        let (c, out) = (&c[..n * n], &mut out[..n * n]);
        out.copy_from_slice(&b[..n * n]);
        for &(i, k, factor) in &self.above {
            let (before, from) = out.split_at_mut(k * n);
            accumulate::<N>(&mut before[i * n..][..n], std::iter::once((factor, &from[..n])));
        }
        for &(j, k, factor) in &self.above {
            assert!(j < n && k < n, "a place in the matrix");
            for row in out.chunks_exact_mut(n) {
                row[j] += factor * row[k];
            }
        }
        for i in 0..n {
            for j in 0..=i {
                let sum = out[i * n + j] + c[i * n + j];
                (out[i * n + j], out[j * n + i]) = (sum, sum);
            }
        }
    }

    /// B becomes A B Aᵀ + C, as in [`Self::congruence`].
    #[inline(always)]
    pub(crate) fn congruence_in_place<const N: usize>(&self, b: &mut [[f64; N]; N], c: &[[f64; N]; N]) {
        for &(i, k, factor) in &self.above {
            let from = b[k];
            add_scaled(&mut b[i], factor, &from);
        }
        for &(j, k, factor) in &self.above {
            assert!(j < N && k < N, "a place in the matrix");
            for row in b.iter_mut() {
                row[j] += factor * row[k];
            }
        }
        for i in 0..N {
            for j in 0..N {
                if j <= i {
                    let sum = b[i][j] + c[i][j];
                    (b[i][j], b[j][i]) = (sum, sum);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::kernel::{multiply, transpose};

    #[test]
    fn products_are_those_of_the_whole_matrix() {
        let n = 4;
        let a: Vec<f64> = (0..16_u32)
            .map(|i| if i % 3 == 0 { 0.0 } else { f64::from(i) - 7.5 })
            .collect();
        let b: Vec<f64> = (0..16_u32).map(|i| f64::from(i * i % 13) - 5.3).collect();
        let (mut expected, mut turned) = (vec![0.0; 16], vec![0.0; 16]);
        multiply::<0>(n, n, &a, &b, &mut expected);
        transpose(n, &expected, &mut turned);
        let mut sparse = Sparse::default();
        sparse.set(n, &[1.0; 16]);
        sparse.set(n, &a);
        let (mut out, mut work) = (vec![0.0; 16], vec![0.0; 4]);
        sparse.multiply::<4>(n, &b, &mut out);
        assert_eq!(out, expected);
        sparse.multiply_transposed::<0>(n, &b, &mut work, &mut out);
        assert_eq!(out, turned);
        sparse.add_product::<4>(n, &[0.0; 16], &b, &mut out);
        assert_eq!(out, expected);
        assert_eq!(
            sparse.row_dot(2, &[1.0, 2.0, 3.0, 4.0]),
            a[8] + 2.0 * a[9] + 3.0 * a[10] + 4.0 * a[11]
        );
    }
    #[test]
    fn a_congruence_in_place_is_that_of_two_products() {
        let n = 6;
        let mut a = [0.0; 36];
        for i in 0..n {
            a[i * n + i] = 1.0;
            (i + 2..n)
                .step_by(2)
                .for_each(|k| a[i * n + k] = 0.3 * k as f64 - 0.8 * i as f64);
        }
        let symmetric = |scale: f64| -> Vec<f64> {
            (0..36)
                .map(|x| scale * (((x / n) * (x % n)) as f64 + 1.3 * ((x / n) + (x % n)) as f64))
                .collect()
        };
        let (b, c) = (symmetric(1.0), symmetric(-2.5));
        let (mut product, mut turned, mut expected) = (vec![0.0; 36], vec![0.0; 36], vec![0.0; 36]);
        multiply::<0>(n, n, &a, &b, &mut product);
        transpose(n, &product, &mut turned);
        multiply::<0>(n, n, &a, &turned, &mut expected);
        let upper = UnitUpper::of(n, &a).unwrap();
        let (mut constant, mut any) = (vec![0.0; 36], vec![0.0; 36]);
        upper.congruence::<6>(n, &b, &c, &mut constant);
        upper.congruence::<0>(n, &b, &c, &mut any);
        assert_eq!(constant, any);
        for (i, found) in any.iter().enumerate() {
            assert!((found - expected[i] - c[i]).abs() < 1e-12 * (1.0 + expected[i].abs()));
        }
        a[7] = 0.9;
        assert!(UnitUpper::of(n, &a).is_none());
        (a[7], a[6]) = (1.0, 0.1);
        assert!(UnitUpper::of(n, &a).is_none());
    }
}
