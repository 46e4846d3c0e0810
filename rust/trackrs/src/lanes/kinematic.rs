//! Kalman filter of kinematic motions and position sensors, several tracks to a register.
//!
//! | symbol  | name here     | shape       | meaning                                                              |
//! |---------|---------------|-------------|----------------------------------------------------------------------|
//! | d       | `D`           |             | coordinates of a position, 1 to 3                                    |
//! | K       | `K`           |             | blocks of the state: positions, velocities, accelerations            |
//! | N       | `N` = D K     |             | states                                                               |
//! | dt, h   | `dt`, `half`  |             | time step, dt²/2                                                     |
//! | P_ab    | `p`           | D×D         | block of the covariance, a, b ∈ {p, v, a}                            |
//! | q       | [`Step::noise`] | D each    | variances and covariances of an axis: pp, vp, vv, ap, av, aa         |
//! | R       | `sensor`      | D           | variances of the sensor                                              |
//! | S, L, Δ | `s`, `l`, `pivot` | D×D     | innovation covariance, S = L Δ Lᵀ, L unit lower                      |
//!
//! Equations, in the order of the code; F is never written down:
//!
//! 1. x_p += dt x_v + h x_a, x_v += dt x_a
//! 2. G = P Fᵀ: G_ap = P_ap + dt P_av + h P_aa, and so on; P = F G + Q
//! 3. ν = z − x_p; where a component is not observed its ν is 0, its column of P Hᵀ is 0 and its S_ii is 1
//! 4. S = P_pp + R = L Δ Lᵀ, one reciprocal per pivot; a track with a pivot that is not positive keeps its prediction
//! 5. G = P Hᵀ S⁻¹ by two substitutions; x += G ν; νᵀ S⁻¹ ν
//! 6. A = (I − G H) P; P = A (I − G H)ᵀ + G R Gᵀ (Joseph), lower triangle
//!
//! The order of the operations is that of the loops at every level, so that the bits are the same. A lane is masked, not
//! branched on.
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §5.2 and §7.3 (Joseph form).

use pulp::{Simd, WithSimd};

use super::block::{Block, LANES, Lane, at};

/// A time step and the noise that gathers in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<const D: usize> {
    /// Seconds.
    pub dt: f64,
    /// Per pair of blocks, in the order pp, vp, vv, ap, av, aa, one number per axis.
    pub noise: [[f64; D]; 6],
}

/// What the filter gives for every track and step; tracks first, then steps. Parts that are not wanted are empty.
#[derive(Debug, Default)]
pub struct Outputs<'a> {
    /// N each.
    pub means: &'a mut [f64],
    /// N×N each.
    pub covs: &'a mut [f64],
    /// One each; NaN where nothing was observed.
    pub nis: &'a mut [f64],
}

/// Some steps of some blocks.
pub(crate) struct Work<'a, const D: usize, const K: usize, const N: usize, const PN: usize> {
    pub(crate) blocks: &'a mut [Block<N, PN>],
    /// Tracks in these blocks; the rest of the last one fills it up.
    pub(crate) tracks: usize,
    pub(crate) steps: &'a [Step<D>],
    pub(crate) sensor: &'a [f64; D],
    /// Measurements, D each, track after track, step after step.
    pub(crate) values: &'a [f64],
    pub(crate) out: Outputs<'a>,
    /// Per track: how often it kept its prediction because of a pivot.
    pub(crate) failures: &'a mut [u64],
}

