//! Kalman update by a linear sensor, z = H x + d + v, several tracks to a register, one component after the other.
//!
//! | symbol | name here            | shape | meaning                                                          |
//! |--------|----------------------|-------|------------------------------------------------------------------|
//! | m      | `components`         |       | components of a measurement, [`MOST`] at most                    |
//! | H, d   | `rows`, `offset`     | m×N, m | the sensor                                                      |
//! | R      | `noise` = L Δ Lᵀ     | m×m   | L unit lower (`l`), Δ diagonal (`own`, 1/Δ `reciprocal`)         |
//! | h, y   | `h`, `y`             | N, 1  | row of L⁻¹ H, component of L⁻¹ (z − d): their noise is Δ         |
//! | c, s   | `cross`, `s`         | N, 1  | c = P hᵀ, s = h c + Δ                                            |
//! | g      | `gain`               | N     | g = c/s                                                          |
//!
//! Equations, in the order of the code, for one component after the other:
//!
//! 1. the row of L and Δ; where a component is not observed its row and column of R are those of the unit matrix
//! 2. h = H_k − Σ L_kj h_j, y = z_k − d_k − Σ L_kj y_j over the components before
//! 3. c = P hᵀ, s = h c + Δ; a track with an s that is not positive keeps its prediction
//! 4. ν = y − h x, x += g ν; νᵀ S⁻¹ ν = Σ ν²/s, |R|/|S| = Π Δ/s; where a component is not observed g and ν are 0
//! 5. P = (I − g h) P (I − g h)ᵀ + g Δ gᵀ (Joseph), lower triangle: with m = c − g (h c), P − g cᵀ − m gᵀ + g Δ gᵀ
//!
//! A component costs the same whatever their number, so that one kernel per motion serves all of them.
//!
//! Reference: Bierman (1977), Factorization Methods for Discrete Sequential Estimation, §II.5 (whitening), §V.2 (one scalar
//! after the other).

use pulp::Simd;

use super::block::at;
use super::kinematic::{Found, after, less, more};
use super::transport::{Spot, gather};
use super::work::Measured;

/// Components at most.
pub(crate) const MOST: usize = 3;

/// A linear sensor of motions with N states.
pub(super) struct Linear<const N: usize> {
    components: usize,
    rows: [[f64; N]; MOST],
    offset: [f64; MOST],
    noise: [[f64; MOST]; MOST],
}

impl<const N: usize> Linear<N> {
    /// Matrices row by row; of more components than [`MOST`] the first ones.
    pub(super) fn new(rows: &[f64], offset: &[f64], noise: &[f64]) -> Self {
        let mut sensor = Self {
            components: offset.len().min(MOST),
            rows: [[0.0; N]; MOST],
            offset: [0.0; MOST],
            noise: [[0.0; MOST]; MOST],
        };
        for k in 0..sensor.components {
            sensor.rows[k].copy_from_slice(&rows[k * N..(k + 1) * N]);
            sensor.offset[k] = offset[k];
            for j in 0..=k {
                sensor.noise[k][j] = noise[k * offset.len() + j];
            }
        }
        sensor
    }
}

