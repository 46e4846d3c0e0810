//! Squared lengths of many vectors through one lower triangular matrix: d²_j = |W (z_j − c)|².
//!
//! The vectors come component by component, so that a register holds one component of several of them; each goes through
//! the same operations in the same order at every [`super::Level`].

use pulp::{Arch, Simd, WithSimd};

/// Vectors that are looked at together: two registers of four, or four of two.
const LANES: usize = 8;

/// The same where their length is not known to the compiler.
const TILE: usize = 64;

/// One center and its W, m×m row by row.
#[derive(Clone, Copy)]
pub(crate) struct Whitening<'a> {
    pub(crate) center: &'a [f64],
    pub(crate) lower: &'a [f64],
}

struct Work<'a, 'b> {
    whitening: Whitening<'a>,
    columns: &'b [&'b [f64]],
    out: &'b mut [f64],
}

/// Writes d² of all vectors; `columns` are their m components.
pub(crate) fn squared_lengths(arch: Arch, whitening: Whitening<'_>, columns: &[&[f64]], out: &mut [f64]) {
    arch.dispatch(Work {
        whitening,
        columns,
        out,
    });
}

impl WithSimd for Work<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        match self.columns.len() {
            1 => fixed::<1>(self),
            2 => fixed::<2>(self),
            3 => fixed::<3>(self),
            4 => fixed::<4>(self),
            _ => any(self),
        }
    }
}

#[inline(always)]
fn fixed<const M: usize>(work: Work<'_, '_>) {
    let Work {
        whitening,
        columns,
        out,
    } = work;
    let (mut w, mut c) = ([[0.0; M]; M], [0.0; M]);
    for i in 0..M {
        w[i].copy_from_slice(&whitening.lower[i * M..(i + 1) * M]);
        c[i] = whitening.center[i];
    }
    let mut parts: [_; M] = std::array::from_fn(|k| columns[k].chunks_exact(LANES));
    let mut outs = out.chunks_exact_mut(LANES);
    for out in &mut outs {
        let mut z = [[0.0; LANES]; M];
        for (z, part) in z.iter_mut().zip(&mut parts) {
            if let Some(part) = part.next() {
                z.copy_from_slice(part);
            }
        }
        let mut sum = [0.0; LANES];
        for i in 0..M {
            let mut y = [0.0; LANES];
            for k in 0..=i {
                for (y, z) in y.iter_mut().zip(&z[k]) {
                    *y += w[i][k] * (z - c[k]);
                }
            }
            for (sum, y) in sum.iter_mut().zip(&y) {
                *sum += y * y;
            }
        }
        out.copy_from_slice(&sum);
    }
    let rest = columns.first().map_or(0, |column| column.len() / LANES * LANES);
    for (j, out) in outs.into_remainder().iter_mut().enumerate() {
        let mut sum = 0.0;
        for i in 0..M {
            let mut y = 0.0;
            for k in 0..=i {
                y += w[i][k] * (columns[k][rest.wrapping_add(j)] - c[k]);
            }
            sum += y * y;
        }
        *out = sum;
    }
}

#[inline(always)]
fn any(work: Work<'_, '_>) {
    let Work {
        whitening,
        columns,
        out,
    } = work;
    let m = columns.len();
    for (tile, out) in out.chunks_mut(TILE).enumerate() {
        let from = tile.wrapping_mul(TILE);
        out.fill(0.0);
        for (i, row) in whitening.lower.chunks_exact(m).enumerate() {
            let mut y = [0.0; TILE];
            let terms = row[..=i].iter().zip(whitening.center).zip(columns);
            for ((&w, &c), column) in terms {
                for (y, z) in y.iter_mut().zip(&column[from..]) {
                    *y += w * (z - c);
                }
            }
            for (sum, y) in out.iter_mut().zip(y) {
                *sum += y * y;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Level;

    #[test]
    fn every_level_and_size_gives_the_bits_of_the_definition() {
        let number = |i: usize| ((i * 29 + 7) % 23) as f64 / 3.0 - 3.1;
        for m in 1..=6 {
            for n in [0, 1, 3, 4, 63, 64, 65, 200] {
                let columns: Vec<Vec<f64>> = (0..m).map(|k| (0..n).map(|j| number(j * m + k)).collect()).collect();
                let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
                let (center, mut lower): (Vec<f64>, Vec<f64>) = (
                    (0..m).map(|k| number(k + 5)).collect(),
                    (0..m * m).map(number).collect(),
                );
                (0..m * m).filter(|i| i % m > i / m).for_each(|i| lower[i] = f64::NAN);
                let whitening = Whitening {
                    center: &center,
                    lower: &lower,
                };
                let of = |j: usize| -> f64 {
                    let row = |i: usize| (0..=i).fold(0.0, |y, k| y + lower[i * m + k] * (columns[k][j] - center[k]));
                    (0..m).fold(0.0, |sum, i| sum + row(i) * row(i))
                };
                let expected: Vec<f64> = (0..n).map(of).collect();
                for level in Level::available() {
                    let mut found = vec![f64::NAN; n];
                    squared_lengths(level.arch().unwrap(), whitening, &columns, &mut found);
                    assert_eq!(found, expected, "{level:?} {m} {n}");
                }
            }
        }
    }
}
