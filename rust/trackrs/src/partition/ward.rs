//! Ward's merges: always the two clusters whose union adds least to the sum of squares.
//!
//! | symbol | name here             | meaning                                                                     |
//! |--------|-----------------------|-----------------------------------------------------------------------------|
//! | c, n_A | `centres`, `sizes`    | centre and size of a cluster                                                |
//! | h²     | `height_squared`      | 2 n_A n_B / (n_A + n_B) |c_A − c_B|²                                        |
//!
//! Chains of nearest neighbours: from a cluster to the one of least h, on to the one of least h of that, until two are each
//! other's, which are joined. The order of the merges does not matter to the tree, and centres are all that is needed: O(n)
//! memory.
//!
//! Nearest neighbours by comparison with all: O(n²) time. Among many clusters by a k-d tree over the centres of the moment, from
//! which those joined since are left out; the unions since, √n times a constant, are compared one by one, and then
//! there is a new k-d tree. A node is skipped if h² ≥ 2 n_A s / (n_A + s) d² says so, with the least size s in it. The
//! clusters compared and their order in ties are as without it, and so are all merges, bit for bit.
//!
//! Reference: J. Ward, *Hierarchical grouping to optimize an objective function*, 1963; F. Murtagh, *A survey of recent advances in
//! hierarchical clustering algorithms*, 1983 (chains).

use super::index::Index;
use super::points::{Points, squared};
use super::tree::Merge;
use crate::error::Result;
use crate::interrupt::ahead;

/// Up to so many clusters comparison with all is faster.
const FEW: usize = 1024;
/// A k-d tree serves for this times √n merges.
const PATIENCE: usize = 6;
/// Bounds are kept off rounding errors by this factor.
const SLACK: f64 = 1.0 - 1e-12;

/// Clusters that are not joined yet: their centres, sizes and first points.
struct Clusters {
    centres: Vec<f64>,
    sizes: Vec<f64>,
    firsts: Vec<usize>,
    dims: usize,
}

/// The nearest other cluster so far: of equals the one before in the chain, then the first.
struct Nearest {
    place: usize,
    height_squared: f64,
    before: Option<usize>,
}

impl Nearest {
    fn offer(&mut self, place: usize, height_squared: f64) {
        let tie = height_squared == self.height_squared && place < self.place && Some(self.place) != self.before;
        if height_squared < self.height_squared || tie {
            (self.place, self.height_squared) = (place, height_squared);
        }
    }
}

/// A k-d tree over clusters, and what became of them: `places` of those in the tree, or `GONE`; for every place its number
/// in the tree, or `GONE` for a union since, of which `young` has the places.
struct Snapshot<'a> {
    index: Index<'a>,
    /// Of every node the least size of its time.
    least: Vec<f64>,
    places: Vec<usize>,
    numbers: Vec<usize>,
    young: Vec<usize>,
}

const GONE: usize = usize::MAX;

impl Clusters {
    fn len(&self) -> usize {
        self.sizes.len()
    }

    fn centre(&self, a: usize) -> &[f64] {
        &self.centres[a * self.dims..(a + 1) * self.dims]
    }

    fn height_squared(&self, a: usize, b: usize) -> f64 {
        let (m, n) = (self.sizes[a], self.sizes[b]);
        2.0 * m * n / (m + n) * squared(self.centre(a), self.centre(b))
    }

    fn nearest(&self, a: usize, before: Option<usize>, snapshot: Option<&Snapshot<'_>>) -> Nearest {
        let mut best = Nearest {
            place: before.unwrap_or(GONE),
            height_squared: before.map_or(f64::INFINITY, |b| self.height_squared(a, b)),
            before,
        };
        let Some(snapshot) = snapshot else {
            ahead(self.len());
            for b in (0..self.len()).filter(|&b| b != a) {
                best.offer(b, self.height_squared(a, b));
            }
            return best;
        };
        for &b in snapshot.young.iter().filter(|&&b| b != a) {
            best.offer(b, self.height_squared(a, b));
        }
        let size = self.sizes[a];
        let query = self.centre(a);
        snapshot.index.descend(query, |node, reach| {
            let least = snapshot.least[node];
            let factor = SLACK * 2.0 * size * least / (size + least);
            if factor * reach.nearest > best.height_squared {
                return false;
            }
            if snapshot.index.is_leaf(node) {
                for (at, d2) in snapshot.index.members(node, query) {
                    let b = snapshot.places[snapshot.index.order[at]];
                    if b != GONE && b != a && factor * d2 <= best.height_squared {
                        best.offer(b, self.height_squared(a, b));
                    }
                }
            }
            true
        });
        best
    }

