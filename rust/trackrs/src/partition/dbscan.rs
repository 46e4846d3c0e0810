//! DBSCAN: clusters are what can be reached from core points in hops of at most eps.
//!
//! | symbol | name here     | meaning                                                              |
//! |--------|---------------|----------------------------------------------------------------------|
//! | eps    | `eps`         | neighbour: d ≤ eps, the point itself included                        |
//! | minPts | `min_samples` | a core point has at least so many neighbours                         |
//! | U      | `left`        | points without a label, per node of the index                        |
//!
//! In the order of the code:
//!
//! 1. core(i): #{j: d_ij ≤ eps} ≥ minPts.
//! 2. In the order of the indices, every core point without a label starts a cluster, which takes all neighbours of its
//!    core points. A border point belongs to the cluster that reaches it first. The rest is noise.
//!
//! Nodes of the index in which every point has its label (U = 0) are skipped: a cluster costs little more than its size.
//!
//! Reference: Ester, Kriegel, Sander, Xu 1996; spec 6.3. Labels are numbered as by scikit-learn.

use super::Partitioner;
use super::index::Index;
use super::points::{Partition, Points};
use crate::error::{Error, Result, require_non_negative};
use crate::threads::each_point;
use serde::{Deserialize, Serialize};

/// DBSCAN.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DbscanPartition {
    /// Largest distance of neighbours; none: 1.5 effective standard deviations of the points' noise.
    pub eps: Option<f64>,
    /// Neighbours, itself among them, that make a core point.
    pub min_samples: usize,
}

impl DbscanPartition {
    fn clusters(&self, points: &Points) -> Result<Vec<Option<usize>>> {
        let eps = match (self.eps, points.deviation()) {
            (Some(eps), _) => eps,
            (None, Some(deviation)) => 1.5 * deviation,
            (None, None) => {
                return Err(Error::invalid("eps", "none", "must be given where there is no noise"));
            }
        };
        require_non_negative("eps", eps)?;
        if self.min_samples == 0 {
            return Err(Error::invalid("min_samples", 0, "must be at least 1"));
        }
        let index = Index::new(points);
        let radius = eps * eps;
        // In the order of the index, so that one query finds in the caches what the last one has read.
        let sorted = each_point(points.len(), false, |at| {
            let query = points.point(index.order[at]);
            index.count(query, self.min_samples, |d2| d2 <= radius) >= self.min_samples
        });
        let mut core = vec![false; points.len()];
        for (&i, is_core) in index.order.iter().zip(sorted) {
            core[i] = is_core;
        }
        let mut labels = Labels::new(&index);
        let mut clusters = 0;
        let (mut waiting, mut fresh) = (Vec::new(), Vec::new());
        for start in 0..points.len() {
            if !core[start] || labels.of[start].is_some() {
                continue;
            }
            labels.set(start, clusters);
            waiting.push(start);
            while let Some(i) = waiting.pop() {
                labels.unlabelled_within(&index, points.point(i), radius, &mut fresh);
                for j in fresh.drain(..) {
                    labels.set(j, clusters);
                    if core[j] {
                        waiting.push(j);
                    }
                }
            }
            clusters += 1;
        }
        Ok(labels.of)
    }
}

impl Partitioner for DbscanPartition {
    fn partitions(&self, points: &Points) -> Result<Vec<Partition>> {
        let labels = self.clusters(points)?;
        Ok(vec![Partition::with_singletons(&labels, points.len())])
    }

    fn labels(&self, points: &Points) -> Result<Vec<Option<usize>>> {
        self.clusters(points)
    }
}

/// Labels, and how many are still to be given in every node of the index.
struct Labels {
    of: Vec<Option<usize>>,
    left: Vec<usize>,
    parents: Vec<usize>,
    homes: Vec<usize>,
}

impl Labels {
    fn new(index: &Index<'_>) -> Self {
        let mut parents = vec![usize::MAX; index.nodes.len()];
        let mut homes = vec![0; index.order.len()];
        for (node, content) in index.nodes.iter().enumerate() {
            if let Some(second) = content.second {
                parents[node + 1] = node;
                parents[second] = node;
            } else {
                for &i in &index.order[content.range.clone()] {
                    homes[i] = node;
                }
            }
        }
        Self {
            of: vec![None; index.order.len()],
            left: index.nodes.iter().map(|node| node.range.len()).collect(),
            parents,
            homes,
        }
    }

    fn set(&mut self, i: usize, label: usize) {
        self.of[i] = Some(label);
        let mut node = self.homes[i];
        while node != usize::MAX {
            self.left[node] -= 1;
            node = self.parents[node];
        }
    }

    fn unlabelled_within(&self, index: &Index<'_>, query: &[f64], radius: f64, found: &mut Vec<usize>) {
        index.descend(query, |node, reach| {
            if self.left[node] == 0 || reach.nearest > radius {
                return false;
            }
            if index.is_leaf(node) {
                let members = index.members(node, query).filter(|&(_, d2)| d2 <= radius);
                found.extend(members.map(|(at, _)| index.order[at]).filter(|&j| self.of[j].is_none()));
            }
            true
        });
    }
}
