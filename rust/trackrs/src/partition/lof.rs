//! Local outlier factor: how much sparser it is at a point than at its neighbours.
//!
//! | symbol      | name here               | shape | meaning                                                    |
//! |-------------|-------------------------|-------|------------------------------------------------------------|
//! | k           | `n_neighbors`           |       | neighbours, at most n − 1                                  |
//! | k-dist(i)   | `k_distance`            | n     | distance to the k-th nearest other point                   |
//! | N_k(i)      |                         |       | the points not farther than k-dist(i), or the k nearest    |
//! | reach(i, j) |                         |       | reachability distance                                      |
//! | lrd         | `reachability_density`  | n     | local reachability density                                 |
//! | LOF         | `factors`               | n     | local outlier factor                                       |
//!
//! Equations, in the order of the code:
//!
//! 1. k-dist(i); N_k(i) = {j ≠ i: d_ij ≤ k-dist(i)}; without ties only k of them, lower indices first.
//! 2. reach(i, j) = max(k-dist(j), d_ij);  lrd(i) = |N_k(i)| / Σ_{j ∈ N_k(i)} reach(i, j).
//! 3. LOF(i) = mean over j ∈ N_k(i) of lrd(j) / lrd(i). A point is clutter if LOF > threshold.
//!
//! More than k coincident points: lrd = ∞, with ∞/∞ = 1, finite/∞ = 0, ∞/finite = ∞. A single point: LOF = 1.
//! Up to `KEPT` neighbours of a point are kept from the first step to the last; if there are more they are found anew in
//! every step, so that memory is O(n) whatever k. Steps go through the points in the order of the index.
//!
//! Reference: Breunig, Kriegel, Ng, Sander 2000; spec 6.4. scikit-learn adds 10⁻¹⁰ to the mean of reach; we do not.

use std::convert::Infallible;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::index::{Index, LEAF};
use super::points::Points;
use crate::error::{Error, Result, require_positive};
use crate::threads::{POINTS, each_point, for_points, share_out};

/// Neighbours that are kept per point.
const KEPT: usize = 32;

/// The outlier factor, and from which value on a point is clutter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LocalOutlierFactor {
    /// k.
    pub n_neighbors: usize,
    /// Points with a larger factor are clutter.
    pub threshold: f64,
    /// Whether all points at k-dist are neighbours.
    pub include_ties: bool,
}

impl Default for LocalOutlierFactor {
    /// Fewer neighbours than the smallest target has measurements, lest it be deleted as a whole.
    fn default() -> Self {
        Self {
            n_neighbors: 4,
            threshold: 2.0,
            include_ties: true,
        }
    }
}

/// Every step of the outlier factor.
#[derive(Debug, Clone, PartialEq)]
pub struct OutlierFactors {
    /// k-dist of every point.
    pub k_distance: Vec<f64>,
    /// lrd of every point.
    pub reachability_density: Vec<f64>,
    /// LOF of every point.
    pub factors: Vec<f64>,
}

impl LocalOutlierFactor {
    /// The factor of every point, and what it is made of.
    pub fn explain(&self, points: &Points) -> Result<OutlierFactors> {
        if self.n_neighbors == 0 {
            return Err(Error::invalid("n_neighbors", 0, "must be at least 1"));
        }
        require_positive("threshold", self.threshold)?;
        let index = Index::new(points);
        let n = points.len();
        let k = self.n_neighbors.min(n.saturating_sub(1));
        let around = Neighbours::new(&index, k, self.include_ties);
        let k_distance: Vec<f64> = around.bounds.iter().map(|bound| libm::sqrt(bound.0)).collect();
        let density = each_point(n, f64::INFINITY, |at| {
            let mut reach = Mean::default();
            if k_distance[at] == 0.0 {
                return f64::INFINITY;
            }
            let query = points.point(index.order[at]);
            around.each(at, |other| {
                let d = libm::sqrt(index.square(other, query));
                reach.add(if d > k_distance[other] { d } else { k_distance[other] });
            });
            1.0 / reach.value()
        });
        let factors = each_point(n, 1.0, |at| {
            let mut ratios = Mean::default();
            if k_distance[at] == 0.0 {
                return 1.0;
            }
            around.each(at, |other| ratios.add(ratio(density[other], density[at])));
            ratios.value()
        });
        let mut out = OutlierFactors {
            k_distance: vec![0.0; n],
            reachability_density: vec![0.0; n],
            factors: vec![1.0; n],
        };
        for (at, &i) in index.order.iter().enumerate() {
            out.k_distance[i] = k_distance[at];
            out.reachability_density[i] = density[at];
            out.factors[i] = factors[at];
        }
        Ok(out)
    }

