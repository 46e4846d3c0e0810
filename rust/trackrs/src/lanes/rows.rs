//! Whole rows of costs in the search of `association::assignment`: the same comparisons at every [`super::Level`].
//!
//! | symbol | name here  | meaning                                                       |
//! |--------|------------|---------------------------------------------------------------|
//! | C, v   | `costs`, `duals` | costs of a row, duals of the columns                    |
//! | d      | `distance` | length of the shortest path to each column                    |
//! | o      | `offset`   | what a path through the row costs before its pair             |

use pulp::{Arch, Simd, WithSimd};

const INFINITY: f64 = f64::INFINITY;

/// Columns are searched in blocks of this many.
pub(crate) const BLOCK: usize = 64;
/// Numbers of the widest register.
const WIDEST: usize = 8;

/// The columns of a search, column by column.
pub(crate) struct Reached<'a> {
    pub(crate) distance: &'a mut [f64],
    /// The row before it on the path.
    pub(crate) predecessor: &'a mut [usize],
    /// Per block: the least distance.
    pub(crate) least: &'a mut [f64],
    /// Per block: columns that are still searched.
    pub(crate) open: &'a [usize],
}

/// A row of the matrix.
#[derive(Clone, Copy)]
pub(crate) struct Row<'a> {
    pub(crate) index: usize,
    pub(crate) costs: &'a [f64],
    /// −∞ where a column is closed to the search.
    pub(crate) duals: &'a [f64],
}

struct Relax<'a, 'b> {
    row: Row<'a>,
    offset: f64,
    reached: Reached<'b>,
}

/// d = min(d, o + (C − v)) in all columns of the row, with its index where that was less.
pub(crate) fn relax(arch: Arch, row: Row<'_>, offset: f64, reached: Reached<'_>) {
    arch.dispatch(Relax { row, offset, reached });
}

impl WithSimd for Relax<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { row, offset, reached } = self;
        let costs = row.costs.chunks(BLOCK).zip(row.duals.chunks(BLOCK));
        let targets = reached
            .distance
            .chunks_mut(BLOCK)
            .zip(reached.predecessor.chunks_mut(BLOCK));
        let blocks = reached.least.iter_mut().zip(reached.open);
        for (((costs, duals), (distance, predecessor)), (least, &open)) in costs.zip(targets).zip(blocks) {
            *least = INFINITY;
            if open == 0 {
                continue;
            }
            let (anything, mut best) = look(simd, costs, duals, offset, distance);
            if anything {
                let targets = distance.iter_mut().zip(predecessor);
                for ((cost, v), (d, predecessor)) in costs.iter().zip(duals).zip(targets) {
                    let through = offset + (cost - v);
                    if through < *d {
                        (*d, *predecessor) = (through, row.index);
                    }
                    best = if *d < best { *d } else { best };
                }
            }
            *least = best;
        }
    }
}

/// Whether a path through a row is shorter anywhere in a block, which is rare; and the least of the distances as they are.
#[inline(always)]
fn look<S: Simd>(simd: S, costs: &[f64], duals: &[f64], offset: f64, distance: &[f64]) -> (bool, f64) {
    let by = simd.splat_f64s(offset);
    let (costs, last_costs) = S::as_simd_f64s(costs);
    let (duals, last_duals) = S::as_simd_f64s(duals);
    let (distance, last_distance) = S::as_simd_f64s(distance);
    let mut least = simd.splat_f64s(INFINITY);
    let mut shorter = simd.less_than_f64s(by, by);
    for ((&cost, &v), &d) in costs.iter().zip(duals).zip(distance) {
        let through = simd.add_f64s(by, simd.sub_f64s(cost, v));
        shorter = simd.or_m64s(shorter, simd.less_than_f64s(through, d));
        least = simd.min_f64s(least, d);
    }
    let (mut anything, mut best) = (
        simd.first_true_m64s(shorter) < S::F64_LANES,
        simd.reduce_min_f64s(least),
    );
    for ((cost, v), &d) in last_costs.iter().zip(last_duals).zip(last_distance) {
        anything |= offset + (cost - v) < d;
        best = if d < best { d } else { best };
    }
    (anything, best)
}

