//! The search of [`assignment`](super): row reduction, then shortest augmenting paths. Symbols and equations there.
//!
//! With no miss costs an exit costs `(1, 0)` and a pair `(0, C)`. Only the second components are stored. The first
//! ones are known: 1 for saturated rows and for rows without a column, -1 for saturated columns, else 0. Hence no
//! path from outside through a saturated column, and no exit, can be shorter than any path to a free column, and
//! the second components alone order the rest.

use pulp::Arch;

use super::NONE;
use super::kernels::lesser;
use crate::interrupt::ahead;
use crate::lanes::rows::{BLOCK, Reached, Row, relax, two_cheapest};

const INFINITY: f64 = f64::INFINITY;
/// Of so many rows row reduction looks at this many; more cost more than they save. A search of many rows is dear, and so more is
/// reduced before it.
fn reductions(rows: usize) -> usize {
    (rows / 64).clamp(4, 16).saturating_mul(rows)
}

/// A column passed in a search, with the row it led to.
#[derive(Clone, Copy)]
struct Passed {
    column: usize,
    distance: f64,
    row: usize,
    offset: f64,
}

/// The cheapest way out of the rows visited so far.
#[derive(Clone, Copy)]
struct Exit {
    row: usize,
    distance: f64,
}

pub(super) struct Solver<'a> {
    arch: Arch,
    costs: &'a [f64],
    columns: usize,
    miss_costs: Option<&'a [f64]>,
    /// The column of each row, [`NONE`] where it left by its exit.
    pub(super) row_column: Vec<usize>,
    column_row: Vec<usize>,
    /// Column duals.
    pub(super) v: Vec<f64>,
    /// 0 at free columns, `+inf` at assigned ones.
    taken: Vec<f64>,
    saturated: Vec<bool>,
    /// `v`, but `-inf` at columns closed to the search: their distance comes out as `+inf`, so the
    /// inner loops need no test.
    open_v: Vec<f64>,
    distance: Vec<f64>,
    predecessor: Vec<usize>,
    block_least: Vec<f64>,
    /// Columns of each block not yet passed in this search.
    block_open: Vec<usize>,
    passed: Vec<Passed>,
    exit: Exit,
}

impl<'a> Solver<'a> {
    /// `costs` row by row.
    pub(super) fn new(
        arch: Arch,
        costs: &'a [f64],
        rows: usize,
        columns: usize,
        miss_costs: Option<&'a [f64]>,
    ) -> Self {
        Self {
            arch,
            costs,
            columns,
            miss_costs,
            row_column: vec![NONE; rows],
            column_row: vec![NONE; columns],
            v: vec![0.0; columns],
            taken: vec![0.0; columns],
            saturated: vec![false; columns],
            open_v: vec![0.0; columns],
            distance: vec![INFINITY; columns],
            predecessor: vec![NONE; columns],
            block_least: vec![INFINITY; columns.div_ceil(BLOCK)],
            block_open: vec![0; columns.div_ceil(BLOCK)],
            passed: Vec::with_capacity(columns),
            exit: Exit {
                row: NONE,
                distance: INFINITY,
            },
        }
    }