impl<const D: usize, const K: usize, const N: usize, const PN: usize> WithSimd for Work<'_, D, K, N, PN> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            blocks,
            tracks,
            steps,
            sensor,
            values,
            mut out,
            failures,
        } = self;
        let count = steps.len();
        let width = S::F64_LANES;
        for (b, block) in blocks.iter_mut().enumerate() {
            for register in 0..LANES / width {
                let first = b * LANES + register * width;
                if first >= tracks {
                    break;
                }
                let used = width.min(tracks - first);
                let mut x: [S::f64s; N] = std::array::from_fn(|i| S::as_simd_f64s(&block.mean[i].0).0[register]);
                let mut p: [S::f64s; PN] = std::array::from_fn(|i| S::as_simd_f64s(&block.cov[i].0).0[register]);
                let mut failed = simd.splat_f64s(0.0);
                for (t, step) in steps.iter().enumerate() {
                    let z = gather::<S, D>(values, first, used, count, t);
                    predict::<S, D, K, N, PN>(simd, &mut x, &mut p, step);
                    let found = update::<S, D, N, PN>(simd, &mut x, &mut p, &z, sensor);
                    failed = simd.add_f64s(failed, found.failed);
                    if !out.means.is_empty() {
                        scatter::<S, N>(&mut out.means, &x, first, used, count, t);
                    }
                    if !out.covs.is_empty() {
                        scatter_symmetric::<S, N, PN>(&mut out.covs, &p, first, used, count, t);
                    }
                    if !out.nis.is_empty() {
                        scatter::<S, 1>(&mut out.nis, &[found.nis], first, used, count, t);
                    }
                }
                for (to, from) in block.mean.iter_mut().zip(x) {
                    S::as_mut_simd_f64s(&mut to.0).0[register] = from;
                }
                for (to, from) in block.cov.iter_mut().zip(p) {
                    S::as_mut_simd_f64s(&mut to.0).0[register] = from;
                }
                let lanes = lanes_of::<S>(failed);
                for (count, lane) in failures[first..first + used].iter_mut().zip(lanes.0) {
                    *count += lane as u64;
                }
            }
        }
    }
}

/// The lanes of a register.
#[inline(always)]
fn lanes_of<S: Simd>(register: S::f64s) -> Lane {
    let mut lane = Lane([0.0; LANES]);
    S::as_mut_simd_f64s(&mut lane.0).0[0] = register;
    lane
}

/// The measurements of some tracks at one step; lanes beyond them are not observed.
#[inline(always)]
fn gather<S: Simd, const D: usize>(values: &[f64], first: usize, used: usize, steps: usize, t: usize) -> [S::f64s; D] {
    let mut lanes = [Lane([f64::NAN; LANES]); D];
    for lane in 0..used {
        let row = ((first + lane) * steps + t) * D;
        for (to, from) in lanes.iter_mut().zip(&values[row..row + D]) {
            to.0[lane] = *from;
        }
    }
    std::array::from_fn(|i| S::as_simd_f64s(&lanes[i].0).0[0])
}

/// Writes vectors of some tracks at one step.
#[inline(always)]
fn scatter<S: Simd, const N: usize>(
    out: &mut [f64],
    registers: &[S::f64s; N],
    first: usize,
    used: usize,
    steps: usize,
    t: usize,
) {
    let mut lanes = [Lane([0.0; LANES]); N];
    for (to, from) in lanes.iter_mut().zip(registers) {
        S::as_mut_simd_f64s(&mut to.0).0[0] = *from;
    }
    for lane in 0..used {
        let row = ((first + lane) * steps + t) * N;
        for (to, from) in out[row..row + N].iter_mut().zip(&lanes) {
            *to = from.0[lane];
        }
    }
}

/// Writes whole covariances of some tracks at one step.
#[inline(always)]
fn scatter_symmetric<S: Simd, const N: usize, const PN: usize>(
    out: &mut [f64],
    registers: &[S::f64s; PN],
    first: usize,
    used: usize,
    steps: usize,
    t: usize,
) {
    let mut lanes = [Lane([0.0; LANES]); PN];
    for (to, from) in lanes.iter_mut().zip(registers) {
        S::as_mut_simd_f64s(&mut to.0).0[0] = *from;
    }
    for lane in 0..used {
        let row = ((first + lane) * steps + t) * N * N;
        let matrix = &mut out[row..row + N * N];
        for i in 0..N {
            for j in 0..N {
                matrix[i * N + j] = lanes[at(i, j)].0[lane];
            }
        }
    }
}

