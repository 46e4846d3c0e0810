//! From arrays of tracks to registers and back.

use pulp::Simd;

use super::block::{LANES, Lane, at};

// Indices without the checks of the profile, as in the kernels.

/// Some tracks at one step, in arrays that have tracks first, then steps.
#[derive(Clone, Copy)]
pub(super) struct Spot {
    /// The first of the tracks.
    pub(super) first: usize,
    /// How many lanes are used.
    pub(super) used: usize,
    /// Steps of a track.
    pub(super) steps: usize,
    /// The step.
    pub(super) t: usize,
}

impl Spot {
    /// Where the numbers of a lane begin, so many each.
    #[inline(always)]
    const fn place(self, lane: usize, width: usize) -> usize {
        let track = self.first.wrapping_add(lane);
        track.wrapping_mul(self.steps).wrapping_add(self.t).wrapping_mul(width)
    }
}

/// Numbers of a square matrix.
const fn matrix_len<const N: usize>() -> usize {
    N.wrapping_mul(N)
}

/// Registers from lanes.
#[inline(always)]
pub(super) fn load<S: Simd, const N: usize>(simd: S, lanes: &[Lane; N], register: usize) -> [S::f64s; N] {
    let mut out = [simd.splat_f64s(0.0); N];
    for (to, from) in out.iter_mut().zip(lanes) {
        *to = S::as_simd_f64s(&from.0).0[register];
    }
    out
}

/// Registers into lanes.
#[inline(always)]
pub(super) fn store<S: Simd, const N: usize>(lanes: &mut [Lane; N], registers: &[S::f64s; N], register: usize) {
    for (to, from) in lanes.iter_mut().zip(registers) {
        S::as_mut_simd_f64s(&mut to.0).0[register] = *from;
    }
}

/// Measurements of `width` components, D at most; lanes that are not used are not observed, and neither are components beyond.
#[inline(always)]
pub(super) fn gather<S: Simd, const D: usize>(simd: S, values: &[f64], width: usize, spot: Spot) -> [S::f64s; D] {
    let mut lanes = [Lane([f64::NAN; LANES]); D];
    // Where all lanes are used their number is known to the compiler.
    let used = if spot.used == S::F64_LANES {
        S::F64_LANES
    } else {
        spot.used
    };
    for lane in 0..used {
        let begin = spot.place(lane, width);
        for (to, from) in lanes.iter_mut().zip(&values[begin..begin.wrapping_add(width)]) {
            to.0[lane] = *from;
        }
    }
    load::<S, D>(simd, &lanes, 0)
}

/// Writes vectors.
#[inline(always)]
pub(super) fn scatter<S: Simd, const N: usize>(out: &mut [f64], registers: &[S::f64s; N], spot: Spot) {
    let mut lanes = [Lane([0.0; LANES]); N];
    for (to, from) in lanes.iter_mut().zip(registers) {
        S::as_mut_simd_f64s(&mut to.0).0[0] = *from;
    }
    for lane in 0..spot.used {
        let begin = spot.place(lane, N);
        for (to, from) in out[begin..begin.wrapping_add(N)].iter_mut().zip(&lanes) {
            *to = from.0[lane];
        }
    }
}

/// Writes whole covariances.
#[inline(always)]
pub(super) fn scatter_symmetric<S: Simd, const N: usize, const PN: usize>(
    out: &mut [f64],
    registers: &[S::f64s; PN],
    spot: Spot,
) {
    let mut lanes = [Lane([0.0; LANES]); PN];
    for (to, from) in lanes.iter_mut().zip(registers) {
        S::as_mut_simd_f64s(&mut to.0).0[0] = *from;
    }
    for lane in 0..spot.used {
        let begin = spot.place(lane, matrix_len::<N>());
        let matrix = &mut out[begin..begin.wrapping_add(matrix_len::<N>())];
        for i in 0..N {
            for j in 0..N {
                matrix[i.wrapping_mul(N).wrapping_add(j)] = lanes[at(i, j)].0[lane];
            }
        }
    }
}
