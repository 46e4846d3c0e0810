//! Joint association marginals against the enumeration of all joint events.

use std::collections::BTreeMap;

use trackrs::Error;
use trackrs::association::marginals::{Candidate, Domain, Marginals, Method, Options, Weights, marginals};
use trackrs::stats::stream::Stream;

/// Log weights (tracks, 1 + reports), −∞ = impossible.
#[derive(Debug, Clone)]
struct Problem {
    tracks: usize,
    reports: usize,
    logs: Vec<f64>,
}

/// Which tracks have a report, and which reports.
type Sets = (Vec<bool>, Vec<usize>);

/// The definition: every joint event, in log domain, relative to the largest.
struct Truth {
    probabilities: Vec<f64>,
    log_total: f64,
}

impl Problem {
    fn columns(&self) -> usize {
        self.reports + 1
    }

    fn events(&self) -> Vec<(Vec<usize>, f64)> {
        let mut events = vec![(Vec::new(), 0.0)];
        for track in 0..self.tracks {
            let mut longer = Vec::new();
            for (event, log) in &events {
                for column in 0..self.columns() {
                    let weight = self.logs[track * self.columns() + column];
                    if weight > f64::NEG_INFINITY && (column == 0 || !event.contains(&column)) {
                        let mut event: Vec<usize> = event.clone();
                        event.push(column);
                        longer.push((event, log + weight));
                    }
                }
            }
            events = longer;
        }
        events
    }

    fn enumerate(&self) -> Option<Truth> {
        self.sum(&self.events())
    }

    /// Of the events of the same tracks and the same reports the most likely.
    fn pruned_events(&self) -> Vec<(Vec<usize>, f64)> {
        let mut best: BTreeMap<Sets, (Vec<usize>, f64)> = BTreeMap::new();
        for (event, log) in self.events() {
            let tracks = event.iter().map(|&column| column > 0).collect();
            let mut reports: Vec<usize> = event.iter().copied().filter(|&column| column > 0).collect();
            reports.sort_unstable();
            let kept = best.entry((tracks, reports)).or_insert_with(|| (event.clone(), log));
            if log > kept.1 {
                *kept = (event, log);
            }
        }
        best.into_values().collect()
    }

    fn sum(&self, events: &[(Vec<usize>, f64)]) -> Option<Truth> {
        let best = events.iter().map(|(_, log)| *log).fold(f64::NEG_INFINITY, f64::max);
        if events.is_empty() {
            return None;
        }
        let mut probabilities = vec![0.0; self.logs.len()];
        let mut total = 0.0;
        for (event, log) in events {
            let weight = (log - best).exp();
            total += weight;
            for (track, column) in event.iter().enumerate() {
                probabilities[track * self.columns() + column] += weight;
            }
        }
        for p in &mut probabilities {
            *p /= total;
        }
        Some(Truth {
            probabilities,
            log_total: best + total.ln(),
        })
    }

    fn weights(&self, domain: Domain) -> trackrs::Result<Weights> {
        let values: Vec<f64> = match domain {
            Domain::Log => self.logs.clone(),
            Domain::Linear => self.logs.iter().map(|log| log.exp()).collect(),
        };
        Weights::from_dense(&values, self.tracks, self.columns(), domain)
    }
}

fn dense(weights: &Weights, found: &Marginals) -> Vec<f64> {
    let columns = weights.reports() + 1;
    let mut out = vec![0.0; weights.tracks() * columns];
    for track in 0..weights.tracks() {
        out[track * columns] = found.missed[track];
        for (candidate, p) in weights.candidates(track).iter().zip(found.candidates(track)) {
            out[track * columns + candidate.report + 1] = *p;
        }
    }
    out
}

