//! Batches: the lanes against the equations written down one number at a time, at every level and number of threads, bit
//! for bit; and against the filter of one sequence to rounding.

// Entries by their indices, as in the equations.
#![allow(clippy::needless_range_loop)]

use nalgebra::{DMatrix, DVector};
use trackrs::Gaussian;
use trackrs::filter::batch::{TrackBatch, Wanted};
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::lanes::Level;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk};
use trackrs::model::sensor::{PositionSensor, RangeBearing};
use trackrs::model::{Motion, MotionModel, SensorModel};
use trackrs::stats::stream::Stream;

const ALL: Wanted = Wanted {
    means: true,
    covs: true,
    nis: true,
};

fn motion(dims: usize, order: usize) -> MotionModel {
    let psd = KinematicNoise::Psd((0..dims).map(|axis| 0.3 + 0.2 * axis as f64).collect());
    match order {
        1 => MotionModel::RandomWalk(RandomWalk::new(psd).unwrap()),
        2 => MotionModel::ConstantVelocity(ConstantVelocity::new(psd).unwrap()),
        _ => MotionModel::ConstantAcceleration(ConstantAcceleration::new(psd).unwrap()),
    }
}

fn sensor_std(dims: usize) -> Vec<f64> {
    (0..dims).map(|axis| 1.0 + 0.5 * axis as f64).collect()
}

fn filter(dims: usize, order: usize) -> Filter {
    let sensor = SensorModel::Position(PositionSensor::new(sensor_std(dims)).unwrap());
    Filter::kalman(motion(dims, order), sensor).unwrap()
}

/// Times with an interval of zero and others of their own; starts of their own; some components missing.
struct Case {
    times: Vec<f64>,
    means: Vec<f64>,
    covs: Vec<f64>,
    values: Vec<f64>,
}

fn case(dims: usize, order: usize, tracks: usize, steps: usize, seed: u64) -> Case {
    let n = dims * order;
    let mut stream = Stream::new(seed, 0);
    let mut time = 0.0;
    let times: Vec<f64> = (0..steps)
        .map(|k| {
            time += [1.0, 1.0, 0.25, 0.0, 2.5][k % 5];
            time
        })
        .collect();
    let means = (0..tracks * n).map(|_| 3.0 * stream.normal()).collect();
    let mut covs = Vec::new();
    for _ in 0..tracks {
        let root = DMatrix::from_fn(n, n, |_, _| stream.normal());
        let cov = &root * root.transpose() + DMatrix::identity(n, n) * 0.5;
        let cov = (&cov + cov.transpose()) * 0.5;
        covs.extend_from_slice(cov.as_slice());
    }
    let values = (0..tracks * steps * dims)
        .map(|_| {
            let value = 5.0 * stream.normal();
            if stream.uniform() < 0.15 { f64::NAN } else { value }
        })
        .collect();
    Case {
        times,
        means,
        covs,
        values,
    }
}

/// Equations 1 to 6 of `lanes::kinematic` for one track, on whole matrices: the order of the operations is all that counts.
struct Oracle {
    d: usize,
    k: usize,
    x: Vec<f64>,
    p: Vec<Vec<f64>>,
}

impl Oracle {
    fn mirror(&mut self) {
        for i in 0..self.x.len() {
            for j in 0..i {
                self.p[j][i] = self.p[i][j];
            }
        }
    }

    fn predict(&mut self, motion: &MotionModel, dt: f64) {
        let (d, h) = (self.d, 0.5 * dt * dt);
        let old = self.p.clone();
        // Rows of blocks: g = P Fᵀ for columns c, then F g.
        let g = |i: usize, block: usize, axis: usize| {
            let mut sum = old[i][block * d + axis];
            if block + 1 < self.k {
                sum += dt * old[i][(block + 1) * d + axis];
            }
            if block + 2 < self.k {
                sum += h * old[i][(block + 2) * d + axis];
            }
            sum
        };
        let q = motion.noise(dt);
        for a in 0..self.k {
            for i in 0..d {
                for b in 0..=a {
                    for j in 0..d {
                        let (row, column) = (a * d + i, b * d + j);
                        if column > row {
                            continue;
                        }
                        let mut sum = g(row, b, j);
                        if a + 1 < self.k {
                            sum += dt * g((a + 1) * d + i, b, j);
                        }
                        if a + 2 < self.k {
                            sum += h * g((a + 2) * d + i, b, j);
                        }
                        if i == j {
                            sum += q[(row, column)];
                        }
                        self.p[row][column] = sum;
                    }
                }
            }
        }
        for i in 0..d {
            if self.k > 1 {
                self.x[i] += dt * self.x[d + i];
            }
            if self.k > 2 {
                self.x[i] += h * self.x[2 * d + i];
                self.x[d + i] += dt * self.x[2 * d + i];
            }
        }
        self.mirror();
    }

