//! Minimum-cost assignment of rows to columns: shortest augmenting paths on a dense rectangular cost matrix.
//!
//! | symbol | name here | shape | meaning |
//! |--------|-----------|-------|---------|
//! | C      | `costs`   | rows × columns, row-major | cost of each pair, `+inf` where the pair is forbidden |
//! | μ      | `miss_costs` | rows | cost of leaving a row unassigned |
//! | u, v   | `row_duals`, `column_duals` | rows, columns | `C[r,c] ≥ u[r] + v[c]`, equal on assigned pairs |
//! | d      | `distance` | columns | length of the shortest alternating path from the start row to the column |
//! | o      | `offset`  | scalar | `d` of a row minus its dual `u` |
//!
//! Every row also has an exit of its own: a private column that only it can take, at cost μ. Equations, in
//! the order of the code:
//!
//! 1. Row reduction, as in an auction: the cheapest column `j` of a row and the second cheapest cost give
//!    `v[j] -= second - first`; the row takes `j`, and the row that had it looks again.
//! 2. Each row still free starts a shortest-path search under the reduced costs `C[r,c] - u[r] - v[c] ≥ 0`.
//!    Visiting row `r`: `d[c] = min(d[c], o + C[r,c] - v[c])`, and its exit is at `o + μ[r]`. The nearest
//!    column or exit is final; an assigned column leads to its row, with `o = d[c] - (C[r,c] - v[c])`;
//!    a free column or an exit, at distance `D`, ends the search.
//! 3. `v[c] += d[c] - D` for the columns passed; the pairs along the path are swapped.
//!
//! A row that has left by its exit never comes back: only that row can reach it.
//!
//! Without miss costs the aim is lexicographic: most pairs first, then least cost. An exit costs `(1, 0)`
//! and a pair `(0, C)`, compared in this order, so no large constant spoils the sums. A search that
//! reaches no free column has found a closed set: its rows reach only its columns, all taken. The first
//! component of their duals becomes `(+1, -1)`: the columns are `saturated`, and a row outside enters
//! them at the price of one exit. So a search looks at the other columns first, and only when
//! these fail opens the saturated ones and the exits.
//!
//! References: R. Jonker, A. Volgenant, *A shortest augmenting path algorithm for dense and sparse linear
//! assignment problems*, Computing 38, 1987, for (1); D. F. Crouse, *On implementing 2D rectangular
//! assignment algorithms*, IEEE Trans. Aerosp. Electron. Syst. 52(4), 2016, for (2) and (3).

mod kernels;
mod lists;
mod paths;
mod price;
pub mod sparse;

use pulp::Arch;

use crate::error::{Error, Result, require_finite, require_size};
use crate::lanes::Level;
use kernels::all_at_most;
use paths::Solver;

/// No row, no column.
const NONE: usize = usize::MAX;
/// From so many columns on registers are as wide as they come.
const WIDE: usize = 32;
/// Sums of costs up to this along any path stay finite.
const LARGEST_COST: f64 = 1e300;

/// An optimal assignment, and the dual solution that proves it.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// The column of each row, `None` where the row stays unassigned.
    pub row_to_column: Vec<Option<usize>>,
    /// Sum of the costs of the assigned pairs, and of the miss costs of unassigned rows where these have one.
    pub cost: f64,
    /// `u` in `costs[r, c] ≥ u[r] + v[c]`, which holds for every allowed pair up to rounding.
    pub row_duals: Vec<f64>,
    /// `v` in the same inequality, which is an equation for assigned pairs.
    pub column_duals: Vec<f64>,
}

/// The cheapest among the largest assignments.
///
/// `costs` is row-major; `+inf` forbids a pair; negative costs are allowed. As many pairs are made as
/// the allowed pairs permit, and among all such assignments one of least total cost is returned.
/// The duals of the longer side (the columns, if equal) are at most 0, and 0 where unassigned.
pub fn assign(costs: &[f64], rows: usize, columns: usize) -> Result<Assignment> {
    check(costs, rows, columns)?;
    solve(costs, rows, columns, None)
}

/// The assignment of least total cost where row `r` may stay unassigned at cost `miss_costs[r]`.
///
/// A miss cost is finite and may be negative. `u[r] ≤ miss_costs[r]`, equal for unassigned rows;
/// `v[c] ≤ 0`, equal for unassigned columns.
pub fn assign_with_misses(costs: &[f64], rows: usize, columns: usize, miss_costs: &[f64]) -> Result<Assignment> {
    check(costs, rows, columns)?;
    require_size("miss costs", rows, miss_costs.len())?;
    require_finite("miss cost", miss_costs)?;
    check_magnitude("miss cost", miss_costs.iter().copied())?;
    solve(costs, rows, columns, Some(miss_costs))
}

