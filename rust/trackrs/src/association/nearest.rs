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
    let mut wanted = vec![0_usize; reports];
    for pair in tracks.iter().flat_map(|track| track.pairs) {
        wanted[pair.report] += 1;
    }
    // Most tracks share no report: each of these has the cheapest of its own.
    let mut shared = vec![GatedTrack::default(); tracks.len()];
    for ((track, shared), chosen) in tracks.iter().zip(&mut shared).zip(&mut chosen) {
        if track.pairs.iter().any(|pair| wanted[pair.report] > 1) {
            *shared = *track;
            continue;
        }
        let slots = 0..track.pairs.len();
        let cheapest = slots.min_by(|&a, &b| cost(&track.pairs[a]).total_cmp(&cost(&track.pairs[b])));
        *chosen = cheapest.filter(|&slot| cost(&track.pairs[slot]) < -2.0 * track.edge_log_likelihood);
    }
    for cluster in clusters(&shared, reports) {
        let mut columns: Vec<usize> = cluster
            .iter()
            .flat_map(|&t| tracks[t].pairs.iter().map(|p| p.report))
            .collect();
        columns.sort_unstable();
        columns.dedup();
        let mut costs = vec![f64::INFINITY; cluster.len() * columns.len()];
        let mut total = 1.0;
        for (row, &track) in cluster.iter().enumerate() {
            for pair in tracks[track].pairs {
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
        for pair in gated.pairs {
            let other = *first_of_report[pair.report].get_or_insert(track);
            let (a, b) = (root(&mut parent, track), root(&mut parent, other));
            parent[a.max(b)] = a.min(b);
        }
    }
    let mut found: Vec<Vec<usize>> = Vec::new();
    let mut cluster_of = vec![None; tracks.len()];
    for (track, gated) in tracks.iter().enumerate() {
        if gated.pairs.is_empty() {
            continue;
        }
        let first = root(&mut parent, track);
        let cluster = *cluster_of[first].get_or_insert(found.len());
        if cluster == found.len() {
            found.push(Vec::new());
        }
        found[cluster].push(track);
    }
    found
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

    fn pair(report: usize, nis: f64) -> GatedPair {
        GatedPair {
            report,
            nis,
            log_likelihood: -0.5 * nis,
            log_density: -0.5 * nis,
        }
    }

    fn gated(pairs: &[GatedPair]) -> GatedTrack<'_> {
        GatedTrack {
            pairs,
            edge_log_likelihood: -4.0,
        }
    }

    #[test]
    fn global_gives_up_the_nearest_pair_for_a_better_sum() {
        let (first, second) = ([pair(0, 1.0), pair(1, 2.0)], [pair(0, 1.5)]);
        let tracks = [gated(&first), gated(&second)];
        assert_eq!(nearest(&tracks, 2, Nearness::Likelihood), [Some(0), None]);
        assert_eq!(global(&tracks, 2).unwrap(), [Some(1), Some(0)]);
    }

    #[test]
    fn one_good_pair_and_a_miss_beat_two_bad_pairs() {
        let (first, second) = ([pair(0, 0.1), pair(1, 7.0)], [pair(0, 7.0)]);
        assert_eq!(global(&[gated(&first), gated(&second)], 2).unwrap(), [Some(0), None]);
    }

    #[test]
    fn a_track_that_shares_no_report_gets_what_the_assignment_would_give_it() {
        // The edge is at a cost of 8.
        let alone = [pair(3, 5.0), pair(4, 2.0), pair(5, 7.9)];
        let (far, first, second) = ([pair(6, 8.1)], [pair(0, 1.0), pair(1, 2.0)], [pair(0, 1.5)]);
        let tracks = [gated(&alone), gated(&far), gated(&first), gated(&second)];
        assert_eq!(global(&tracks, 7).unwrap(), [Some(1), None, Some(1), Some(0)]);
    }

    #[test]
    fn clusters_are_connected_through_reports() {
        let parts = [
            vec![pair(0, 1.0)],
            vec![],
            vec![pair(2, 1.0), pair(0, 1.0)],
            vec![pair(1, 1.0)],
        ];
        let tracks: Vec<GatedTrack> = parts.iter().map(|pairs| gated(pairs)).collect();
        assert_eq!(clusters(&tracks, 3), [vec![0, 2], vec![3]]);
    }
}
