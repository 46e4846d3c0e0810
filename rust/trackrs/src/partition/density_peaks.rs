//! Clustering by fast search and find of density peaks: a peak is dense, and far from everything denser.
//!
//! | symbol | name here        | shape | meaning                                                                  |
//! |--------|------------------|-------|--------------------------------------------------------------------------|
//! | d_c    | `d_c`            |       | scale of the density                                                     |
//! | ρ      | `rho`            | n     | density                                                                  |
//! | δ      | `delta`          | n     | distance to the nearest denser point; of the densest: to the farthest    |
//! | nn     | `nearest_denser` | n     | that point                                                               |
//! | γ      | `gamma`          | n     | ρ δ                                                                      |
//! | κ      | [`Peaks::Distance`] |    | a peak has δ > κ d_c                                                     |
//!
//! Equations, in the order of the code:
//!
//! 1. ρ_i = Σ_{j≠i} exp(−(d_ij/d_c)²), or #{j ≠ i: d_ij < d_c}. Denser: larger ρ, ties lower index.
//! 2. δ_i = min d_ij over denser j, ties the denser one; γ = ρ δ.
//! 3. Peaks by descending γ, ties the denser: a given number; or so many that γ_(i)/γ_(i+1) is largest, i ≤ √n; or all with
//!    δ > κ d_c, and the densest.
//! 4. In the order of density every point takes the label of nn; a link longer than `max_link` d_c starts a cell instead.
//!
//! Only ρ, δ and nn are kept: O(n). Terms of the Gaussian sum that together stay below 10⁻¹⁷ of it are left out.
//!
//! Reference: Rodriguez, Laio 2014; spec 6.5. The distance rule and `max_link` are ours.

use super::index::{Index, square_of_bound};
use super::points::{Partition, Points};
use super::{Partitioner, all_labelled, quantile};
use crate::error::{Error, Result, require_non_negative, require_positive};
use crate::threads::each_point;
use serde::{Deserialize, Serialize};

/// Beyond this argument exp(−x) is zero.
const UNDERFLOW: f64 = 745.2;
/// ln 10¹⁷.
const NEGLIGIBLE: f64 = 39.2;

/// How d_c is found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Scale {
    /// It is the effective standard deviation of the points' noise.
    Deviation,
    /// It is given.
    Length(f64),
    /// This percentage of all distances is shorter.
    Percent(f64),
}

/// How a neighbour adds to the density.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kernel {
    /// By exp(−(d/d_c)²).
    Gaussian,
    /// By one if nearer than d_c.
    Cutoff,
}

/// Which points are peaks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Peaks {
    /// So many, those of largest γ.
    Count(usize),
    /// Those before the largest gap in γ.
    Gap,
    /// Those with δ beyond so many d_c.
    Distance(f64),
}

/// Partition by density peaks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DensityPeakPartition {
    /// How d_c is found.
    pub scale: Scale,
    /// How a neighbour adds to the density.
    pub kernel: Kernel,
    /// Which points are peaks.
    pub peaks: Peaks,
    /// Longest link to a denser point, in d_c; none: any.
    pub max_link: Option<f64>,
}

impl Default for DensityPeakPartition {
    fn default() -> Self {
        Self {
            scale: Scale::Deviation,
            kernel: Kernel::Gaussian,
            peaks: Peaks::Distance(2.0),
            max_link: None,
        }
    }
}

/// The decision graph and what follows from it.
#[derive(Debug, Clone, PartialEq)]
pub struct DensityPeaks {
    /// Scale of the density.
    pub d_c: f64,
    /// Density of every point.
    pub rho: Vec<f64>,
    /// Distance of every point to its nearest denser one.
    pub delta: Vec<f64>,
    /// ρ δ of every point.
    pub gamma: Vec<f64>,
    /// The nearest denser point of every point; none of the densest.
    pub nearest_denser: Vec<Option<usize>>,
    /// The points by descending density.
    pub order: Vec<usize>,
    /// The peaks by descending γ; cell i is that of peak i. Cells that a long link has started follow.
    pub peaks: Vec<usize>,
    /// The cell of every point.
    pub labels: Vec<usize>,
    /// How many cells there are.
    pub cells: usize,
}

impl DensityPeakPartition {
    /// Every step: densities, distances, peaks and cells.
    pub fn explain(&self, points: &Points) -> Result<DensityPeaks> {
        self.explain_indexed(&Index::new(points))
    }

