//! Distance partitions: cells are what hops of at most θ connect, for every θ in a range that makes a difference.
//!
//! | symbol   | name here        | meaning                                                                        |
//! |----------|------------------|--------------------------------------------------------------------------------|
//! | d_M      |                  | Mahalanobis distance of two points; without noise, their distance               |
//! | θ        | `Thresholds`     | longest hop, in units of d_M                                                    |
//! | p_L, p_U | `probabilities`  | of the chi-square distribution of d degrees of freedom, default 0.3 and 0.8     |
//! | γ        | `detections_per_target` | mean measurements per target                                             |
//!
//! In the order of the code:
//!
//! 1. θ² = χ²_d quantile of p_L … p_U (`literature`); or twice that (`difference`), as the difference of two points has
//!    covariance 2R.
//! 2. All distinct partitions of the range: that of the lower bound, and one more at every length of an edge of the minimum
//!    spanning tree in (lower, upper]. They are the cuts of single linkage.
//! 3. Sub-partitions: a cell that is more likely to come from x > 1 targets than from one gives a copy of its partition in which
//!    it is split into x by k-means. Equal partitions are kept once.
//!
//! Reference: Granström, Lundquist, Orguner 2012; spec 6.1. The spanning tree and `difference` are ours.

use serde::{Deserialize, Serialize};
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};

use super::points::{Partition, Points};
use super::spanning_tree::spanning_tree;
use super::union::Union;
use super::{Partitioner, all_labelled, kmeans, poisson_split, require_few};
use crate::error::{Error, Result, require_non_negative, require_positive};
use crate::stats::chi_square;
use crate::stats::stream::Stream;

/// The thresholds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Thresholds {
    /// From the chi-square distribution of a point about its target, as in the literature.
    Literature,
    /// From that of the difference of two points.
    Difference,
    /// Given.
    Range {
        /// The least.
        lower: f64,
        /// The largest.
        upper: f64,
    },
}

/// Sub-partitions of cells that are too large for one target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SubPartitions {
    /// Mean measurements per target.
    pub detections_per_target: f64,
    /// Seed of the k-means splits.
    pub seed: u64,
}

/// Distance partitions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DistancePartition {
    /// The thresholds.
    pub thresholds: Thresholds,
    /// Probabilities of the lower and upper bound.
    pub probabilities: [f64; 2],
    /// Sub-partitions, if wanted.
    pub sub_partitions: Option<SubPartitions>,
}

impl Default for DistancePartition {
    fn default() -> Self {
        Self {
            thresholds: Thresholds::Literature,
            probabilities: [0.3, 0.8],
            sub_partitions: None,
        }
    }
}

const REMEDY: &str = "too many labels: narrow the thresholds";

impl DistancePartition {
    /// The bounds of θ² for points of `dims` coordinates.
    pub fn bounds_squared(&self, dims: usize) -> Result<[f64; 2]> {
        let bounds = match self.thresholds {
            Thresholds::Range { lower, upper } => {
                require_non_negative("thresholds", lower)?;
                require_non_negative("thresholds", upper)?;
                [lower * lower, upper * upper]
            }
            Thresholds::Literature | Thresholds::Difference => {
                let factor = if self.thresholds == Thresholds::Difference {
                    2.0
                } else {
                    1.0
                };
                let [lower, upper] = self.probabilities;
                if upper == 1.0 {
                    return Err(Error::invalid("probabilities", upper, "must be below 1"));
                }
                [
                    factor * chi_square::quantile(lower, dims)?,
                    factor * chi_square::quantile(upper, dims)?,
                ]
            }
        };
        if bounds[1] < bounds[0] {
            let upper = libm::sqrt(bounds[1]);
            return Err(Error::invalid("thresholds", upper, "must not be below the lower one"));
        }
        Ok(bounds)
    }

    fn cuts(&self, points: &Points) -> Result<Vec<Partition>> {
        let unit = points.deviation().unwrap_or(1.0);
        let [lower, upper] = self.bounds_squared(points.dims())?.map(|theta2| theta2 * unit * unit);
        let n = points.len();
        let tree = spanning_tree(points);
        let within = tree.partition_point(|edge| edge.length_squared <= lower);
        let upper = tree.partition_point(|edge| edge.length_squared <= upper);
        let steps: Vec<_> = tree[within..upper]
            .chunk_by(|a, b| a.length_squared == b.length_squared)
            .collect();
        require_few(steps.len() + 1, n, REMEDY)?;
        let mut cells = Union::new(n);
        let mut cuts = Vec::with_capacity(steps.len() + 1);
        for step in std::iter::once(&tree[..within]).chain(steps) {
            for edge in step {
                cells.join(edge.ends[0], edge.ends[1]);
            }
            cuts.push(Partition::from_labels(&cells.names(), n));
        }
        Ok(cuts)
    }
}

impl Partitioner for DistancePartition {
    fn partitions(&self, points: &Points) -> Result<Vec<Partition>> {
        if let Some(sub) = self.sub_partitions {
            require_positive("detections_per_target", sub.detections_per_target)?;
            return with_splits(points, self.cuts(points)?, sub);
        }
        self.cuts(points)
    }

    fn labels(&self, points: &Points) -> Result<Vec<Option<usize>>> {
        let [lower, upper] = self.bounds_squared(points.dims())?;
        if lower != upper {
            return Err(Error::invalid(
                "threshold",
                "none",
                "must be given where one partition is wanted",
            ));
        }
        let cuts = self.cuts(points)?;
        Ok(cuts.first().map_or_else(Vec::new, |cut| all_labelled(cut.labels())))
    }
}

/// The partitions, and behind each those with one of its cells split. Every distinct cell is split once, so that it is
/// split alike wherever it stands.
fn with_splits(points: &Points, cuts: Vec<Partition>, sub: SubPartitions) -> Result<Vec<Partition>> {
    let mut seen: HashSet<Partition> = HashSet::new();
    let mut splits: HashMap<Vec<usize>, Vec<usize>> = HashMap::new();
    let mut out = Vec::new();
    for cut in cuts {
        let mut found = vec![cut.clone()];
        for cell in cut.cells() {
            let parts = poisson_split::targets(cell.len(), sub.detections_per_target);
            if parts > 1 {
                let run = splits.len() as u64;
                let split = match splits.entry(cell.clone()) {
                    Entry::Occupied(known) => known.into_mut(),
                    Entry::Vacant(new) => {
                        let stream = &mut Stream::new(sub.seed, run);
                        new.insert(kmeans::cluster(&points.select(&cell), parts, stream)?)
                    }
                };
                found.push(cut.with_split(&cell, split));
            }
        }
        for partition in found {
            if seen.insert(partition.clone()) {
                out.push(partition);
                require_few(out.len(), points.len(), REMEDY)?;
            }
        }
    }
    Ok(out)
}
