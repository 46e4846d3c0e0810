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
//! 7. a track whose P is nearly singular is marked (`condition`) and stays where it was before the first step
//!
//! The order of the operations is that of the loops at every level, so that the bits are the same. A lane is masked, not
//! branched on.
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §5.2 and §7.3 (Joseph form).

use pulp::Simd;

use super::block::at;
use super::transport::{Spot, gather};
use super::work::Measured;

/// More than what the roundings of a determinant can do to it, as a part of the product of its variances.
const ROUNDING: f64 = 1e-12;

/// A time step and the noise that gathers in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<const D: usize> {
    /// Seconds.
    pub dt: f64,
    /// Per pair of blocks, in the order pp, vp, vv, ap, av, aa, one number per axis.
    pub noise: [[f64; D]; 6],
    /// What the determinant of the noise is at least.
    pub det: f64,
}

impl<const D: usize> Step<D> {
    /// A step of a motion with K blocks.
    pub(crate) fn new<const K: usize>(dt: f64, noise: [[f64; D]; 6]) -> Self {
        let of_axis = |axis: usize| {
            let [pp, vp, vv, ap, av, aa] = noise.map(|entry| entry[axis]);
            let (all, left) = match K {
                1 => (pp, pp),
                2 => (pp * vv, pp * vv - vp * vp),
                _ => {
                    let minors = [vv * aa - av * av, vp * aa - av * ap, vp * av - vv * ap];
                    (pp * vv * aa, pp * minors[0] - vp * minors[1] + ap * minors[2])
                }
            };
            // What rounding can have left over is nothing.
            (left - ROUNDING * all).max(0.0)
        };
        Self {
            dt,
            noise,
            det: (0..D).map(of_axis).product(),
        }
    }
}

// Indices are found without the checks of the profile: with them the loops over three axes are not unrolled, and a step
// takes ten times as long. None of them can overflow.

/// Where component `axis` of block `block` stands.
#[inline(always)]
const fn row<const D: usize>(block: usize, axis: usize) -> usize {
    block.wrapping_mul(D).wrapping_add(axis)
}

/// Where the entry (i, j) of block (a, b) of the covariance stands.
#[inline(always)]
const fn cov<const D: usize>(a: usize, i: usize, b: usize, j: usize) -> usize {
    at(row::<D>(a, i), row::<D>(b, j))
}

/// The next index.
#[inline(always)]
pub(super) const fn after(index: usize) -> usize {
    index.wrapping_add(1)
}

/// a + b c.
#[inline(always)]
pub(super) fn more<S: Simd>(simd: S, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
    simd.add_f64s(a, simd.mul_f64s(b, c))
}

/// a − b c.
#[inline(always)]
pub(super) fn less<S: Simd>(simd: S, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
    simd.sub_f64s(a, simd.mul_f64s(b, c))
}

