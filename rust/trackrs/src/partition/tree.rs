//! Binary trees over points, of which every cut is a partition: single linkage and Ward.
//!
//! | symbol  | name here    | meaning                                                                          |
//! |---------|--------------|----------------------------------------------------------------------------------|
//! | v       |              | node: points are 0 … n−1, the merges n, n+1, … by ascending height               |
//! | h(v)    | `heights`    | height of a merge                                                                |
//!
//! In the order of the code:
//!
//! 1. Single linkage: the edges of the minimum spanning tree, shortest first; h = length.
//! 2. Ward: the two clusters with the least growth of the sum of squares (`ward.rs`).
//! 3. Nodes whose bounding box has a diagonal above `max_extent` are dropped; what is left is a forest.
//! 4. Partitions: the cuts of the forest at all distinct heights, points alone first. Equal ones are kept once.
//!
//! Reference: Gower, Ross 1969 (single linkage from the spanning tree); spec 8.2 (forest).

use serde::{Deserialize, Serialize};
use std::collections::HashSet;

use super::points::{Partition, Points};
use super::spanning_tree::spanning_tree;
use super::union::Union;
use super::ward::ward;
use super::{Partitioner, require_few};
use crate::error::{Error, Result, require_positive};

/// Default `max_extent`, in effective standard deviations.
const EXTENT: f64 = 15.0;

/// How clusters are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Linkage {
    /// By the shortest distance of two of their points.
    Single,
    /// By the least growth of the sum of squares.
    Ward,
}

/// A forest of binary trees over points.
#[derive(Debug, Clone, PartialEq)]
pub struct Tree {
    /// How many points there are.
    pub points: usize,
    /// The two nodes that each merge joins, the lower first; merge i is node `points` + i.
    pub children: Vec<[usize; 2]>,
    /// Height of each merge, ascending.
    pub heights: Vec<f64>,
    /// The nodes that are no child, ascending.
    pub roots: Vec<usize>,
}

/// Cuts of single-linkage and Ward trees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TreePartition {
    /// The trees.
    pub linkages: Vec<Linkage>,
    /// Largest diagonal of a cell's bounding box; none: 15 effective standard deviations of the points' noise, if there is one.
    pub max_extent: Option<f64>,
}

impl Default for TreePartition {
    fn default() -> Self {
        Self {
            linkages: vec![Linkage::Single, Linkage::Ward],
            max_extent: None,
        }
    }
}

impl TreePartition {
    /// The trees, in the order of `linkages`.
    pub fn trees(&self, points: &Points) -> Result<Vec<Tree>> {
        if self.linkages.is_empty() {
            return Err(Error::invalid("linkages", "none", "must name at least one"));
        }
        if let Some(extent) = self.max_extent {
            require_positive("max_extent", extent)?;
        }
        let default = points.deviation().map(|deviation| EXTENT * deviation);
        let extent = self.max_extent.or(default).unwrap_or(f64::INFINITY);
        let tree = |linkage: &Linkage| {
            let merges = match linkage {
                Linkage::Single => single(points),
                Linkage::Ward => ward(points)?,
            };
            Ok(forest(points, &merges, extent))
        };
        self.linkages.iter().map(tree).collect()
    }
}

impl Partitioner for TreePartition {
    fn partitions(&self, points: &Points) -> Result<Vec<Partition>> {
        let remedy = "too many labels: ask for the trees instead";
        let mut seen = HashSet::new();
        let mut out = Vec::new();
        for tree in self.trees(points)? {
            let n = tree.points;
            let mut cells = Union::new(n);
            // The first point of every node stands for it.
            let mut firsts: Vec<usize> = (0..n).collect();
            let mut merges = tree.children.iter().zip(&tree.heights).peekable();
            let levels = tree.heights.chunk_by(|a, b| a == b).count();
            require_few(out.len() + levels + 1, n, remedy)?;
            for level in 0..=levels {
                let mut height = None;
                while level > 0
                    && let Some((&[a, b], &h)) = merges.next_if(|&(_, &h)| height.is_none_or(|height| height == h))
                {
                    cells.join(firsts[a], firsts[b]);
                    firsts.push(firsts[a].min(firsts[b]));
                    height = Some(h);
                }
                let cut = Partition::from_labels(&cells.names(), n);
                if seen.insert(cut.clone()) {
                    out.push(cut);
                }
            }
        }
        Ok(out)
    }

    fn labels(&self, _points: &Points) -> Result<Vec<Option<usize>>> {
        Err(Error::invalid(
            "TreePartition",
            "a tree",
            "gives many partitions, not one",
        ))
    }
}

/// A merge of the clusters that hold two points.
pub(super) struct Merge {
    pub(super) members: [usize; 2],
    pub(super) height: f64,
}

fn single(points: &Points) -> Vec<Merge> {
    let merge = |edge: super::spanning_tree::Edge| Merge {
        members: edge.ends,
        height: libm::sqrt(edge.length_squared),
    };
    spanning_tree(points).into_iter().map(merge).collect()
}

/// The nodes of merges by ascending height, those dropped that are too large, and all above them.
fn forest(points: &Points, merges: &[Merge], extent: f64) -> Tree {
    let (n, dims) = (points.len(), points.dims());
    let mut cells = Union::new(n);
    // Per cell, at its first point: its node, if it is small enough, and its bounding box.
    let mut nodes: Vec<Option<usize>> = (0..n).map(Some).collect();
    let (mut low, mut high) = (points.values().to_vec(), points.values().to_vec());
    let (mut children, mut heights) = (Vec::new(), Vec::new());
    for merge in merges {
        let [a, b] = merge.members.map(|member| cells.find(member));
        cells.join(a, b);
        let (to, from) = (a.min(b), a.max(b));
        let mut diagonal = 0.0;
        for axis in 0..dims {
            let (i, j) = (to * dims + axis, from * dims + axis);
            low[i] = low[i].min(low[j]);
            high[i] = high[i].max(high[j]);
            diagonal += (high[i] - low[i]) * (high[i] - low[i]);
        }
        nodes[to] = match (nodes[a], nodes[b]) {
            (Some(x), Some(y)) if diagonal <= extent * extent => {
                children.push([x.min(y), x.max(y)]);
                heights.push(merge.height);
                Some(n + children.len() - 1)
            }
            _ => None,
        };
    }
    let mut is_root = vec![true; n + children.len()];
    children.iter().flatten().for_each(|&child| is_root[child] = false);
    Tree {
        points: n,
        children,
        heights,
        roots: (0..is_root.len()).filter(|&node| is_root[node]).collect(),
    }
}
