//! Matrices of one shape, one after the other in one piece of memory.

use nalgebra::{DMatrix, DVector};

use super::same_bits;

/// Matrices of one shape, each row by row; a vector is a matrix of one row.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stack {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl Stack {
    /// No matrices yet, of this shape.
    pub fn new(rows: usize, columns: usize) -> Self {
        Self {
            rows,
            columns,
            values: Vec::new(),
        }
    }

    /// No square matrices yet.
    pub fn square(n: usize) -> Self {
        Self::new(n, n)
    }

    /// No vectors yet.
    pub fn vectors(n: usize) -> Self {
        Self::new(1, n)
    }

    /// Numbers of one matrix.
    fn size(&self) -> usize {
        self.rows * self.columns
    }

    /// How many matrices there are.
    pub fn len(&self) -> usize {
        self.values.len().checked_div(self.size()).unwrap_or(0)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Rows and columns of each.
    pub fn shape(&self) -> [usize; 2] {
        [self.rows, self.columns]
    }

    /// Takes memory for so many more.
    pub fn reserve(&mut self, count: usize) {
        self.values.reserve(count * self.size());
    }

    /// Adds one, given row by row.
    #[inline]
    pub fn push(&mut self, matrix: &[f64]) {
        debug_assert_eq!(matrix.len(), self.size());
        self.values.extend_from_slice(matrix);
    }

    /// Adds several, given one after the other, each row by row.
    pub fn append(&mut self, matrices: &[f64]) {
        debug_assert_eq!(matrices.len() % self.size().max(1), 0);
        self.values.extend_from_slice(matrices);
    }

    /// Adds one.
    pub fn push_matrix(&mut self, matrix: &DMatrix<f64>) {
        debug_assert_eq!(matrix.shape(), (self.rows, self.columns));
        for i in 0..self.rows {
            self.values.extend(matrix.row(i).iter());
        }
    }

    /// Adds one whose numbers are all `value`, `count` times.
    pub fn fill(&mut self, value: f64, count: usize) {
        self.values.resize(self.values.len() + count * self.size(), value);
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.values.clear();
    }

    /// Turns the order round.
    pub fn reverse(&mut self) {
        let (size, count) = (self.size(), self.len());
        for i in 0..count / 2 {
            let (head, tail) = self.values.split_at_mut((count - 1 - i) * size);
            head[i * size..(i + 1) * size].swap_with_slice(&mut tail[..size]);
        }
    }

    /// Adds the matrices `from..to` of another stack of this shape.
    pub fn extend(&mut self, other: &Self, from: usize, to: usize) {
        self.values
            .extend_from_slice(&other.values[from * self.size()..to * self.size()]);
    }

    /// The numbers of all from matrix `index` on.
    pub(crate) fn after(&self, index: usize) -> &[f64] {
        &self.values[index * self.size()..]
    }

    /// Matrix `index` row by row; `index` as in a slice.
    pub fn at(&self, index: usize) -> &[f64] {
        &self.values[index * self.size()..(index + 1) * self.size()]
    }

    /// Matrix `index`.
    pub fn matrix(&self, index: usize) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.rows, self.columns, self.at(index))
    }

    /// Vector `index`.
    pub fn vector(&self, index: usize) -> DVector<f64> {
        DVector::from_column_slice(self.at(index))
    }

    /// All, each row by row.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &[f64]> + ExactSizeIterator {
        self.values.chunks_exact(self.size().max(1))
    }

    /// All numbers.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// All numbers, given away.
    pub fn into_values(self) -> Vec<f64> {
        self.values
    }
}

/// After so many different matrices without a repetition the others are thought to be different too.
const CHANGING: usize = 8;

/// Matrices of one shape, of which many are the one before: such a one is kept once.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Repeats {
    /// No two neighbours are the same bits.
    distinct: Stack,
    /// Which of them each is.
    which: Vec<usize>,
}

impl Repeats {
    /// No square matrices yet.
    pub fn square(n: usize) -> Self {
        Self {
            distinct: Stack::square(n),
            which: Vec::new(),
        }
    }

    /// How many matrices there are.
    pub fn len(&self) -> usize {
        self.which.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.which.is_empty()
    }

    /// Those that are kept, in their order.
    pub fn distinct(&self) -> &Stack {
        &self.distinct
    }

    /// Takes memory for so many more.
    pub fn reserve(&mut self, count: usize) {
        self.which.reserve(count);
    }

    /// Adds one, given row by row.
    #[inline]
    pub fn push(&mut self, matrix: &[f64]) {
        let count = self.distinct.len();
        if count > 0 && same_bits(self.distinct.at(count - 1), matrix) {
            self.which.push(count - 1);
        } else {
            if count == CHANGING && self.which.len() == CHANGING {
                self.distinct.reserve(self.which.capacity() - CHANGING);
            }
            self.distinct.push(matrix);
            self.which.push(count);
        }
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.distinct.clear();
        self.which.clear();
    }

    /// Matrix `index` row by row; `index` as in a slice.
    pub fn at(&self, index: usize) -> &[f64] {
        self.distinct.at(self.which[index])
    }

    /// All, each for itself; where none repeats, in the memory they were in.
    pub fn into_stack(self) -> Stack {
        if self.distinct.len() == self.len() {
            return self.distinct;
        }
        let [rows, columns] = self.distinct.shape();
        let mut all = Stack::new(rows, columns);
        all.reserve(self.len());
        self.iter().for_each(|matrix| all.push(matrix));
        all
    }

    /// All, each row by row.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.which.iter().map(|&index| self.distinct.at(index))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_come_back_in_either_order() {
        let list: Vec<_> = (0..3)
            .map(|k| DMatrix::from_fn(2, 3, |i, j| (10 * k + 3 * i + j) as f64))
            .collect();
        let mut stack = Stack::new(2, 3);
        for matrix in &list {
            stack.push_matrix(matrix);
        }
        assert_eq!((stack.len(), stack.matrix(1)), (3, list[1].clone()));
        assert_eq!(stack.at(1), &[10.0, 11.0, 12.0, 13.0, 14.0, 15.0]);
        stack.reverse();
        assert_eq!((stack.matrix(0), stack.matrix(1)), (list[2].clone(), list[1].clone()));
        assert_eq!(Stack::default().len(), 0);
    }

    #[test]
    fn what_repeats_is_kept_once() {
        let list = [1.0, 1.0, 2.0, 2.0, 2.0, 1.0, -0.0, 0.0];
        let mut repeats = Repeats::square(1);
        for value in list {
            repeats.push(&[value]);
        }
        assert_eq!(repeats.distinct().values(), &[1.0, 2.0, 1.0, -0.0, 0.0]);
        assert_eq!(repeats.iter().flatten().copied().collect::<Vec<_>>(), list);
        assert_eq!((repeats.len(), repeats.at(4)), (list.len(), &[2.0][..]));
        assert!(same_bits(repeats.into_stack().values(), &list));
    }

    #[test]
    fn what_does_not_repeat_is_handed_over() {
        let mut repeats = Repeats::square(1);
        repeats.reserve(100);
        (0..100).for_each(|k| repeats.push(&[f64::from(k)]));
        let memory = repeats.distinct().values().as_ptr();
        let all = repeats.into_stack();
        assert_eq!((all.len(), all.values().as_ptr()), (100, memory));
    }
}
