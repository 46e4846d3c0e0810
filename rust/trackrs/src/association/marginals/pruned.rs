//! Marginals of a cluster that counts, of all ways to give the same reports to the same tracks, only the most likely.
//!
//! | symbol | name here | meaning                                                                       |
//! |--------|-----------|-------------------------------------------------------------------------------|
//! | A, B   |           | sets of tracks that take a shared report, and of reports taken; |A| = |B| = k |
//! | b(A,B) | `best`    | largest Π_{i∈A} w_{i,e(i)} over the ways e to give B to A                     |
//! | W(A,B) |           | b(A,B) Π_{i∉A} a_i Π_{j∉B} c_j: the weight of the one event that is kept      |
//! | R(A,B) | `flow`    | sum of the weights of all kept events that contain the best event of (A,B)     |
//!
//! 1. With i the last track of A: b(A,B) = max_{j∈B} w_ij b(A∖i, B∖j), and j(A,B) is where the maximum is.
//! 2. From the largest sets down: R(A,B) = W(A,B) + what came from above; R(A,B) goes to β_ij for i and j = j(A,B), and
//!    to R(A∖i, B∖j). So every kept event reaches every one of its pairs.
//! 3. β_i0 is the sum of W(A,B) over A without i.
//!
//! Sets of one size are numbered in the order of their bit masks: the rank of b_1 < b_2 < … is Σ_m C(b_m, m). There are
//! C(T + M, T) pairs of sets. Of equally likely ways the one that gives the last track the first report is kept.
//! Own reports of a track do not matter: with them B says who has them.
//!
//! Reference: H. A. P. Blom, E. A. Bloem, Probabilistic data association avoiding track coalescence, IEEE Trans. Autom.
//! Control 45(2), 2000 (JPDA*).

use super::Method;
use super::cluster::{Cluster, Solution};
use crate::interrupt::ahead;

/// Members are counted in a byte, and no binomial coefficient overflows.
const LARGEST: usize = 60;
/// Ranks fit 32 bits.
const MOST_TRANSITIONS: usize = 1 << 31;

/// The subsets of one size, in the order of their bit masks.
struct Sets {
    size: usize,
    /// The members of each, increasing.
    members: Vec<u8>,
    /// The rank of each set without its m-th member, among the sets of one member less.
    without: Vec<u32>,
    /// Product of the weights of what is not in the set.
    rest: Vec<f64>,
}

/// The marginals, or `None` where they would take more transitions than the budget.
pub(super) fn solve(cluster: &Cluster, budget: usize) -> Option<Solution> {
    let (tracks, reports) = (cluster.tracks.len(), cluster.reports);
    if tracks > LARGEST || reports > LARGEST {
        return None;
    }
    let choose = binomials(tracks.max(reports));
    let mut transitions: f64 = 0.0;
    for (k, (of_tracks, of_reports)) in choose[tracks].iter().zip(&choose[reports]).enumerate() {
        transitions += of_tracks * of_reports * k as f64;
    }
    if transitions > budget.min(MOST_TRANSITIONS) as f64 {
        return None;
    }
    let mut weights = vec![0.0; tracks * reports];
    for link in &cluster.links {
        weights[link.track * reports + link.report] = link.weight;
    }
    let mut levels = vec![Level::empty(cluster, &choose)];
    for k in 1..=tracks.min(reports) {
        let next = Level::after(levels.last()?, cluster, &weights, k, &choose);
        levels.push(next);
    }
    let mut pairs = vec![0.0; tracks * reports];
    let mut missed = vec![0.0; tracks];
    let mut total = 0.0;
    let mut flow: Vec<f64> = Vec::new();
    for level in levels.iter().rev() {
        let mut below = vec![
            0.0;
            if level.k == 0 {
                0
            } else {
                levels[level.k - 1].best.len()
            }
        ];
        flow.resize(level.best.len(), 0.0);
        let count = level.reports.rest.len();
        for (set, &rest) in level.tracks.rest.iter().enumerate() {
            ahead(count);
            let mut kept = 0.0;
            for other in 0..count {
                let index = set * count + other;
                if level.best[index] == 0.0 {
                    continue;
                }
                let weight = level.best[index] * rest * level.reports.rest[other];
                kept += weight;
                let through = flow[index] + weight;
                if level.k > 0 {
                    let place = other * level.k + usize::from(level.choice[index]);
                    let track = usize::from(level.tracks.members[(set + 1) * level.k - 1]);
                    pairs[track * reports + usize::from(level.reports.members[place])] += through;
                    below[level.below(set, place, levels[level.k - 1].reports.rest.len())] += through;
                }
            }
            total += kept;
            let members = &level.tracks.members[set * level.k..(set + 1) * level.k];
            for (track, missed) in missed.iter_mut().enumerate() {
                if members.iter().all(|&member| usize::from(member) != track) {
                    *missed += kept;
                }
            }
        }
        flow = below;
    }
    let share = |link: &super::cluster::Link| pairs[link.track * reports + link.report] / total;
    for p in &mut missed {
        *p /= total;
    }
    Some(Solution {
        links: cluster.links.iter().map(share).collect(),
        missed,
        log_total: libm::log(total),
        method: Method::Exact,
        error_bound: Some(0.0),
    })
}