/// Equations 1 and 2.
#[inline(always)]
fn predict<S: Simd, const D: usize, const K: usize, const N: usize, const PN: usize>(
    simd: S,
    x: &mut [S::f64s; N],
    p: &mut [S::f64s; PN],
    step: &Step<D>,
) {
    let dt = simd.splat_f64s(step.dt);
    let half = simd.splat_f64s(0.5 * step.dt * step.dt);
    // a + dt b, and a + dt b + h c
    let first = |a, b| simd.add_f64s(a, simd.mul_f64s(dt, b));
    let second = |a, b, c| simd.add_f64s(first(a, b), simd.mul_f64s(half, c));
    let (v, a) = (D, 2 * D);
    if K == 2 {
        for i in 0..D {
            x[i] = first(x[i], x[v + i]);
        }
        let mut g = [[simd.splat_f64s(0.0); D]; D];
        for i in 0..D {
            for j in 0..=i {
                g[i][j] = first(p[at(i, j)], p[at(v + j, i)]);
            }
        }
        for i in 0..D {
            for j in 0..D {
                p[at(v + i, j)] = first(p[at(v + i, j)], p[at(v + i, v + j)]);
            }
        }
        for i in 0..D {
            for j in 0..=i {
                p[at(i, j)] = first(g[i][j], p[at(v + i, j)]);
            }
        }
    }
    if K == 3 {
        for i in 0..D {
            x[i] = second(x[i], x[v + i], x[a + i]);
            x[v + i] = first(x[v + i], x[a + i]);
        }
        let mut g = [[simd.splat_f64s(0.0); D]; D];
        for i in 0..D {
            for j in 0..=i {
                g[i][j] = second(p[at(i, j)], p[at(v + j, i)], p[at(a + j, i)]);
            }
        }
        for i in 0..D {
            for j in 0..D {
                let vp = second(p[at(v + i, j)], p[at(v + i, v + j)], p[at(a + j, v + i)]);
                let ap = second(p[at(a + i, j)], p[at(a + i, v + j)], p[at(a + i, a + j)]);
                if j <= i {
                    p[at(i, j)] = second(g[i][j], vp, ap);
                }
                p[at(v + i, j)] = first(vp, ap);
                p[at(a + i, j)] = ap;
            }
        }
        for i in 0..D {
            for j in 0..=i {
                g[i][j] = first(p[at(v + i, v + j)], p[at(a + j, v + i)]);
            }
        }
        for i in 0..D {
            for j in 0..D {
                p[at(a + i, v + j)] = first(p[at(a + i, v + j)], p[at(a + i, a + j)]);
            }
        }
        for i in 0..D {
            for j in 0..=i {
                p[at(v + i, v + j)] = first(g[i][j], p[at(a + i, v + j)]);
            }
        }
    }
    for axis in 0..D {
        let mut pair = 0;
        for row in 0..K {
            for column in 0..=row {
                let entry = at(row * D + axis, column * D + axis);
                p[entry] = simd.add_f64s(p[entry], simd.splat_f64s(step.noise[pair][axis]));
                pair += 1;
            }
        }
    }
}

/// What an update tells besides.
struct Found<S: Simd> {
    nis: S::f64s,
    /// 1 where a pivot was not positive.
    failed: S::f64s,
}