/// Random gates and weights, of the orders of magnitude `spread`, some with tracks that cannot be missed.
fn draw(stream: &mut Stream, largest: usize, spread: f64) -> Problem {
    let sizes: Vec<usize> = (0..=largest).collect();
    let mut size = || stream.choice(&sizes).copied().unwrap();
    let (tracks, reports) = (size(), size());
    let gated = *stream.choice(&[0.3, 0.6, 1.0]).unwrap();
    let missable = *stream.choice(&[1.0, 0.7]).unwrap();
    let mut logs = Vec::new();
    for _ in 0..tracks {
        for column in 0..=reports {
            let share = if column == 0 { missable } else { gated };
            let possible = stream.uniform() < share;
            // Few binary digits: the sums of the enumeration are exact, even of logarithms of 1e4.
            let log = (stream.between(-spread, spread) * 1_048_576.0).round() / 1_048_576.0;
            logs.push(if possible { log } else { f64::NEG_INFINITY });
        }
    }
    Problem { tracks, reports, logs }
}

fn agree(problem: &Problem, probabilities: &[f64], truth: &Truth) {
    for (p, q) in probabilities.iter().zip(&truth.probabilities) {
        if *q > 1e-200 {
            assert!((p / q - 1.0).abs() <= 1e-12, "{p} {q} in {problem:?}");
        } else {
            assert!(*p <= 2e-200);
        }
    }
    for row in probabilities.chunks(problem.columns()) {
        assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-13);
    }
    for column in 1..problem.columns() {
        let sum: f64 = probabilities.iter().skip(column).step_by(problem.columns()).sum();
        assert!(sum <= 1.0 + 1e-13);
    }
}

fn check(runs: u64, prune: bool) {
    let options = Options {
        prune,
        ..Options::default()
    };
    for run in 0..runs {
        let mut stream = Stream::new(1, run);
        let spread = [1.0, 5.0, 50.0, 1e4][(run % 4) as usize];
        let problem = draw(&mut stream, 5, spread);
        let domain = if spread < 100.0 && run % 3 == 0 {
            Domain::Linear
        } else {
            Domain::Log
        };
        let events = if prune {
            problem.pruned_events()
        } else {
            problem.events()
        };
        let truth = problem.sum(&events);
        let found = problem.weights(domain).and_then(|w| Ok((marginals(&w, &options)?, w)));
        let Some(truth) = truth else {
            assert!(matches!(found, Err(Error::InvalidParameter { .. })), "{problem:?}");
            continue;
        };
        let (found, weights) = found.unwrap();
        assert_eq!((found.method, found.error_bound), (Method::Exact, Some(0.0)));
        agree(&problem, &dense(&weights, &found), &truth);
        let scale = truth.log_total.abs().max(1.0);
        assert!(
            (found.log_total - truth.log_total).abs() <= 1e-12 * scale,
            "{} {}",
            found.log_total,
            truth.log_total
        );
    }
}

/// 10^5 problems, every gate, weights over up to 20,000 powers of e, tracks that cannot be missed.
#[test]
fn marginals_are_those_of_the_definition() {
    check(100_000, false);
}

#[test]
fn pruned_marginals_are_those_of_the_best_event_of_each_set() {
    check(20_000, true);
}

/// Larger clusters, where layers have more than three bits: against the recursion over subsets, in its plainest form.
#[test]
fn larger_clusters_agree_with_a_plain_recursion() {
    for run in 0..300 {
        let mut stream = Stream::new(2, run);
        let mut problem = draw(&mut stream, 9, 8.0);
        for track in 0..problem.tracks {
            problem.logs[track * (problem.reports + 1)] = -1.0;
        }
        let columns = problem.columns();
        let at = |track: usize, column: usize| problem.logs[track * columns + column].exp();
        // Σ over joint events.
        let total = |at: &dyn Fn(usize, usize) -> f64| {
            let mut layer = vec![0.0; 1 << columns];
            layer[0] = 1.0;
            for row in 0..problem.tracks {
                let mut next = vec![0.0; 1 << columns];
                for (set, weight) in layer.iter().enumerate() {
                    next[set] += weight * at(row, 0);
                    for column in 1..columns {
                        if set >> column & 1 == 0 {
                            next[set | 1 << column] += weight * at(row, column);
                        }
                    }
                }
                layer = next;
            }
            layer.iter().sum::<f64>()
        };
        let all = total(&at);
        let weights = problem.weights(Domain::Linear).unwrap();
        let found = dense(&weights, &marginals(&weights, &Options::default()).unwrap());
        for track in 0..problem.tracks {
            for column in 0..columns {
                let forced = |row: usize, c: usize| if row == track && c != column { 0.0 } else { at(row, c) };
                let expected = total(&forced) / all;
                assert!((found[track * columns + column] - expected).abs() <= 1e-12 * expected);
            }
        }
    }
}

