//! The k assignments of least cost, in order.
//!
//! | symbol | name here | meaning                                                                            |
//! |--------|-----------|------------------------------------------------------------------------------------|
//! | C, μ   | `costs`, `miss_costs` | as in [`assignment`](super::assignment)                                |
//! | s      | `depth`   | rows before it are fixed to what they have in the node's solution                  |
//! | F      | `forbidden` | what row s may not have                                                          |
//! | u, v   | `row_duals`, `column_duals` | C_rc ≥ u_r + v_c, μ_r ≥ u_r, 0 ≥ v_c; equal where assigned or left out |
//!
//! 1. A node is a set of assignments and the best of them. The root holds all.
//! 2. The cheapest open node's solution is the next in order. What else the node holds is split: child r = s, s + 1, …
//!    fixes rows s … r − 1 to what they have in that solution and forbids row r what it has there.
//! 3. The child's solution is one augmentation away from the parent's, under the parent's duals (`search`).
//!
//! Costs are summed anew for every solution, row by row. Equal costs come in the order in which they were found, which
//! depends on the numbers alone.
//!
//! Without miss costs all solutions have the largest possible number of pairs. Where every row, or every column, can
//! have one, exits are closed. Otherwise an exit costs more than all pairs together.
//!
//! References: K. G. Murty, An algorithm for ranking all the assignments in order of increasing cost, Oper. Res. 16(3),
//! 1968; M. L. Miller, H. S. Stone, I. J. Cox, Optimizing Murty's ranked assignment method, IEEE Trans. Aerosp. Electron.
//! Syst. 33(3), 1997, for (3).

mod search;

use super::assignment::{Assignment, assign, assign_with_misses};
use crate::error::{Result, require_size};
use search::NONE;
pub(super) use search::{Node, Table};

/// One of the best assignments.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranked {
    /// The column of each row, `None` where the row stays unassigned.
    pub row_to_column: Vec<Option<usize>>,
    /// Sum of the costs of the pairs, and of the miss costs of unassigned rows where these have one.
    pub cost: f64,
}

/// The `k` cheapest among the largest assignments, or all if there are fewer. The matrix is as in [`assign`].
pub fn k_best(costs: &[f64], rows: usize, columns: usize, k: usize) -> Result<Vec<Ranked>> {
    let first = assign(costs, rows, columns)?;
    let pairs = first.row_to_column.iter().flatten().count();
    if pairs == rows {
        let table = Table::new(costs, columns, vec![f64::INFINITY; rows]);
        return Ok(Ranking::from_first(table, &first).take(k).collect());
    }
    if pairs == columns {
        let mut turned = Vec::with_capacity(costs.len());
        for column in 0..columns {
            turned.extend((0..rows).map(|row| costs[row * columns + column]));
        }
        let first = assign(&turned, columns, rows)?;
        let table = Table::new(&turned, rows, vec![f64::INFINITY; columns]);
        let turn = |found: Ranked| {
            let mut row_to_column = vec![None; rows];
            for (column, row) in found.row_to_column.iter().enumerate() {
                if let Some(row) = row {
                    row_to_column[*row] = Some(column);
                }
            }
            let of_row = |(row, column): (usize, &Option<usize>)| column.map_or(0.0, |c| costs[row * columns + c]);
            let cost = row_to_column.iter().enumerate().map(of_row).sum();
            Ranked { row_to_column, cost }
        };
        let mut found: Vec<Ranked> = Ranking::from_first(table, &first).take(k).map(turn).collect();
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost)); // sums in another order differ in their last digit
        return Ok(found);
    }
    let exit = 1.0 + 2.0 * costs.iter().filter(|c| c.is_finite()).map(|c| c.abs()).sum::<f64>();
    let misses = vec![exit; rows];
    let mut found = Vec::new();
    for mut ranked in Ranking::new(costs, columns, misses)? {
        let assigned = ranked.row_to_column.iter().flatten().count();
        if assigned < pairs || found.len() == k {
            break;
        }
        let of_row = |(row, column): (usize, &Option<usize>)| column.map_or(0.0, |c| costs[row * columns + c]);
        ranked.cost = ranked.row_to_column.iter().enumerate().map(of_row).sum();
        found.push(ranked);
    }
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    Ok(found)
}

/// The `k` cheapest assignments where row r may stay unassigned at cost `miss_costs[r]`, or all if there are fewer.
/// Arguments are as in [`assign_with_misses`].
pub fn k_best_with_misses(
    costs: &[f64],
    rows: usize,
    columns: usize,
    miss_costs: &[f64],
    k: usize,
) -> Result<Vec<Ranked>> {
    require_size("miss costs", rows, miss_costs.len())?;
    Ok(Ranking::new(costs, columns, miss_costs.to_vec())?.take(k).collect())
}

/// All assignments, the cheapest first.
pub(super) struct Ranking<'a> {
    table: Table<'a>,
    /// Nodes not yet split, as a binary heap.
    open: std::collections::BinaryHeap<Node>,
    born: usize,
    last_cost: f64,
}

impl<'a> Ranking<'a> {
    /// `miss_costs` may be +∞ in a row whose best solution has a pair.
    pub(super) fn new(costs: &'a [f64], columns: usize, miss_costs: Vec<f64>) -> Result<Self> {
        let first = assign_with_misses(costs, miss_costs.len(), columns, &miss_costs)?;
        Ok(Self::from_first(Table::new(costs, columns, miss_costs), &first))
    }

    fn from_first(table: Table<'a>, first: &Assignment) -> Self {
        let row_column: Vec<usize> = first.row_to_column.iter().map(|c| c.unwrap_or(NONE)).collect();
        let root = Node {
            cost: table.cost(&row_column),
            born: 0,
            row_column,
            row_duals: first.row_duals.clone(),
            column_duals: first.column_duals.clone(),
            depth: 0,
            forbidden: Vec::new(),
        };
        Self {
            last_cost: root.cost,
            table,
            open: [root].into(),
            born: 1,
        }
    }

    /// The nodes whose solutions have not been returned.
    pub(super) fn open(&self) -> impl Iterator<Item = &Node> {
        self.open.iter()
    }

    pub(super) fn table(&self) -> &Table<'a> {
        &self.table
    }
}

impl Iterator for Ranking<'_> {
    type Item = Ranked;

    fn next(&mut self) -> Option<Ranked> {
        let node = self.open.pop()?;
        for row in node.depth..node.row_column.len() {
            if let Some(child) = self.table.child(&node, row, self.born) {
                self.born += 1;
                self.open.push(child);
            }
        }
        // A child may be cheaper than its parent in the last digit.
        self.last_cost = self.last_cost.max(node.cost);
        Some(Ranked {
            row_to_column: node.row_column.iter().map(|&c| (c != NONE).then_some(c)).collect(),
            cost: self.last_cost,
        })
    }
}
