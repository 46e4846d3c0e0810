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
//! summed, must reach what its second nearest centre was farther away than its own at the last look. Points are looked at
//! in blocks; many of them are put in the order of that gap first, so that those between two centres share blocks.
//!
//! The run of K draws from stream (seed, K), so that it does not depend on the range.
//!
//! Reference: Arthur, Vassilvitskii 2007; Lloyd 1982; G. Hamerly, *Making k-means even faster*, SDM 2010, for the bounds;
//! spec 6.2.

mod seeds;

use self::seeds::seeds;
use super::points::{Partition, Points};
use super::{Partitioner, all_labelled, require_few};
use crate::error::{Error, Result};
use crate::interrupt::ahead;
use crate::lanes::Level;
use crate::stats::stream::Stream;
use pulp::{Simd, WithSimd};
use serde::{Deserialize, Serialize};

const MAX_ITERATIONS: usize = 100;
/// More than what the roundings of one step can do to a bound, relative.
const ROUNDING: f64 = 1e-12;
/// Points that are labelled at once.
const LANES: usize = 8;
/// So many points are put in order: fewer are labelled before that would be done.
const MANY: usize = 1024;
/// Gaps are ordered by the leading bits of a 32-bit number, but for the sign: exponent and four more.
const LEADING: u32 = 12;
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
        axes: Vec::new(),
        order: (0..points.len()).collect(),
        gaps: vec![[0.0; LANES]; points.len().div_ceil(LANES)],
        names: vec![[f64::NAN; LANES]; points.len().div_ceil(LANES)],
        labels: vec![usize::MAX; points.len()],
        sums: vec![0.0; centres.len()],
        counts: vec![0; centres.len() / dims],
        centres,
        limits: vec![0.0; points.len().div_ceil(LANES)],
        drift: 0.0,
    };
    lloyd.gather();
    for iteration in 0..MAX_ITERATIONS {
        if iteration == 1 && points.len() >= MANY {
            lloyd.sort();
        }
        if !arch.dispatch(Relabel(&mut lloyd)) {
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
    /// The points in the order in which they stand in blocks.
    order: Vec<usize>,
    /// Their coordinates axis by axis, so that the same entry of several points stands in one register.
    axes: Vec<f64>,
    /// In the same order, what their second nearest centre was farther away than their own at the last look, and their
    /// labels as numbers; in the last block anything behind the last point.
    gaps: Vec<[f64; LANES]>,
    names: Vec<[f64; LANES]>,
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

/// One pass over the points, compiled for every level.
struct Relabel<'a, 'b>(&'a mut Lloyd<'b>);

impl WithSimd for Relabel<'_, '_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> bool {
        self.0.relabel()
    }
}

impl Lloyd<'_> {
    /// Puts coordinates and names in order.
    fn gather(&mut self) {
        let (points, order) = (self.points, &self.order);
        self.axes.clear();
        for axis in 0..points.dims() {
            self.axes.extend(order.iter().map(|&i| points.point(i)[axis]));
        }
        for (name, &i) in self.names.as_flattened_mut().iter_mut().zip(order) {
            *name = self.labels[i] as f64;
        }
    }

    /// Puts the points in the order of their gaps, roughly, and finds the limits of the blocks anew. All have just been
    /// looked at, at a drift of 0.
    fn sort(&mut self) {
        let key = |gap: f64| {
            // A gap that is negative by rounding is none; the sign is 0.
            #[allow(clippy::cast_possible_truncation)]
            let narrow = gap.max(0.0) as f32;
            (narrow.to_bits() >> (31 - LEADING)) as usize
        };
        let all = self.gaps.as_flattened();
        let mut places = vec![0; (1 << LEADING) + 1];
        for &gap in &all[..self.order.len()] {
            places[key(gap) + 1] += 1;
        }
        for k in 0..1 << LEADING {
            places[k + 1] += places[k];
        }
        let (mut order, mut gaps) = (vec![0; self.order.len()], self.gaps.clone());
        for (&i, &gap) in self.order.iter().zip(all) {
            let place = &mut places[key(gap)];
            (order[*place], gaps.as_flattened_mut()[*place]) = (i, gap);
            *place += 1;
        }
        (self.order, self.gaps) = (order, gaps);
        self.gather();
        for (limit, gaps) in self.limits.iter_mut().zip(&self.gaps) {
            *limit = gaps.iter().copied().fold(f64::INFINITY, f64::min) * (1.0 - ROUNDING);
        }
    }

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
            let mut least = f64::INFINITY;
            let mut same = true;
            for lane in 0..LANES {
                let gap = closest.seconds[lane].sqrt() * (1.0 - ROUNDING) - closest.squares[lane].sqrt();
                self.gaps[block][lane] = gap;
                least = if gap < least { gap } else { least };
                same &= closest.labels[lane] == self.names[block][lane];
            }
            self.limits[block] = (self.drift + least) * (1.0 - ROUNDING);
            if !same {
                self.names[block] = closest.labels;
                for (lane, place) in here.enumerate() {
                    changed |= self.pass_on(self.order[place], index_of(closest.labels[lane]));
                }
            }
        }
        changed
    }

    /// Point `i` goes to this centre; whether it was at another one.
    fn pass_on(&mut self, i: usize, new: usize) -> bool {
        let (dims, row, old) = (self.points.dims(), self.points.point(i), self.labels[i]);
        if old == new {
            return false;
        }
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
        true
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
        self.gather();
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
