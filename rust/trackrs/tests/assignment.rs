//! Assignment against enumeration of all of them, and against the optimality proof that the duals give.

use proptest::prelude::*;
use trackrs::association::assignment::{Assignment, assign, assign_with_misses};

const NO: f64 = f64::INFINITY;

/// A row-major cost matrix.
#[derive(Debug, Clone)]
struct Costs {
    values: Vec<f64>,
    rows: usize,
    columns: usize,
}

impl Costs {
    fn at(&self, row: usize, column: usize) -> f64 {
        self.values[row * self.columns + column]
    }

    fn solve(&self) -> Assignment {
        assign(&self.values, self.rows, self.columns).unwrap()
    }

    fn solve_with_misses(&self, misses: &[f64]) -> Assignment {
        assign_with_misses(&self.values, self.rows, self.columns, misses).unwrap()
    }

    /// Calls `report(pairs, cost of the pairs, rows left out)` for every partial assignment.
    fn enumerate(&self, report: &mut impl FnMut(usize, f64, &[usize])) {
        self.extend(0, &mut vec![false; self.columns], (0, 0.0), &mut Vec::new(), report);
    }

    fn extend(
        &self,
        row: usize,
        used: &mut [bool],
        (pairs, cost): (usize, f64),
        missed: &mut Vec<usize>,
        report: &mut impl FnMut(usize, f64, &[usize]),
    ) {
        if row == self.rows {
            report(pairs, cost, missed);
            return;
        }
        missed.push(row);
        self.extend(row + 1, used, (pairs, cost), missed, report);
        missed.pop();
        for column in 0..self.columns {
            if !used[column] && self.at(row, column) < NO {
                used[column] = true;
                let with = (pairs + 1, cost + self.at(row, column));
                self.extend(row + 1, used, with, missed, report);
                used[column] = false;
            }
        }
    }

    /// Checks that `found` is an assignment of allowed pairs with the cost it states, and counts the pairs.
    fn pairs_of(&self, found: &Assignment, misses: &[f64]) -> usize {
        let (mut used, mut cost, mut pairs) = (vec![false; self.columns], 0.0, 0);
        assert_eq!(found.row_to_column.len(), self.rows);
        for (row, column) in found.row_to_column.iter().enumerate() {
            match *column {
                None => cost += misses.get(row).copied().unwrap_or(0.0),
                Some(column) => {
                    assert!(
                        !std::mem::replace(&mut used[column], true),
                        "column {column} used twice"
                    );
                    cost += self.at(row, column);
                    pairs += 1;
                }
            }
        }
        assert!(
            (found.cost - cost).abs() <= 1e-12 * cost.abs(),
            "{} is not {cost}",
            found.cost
        );
        pairs
    }

    /// `C ≥ u + v`, equal on assigned pairs; duals of the longer side ≤ 0, and 0 where unassigned.
    fn check_duals(&self, found: &Assignment, tolerance: f64) {
        self.check_slacks(found, tolerance);
        if self.rows <= self.columns {
            check_column_signs(found, tolerance);
        } else {
            for (&dual, column) in found.row_duals.iter().zip(&found.row_to_column) {
                assert!(dual <= tolerance && (column.is_some() || dual >= -tolerance));
            }
        }
    }

    /// The same with misses, where the two sums must agree too.
    fn check_duals_with_misses(&self, found: &Assignment, misses: &[f64], tolerance: f64) {
        self.check_slacks(found, tolerance);
        check_column_signs(found, tolerance);
        for (row, column) in found.row_to_column.iter().enumerate() {
            let slack = misses[row] - found.row_duals[row];
            assert!(slack >= -tolerance && (column.is_some() || slack <= tolerance));
        }
        let dual: f64 = found.row_duals.iter().chain(&found.column_duals).sum();
        assert!((dual - found.cost).abs() <= tolerance * (self.rows + self.columns) as f64);
    }

    fn check_slacks(&self, found: &Assignment, tolerance: f64) {
        assert_eq!(
            (found.row_duals.len(), found.column_duals.len()),
            (self.rows, self.columns)
        );
        for row in 0..self.rows {
            for column in 0..self.columns {
                let slack = self.at(row, column) - found.row_duals[row] - found.column_duals[column];
                assert!(slack >= -tolerance, "pair ({row}, {column}): slack {slack}");
                let assigned = found.row_to_column[row] == Some(column);
                assert!(
                    !assigned || slack <= tolerance,
                    "assigned ({row}, {column}): slack {slack}"
                );
            }
        }
    }
}

