//! Assignment where few pairs are allowed: rows as lists, shortest augmenting paths over a heap.
//!
//! | symbol | name here | shape | meaning |
//! |--------|-----------|-------|---------|
//! | C      | [`Candidate`] | list | allowed pairs and their costs; all others are forbidden |
//! | u, v   | `row_duals`, `v` | rows, columns | `C[r,c] ≥ u[r] + v[c]`, equal on assigned pairs |
//! | d      | `distance` | columns | length of the shortest alternating path from the start row |
//! | o      | `offset`  | scalar | `d` of a row minus its dual `u` |
//!
//! Equations (1) to (3) are those of [`assignment`](super), over lists instead of whole rows:
//!
//! 1. Row reduction: bids of the rows for their cheapest columns.
//! 2. A search from each row still free. Columns wait in a heap, those at the present distance on a stack; free columns
//!    and exits never wait: the nearest of them so far bounds the search.
//! 3. `v[c] += d[c] − D` for the columns passed; the pairs along the path are swapped.
//!
//! Without miss costs first as if every row found a column. If one does not, again in prices of two components, `(1, 0)`
//! for an exit and `(0, C)` for a pair, compared in this order: most pairs first, then least cost.
//!
//! Reference: R. Jonker, A. Volgenant, *A shortest augmenting path algorithm for dense and sparse linear assignment
//! problems*, Computing 38, 1987. The stack is their list of columns at the minimum.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::lists::Lists;
use super::price::{Graded, Price};
use super::{Assignment, NONE, check_magnitude};
use crate::error::{Error, Result, require_finite, require_size};
use crate::interrupt::ahead;

/// Row reduction looks at this many rows per row of the problem; lists are cheap to look at, searches are not.
const REDUCTIONS_PER_ROW: usize = 16;

/// A pair that is allowed, and what it costs; `+inf` forbids it again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Its row.
    pub row: usize,
    /// Its column.
    pub column: usize,
    /// Its cost.
    pub cost: f64,
}

/// As [`assign`](super::assign), with the allowed pairs as a list; of a pair that is there twice the cheaper counts.
pub fn assign_sparse(candidates: &[Candidate], rows: usize, columns: usize) -> Result<Assignment> {
    check(candidates, rows, columns)?;
    // One search per element of the smaller side.
    let turned = rows > columns;
    let lists = Lists::new(candidates, rows, columns, turned);
    let mut found = match Solver::<f64>::new(&lists, None).solve() {
        Some(found) => found,
        None => Solver::<Graded>::new(&lists, None).solve().ok_or_else(stranded)?,
    };
    if turned {
        let mut row_to_column = vec![None; rows];
        for (column, row) in found.row_to_column.iter().enumerate() {
            if let Some(row) = *row {
                row_to_column[row] = Some(column);
            }
        }
        found.row_to_column = row_to_column;
        std::mem::swap(&mut found.row_duals, &mut found.column_duals);
    }
    Ok(found)
}

/// As [`assign_with_misses`](super::assign_with_misses), with the allowed pairs as a list.
pub fn assign_sparse_with_misses(
    candidates: &[Candidate],
    rows: usize,
    columns: usize,
    miss_costs: &[f64],
) -> Result<Assignment> {
    check(candidates, rows, columns)?;
    require_size("miss costs", rows, miss_costs.len())?;
    require_finite("miss cost", miss_costs)?;
    check_magnitude("miss cost", miss_costs.iter().copied())?;
    let lists = Lists::new(candidates, rows, columns, false);
    Solver::<f64>::new(&lists, Some(miss_costs))
        .solve()
        .ok_or_else(stranded)
}

/// No row is: where there are exits each has its own.
fn stranded() -> Error {
    Error::invalid("assignment", "a row", "must find a column or its exit")
}

fn check(candidates: &[Candidate], rows: usize, columns: usize) -> Result<()> {
    for (index, pair) in candidates.iter().enumerate() {
        if pair.row >= rows || pair.column >= columns {
            return Err(Error::invalid(
                "assignment pair",
                format_args!("({}, {})", pair.row, pair.column),
                &format!("must lie within {rows} rows and {columns} columns"),
            ));
        }
        if pair.cost.is_nan() || pair.cost == f64::NEG_INFINITY {
            return Err(Error::NonFinite {
                what: "assignment cost".into(),
                index,
            });
        }
    }
    check_magnitude("assignment cost", candidates.iter().map(|pair| pair.cost))
}

