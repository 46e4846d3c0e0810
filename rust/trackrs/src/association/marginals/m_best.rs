//! Marginals of a cluster from its most likely joint events, with a bound on what the others weigh.
//!
//! | symbol | name here | meaning                                                                     |
//! |--------|-----------|-----------------------------------------------------------------------------|
//! | S      | `seen`    | Σ of the weights of the events enumerated                                   |
//! | N      | node      | one of the disjoint sets of events that the enumeration leaves open          |
//! | Ĉ_N    | `cost`    | least cost −ln w(e) in N, under the duals u, v                              |
//! | R      | `rest`    | bound on Σ of the weights of the events not enumerated                      |
//!
//! 1. Events in the order of their weight ([`k_best`](crate::association::k_best)), S and marginals along the way.
//! 2. In N every event has w(e) = e^{−Ĉ_N} Π_i e^{−r_i} Π_{j free} e^{v_j}, r = C − u − v or μ − u. The last factors are
//!    at most 1, and without exclusion the sum over events is a product of sums over rows:
//!    Σ_{e∈N} w(e) ≤ e^{−Ĉ_N} Π_i Σ_j e^{−r_ij}, over the rows that N leaves open.
//! 3. R is the sum of these bounds; R / (S + R) bounds the share that is missing, and so the error of every marginal.
//!
//! The enumeration is given up before it begins where all its events together cannot reach the total that belief
//! propagation estimates.

use std::collections::HashSet;

use super::Method;
use super::cluster::{Cluster, Costs, Solution};
use super::weights::Weights;
use crate::association::k_best::{Node, Ranked, Ranking, Table};
use crate::error::Result;

/// Events enumerated at most.
const MOST_EVENTS: u32 = 128;
/// Share of the weight that may be missing.
const TOLERANCE: f64 = 0.01;
/// No more events where less than this is missing.
const ENOUGH: f64 = 1e-6;
/// Events enumerated at most where only the best of each set counts.
const MOST_PRUNED: u32 = 1000;

/// `None` where the best events hold too little of the total. `log_estimate` is an estimate of it, ln, scaled.
pub(super) fn solve(cluster: &Cluster, weights: &Weights, log_estimate: f64) -> Result<Option<Solution>> {
    let costs = cluster.costs(weights);
    let mut ranking = Ranking::new(&costs.pairs, cluster.reports, costs.misses.clone())?;
    let log_best = -ranking.open().map(|node| node.cost).sum::<f64>() - cluster.log_scale;
    if log_best + libm::log(f64::from(MOST_EVENTS)) < log_estimate {
        return Ok(None);
    }
    let solution = collect(cluster, &costs, &mut ranking, MOST_EVENTS, |_| true);
    Ok((solution.error_bound <= Some(TOLERANCE)).then_some(solution))
}

/// Of the events of the same tracks and reports, the first: the others are not counted.
pub(super) fn pruned(cluster: &Cluster, weights: &Weights) -> Result<Solution> {
    let costs = cluster.costs(weights);
    let mut ranking = Ranking::new(&costs.pairs, cluster.reports, costs.misses.clone())?;
    let mut seen = HashSet::new();
    let is_first = |event: &Ranked| {
        let tracks: Vec<bool> = event.row_to_column.iter().map(Option::is_some).collect();
        let mut reports: Vec<usize> = event.row_to_column.iter().flatten().copied().collect();
        reports.sort_unstable();
        seen.insert((tracks, reports))
    };
    Ok(collect(cluster, &costs, &mut ranking, MOST_PRUNED, is_first))
}

fn collect(
    cluster: &Cluster,
    costs: &Costs,
    ranking: &mut Ranking,
    most: u32,
    mut counts: impl FnMut(&Ranked) -> bool,
) -> Solution {
    let mut place = vec![usize::MAX; costs.pairs.len()];
    for (index, link) in cluster.links.iter().enumerate() {
        place[link.track * cluster.reports + link.report] = index;
    }
    let mut links = vec![0.0; cluster.links.len()];
    let mut missed = vec![0.0; cluster.tracks.len()];
    let (mut seen, mut best, mut bound) = (0.0, None, 0.0);
    for number in 1..=most {
        let event = ranking.next();
        let allowed = |event: &Ranked| {
            let mut rows = event.row_to_column.iter().zip(&costs.can_miss);
            rows.all(|(column, can_miss)| column.is_some() || *can_miss)
        };
        // Impossible events come last.
        let Some(event) = event.filter(allowed) else {
            bound = 0.0;
            break;
        };
        let least = *best.get_or_insert(event.cost);
        if counts(&event) {
            let weight = libm::exp(least - event.cost);
            seen += weight;
            for (track, column) in event.row_to_column.iter().enumerate() {
                match column {
                    Some(column) => links[place[track * cluster.reports + column]] += weight,
                    None => missed[track] += weight,
                }
            }
        }
        if number.is_power_of_two() || number == most {
            let table = ranking.table();
            let rest: f64 = ranking
                .open()
                .map(|node| most_of(table, node, &costs.can_miss, least))
                .sum();
            bound = rest / (seen + rest);
            if bound <= ENOUGH {
                break;
            }
        }
    }
    for p in links.iter_mut().chain(&mut missed) {
        *p /= seen;
    }
    Solution {
        links,
        missed,
        log_total: libm::log(seen) - best.unwrap_or(0.0) - cluster.log_scale,
        method: Method::MBest,
        error_bound: Some(bound),
    }
}

/// Equation 2, relative to an event of cost `least`.
fn most_of(table: &Table, node: &Node, can_miss: &[bool], least: f64) -> f64 {
    let mut is_open = vec![true; table.columns];
    for &column in &node.row_column[..node.depth] {
        if let Some(open) = is_open.get_mut(column) {
            *open = false;
        }
    }
    let mut bound = libm::exp(least - node.cost);
    for (row, &can_miss) in can_miss.iter().enumerate().skip(node.depth) {
        let is_barred = |column: usize| row == node.depth && node.forbidden.contains(&column);
        let dual = node.row_duals[row];
        let mut sum = 0.0;
        if can_miss && !is_barred(usize::MAX) {
            sum += libm::exp(dual - table.miss(row));
        }
        for column in (0..table.columns).filter(|&column| is_open[column]) {
            let cost = table.pair(row, column);
            if cost < f64::INFINITY && !is_barred(column) {
                sum += libm::exp(dual + node.column_duals[column] - cost);
            }
        }
        bound *= sum;
    }
    bound
}
