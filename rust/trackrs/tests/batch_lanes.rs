//! Lanes against the equations written down one number at a time, at every level, bit for bit; and against the filter of one
//! sequence to rounding.

// Entries by their indices, as in the equations.
#![allow(clippy::needless_range_loop)]

use nalgebra::{DMatrix, DVector};
use trackrs::Gaussian;
use trackrs::filter::batch::TrackBatch;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::lanes::Level;
use trackrs::model::{Motion, MotionModel};

use crate::batches::{ALL, Case, case, filter, linear, linear_filter, motion, same, sensor_std};

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

    /// Equations 1 to 5 of `lanes::linear`, all of a step.
    fn update_linear(&mut self, z: &[f64], sensor: &(DMatrix<f64>, DMatrix<f64>, Vec<f64>)) -> f64 {
        let ((rows, noise, offset), (m, n)) = (sensor, (z.len(), self.x.len()));
        let seen: Vec<bool> = z.iter().map(|value| !value.is_nan()).collect();
        let (mut l, mut own) = (vec![vec![0.0; m]; m], vec![1.0; m]);
        let (mut h, mut y, mut nis) = (vec![vec![0.0; n]; m], vec![0.0; m], 0.0);
        for k in 0..m {
            own[k] = if seen[k] { noise[(k, k)] } else { 1.0 };
            for j in 0..k {
                let mut rest = if seen[k] && seen[j] { noise[(k, j)] } else { 0.0 };
                for i in 0..j {
                    rest -= l[k][i] * l[j][i] * own[i];
                }
                l[k][j] = rest * (1.0 / own[j]);
                own[k] -= l[k][j] * l[k][j] * own[j];
            }
            y[k] = if seen[k] { z[k] - offset[k] } else { 0.0 };
            h[k] = rows.row(k).iter().copied().collect();
            for j in 0..k {
                y[k] -= l[k][j] * y[j];
                for i in 0..n {
                    h[k][i] -= l[k][j] * h[j][i];
                }
            }
            if !seen[k] {
                continue;
            }
            let dot = |a: &[f64], b: &[f64]| (1..n).fold(a[0] * b[0], |sum, i| sum + a[i] * b[i]);
            let cross: Vec<f64> = self.p.iter().map(|row| dot(row, &h[k])).collect();
            let spread = dot(&h[k], &cross);
            let inverse = 1.0 / (spread + own[k]);
            let nu = y[k] - dot(&h[k], &self.x);
            nis += nu * nu * inverse;
            let gain: Vec<f64> = cross.iter().map(|c| c * inverse).collect();
            for i in 0..n {
                self.x[i] += gain[i] * nu;
                let left = cross[i] - gain[i] * spread;
                for j in 0..=i {
                    self.p[i][j] = self.p[i][j] - gain[i] * cross[j] - left * gain[j] + gain[i] * own[k] * gain[j];
                }
            }
            self.mirror();
        }
        if seen.contains(&true) { nis } else { f64::NAN }
    }
}

/// That the lanes have the bits of the equations, of motions in `dims` axes and sensors of `m` components.
fn check_bits(what: &str, kf: &Filter, case: &Case, m: usize, update: impl Fn(&mut Oracle, &[f64]) -> f64) {
    let motion = kf.motion();
    let (d, n) = (motion.position_dims(), motion.state_dim());
    let (tracks, steps) = (case.means.len() / n, case.times.len());
    let (mut means, mut covs, mut nis) = (Vec::new(), Vec::new(), Vec::new());
    for track in 0..tracks {
        let cov = &case.covs[track * n * n..(track + 1) * n * n];
        let mut oracle = Oracle {
            d,
            k: n / d,
            x: case.means[track * n..(track + 1) * n].to_vec(),
            p: (0..n).map(|i| cov[i * n..(i + 1) * n].to_vec()).collect(),
        };
        let mut previous = 0.0;
        for (t, &time) in case.times.iter().enumerate() {
            oracle.predict(motion, time - previous);
            previous = time;
            let row = (track * steps + t) * m;
            nis.push(update(&mut oracle, &case.values[row..row + m]));
            means.extend_from_slice(&oracle.x);
            covs.extend(oracle.p.iter().flatten());
        }
    }
    for level in Level::available() {
        let batch = TrackBatch::new(kf.clone(), 0.0, &case.means, &case.covs).unwrap();
        assert!(batch.in_lanes(), "{what}");
        let mut batch = batch.at_level(level);
        let run = batch.run(&case.times, &case.values, ALL).unwrap();
        assert!(same(&run.means, &means), "means {what} {level:?}");
        assert!(same(&run.covs, &covs), "covs {what} {level:?}");
        assert!(same(&run.nis, &nis), "nis {what} {level:?}");
        let last: Vec<f64> = (0..tracks)
            .flat_map(|b| means[((b + 1) * steps - 1) * n..][..n].to_vec())
            .collect();
        assert!(same(&batch.means(), &last));
    }
}

