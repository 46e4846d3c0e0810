//! Minimum spanning tree of points: the shortest edges that connect them all. Its edges up to a length connect what hops of
//! that length connect.
//!
//! | name here | meaning                                                                                           |
//! |-----------|---------------------------------------------------------------------------------------------------|
//! | [`Edge`]  | two points and d²; edges are in the order of d², then of their ends, so that there is one tree only |
//!
//! 1. Few points, Prim: the tree grows by its shortest edge to a point outside. O(n²) time.
//! 2. Many points, Borůvka: every part joins another by its shortest edge, again and again; nearest points of other parts by a
//!    k-d tree that skips what lies in the same part. What a point found once stays a lower bound, because parts only grow.
//!
//! Both give the same edges, in O(n) memory.
//!
//! Reference: R. Prim, *Shortest connection networks and some generalizations*, 1957; O. Borůvka, *O jistém problému
//! minimálním*, 1926; W. March, P. Ram, A. Gray, *Fast Euclidean minimum spanning tree*, 2010 (the bounds).

use super::index::Index;
use super::points::{Points, squared};
use super::union::Union;
use crate::interrupt::ahead;

/// Up to so many points O(n²) is faster.
const FEW: usize = 1024;

/// An edge of the tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Its ends, the lower index first.
    pub ends: [usize; 2],
    /// The square of its length.
    pub length_squared: f64,
}

impl Edge {
    fn new(i: usize, j: usize, length_squared: f64) -> Self {
        Self {
            ends: [i.min(j), i.max(j)],
            length_squared,
        }
    }

    fn is_before(&self, other: &Self) -> bool {
        (self.length_squared, self.ends) < (other.length_squared, other.ends)
    }
}

/// The edges, shortest first, ties in the order of their ends.
pub fn spanning_tree(points: &Points) -> Vec<Edge> {
    let mut edges = if points.len() <= FEW {
        prim(points)
    } else {
        boruvka(points)
    };
    edges.sort_by(|a, b| a.length_squared.total_cmp(&b.length_squared).then(a.ends.cmp(&b.ends)));
    edges
}

fn prim(points: &Points) -> Vec<Edge> {
    let (n, dims) = (points.len(), points.dims());
    let mut edges = Vec::with_capacity(n.saturating_sub(1));
    // What is not in the tree yet: coordinates, index, nearest point of the tree and its distance, side by side.
    let mut outside = points.values().to_vec();
    let mut indices: Vec<usize> = (0..n).collect();
    let mut nearest = vec![0; n];
    let mut distances = vec![f64::INFINITY; n];
    let (mut latest, mut slot) = (0, 0);
    for left in (1..n).rev() {
        ahead(left);
        // The point at `slot` has joined the tree: the last one takes its place.
        indices.swap_remove(slot);
        nearest.swap_remove(slot);
        distances.swap_remove(slot);
        outside.copy_within(left * dims.., slot * dims);
        outside.truncate(left * dims);
        let joined = points.point(latest);
        let mut best = Edge::new(usize::MAX, usize::MAX, f64::INFINITY);
        let rows = outside.chunks_exact(dims).zip(&indices);
        for (at, ((row, &i), (near, distance))) in rows.zip(nearest.iter_mut().zip(&mut distances)).enumerate() {
            let d2 = squared(row, joined);
            if d2 < *distance || (d2 == *distance && Edge::new(i, latest, d2).is_before(&Edge::new(i, *near, d2))) {
                (*distance, *near) = (d2, latest);
            }
            if *distance <= best.length_squared {
                let edge = Edge::new(i, *near, *distance);
                if edge.is_before(&best) {
                    (best, slot) = (edge, at);
                }
            }
        }
        latest = indices[slot];
        edges.push(best);
    }
    edges
}

/// What stands for a node whose points are of several parts.
const MIXED: usize = usize::MAX;

