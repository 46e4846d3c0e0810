//! One augmentation from a parent's solution to its child's, for [`k_best`](super).
//!
//! Row r and what it had, column c or its exit, are free again; every other row, and every column, keeps what it has.
//! "Out" stands for all exits of rows and all exits of columns, which change partners among themselves at no cost. Under
//! the parent's duals no step is shorter than 0:
//!
//! | from → to           | length              | meaning                                                    |
//! |---------------------|---------------------|------------------------------------------------------------|
//! | row i → column j    | C_ij − u_i − v_j | i takes j; the row that had j goes on, or else out goes on |
//! | row i → out         | μ_i − u_i         | i stays unassigned                                         |
//! | out → column j      | −v_j               | j stays unassigned; the row that had j goes on             |
//! | out → row i         | 0                   | i, unassigned so far, goes on                              |
//!
//! 1. Shortest path from row r to column c, or to out if r had none (Dijkstra); distances d, length D.
//! 2. u_i += (D − d_i)⁺ − (D − d_out)⁺, v_j −= (D − d_j)⁺ − (D − d_out)⁺ for the rows and columns that are not fixed.
//!    So the dual of out stays 0.
//! 3. The rows along the path take what the path says.

use std::cmp::Ordering;

use crate::interrupt::ahead;

const INFINITY: f64 = f64::INFINITY;
/// No column.
pub(crate) const NONE: usize = usize::MAX;

/// A set of assignments, and the best of them.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    pub(crate) cost: f64,
    /// Number of nodes made before this one.
    pub(super) born: usize,
    /// The column of each row in the best assignment, or [`NONE`].
    pub(crate) row_column: Vec<usize>,
    pub(crate) row_duals: Vec<f64>,
    pub(crate) column_duals: Vec<f64>,
    /// Rows before this are fixed.
    pub(crate) depth: usize,
    /// What row `depth` may not have; [`NONE`] forbids its exit.
    pub(crate) forbidden: Vec<usize>,
}

impl Ord for Node {
    /// The cheapest is the greatest, then the oldest.
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then(other.born.cmp(&self.born))
    }
}

impl PartialOrd for Node {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Node {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Node {}

/// The costs.
#[derive(Debug)]
pub(crate) struct Table<'a> {
    costs: &'a [f64],
    pub(crate) columns: usize,
    misses: Vec<f64>,
}

/// The state of one search. Index `columns` is out.
struct Search {
    distance: Vec<f64>,
    /// The row from which a column or out is reached; [`NONE`]: a column from out.
    from_row: Vec<usize>,
    /// The unassigned column by which out is reached, if any.
    out_by: usize,
    settled: Vec<bool>,
    row_distance: Vec<f64>,
}

impl<'a> Table<'a> {
    pub(super) fn new(costs: &'a [f64], columns: usize, misses: Vec<f64>) -> Self {
        Self { costs, columns, misses }
    }

    pub(crate) fn pair(&self, row: usize, column: usize) -> f64 {
        self.costs[row * self.columns + column]
    }

    pub(crate) fn miss(&self, row: usize) -> f64 {
        self.misses[row]
    }

    pub(super) fn cost(&self, row_column: &[usize]) -> f64 {
        let of_row = |(row, &column): (usize, &usize)| match column {
            NONE => self.misses[row],
            _ => self.pair(row, column),
        };
        row_column.iter().enumerate().map(of_row).sum()
    }

