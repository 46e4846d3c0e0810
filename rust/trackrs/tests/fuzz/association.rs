use trackrs::association::assignment::sparse::{Candidate as Pair, assign_sparse, assign_sparse_with_misses};
use trackrs::association::assignment::{Assignment, assign, assign_with_misses};
use trackrs::association::existence::{Prospect, joint_existence};
use trackrs::association::k_best::{k_best, k_best_with_misses};
use trackrs::association::marginals::{Candidate, Domain, Options, Weights, marginals};
use trackrs::gating::distances::{Expected, pairs_within, squared_distances};

use super::Source;
use super::source::finite;

fn sound(found: &Assignment, columns: usize) {
    finite("cost", [&found.cost]);
    finite("duals", found.row_duals.iter().chain(&found.column_duals));
    let mut taken = vec![false; columns];
    for &column in found.row_to_column.iter().flatten() {
        assert!(!std::mem::replace(&mut taken[column], true), "a column twice");
    }
}

fn costs(source: &mut Source<'_>, count: usize) -> Vec<f64> {
    let forbidden = source.below(4);
    let cost = |source: &mut Source<'_>| {
        if source.below(8) < forbidden {
            f64::INFINITY
        } else {
            source.number()
        }
    };
    (0..count).map(|_| cost(source)).collect()
}

pub(crate) fn assignment(source: &mut Source<'_>) {
    let (rows, columns) = (source.below(6), source.below(6));
    let size = source.about(rows * columns);
    let costs = costs(source, size);
    let count = source.about(rows);
    let misses = source.numbers(count);
    let dense = [
        assign(&costs, rows, columns),
        assign_with_misses(&costs, rows, columns, &misses),
    ];
    dense.iter().flatten().for_each(|found| sound(found, columns));
    let listed: Vec<Pair> = costs
        .iter()
        .enumerate()
        .filter(|(_, cost)| **cost < f64::INFINITY)
        .map(|(at, &cost)| Pair {
            row: at / columns.max(1),
            column: at % columns.max(1),
            cost,
        })
        .collect();
    let sparse = [
        assign_sparse(&listed, rows, columns),
        assign_sparse_with_misses(&listed, rows, columns, &misses),
    ];
    sparse.iter().flatten().for_each(|found| sound(found, columns));
    for (dense, sparse) in dense.iter().zip(&sparse) {
        if let (Ok(dense), Ok(sparse)) = (dense, sparse) {
            let scale = costs
                .iter()
                .chain(&misses)
                .filter(|c| c.is_finite())
                .map(|c| c.abs())
                .sum::<f64>();
            assert!(
                (dense.cost - sparse.cost).abs() <= 1e-12 * scale,
                "{} {}",
                dense.cost,
                sparse.cost
            );
        }
    }
}

pub(crate) fn ranked_assignments(source: &mut Source<'_>) {
    let (rows, columns) = (source.below(5), source.below(5));
    let size = source.about(rows * columns);
    let (costs, k) = (costs(source, size), source.below(20));
    let count = source.about(rows);
    let misses = source.numbers(count);
    let found = [
        k_best(&costs, rows, columns, k),
        k_best_with_misses(&costs, rows, columns, &misses, k),
    ];
    for ranked in found.iter().flatten() {
        assert!(ranked.len() <= k);
        finite("cost", ranked.iter().map(|r| &r.cost));
    }
}

pub(crate) fn joint_marginals(source: &mut Source<'_>) {
    let (tracks, reports) = (source.below(6), source.below(6));
    let domain = if source.coin() { Domain::Log } else { Domain::Linear };
    let size = source.about(tracks * (reports + 1));
    let mut values = source.numbers(size);
    if let Domain::Linear = domain {
        for value in &mut values {
            *value = value.abs();
        }
    }
    let options = Options {
        budget: source.below(256) * source.below(8),
        prune: source.coin(),
    };
    let Ok(weights) = Weights::from_dense(&values, tracks, reports + 1, domain) else {
        return;
    };
    if let Ok(found) = marginals(&weights, &options) {
        for track in 0..tracks {
            let given = found.candidates(track);
            let sum = found.missed[track] + given.iter().sum::<f64>();
            assert!((sum - 1.0).abs() < 1e-9, "{sum}: {weights:?} {options:?} {found:?}");
            assert!(given.iter().all(|p| (0.0..=1.0).contains(p)));
        }
    }
}

pub(crate) fn joint_existences(source: &mut Source<'_>) {
    let reports = source.below(5);
    let mut prospects = Vec::new();
    for _ in 0..source.below(5) {
        let mut candidates = Vec::new();
        for report in 0..reports {
            if source.coin() {
                candidates.push(Candidate {
                    report,
                    weight: source.number(),
                });
            }
        }
        prospects.push(Prospect {
            existence: source.share(),
            detection: source.share(),
            candidates,
        });
    }
    if let Ok(found) = joint_existence(&prospects, reports, &Options::default()) {
        for track in &found.tracks {
            finite(
                "existence",
                track.candidates.iter().chain([&track.existence, &track.missed]),
            );
            assert!((0.0..=1.0).contains(&track.existence), "{}", track.existence);
        }
    }
}

pub(crate) fn gates(source: &mut Source<'_>) {
    let (dims, tracks, count) = (source.below(5), source.below(4), source.below(12));
    let size = source.about(tracks * dims);
    let means = source.numbers(size);
    let covs: Vec<f64> = (0..tracks)
        .flat_map(|_| source.covariance(dims).as_slice().to_vec())
        .collect();
    let size = source.about(count * dims);
    let reports = source.numbers(size);
    let expected = Expected {
        dims,
        means: &means,
        covs: &covs,
    };
    let threshold = source.positive();
    let mut all = vec![0.0; tracks * count];
    let full = squared_distances(&expected, &reports, &mut all);
    let pairs = pairs_within(&expected, &reports, threshold);
    if let (Ok(()), Ok(pairs)) = (full, pairs) {
        let inside = all.iter().filter(|d| **d <= threshold).count();
        assert_eq!(inside, pairs.distances.len());
        for ((track, report), distance) in pairs.tracks.iter().zip(&pairs.reports).zip(&pairs.distances) {
            assert_eq!(all[track * count + report].to_bits(), distance.to_bits());
        }
    }
}