    /// The points that are no clutter, ascending.
    pub fn inliers(&self, points: &Points) -> Result<Vec<usize>> {
        let found = self.explain(points)?;
        Ok((0..points.len())
            .filter(|&i| found.factors[i] <= self.threshold)
            .collect())
    }
}

/// More than what the roundings of a sum of two distances can do, relative.
const ROUNDING: f64 = 1e-12;
const TINY: f64 = 1e-280;

/// Bits of a squared distance, and the place of that point.
type Found = (u64, usize);

/// The neighbours of every point. Points go by their places in the order of the index.
struct Neighbours<'a> {
    index: &'a Index<'a>,
    /// Squared distance of the farthest neighbour, and the last index that counts at that distance.
    bounds: Vec<(f64, usize)>,
    /// Where the neighbours of a point begin and end in `places`; none where they are not kept.
    kept: Vec<Range<usize>>,
    places: Vec<usize>,
}

/// The same of the points of a part, one after the other in the order of the index.
#[derive(Default)]
struct Part {
    bounds: Vec<(f64, usize)>,
    /// How many of a point are kept.
    counts: Vec<usize>,
    places: Vec<usize>,
}

impl<'a> Neighbours<'a> {
    fn new(index: &'a Index<'a>, k: usize, include_ties: bool) -> Self {
        let n = index.order.len();
        let mut parts: Vec<Part> = (0..n.div_ceil(POINTS)).map(|_| Part::default()).collect();
        let search = Search { index, k, include_ties };
        let Ok(()) = share_out(parts.iter_mut().enumerate(), for_points(n), |(part, out)| {
            search.all(part * POINTS..n.min((part + 1) * POINTS), out);
            Ok::<_, Infallible>(())
        });
        let mut out = Self {
            index,
            bounds: Vec::with_capacity(n),
            kept: Vec::with_capacity(n),
            places: Vec::with_capacity(parts.iter().map(|part| part.places.len()).sum()),
        };
        for part in parts {
            let mut first = out.places.len();
            for count in part.counts {
                out.kept.push(first..first + count);
                first += count;
            }
            out.bounds.extend(part.bounds);
            out.places.extend(part.places);
        }
        out
    }

    /// Calls `visit` with every neighbour of point `at`.
    #[inline(always)]
    fn each(&self, at: usize, mut visit: impl FnMut(usize)) {
        let index = self.index;
        let kept = self.kept[at].clone();
        if !kept.is_empty() {
            self.places[kept].iter().for_each(|&place| visit(place));
            return;
        }
        let query = index.points.point(index.order[at]);
        let (farthest, last) = self.bounds[at];
        index.descend(query, |node, reach| {
            if reach.nearest > farthest {
                return false;
            }
            if index.is_leaf(node) {
                for (place, d2) in index.members(node, query) {
                    if place != at && (d2 < farthest || d2 == farthest && index.order[place] <= last) {
                        visit(place);
                    }
                }
            }
            true
        });
    }
}

/// How neighbours are found.
struct Search<'a> {
    index: &'a Index<'a>,
    k: usize,
    include_ties: bool,
}

