//! Pairs of points closer than a cutoff, and the best choice among them: what OSPA and GOSPA share.
//!
//! | symbol | name here | shape | meaning |
//! |--------|-----------|-------|---------|
//! | X, Y   | `x`, `y`  | m×d, n×d | points as rows |
//! | c, p   | `cutoff`, `order` | scalar | largest distance that counts, exponent |
//! | γ      |           | list  | pairs closer than c, no row and no column used twice |
//!
//! 1. The points of Y in the order of their widest coordinate; each of X is compared with those whose coordinate is not
//!    farther than c.
//! 2. `min over γ of Σ_γ dᵖ + cᵖ (m − |γ|)`: for m ≤ n the optimum over injections of `min(c, d)ᵖ`, because a pair not
//!    closer than c costs as much as none. So the problem falls into small ones where c is small.
//!
//! Where most pairs are close the same problem is solved as a full matrix of `min(c, d)ᵖ`.

use nalgebra::DMatrix;

use super::ospa::power;
use crate::association::assignment::assign;
use crate::association::assignment::sparse::{Candidate, assign_sparse_with_misses};
use crate::error::{Result, require_finite, require_size};
use crate::interrupt::ahead;

/// Two points closer than the cutoff.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Near {
    pub(super) row: usize,
    pub(super) column: usize,
    pub(super) distance: f64,
}

/// Fewer pairs than these are all compared; below, sorting costs more than it saves.
const SMALL: usize = 1024;
/// Lists beat the full matrix as long as at most one pair in so many is close.
const SPARSE: usize = 4;

fn check(x: &DMatrix<f64>, y: &DMatrix<f64>) -> Result<()> {
    for points in [x, y] {
        if points.iter().any(|value| !value.is_finite()) {
            // Row by row, so that the index is the one in the caller's array.
            require_finite("points", points.transpose().as_slice())?;
        }
    }
    if x.nrows() == 0 || y.nrows() == 0 {
        return Ok(()); // an empty set has no dimension to check
    }
    require_size("coordinates of a point", x.ncols(), y.ncols())
}

/// Squared distances of one point from all in `others`, which has a column per coordinate.
fn squares(point: impl Iterator<Item = f64>, others: &DMatrix<f64>, from: usize, out: &mut [f64]) {
    out.fill(0.0);
    for (x, others) in point.zip(others.column_iter()) {
        let others = others.as_slice();
        for (square, y) in out.iter_mut().zip(&others[from..]) {
            *square += (x - y) * (x - y);
        }
    }
}

/// All Euclidean distances, row-major: every row of `x` with every row of `y`.
pub(super) fn distances(x: &DMatrix<f64>, y: &DMatrix<f64>) -> Result<Vec<f64>> {
    check(x, y)?;
    let mut out = vec![0.0; x.nrows() * y.nrows()];
    for (i, row) in out.chunks_exact_mut(y.nrows().max(1)).enumerate() {
        ahead(row.len());
        squares(x.row(i).iter().copied(), y, 0, row);
        for square in row {
            *square = square.sqrt();
        }
    }
    Ok(out)
}

/// Equation 1: the pairs closer than `cutoff`, row after row.
pub(super) fn near(x: &DMatrix<f64>, y: &DMatrix<f64>, cutoff: f64) -> Result<Vec<Near>> {
    check(x, y)?;
    let (m, n) = (x.nrows(), y.nrows());
    let mut out = Vec::with_capacity(m.min(n));
    if m == 0 || n == 0 {
        return Ok(out);
    }
    let mut buffer = vec![0.0; n];
    let mut visit = |row: usize, y: &DMatrix<f64>, from: usize, to: usize, name: &dyn Fn(usize) -> usize| {
        ahead(to - from);
        let square_of = &mut buffer[..to - from];
        squares(x.row(row).iter().copied(), y, from, square_of);
        for (at, square) in square_of.iter().enumerate() {
            let distance = square.sqrt();
            if distance < cutoff {
                out.push(Near {
                    row,
                    column: name(from + at),
                    distance,
                });
            }
        }
    };
    if m * n <= SMALL {
        (0..m).for_each(|row| visit(row, y, 0, n, &|column| column));
        return Ok(out);
    }
    let width = |axis: &usize| y.column(*axis).max() - y.column(*axis).min();
    let axis = (0..y.ncols()).max_by(|a, b| width(a).total_cmp(&width(b))).unwrap_or(0);
    let mut order: Vec<usize> = (0..n).collect();
    let along = y.column(axis);
    order.sort_unstable_by(|&a, &b| along[a].total_cmp(&along[b]).then(a.cmp(&b)));
    let sorted = y.select_rows(&order);
    let along = sorted.column(axis);
    let along = along.as_slice();
    for row in 0..m {
        // A distance is not below the difference of a coordinate, rounding included.
        let here = x[(row, axis)];
        let from = along.partition_point(|value| here - value > cutoff);
        let to = from + along[from..].partition_point(|value| value - here <= cutoff);
        visit(row, &sorted, from, to, &|column| order[column]);
    }
    Ok(out)
}

/// Equation 2: the pair of each row, if it has one in the best choice.
pub(super) fn matched(near: &[Near], [m, n]: [usize; 2], full: f64, order: f64) -> Result<Vec<Option<Near>>> {
    let mut out = vec![None; m];
    if near.len() <= SMALL || near.len() <= m * n / SPARSE {
        let candidate = |pair: &Near| Candidate {
            row: pair.row,
            column: pair.column,
            cost: power(pair.distance, order),
        };
        let candidates: Vec<Candidate> = near.iter().map(candidate).collect();
        let found = assign_sparse_with_misses(&candidates, m, n, &vec![full; m])?.row_to_column;
        for pair in near {
            if found[pair.row] == Some(pair.column) {
                out[pair.row] = Some(*pair);
            }
        }
        return Ok(out);
    }
    let mut costs = vec![full; m * n];
    for (at, pair) in near.iter().enumerate() {
        if at % 1024 == 0 {
            ahead(1 << 15);
        }
        costs[pair.row * n + pair.column] = power(pair.distance, order);
    }
    let found = assign(&costs, m, n)?.row_to_column;
    for pair in near {
        if found[pair.row] == Some(pair.column) {
            out[pair.row] = Some(*pair);
        }
    }
    Ok(out)
}