/// The two smallest reduced costs of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TwoCheapest {
    pub(crate) first: f64,
    pub(crate) second: f64,
}

struct Cheapest<'a>(&'a [f64], &'a [f64]);

/// The two smallest of C − v.
pub(crate) fn two_cheapest(arch: Arch, costs: &[f64], duals: &[f64]) -> TwoCheapest {
    arch.dispatch(Cheapest(costs, duals))
}

impl WithSimd for Cheapest<'_> {
    type Output = TwoCheapest;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> TwoCheapest {
        let (costs, last_costs) = S::as_simd_f64s(self.0);
        let (duals, last_duals) = S::as_simd_f64s(self.1);
        let infinite = simd.splat_f64s(INFINITY);
        let (mut first, mut second) = (infinite, infinite);
        for (&cost, &v) in costs.iter().zip(duals) {
            let reduced = simd.sub_f64s(cost, v);
            second = simd.min_f64s(second, simd.max_f64s(first, reduced));
            first = simd.min_f64s(first, reduced);
        }
        let mut lanes = [[INFINITY; WIDEST]; 2];
        S::as_mut_simd_f64s(&mut lanes[0]).0[0] = first;
        S::as_mut_simd_f64s(&mut lanes[1]).0[0] = second;
        let mut best = TwoCheapest {
            first: INFINITY,
            second: INFINITY,
        };
        let last = last_costs.iter().zip(last_duals).map(|(cost, v)| cost - v);
        for value in lanes.into_iter().flatten().chain(last) {
            let larger = if value < best.first { best.first } else { value };
            best.second = if larger < best.second { larger } else { best.second };
            best.first = if value < best.first { value } else { best.first };
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Level;

    fn number(i: usize) -> f64 {
        if i.is_multiple_of(17) {
            INFINITY
        } else {
            ((i * 29 + 7) % 23) as f64 / 3.0 - 3.1
        }
    }

    #[test]
    fn every_level_and_size_gives_what_the_definition_gives() {
        for n in [0, 1, 2, 3, 7, 8, 63, 64, 65, 200] {
            let costs: Vec<f64> = (0..n).map(number).collect();
            let closed = |k: usize| k % 11 == 5;
            let duals: Vec<f64> = (0..n)
                .map(|k| {
                    if closed(k) {
                        -INFINITY
                    } else {
                        number(3 * k + 1).min(4.0)
                    }
                })
                .collect();
            let mut reduced: Vec<f64> = costs.iter().zip(&duals).map(|(c, v)| c - v).collect();
            let before: Vec<f64> = (0..n).map(|k| number(5 * k + 2) + 2.0).collect();
            let offset = 0.7;
            let through: Vec<f64> = reduced.iter().map(|x| offset + x).collect();
            let expected: Vec<f64> = before.iter().zip(&through).map(|(&d, &x)| d.min(x)).collect();
            let from: Vec<usize> = (0..n)
                .map(|k| if through[k] < before[k] { 3 } else { 1000 + k })
                .collect();
            let nearest: Vec<f64> = expected
                .chunks(BLOCK)
                .map(|block| block.iter().copied().fold(INFINITY, f64::min))
                .collect();
            reduced.sort_by(f64::total_cmp);
            let smallest = |k: usize| reduced.get(k).copied().unwrap_or(INFINITY);
            for level in Level::available() {
                let arch = level.arch().unwrap();
                let found = two_cheapest(arch, &costs, &duals);
                assert_eq!((found.first, found.second), (smallest(0), smallest(1)), "{level:?} {n}");
                let (mut distance, mut predecessor) = (before.clone(), (1000..1000 + n).collect::<Vec<_>>());
                let mut least = vec![f64::NAN; nearest.len()];
                let reached = Reached {
                    distance: &mut distance,
                    predecessor: &mut predecessor,
                    least: &mut least,
                    open: &vec![1; nearest.len()],
                };
                let row = Row {
                    index: 3,
                    costs: &costs,
                    duals: &duals,
                };
                relax(arch, row, offset, reached);
                assert_eq!(
                    (&distance, &predecessor, &least),
                    (&expected, &from, &nearest),
                    "{level:?} {n}"
                );
            }
        }
    }
}
