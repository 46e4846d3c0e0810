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
//! A point is not looked at again until the centres have moved far enough to change its label: twice the largest moves,
//! summed, must reach what its second nearest centre was farther away than its own at the last look.
//!
//! The run of K draws from stream (seed, K), so that it does not depend on the range.
//!
//! Reference: Arthur, Vassilvitskii 2007; Lloyd 1982; G. Hamerly, *Making k-means even faster*, SDM 2010, for the bounds;
//! spec 6.2.

use super::points::{Partition, Points, squared};
use super::{Partitioner, all_labelled, require_few};
use crate::error::{Error, Result};
use crate::interrupt::ahead;
use crate::lanes::Level;
use crate::stats::stream::Stream;
use serde::{Deserialize, Serialize};

const MAX_ITERATIONS: usize = 100;
/// More than what the roundings of one step can do to a bound, relative.
const ROUNDING: f64 = 1e-12;
/// Points that are labelled at once.
const LANES: usize = 8;
/// After so many blocks it is asked whether to go on.
const PAUSE: usize = 64;

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
    let arch = Level::chosen_arch()?;
    let dims = points.dims();
    let centres = seeds(points, k.min(points.len()), stream);
    let mut lloyd = Lloyd {
        points,
        axes: (0..dims)
            .flat_map(|axis| points.values().iter().skip(axis).step_by(dims).copied())
            .collect(),
        labels: vec![usize::MAX; points.len()],
        sums: vec![0.0; centres.len()],
        counts: vec![0; centres.len() / dims],
        centres,
        limits: vec![0.0; points.len().div_ceil(LANES)],
        drift: 0.0,
    };
    for _ in 0..MAX_ITERATIONS {
        if !arch.dispatch(|| lloyd.relabel()) {
            // Sums that are kept up to date gather roundings; the last centres are means of sums taken afresh.
            lloyd.sum();
            if lloyd.centre() {
                continue;
            }
            break;
        }
        lloyd.centre();
    }
    Ok(lloyd.labels)
}

/// The state of the iteration. Points are looked at in blocks of `LANES`.
struct Lloyd<'a> {
    points: &'a Points,
    /// Coordinates axis by axis, so that the same entry of several points stands in one register.
    axes: Vec<f64>,
    labels: Vec<usize>,
    centres: Vec<f64>,
    /// Sums and numbers of the points of each centre.
    sums: Vec<f64>,
    counts: Vec<usize>,
    /// Of every block the drift up to which all its points keep their labels.
    limits: Vec<f64>,
    /// Twice the sum of the largest moves so far: by so much the distance to a point's own centre and that to the second
    /// nearest have come closer to each other, at most. Roundings only make it larger.
    drift: f64,
}

