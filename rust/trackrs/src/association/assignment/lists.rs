//! The allowed pairs of [`sparse`](super::sparse), row after row.

use super::sparse::Candidate;

/// A column that a row may take, and its cost.
#[derive(Clone, Copy)]
pub(super) struct Entry {
    pub(super) column: usize,
    pub(super) cost: f64,
}

/// The pairs of every row, one after the other.
pub(super) struct Lists {
    starts: Vec<usize>,
    entries: Vec<Entry>,
    pub(super) columns: usize,
}

impl Lists {
    /// Sorted by rows, by counting; rows and columns exchanged where `turned`.
    pub(super) fn new(candidates: &[Candidate], rows: usize, columns: usize, turned: bool) -> Self {
        let sides = |pair: &Candidate| {
            if turned {
                (pair.column, pair.row)
            } else {
                (pair.row, pair.column)
            }
        };
        let (rows, columns) = if turned { (columns, rows) } else { (rows, columns) };
        let mut starts = vec![0; rows + 1];
        for pair in candidates {
            starts[sides(pair).0 + 1] += 1;
        }
        for row in 0..rows {
            starts[row + 1] += starts[row];
        }
        let mut next = starts.clone();
        let mut entries = vec![Entry { column: 0, cost: 0.0 }; candidates.len()];
        for pair in candidates {
            let (row, column) = sides(pair);
            entries[next[row]] = Entry {
                column,
                cost: pair.cost,
            };
            next[row] += 1;
        }
        Self {
            starts,
            entries,
            columns,
        }
    }

    /// How many rows there are.
    pub(super) fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    #[inline]
    pub(super) fn row(&self, row: usize) -> &[Entry] {
        &self.entries[self.starts[row]..self.starts[row + 1]]
    }
}
