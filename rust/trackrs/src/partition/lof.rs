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
//! Neighbours are found anew in every step rather than kept, so memory is O(n) whatever k.
//!
//! Reference: Breunig, Kriegel, Ng, Sander 2000; spec 6.4. scikit-learn adds 10⁻¹⁰ to the mean of reach; we do not.

use serde::{Deserialize, Serialize};
use std::collections::BinaryHeap;

use super::index::Index;
use super::points::Points;
use crate::error::{Error, Result, require_positive};

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

/// How far the neighbours of a point reach: among those at `distance_squared` only indices up to `last` count.
#[derive(Debug, Clone, Copy)]
struct Neighbourhood {
    distance_squared: f64,
    last: usize,
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
        let mut nearest = BinaryHeap::new();
        let around: Vec<Neighbourhood> = (0..n).map(|i| self.neighbourhood(&index, i, k, &mut nearest)).collect();
        let k_distance: Vec<f64> = around.iter().map(|a| libm::sqrt(a.distance_squared)).collect();
        let mut density = vec![f64::INFINITY; n];
        for (i, lrd) in density.iter_mut().enumerate() {
            let mut reach = Mean::default();
            if around[i].distance_squared > 0.0 {
                each_neighbour(&index, i, around[i], |j, d2| {
                    reach.add(libm::sqrt(d2).max(k_distance[j]));
                });
                *lrd = 1.0 / reach.value();
            }
        }
        let factor = |i: usize| {
            if around[i].distance_squared == 0.0 {
                return 1.0;
            }
            let mut ratios = Mean::default();
            each_neighbour(&index, i, around[i], |j, _| ratios.add(ratio(density[j], density[i])));
            ratios.value()
        };
        Ok(OutlierFactors {
            factors: (0..n).map(factor).collect(),
            k_distance,
            reachability_density: density,
        })
    }

    /// The points that are no clutter, ascending.
    pub fn inliers(&self, points: &Points) -> Result<Vec<usize>> {
        let found = self.explain(points)?;
        Ok((0..points.len())
            .filter(|&i| found.factors[i] <= self.threshold)
            .collect())
    }

    /// The k nearest other points of point `i`, as their bound; `nearest` is memory to use.
    fn neighbourhood(&self, index: &Index<'_>, i: usize, k: usize, nearest: &mut Nearest) -> Neighbourhood {
        nearest.clear();
        let query = index.points.point(i);
        index.descend(query, |node, reach| {
            // Squared distances are not negative, so their bits are in their order.
            if nearest.len() == k && nearest.peek().is_none_or(|worst| reach.nearest.to_bits() > worst.0) {
                return false;
            }
            if index.is_leaf(node) {
                for (at, d2) in index.members(node, query) {
                    let found = (d2.to_bits(), index.order[at]);
                    if found.1 == i {
                        continue;
                    }
                    if nearest.len() < k {
                        nearest.push(found);
                    } else if let Some(mut worst) = nearest.peek_mut()
                        && found < *worst
                    {
                        *worst = found;
                    }
                }
            }
            true
        });
        let &(bits, last) = nearest.peek().unwrap_or(&(0, 0));
        Neighbourhood {
            distance_squared: f64::from_bits(bits),
            last: if self.include_ties { usize::MAX } else { last },
        }
    }
}

/// The nearest points found so far, bits of the squared distance and index, the worst on top.
type Nearest = BinaryHeap<(u64, usize)>;

fn each_neighbour(index: &Index<'_>, i: usize, around: Neighbourhood, mut visit: impl FnMut(usize, f64)) {
    index.within(index.points.point(i), around.distance_squared, |j, d2| {
        if j != i && (d2 < around.distance_squared || j <= around.last) {
            visit(j, d2);
        }
    });
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