    fn update(&mut self, z: &[f64], r: &[f64]) -> f64 {
        let (d, n) = (self.d, self.x.len());
        let seen: Vec<bool> = z.iter().map(|value| !value.is_nan()).collect();
        let nu: Vec<f64> = (0..d).map(|k| if seen[k] { z[k] - self.x[k] } else { 0.0 }).collect();
        let c = |i: usize, k: usize| if seen[k] { self.p[i][k] } else { 0.0 };
        let (mut l, mut pivot, mut reciprocal) = (vec![vec![0.0; d]; d], vec![1.0; d], vec![1.0; d]);
        for j in 0..d {
            let mut rest = if seen[j] { self.p[j][j] + r[j] } else { 1.0 };
            for k in 0..j {
                rest -= l[j][k] * l[j][k] * pivot[k];
            }
            pivot[j] = rest;
            reciprocal[j] = 1.0 / rest;
            for i in j + 1..d {
                let mut rest = if seen[i] { c(i, j) } else { 0.0 };
                for k in 0..j {
                    rest -= l[i][k] * l[j][k] * pivot[k];
                }
                l[i][j] = rest * reciprocal[j];
            }
        }
        let solve = |mut y: Vec<f64>| {
            for i in 0..d {
                for k in 0..i {
                    y[i] -= l[i][k] * y[k];
                }
            }
            for i in 0..d {
                y[i] *= reciprocal[i];
            }
            for i in (0..d).rev() {
                for k in i + 1..d {
                    y[i] -= l[k][i] * y[k];
                }
            }
            y
        };
        let gain: Vec<Vec<f64>> = (0..n).map(|i| solve((0..d).map(|k| c(i, k)).collect())).collect();
        for i in 0..n {
            for k in 0..d {
                self.x[i] += gain[i][k] * nu[k];
            }
        }
        let old = self.p.clone();
        let left = |i: usize, j: usize| (0..d).fold(old[i][j], |sum, k| sum - gain[i][k] * old[k][j]);
        for i in 0..n {
            for j in 0..=i {
                let mut entry = left(i, j);
                for k in 0..d {
                    entry -= left(i, k) * gain[j][k];
                }
                for k in 0..d {
                    entry += gain[i][k] * r[k] * gain[j][k];
                }
                self.p[i][j] = entry;
            }
        }
        self.mirror();
        let solved = solve(nu.clone());
        if seen.iter().any(|&s| s) {
            (0..d).fold(0.0, |sum, k| sum + nu[k] * solved[k])
        } else {
            f64::NAN
        }
    }
}

fn same(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len()
        && a.iter()
            .zip(b)
            .all(|(a, b)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan()))
}

