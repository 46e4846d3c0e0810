//! Approximate marginals of a cluster by loopy belief propagation: exact where the gates form a tree.
//!
//! | symbol | name here | meaning                                                                   |
//! |--------|-----------|---------------------------------------------------------------------------|
//! | μ_ij   | `to_report` | message of track i to report j: odds that i takes j, as far as i knows  |
//! | ν_ij   | `to_track`  | message of report j to track i: odds that j is free for i               |
//!
//! 1. μ_ij = w_ij / (a_i + Σ_{j'≠j} w_ij' ν_ij')
//! 2. ν_ij = 1 / (c_j + Σ_{i'≠i} μ_i'j)
//! 3. repeated until no ν changes by more than 1e-9 of itself. That is a contraction where every a_i > 0. From the 200th
//!    time on the new ν is averaged with the old, since with a_i = 0 they may swing for ever; 1000 times at most.
//! 4. β_ij = w_ij ν_ij / s_i, β_i0 = a_i / s_i, s_i = a_i + Σ_j w_ij ν_ij
//! 5. ln W ≈ Σ_i ln s_i + Σ_j ln(c_j + Σ_i μ_ij) − Σ_ij ln(1 + μ_ij ν_ij) (Bethe)
//!
//! Reference: J. L. Williams, R. A. Lau, Approximate evaluation of marginal association probabilities with belief
//! propagation, IEEE Trans. Aerosp. Electron. Syst. 50(4), 2014, for (1) to (4); J. S. Yedidia, W. T. Freeman, Y. Weiss,
//! Constructing free energy approximations and generalized belief propagation algorithms, IEEE Trans. Inf. Theory 51(7),
//! 2005, for (5).

use super::Method;
use super::cluster::{Cluster, Solution};
use crate::interrupt::ahead;

const TOLERANCE: f64 = 1e-9;
const MOST_ITERATIONS: usize = 1000;
const DAMPED_FROM: usize = 200;

/// Marginals without a bound of their error.
pub(super) fn solve(cluster: &Cluster) -> Solution {
    let links = &cluster.links;
    let mut of_report: Vec<Vec<usize>> = vec![Vec::new(); cluster.reports];
    let mut of_track: Vec<Vec<usize>> = vec![Vec::new(); cluster.tracks.len()];
    for (index, link) in links.iter().enumerate() {
        of_report[link.report].push(index);
        of_track[link.track].push(index);
    }
    let mut to_report = vec![0.0; links.len()];
    let mut to_track = vec![1.0; links.len()];
    let mut others = vec![0.0; links.len()];
    for iteration in 0..MOST_ITERATIONS {
        ahead(links.len());
        for (row, &miss) in of_track.iter().zip(&cluster.misses) {
            sum_of_others(row, miss, |link| links[link].weight * to_track[link], &mut others);
        }
        for ((message, link), others) in to_report.iter_mut().zip(links).zip(&others) {
            *message = link.weight / others;
        }
        for (column, &unused) in of_report.iter().zip(&cluster.unused) {
            sum_of_others(column, unused, |link| to_report[link], &mut others);
        }
        let mut change: f64 = 0.0;
        for (message, others) in to_track.iter_mut().zip(&others) {
            let mut new = 1.0 / others;
            if iteration >= DAMPED_FROM {
                new = 0.5 * (new + *message);
            }
            if new != *message {
                change = change.max((new - *message).abs() / new.max(*message));
            }
            *message = new;
        }
        if change <= TOLERANCE {
            break;
        }
    }
    let mut log_total = 0.0;
    let mut solution = Solution {
        links: vec![0.0; links.len()],
        missed: vec![0.0; cluster.tracks.len()],
        log_total: 0.0,
        method: Method::Belief,
        error_bound: None,
    };
    for ((row, &miss), missed) in of_track.iter().zip(&cluster.misses).zip(&mut solution.missed) {
        let total = miss + row.iter().map(|&link| links[link].weight * to_track[link]).sum::<f64>();
        *missed = miss / total;
        for &link in row {
            solution.links[link] = links[link].weight * to_track[link] / total;
        }
        log_total += libm::log(total);
    }
    for (column, &unused) in of_report.iter().zip(&cluster.unused) {
        log_total += libm::log(unused + column.iter().map(|&link| to_report[link]).sum::<f64>());
    }
    for (mu, nu) in to_report.iter().zip(&to_track) {
        log_total -= libm::log1p(mu * nu);
    }
    solution.log_total = log_total;
    solution
}

/// For every link of a row `first` + Σ of the others' values, without a difference that would lose digits.
fn sum_of_others(row: &[usize], first: f64, value: impl Fn(usize) -> f64, others: &mut [f64]) {
    let mut sum = first;
    for &link in row {
        others[link] = sum;
        sum += value(link);
    }
    sum = 0.0;
    for &link in row.iter().rev() {
        others[link] += sum;
        sum += value(link);
    }
}