/// All pairs of sets of one size.
struct Level {
    k: usize,
    tracks: Sets,
    reports: Sets,
    best: Vec<f64>,
    /// Which member of B the last track of A has.
    choice: Vec<u8>,
}

impl Level {
    fn empty(cluster: &Cluster, choose: &[Vec<f64>]) -> Self {
        Self {
            k: 0,
            tracks: Sets::new(&cluster.misses, 0, choose),
            reports: Sets::new(&cluster.unused, 0, choose),
            best: vec![1.0],
            choice: vec![0],
        }
    }

    fn after(last: &Self, cluster: &Cluster, weights: &[f64], k: usize, choose: &[Vec<f64>]) -> Self {
        let tracks = Sets::new(&cluster.misses, k, choose);
        let reports = Sets::new(&cluster.unused, k, choose);
        let count = reports.rest.len();
        let mut best = vec![0.0; tracks.rest.len() * count];
        let mut choice = vec![0; best.len()];
        let last_count = last.reports.rest.len();
        let found = best.chunks_exact_mut(count).zip(choice.chunks_exact_mut(count));
        for (set, (best, choice)) in found.enumerate() {
            ahead(count);
            let track = usize::from(tracks.members[(set + 1) * k - 1]);
            let row = &weights[track * cluster.reports..(track + 1) * cluster.reports];
            let start = tracks.without[(set + 1) * k - 1] as usize * last_count;
            let last_best = &last.best[start..start + last_count];
            let ways = reports.members.chunks_exact(k).zip(reports.without.chunks_exact(k));
            for ((best, choice), (members, without)) in best.iter_mut().zip(choice).zip(ways) {
                for (m, (&report, &rank)) in (0_u8..).zip(members.iter().zip(without)) {
                    let way = row[usize::from(report)] * last_best[rank as usize];
                    if way > *best {
                        (*best, *choice) = (way, m);
                    }
                }
            }
        }
        Self {
            k,
            tracks,
            reports,
            best,
            choice,
        }
    }

    /// Where (A∖i, B∖j) is on the level below.
    fn below(&self, set: usize, place: usize, last_count: usize) -> usize {
        let last = self.tracks.without[(set + 1) * self.tracks.size - 1] as usize;
        last * last_count + self.reports.without[place] as usize
    }
}

impl Sets {
    /// The subsets of `k` of the members, which have these weights when they are not in it.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts within the budget, members up to LARGEST
    fn new(weights: &[f64], k: usize, choose: &[Vec<f64>]) -> Self {
        let count = choose[weights.len()][k] as usize;
        let mut sets = Self {
            size: k,
            members: Vec::with_capacity(count * k),
            without: Vec::with_capacity(count * k),
            rest: Vec::with_capacity(count),
        };
        let mut chosen: Vec<usize> = (0..k).collect();
        for _ in 0..count {
            sets.members.extend(chosen.iter().map(|&member| member as u8));
            for left_out in 0..k {
                let others = chosen.iter().enumerate().filter(|(m, _)| *m != left_out);
                let rank: f64 = others.enumerate().map(|(m, (_, &member))| choose[member][m + 1]).sum();
                sets.without.push(rank as u32);
            }
            let outside = weights
                .iter()
                .enumerate()
                .filter(|(member, _)| !chosen.contains(member));
            sets.rest.push(outside.map(|(_, weight)| weight).product());
            // The next bit mask: the first member that has room above it moves up, those before it go back to the start.
            let has_room = |&m: &usize| m + 1 == k || chosen[m] + 1 < chosen[m + 1];
            if let Some(m) = (0..k).find(has_room) {
                chosen[m] += 1;
                (0..m).for_each(|before| chosen[before] = before);
            }
        }
        sets
    }
}

/// `choose[n][k]` for n up to `largest`, 0 for k > n.
fn binomials(largest: usize) -> Vec<Vec<f64>> {
    let mut choose = vec![vec![0.0; largest + 2]; largest + 1];
    for n in 0..=largest {
        choose[n][0] = 1.0;
        for k in 1..=n {
            choose[n][k] = choose[n - 1][k - 1] + choose[n - 1][k];
        }
    }
    choose
}
