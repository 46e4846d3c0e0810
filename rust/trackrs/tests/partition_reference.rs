//! Partitions over the index against the definitions written out over all pairs: random points, duplicates, points on a
//! line, ties on a lattice, one to four dimensions.

use trackrs::partition::density_peaks::{DensityPeakPartition, Kernel, Peaks, Scale};
use trackrs::partition::kmeans::KMeansPartition;
use trackrs::partition::lof::LocalOutlierFactor;
use trackrs::partition::{Partitioner, Points};
use trackrs::stats::stream::Stream;

/// Sets of points of every kind.
fn sets() -> Vec<Points> {
    let mut out = Vec::new();
    for dims in 1..=4 {
        for n in [1, 2, 3, 15, 16, 17, 33, 70, 300] {
            let mut stream = Stream::new(9, (n * 10 + dims) as u64);
            let random: Vec<f64> = (0..n * dims).map(|_| stream.normal()).collect();
            let mut piled = random.clone();
            for (at, row) in piled.chunks_exact_mut(dims).enumerate() {
                if at % 3 == 0 {
                    row.fill(0.25);
                }
            }
            let lattice: Vec<f64> = random.iter().map(|x| (x * 2.0).round() * 0.5).collect();
            let line: Vec<f64> = (0..n).flat_map(|i| vec![0.5 * (i % 40) as f64; dims]).collect();
            for values in [random, piled, lattice, line] {
                out.push(Points::new(&values, dims).unwrap());
            }
        }
    }
    out
}

fn scattered(n: usize, dims: usize) -> Points {
    let mut stream = Stream::new(8, n as u64);
    let values: Vec<f64> = (0..n * dims).map(|_| stream.normal()).collect();
    Points::new(&values, dims).unwrap()
}

fn distance(points: &Points, i: usize, j: usize) -> f64 {
    points.distance_squared(i, j).sqrt()
}

#[test]
fn density_peaks_with_a_cut_off_are_the_definition_to_the_last_bit() {
    for points in sets() {
        let n = points.len();
        for d_c in [0.5, 0.7] {
            let found = DensityPeakPartition {
                scale: Scale::Length(d_c),
                kernel: Kernel::Cutoff,
                peaks: Peaks::Count(3),
                max_link: None,
            };
            let found = found.explain(&points).unwrap();
            let near = |i: usize| (0..n).filter(|&j| j != i && distance(&points, i, j) < d_c).count() as f64;
            let rho: Vec<f64> = (0..n).map(near).collect();
            assert_eq!(found.rho, rho);
            let mut order: Vec<usize> = (0..n).collect();
            order.sort_by(|&a, &b| rho[b].total_cmp(&rho[a]).then(a.cmp(&b)));
            assert_eq!(found.order, order);
            for (rank, &i) in order.iter().enumerate() {
                let mut best: Option<usize> = None;
                for &j in &order[..rank] {
                    if best.is_none_or(|b| points.distance_squared(i, j) < points.distance_squared(i, b)) {
                        best = Some(j);
                    }
                }
                assert_eq!(found.nearest_denser[i], best);
                let farthest = (0..n).map(|j| distance(&points, i, j)).fold(0.0, f64::max);
                assert_eq!(found.delta[i], best.map_or(farthest, |j| distance(&points, i, j)));
            }
            let mut peaks = order.clone();
            peaks.sort_by(|&a, &b| (rho[b] * found.delta[b]).total_cmp(&(rho[a] * found.delta[a])));
            peaks.truncate(3);
            assert_eq!(found.peaks, peaks);
        }
    }
}

/// More pairs than are listed at once, ties and coincident points among them.
#[test]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the rule's own rounding of a positive count"
)]
fn the_distance_that_a_percentage_of_pairs_keeps_is_found_without_listing_them() {
    let mut stream = Stream::new(12, 0);
    let loose: Vec<f64> = (0..1200).map(|_| stream.between(0.0, 100.0)).collect();
    let grid: Vec<f64> = loose.iter().map(|x| (x / 10.0).floor()).collect();
    let mostly_one: Vec<f64> = loose
        .iter()
        .enumerate()
        .map(|(i, &x)| if i < 1100 { 3.0 } else { x })
        .collect();
    for values in [loose, grid, mostly_one, vec![1.0; 1200]] {
        let points = Points::new(&values, 2).unwrap();
        let n = points.len();
        let mut pairs: Vec<f64> = (0..n)
            .flat_map(|i| (0..i).map(move |j| (i, j)))
            .map(|(i, j)| distance(&points, i, j))
            .collect();
        pairs.sort_by(f64::total_cmp);
        for percent in [1e-4, 0.5, 2.0, 37.0, 99.99, 100.0] {
            let wanted = ((pairs.len() as f64 * percent / 100.0 + 0.5) as usize).clamp(1, pairs.len());
            let apart = pairs[wanted - 1..].iter().copied().find(|&d| d > 0.0);
            let rule = DensityPeakPartition {
                scale: Scale::Percent(percent),
                ..DensityPeakPartition::default()
            };
            assert_eq!(rule.explain(&points).unwrap().d_c, apart.unwrap_or(1.0), "{percent} %");
        }
    }
}