    /// Puts the union of two clusters in the place of the lower; the last takes that of the other.
    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (a.min(b), a.max(b));
        let (m, n) = (self.sizes[a], self.sizes[b]);
        for axis in 0..self.dims {
            let (x, y) = (self.centres[a * self.dims + axis], self.centres[b * self.dims + axis]);
            self.centres[a * self.dims + axis] = (m * x + n * y) / (m + n);
        }
        self.sizes[a] = m + n;
        self.firsts[a] = self.firsts[a].min(self.firsts[b]);
        self.sizes.swap_remove(b);
        self.firsts.swap_remove(b);
        let last = self.sizes.len();
        self.centres.copy_within(last * self.dims.., b * self.dims);
        self.centres.truncate(last * self.dims);
    }
}

impl<'a> Snapshot<'a> {
    fn new(centres: &'a Points, sizes: &[f64]) -> Self {
        let index = Index::new(centres);
        let mut least = vec![f64::INFINITY; index.nodes.len()];
        // Children stand behind their parent.
        for (at, node) in index.nodes.iter().enumerate().rev() {
            least[at] = match node.second {
                Some(second) => least[at + 1].min(least[second]),
                None => index.order[node.range.clone()]
                    .iter()
                    .fold(f64::INFINITY, |least, &i| least.min(sizes[i])),
            };
        }
        Self {
            index,
            least,
            places: (0..sizes.len()).collect(),
            numbers: (0..sizes.len()).collect(),
            young: Vec::new(),
        }
    }

    /// Follows `Clusters::join`.
    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (a.min(b), a.max(b));
        for place in [a, b] {
            match self.numbers[place] {
                GONE => self.young.retain(|&young| young != place),
                number => self.places[number] = GONE,
            }
        }
        self.numbers[a] = GONE;
        self.numbers.swap_remove(b);
        let last = self.numbers.len();
        if b < last {
            match self.numbers[b] {
                GONE => self
                    .young
                    .iter_mut()
                    .filter(|young| **young == last)
                    .for_each(|young| *young = b),
                number => self.places[number] = b,
            }
        }
        self.young.push(a);
    }
}

/// The merges by ascending height.
pub(super) fn ward(points: &Points) -> Result<Vec<Merge>> {
    merges(points, FEW)
}

fn merges(points: &Points, few: usize) -> Result<Vec<Merge>> {
    let n = points.len();
    let mut clusters = Clusters {
        centres: points.values().to_vec(),
        sizes: vec![1.0; n],
        firsts: (0..n).collect(),
        dims: points.dims(),
    };
    let mut merges = Vec::with_capacity(n.saturating_sub(1));
    let mut chain: Vec<usize> = Vec::new();
    while clusters.len() > few.max(1) {
        let centres = Points::new(&clusters.centres, clusters.dims)?;
        let mut snapshot = Snapshot::new(&centres, &clusters.sizes);
        let patience = PATIENCE * clusters.len().isqrt();
        while clusters.len() > few.max(1) && snapshot.young.len() < patience {
            advance(&mut clusters, &mut chain, &mut merges, Some(&mut snapshot));
        }
    }
    while clusters.len() > 1 {
        advance(&mut clusters, &mut chain, &mut merges, None);
    }
    merges.sort_by(|a: &Merge, b| a.height.total_cmp(&b.height));
    Ok(merges)
}

/// One step along the chain, or a merge at its end.
fn advance(
    clusters: &mut Clusters,
    chain: &mut Vec<usize>,
    merges: &mut Vec<Merge>,
    mut snapshot: Option<&mut Snapshot<'_>>,
) {
    let top = chain.last().copied().unwrap_or(0);
    if chain.is_empty() {
        chain.push(top);
    }
    let before = chain.len().checked_sub(2).map(|at| chain[at]);
    let nearest = clusters.nearest(top, before, snapshot.as_deref());
    if Some(nearest.place) != before {
        chain.push(nearest.place);
        return;
    }
    chain.truncate(chain.len() - 2);
    merges.push(Merge {
        members: [clusters.firsts[top], clusters.firsts[nearest.place]],
        height: libm::sqrt(nearest.height_squared),
    });
    // The last cluster moves to the place that becomes free.
    let (free, moved) = (top.max(nearest.place), clusters.len() - 1);
    clusters.join(top, nearest.place);
    if let Some(snapshot) = &mut snapshot {
        snapshot.join(top, nearest.place);
    }
    for link in chain {
        if *link == moved {
            *link = free;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::stream::Stream;

    #[test]
    fn the_index_changes_no_merge() {
        let mut stream = Stream::new(9, 0);
        for case in 0..60 {
            let (n, dims) = (1 + 7 * case, 1 + case % 3);
            // Every other time on a grid, with many ties and points that coincide.
            let place = |x: f64| if case % 2 == 0 { x } else { (3.0 * x).round() };
            let values: Vec<f64> = (0..n * dims).map(|_| place(stream.normal())).collect();
            let points = Points::new(&values, dims).unwrap();
            let (all, indexed) = (merges(&points, n).unwrap(), merges(&points, 2).unwrap());
            assert_eq!(all.len(), indexed.len());
            for (a, b) in all.iter().zip(&indexed) {
                assert_eq!((a.members, a.height.to_bits()), (b.members, b.height.to_bits()));
            }
        }
    }
}