fn boruvka(points: &Points) -> Vec<Edge> {
    let n = points.len();
    let index = Index::new(points);
    let mut parts = Union::new(n);
    let mut bounds = vec![0.0; n];
    let mut edges: Vec<Edge> = Vec::with_capacity(n.saturating_sub(1));
    while edges.len() + 1 < n {
        let names = parts.names();
        let of_node = parts_of_nodes(&index, &names);
        let mut best: Vec<Option<Edge>> = vec![None; n];
        for &i in &index.order {
            let part = names[i];
            let found = shortest(&index, i, bounds[i], best[part], &names, &of_node);
            bounds[i] = found.bound;
            best[part] = found.edge;
        }
        for edge in best.into_iter().flatten() {
            let [i, j] = edge.ends;
            // Two parts may have chosen the same edge.
            if parts.find(i) != parts.find(j) {
                parts.join(i, j);
                edges.push(edge);
            }
        }
    }
    edges
}

/// The part of each node's points, or `MIXED`.
fn parts_of_nodes(index: &Index<'_>, names: &[usize]) -> Vec<usize> {
    let mut out = vec![MIXED; index.nodes.len()];
    for node in (0..out.len()).rev() {
        // Children stand behind their parent.
        out[node] = if let Some(second) = index.nodes[node].second {
            if out[node + 1] == out[second] {
                out[second]
            } else {
                MIXED
            }
        } else {
            let mut members = index.order[index.nodes[node].range.clone()].iter().map(|&i| names[i]);
            let first = members.next().unwrap_or(MIXED);
            if members.all(|name| name == first) {
                first
            } else {
                MIXED
            }
        };
    }
    out
}

/// The shortest edge of a part so far, and no edge of the point to another part is shorter than √`bound`.
struct Shortest {
    edge: Option<Edge>,
    bound: f64,
}

/// The shorter of a part's shortest edge so far and that of one of its points.
fn shortest(
    index: &Index<'_>,
    i: usize,
    bound: f64,
    edge: Option<Edge>,
    names: &[usize],
    of_node: &[usize],
) -> Shortest {
    let mut best = edge.unwrap_or_else(|| Edge::new(usize::MAX, usize::MAX, f64::INFINITY));
    if bound > best.length_squared {
        return Shortest { edge, bound };
    }
    let (part, query) = (names[i], index.points.point(i));
    let mut nearest = f64::INFINITY;
    index.descend(query, |node, reach| {
        if of_node[node] == part || reach.nearest > best.length_squared {
            return false;
        }
        if index.is_leaf(node) {
            for (at, d2) in index.members(node, query) {
                let j = index.order[at];
                if d2 <= best.length_squared && names[j] != part {
                    nearest = nearest.min(d2);
                    let other = Edge::new(i, j, d2);
                    if other.is_before(&best) {
                        best = other;
                    }
                }
            }
        }
        true
    });
    // Nothing nearer was skipped than the best of the part.
    Shortest {
        edge: (best.length_squared < f64::INFINITY).then_some(best),
        bound: nearest.min(best.length_squared),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::stream::Stream;

    #[test]
    fn both_ways_give_the_same_tree() {
        let mut stream = Stream::new(6, 0);
        for case in 0..60 {
            let (n, dims) = (1 + 5 * case, 1 + case % 3);
            // Every other time on a grid, with many ties and points that coincide.
            let place = |x: f64| if case % 2 == 0 { x } else { (2.0 * x).round() };
            let values: Vec<f64> = (0..n * dims).map(|_| place(stream.normal())).collect();
            let points = Points::new(&values, dims).unwrap();
            let key = |a: &Edge, b: &Edge| a.length_squared.total_cmp(&b.length_squared).then(a.ends.cmp(&b.ends));
            let (mut slow, mut fast) = (prim(&points), boruvka(&points));
            slow.sort_by(key);
            fast.sort_by(key);
            assert_eq!(slow, fast, "{n} points in {dims} dimensions");
        }
    }
}