#[test]
fn lanes_are_the_equations_bit_for_bit_at_every_level() {
    for (dims, order) in (1..=3).flat_map(|dims| (1..=3).map(move |order| (dims, order))) {
        let (n, seed) = (dims * order, 10 * dims as u64 + order as u64);
        let variances: Vec<f64> = sensor_std(dims).iter().map(|std| std * std).collect();
        let case_of = |m: usize| case(n, m, 19, 11, seed);
        check_bits("positions", &filter(dims, order), &case_of(dims), dims, |oracle, z| {
            oracle.update(z, &variances)
        });
        for m in 1..=3 {
            for correlated in [false, true] {
                let sensor = linear(n, m, correlated, seed);
                let kf = linear_filter(motion(dims, order), &sensor);
                check_bits(&format!("{m} rows of {n}"), &kf, &case_of(m), m, |oracle, z| {
                    oracle.update_linear(z, &sensor)
                });
            }
        }
    }
}

/// That the lanes agree with the filter of one sequence.
fn check_runs(what: &str, kf: &Filter, case: &Case, m: usize) {
    let n = kf.motion().state_dim();
    let (tracks, steps) = (case.means.len() / n, case.times.len());
    let mut batch = TrackBatch::new(kf.clone(), 0.0, &case.means, &case.covs).unwrap();
    assert!(batch.in_lanes(), "{what}");
    let run = batch.run(&case.times, &case.values, ALL).unwrap();
    for track in 0..tracks {
        let rows = case.values[track * steps * m..(track + 1) * steps * m].chunks_exact(m);
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
            // Roundings of a mean count by how far off it may be anyway.
            let size = 1.0 + estimate.mean.amax() + scale.sqrt();
            for i in 0..n {
                let off = run.means[row * n + i] - estimate.mean[i];
                assert!(off.abs() < 1e-11 * size, "{what}: {off}");
                for j in 0..n {
                    let off = run.covs[(row * n + i) * n + j] - estimate.cov[(i, j)];
                    assert!(off.abs() < 1e-11 * scale, "{what}: {off}");
                }
            }
            let (a, b) = (run.nis[row], one.nis[k]);
            let close = (a - b).abs() < 1e-9 * (1.0 + b) || (a.is_nan() && b.is_nan());
            assert!(close, "{what}: {a} {b}");
        }
    }
}

#[test]
fn lanes_agree_with_the_filter_of_one_sequence() {
    for (dims, order) in [(1, 1), (2, 2), (2, 3), (3, 3)] {
        let n = dims * order;
        check_runs("positions", &filter(dims, order), &case(n, dims, 9, 25, 77), dims);
        for m in 1..=3 {
            for correlated in [false, true] {
                let kf = linear_filter(motion(dims, order), &linear(n, m, correlated, 7));
                check_runs(&format!("{m} rows of {n}"), &kf, &case(n, m, 9, 25, 77), m);
            }
        }
    }
}

#[test]
fn sensors_that_are_not_for_lanes() {
    let in_lanes = |noise: DMatrix<f64>| {
        let m = noise.nrows();
        let kf = linear_filter(motion(2, 2), &(DMatrix::identity(m, 4), noise, vec![0.0; m]));
        let cov = DMatrix::<f64>::identity(4, 4);
        let batch = TrackBatch::new(kf, 0.0, &[0.0; 4], cov.as_slice()).unwrap();
        batch.in_lanes()
    };
    assert!(in_lanes(DMatrix::identity(3, 3)));
    assert!(!in_lanes(DMatrix::identity(4, 4)), "too many components");
    let nearly_one = DMatrix::from_row_slice(2, 2, &[1.0, 1.0 - 1e-9, 1.0 - 1e-9, 1.0]);
    assert!(!in_lanes(nearly_one), "one and the same component twice");
}
