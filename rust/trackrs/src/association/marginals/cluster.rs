//! One cluster: tracks that share reports, directly or through others, with weights that neither over- nor underflow.
//!
//! | symbol | name here   | meaning                                                                        |
//! |--------|-------------|--------------------------------------------------------------------------------|
//! | a_i    | `misses`    | weight of track i taking none of the shared reports                            |
//! | w_ij   | `Link::weight` | weight of track i taking shared report j                                    |
//! | c_j    | `unused`    | weight of report j being nobody's                                              |
//! | u, v   | `Assignment` | dual solution of the best joint event                                         |
//!
//! 1. A report that only one track gates excludes nobody else: a_i = (missed) + Σ (its own such reports). Afterwards
//!    P(a_i) is shared out among them in the same ratio.
//! 2. Scaling of a row multiplies every joint event alike, and so does scaling of a column together with c_j. By rows:
//!    every row is divided by its largest weight, c_j = 1. By duals: a_i e^{u_i}, w_ij e^{u_i + v_j}, c_j = e^{v_j} for
//!    the costs −ln of the weights. No weight exceeds 1 and the best joint event has weight 1, so that what underflows
//!    is less than 1e-300 of the total, whatever the weights were.
//!
//! u and v are rounded to whole numbers: any u, v scale rightly, and with these the exponents are exact.

use super::Method;
use super::weights::Weights;
use crate::association::assignment::assign_with_misses;
use crate::error::{Error, Result};

/// A track and a report that it shares with others.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    /// Track of the cluster.
    pub(super) track: usize,
    /// Shared report of the cluster.
    pub(super) report: usize,
    pub(super) weight: f64,
    /// Position among the candidates of all tracks.
    pub(super) place: usize,
}

/// The weight of the alternatives that only concern one track.
#[derive(Debug, Clone, Copy)]
struct Own {
    /// The largest of them, as the user gave it.
    largest: f64,
    /// Their sum, as a multiple of the largest.
    sum: f64,
}

/// A cluster, scaled.
#[derive(Debug)]
pub(super) struct Cluster {
    /// Tracks of the scan.
    pub(super) tracks: Vec<usize>,
    /// Number of shared reports.
    pub(super) reports: usize,
    pub(super) misses: Vec<f64>,
    pub(super) unused: Vec<f64>,
    /// Track by track.
    pub(super) links: Vec<Link>,
    /// ln of what the scaled total is to be multiplied with.
    pub(super) log_scale: f64,
    own: Vec<Own>,
}

/// Costs −ln w of a cluster.
#[derive(Debug)]
pub(super) struct Costs {
    /// (tracks, shared reports), row-major.
    pub(super) pairs: Vec<f64>,
    /// Of taking no shared report. A track that must take one does without only where there is no other way: at a cost
    /// above that of all pairs together.
    pub(super) misses: Vec<f64>,
    /// Whether the track can go without a shared report.
    pub(super) can_miss: Vec<bool>,
}

/// Marginals of one cluster, before own reports are shared out.
#[derive(Debug)]
pub(super) struct Solution {
    /// Per link.
    pub(super) links: Vec<f64>,
    /// Per track: it takes none of the shared reports.
    pub(super) missed: Vec<f64>,
    /// ln of the sum over joint events of the scaled weights.
    pub(super) log_total: f64,
    pub(super) method: Method,
    /// Share of the weight that is not in the sums, at most.
    pub(super) error_bound: Option<f64>,
}

impl Cluster {
    /// `sharers[report]` is the number of tracks that gate it; `local` is scratch space of one number per report.
    pub(super) fn new(weights: &Weights, tracks: Vec<usize>, sharers: &[u32], local: &mut [usize]) -> Self {
        let mut reports = 0;
        let mut links = Vec::with_capacity(tracks.iter().map(|&track| weights.candidates(track).len()).sum());
        let mut own = Vec::with_capacity(tracks.len());
        let mut log_scale = 0.0;
        let mut misses = Vec::with_capacity(tracks.len());
        for &track in &tracks {
            for candidate in weights.candidates(track) {
                local[candidate.report] = usize::MAX;
            }
        }
        for (index, &track) in tracks.iter().enumerate() {
            let row = weights.candidates(track);
            let is_own = |report: usize| sharers[report] == 1;
            let mut largest_own = weights.miss(track);
            let mut largest = largest_own;
            for candidate in row {
                largest = largest.max(candidate.weight);
                if is_own(candidate.report) {
                    largest_own = largest_own.max(candidate.weight);
                }
            }
            let mut sum = weights.ratio(weights.miss(track), largest_own);
            for (candidate, place) in row.iter().zip(weights.row(track)) {
                if is_own(candidate.report) {
                    sum += weights.ratio(candidate.weight, largest_own);
                    continue;
                }
                let report = &mut local[candidate.report];
                if *report == usize::MAX {
                    *report = reports;
                    reports += 1;
                }
                links.push(Link {
                    track: index,
                    report: *report,
                    weight: weights.ratio(candidate.weight, largest),
                    place,
                });
            }
            misses.push(weights.ratio(largest_own, largest) * sum);
            own.push(Own {
                largest: largest_own,
                sum,
            });
            log_scale += weights.log(largest);
        }
        Self {
            unused: vec![1.0; reports],
            tracks,
            reports,
            misses,
            links,
            log_scale,
            own,
        }
    }