fn solve(costs: &[f64], rows: usize, columns: usize, miss_costs: Option<&[f64]>) -> Result<Assignment> {
    // Rows of a few columns do not fill wide registers.
    let arch = if rows.max(columns) < WIDE {
        Arch::Scalar
    } else {
        Level::chosen_arch()?
    };
    let mut row_to_column = vec![None; rows];
    let (row_duals, column_duals) = if rows <= columns {
        let mut solver = Solver::new(arch, costs, rows, columns, miss_costs);
        let row_duals = solver.run();
        for (column, &taken) in row_to_column.iter_mut().zip(&solver.row_column) {
            *column = (taken != NONE).then_some(taken);
        }
        (row_duals, solver.v)
    } else {
        // One search per element of the smaller side. With C - μ for C a column may stay free at cost 0.
        let miss = |row: usize| miss_costs.map_or(0.0, |m| m[row]);
        let mut turned = Vec::with_capacity(costs.len());
        for column in 0..columns {
            turned.extend((0..rows).map(|row| costs[row * columns + column] - miss(row)));
        }
        let nothing = vec![0.0; columns];
        let mut solver = Solver::new(arch, &turned, columns, rows, miss_costs.map(|_| &nothing[..]));
        let column_duals = solver.run();
        for (column, &row) in solver.row_column.iter().enumerate() {
            if row != NONE {
                row_to_column[row] = Some(column);
            }
        }
        let row_duals = solver.v.iter().enumerate();
        (row_duals.map(|(row, v)| v + miss(row)).collect(), column_duals)
    };
    let cost_of = |(row, column): (usize, &Option<usize>)| match column {
        Some(column) => costs[row * columns + column],
        None => miss_costs.map_or(0.0, |m| m[row]),
    };
    let mut cost = 0.0;
    for pair in row_to_column.iter().enumerate() {
        cost += cost_of(pair);
    }
    Ok(Assignment {
        row_to_column,
        cost,
        row_duals,
        column_duals,
    })
}

fn check(costs: &[f64], rows: usize, columns: usize) -> Result<()> {
    require_size("assignment costs", rows.saturating_mul(columns), costs.len())?;
    if all_at_most(LARGEST_COST, costs) {
        return Ok(());
    }
    let unusable = |c: &f64| c.is_nan() || *c == f64::NEG_INFINITY;
    if let Some(index) = costs.iter().position(unusable) {
        return Err(Error::NonFinite {
            what: "assignment cost".into(),
            index,
        });
    }
    check_magnitude("assignment cost", costs.iter().copied())
}

fn check_magnitude(name: &str, mut costs: impl Iterator<Item = f64>) -> Result<()> {
    let excessive = |c: &f64| c.is_finite() && c.abs() > LARGEST_COST;
    costs.find(excessive).map_or(Ok(()), |c| {
        let requirement = "must not exceed 1e300 in magnitude; infinity forbids a pair";
        Err(Error::invalid(name, c, requirement))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO: f64 = f64::INFINITY;

    #[test]
    fn number_of_pairs_comes_first() {
        // Row 0 alone would take column 0 at 1; both rows find a pair only if it takes column 1.
        let found = assign(&[1.0, 1e9, 1.0, NO], 2, 2).unwrap();
        assert_eq!(found.row_to_column, [Some(1), Some(0)]);
        assert_eq!(found.cost, 1e9 + 1.0);
    }

    #[test]
    fn the_right_row_is_left_out() {
        // Two rows compete for one column, and a third for the other.
        let costs = [5.0, NO, 3.0, NO, NO, 1.0, 4.0, NO];
        let found = assign(&costs, 4, 2).unwrap();
        assert_eq!(found.row_to_column, [None, Some(0), Some(1), None]);
        assert_eq!(found.cost, 4.0);
    }

    #[test]
    fn a_miss_is_taken_where_it_is_cheaper() {
        let found = assign_with_misses(&[5.0, NO, 3.0, 8.0], 2, 2, &[1.0, 6.0]).unwrap();
        assert_eq!(found.row_to_column, [None, Some(0)]);
        assert_eq!(found.cost, 4.0);
    }

    #[test]
    fn nothing_to_assign() {
        assert_eq!(assign(&[], 0, 3).unwrap().cost, 0.0);
        assert_eq!(assign(&[], 2, 0).unwrap().row_to_column, [None, None]);
        assert_eq!(assign_with_misses(&[], 2, 0, &[1.0, 2.0]).unwrap().cost, 3.0);
        assert_eq!(assign(&[NO; 6], 2, 3).unwrap().row_to_column, [None, None]);
    }

    #[test]
    fn errors_name_the_culprit() {
        let index = |costs: &[f64]| match assign(costs, 1, costs.len()) {
            Err(Error::NonFinite { index, .. }) => Some(index),
            _ => None,
        };
        assert_eq!(index(&[0.0, NO, f64::NAN]), Some(2));
        assert_eq!(index(&[0.0, -NO]), Some(1));
        assert!(matches!(assign(&[f64::MAX], 1, 1), Err(Error::InvalidParameter { .. })));
        assert!(matches!(assign(&[1.0], 1, 2), Err(Error::DimensionMismatch { .. })));
        assert!(assign(&[], usize::MAX, 2).is_err());
        assert!(matches!(
            assign_with_misses(&[1.0], 1, 1, &[NO]),
            Err(Error::NonFinite { .. })
        ));
    }
}