#[test]
fn outlier_factors_are_the_definition() {
    for points in sets() {
        let n = points.len();
        for (k, include_ties) in [(1, false), (4, true), (4, false), (20, true), (20, false), (60, false)] {
            let lof = LocalOutlierFactor {
                n_neighbors: k,
                threshold: 2.0,
                include_ties,
            };
            let found = lof.explain(&points).unwrap();
            let k = k.min(n - 1);
            let around: Vec<Vec<usize>> = (0..n)
                .map(|i| {
                    let mut others: Vec<usize> = (0..n).filter(|&j| j != i).collect();
                    others.sort_by(|&a, &b| {
                        points
                            .distance_squared(i, a)
                            .total_cmp(&points.distance_squared(i, b))
                            .then(a.cmp(&b))
                    });
                    let kept = match others.get(k.wrapping_sub(1)) {
                        Some(&last) if include_ties => {
                            let far = points.distance_squared(i, last);
                            others.iter().filter(|&&j| points.distance_squared(i, j) <= far).count()
                        }
                        _ => k,
                    };
                    others.truncate(kept);
                    others
                })
                .collect();
            let reach = |i: usize| around[i].iter().map(|&j| distance(&points, i, j)).fold(0.0, f64::max);
            let k_distance: Vec<f64> = (0..n).map(reach).collect();
            assert_eq!(found.k_distance, k_distance);
            let density = |i: usize| {
                let sum: f64 = around[i]
                    .iter()
                    .map(|&j| distance(&points, i, j).max(k_distance[j]))
                    .sum();
                if k_distance[i] == 0.0 {
                    f64::INFINITY
                } else {
                    around[i].len() as f64 / sum
                }
            };
            let density: Vec<f64> = (0..n).map(density).collect();
            for i in 0..n {
                let ratio = |&j: &usize| match (density[j], density[i]) {
                    (f64::INFINITY, f64::INFINITY) => 1.0,
                    (a, b) => a / b,
                };
                let mean = around[i].iter().map(ratio).sum::<f64>() / around[i].len() as f64;
                let expected = if k_distance[i] == 0.0 { 1.0 } else { mean };
                let close = |a: f64, b: f64| a == b || (a - b).abs() <= 1e-12 * b.abs();
                assert!(close(found.reachability_density[i], density[i]), "lrd of {i}");
                assert!(
                    close(found.factors[i], expected),
                    "{} is not {expected}",
                    found.factors[i]
                );
            }
        }
    }
}

/// Labels are those of the nearest means, which is what the iteration ends with.
#[test]
fn k_means_ends_where_nothing_changes() {
    // Many points are put in another order.
    let many = [(1_500, 2), (2_001, 3)].map(|(n, dims)| scattered(n, dims));
    for points in sets().into_iter().chain(many) {
        let (n, dims) = (points.len(), points.dims());
        let k_means = KMeansPartition {
            lower: 5,
            upper: 5,
            seed: 3,
        };
        let labels: Vec<usize> = k_means.labels(&points).unwrap().into_iter().flatten().collect();
        let clusters = labels.iter().max().unwrap() + 1;
        let mut means = vec![0.0; clusters * dims];
        let mut counts = vec![0.0; clusters];
        for (i, &label) in labels.iter().enumerate() {
            counts[label] += 1.0;
            for axis in 0..dims {
                means[label * dims + axis] += points.point(i)[axis];
            }
        }
        for (i, &own) in labels.iter().enumerate() {
            let square = |label: usize| -> f64 {
                let mean = (0..dims).map(|axis| means[label * dims + axis] / counts[label]);
                mean.zip(points.point(i)).map(|(mean, x)| (x - mean) * (x - mean)).sum()
            };
            let least = (0..clusters).map(square).fold(f64::INFINITY, f64::min);
            assert!(square(own) <= least + 1e-12, "point {i} of {n}, {dims} dimensions");
        }
    }
}