/// A column on its way through the heap; the nearest comes out first.
struct Waiting<P> {
    distance: P,
    column: usize,
}

impl<P: Price> Ord for Waiting<P> {
    fn cmp(&self, other: &Self) -> Ordering {
        let nearest = other.distance.partial_cmp(&self.distance).unwrap_or(Ordering::Equal);
        nearest.then(other.column.cmp(&self.column))
    }
}

impl<P: Price> PartialOrd for Waiting<P> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<P: Price> PartialEq for Waiting<P> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl<P: Price> Eq for Waiting<P> {}

/// The pair that a row has made.
#[derive(Clone, Copy)]
struct Made {
    column: usize,
    cost: f64,
}

const UNMADE: Made = Made {
    column: NONE,
    cost: 0.0,
};

/// What is known of a column.
#[derive(Clone, Copy)]
struct Column<P> {
    v: P,
    row: usize,
    /// `INFINITY` where a search has not come, `PASSED` where it is done.
    distance: P,
    /// The row that the path comes from, and the cost of that pair.
    from: usize,
    cost: f64,
}

struct Solver<'a, P> {
    lists: &'a Lists,
    miss_costs: Option<&'a [f64]>,
    rows: Vec<Made>,
    columns: Vec<Column<P>>,
    heap: BinaryHeap<Waiting<P>>,
    ready: Vec<usize>,
    touched: Vec<usize>,
    passed: Vec<(usize, P)>,
}

impl<'a, P: Price> Solver<'a, P> {
    fn new(lists: &'a Lists, miss_costs: Option<&'a [f64]>) -> Self {
        let column = Column {
            v: P::ZERO,
            row: NONE,
            distance: P::INFINITY,
            from: NONE,
            cost: 0.0,
        };
        Self {
            lists,
            miss_costs,
            rows: vec![UNMADE; lists.rows()],
            columns: vec![column; lists.columns],
            heap: BinaryHeap::new(),
            ready: Vec::new(),
            touched: Vec::new(),
            passed: Vec::new(),
        }
    }

    /// The price of leaving a row alone; none where it must not be.
    #[inline]
    fn exit(&self, row: usize) -> Option<P> {
        self.miss_costs.map_or(P::EXIT, |costs| Some(P::of(costs[row])))
    }

    /// `None` where a row that must not stay alone has found no column.
    fn solve(mut self) -> Option<Assignment> {
        for row in self.reduce_rows()? {
            self.augment(row)?;
        }
        Some(self.finish())
    }

    /// Equation 1. Returns the rows that remain to be searched from.
    fn reduce_rows(&mut self) -> Option<Vec<usize>> {
        let count = self.rows.len();
        let mut waiting: Vec<usize> = (0..count).rev().collect();
        let mut left = Vec::new();
        let mut budget = REDUCTIONS_PER_ROW * count;
        while let Some(row) = waiting.pop() {
            ahead(self.lists.row(row).len());
            let (mut first, mut second, mut best) = (P::INFINITY, P::INFINITY, UNMADE);
            for entry in self.lists.row(row) {
                let reduced = P::of(entry.cost) - self.columns[entry.column].v;
                if reduced < first {
                    second = first;
                    first = reduced;
                    best = Made {
                        column: entry.column,
                        cost: entry.cost,
                    };
                } else if reduced < second && entry.column != best.column {
                    second = reduced;
                }
            }
            match self.exit(row) {
                Some(exit) if first > exit => continue, // the exit is the cheapest and free: settled
                Some(exit) if exit < second => second = exit,
                None if best.column == NONE => return None,
                _ => {}
            }
            if best.column == NONE {
                continue;
            }
            let column = &mut self.columns[best.column];
            let gains = second > first && second < P::INFINITY;
            // A column is taken from another row only for a gain: else two rows could swap for ever.
            if budget == 0 || (column.row != NONE && !gains) {
                left.push(row);
                continue;
            }
            budget -= 1;
            if gains {
                column.v = column.v - (second - first);
            }
            let rival = std::mem::replace(&mut column.row, row);
            self.rows[row] = best;
            if rival != NONE {
                self.rows[rival] = UNMADE;
                waiting.push(rival);
            }
        }
        Some(left)
    }