    pub(crate) fn explain_indexed(&self, index: &Index<'_>) -> Result<DensityPeaks> {
        self.check()?;
        let d_c = self.scale(index)?;
        let rho = densities(index, d_c, self.kernel);
        // Densities are not negative, so their bits are in their order.
        let mut keys: Vec<(u64, usize)> = rho.iter().map(|rho| !rho.to_bits()).zip(0..).collect();
        keys.sort_unstable();
        let order: Vec<usize> = keys.iter().map(|&(_, i)| i).collect();
        let Links { delta, nearest_denser } = links(index, &order);
        let gamma: Vec<f64> = rho.iter().zip(&delta).map(|(rho, delta)| rho * delta).collect();
        let peaks = self.choose(&order, &delta, &gamma, d_c);
        let mut found = DensityPeaks {
            d_c,
            rho,
            delta,
            gamma,
            nearest_denser,
            order,
            labels: Vec::new(),
            cells: peaks.len(),
            peaks,
        };
        self.assign(&mut found);
        Ok(found)
    }

    fn check(&self) -> Result<()> {
        match self.scale {
            Scale::Deviation => {}
            Scale::Length(d_c) => require_positive("d_c", d_c)?,
            Scale::Percent(percent) if percent > 0.0 && percent <= 100.0 => {}
            Scale::Percent(percent) => {
                return Err(Error::invalid("percent", percent, "must lie above 0 and not above 100"));
            }
        }
        match self.peaks {
            Peaks::Count(0) => return Err(Error::invalid("peaks", 0, "must be at least 1")),
            Peaks::Distance(kappa) => require_non_negative("peak_distance", kappa)?,
            _ => {}
        }
        self.max_link.map_or(Ok(()), |link| require_positive("max_link", link))
    }

    fn scale(&self, index: &Index<'_>) -> Result<f64> {
        match (self.scale, index.points.deviation()) {
            (Scale::Length(d_c), _) => Ok(d_c),
            (Scale::Percent(percent), _) => Ok(quantile::distance(index, percent)),
            (Scale::Deviation, Some(deviation)) => Ok(deviation),
            (Scale::Deviation, None) => Err(Error::invalid(
                "d_c",
                "none",
                "must be given, or percent, where there is no noise",
            )),
        }
    }

    fn choose(&self, order: &[usize], delta: &[f64], gamma: &[f64], d_c: f64) -> Vec<usize> {
        // γ is not negative; ties stay in the order of density.
        let mut keys: Vec<(u64, usize)> = order.iter().map(|&i| !gamma[i].to_bits()).zip(0..).collect();
        if let Peaks::Count(count) = self.peaks
            && count < keys.len()
        {
            keys.select_nth_unstable(count);
            keys.truncate(count);
        }
        keys.sort_unstable();
        let mut peaks: Vec<usize> = keys.iter().map(|&(_, rank)| order[rank]).collect();
        match self.peaks {
            Peaks::Count(_) => {}
            Peaks::Gap => peaks.truncate(before_gap(&peaks, gamma)),
            Peaks::Distance(kappa) => {
                let densest = order.first().copied();
                peaks.retain(|&i| delta[i] > kappa * d_c || Some(i) == densest);
            }
        }
        peaks
    }

    fn assign(&self, found: &mut DensityPeaks) {
        const NONE: usize = usize::MAX;
        found.labels = vec![NONE; found.rho.len()];
        for (label, &peak) in found.peaks.iter().enumerate() {
            found.labels[peak] = label;
        }
        let longest = self.max_link.map_or(f64::INFINITY, |link| link * found.d_c);
        for &i in &found.order {
            if found.labels[i] != NONE {
                continue;
            }
            found.labels[i] = match found.nearest_denser[i] {
                Some(denser) if found.delta[i] <= longest => found.labels[denser],
                _ => {
                    found.cells += 1;
                    found.cells - 1
                }
            };
        }
    }
}

impl Partitioner for DensityPeakPartition {
    fn partitions(&self, points: &Points) -> Result<Vec<Partition>> {
        let found = self.explain(points)?;
        Ok(vec![Partition::from_labels(&found.labels, found.cells)])
    }

    fn labels(&self, points: &Points) -> Result<Vec<Option<usize>>> {
        Ok(all_labelled(&self.explain(points)?.labels))
    }
}

/// How many of the peaks stand before the largest ratio of one γ to the next.
fn before_gap(peaks: &[usize], gamma: &[f64]) -> usize {
    let (mut best, mut count) = (0.0, peaks.len().min(1));
    for (i, pair) in peaks.windows(2).enumerate() {
        let (above, below) = (gamma[pair[0]], gamma[pair[1]]);
        if (i + 1) * (i + 1) > peaks.len() || above == 0.0 {
            break;
        }
        if above / below > best {
            (best, count) = (above / below, i + 1);
        }
    }
    count
}

