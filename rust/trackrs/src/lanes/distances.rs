//! Squared lengths of many vectors through one lower triangular matrix: d²_j = |W (z_j − c)|².
//!
//! The vectors come component by component, so that a register holds one component of several of them; each goes through
//! the same operations in the same order at every [`super::Level`]. Registers are named, not left to the compiler: of loops
//! over arrays it made at some sizes a gathering across blocks, three times as slow.

use pulp::{Arch, Simd, WithSimd};

/// Vectors that are looked at together.
pub(crate) const LANES: usize = 8;

/// Vectors of M components, component by component in blocks, and anything behind the last one.
pub(crate) type Blocks<const M: usize> = [[[f64; LANES]; M]];

/// One center and its W.
#[derive(Clone, Copy)]
pub(crate) struct Whitening<const M: usize> {
    pub(crate) center: [f64; M],
    pub(crate) lower: [[f64; M]; M],
}

struct Rows<'a, const M: usize> {
    whitenings: &'a [Whitening<M>],
    blocks: &'a Blocks<M>,
    count: usize,
    out: &'a mut [f64],
}

/// Writes d² of all centers and vectors, `count` of each center.
pub(crate) fn squared_lengths<const M: usize>(
    arch: Arch,
    whitenings: &[Whitening<M>],
    blocks: &Blocks<M>,
    count: usize,
    out: &mut [f64],
) {
    arch.dispatch(Rows {
        whitenings,
        blocks,
        count,
        out,
    });
}

impl<const M: usize> WithSimd for Rows<'_, M> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for (whitening, out) in self.whitenings.iter().zip(self.out.chunks_exact_mut(self.count.max(1))) {
            let by = spread(simd, whitening);
            let (outs, last) = out.as_chunks_mut::<LANES>();
            for (out, block) in outs.iter_mut().zip(self.blocks) {
                *out = eight(simd, &by, block);
            }
            if let Some(block) = self.blocks.get(outs.len()) {
                last.copy_from_slice(&eight(simd, &by, block)[..last.len()]);
            }
        }
    }
}

struct Within<'a, const M: usize> {
    whitening: &'a Whitening<M>,
    columns: &'a [&'a [f64]; M],
    names: &'a [usize],
    windows: &'a [(usize, usize)],
    threshold: f64,
    found: &'a mut [(usize, f64)],
}

/// Finds the vectors with d² ≤ γ in these windows of the columns: their names and d², put into `found`; how many. Columns and
/// names reach [`LANES`] beyond the last window, and so does `found` beyond what can be found.
pub(crate) fn within<const M: usize>(
    arch: Arch,
    whitening: &Whitening<M>,
    columns: &[&[f64]; M],
    names: &[usize],
    windows: &[(usize, usize)],
    threshold: f64,
    found: &mut [(usize, f64)],
) -> usize {
    arch.dispatch(Within {
        whitening,
        columns,
        names,
        windows,
        threshold,
        found,
    })
}

impl<const M: usize> WithSimd for Within<'_, M> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> usize {
        let mut count = 0_usize;
        let by = spread(simd, self.whitening);
        for &(from, to) in self.windows {
            let mut at = from;
            while at < to {
                let mut block = [[f64::NAN; LANES]; M];
                for k in 0..M {
                    if let Some(part) = first(self.columns[k], at) {
                        block[k] = *part;
                    }
                }
                let d = eight(simd, &by, &block);
                let Some(names) = first(self.names, at) else { break };
                let Some(slots) = first_mut(self.found, count) else {
                    break;
                };
                let mut n = 0_usize;
                for lane in 0..LANES {
                    slots[n % LANES] = (names[lane], d[lane]);
                    let here = at.wrapping_add(lane);
                    n = n.wrapping_add(usize::from(d[lane] <= self.threshold) & usize::from(here < to));
                }
                count = count.wrapping_add(n);
                at = at.wrapping_add(LANES);
            }
        }
        count
    }
}

/// Center and W, a register each number.
struct Spread<S: Simd, const M: usize> {
    center: [S::f64s; M],
    lower: [[S::f64s; M]; M],
}

#[inline(always)]
fn spread<S: Simd, const M: usize>(simd: S, whitening: &Whitening<M>) -> Spread<S, M> {
    let zero = simd.splat_f64s(0.0);
    let (mut center, mut lower) = ([zero; M], [[zero; M]; M]);
    for i in 0..M {
        center[i] = simd.splat_f64s(whitening.center[i]);
        for k in 0..M {
            lower[i][k] = simd.splat_f64s(whitening.lower[i][k]);
        }
    }
    Spread { center, lower }
}

/// As many as stand together from `at` on.
#[inline(always)]
fn first<T>(of: &[T], at: usize) -> Option<&[T; LANES]> {
    match of.get(at..) {
        Some(rest) => rest.first_chunk(),
        None => None,
    }
}

