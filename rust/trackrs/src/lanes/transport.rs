//! From arrays of tracks to registers and back.

use pulp::Simd;

use super::block::{LANES, Lane, at};

// Indices without the checks of the profile, as in the kernels.

/// Where the numbers of a track and step begin, so many each.
#[inline(always)]
const fn place(first: usize, lane: usize, steps: usize, t: usize, width: usize) -> usize {
    let track = first.wrapping_add(lane);
    track.wrapping_mul(steps).wrapping_add(t).wrapping_mul(width)
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

/// The measurements of some tracks at one step; lanes beyond them are not observed.
#[inline(always)]
pub(super) fn gather<S: Simd, const D: usize>(
    simd: S,
    values: &[f64],
    first: usize,
    used: usize,
    steps: usize,
    t: usize,
) -> [S::f64s; D] {
    let mut lanes = [Lane([f64::NAN; LANES]); D];
    // Where all lanes are used their number is known to the compiler.
    let used = if used == S::F64_LANES { S::F64_LANES } else { used };
    for lane in 0..used {
        let begin = place(first, lane, steps, t, D);
        for (to, from) in lanes.iter_mut().zip(&values[begin..begin.wrapping_add(D)]) {
            to.0[lane] = *from;
        }
    }
    load::<S, D>(simd, &lanes, 0)
}

/// Writes vectors of some tracks at one step.
#[inline(always)]
pub(super) fn scatter<S: Simd, const N: usize>(
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
        let begin = place(first, lane, steps, t, N);
        for (to, from) in out[begin..begin.wrapping_add(N)].iter_mut().zip(&lanes) {
            *to = from.0[lane];
        }
    }
}

/// Writes whole covariances of some tracks at one step.
#[inline(always)]
pub(super) fn scatter_symmetric<S: Simd, const N: usize, const PN: usize>(
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
        let begin = place(first, lane, steps, t, matrix_len::<N>());
        let matrix = &mut out[begin..begin.wrapping_add(matrix_len::<N>())];
        for i in 0..N {
            for j in 0..N {
                matrix[i.wrapping_mul(N).wrapping_add(j)] = lanes[at(i, j)].0[lane];
            }
        }
    }
}