    /// −ln of the weights, as [`assign_with_misses`] takes them.
    pub(super) fn costs(&self, weights: &Weights) -> Costs {
        let mut pairs = vec![f64::INFINITY; self.tracks.len() * self.reports];
        let mut barred = 1.0;
        for link in &self.links {
            let cost = -weights.log(weights.all()[link.place].weight);
            pairs[link.track * self.reports + link.report] = cost;
            barred += 2.0 * cost.abs();
        }
        let mut misses = Vec::with_capacity(self.own.len());
        for own in &self.own {
            if own.largest == weights.zero() {
                misses.push(f64::INFINITY);
                continue;
            }
            let cost = -(weights.log(own.largest) + libm::log(own.sum));
            misses.push(cost);
            barred += 2.0 * cost.abs();
        }
        let can_miss = misses.iter().map(|&cost| cost < f64::INFINITY).collect();
        for cost in &mut misses {
            *cost = cost.min(barred);
        }
        Costs {
            pairs,
            misses,
            can_miss,
        }
    }

    /// Scales anew, by duals.
    pub(super) fn rescale(&mut self, weights: &Weights) -> Result<()> {
        let columns = self.reports;
        let costs = self.costs(weights);
        let best = assign_with_misses(&costs.pairs, self.tracks.len(), columns, &costs.misses)?;
        for (row, column) in best.row_to_column.iter().enumerate() {
            if column.is_none() && !costs.can_miss[row] {
                return Err(self.impossible());
            }
        }
        let round = |duals: &[f64]| duals.iter().map(|d| libm::round(*d)).collect::<Vec<f64>>();
        let (u, v) = (round(&best.row_duals), round(&best.column_duals));
        for link in &mut self.links {
            let cost = costs.pairs[link.track * columns + link.report];
            link.weight = libm::exp((u[link.track] - cost) + v[link.report]);
        }
        for (row, own) in self.own.iter().enumerate() {
            self.misses[row] = if costs.can_miss[row] {
                libm::exp(weights.log(own.largest) + u[row]) * own.sum
            } else {
                0.0
            };
        }
        self.unused = v.iter().map(|v| libm::exp(*v)).collect();
        self.log_scale = -u.iter().sum::<f64>() - v.iter().sum::<f64>();
        Ok(())
    }

    /// The error for a cluster without a possible joint event.
    pub(super) fn impossible(&self) -> Error {
        let requirement = "no joint event is possible: tracks that cannot be missed outnumber their reports";
        Error::invalid("weights of tracks", format!("{:?}", self.tracks), requirement)
    }

    /// Writes the marginals of a solution to those of the scan.
    pub(super) fn write(&self, weights: &Weights, solution: &Solution, sharers: &[u32], out: &mut super::Marginals) {
        for (link, &probability) in self.links.iter().zip(&solution.links) {
            // Sums of probabilities are rounded.
            out.candidates[link.place] = probability.min(1.0);
        }
        for ((&track, own), &probability) in self.tracks.iter().zip(&self.own).zip(&solution.missed) {
            if probability == 0.0 {
                continue;
            }
            let unit = probability / own.sum;
            out.missed[track] = (unit * weights.ratio(weights.miss(track), own.largest)).min(1.0);
            for place in weights.row(track) {
                let candidate = weights.all()[place];
                if sharers[candidate.report] == 1 {
                    out.candidates[place] = (unit * weights.ratio(candidate.weight, own.largest)).min(1.0);
                }
            }
        }
    }
}
