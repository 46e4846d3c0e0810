//! A k-d tree over points: who is near, counted, visited or summed, in O(n) memory.
//!
//! | symbol | name here         | meaning                                                                        |
//! |--------|-------------------|--------------------------------------------------------------------------------|
//! |        | `order`           | indices of the points; every node holds a contiguous range of them             |
//! |        | `boxes`           | lower and upper corner of each node's bounding box                             |
//! | d²     | `distance_squared`| squared distances throughout: comparing them is comparing distances            |
//!
//! A node is cut at the median of its widest coordinate, ties by index, until `LEAF` points are left or all coincide.
//! A node whose box lies outside a query is skipped; one whose box lies wholly inside is counted at once, so piles of
//! coincident points cost no more than one.
//!
//! Reference: J. Bentley, *Multidimensional binary search trees used for associative searching*, 1975; bounding boxes as
//! in Friedman, Bentley, Finkel 1977.

use std::ops::Range;

use super::points::Points;
use crate::interrupt::ahead;

/// Nodes with at most so many points are not cut.
pub(crate) const LEAF: usize = 16;

/// A node: a range of `order`, and where its children are.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    pub(crate) range: Range<usize>,
    /// The first child; the second stands behind all nodes of the first, at `second`. None for a leaf.
    pub(crate) second: Option<usize>,
}

/// The tree.
#[derive(Debug, Clone)]
pub(crate) struct Index<'a> {
    pub(crate) points: &'a Points,
    /// Coordinates in the order of `order`, one axis after the other, so that a leaf is read in one go.
    sorted: Vec<f64>,
    pub(crate) order: Vec<usize>,
    pub(crate) nodes: Vec<Node>,
    boxes: Vec<f64>,
}

/// The least number whose root is not below `length`, so that d² below it is d below `length` to the last bit.
pub(crate) fn square_of_bound(length: f64) -> f64 {
    let mut square = length * length;
    while square > 0.0 && libm::sqrt(square.next_down()) >= length {
        square = square.next_down();
    }
    while libm::sqrt(square) < length {
        square = square.next_up();
    }
    square
}

/// Squares of how near and how far a coordinate can be.
#[inline(always)]
fn bounds(x: f64, low: f64, high: f64) -> (f64, f64) {
    let (below, above) = (low - x, x - high);
    let near = if below > above { below } else { above };
    let near = if near > 0.0 { near } else { 0.0 };
    let (below, above) = (below.abs(), above.abs());
    let far = if below > above { below } else { above };
    (near * near, far * far)
}

/// How near and how far the points of a node can be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach {
    pub(crate) nearest: f64,
    pub(crate) farthest: f64,
}

impl<'a> Index<'a> {
    pub(crate) fn new(points: &'a Points) -> Self {
        let leaves = 2 * points.len().div_ceil(LEAF);
        let mut index = Self {
            points,
            sorted: Vec::with_capacity(points.values().len()),
            order: (0..points.len()).collect(),
            nodes: Vec::with_capacity(leaves),
            boxes: Vec::with_capacity(2 * leaves * points.dims()),
        };
        if !points.is_empty() {
            let mut keys = Vec::with_capacity(points.len());
            index.build(0..points.len(), &mut keys);
        }
        for axis in 0..points.dims() {
            index.sorted.extend(index.order.iter().map(|&i| points.point(i)[axis]));
        }
        index
    }

    /// Adds the node of this range and everything below it; `keys` is memory to use.
    fn build(&mut self, range: Range<usize>, keys: &mut Vec<(f64, usize)>) {
        ahead(range.len());
        let dims = self.points.dims();
        let at = self.boxes.len();
        let first = self.points.point(self.order[range.start]);
        self.boxes.extend_from_slice(first);
        self.boxes.extend_from_slice(first);
        let (low, high) = self.boxes[at..].split_at_mut(dims);
        for &i in &self.order[range.clone()] {
            for ((low, high), &x) in low.iter_mut().zip(high.iter_mut()).zip(self.points.point(i)) {
                *low = if x < *low { x } else { *low };
                *high = if x > *high { x } else { *high };
            }
        }
        let (mut axis, mut width) = (0, 0.0);
        for (k, (low, high)) in low.iter().zip(high.iter()).enumerate() {
            if high - low > width {
                (axis, width) = (k, high - low);
            }
        }
        let node = self.nodes.len();
        self.nodes.push(Node {
            range: range.clone(),
            second: None,
        });
        if range.len() <= LEAF || width == 0.0 {
            return;
        }
        // Full leaves but for the last one.
        let middle = range.len().div_ceil(2).next_multiple_of(LEAF);
        let points = self.points;
        keys.clear();
        keys.extend(self.order[range.clone()].iter().map(|&i| (points.point(i)[axis], i)));
        keys.select_nth_unstable_by(middle, |(x, a), (y, b)| x.total_cmp(y).then(a.cmp(b)));
        for (place, &(_, i)) in self.order[range.clone()].iter_mut().zip(keys.iter()) {
            *place = i;
        }
        self.build(range.start..range.start + middle, keys);
        self.nodes[node].second = Some(self.nodes.len());
        self.build(range.start + middle..range.end, keys);
    }