    /// The child of `parent` in which `row` may not have what it has there; `None` if it holds no assignment.
    pub(super) fn child(&self, parent: &Node, row: usize, born: usize) -> Option<Node> {
        let mut node = parent.clone();
        (node.depth, node.born) = (row, born);
        if row > parent.depth {
            node.forbidden.clear();
        }
        let lost = node.row_column[row];
        node.forbidden.push(lost);
        let out = self.columns;
        let target = if lost == NONE { out } else { lost };
        let mut column_row = vec![NONE; self.columns];
        for (row, &column) in node.row_column.iter().enumerate() {
            if column != NONE {
                column_row[column] = row;
            }
        }
        let mut search = Search {
            distance: vec![INFINITY; self.columns + 1],
            from_row: vec![NONE; self.columns + 1],
            out_by: NONE,
            settled: vec![false; self.columns + 1],
            row_distance: vec![INFINITY; node.row_column.len()],
        };
        for &fixed in &node.row_column[..row] {
            if fixed != NONE {
                search.settled[fixed] = true;
            }
        }
        let fixed = search.settled.clone();
        self.visit(&node, row, 0.0, &mut search);
        let nearest = loop {
            ahead(search.distance.len());
            let nearest = search.nearest()?;
            if nearest == target {
                break nearest;
            }
            search.settled[nearest] = true;
            let distance = search.distance[nearest];
            if nearest == out {
                self.pass_out(&node, (row, distance), &mut search);
            } else if column_row[nearest] == NONE {
                if distance < search.distance[out] && !search.settled[out] {
                    (search.distance[out], search.out_by) = (distance, nearest);
                }
            } else {
                self.visit(&node, column_row[nearest], distance, &mut search);
            }
        };
        let total = search.distance[nearest];
        let passed = |distance: f64| f64::max(total - distance, 0.0);
        let of_out = passed(search.distance[out]);
        for index in row..node.row_column.len() {
            node.row_duals[index] += passed(search.row_distance[index]) - of_out;
        }
        let columns = node.column_duals.iter_mut().zip(&search.distance).zip(&fixed);
        for ((dual, &distance), _) in columns.filter(|(_, fixed)| !**fixed) {
            *dual -= passed(distance) - of_out;
        }
        self.swap(&mut node, (row, target), &search);
        node.cost = self.cost(&node.row_column);
        Some(node)
    }

    /// Steps from a row at this distance.
    fn visit(&self, node: &Node, row: usize, offset: f64, search: &mut Search) {
        search.row_distance[row] = offset;
        let forbidden: &[usize] = if row == node.depth { &node.forbidden } else { &[] };
        let offset = offset - node.row_duals[row];
        let costs = &self.costs[row * self.columns..(row + 1) * self.columns];
        for (column, (cost, dual)) in costs.iter().zip(&node.column_duals).enumerate() {
            let distance = offset + (cost - dual);
            if distance < search.distance[column] && !search.settled[column] && !forbidden.contains(&column) {
                (search.distance[column], search.from_row[column]) = (distance, row);
            }
        }
        let distance = offset + self.misses[row];
        let out = self.columns;
        if distance < search.distance[out] && !search.settled[out] && !forbidden.contains(&NONE) {
            (search.distance[out], search.from_row[out], search.out_by) = (distance, row, NONE);
        }
    }

    /// Steps from out at this distance, in the search from `row`.
    fn pass_out(&self, node: &Node, (row, distance): (usize, f64), search: &mut Search) {
        for (column, dual) in node.column_duals.iter().enumerate() {
            if distance - dual < search.distance[column] && !search.settled[column] {
                (search.distance[column], search.from_row[column]) = (distance - dual, NONE);
            }
        }
        for other in row + 1..node.row_column.len() {
            if node.row_column[other] == NONE {
                self.visit(node, other, distance, search);
            }
        }
    }

    /// Back along the path from its end. Every step takes what the step before it has to leave.
    fn swap(&self, node: &mut Node, (start, target): (usize, usize), search: &Search) {
        let out = self.columns;
        let mut at = target;
        loop {
            let row = search.from_row[at];
            if at == out && search.out_by != NONE {
                at = search.out_by;
                continue;
            }
            if row == NONE {
                at = out;
                continue;
            }
            let taken = if at == out { NONE } else { at };
            let left = std::mem::replace(&mut node.row_column[row], taken);
            if row == start {
                return;
            }
            at = if left == NONE { out } else { left };
        }
    }
}

impl Search {
    fn nearest(&self) -> Option<usize> {
        let mut nearest = None;
        let mut least = INFINITY;
        for (index, (&distance, settled)) in self.distance.iter().zip(&self.settled).enumerate() {
            if distance < least && !settled {
                (nearest, least) = (Some(index), distance);
            }
        }
        nearest
    }
}