fn densities(index: &Index<'_>, d_c: f64, kernel: Kernel) -> Vec<f64> {
    // Not zero, lest coincident points give 0/0.
    let squared = (d_c * d_c).max(f64::MIN_POSITIVE);
    let bound = square_of_bound(d_c);
    // In the order of the index, so that one query finds in the caches what the last one has read.
    let sorted = each_point(index.order.len(), 0.0, |at| {
        let i = index.order[at];
        match kernel {
            // A point is nearer than d_c to itself.
            Kernel::Cutoff => {
                let near = index.count(index.points.point(i), usize::MAX, |d2| d2 < bound);
                near.saturating_sub(1) as f64
            }
            Kernel::Gaussian => gaussian_density(index, i, squared),
        }
    });
    let mut rho = vec![0.0; sorted.len()];
    for (&i, density) in index.order.iter().zip(sorted) {
        rho[i] = density;
    }
    rho
}

fn gaussian_density(index: &Index<'_>, i: usize, squared: f64) -> f64 {
    let query = index.points.point(i);
    let n = index.points.len() as f64;
    let (mut sum, mut limit) = (0.0, UNDERFLOW);
    index.descend(query, |node, reach| {
        if reach.nearest > limit * squared {
            return false;
        }
        if reach.nearest == reach.farthest {
            // All of these coincide; where they are at distance zero, the point is one of them.
            let count = index.nodes[node].range.len() as f64;
            sum += if reach.nearest == 0.0 {
                count - 1.0
            } else {
                count * libm::exp(-reach.nearest / squared)
            };
        } else if index.is_leaf(node) {
            for (at, d2) in index.members(node, query) {
                if index.order[at] != i {
                    sum += libm::exp(-d2 / squared);
                }
            }
        } else {
            return true;
        }
        if sum > 0.0 {
            limit = UNDERFLOW.min(NEGLIGIBLE + libm::log(n / sum));
        }
        false
    });
    sum
}

struct Links {
    delta: Vec<f64>,
    nearest_denser: Vec<Option<usize>>,
}

/// The nearest denser point of every point. A node whose densest point is not denser is skipped.
fn links(index: &Index<'_>, order: &[usize]) -> Links {
    let n = order.len();
    // Ranks as numbers that can be compared in the lanes of the distances.
    let mut ranks = vec![0.0; n];
    for (rank, &i) in order.iter().enumerate() {
        ranks[i] = rank as f64;
    }
    // Ranks in the order of the index, and the least in every node; children stand behind their parents.
    let sorted: Vec<f64> = index.order.iter().map(|&i| ranks[i]).collect();
    let mut least = vec![f64::INFINITY; index.nodes.len()];
    for (node, content) in index.nodes.iter().enumerate().rev() {
        least[node] = match content.second {
            Some(second) => least[node + 1].min(least[second]),
            None => sorted[content.range.clone()]
                .iter()
                .copied()
                .fold(f64::INFINITY, f64::min),
        };
    }
    let found = each_point(n, (0.0, None), |at| {
        let (query, rank) = (index.points.point(index.order[at]), sorted[at]);
        if rank == 0.0 {
            return (libm::sqrt(index.farthest(query)), None);
        }
        let mut best = (f64::INFINITY, f64::INFINITY, None);
        index.descend(query, |node, reach| {
            if least[node] >= rank || reach.nearest > best.0 {
                return false;
            }
            if index.is_leaf(node) {
                index.scan(node, query, |first, squares| {
                    let ranks = &sorted[first..first + squares.len()];
                    // Most leaves bring nothing nearer, which the lanes tell.
                    let mut nearer = false;
                    for (&d2, &other) in squares.iter().zip(ranks) {
                        nearer |= other < rank && d2 <= best.0;
                    }
                    if !nearer {
                        return;
                    }
                    for (lane, (&d2, &other)) in squares.iter().zip(ranks).enumerate() {
                        if other < rank && (d2, other) < (best.0, best.1) {
                            best = (d2, other, Some(index.order[first + lane]));
                        }
                    }
                });
            }
            true
        });
        (libm::sqrt(best.0), best.2)
    });
    let mut out = Links {
        delta: vec![0.0; n],
        nearest_denser: vec![None; n],
    };
    for (&i, (delta, nearest_denser)) in index.order.iter().zip(found) {
        (out.delta[i], out.nearest_denser[i]) = (delta, nearest_denser);
    }
    out
}