/// Tracks in a row, each sharing reports with the next: far too many events to enumerate, but a frontier of few bits.
#[test]
fn a_long_chain_is_exact_and_relabelling_permutes() {
    let (tracks, reports) = (300_usize, 600_usize);
    let mut stream = Stream::new(3, 0);
    let mut rows = Vec::new();
    for track in 0..tracks {
        let mut row = vec![(0, -2.0)];
        for report in (2 * track).saturating_sub(1)..(2 * track + 3).min(reports) {
            row.push((report + 1, stream.between(-3.0, 3.0)));
        }
        rows.push(row);
    }
    let order = |n: usize, factor: usize| (0..n).map(|i| (i * factor + 5) % n).collect::<Vec<_>>();
    let (track_at, report_at) = (order(tracks, 101), order(reports, 77));
    let options = Options {
        budget: 100_000,
        prune: false,
    };
    let solve = |track_at: &[usize], report_at: &[usize]| {
        let mut logs = vec![f64::NEG_INFINITY; tracks * (reports + 1)];
        for (track, row) in rows.iter().enumerate() {
            for &(column, log) in row {
                let column = if column == 0 { 0 } else { report_at[column - 1] + 1 };
                logs[track_at[track] * (reports + 1) + column] = log;
            }
        }
        let weights = Weights::from_dense(&logs, tracks, reports + 1, Domain::Log).unwrap();
        let found = marginals(&weights, &options).unwrap();
        assert_eq!(found.method, Method::Exact);
        (dense(&weights, &found), found.log_total)
    };
    let identity = |n: usize| (0..n).collect::<Vec<_>>();
    let (plain, log_total) = solve(&identity(tracks), &identity(reports));
    let (permuted, permuted_total) = solve(&track_at, &report_at);
    assert!((log_total - permuted_total).abs() < 1e-10);
    for track in 0..tracks {
        for column in 0..=reports {
            let to = if column == 0 { 0 } else { report_at[column - 1] + 1 };
            let other = permuted[track_at[track] * (reports + 1) + to];
            let here = plain[track * (reports + 1) + column];
            assert!((here - other).abs() <= 1e-12 * here);
        }
    }
}

/// With no budget at all: m-best where it says how good it is, belief propagation elsewhere.
#[test]
fn approximations_say_what_they_are() {
    let options = Options {
        budget: 0,
        prune: false,
    };
    let (mut m_best, mut belief) = (0, 0);
    for run in 0..2000 {
        let mut stream = Stream::new(4, run);
        let problem = draw(&mut stream, 5, [1.0, 10.0][(run % 2) as usize]);
        let Some(truth) = problem.enumerate() else { continue };
        let weights = problem.weights(Domain::Log).unwrap();
        let found = marginals(&weights, &options).unwrap();
        let probabilities = dense(&weights, &found);
        for (row, truth) in probabilities
            .chunks(problem.columns())
            .zip(truth.probabilities.chunks(problem.columns()))
        {
            let distance = 0.5 * row.iter().zip(truth).map(|(p, q)| (p - q).abs()).sum::<f64>();
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            match found.error_bound {
                Some(bound) => assert!(distance <= bound + 1e-12, "{distance} {bound} {problem:?}"),
                None => assert!(distance < 0.5, "{distance}"),
            }
        }
        match found.method {
            Method::MBest => {
                m_best += 1;
                let missing = -(found.log_total - truth.log_total).exp_m1();
                assert!((-1e-12..=found.error_bound.unwrap() + 1e-12).contains(&missing));
            }
            Method::Belief => {
                belief += 1;
                assert_eq!(found.error_bound, None);
            }
            Method::Exact => {}
        }
    }
    assert!(m_best > 300 && belief > 20, "{m_best} {belief}");
}

