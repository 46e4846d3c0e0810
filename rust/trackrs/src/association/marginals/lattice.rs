//! The inner loops of [`subsets`](super::subsets): passes over all subsets A of a set, numbers indexed by bit mask.
//!
//! For one bit the subsets without and with it lie in blocks of 2^bit, one after the other. Blocks of 8 and more are
//! plain vectors; the three lowest bits move numbers inside blocks of 8, in a fixed pattern that the compiler unrolls.

use super::frontier::Take;
use crate::interrupt::ahead;

/// Y[A] = s X[A] + Σ_{k∈A} w_k X[A∖k].
pub(super) fn put(after: &mut [f64], before: &[f64], skip: f64, takes: &[Take]) {
    for (y, x) in after.iter_mut().zip(before) {
        *y = skip * x;
    }
    for take in takes {
        if after.len() < 8 {
            let bit = 1 << take.bit;
            for set in 0..after.len().min(before.len()) {
                if set & bit == 0 {
                    after[set | bit] += take.weight * before[set];
                }
            }
            continue;
        }
        ahead(after.len());
        match take.bit {
            0 => put_low::<1>(after, before, take.weight),
            1 => put_low::<2>(after, before, take.weight),
            2 => put_low::<4>(after, before, take.weight),
            bit => {
                let blocks = after.chunks_exact_mut(2 << bit).zip(before.chunks_exact(2 << bit));
                for (after, before) in blocks {
                    for (y, x) in after[1 << bit..].iter_mut().zip(&before[..1 << bit]) {
                        *y += take.weight * x;
                    }
                }
            }
        }
    }
}

fn put_low<const BIT: usize>(after: &mut [f64], before: &[f64], weight: f64) {
    let (after, _) = after.as_chunks_mut::<8>();
    let (before, _) = before.as_chunks::<8>();
    for (y, x) in after.iter_mut().zip(before) {
        for set in 0..8 {
            if set & BIT == 0 {
                y[set | BIT] += weight * x[set];
            }
        }
    }
}

/// `earlier[A]` += w G[A∪k] for k ∉ A, and returns Σ_{A∌k} X[A] G[A∪k].
pub(super) fn put_back(earlier: &mut [f64], before: &[f64], to_come: &[f64], bit: usize, weight: f64) -> f64 {
    let mut sum = 0.0;
    if earlier.len() < 8 {
        let bit = 1 << bit;
        for set in 0..earlier.len().min(before.len()).min(to_come.len()) {
            if set & bit == 0 {
                earlier[set] += weight * to_come[set | bit];
                sum += before[set] * to_come[set | bit];
            }
        }
        return sum;
    }
    ahead(earlier.len());
    match bit {
        0 => put_back_low::<1>(earlier, before, to_come, weight),
        1 => put_back_low::<2>(earlier, before, to_come, weight),
        2 => put_back_low::<4>(earlier, before, to_come, weight),
        bit => {
            let blocks = earlier.chunks_exact_mut(2 << bit).zip(before.chunks_exact(2 << bit));
            for ((earlier, before), to_come) in blocks.zip(to_come.chunks_exact(2 << bit)) {
                let (earlier, _) = earlier[..1 << bit].as_chunks_mut::<8>();
                let (before, _) = before[..1 << bit].as_chunks::<8>();
                let (to_come, _) = to_come[1 << bit..].as_chunks::<8>();
                let mut lanes = [0.0; 8];
                for ((e, x), g) in earlier.iter_mut().zip(before).zip(to_come) {
                    for lane in 0..8 {
                        e[lane] += weight * g[lane];
                        lanes[lane] += x[lane] * g[lane];
                    }
                }
                sum += add(lanes);
            }
            sum
        }
    }
}

fn put_back_low<const BIT: usize>(earlier: &mut [f64], before: &[f64], to_come: &[f64], weight: f64) -> f64 {
    let (earlier, _) = earlier.as_chunks_mut::<8>();
    let (before, _) = before.as_chunks::<8>();
    let (to_come, _) = to_come.as_chunks::<8>();
    let mut lanes = [0.0; 8];
    for ((e, x), g) in earlier.iter_mut().zip(before).zip(to_come) {
        for set in 0..8 {
            if set & BIT == 0 {
                e[set] += weight * g[set | BIT];
                lanes[set] += x[set] * g[set | BIT];
            }
        }
    }
    add(lanes)
}

fn add(lanes: [f64; 8]) -> f64 {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}

/// Σ_A x[A] y[A].
pub(super) fn dot(x: &[f64], y: &[f64]) -> f64 {
    let (x, x_last) = x.as_chunks::<8>();
    let (y, y_last) = y.as_chunks::<8>();
    let mut lanes = [0.0; 8];
    for (x, y) in x.iter().zip(y) {
        for lane in 0..8 {
            lanes[lane] += x[lane] * y[lane];
        }
    }
    let mut sum = add(lanes);
    for (x, y) in x_last.iter().zip(y_last) {
        sum += x * y;
    }
    sum
}

/// Σ_{A∌k} x[A] y[A].
pub(super) fn dot_without(x: &[f64], y: &[f64], bit: usize) -> f64 {
    let mut sum = 0.0;
    for (x, y) in x.chunks_exact(2 << bit).zip(y.chunks_exact(2 << bit)) {
        sum += dot(&x[..1 << bit], &y[..1 << bit]);
    }
    sum
}

/// X[A] = q Y[A] + Y[A∪k] for k ∉ A, and 0 elsewhere.
pub(super) fn drop_bit(layer: &mut [f64], bit: usize, rest: f64) {
    for block in layer.chunks_exact_mut(2 << bit) {
        let (without, with) = block.split_at_mut(1 << bit);
        for (x, y) in without.iter_mut().zip(with) {
            *x = rest * *x + std::mem::take(y);
        }
    }
}

/// G[A∪k] = G[A], then G[A] multiplied with q, for k ∉ A.
pub(super) fn give_back_bit(layer: &mut [f64], bit: usize, rest: f64) {
    for block in layer.chunks_exact_mut(2 << bit) {
        let (without, with) = block.split_at_mut(1 << bit);
        for (x, y) in without.iter_mut().zip(with) {
            *y = *x;
            *x *= rest;
        }
    }
}