#[test]
fn lanes_are_the_equations_bit_for_bit_at_every_level() {
    for dims in 1..=3 {
        for order in 1..=3 {
            let n = dims * order;
            let (tracks, steps) = (19, 11);
            let case = case(dims, order, tracks, steps, 10 * dims as u64 + order as u64);
            let variances: Vec<f64> = sensor_std(dims).iter().map(|std| std * std).collect();
            let (mut means, mut covs, mut nis) = (Vec::new(), Vec::new(), Vec::new());
            for track in 0..tracks {
                let cov = &case.covs[track * n * n..(track + 1) * n * n];
                let mut oracle = Oracle {
                    d: dims,
                    k: order,
                    x: case.means[track * n..(track + 1) * n].to_vec(),
                    p: (0..n).map(|i| cov[i * n..(i + 1) * n].to_vec()).collect(),
                };
                let mut previous = 0.0;
                for (t, &time) in case.times.iter().enumerate() {
                    oracle.predict(&motion(dims, order), time - previous);
                    previous = time;
                    let row = (track * steps + t) * dims;
                    nis.push(oracle.update(&case.values[row..row + dims], &variances));
                    means.extend_from_slice(&oracle.x);
                    covs.extend(oracle.p.iter().flatten());
                }
            }
            for level in Level::available() {
                let batch = TrackBatch::new(filter(dims, order), 0.0, &case.means, &case.covs).unwrap();
                assert!(batch.in_lanes());
                let mut batch = batch.at_level(level);
                let run = batch.run(&case.times, &case.values, ALL).unwrap();
                assert!(same(&run.means, &means), "means {dims} {order} {level:?}");
                assert!(same(&run.covs, &covs), "covs {dims} {order} {level:?}");
                assert!(same(&run.nis, &nis), "nis {dims} {order} {level:?}");
                let last: Vec<f64> = (0..tracks)
                    .flat_map(|b| means[((b + 1) * steps - 1) * n..][..n].to_vec())
                    .collect();
                assert!(same(&batch.means(), &last));
            }
        }
    }
}

#[test]
fn lanes_agree_with_the_filter_of_one_sequence() {
    for (dims, order) in [(1, 1), (2, 2), (2, 3), (3, 3)] {
        let n = dims * order;
        let (tracks, steps) = (9, 25);
        let case = case(dims, order, tracks, steps, 77);
        let kf = filter(dims, order);
        let mut batch = TrackBatch::new(kf.clone(), 0.0, &case.means, &case.covs).unwrap();
        let run = batch.run(&case.times, &case.values, ALL).unwrap();
        for track in 0..tracks {
            let rows = case.values[track * steps * dims..(track + 1) * steps * dims].chunks_exact(dims);
            let values: Vec<DVector<f64>> = rows.map(DVector::from_row_slice).collect();
            let state = Gaussian {
                mean: DVector::from_row_slice(&case.means[track * n..(track + 1) * n]),
                cov: DMatrix::from_row_slice(n, n, &case.covs[track * n * n..(track + 1) * n * n]),
            };
            let initial = InitialState { time: 0.0, state };
            let one = kf
                .run(&case.times, &values, Some(&initial), None, History::Filtered)
                .unwrap();
            for k in 0..steps {
                let (row, estimate) = (track * steps + k, one.filtered.at(k));
                let scale = estimate.cov.amax();
                for i in 0..n {
                    assert!((run.means[row * n + i] - estimate.mean[i]).abs() < 1e-11 * (1.0 + estimate.mean.amax()));
                    for j in 0..n {
                        assert!((run.covs[(row * n + i) * n + j] - estimate.cov[(i, j)]).abs() < 1e-11 * scale);
                    }
                }
                let (a, b) = (run.nis[row], one.nis[k]);
                assert!(
                    (a - b).abs() < 1e-9 * (1.0 + b) || (a.is_nan() && b.is_nan()),
                    "{a} {b}"
                );
            }
        }
    }
}

#[test]
fn threads_pieces_and_neighbours_change_nothing() {
    let (tracks, steps) = (1203, 40);
    let case = case(2, 2, tracks, steps, 5);
    let make = || TrackBatch::new(filter(2, 2), 0.0, &case.means, &case.covs).unwrap();
    let whole = make()
        .with_threads(1)
        .unwrap()
        .run(&case.times, &case.values, ALL)
        .unwrap();
    for threads in [2, 3, 7] {
        let run = make()
            .with_threads(threads)
            .unwrap()
            .run(&case.times, &case.values, ALL)
            .unwrap();
        assert!(same(&run.means, &whole.means) && same(&run.covs, &whole.covs) && same(&run.nis, &whole.nis));
    }
    // Scan by scan.
    let mut batch = make();
    for (t, &time) in case.times.iter().enumerate() {
        let scan: Vec<f64> = (0..tracks)
            .flat_map(|b| case.values[(b * steps + t) * 2..][..2].to_vec())
            .collect();
        batch.run(&[time], &scan, Wanted::default()).unwrap();
    }
    let mut at_once = make();
    at_once.run(&case.times, &case.values, Wanted::default()).unwrap();
    assert!(same(&batch.means(), &at_once.means()) && same(&batch.covs(), &at_once.covs()));
    // One track alone.
    let track = 1200;
    let mut alone = TrackBatch::new(
        filter(2, 2),
        0.0,
        &case.means[track * 4..][..4],
        &case.covs[track * 16..][..16],
    )
    .unwrap();
    let run = alone
        .run(&case.times, &case.values[track * steps * 2..][..steps * 2], ALL)
        .unwrap();
    assert!(same(&run.means, &whole.means[track * steps * 4..][..steps * 4]));
}

