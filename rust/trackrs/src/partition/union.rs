//! Disjoint sets of numbers that grow together.

/// Which set each number belongs to. Every set is named by its smallest member.
pub(crate) struct Union {
    parents: Vec<usize>,
}

impl Union {
    /// Every number below `size` alone.
    pub(crate) fn new(size: usize) -> Self {
        Self {
            parents: (0..size).collect(),
        }
    }

    /// The smallest member of the set of `i`.
    pub(crate) fn find(&mut self, mut i: usize) -> usize {
        while self.parents[i] != i {
            self.parents[i] = self.parents[self.parents[i]];
            i = self.parents[i];
        }
        i
    }

    /// Makes one set of those of `i` and `j`.
    pub(crate) fn join(&mut self, i: usize, j: usize) {
        let (i, j) = (self.find(i), self.find(j));
        self.parents[i.max(j)] = i.min(j);
    }

    /// The names of the sets of all numbers.
    pub(crate) fn names(&mut self) -> Vec<usize> {
        (0..self.parents.len()).map(|i| self.find(i)).collect()
    }
}