impl Lloyd<'_> {
    /// Gives every point the label of its closest centre, and says whether any has changed.
    #[inline(always)]
    fn relabel(&mut self) -> bool {
        let (n, dims) = (self.labels.len(), self.points.dims());
        let mut changed = false;
        for block in 0..self.limits.len() {
            if block % PAUSE == 0 {
                ahead(PAUSE * LANES * self.centres.len());
            }
            if self.drift < self.limits[block] {
                continue;
            }
            let here = block * LANES..n.min(block * LANES + LANES);
            let mut closest = Closest {
                squares: [f64::INFINITY; LANES],
                seconds: [f64::INFINITY; LANES],
                labels: [0.0; LANES],
            };
            if dims == 2 {
                let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
                x[..here.len()].copy_from_slice(&self.axes[here.clone()]);
                y[..here.len()].copy_from_slice(&self.axes[n..][here.clone()]);
                for (k, centre) in self.centres.chunks_exact(2).enumerate() {
                    let mut squares = [0.0; LANES];
                    for ((square, x), y) in squares.iter_mut().zip(&x).zip(&y) {
                        let (u, v) = (x - centre[0], y - centre[1]);
                        *square = u * u + v * v;
                    }
                    closest.offer(&squares, k as f64);
                }
            } else {
                for (k, centre) in self.centres.chunks_exact(dims).enumerate() {
                    let mut squares = [0.0; LANES];
                    for (values, centre) in self.axes.chunks_exact(n).zip(centre) {
                        for (square, x) in squares.iter_mut().zip(&values[here.clone()]) {
                            *square += (x - centre) * (x - centre);
                        }
                    }
                    closest.offer(&squares, k as f64);
                }
            }
            let mut gap = f64::INFINITY;
            for (lane, i) in here.enumerate() {
                let (own, other) = (closest.squares[lane].sqrt(), closest.seconds[lane].sqrt());
                gap = gap.min(other * (1.0 - ROUNDING) - own);
                let (old, new) = (self.labels[i], index_of(closest.labels[lane]));
                if old != new {
                    changed = true;
                    self.pass_on(i, old, new);
                }
            }
            self.limits[block] = (self.drift + gap) * (1.0 - ROUNDING);
        }
        changed
    }

    /// Point `i` goes from one centre to another.
    fn pass_on(&mut self, i: usize, old: usize, new: usize) {
        let (dims, row) = (self.points.dims(), self.points.point(i));
        if let Some(count) = self.counts.get_mut(old) {
            *count -= 1;
            for (sum, x) in self.sums[old * dims..].iter_mut().zip(row) {
                *sum -= x;
            }
        }
        self.counts[new] += 1;
        for (sum, x) in self.sums[new * dims..].iter_mut().zip(row) {
            *sum += x;
        }
        self.labels[i] = new;
    }

    /// The sums, afresh.
    fn sum(&mut self) {
        let dims = self.points.dims();
        self.sums.fill(0.0);
        for (row, &label) in self.points.values().chunks_exact(dims).zip(&self.labels) {
            for (sum, x) in self.sums[label * dims..].iter_mut().zip(row) {
                *sum += x;
            }
        }
    }

    /// Moves the centres to the means, and says whether any has moved. Empty ones are taken out, of the labels too.
    fn centre(&mut self) -> bool {
        if self.counts.contains(&0) {
            self.drop_empty();
        }
        let dims = self.points.dims();
        let mut largest = 0.0_f64;
        let means = self.sums.chunks_exact(dims).zip(&self.counts);
        for (centre, (sum, &count)) in self.centres.chunks_exact_mut(dims).zip(means) {
            let mut square = 0.0;
            for (x, sum) in centre.iter_mut().zip(sum) {
                let mean = sum / count as f64;
                square += (mean - *x) * (mean - *x);
                *x = mean;
            }
            largest = largest.max(square);
        }
        self.drift = (self.drift + 2.0 * largest.sqrt()) * (1.0 + ROUNDING);
        largest > 0.0
    }

    fn drop_empty(&mut self) {
        let dims = self.points.dims();
        let mut names = vec![0; self.counts.len()];
        let mut kept = 0;
        for (old, name) in names.iter_mut().enumerate() {
            *name = kept;
            if self.counts[old] > 0 {
                self.counts[kept] = self.counts[old];
                self.sums.copy_within(old * dims..(old + 1) * dims, kept * dims);
                self.centres.copy_within(old * dims..(old + 1) * dims, kept * dims);
                kept += 1;
            }
        }
        self.counts.truncate(kept);
        self.sums.truncate(kept * dims);
        self.centres.truncate(kept * dims);
        for label in &mut self.labels {
            *label = names[*label];
        }
    }
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

/// The first centres, row by row.
fn seeds(points: &Points, k: usize, stream: &mut Stream) -> Vec<f64> {
    let n = points.len();
    let mut centres = Vec::with_capacity(k * points.dims());
    let indices: Vec<usize> = (0..n).collect();
    let mut nearest = vec![f64::INFINITY; n];
    let mut total = 0.0;
    for number in 0..k {
        ahead(n);
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