#[test]
fn other_filters_run_track_by_track() {
    let sensor = SensorModel::RangeBearing(RangeBearing::new([0.0, 0.0], 5.0, 0.01).unwrap());
    let ekf = Filter::extended(motion(2, 2), sensor).unwrap();
    let (tracks, steps) = (13, 6);
    let means: Vec<f64> = (0..tracks).flat_map(|b| [300.0 + b as f64, 400.0, 1.0, -1.0]).collect();
    let cov: Vec<f64> = DMatrix::<f64>::identity(4, 4).as_slice().to_vec();
    let times: Vec<f64> = (1..=steps).map(|k| k as f64).collect();
    let values: Vec<f64> = (0..tracks * steps)
        .flat_map(|k| [500.0 + (k % 3) as f64, 0.92])
        .collect();
    let runs: Vec<_> = [1, 3]
        .into_iter()
        .map(|threads| {
            let batch = TrackBatch::new(ekf.clone(), 0.0, &means, &cov).unwrap();
            assert!(!batch.in_lanes());
            let mut batch = batch.with_threads(threads).unwrap();
            let run = batch.run(&times, &values, ALL).unwrap();
            assert!(same(&batch.means()[..4], &run.means[(steps - 1) * 4..steps * 4]));
            run
        })
        .collect();
    assert_eq!(runs[0], runs[1]);
    let one: Vec<DVector<f64>> = values[..steps * 2]
        .chunks_exact(2)
        .map(DVector::from_row_slice)
        .collect();
    let initial = InitialState {
        time: 0.0,
        state: Gaussian {
            mean: DVector::from_row_slice(&means[..4]),
            cov: DMatrix::identity(4, 4),
        },
    };
    let run = ekf.run(&times, &one, Some(&initial), None, History::Filtered).unwrap();
    for k in 0..steps {
        assert!(same(
            &runs[0].means[k * 4..(k + 1) * 4],
            run.filtered.at(k).mean.as_slice()
        ));
    }
}

#[test]
fn what_is_not_observed_is_predicted_only() {
    let kf = filter(1, 1);
    assert!(TrackBatch::new(kf.clone(), 0.0, &[0.0], &[-5.0]).is_err());
    let mut batch = TrackBatch::new(kf, 0.0, &[0.0, 1.0, 2.0], &[1.0]).unwrap();
    batch
        .run(&[1.0], &[f64::NAN, 1.0, f64::NAN], Wanted::default())
        .unwrap();
    assert_eq!(batch.failures(), [0, 0, 0]);
    assert_eq!(batch.means()[0], 0.0);
    assert_eq!(batch.covs()[0], batch.covs()[2]);
    assert!(batch.covs()[1] < batch.covs()[0]);
}

#[test]
fn mistakes_are_named() {
    let make = || TrackBatch::new(filter(2, 2), 3.0, &[0.0; 8], DMatrix::<f64>::identity(4, 4).as_slice()).unwrap();
    let message = |result: trackrs::Result<trackrs::filter::batch::BatchRun>| result.unwrap_err().to_string();
    assert!(message(make().run(&[2.0], &[0.0; 4], ALL)).contains('2'));
    assert!(message(make().run(&[4.0], &[0.0; 3], ALL)).contains("measurements"));
    assert!(message(make().run(&[4.0], &[0.0, 0.0, f64::INFINITY, 0.0], ALL)).contains("measurement"));
    assert!(message(make().run(&[f64::NAN], &[0.0; 4], ALL)).contains("times"));
    assert!(make().with_threads(0).is_err());
    assert!(TrackBatch::new(filter(2, 2), 0.0, &[0.0; 7], &[1.0; 16]).is_err());
    let lopsided = DMatrix::from_fn(4, 4, |i, j| if i == j { 2.0 } else { 0.1 * (i as f64) });
    let error = TrackBatch::new(filter(2, 2), 0.0, &[0.0; 4], lopsided.as_slice()).unwrap_err();
    assert!(error.to_string().contains("symmetric"), "{error}");
    assert!(make().run(&[], &[], ALL).unwrap().means.is_empty());
}

