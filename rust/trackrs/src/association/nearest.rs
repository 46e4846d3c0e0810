//! Nearest neighbour and global nearest neighbour: one report at most for each track and one track for each report.
//!
//! The cost of giving report j to track i is −2 ln N(z_j; ẑ_i, S_i), that is d² + ln det S_i + m ln 2π: the
//! determinant keeps an uncertain track from taking a report that a certain one explains as well.
//! A track without a report costs as much as one with a report on the edge of its gate.
//!
//! * Nearest: the cheapest pair of all is fixed, then the cheapest of the rest, and so on.
//! * Global: the sum is minimal ([`super::assignment`]). Tracks that share no report are solved apart.
//!
//! Reference: Blackman, Popoli (1999), Design and Analysis of Modern Tracking Systems, §6.4.

use serde::{Deserialize, Serialize};

use super::assignment::assign_with_misses;
use crate::error::Result;
use crate::gating::mahalanobis::{GatedPair, GatedTrack};

/// What nearest neighbour counts as near.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Nearness {
    /// The cost above.
    #[default]
    Likelihood,
    /// d² alone (spec label N15).
    Distance,
}

fn cost(pair: &GatedPair) -> f64 {
    -2.0 * pair.log_likelihood
}

/// For every track the position in its list of pairs of the one it gets, if any: the cheapest pair first. `reports` is the
/// number of reports in the scan.
pub fn nearest(tracks: &[GatedTrack], reports: usize, by: Nearness) -> Vec<Option<usize>> {
    let near = |pair: &GatedPair| match by {
        Nearness::Likelihood => cost(pair),
        Nearness::Distance => pair.nis,
    };
    let mut order: Vec<(f64, usize, usize)> = Vec::new();
    for (track, gated) in tracks.iter().enumerate() {
        order.extend(
            gated
                .pairs
                .iter()
                .enumerate()
                .map(|(slot, pair)| (near(pair), track, slot)),
        );
    }
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut chosen = vec![None; tracks.len()];
    let mut taken = vec![false; reports];
    for (_, track, slot) in order {
        let report = tracks[track].pairs[slot].report;
        if chosen[track].is_none() && !taken[report] {
            chosen[track] = Some(slot);
            taken[report] = true;
        }
    }
    chosen
}

/// The same for the cheapest set of pairs.
pub fn global(tracks: &[GatedTrack], reports: usize) -> Result<Vec<Option<usize>>> {
    let mut chosen = vec![None; tracks.len()];
    for cluster in clusters(tracks, reports) {
        let mut columns: Vec<usize> = cluster
            .iter()
            .flat_map(|&t| tracks[t].pairs.iter().map(|p| p.report))
            .collect();
        columns.sort_unstable();
        columns.dedup();
        let mut costs = vec![f64::INFINITY; cluster.len() * columns.len()];
        let mut total = 1.0;
        for (row, &track) in cluster.iter().enumerate() {
            for pair in &tracks[track].pairs {
                let column = columns.partition_point(|&report| report < pair.report);
                costs[row * columns.len() + column] = cost(pair);
                total += cost(pair).abs();
            }
        }
        // Without a gate no report is too far: leaving a track empty costs more than all pairs together.
        let miss = |&track: &usize| f64::min(-2.0 * tracks[track].edge_log_likelihood, total);
        let misses: Vec<f64> = cluster.iter().map(miss).collect();
        let solved = assign_with_misses(&costs, cluster.len(), columns.len(), &misses)?;
        for (&track, column) in cluster.iter().zip(solved.row_to_column) {
            let report = column.map(|column| columns[column]);
            chosen[track] = report.and_then(|r| tracks[track].pairs.iter().position(|p| p.report == r));
        }
    }
    Ok(chosen)
}

/// Tracks that share reports, directly or through others; tracks without a pair belong to none.
pub fn clusters(tracks: &[GatedTrack], reports: usize) -> Vec<Vec<usize>> {
    let mut first_of_report: Vec<Option<usize>> = vec![None; reports];
    let mut parent: Vec<usize> = (0..tracks.len()).collect();
    for (track, gated) in tracks.iter().enumerate() {
        for pair in &gated.pairs {
            let other = *first_of_report[pair.report].get_or_insert(track);
            let (a, b) = (root(&mut parent, track), root(&mut parent, other));
            parent[a.max(b)] = a.min(b);
        }
    }
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); tracks.len()];
    for (track, gated) in tracks.iter().enumerate() {
        if !gated.pairs.is_empty() {
            members[root(&mut parent, track)].push(track);
        }
    }
    members.retain(|cluster| !cluster.is_empty());
    members
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;

    fn pair(report: usize, nis: f64) -> GatedPair {
        GatedPair {
            report,
            nis,
            log_likelihood: -0.5 * nis,
            log_density: -0.5 * nis,
            innovation: DVector::zeros(1),
        }
    }

    fn gated(pairs: Vec<GatedPair>) -> GatedTrack {
        GatedTrack {
            pairs,
            edge_log_likelihood: -4.0,
        }
    }

    #[test]
    fn global_gives_up_the_nearest_pair_for_a_better_sum() {
        let tracks = [gated(vec![pair(0, 1.0), pair(1, 2.0)]), gated(vec![pair(0, 1.5)])];
        assert_eq!(nearest(&tracks, 2, Nearness::Likelihood), [Some(0), None]);
        assert_eq!(global(&tracks, 2).unwrap(), [Some(1), Some(0)]);
    }

    #[test]
    fn one_good_pair_and_a_miss_beat_two_bad_pairs() {
        let tracks = [gated(vec![pair(0, 0.1), pair(1, 7.0)]), gated(vec![pair(0, 7.0)])];
        assert_eq!(global(&tracks, 2).unwrap(), [Some(0), None]);
    }

    #[test]
    fn clusters_are_connected_through_reports() {
        let none = gated(vec![]);
        let tracks = [
            gated(vec![pair(0, 1.0)]),
            none,
            gated(vec![pair(2, 1.0), pair(0, 1.0)]),
            gated(vec![pair(1, 1.0)]),
        ];
        assert_eq!(clusters(&tracks, 3), [vec![0, 2], vec![3]]);
    }
}