/// Gates that form a tree: track i and track i + 1 share one report.
#[test]
fn belief_propagation_is_exact_on_trees() {
    let mut stream = Stream::new(5, 0);
    let n = 40;
    let mut logs = vec![f64::NEG_INFINITY; n * (n + 1)];
    for track in 0..n {
        logs[track * (n + 1)] = stream.between(-2.0, 2.0);
        for column in [track, track + 1] {
            logs[track * (n + 1) + column.max(1)] = stream.between(-2.0, 2.0);
        }
    }
    for track in 1..n {
        logs[track * (n + 1)] = -1.0;
    }
    let weights = Weights::from_dense(&logs, n, n + 1, Domain::Log).unwrap();
    let solve = |budget| {
        let options = Options { budget, prune: false };
        marginals(&weights, &options).unwrap()
    };
    let (exact, approximate) = (solve(usize::MAX), solve(0));
    assert_eq!((exact.method, approximate.method), (Method::Exact, Method::Belief));
    assert!((exact.log_total - approximate.log_total).abs() < 1e-8);
    for (p, q) in dense(&weights, &exact).iter().zip(dense(&weights, &approximate)) {
        assert!((p - q).abs() < 1e-8);
    }
}

/// Beyond the budget of the pruned sum: the bound holds there too.
#[test]
fn pruned_enumeration_bounds_what_it_leaves_out() {
    let options = Options { budget: 0, prune: true };
    for run in 0..500 {
        let mut stream = Stream::new(6, run);
        let problem = draw(&mut stream, 5, 2.0);
        let Some(truth) = problem.sum(&problem.pruned_events()) else {
            continue;
        };
        let weights = problem.weights(Domain::Log).unwrap();
        let found = marginals(&weights, &options).unwrap();
        let bound = found.error_bound.unwrap();
        for (p, q) in dense(&weights, &found).iter().zip(&truth.probabilities) {
            assert!((p - q).abs() <= bound + 1e-12, "{p} {q} {bound}");
        }
    }
}

#[test]
fn nothing_to_associate() {
    let none = Weights::from_dense(&[], 0, 4, Domain::Linear).unwrap();
    let found = marginals(&none, &Options::default()).unwrap();
    assert_eq!(
        (found.missed.len(), found.log_total, found.error_bound),
        (0, 0.0, Some(0.0))
    );
    let no_reports = Weights::from_dense(&[0.1, 0.5], 2, 1, Domain::Linear).unwrap();
    let found = marginals(&no_reports, &Options::default()).unwrap();
    assert_eq!(found.missed, [1.0, 1.0]);
    assert!((found.log_total - 0.05_f64.ln()).abs() < 1e-15);
}

#[test]
fn errors_name_the_culprit() {
    let message = |values: &[f64], tracks: usize, domain: Domain| {
        let columns = values.len() / tracks;
        let found = Weights::from_dense(values, tracks, columns, domain);
        found
            .and_then(|w| marginals(&w, &Options::default()))
            .unwrap_err()
            .to_string()
    };
    let linear = |values: &[f64], tracks: usize| message(values, tracks, Domain::Linear);
    assert!(linear(&[0.1, f64::NAN], 1).contains("weights[0, 1] is not finite"));
    assert!(linear(&[0.1, 0.2, -1.0, 0.3], 2).contains("weights[1, 0] = -1 is invalid"));
    assert!(linear(&[0.0, 0.0], 1).contains("weights[0, 0] = 0 is invalid"));
    assert!(linear(&[0.0, 1.0, 0.0, 1.0], 2).contains("tracks = [0, 1]"));
    assert!(message(&[0.0, f64::INFINITY], 1, Domain::Log).contains("weights[0, 1] is not finite"));
    assert!(Weights::from_dense(&[], 3, 0, Domain::Linear).is_err());
    assert!(Weights::from_dense(&[1.0], 1, 2, Domain::Linear).is_err());
    let mut weights = Weights::new(2, Domain::Log);
    let candidate = |report| Candidate { report, weight: 0.0 };
    assert!(weights.push(0.0, [candidate(2)]).is_err());
    assert!(weights.push(0.0, [candidate(1), candidate(1)]).is_err());
    assert_eq!(weights.tracks(), 0);
}