    fn row(&self, row: usize) -> &'a [f64] {
        &self.costs[row * self.columns..(row + 1) * self.columns]
    }

    fn miss(&self, row: usize) -> Option<f64> {
        self.miss_costs.map(|costs| costs[row])
    }

    /// Solves, and returns the row duals.
    pub(super) fn run(&mut self) -> Vec<f64> {
        let free = self.reduce_rows();
        self.open_v.copy_from_slice(&self.v);
        for row in free {
            self.augment(row);
        }
        let dual = |(row, &column): (usize, &usize)| match column {
            NONE => self.miss(row).unwrap_or(0.0),
            _ => self.row(row)[column] - self.v[column],
        };
        let mut row_duals = self.row_column.iter().enumerate().map(dual).collect::<Vec<_>>();
        self.lift_saturated(&mut row_duals);
        row_duals
    }

    /// Equation 1. Returns the rows that remain to be searched from.
    fn reduce_rows(&mut self) -> Vec<usize> {
        let rows = self.row_column.len();
        let mut waiting: Vec<usize> = (0..rows).rev().collect();
        let mut left = Vec::new();
        let mut budget = reductions(rows);
        while let Some(row) = waiting.pop() {
            ahead(self.columns);
            let mut best = two_cheapest(self.arch, self.row(row), &self.v);
            if let Some(miss) = self.miss(row) {
                if best.first > miss {
                    continue; // the exit is the cheapest and free: settled
                }
                best.second = best.second.min(miss);
            }
            let gain = best.second - best.first;
            let column = self.cheapest_column(row, best.first);
            let rival = self.column_row.get(column).copied().unwrap_or(NONE);
            // A column is taken from another row only for a gain: else two rows could swap for ever.
            let stuck = rival != NONE && !(gain > 0.0 && gain < INFINITY);
            if budget == 0 || column == NONE || stuck {
                left.push(row);
                continue;
            }
            budget -= 1;
            if gain < INFINITY {
                self.v[column] -= gain;
            }
            self.column_row[column] = row;
            self.taken[column] = INFINITY;
            self.row_column[row] = column;
            if rival != NONE {
                self.row_column[rival] = NONE;
                waiting.push(rival);
            }
        }
        left
    }

    /// The column of reduced cost `least` in this row, a free one if there are several.
    fn cheapest_column(&self, row: usize, least: f64) -> usize {
        let mut cheapest = NONE;
        if least == INFINITY {
            return NONE;
        }
        let blocks = self.row(row).chunks(BLOCK).zip(self.v.chunks(BLOCK));
        for (block, (costs, v)) in blocks.enumerate() {
            let is_least = |(cost, v): (&f64, &f64)| cost - v == least;
            // Of most blocks this test says all, and it vectorises.
            if !costs.iter().zip(v).fold(false, |any, pair| any | is_least(pair)) {
                continue;
            }
            for (lane, pair) in costs.iter().zip(v).enumerate() {
                if is_least(pair) {
                    cheapest = block * BLOCK + lane;
                    if self.taken[cheapest] == 0.0 {
                        return cheapest;
                    }
                }
            }
        }
        cheapest
    }

    /// Equations 2 and 3: one search from a free row.
    fn augment(&mut self, start: usize) {
        self.distance.fill(INFINITY);
        self.passed.clear();
        self.block_open.fill(BLOCK); // a short last block is never skipped
        self.exit = Exit {
            row: NONE,
            distance: INFINITY,
        };
        let mut exits_open = self.miss_costs.is_some();
        let mut nearest = self.visit(start, 0.0);
        let end = loop {
            let distance = self.distance.get(nearest).copied().unwrap_or(INFINITY);
            if exits_open && self.exit.distance < distance {
                break NONE;
            }
            if distance == INFINITY {
                exits_open = true;
                nearest = self.open_saturated(start);
                continue;
            }
            let row = self.column_row[nearest];
            if row == NONE {
                break nearest;
            }
            let offset = distance - (self.row(row)[nearest] - self.v[nearest]);
            self.passed.push(Passed {
                column: nearest,
                distance,
                row,
                offset,
            });
            self.open_v[nearest] = -INFINITY;
            self.distance[nearest] = INFINITY;
            self.block_open[nearest / BLOCK] -= 1;
            nearest = self.visit(row, offset);
        };
        let saturate = exits_open && self.miss_costs.is_none();
        let total = if end == NONE {
            self.exit.distance
        } else {
            self.distance[end]
        };
        for passed in &self.passed {
            let column = passed.column;
            self.v[column] += passed.distance - total;
            self.saturated[column] |= saturate;
        }
        self.close(saturate);
        self.swap_along_path(start, end);
    }

    /// Relaxes all open columns from `row`, and returns the nearest of them, free ones first among equals.
    fn visit(&mut self, row: usize, offset: f64) -> usize {
        ahead(self.columns);
        let exit = offset + self.miss(row).unwrap_or(0.0);
        if exit < self.exit.distance {
            self.exit = Exit { row, distance: exit };
        }
        let costs = self.row(row);
        let reached = Reached {
            distance: &mut self.distance,
            predecessor: &mut self.predecessor,
            least: &mut self.block_least,
            open: &self.block_open,
        };
        let row = Row {
            index: row,
            costs,
            duals: &self.open_v,
        };
        relax(self.arch, row, offset, reached);
        self.nearest()
    }

    fn nearest(&self) -> usize {
        let best = self.block_least.iter().copied().fold(INFINITY, lesser);
        let mut column = NONE;
        if best == INFINITY {
            return NONE;
        }
        let blocks = self.distance.chunks(BLOCK).zip(self.taken.chunks(BLOCK));
        for (block, (distance, taken)) in blocks.enumerate() {
            if self.block_least[block] != best {
                continue;
            }
            // Among many ties most blocks have no free column: this test vectorises, a search would not.
            let is_free = |(d, t): (&f64, &f64)| d + t == best;
            if distance.iter().zip(taken).fold(false, |any, pair| any | is_free(pair)) {
                let lane = distance.iter().zip(taken).position(is_free);
                return lane.map_or(NONE, |lane| block * BLOCK + lane);
            }
            if column == NONE {
                let lane = distance.iter().position(|&d| d == best);
                column = lane.map_or(NONE, |lane| block * BLOCK + lane);
            }
        }
        column
    }

    /// Opens the saturated columns to all rows visited so far, and returns the nearest.
    fn open_saturated(&mut self, start: usize) -> usize {
        for column in 0..self.columns {
            if self.saturated[column] {
                self.open_v[column] = self.v[column];
            }
        }
        let mut nearest = self.visit(start, 0.0);
        for index in 0..self.passed.len() {
            let Passed { row, offset, .. } = self.passed[index];
            nearest = self.visit(row, offset);
        }
        nearest
    }

    /// Restores `open_v` after a search.
    fn close(&mut self, everywhere: bool) {
        if everywhere {
            for column in 0..self.columns {
                let open = if self.saturated[column] {
                    -INFINITY
                } else {
                    self.v[column]
                };
                self.open_v[column] = open;
            }
        } else {
            for passed in &self.passed {
                self.open_v[passed.column] = self.v[passed.column];
            }
        }
    }

    /// Gives each row on the path to `end` its new column.
    fn swap_along_path(&mut self, start: usize, end: usize) {
        let mut column = end;
        if end == NONE {
            let row = self.exit.row;
            column = std::mem::replace(&mut self.row_column[row], NONE);
            if row == start {
                return;
            }
        }
        loop {
            let row = self.predecessor[column];
            self.column_row[column] = row;
            self.taken[column] = INFINITY;
            column = std::mem::replace(&mut self.row_column[row], column);
            if row == start {
                return;
            }
        }
    }

    /// Turns the dual pairs `(±1, x)` of saturated columns and their rows into numbers: the unit becomes the
    /// least one that keeps these columns' duals at most 0 and makes every row outside respect them.
    fn lift_saturated(&mut self, row_duals: &mut [f64]) {
        if self.miss_costs.is_some() || !self.saturated.contains(&true) {
            return;
        }
        let saturated_row = |row: usize| {
            let column = self.row_column[row];
            column == NONE || self.saturated[column]
        };
        let saturated_columns = (0..self.columns).filter(|&column| self.saturated[column]);
        let mut unit = saturated_columns
            .clone()
            .map(|column| self.v[column])
            .fold(0.0, f64::max);
        for row in (0..row_duals.len()).filter(|&row| !saturated_row(row)) {
            let costs = self.row(row);
            for column in saturated_columns.clone() {
                unit = unit.max(row_duals[row] + self.v[column] - costs[column]);
            }
        }
        for (row, dual) in row_duals.iter_mut().enumerate() {
            if saturated_row(row) {
                *dual += unit;
            }
        }
        for (v, _) in self
            .v
            .iter_mut()
            .zip(&self.saturated)
            .filter(|(_, saturated)| **saturated)
        {
            *v -= unit;
        }
    }
}