fn check_column_signs(found: &Assignment, tolerance: f64) {
    for (column, &dual) in found.column_duals.iter().enumerate() {
        let assigned = found.row_to_column.contains(&Some(column));
        assert!(
            dual <= tolerance && (assigned || dual >= -tolerance),
            "column {column}: dual {dual}"
        );
    }
}

fn sized(
    rows: impl Strategy<Value = usize>,
    columns: impl Strategy<Value = usize>,
    cell: impl Strategy<Value = f64> + Clone,
) -> impl Strategy<Value = Costs> {
    (rows, columns).prop_flat_map(move |(rows, columns)| {
        let values = prop::collection::vec(cell.clone(), rows * columns);
        values.prop_map(move |values| Costs { values, rows, columns })
    })
}

fn integer(allowed: u32, forbidden: u32, range: i32) -> impl Strategy<Value = f64> + Clone {
    prop_oneof![allowed => (-range..=range).prop_map(f64::from), forbidden => Just(NO)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn largest_then_cheapest(
        costs in prop_oneof![
            sized(0usize..=5, 0usize..=5, integer(3, 2, 20)),
            sized(0usize..=5, 0usize..=5, integer(1, 2, 3)),
            sized(0usize..=5, 0usize..=5, integer(1, 0, 9)),
        ]
    ) {
        let mut best = (0, 0.0);
        costs.enumerate(&mut |pairs, cost, _| {
            if pairs > best.0 || (pairs == best.0 && cost < best.1) {
                best = (pairs, cost);
            }
        });
        let found = costs.solve();
        prop_assert_eq!((costs.pairs_of(&found, &[]), found.cost), best);
        costs.check_duals(&found, 0.0);
    }

    #[test]
    fn cheapest_with_misses(
        costs in sized(0usize..=5, 0usize..=5, integer(3, 2, 20)),
        misses in prop::collection::vec((-10..30).prop_map(f64::from), 5),
    ) {
        let misses = &misses[..costs.rows];
        let mut best = NO;
        costs.enumerate(&mut |_, cost, missed| {
            best = best.min(cost + missed.iter().map(|&row| misses[row]).sum::<f64>());
        });
        let found = costs.solve_with_misses(misses);
        costs.pairs_of(&found, misses);
        prop_assert_eq!(found.cost, best);
        costs.check_duals_with_misses(&found, misses, 0.0);
    }

    #[test]
    fn real_costs(costs in sized(1usize..=5, 1usize..=5, -1.0..1.0_f64)) {
        let most = costs.rows.min(costs.columns);
        let mut best = NO;
        costs.enumerate(&mut |pairs, cost, _| if pairs == most { best = best.min(cost) });
        let found = costs.solve();
        prop_assert_eq!(costs.pairs_of(&found, &[]), most);
        prop_assert!((found.cost - best).abs() < 1e-14);
        costs.check_duals(&found, 1e-14);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// Integers below 2^53 make a large penalty exact, so the second problem has the same solution.
    #[test]
    fn forbidden_pairs_equal_an_exact_penalty(
        costs in prop_oneof![
            sized(1usize..90, 1usize..200, integer(1, 30, 1000)),
            sized(1usize..90, 1usize..90, integer(1, 60, 5)),
        ]
    ) {
        const PENALTY: f64 = 1e7;
        let penalised = costs.values.iter().map(|c| c.min(PENALTY)).collect();
        let penalised = Costs { values: penalised, ..costs.clone() }.solve();
        let most = costs.rows.min(costs.columns);
        let found = costs.solve();
        let pairs = costs.pairs_of(&found, &[]);
        prop_assert_eq!(found.cost + PENALTY * (most - pairs) as f64, penalised.cost);
        costs.check_duals(&found, 0.0);
    }

    #[test]
    fn duals_prove_larger_assignments(
        costs in sized(1usize..120, 1usize..200, 0.0..1.0_f64),
        miss in 0.0..0.2_f64,
    ) {
        let found = costs.solve();
        prop_assert_eq!(costs.pairs_of(&found, &[]), costs.rows.min(costs.columns));
        costs.check_duals(&found, 1e-13);
        let misses = vec![miss; costs.rows];
        let found = costs.solve_with_misses(&misses);
        costs.pairs_of(&found, &misses);
        costs.check_duals_with_misses(&found, &misses, 1e-13);
    }
}