    /// Bounds of the squared distance from `query` to the points of a node. A box of no extent gives equal bounds.
    #[inline(always)]
    pub(crate) fn reach(&self, node: usize, query: &[f64]) -> Reach {
        let dims = query.len();
        let corners = &self.boxes[2 * dims * node..2 * dims * (node + 1)];
        // Two coordinates are the common case; both ways sum in the same order.
        if let (&[x, y], &[low_x, low_y, high_x, high_y]) = (query, corners) {
            let ((near_x, far_x), (near_y, far_y)) = (bounds(x, low_x, high_x), bounds(y, low_y, high_y));
            return Reach {
                nearest: near_x + near_y,
                farthest: far_x + far_y,
            };
        }
        let (low, high) = corners.split_at(dims);
        let mut reach = Reach {
            nearest: 0.0,
            farthest: 0.0,
        };
        for ((&x, &low), &high) in query.iter().zip(low).zip(high) {
            let (near, far) = bounds(x, low, high);
            reach.nearest += near;
            reach.farthest += far;
        }
        reach
    }

    /// Squared distance of the point at this place of `order`.
    #[inline(always)]
    pub(crate) fn square(&self, at: usize, query: &[f64]) -> f64 {
        if let &[x, y] = query {
            let (u, v) = (self.sorted[at] - x, self.sorted[self.order.len() + at] - y);
            return u * u + v * v;
        }
        let axes = self.sorted.chunks_exact(self.order.len());
        let square = |(values, x): (&[f64], &f64)| (values[at] - x) * (values[at] - x);
        axes.zip(query).map(square).fold(0.0, |sum, square| sum + square)
    }

    /// The points of a node: their places in `order`, and squared distances from `query`.
    #[inline]
    pub(crate) fn members<'b>(&'b self, node: usize, query: &'b [f64]) -> impl Iterator<Item = (usize, f64)> + 'b {
        self.nodes[node]
            .range
            .clone()
            .map(move |at| (at, self.square(at, query)))
    }

    /// The same, `LEAF` of them at a time: the place of the first and the squared distances.
    #[inline(always)]
    pub(crate) fn scan(&self, node: usize, query: &[f64], mut visit: impl FnMut(usize, &[f64])) {
        let Range { start, end } = self.nodes[node].range;
        let mut buffer = [0.0; LEAF];
        for first in (start..end).step_by(LEAF) {
            let count = LEAF.min(end - first);
            self.squares(first, query, &mut buffer[..count]);
            visit(first, &buffer[..count]);
        }
    }

    /// Squared distances of the points from `first` on.
    #[inline(always)]
    fn squares(&self, first: usize, query: &[f64], out: &mut [f64]) {
        let n = self.order.len();
        if let &[x, y] = query {
            let (xs, ys) = self.sorted.split_at(n);
            let (xs, ys) = (&xs[first..first + out.len()], &ys[first..first + out.len()]);
            for ((out, a), b) in out.iter_mut().zip(xs).zip(ys) {
                let (u, v) = (a - x, b - y);
                *out = u * u + v * v;
            }
            return;
        }
        out.fill(0.0);
        for (values, x) in self.sorted.chunks_exact(n).zip(query) {
            for (out, value) in out.iter_mut().zip(&values[first..]) {
                *out += (value - x) * (value - x);
            }
        }
    }