impl<const N: usize, const PN: usize> Measured<N, PN> for Linear<N> {
    fn components(&self) -> usize {
        self.components
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
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let (always, never) = (simd.equal_f64s(zero, zero), simd.less_than_f64s(one, zero));
        let z = gather::<S, MOST>(simd, values, self.components, spot);
        let before = (*x, *p);
        let (mut seen, mut y, mut h) = ([never; MOST], [zero; MOST], [[zero; N]; MOST]);
        let (mut l, mut own, mut reciprocal) = ([[zero; MOST]; MOST], [one; MOST], [one; MOST]);
        let (mut good, mut any, mut nis, mut shrunk) = (always, never, zero, one);
        for k in 0..self.components.min(MOST) {
            // Equation 1.
            seen[k] = simd.equal_f64s(z[k], z[k]);
            any = simd.or_m64s(any, seen[k]);
            own[k] = simd.select_f64s(seen[k], simd.splat_f64s(self.noise[k][k]), one);
            for j in 0..k {
                let both = simd.and_m64s(seen[k], seen[j]);
                let mut rest = simd.select_f64s(both, simd.splat_f64s(self.noise[k][j]), zero);
                for i in 0..j {
                    rest = less(simd, rest, simd.mul_f64s(l[k][i], l[j][i]), own[i]);
                }
                l[k][j] = simd.mul_f64s(rest, reciprocal[j]);
                own[k] = less(simd, own[k], simd.mul_f64s(l[k][j], l[k][j]), own[j]);
            }
            reciprocal[k] = simd.div_f64s(one, own[k]);
            // Equation 2.
            y[k] = simd.select_f64s(seen[k], simd.sub_f64s(z[k], simd.splat_f64s(self.offset[k])), zero);
            for i in 0..N {
                h[k][i] = simd.splat_f64s(self.rows[k][i]);
            }
            for j in 0..k {
                y[k] = less(simd, y[k], l[k][j], y[j]);
                for i in 0..N {
                    h[k][i] = less(simd, h[k][i], l[k][j], h[j][i]);
                }
            }
            // Equation 3.
            let cross = product::<S, N, PN>(simd, p, &h[k]);
            let spread = dot(simd, &h[k], &cross);
            let s = simd.select_f64s(seen[k], simd.add_f64s(spread, own[k]), one);
            good = simd.and_m64s(good, simd.less_than_f64s(zero, s));
            // Equation 4.
            let inverse = simd.div_f64s(one, s);
            let taken = simd.and_m64s(good, seen[k]);
            let nu = simd.select_f64s(seen[k], simd.sub_f64s(y[k], dot(simd, &h[k], x)), zero);
            nis = more(simd, nis, simd.mul_f64s(nu, nu), inverse);
            shrunk = simd.mul_f64s(shrunk, simd.select_f64s(taken, simd.mul_f64s(own[k], inverse), one));
            let mut gain = [zero; N];
            for i in 0..N {
                gain[i] = simd.select_f64s(taken, simd.mul_f64s(cross[i], inverse), zero);
                x[i] = more(simd, x[i], gain[i], nu);
            }
            joseph::<S, N, PN>(simd, p, &gain, &cross, spread, own[k]);
        }
        let failed = simd.select_f64s(good, zero, one);
        if simd.reduce_max_f64s(failed) > 0.0 {
            for i in 0..N {
                x[i] = simd.select_f64s(good, x[i], before.0[i]);
            }
            for i in 0..PN {
                p[i] = simd.select_f64s(good, p[i], before.1[i]);
            }
        }
        let scored = simd.and_m64s(any, good);
        Found {
            nis: simd.select_f64s(scored, nis, simd.splat_f64s(f64::NAN)),
            failed,
            shrunk: simd.select_f64s(good, shrunk, one),
        }
    }
}

/// Σ a_i b_i.
#[inline(always)]
fn dot<S: Simd, const N: usize>(simd: S, a: &[S::f64s; N], b: &[S::f64s; N]) -> S::f64s {
    let mut sum = simd.mul_f64s(a[0], b[0]);
    for i in 1..N {
        sum = more(simd, sum, a[i], b[i]);
    }
    sum
}

/// P h.
#[inline(always)]
fn product<S: Simd, const N: usize, const PN: usize>(simd: S, p: &[S::f64s; PN], h: &[S::f64s; N]) -> [S::f64s; N] {
    let mut product = [simd.splat_f64s(0.0); N];
    for i in 0..N {
        product[i] = simd.mul_f64s(p[at(i, 0)], h[0]);
        for j in 1..N {
            product[i] = more(simd, product[i], p[at(i, j)], h[j]);
        }
    }
    product
}

/// Equation 5.
#[inline(always)]
fn joseph<S: Simd, const N: usize, const PN: usize>(
    simd: S,
    p: &mut [S::f64s; PN],
    gain: &[S::f64s; N],
    cross: &[S::f64s; N],
    spread: S::f64s,
    own: S::f64s,
) {
    for i in 0..N {
        let left = less(simd, cross[i], gain[i], spread);
        let noise = simd.mul_f64s(gain[i], own);
        for j in 0..after(i) {
            let entry = less(simd, p[at(i, j)], gain[i], cross[j]);
            let entry = less(simd, entry, left, gain[j]);
            p[at(i, j)] = more(simd, entry, noise, gain[j]);
        }
    }
}
