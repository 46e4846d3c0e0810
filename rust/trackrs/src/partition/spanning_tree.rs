//! Minimum spanning tree of points: the shortest edges that connect them all. Its edges up to a length connect what hops of
//! that length connect.
//!
//! Prim's algorithm: the tree grows by the point nearest to it, ties by the lower index. O(n²) time, O(n) memory.
//!
//! Reference: R. Prim, *Shortest connection networks and some generalizations*, 1957.

use super::points::{Points, squared};

/// An edge of the tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Its ends, the lower index first.
    pub ends: [usize; 2],
    /// The square of its length.
    pub length_squared: f64,
}

/// The edges, shortest first, ties in the order of their ends.
pub fn spanning_tree(points: &Points) -> Vec<Edge> {
    let (n, dims) = (points.len(), points.dims());
    let mut edges = Vec::with_capacity(n.saturating_sub(1));
    // What is not in the tree yet: coordinates, index, nearest point of the tree and its distance, side by side.
    let mut outside = points.values().to_vec();
    let mut indices: Vec<usize> = (0..n).collect();
    let mut nearest = vec![0; n];
    let mut distances = vec![f64::INFINITY; n];
    let mut latest = 0;
    let mut slot = 0;
    for left in (1..n).rev() {
        // The point at `slot` has joined the tree: the last one takes its place.
        indices.swap_remove(slot);
        nearest.swap_remove(slot);
        distances.swap_remove(slot);
        outside.copy_within(left * dims.., slot * dims);
        outside.truncate(left * dims);
        let joined = points.point(latest);
        let mut best = (f64::INFINITY, usize::MAX);
        let rows = outside.chunks_exact(dims).zip(&indices);
        for (at, ((row, &i), (near, distance))) in rows.zip(nearest.iter_mut().zip(&mut distances)).enumerate() {
            let d2 = squared(row, joined);
            if d2 < *distance {
                (*distance, *near) = (d2, latest);
            }
            if (*distance, i) < best {
                (best, slot) = ((*distance, i), at);
            }
        }
        latest = best.1;
        let other = nearest[slot];
        edges.push(Edge {
            ends: [latest.min(other), latest.max(other)],
            length_squared: best.0,
        });
    }
    edges.sort_by(|a, b| a.length_squared.total_cmp(&b.length_squared).then(a.ends.cmp(&b.ends)));
    edges
}