    /// Visits nodes from the root down; `enter` says of each whether to go into its children, near one first, and works
    /// on leaves itself.
    #[inline(always)]
    pub(crate) fn descend(&self, query: &[f64], mut enter: impl FnMut(usize, Reach) -> bool) {
        ahead(self.order.len());
        // Nodes are halved down to `LEAF`, so that this is enough for 2³⁵ points.
        let mut waiting = [(
            0,
            Reach {
                nearest: 0.0,
                farthest: 0.0,
            },
        ); 32];
        let mut count = 0;
        if !self.nodes.is_empty() {
            waiting[0] = (0, self.reach(0, query));
            count = 1;
        }
        while count > 0 {
            count -= 1;
            let (node, reach) = waiting[count];
            if !enter(node, reach) {
                continue;
            }
            if let Some(second) = self.nodes[node].second {
                let children = [node + 1, second].map(|child| (child, self.reach(child, query)));
                let [a, b] = if children[1].1.nearest < children[0].1.nearest {
                    [children[0], children[1]]
                } else {
                    [children[1], children[0]]
                };
                waiting[count] = a;
                waiting[count + 1] = b;
                count += 2;
            }
        }
    }

    /// Whether a node has no children.
    #[inline]
    pub(crate) fn is_leaf(&self, node: usize) -> bool {
        self.nodes[node].second.is_none()
    }

    /// Calls `visit` with every point within √`radius_squared`, bound included: index and squared distance.
    pub(crate) fn within(&self, query: &[f64], radius_squared: f64, mut visit: impl FnMut(usize, f64)) {
        self.descend(query, |node, reach| {
            if reach.nearest > radius_squared {
                return false;
            }
            if self.is_leaf(node) {
                for (at, d2) in self.members(node, query) {
                    if d2 <= radius_squared {
                        visit(self.order[at], d2);
                    }
                }
            }
            true
        });
    }

    /// How many points have a squared distance for which `inside` holds; it must hold below some bound and not above.
    /// Counting stops at `enough`.
    #[inline(always)]
    pub(crate) fn count(&self, query: &[f64], enough: usize, inside: impl Fn(f64) -> bool) -> usize {
        let mut count = 0;
        self.descend(query, |node, reach| {
            if count >= enough || !inside(reach.nearest) {
                return false;
            }
            if inside(reach.farthest) {
                count += self.nodes[node].range.len();
                return false;
            }
            if self.is_leaf(node) {
                self.scan(node, query, |_, squares| {
                    // Wrapping, because checked sums are not vectorised; there are `LEAF` at most.
                    let within = squares.iter().map(|&d2| usize::from(inside(d2)));
                    count += within.fold(0, usize::wrapping_add);
                });
            }
            true
        });
        count
    }

    /// The squared distance of the point farthest from `query`.
    pub(crate) fn farthest(&self, query: &[f64]) -> f64 {
        let mut best = 0.0;
        self.descend(query, |node, reach| {
            if reach.farthest <= best {
                return false;
            }
            if self.is_leaf(node) {
                best = self.members(node, query).fold(best, |best, (_, d2)| best.max(d2));
            }
            true
        });
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::stream::Stream;

    #[test]
    fn bounds_are_exact() {
        let mut stream = Stream::new(4, 0);
        for _ in 0..1000 {
            let squared = stream.uniform();
            let length = squared.sqrt();
            let bound = square_of_bound(length);
            assert!(bound <= squared && bound.sqrt() >= length && bound.next_down().sqrt() < length);
        }
    }

    #[test]
    fn queries_equal_brute_force() {
        let mut stream = Stream::new(3, 0);
        for (n, dims) in [(0, 2), (1, 2), (40, 1), (300, 2), (300, 3), (200, 5)] {
            let mut values: Vec<f64> = (0..n * dims).map(|_| stream.normal()).collect();
            // A pile of coincident points.
            let piled = values.len().min(30 * dims);
            values[..piled].fill(0.5);
            let points = Points::new(&values, dims).unwrap();
            let index = Index::new(&points);
            for i in 0..n {
                let query = points.point(i);
                let all: Vec<f64> = (0..n).map(|j| points.distance_squared(i, j)).collect();
                let expected: Vec<usize> = (0..n).filter(|&j| all[j] <= 0.7).collect();
                let mut found = Vec::new();
                index.within(query, 0.7, |j, d2| {
                    assert_eq!(d2, all[j]);
                    found.push(j);
                });
                found.sort_unstable();
                assert_eq!(found, expected);
                assert_eq!(index.count(query, usize::MAX, |d2| d2 <= 0.7), expected.len());
                assert_eq!(index.farthest(query), all.iter().fold(0.0, |a: f64, &b| a.max(b)));
            }
        }
    }
}