/// Equations 1 and 2.
#[inline(always)]
pub(super) fn predict<S: Simd, const D: usize, const K: usize, const N: usize, const PN: usize>(
    simd: S,
    x: &mut [S::f64s; N],
    p: &mut [S::f64s; PN],
    step: &Step<D>,
) {
    let dt = simd.splat_f64s(step.dt);
    let half = simd.splat_f64s(0.5 * step.dt * step.dt);
    // a + dt b, and a + dt b + h c
    macro_rules! first {
        ($a:expr, $b:expr) => {
            more(simd, $a, dt, $b)
        };
    }
    macro_rules! second {
        ($a:expr, $b:expr, $c:expr) => {
            more(simd, first!($a, $b), half, $c)
        };
    }
    if K == 2 {
        for i in 0..D {
            x[i] = first!(x[i], x[row::<D>(1, i)]);
        }
        let mut g = [[simd.splat_f64s(0.0); D]; D];
        for i in 0..D {
            for j in 0..=i {
                g[i][j] = first!(p[cov::<D>(0, i, 0, j)], p[cov::<D>(1, j, 0, i)]);
            }
        }
        for i in 0..D {
            for j in 0..D {
                p[cov::<D>(1, i, 0, j)] = first!(p[cov::<D>(1, i, 0, j)], p[cov::<D>(1, i, 1, j)]);
            }
        }
        for i in 0..D {
            for j in 0..=i {
                p[cov::<D>(0, i, 0, j)] = first!(g[i][j], p[cov::<D>(1, i, 0, j)]);
            }
        }
    }
    if K == 3 {
        for i in 0..D {
            x[i] = second!(x[i], x[row::<D>(1, i)], x[row::<D>(2, i)]);
            x[row::<D>(1, i)] = first!(x[row::<D>(1, i)], x[row::<D>(2, i)]);
        }
        let mut g = [[simd.splat_f64s(0.0); D]; D];
        for i in 0..D {
            for j in 0..=i {
                g[i][j] = second!(
                    p[cov::<D>(0, i, 0, j)],
                    p[cov::<D>(1, j, 0, i)],
                    p[cov::<D>(2, j, 0, i)]
                );
            }
        }
        for i in 0..D {
            for j in 0..D {
                let vp = second!(
                    p[cov::<D>(1, i, 0, j)],
                    p[cov::<D>(1, i, 1, j)],
                    p[cov::<D>(2, j, 1, i)]
                );
                let ap = second!(
                    p[cov::<D>(2, i, 0, j)],
                    p[cov::<D>(2, i, 1, j)],
                    p[cov::<D>(2, i, 2, j)]
                );
                if j <= i {
                    p[cov::<D>(0, i, 0, j)] = second!(g[i][j], vp, ap);
                }
                p[cov::<D>(1, i, 0, j)] = first!(vp, ap);
                p[cov::<D>(2, i, 0, j)] = ap;
            }
        }
        for i in 0..D {
            for j in 0..=i {
                g[i][j] = first!(p[cov::<D>(1, i, 1, j)], p[cov::<D>(2, j, 1, i)]);
            }
        }
        for i in 0..D {
            for j in 0..D {
                p[cov::<D>(2, i, 1, j)] = first!(p[cov::<D>(2, i, 1, j)], p[cov::<D>(2, i, 2, j)]);
            }
        }
        for i in 0..D {
            for j in 0..=i {
                p[cov::<D>(1, i, 1, j)] = first!(g[i][j], p[cov::<D>(2, i, 1, j)]);
            }
        }
    }
    for axis in 0..D {
        for a in 0..K {
            for b in 0..=a {
                let (entry, noise) = (cov::<D>(a, axis, b, axis), step.noise[at(a, b)][axis]);
                p[entry] = simd.add_f64s(p[entry], simd.splat_f64s(noise));
            }
        }
    }
}

/// What an update tells besides.
pub(super) struct Found<S: Simd> {
    pub(super) nis: S::f64s,
    /// 1 where a pivot was not positive.
    pub(super) failed: S::f64s,
    /// |R|/|S|.
    pub(super) shrunk: S::f64s,
}

/// A sensor of positions: R of its axes.
pub(super) struct Positions<const D: usize>(pub(super) [f64; D]);

impl<const D: usize, const N: usize, const PN: usize> Measured<N, PN> for Positions<D> {
    fn components(&self) -> usize {
        D
    }