impl Search<'_> {
    /// Those of some points. The first one has no point before it that would give it a bound, so that the bits do not depend on
    /// who has looked at that.
    fn all(&self, points: Range<usize>, out: &mut Part) {
        let mut found = Vec::new();
        let mut before = None;
        for at in points {
            let (bound, count) = self.nearest(at, before, &mut found);
            let first = out.places.len();
            if count <= KEPT + 1 {
                let places = found[..count].iter().map(|&(_, place)| place);
                out.places.extend(places.filter(|&place| place != at));
            }
            out.counts.push(out.places.len() - first);
            out.bounds.push(bound);
            before = Some(bound.0);
        }
    }

    /// Puts point `at` and its neighbours first in `found`; returns their bound and how many there are.
    ///
    /// Whatever is not farther than the bound so far is put down, without a branch; when there is a good deal of it, the
    /// k nearest are taken out and give a new bound.
    #[inline(always)]
    fn nearest(&self, at: usize, before: Option<f64>, found: &mut Vec<Found>) -> ((f64, usize), usize) {
        let Self { index, k, include_ties } = *self;
        let query = index.points.point(index.order[at]);
        let mut full = k + 1 + 2 * LEAF;
        let mut count = 0;
        let mut limit = before.map_or(f64::INFINITY, |farthest| self.farthest_at_most(at, farthest, query));
        index.descend(query, |node, reach| {
            // Where more than k points coincide, their neighbours do not matter.
            if reach.nearest > limit || limit == 0.0 {
                return false;
            }
            if index.is_leaf(node) {
                index.scan(node, query, |first, squares| {
                    if limit == 0.0 {
                        return;
                    }
                    if found.len() < count + LEAF {
                        found.resize(count + LEAF, (0, 0));
                    }
                    let mut fresh = 0_usize;
                    if let Some((room, _)) = found[count..].split_first_chunk_mut::<LEAF>() {
                        for (lane, &d2) in squares.iter().enumerate() {
                            room[fresh % LEAF] = (d2.to_bits(), first.wrapping_add(lane));
                            fresh = fresh.wrapping_add(usize::from(d2 <= limit));
                        }
                    }
                    count += fresh;
                    if count > full {
                        count = self.narrow(at, &mut found[..count]);
                        limit = f64::from_bits(found[k].0);
                        // Among many ties there is little to take out.
                        full = full.max(2 * count);
                    }
                });
            }
            true
        });
        count = self.narrow(at, &mut found[..count]);
        let farthest = found[k].0;
        let ties = found[..count]
            .iter()
            .filter(|&&(bits, place)| bits == farthest && place != at);
        let last = ties.map(|&(_, place)| index.order[place]).max().unwrap_or(0);
        let last = if include_ties { usize::MAX } else { last };
        ((f64::from_bits(farthest), last), count)
    }

    /// A squared distance within which point `at` has its k neighbours: those of the point before it in the index, which is
    /// near, are not farther than that point and its farthest one together. Infinite where that says nothing.
    fn farthest_at_most(&self, at: usize, farthest: f64, query: &[f64]) -> f64 {
        let before = at.saturating_sub(1);
        let most = libm::sqrt(farthest) + libm::sqrt(self.index.square(before, query));
        let square = most * most * (1.0 + ROUNDING);
        // Squares so small have lost their digits.
        if square > TINY { square } else { f64::INFINITY }
    }

    /// Puts the k nearest and the point itself first, the farthest of them at `k`; returns how many count.
    fn narrow(&self, at: usize, found: &mut [Found]) -> usize {
        let Self { k, include_ties, .. } = *self;
        // Squared distances are not negative, so their bits are in their order.
        let (_, &mut (farthest, _), beyond) = found.select_nth_unstable_by_key(k, |&(bits, _)| bits);
        if beyond.iter().all(|&(bits, _)| bits > farthest) {
            return k + 1;
        }
        if !include_ties {
            // The point itself is the nearest, or one of them; then lower indices come first.
            found.sort_unstable_by_key(|&(bits, place)| (bits, place != at, self.index.order[place]));
            return k + 1;
        }
        let mut count = k + 1;
        for other in k + 1..found.len() {
            if found[other].0 == farthest {
                found.swap(count, other);
                count += 1;
            }
        }
        count
    }
}

fn ratio(a: f64, b: f64) -> f64 {
    if a == f64::INFINITY && b == f64::INFINITY {
        1.0
    } else {
        a / b
    }
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }

    fn value(&self) -> f64 {
        self.sum / self.count
    }
}
