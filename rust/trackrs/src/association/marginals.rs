//! Joint association: with what probability each track has each report, given that no report is of two tracks.
//!
//! | symbol | name here       | meaning                                                                          |
//! |--------|-----------------|----------------------------------------------------------------------------------|
//! | w_i0   | `miss`          | weight of track i having no report: 1 − P_D P_G                                   |
//! | w_ij   | `Candidate::weight` | weight of track i having report j, against clutter: P_D f_ij / λ              |
//! | e      |                 | joint event: track → 0 or a report, no report twice                               |
//! | W      | `log_total`     | Σ_e w(e)                                                                          |
//! | β_ij   | `candidates`, `missed` | marginal Σ_{e(i)=j} w(e) / W                                               |
//!
//! 1. w(e) = Π_i w_{i,e(i)}, and β as above (spec N19; docs/association.md has the derivation).
//! 2. Tracks that share no report, not even through others, are independent: W is the product over such clusters.
//! 3. In each cluster the sums are taken exactly, over subsets of the frontier (`subsets`).
//! 4. A cluster that needs more transitions than the budget: the best joint events in order (`m_best`) if these hold
//!    all but 1 % of W, which a bound proves; else belief propagation (`belief`), which has no bound.
//! 5. Asked for, pruned: of the joint events that use the same tracks and the same reports only the most likely counts
//!    (`pruned`), so that tracks do not coalesce.
//!
//! References: T. E. Fortmann, Y. Bar-Shalom, M. Scheffe, Sonar tracking of multiple targets using joint probabilistic
//! data association, IEEE J. Ocean. Eng. 8(3), 1983; J. L. Williams, R. A. Lau, Approximate evaluation of marginal
//! association probabilities with belief propagation, IEEE Trans. Aerosp. Electron. Syst. 50(4), 2014; H. A. P. Blom,
//! E. A. Bloem, Probabilistic data association avoiding track coalescence, IEEE Trans. Autom. Control 45(2), 2000.

mod belief;
mod cluster;
mod frontier;
mod lattice;
mod m_best;
mod pruned;
mod subsets;
mod weights;

use crate::error::Result;
use cluster::{Cluster, Solution};
pub use weights::{Candidate, Domain, Weights};

/// How the marginals were found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Method {
    /// Sum over all joint events.
    Exact,
    /// Sum over the most likely joint events.
    MBest,
    /// Loopy belief propagation.
    Belief,
}

/// What is computed, and what it may cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Transitions that the exact sum of one cluster may take; its memory is at most 16 bytes each.
    pub budget: usize,
    /// Whether of the joint events of the same tracks and reports only the most likely counts.
    pub prune: bool,
}

impl Default for Options {
    /// Some 20 ms for one cluster.
    fn default() -> Self {
        Self {
            budget: 10_000_000,
            prune: false,
        }
    }
}

/// Marginal association probabilities.
#[derive(Debug, Clone, PartialEq)]
pub struct Marginals {
    /// Per track: none of the reports is its own.
    pub missed: Vec<f64>,
    /// Per candidate, track by track; [`Marginals::candidates`] has those of one track.
    candidates: Vec<f64>,
    starts: Vec<usize>,
    /// The least exact method that a cluster needed.
    pub method: Method,
    /// Share of the joint events' weight that is not in the sums, at most; `None` where no bound is known.
    pub error_bound: Option<f64>,
    /// ln of the sum of the weights of all joint events that were summed; an estimate of it by belief propagation.
    pub log_total: f64,
}

impl Marginals {
    /// Probabilities of a track's candidates, in their order.
    pub fn candidates(&self, track: usize) -> &[f64] {
        &self.candidates[self.starts[track]..self.starts[track + 1]]
    }
}

/// The marginals of all joint events.
pub fn marginals(weights: &Weights, options: &Options) -> Result<Marginals> {
    let mut out = Marginals {
        missed: vec![0.0; weights.tracks()],
        candidates: vec![0.0; weights.all().len()],
        starts: weights.starts().to_vec(),
        method: Method::Exact,
        error_bound: Some(0.0),
        log_total: 0.0,
    };
    let mut sharers = vec![0_u32; weights.reports()];
    for candidate in weights.all() {
        sharers[candidate.report] += 1;
    }
    let mut local = vec![0; weights.reports()];
    for tracks in clusters(weights) {
        let mut cluster = Cluster::new(weights, tracks, &sharers, &mut local);
        let solution = solve(&mut cluster, weights, options)?;
        out.log_total += cluster.log_scale + solution.log_total;
        out.method = out.method.max(solution.method);
        out.error_bound = match (out.error_bound, solution.error_bound) {
            (Some(before), Some(bound)) => Some(before + bound - before * bound), // 1 − Π (1 − bound)
            _ => None,
        };
        cluster.write(weights, &solution, &sharers, &mut out);
    }
    Ok(out)
}

fn solve(cluster: &mut Cluster, weights: &Weights, options: &Options) -> Result<Solution> {
    if cluster.links.is_empty() {
        // A single track: its row is scaled so that it cannot overflow, and its largest weight is 1.
        return Ok(Solution {
            links: Vec::new(),
            missed: vec![1.0],
            log_total: libm::log(cluster.misses[0]),
            method: Method::Exact,
            error_bound: Some(0.0),
        });
    }
    if options.prune {
        cluster.rescale(weights)?;
        return match pruned::solve(cluster, options.budget) {
            Some(solution) => Ok(solution),
            None => m_best::pruned(cluster, weights),
        };
    }
    let plan = frontier::plan(cluster);
    if plan.transitions <= options.budget {
        if let Some(solution) = subsets::solve(cluster, &plan) {
            return Ok(solution);
        }
        cluster.rescale(weights)?;
        let plan = frontier::plan(cluster);
        return subsets::solve(cluster, &plan).ok_or_else(|| cluster.impossible());
    }
    cluster.rescale(weights)?;
    let belief = belief::solve(cluster);
    Ok(m_best::solve(cluster, weights, belief.log_total)?.unwrap_or(belief))
}

/// Tracks that share reports, directly or through others.
fn clusters(weights: &Weights) -> Vec<Vec<usize>> {
    let mut first: Vec<usize> = vec![usize::MAX; weights.reports()];
    let mut parent: Vec<usize> = (0..weights.tracks()).collect();
    for track in 0..weights.tracks() {
        for candidate in weights.candidates(track) {
            let other = &mut first[candidate.report];
            if *other == usize::MAX {
                *other = track;
                continue;
            }
            let (a, b) = (root(&mut parent, track), root(&mut parent, *other));
            parent[a.max(b)] = a.min(b);
        }
    }
    let mut sizes = vec![0; weights.tracks()];
    for track in 0..weights.tracks() {
        parent[track] = root(&mut parent, track);
        sizes[parent[track]] += 1;
    }
    // A root is the first track of its cluster; from here on its size stands for the place of the cluster.
    let mut clusters: Vec<Vec<usize>> = Vec::new();
    for (track, &root) in parent.iter().enumerate() {
        if root == track {
            clusters.push(Vec::with_capacity(sizes[root]));
            sizes[root] = clusters.len() - 1;
        }
        clusters[sizes[root]].push(track);
    }
    clusters
}

fn root(parent: &mut [usize], mut node: usize) -> usize {
    while parent[node] != node {
        parent[node] = parent[parent[node]];
        node = parent[node];
    }
    node
}
