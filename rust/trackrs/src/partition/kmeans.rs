//! K-means with the seeding of k-means++, over a range of K.
//!
//! | symbol | name here | meaning                                                           |
//! |--------|-----------|-------------------------------------------------------------------|
//! | K      | `k`       | clusters asked for; at most one per point                         |
//! | D²     | `nearest` | squared distance of every point to the nearest centre so far      |
//!
//! 1. The first centre is a point drawn evenly, every other one a point drawn with probability proportional to D²; evenly where
//!    all D² are zero.
//! 2. Lloyd: every point to its nearest centre, ties the lower label; centres to the means; until labels repeat, at most
//!    100 times. Empty clusters vanish.
//!
//! The run of K draws from stream (seed, K), so that it does not depend on the range.
//!
//! Reference: Arthur, Vassilvitskii 2007; Lloyd 1982; spec 6.2.

use super::points::{Partition, Points, squared};
use super::{Partitioner, all_labelled, require_few};
use crate::error::{Error, Result};
use crate::stats::stream::Stream;
use serde::{Deserialize, Serialize};

const MAX_ITERATIONS: usize = 100;

/// K-means for every K of a range, one partition each.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KMeansPartition {
    /// The least K.
    pub lower: usize,
    /// The largest K.
    pub upper: usize,
    /// Seed of the streams.
    pub seed: u64,
}

impl Default for KMeansPartition {
    fn default() -> Self {
        Self {
            lower: 1,
            upper: 20,
            seed: 0,
        }
    }
}

impl Partitioner for KMeansPartition {
    fn partitions(&self, points: &Points) -> Result<Vec<Partition>> {
        if self.lower == 0 {
            return Err(Error::invalid("k", 0, "must be at least 1"));
        }
        if self.upper < self.lower {
            return Err(Error::invalid("k", self.upper, "must not be below the lower one"));
        }
        // More clusters than points are as many as points.
        let most = points.len().max(1);
        let (lower, upper) = (self.lower.min(most), self.upper.min(most));
        require_few(
            upper - lower + 1,
            points.len(),
            "too many labels: narrow the range of k",
        )?;
        let run = |k| {
            let labels = cluster(points, k, &mut Stream::new(self.seed, k as u64));
            Partition::from_labels(&labels, points.len())
        };
        Ok((lower..=upper).map(run).collect())
    }

    fn labels(&self, points: &Points) -> Result<Vec<Option<usize>>> {
        if self.lower != self.upper {
            return Err(Error::invalid(
                "k",
                "a range",
                "must be one number where one partition is wanted",
            ));
        }
        let found = self.partitions(points)?;
        Ok(found
            .first()
            .map_or_else(Vec::new, |cells| all_labelled(cells.labels())))
    }
}

/// The label of every point, below `k`.
pub(crate) fn cluster(points: &Points, k: usize, stream: &mut Stream) -> Vec<usize> {
    let mut centres = seeds(points, k.min(points.len()), stream);
    let mut labels = vec![usize::MAX; points.len()];
    for _ in 0..MAX_ITERATIONS {
        let mut changed = false;
        for (row, label) in points.values().chunks_exact(points.dims()).zip(&mut labels) {
            let closest = closest(row, &centres);
            changed |= closest != *label;
            *label = closest;
        }
        if !changed {
            break;
        }
        means(points, &mut labels, &mut centres);
    }
    labels
}

fn closest(row: &[f64], centres: &[f64]) -> usize {
    let (mut best, mut label) = (f64::INFINITY, 0);
    for (k, centre) in centres.chunks_exact(row.len()).enumerate() {
        let d2 = squared(row, centre);
        if d2 < best {
            (best, label) = (d2, k);
        }
    }
    label
}

/// The means of the clusters; empty ones are taken out, of the labels too.
fn means(points: &Points, labels: &mut [usize], centres: &mut Vec<f64>) {
    let dims = points.dims();
    let mut counts = vec![0_usize; centres.len() / dims];
    centres.fill(0.0);
    for (row, &label) in points.values().chunks_exact(dims).zip(labels.iter()) {
        counts[label] += 1;
        for (sum, x) in centres[label * dims..].iter_mut().zip(row) {
            *sum += x;
        }
    }
    let mut names = vec![0; counts.len()];
    let mut kept = 0;
    for (old, &count) in counts.iter().enumerate() {
        names[old] = kept;
        if count > 0 {
            for axis in 0..dims {
                centres[kept * dims + axis] = centres[old * dims + axis] / count as f64;
            }
            kept += 1;
        }
    }
    centres.truncate(kept * dims);
    for label in labels {
        *label = names[*label];
    }
}

/// The first centres, row by row.
fn seeds(points: &Points, k: usize, stream: &mut Stream) -> Vec<f64> {
    let n = points.len();
    let mut centres = Vec::with_capacity(k * points.dims());
    let indices: Vec<usize> = (0..n).collect();
    let mut nearest = vec![f64::INFINITY; n];
    let mut total = 0.0;
    for number in 0..k {
        let chosen = if number == 0 || total == 0.0 {
            stream.choice(&indices).copied().unwrap_or(0)
        } else {
            weighted(&nearest, stream.uniform() * total)
        };
        let centre = points.point(chosen);
        centres.extend_from_slice(centre);
        total = 0.0;
        for (row, d2) in points.values().chunks_exact(points.dims()).zip(&mut nearest) {
            *d2 = d2.min(squared(row, centre));
            total += *d2;
        }
    }
    centres
}

/// The first index at which the sum of the weights exceeds `target`.
fn weighted(weights: &[f64], target: f64) -> usize {
    let (mut sum, mut last) = (0.0, 0);
    for (i, &weight) in weights.iter().enumerate() {
        if weight > 0.0 {
            sum += weight;
            last = i;
            if sum > target {
                break;
            }
        }
    }
    last
}
