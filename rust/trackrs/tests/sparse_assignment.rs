//! Sparse assignment against the dense one, which is tested against enumeration, and against the proof by duals.

use proptest::prelude::*;
use trackrs::association::assignment::sparse::{Candidate, assign_sparse, assign_sparse_with_misses};
use trackrs::association::assignment::{Assignment, assign, assign_with_misses};

#[derive(Debug, Clone)]
struct Problem {
    rows: usize,
    columns: usize,
    candidates: Vec<Candidate>,
    misses: Vec<f64>,
}

impl Problem {
    fn dense(&self) -> Vec<f64> {
        let mut costs = vec![f64::INFINITY; self.rows * self.columns];
        for pair in &self.candidates {
            let cost = &mut costs[pair.row * self.columns + pair.column];
            *cost = cost.min(pair.cost);
        }
        costs
    }

    fn check_duals(&self, found: &Assignment, misses: Option<&[f64]>) {
        for pair in &self.candidates {
            let slack = pair.cost - found.row_duals[pair.row] - found.column_duals[pair.column];
            assert!(slack >= -1e-9, "{pair:?}: slack {slack}");
        }
        let dual: f64 = found.row_duals.iter().chain(&found.column_duals).sum();
        if misses.is_some() || found.row_to_column.iter().all(Option::is_some) {
            assert!((dual - found.cost).abs() <= 1e-9, "{dual} is not {}", found.cost);
        }
    }
}

fn problems() -> impl Strategy<Value = Problem> {
    (1_usize..9, 1_usize..9).prop_flat_map(|(rows, columns)| {
        // Whole numbers make ties, the others none.
        let cost = prop_oneof![(-4_i32..5).prop_map(f64::from), -3.0..3.0];
        let pair = (0..rows, 0..columns, cost).prop_map(|(row, column, cost)| Candidate { row, column, cost });
        (
            proptest::collection::vec(pair, 0..24),
            proptest::collection::vec(-2.0..4.0, rows),
        )
            .prop_map(move |(candidates, misses)| Problem {
                rows,
                columns,
                candidates,
                misses,
            })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn as_many_pairs_at_the_same_cost_as_the_full_matrix(problem in problems()) {
        let dense = assign(&problem.dense(), problem.rows, problem.columns).unwrap();
        let sparse = assign_sparse(&problem.candidates, problem.rows, problem.columns).unwrap();
        let pairs = |found: &Assignment| found.row_to_column.iter().flatten().count();
        prop_assert_eq!(pairs(&sparse), pairs(&dense));
        prop_assert!((sparse.cost - dense.cost).abs() < 1e-9, "{} is not {}", sparse.cost, dense.cost);
        problem.check_duals(&sparse, None);
    }

    #[test]
    fn the_same_cost_with_misses(problem in problems()) {
        let (rows, columns) = (problem.rows, problem.columns);
        let dense = assign_with_misses(&problem.dense(), rows, columns, &problem.misses).unwrap();
        let sparse = assign_sparse_with_misses(&problem.candidates, rows, columns, &problem.misses).unwrap();
        prop_assert!((sparse.cost - dense.cost).abs() < 1e-9, "{} is not {}", sparse.cost, dense.cost);
        problem.check_duals(&sparse, Some(&problem.misses));
    }
}

/// The columns of a search's first row come in their order also where all of them are nearer than nothing.
#[test]
fn negative_costs_are_searched_from_the_least() {
    let pair = |(row, column, cost): (usize, usize, f64)| Candidate { row, column, cost };
    let listed = [
        (3, 2, -2.0),
        (3, 0, -1.0),
        (3, 3, -2.0),
        (0, 3, 0.0),
        (0, 2, -2.0),
        (1, 0, -1.0),
    ];
    let problem = Problem {
        rows: 5,
        columns: 4,
        candidates: listed.map(pair).to_vec(),
        misses: Vec::new(),
    };
    let found = assign_sparse(&problem.candidates, 5, 4).unwrap();
    assert_eq!(found.cost, -5.0);
    assert_eq!(found.row_to_column, [Some(2), Some(0), None, Some(3), None]);
    problem.check_duals(&found, None);
}

#[test]
fn pairs_outside_of_the_problem_are_refused() {
    let pair = |row, column, cost| Candidate { row, column, cost };
    assert!(assign_sparse(&[pair(2, 0, 1.0)], 2, 1).is_err());
    assert!(assign_sparse(&[pair(0, 1, 1.0)], 2, 1).is_err());
    assert!(assign_sparse(&[pair(0, 0, f64::NAN)], 2, 1).is_err());
    let found = assign_sparse(&[pair(0, 0, f64::INFINITY), pair(1, 0, 2.0)], 2, 1).unwrap();
    assert_eq!(found.row_to_column, [None, Some(0)]);
}