/// A track that begins close to singular leaves the lanes: it has the bits of the filter of one sequence, in one call or in
/// many, and the others have those of a batch without it.
#[test]
fn a_track_that_escalates_is_that_of_a_run() {
    let (dims, order, tracks, steps) = (2, 2, 19, 40);
    let (filter, n) = (filter(dims, order), 4);
    let mut case = case(dims, order, tracks, steps, 5);
    case.times.iter_mut().for_each(|time| *time -= 1.0);
    let odd = [3, 17];
    for track in odd {
        let cov = &mut case.covs[track * n * n..(track + 1) * n * n];
        cov.copy_from_slice(DMatrix::<f64>::identity(n, n).as_slice());
        (cov[2], cov[2 * n]) = (1.0 - 1e-15, 1.0 - 1e-15);
    }
    let batch = |level| {
        let batch = TrackBatch::new(filter.clone(), 0.0, &case.means, &case.covs).unwrap();
        batch.at_level(level)
    };
    let mut healthy = case.covs.clone();
    for track in odd {
        healthy[track * n * n..(track + 1) * n * n].copy_from_slice(DMatrix::<f64>::identity(n, n).as_slice());
    }
    let mut others = TrackBatch::new(filter.clone(), 0.0, &case.means, &healthy).unwrap();
    let others = others.run(&case.times, &case.values, ALL).unwrap();
    for level in Level::available() {
        for threads in [1, 2] {
            let mut whole = batch(level).with_threads(threads).unwrap();
            let run = whole.run(&case.times, &case.values, ALL).unwrap();
            assert_eq!(
                (0..tracks)
                    .filter(|&track| whole.escalated()[track])
                    .collect::<Vec<_>>(),
                odd
            );
            let mut parts = batch(level).with_threads(threads).unwrap();
            for step in 0..steps {
                let values: Vec<f64> = (0..tracks)
                    .flat_map(|track| case.values[(track * steps + step) * dims..][..dims].to_vec())
                    .collect();
                parts.run(&case.times[step..=step], &values, Wanted::default()).unwrap();
            }
            assert_eq!((parts.means(), parts.covs()), (whole.means(), whole.covs()));
            assert!(whole.failures().iter().all(|&failures| failures == 0));
            for track in 0..tracks {
                let part = |all: &[f64], width: usize| {
                    let part = &all[track * steps * width..(track + 1) * steps * width];
                    part.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
                };
                if odd.contains(&track) {
                    let values: Vec<DVector<f64>> = case.values[track * steps * dims..(track + 1) * steps * dims]
                        .chunks_exact(dims)
                        .map(DVector::from_row_slice)
                        .collect();
                    let state = Gaussian {
                        mean: DVector::from_row_slice(&case.means[track * n..(track + 1) * n]),
                        cov: DMatrix::from_row_slice(n, n, &case.covs[track * n * n..(track + 1) * n * n]),
                    };
                    let initial = InitialState { time: 0.0, state };
                    let one = filter
                        .run(&case.times, &values, Some(&initial), None, History::Filtered)
                        .unwrap();
                    assert_eq!(one.books.events.counts().len(), 1);
                    let bits = |all: &[f64]| all.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                    assert_eq!(part(&run.means, n), bits(one.filtered.means.values()));
                    assert_eq!(part(&run.covs, n * n), bits(one.filtered.covs.values()));
                    assert_eq!(part(&run.nis, 1), bits(&one.nis));
                } else {
                    assert_eq!(part(&run.means, n), part(&others.means, n));
                    assert_eq!(part(&run.covs, n * n), part(&others.covs, n * n));
                }
            }
        }
    }
    let mut strict = TrackBatch::new(filter.with_strict(), 0.0, &case.means, &case.covs).unwrap();
    assert!(strict.run(&case.times, &case.values, ALL).is_err());
    assert_eq!(
        (strict.means(), strict.covs(), strict.time()),
        (case.means.clone(), case.covs.clone(), 0.0)
    );
}