/// Equations 3 to 6.
#[inline(always)]
fn update<S: Simd, const D: usize, const N: usize, const PN: usize>(
    simd: S,
    x: &mut [S::f64s; N],
    p: &mut [S::f64s; PN],
    z: &[S::f64s; D],
    sensor: &[f64; D],
) -> Found<S> {
    let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
    let always = simd.equal_f64s(zero, zero);
    // a − b c
    let less = |a, b, c| simd.sub_f64s(a, simd.mul_f64s(b, c));
    let seen: [S::m64s; D] = std::array::from_fn(|k| simd.equal_f64s(z[k], z[k]));
    let nu: [S::f64s; D] = std::array::from_fn(|k| simd.select_f64s(seen[k], simd.sub_f64s(z[k], x[k]), zero));
    let mut cross = [[zero; D]; N];
    for (i, row) in cross.iter_mut().enumerate() {
        for (k, entry) in row.iter_mut().enumerate() {
            *entry = simd.select_f64s(seen[k], p[at(i, k)], zero);
        }
    }
    let (mut l, mut pivot, mut reciprocal) = ([[zero; D]; D], [one; D], [one; D]);
    let mut good = always;
    for j in 0..D {
        let s = simd.add_f64s(p[at(j, j)], simd.splat_f64s(sensor[j]));
        let mut rest = simd.select_f64s(seen[j], s, one);
        for k in 0..j {
            rest = less(rest, simd.mul_f64s(l[j][k], l[j][k]), pivot[k]);
        }
        good = simd.and_m64s(good, simd.less_than_f64s(zero, rest));
        pivot[j] = rest;
        reciprocal[j] = simd.div_f64s(one, rest);
        for i in j + 1..D {
            let mut rest = simd.select_f64s(seen[i], cross[i][j], zero);
            for k in 0..j {
                rest = less(rest, simd.mul_f64s(l[i][k], l[j][k]), pivot[k]);
            }
            l[i][j] = simd.mul_f64s(rest, reciprocal[j]);
        }
    }
    // S⁻¹ on a row.
    let solve = |mut y: [S::f64s; D]| {
        for i in 0..D {
            for k in 0..i {
                y[i] = less(y[i], l[i][k], y[k]);
            }
        }
        for i in 0..D {
            y[i] = simd.mul_f64s(y[i], reciprocal[i]);
        }
        for i in (0..D).rev() {
            for k in i + 1..D {
                y[i] = less(y[i], l[k][i], y[k]);
            }
        }
        y
    };
    let mut gain = [[zero; D]; N];
    for (to, row) in gain.iter_mut().zip(&cross) {
        let solved = solve(*row);
        for (to, from) in to.iter_mut().zip(solved) {
            *to = simd.select_f64s(good, from, zero);
        }
    }
    for (state, row) in x.iter_mut().zip(&gain) {
        for (weight, nu) in row.iter().zip(&nu) {
            *state = simd.add_f64s(*state, simd.mul_f64s(*weight, *nu));
        }
    }
    joseph::<S, D, N, PN>(simd, p, &gain, sensor);
    let solved = solve(nu);
    let (mut nis, mut any) = (zero, simd.less_than_f64s(one, zero));
    for k in 0..D {
        nis = simd.add_f64s(nis, simd.mul_f64s(nu[k], solved[k]));
        any = simd.or_m64s(any, seen[k]);
    }
    any = simd.and_m64s(any, good);
    Found {
        nis: simd.select_f64s(any, nis, simd.splat_f64s(f64::NAN)),
        failed: simd.select_f64s(good, zero, one),
    }
}

/// Equation 6.
#[inline(always)]
fn joseph<S: Simd, const D: usize, const N: usize, const PN: usize>(
    simd: S,
    p: &mut [S::f64s; PN],
    gain: &[[S::f64s; D]; N],
    sensor: &[f64; D],
) {
    let less = |a, b, c| simd.sub_f64s(a, simd.mul_f64s(b, c));
    let left = |p: &[S::f64s; PN], i: usize, j: usize| {
        let mut entry = p[at(i, j)];
        for k in 0..D {
            entry = less(entry, gain[i][k], p[at(k, j)]);
        }
        entry
    };
    let mut measured = [[simd.splat_f64s(0.0); D]; N];
    for (i, row) in measured.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            *entry = left(p, i, j);
        }
    }
    // From the last row upwards: the first rows are needed to the end.
    for i in (0..N).rev() {
        let noise: [S::f64s; D] = std::array::from_fn(|k| simd.mul_f64s(gain[i][k], simd.splat_f64s(sensor[k])));
        for j in (0..=i).rev() {
            let mut entry = if j < D { measured[i][j] } else { left(p, i, j) };
            for k in 0..D {
                entry = less(entry, measured[i][k], gain[j][k]);
            }
            for k in 0..D {
                entry = simd.add_f64s(entry, simd.mul_f64s(noise[k], gain[j][k]));
            }
            p[at(i, j)] = entry;
        }
    }
}