    #[inline(always)]
    fn update<S: Simd>(
        &self,
        simd: S,
        x: &mut [S::f64s; N],
        p: &mut [S::f64s; PN],
        values: &[f64],
        spot: Spot,
    ) -> Found<S> {
        let z = gather::<S, D>(simd, values, D, spot);
        update::<S, D, N, PN>(simd, x, p, &z, &self.0)
    }
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
    let (always, never) = (simd.equal_f64s(zero, zero), simd.less_than_f64s(one, zero));
    let (mut seen, mut nu, mut any) = ([never; D], [zero; D], never);
    for k in 0..D {
        seen[k] = simd.equal_f64s(z[k], z[k]);
        nu[k] = simd.select_f64s(seen[k], simd.sub_f64s(z[k], x[k]), zero);
        any = simd.or_m64s(any, seen[k]);
    }
    let mut cross = [[zero; D]; N];
    for i in 0..N {
        for k in 0..D {
            cross[i][k] = simd.select_f64s(seen[k], p[at(i, k)], zero);
        }
    }
    let mut factor = Factor::<S, D> {
        l: [[zero; D]; D],
        reciprocal: [one; D],
    };
    let (mut pivot, mut good) = ([one; D], always);
    for j in 0..D {
        let s = simd.add_f64s(p[at(j, j)], simd.splat_f64s(sensor[j]));
        let mut rest = simd.select_f64s(seen[j], s, one);
        for k in 0..j {
            rest = less(simd, rest, simd.mul_f64s(factor.l[j][k], factor.l[j][k]), pivot[k]);
        }
        good = simd.and_m64s(good, simd.less_than_f64s(zero, rest));
        pivot[j] = rest;
        factor.reciprocal[j] = simd.div_f64s(one, rest);
        for i in after(j)..D {
            let mut rest = simd.select_f64s(seen[i], cross[i][j], zero);
            for k in 0..j {
                rest = less(simd, rest, simd.mul_f64s(factor.l[i][k], factor.l[j][k]), pivot[k]);
            }
            factor.l[i][j] = simd.mul_f64s(rest, factor.reciprocal[j]);
        }
    }
    let mut gain = cross;
    for i in 0..N {
        factor.solve(simd, &mut gain[i]);
        for k in 0..D {
            gain[i][k] = simd.select_f64s(good, gain[i][k], zero);
            x[i] = more(simd, x[i], gain[i][k], nu[k]);
        }
    }
    joseph::<S, D, N, PN>(simd, p, &gain, sensor);
    let mut solved = nu;
    factor.solve(simd, &mut solved);
    let mut nis = zero;
    for k in 0..D {
        nis = more(simd, nis, nu[k], solved[k]);
    }
    let mut shrunk = one;
    for k in 0..D {
        let part = simd.mul_f64s(simd.splat_f64s(sensor[k]), factor.reciprocal[k]);
        shrunk = simd.mul_f64s(shrunk, simd.select_f64s(seen[k], part, one));
    }
    let scored = simd.and_m64s(any, good);
    Found {
        nis: simd.select_f64s(scored, nis, simd.splat_f64s(f64::NAN)),
        failed: simd.select_f64s(good, zero, one),
        shrunk: simd.select_f64s(good, shrunk, one),
    }
}

/// L, and the reciprocals of Δ.
struct Factor<S: Simd, const D: usize> {
    l: [[S::f64s; D]; D],
    reciprocal: [S::f64s; D],
}

impl<S: Simd, const D: usize> Factor<S, D> {
    /// S⁻¹ y.
    #[inline(always)]
    fn solve(&self, simd: S, y: &mut [S::f64s; D]) {
        for i in 0..D {
            for k in 0..i {
                y[i] = less(simd, y[i], self.l[i][k], y[k]);
            }
        }
        for i in 0..D {
            y[i] = simd.mul_f64s(y[i], self.reciprocal[i]);
        }
        for i in (0..D).rev() {
            for k in after(i)..D {
                y[i] = less(simd, y[i], self.l[k][i], y[k]);
            }
        }
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
    let zero = simd.splat_f64s(0.0);
    let mut measured = [[zero; D]; N];
    for i in 0..N {
        for j in 0..D {
            measured[i][j] = left(simd, p, gain, i, j);
        }
    }
    // From the last row upwards: the first rows are needed to the end.
    for i in (0..N).rev() {
        let mut noise = [zero; D];
        for k in 0..D {
            noise[k] = simd.mul_f64s(gain[i][k], simd.splat_f64s(sensor[k]));
        }
        for j in (0..after(i)).rev() {
            let mut entry = if j < D {
                measured[i][j]
            } else {
                left(simd, p, gain, i, j)
            };
            for k in 0..D {
                entry = less(simd, entry, measured[i][k], gain[j][k]);
            }
            for k in 0..D {
                entry = more(simd, entry, noise[k], gain[j][k]);
            }
            p[at(i, j)] = entry;
        }
    }
}

/// Entry (i, j) of (I − G H) P.
#[inline(always)]
fn left<S: Simd, const D: usize, const N: usize, const PN: usize>(
    simd: S,
    p: &[S::f64s; PN],
    gain: &[[S::f64s; D]; N],
    i: usize,
    j: usize,
) -> S::f64s {
    let mut entry = p[at(i, j)];
    for k in 0..D {
        entry = less(simd, entry, gain[i][k], p[at(k, j)]);
    }
    entry
}
