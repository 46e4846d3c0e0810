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
//! Reference: Arthur, Vassilvitskii 2007; Lloyd 1982; G. Hamerly, *Making k-means even faster*, SDM 2010, for the bounds;
//! spec 6.2.

use super::points::{Partition, Points, squared};
use super::{Partitioner, all_labelled, require_few};
use crate::error::{Error, Result};
use crate::stats::stream::Stream;
use serde::{Deserialize, Serialize};

const MAX_ITERATIONS: usize = 100;
/// Widens a bound by more than what rounding can do to it in one step.
const ROUNDING: f64 = 1e-12;
/// Points that are labelled at once.
const LANES: usize = 8;

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
            let labels = cluster(points, k, &mut Stream::new(self.seed, k as u64))?;
            Ok(Partition::from_labels(&labels, points.len()))
        };
        (lower..=upper).map(run).collect()
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
pub(crate) fn cluster(points: &Points, k: usize, stream: &mut Stream) -> Result<Vec<usize>> {
    let arch = super::instructions()?;
    let dims = points.dims();
    let mut centres = seeds(points, k.min(points.len()), stream);
    let mut labels = vec![usize::MAX; points.len()];
    let mut bounds = Bounds {
        own: vec![f64::INFINITY; points.len()],
        others: vec![0.0; points.len()],
    };
    let axes: Vec<f64> = (0..dims)
        .flat_map(|axis| points.values().iter().skip(axis).step_by(dims).copied())
        .collect();
    for round in 0..MAX_ITERATIONS {
        if round > 0 {
            let before = centres.clone();
            means(points, &mut labels, &mut centres);
            bounds.widen(&labels, &moves(&before, &centres, dims));
        }
        if !arch.dispatch(|| relabel(&axes, &centres, dims, &mut labels, &mut bounds)) {
            break;
        }
    }
    Ok(labels)
}

/// Bounds of the distances of every point: not farther from its own centre, not nearer to any other one. A point whose
/// bounds do not overlap keeps its label; all roundings widen the bounds.
struct Bounds {
    own: Vec<f64>,
    others: Vec<f64>,
}

impl Bounds {
    /// After the centres have moved; no moves: nothing is known any more.
    fn widen(&mut self, labels: &[usize], moves: &[f64]) {
        let Some(largest) = moves.iter().copied().reduce(f64::max) else {
            self.others.fill(0.0);
            return;
        };
        let largest = largest * (1.0 + ROUNDING);
        for ((own, others), &label) in self.own.iter_mut().zip(&mut self.others).zip(labels) {
            *own = (*own + moves[label]) * (1.0 + ROUNDING);
            *others = *others * (1.0 - ROUNDING) - largest;
        }
    }
}

/// How far the centres have moved; nothing if some have vanished, so that the others have new labels.
fn moves(before: &[f64], after: &[f64], dims: usize) -> Vec<f64> {
    if before.len() != after.len() {
        return Vec::new();
    }
    let pairs = before.chunks_exact(dims).zip(after.chunks_exact(dims));
    pairs.map(|(a, b)| squared(a, b).sqrt()).collect()
}

/// Gives every point the label of its closest centre, and says whether any has changed. `axes` has the coordinates axis
/// by axis, so that the same entry of several points stands in one register.
#[inline(always)]
fn relabel(axes: &[f64], centres: &[f64], dims: usize, labels: &mut [usize], bounds: &mut Bounds) -> bool {
    let n = labels.len();
    let mut changed = false;
    let bounds = bounds.own.chunks_mut(LANES).zip(bounds.others.chunks_mut(LANES));
    for (block, (labels, (own, others))) in labels.chunks_mut(LANES).zip(bounds).enumerate() {
        let settled = own
            .iter()
            .zip(&*others)
            .fold(true, |all, (own, others)| all & (own < others));
        if settled {
            continue;
        }
        let here = block * LANES..block * LANES + labels.len();
        let mut closest = Closest {
            squares: [f64::INFINITY; LANES],
            seconds: [f64::INFINITY; LANES],
            labels: [0.0; LANES],
        };
        if dims == 2 {
            let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
            x[..here.len()].copy_from_slice(&axes[here.clone()]);
            y[..here.len()].copy_from_slice(&axes[n..][here]);
            for (k, centre) in centres.chunks_exact(2).enumerate() {
                let mut squares = [0.0; LANES];
                for ((square, x), y) in squares.iter_mut().zip(&x).zip(&y) {
                    let (u, v) = (x - centre[0], y - centre[1]);
                    *square = u * u + v * v;
                }
                closest.offer(&squares, k as f64);
            }
        } else {
            for (k, centre) in centres.chunks_exact(dims).enumerate() {
                let mut squares = [0.0; LANES];
                for (values, centre) in axes.chunks_exact(n).zip(centre) {
                    for (square, x) in squares.iter_mut().zip(&values[here.clone()]) {
                        *square += (x - centre) * (x - centre);
                    }
                }
                closest.offer(&squares, k as f64);
            }
        }
        for (own, square) in own.iter_mut().zip(closest.squares) {
            *own = square.sqrt() * (1.0 + ROUNDING);
        }
        for (others, square) in others.iter_mut().zip(closest.seconds) {
            *others = square.sqrt() * (1.0 - ROUNDING);
        }
        for (label, found) in labels.iter_mut().zip(closest.labels) {
            let found = index_of(found);
            changed |= found != *label;
            *label = found;
        }
    }
    changed
}

/// A label that stood among the distances as a number.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "it was made from a small index"
)]
#[inline(always)]
fn index_of(label: f64) -> usize {
    label as usize
}

/// Of each of some points the least squared distance, the second one, and the label of the first.
struct Closest {
    squares: [f64; LANES],
    seconds: [f64; LANES],
    labels: [f64; LANES],
}

impl Closest {
    #[inline(always)]
    fn offer(&mut self, squares: &[f64; LANES], label: f64) {
        let best = self.squares.iter_mut().zip(&mut self.seconds).zip(&mut self.labels);
        for (((best, second), name), &square) in best.zip(squares) {
            let nearer = square < *best;
            let larger = if nearer { *best } else { square };
            *second = if larger < *second { larger } else { *second };
            *name = if nearer { label } else { *name };
            *best = if nearer { square } else { *best };
        }
    }
}

/// The means of the clusters; empty ones are taken out, of the labels too.
fn means(points: &Points, labels: &mut [usize], centres: &mut Vec<f64>) {
    let dims = points.dims();
    let mut counts = vec![0_usize; centres.len() / dims];
    centres.fill(0.0);
    if let (2, (sums, [])) = (dims, centres.as_chunks_mut::<2>()) {
        for (row, &label) in points.values().as_chunks::<2>().0.iter().zip(labels.iter()) {
            counts[label] = counts[label].wrapping_add(1);
            let sum = &mut sums[label];
            *sum = [sum[0] + row[0], sum[1] + row[1]];
        }
    } else {
        for (row, &label) in points.values().chunks_exact(dims).zip(labels.iter()) {
            counts[label] += 1;
            for (sum, x) in centres[label * dims..].iter_mut().zip(row) {
                *sum += x;
            }
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
    if kept < counts.len() {
        centres.truncate(kept * dims);
        for label in labels {
            *label = names[*label];
        }
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
