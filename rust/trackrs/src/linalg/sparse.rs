//! A matrix by its numbers that are not zero: the products of a filter with F and H.
//!
//! Sums go row by row and from the first column to the last, as those of [`super::kernel`] do.

use super::kernel::combine;

/// The numbers of a matrix that are not zero, row by row, for one that is used again and again.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sparse {
    /// Where each row ends among the entries.
    ends: Vec<usize>,
    /// Column and value; behind the last end they mean nothing.
    entries: Vec<(usize, f64)>,
}

impl Sparse {
    /// Takes over a matrix of rows of length n.
    pub(crate) fn set(&mut self, n: usize, matrix: &[f64]) {
        self.ends.clear();
        // Every number is written, and the next one over it if it is zero: without a branch on values.
        self.entries.resize(matrix.len() + 1, (0, 0.0));
        let mut count = 0;
        for row in matrix.chunks_exact(n.max(1)) {
            for (k, &value) in row.iter().enumerate() {
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
}