    /// Equations 2 and 3: one search from a free row.
    fn augment(&mut self, start: usize) -> Option<()> {
        // Nothing has been passed: the nearest column of the first row comes out of the heap, at whatever distance.
        let (mut row, mut at, mut offset) = (start, P::PASSED, P::ZERO);
        // Where the path ends: at a free column, or by the exit of a row.
        let (mut total, mut end, mut leaving) = (P::INFINITY, NONE, NONE);
        loop {
            ahead(self.lists.row(row).len());
            if let Some(exit) = self.exit(row)
                && offset + exit < total
            {
                (total, end, leaving) = (offset + exit, NONE, row);
            }
            for entry in self.lists.row(row) {
                let column = &mut self.columns[entry.column];
                let through = offset + (P::of(entry.cost) - column.v);
                if !(through < column.distance && through < total) {
                    continue;
                }
                if column.distance == P::INFINITY {
                    self.touched.push(entry.column);
                }
                column.distance = through;
                column.from = row;
                column.cost = entry.cost;
                if column.row == NONE {
                    (total, end, leaving) = (through, entry.column, NONE);
                } else if through <= at {
                    self.ready.push(entry.column);
                } else {
                    self.heap.push(Waiting {
                        distance: through,
                        column: entry.column,
                    });
                }
            }
            let Some(next) = self.next(total) else { break };
            let column = &mut self.columns[next];
            at = column.distance;
            column.distance = P::PASSED;
            self.passed.push((next, at));
            row = column.row;
            offset = at - (P::of(self.rows[row].cost) - column.v);
        }
        for &(column, distance) in &self.passed {
            let v = &mut self.columns[column].v;
            *v = *v + (distance - total);
        }
        for &column in &self.touched {
            self.columns[column].distance = P::INFINITY;
        }
        self.touched.clear();
        self.passed.clear();
        self.heap.clear();
        self.ready.clear();
        (total < P::INFINITY).then(|| self.swap_along_path(start, end, leaving))
    }

    /// The nearest column that waits, if it is nearer than `total`.
    #[inline]
    fn next(&mut self, total: P) -> Option<usize> {
        while let Some(column) = self.ready.pop() {
            if self.columns[column].distance != P::PASSED {
                return Some(column);
            }
        }
        while let Some(Waiting { distance, column }) = self.heap.pop() {
            if distance >= total {
                return None;
            }
            // Else it has been reached by a shorter way since.
            if self.columns[column].distance == distance {
                return Some(column);
            }
        }
        None
    }

    /// Gives each row on the path its new column.
    fn swap_along_path(&mut self, start: usize, end: usize, leaving: usize) {
        let mut column = end;
        if end == NONE {
            column = std::mem::replace(&mut self.rows[leaving], UNMADE).column;
            if leaving == start {
                return;
            }
        }
        loop {
            let Column { from, cost, .. } = self.columns[column];
            self.columns[column].row = from;
            column = std::mem::replace(&mut self.rows[from], Made { column, cost }).column;
            if from == start {
                return;
            }
        }
    }

    fn finish(self) -> Assignment {
        let dual = |(row, made): (usize, &Made)| match made.column {
            NONE => self.exit(row).unwrap_or(P::ZERO),
            column => P::of(made.cost) - self.columns[column].v,
        };
        let row_duals: Vec<P> = self.rows.iter().enumerate().map(dual).collect();
        let unit = self.unit(&row_duals);
        let mut cost = 0.0;
        for (row, made) in self.rows.iter().enumerate() {
            cost += match made.column {
                NONE => self.miss_costs.map_or(0.0, |costs| costs[row]),
                _ => made.cost,
            };
        }
        Assignment {
            row_to_column: self
                .rows
                .iter()
                .map(|made| (made.column != NONE).then_some(made.column))
                .collect(),
            cost,
            row_duals: row_duals.iter().map(|dual| dual.with_unit(unit)).collect(),
            column_duals: self.columns.iter().map(|column| column.v.with_unit(unit)).collect(),
        }
    }

    /// What the first component of a price is worth: the least that keeps the duals of columns at most 0 and all
    /// reduced costs at least 0.
    fn unit(&self, row_duals: &[P]) -> f64 {
        let signs = self.columns.iter().map(|column| (P::ZERO - column.v).least_unit());
        let slack = |(row, dual): (usize, &P)| {
            let costs = self.lists.row(row).iter().filter(|entry| entry.cost < f64::INFINITY);
            let slacks = costs.map(|entry| (P::of(entry.cost) - *dual - self.columns[entry.column].v).least_unit());
            slacks.fold(0.0, f64::max)
        };
        row_duals.iter().enumerate().map(slack).chain(signs).fold(0.0, f64::max)
    }
}