/// The same, to write to.
#[inline(always)]
fn first_mut<T>(of: &mut [T], at: usize) -> Option<&mut [T; LANES]> {
    match of.get_mut(at..) {
        Some(rest) => rest.first_chunk_mut(),
        None => None,
    }
}

/// d² of a block.
#[inline(always)]
fn eight<S: Simd, const M: usize>(simd: S, by: &Spread<S, M>, block: &[[f64; LANES]; M]) -> [f64; LANES] {
    let mut out = [0.0; LANES];
    let registers = S::as_mut_simd_f64s(&mut out).0;
    for r in 0..LANES / S::F64_LANES {
        let mut z = [simd.splat_f64s(0.0); M];
        for k in 0..M {
            z[k] = simd.sub_f64s(S::as_simd_f64s(&block[k]).0[r], by.center[k]);
        }
        let mut sum = simd.splat_f64s(0.0);
        for i in 0..M {
            let mut y = simd.mul_f64s(by.lower[i][0], z[0]);
            for k in 1..M {
                if k <= i {
                    y = simd.add_f64s(y, simd.mul_f64s(by.lower[i][k], z[k]));
                }
            }
            let square = simd.mul_f64s(y, y);
            sum = if i == 0 { square } else { simd.add_f64s(sum, square) };
        }
        registers[r] = sum;
    }
    out
}

/// d² of one vector of any length, given by its components; W row by row.
#[inline(always)]
pub(crate) fn squared_length(center: &[f64], lower: &[f64], component: impl Fn(usize) -> f64) -> f64 {
    let mut sum = 0.0;
    for (i, row) in lower.chunks_exact(center.len().max(1)).enumerate() {
        let mut y = 0.0;
        for (k, (w, c)) in row[..=i].iter().zip(center).enumerate() {
            y += w * (component(k) - c);
        }
        sum += y * y;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Level;

    fn number(i: usize) -> f64 {
        ((i * 29 + 7) % 23) as f64 / 3.0 - 3.1
    }

    fn every_level<const M: usize>() {
        let whitening = |track: usize| {
            let mut lower = [[f64::NAN; M]; M];
            (0..M).for_each(|i| (0..=i).for_each(|k| lower[i][k] = number(i * M + k + track)));
            Whitening {
                center: std::array::from_fn(|k| number(k + 5 + track)),
                lower,
            }
        };
        let whitenings = [whitening(0), whitening(1)];
        for n in [0, 1, 3, 4, 63, 64, 65, 200] {
            let value = |j: usize, k: usize| if j < n { number(j * M + k) } else { f64::NAN };
            let columns: [Vec<f64>; M] = std::array::from_fn(|k| (0..n + LANES).map(|j| value(j, k)).collect());
            let blocks: Vec<[[f64; LANES]; M]> = (0..n.div_ceil(LANES))
                .map(|block| std::array::from_fn(|k| std::array::from_fn(|lane| value(block * LANES + lane, k))))
                .collect();
            let of = |by: &Whitening<M>, j: usize| -> f64 {
                let row = |i: usize| (0..=i).fold(0.0, |y, k| y + by.lower[i][k] * (value(j, k) - by.center[k]));
                (0..M).fold(0.0, |sum, i| sum + row(i) * row(i))
            };
            let expected: Vec<f64> = whitenings
                .iter()
                .flat_map(|by| (0..n).map(move |j| of(by, j)))
                .collect();
            for (by, row) in whitenings.iter().zip(expected.chunks(n.max(1))) {
                for (j, &d) in row.iter().enumerate() {
                    let lower = by.lower.as_flattened();
                    assert_eq!(squared_length(&by.center, lower, |k| value(j, k)), d);
                }
            }
            let names: Vec<usize> = (0..n + LANES).map(|j| 1000 - j).collect();
            let windows = [(n / 9, n / 5), (n / 4, n)];
            for level in Level::available() {
                let arch = level.arch().unwrap();
                let mut found = vec![f64::NAN; 2 * n];
                squared_lengths(arch, &whitenings, &blocks, n, &mut found);
                assert_eq!(found, expected, "{level:?} {M} {n}");
                let mut found = vec![(0, 0.0); n + LANES];
                let columns = columns.each_ref().map(|column| &column[..]);
                let count = within(arch, &whitenings[0], &columns, &names, &windows, 50.0, &mut found);
                let near: Vec<(usize, f64)> = windows
                    .iter()
                    .flat_map(|&(from, to)| from..to)
                    .map(|j| (names[j], expected[j]))
                    .filter(|pair| pair.1 <= 50.0)
                    .collect();
                assert_eq!(found[..count], near, "{level:?} {M} {n}");
            }
        }
    }

    #[test]
    fn every_level_and_size_gives_the_bits_of_the_definition() {
        every_level::<1>();
        every_level::<2>();
        every_level::<3>();
        every_level::<4>();
        every_level::<6>();
    }
}
