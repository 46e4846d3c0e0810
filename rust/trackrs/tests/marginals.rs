//! Joint association marginals against the enumeration of all joint events.

use trackrs::association::marginals::{Domain, Marginals, Method, Options, Weights, marginals};
use trackrs::stats::stream::Stream;

/// Log weights (tracks, 1 + reports), −∞ = impossible.
#[derive(Debug, Clone)]
struct Problem {
    tracks: usize,
    reports: usize,
    logs: Vec<f64>,
}

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
        let events = self.events();
        let best = events.iter().map(|(_, log)| *log).fold(f64::NEG_INFINITY, f64::max);
        if events.is_empty() {
            return None;
        }
        let mut probabilities = vec![0.0; self.logs.len()];
        let mut total = 0.0;
        for (event, log) in &events {
            let weight = (log - best).exp();
            total += weight;
            for (track, column) in event.iter().enumerate() {
                probabilities[track * self.columns() + column] += weight;
            }
        }
        probabilities.iter_mut().for_each(|p| *p /= total);
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
            let log = (stream.between(-spread, spread) * 1048576.0).round() / 1048576.0;
            logs.push(if possible { log } else { f64::NEG_INFINITY });
        }
    }
    Problem { tracks, reports, logs }
}

#[test]
fn marginals_are_those_of_the_definition() {
    let mut worst: f64 = 0.0;
    for run in 0..100_000_u64 {
        let mut stream = Stream::new(1, run);
        let spread = [1.0, 5.0, 50.0, 1e4][(run % 4) as usize];
        let problem = draw(&mut stream, 5, spread);
        let domain = if spread < 100.0 && run % 3 == 0 { Domain::Linear } else { Domain::Log };
        let truth = problem.enumerate();
        let found = problem.weights(domain).and_then(|w| Ok((marginals(&w, &Options::default())?, w)));
        let Some(truth) = truth else {
            assert!(found.is_err(), "{problem:?}");
            continue;
        };
        let (found, weights) = found.unwrap();
        assert_eq!((found.method, found.error_bound), (Method::Exact, Some(0.0)));
        let probabilities = dense(&weights, &found);
        for (p, q) in probabilities.iter().zip(&truth.probabilities) {
            if *q > 1e-200 {
                worst = worst.max((p / q - 1.0).abs());
                assert!((p / q - 1.0).abs() <= 1e-12, "{p} {q} in {problem:?}");
            } else {
                assert!(*p <= 2e-200);
            }
        }
        let scale = truth.log_total.abs().max(1.0);
        assert!((found.log_total - truth.log_total).abs() <= 1e-12 * scale, "{} {}", found.log_total, truth.log_total);
        for row in probabilities.chunks(problem.columns()) {
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-13);
        }
        for column in 1..problem.columns() {
            let sum: f64 = probabilities.iter().skip(column).step_by(problem.columns()).sum();
            assert!(sum <= 1.0 + 1e-13);
        }
    }
    println!("worst relative error {worst:e}");
}
