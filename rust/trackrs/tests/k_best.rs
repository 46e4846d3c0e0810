//! The k best assignments against the sorted list of all of them.

use trackrs::association::k_best::{Ranked, k_best, k_best_with_misses};
use trackrs::stats::stream::Stream;

const NO: f64 = f64::INFINITY;

/// Every assignment with its cost, the misses priced or not.
fn all(costs: &[f64], rows: usize, columns: usize, misses: Option<&[f64]>) -> Vec<(Vec<Option<usize>>, f64)> {
    let mut found = vec![(Vec::new(), 0.0)];
    for row in 0..rows {
        let mut longer = Vec::new();
        for (assignment, cost) in &found {
            let mut add = |column: Option<usize>, price: f64| {
                let mut assignment: Vec<Option<usize>> = assignment.clone();
                assignment.push(column);
                longer.push((assignment, cost + price));
            };
            add(None, misses.map_or(0.0, |m| m[row]));
            for column in 0..columns {
                let price = costs[row * columns + column];
                if price < NO && !assignment.contains(&Some(column)) {
                    add(Some(column), price);
                }
            }
        }
        found = longer;
    }
    if misses.is_none() {
        let pairs = |assignment: &[Option<usize>]| assignment.iter().flatten().count();
        let most = found.iter().map(|(a, _)| pairs(a)).max().unwrap_or(0);
        found.retain(|(a, _)| pairs(a) == most);
    }
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    found
}

fn check(found: &[Ranked], expected: &[(Vec<Option<usize>>, f64)], k: usize) {
    assert_eq!(found.len(), expected.len().min(k));
    for (ranked, (_, cost)) in found.iter().zip(expected) {
        assert!(
            (ranked.cost - cost).abs() <= 1e-12 * cost.abs().max(1.0),
            "{} {cost}",
            ranked.cost
        );
        let truth = expected.iter().find(|(a, _)| *a == ranked.row_to_column);
        assert!((truth.unwrap().1 - ranked.cost).abs() <= 1e-12 * cost.abs().max(1.0));
    }
    for (index, ranked) in found.iter().enumerate() {
        assert!(
            found[..index]
                .iter()
                .all(|before| before.row_to_column != ranked.row_to_column)
        );
        assert!(index == 0 || found[index - 1].cost <= ranked.cost);
    }
}

#[test]
fn order_is_that_of_the_enumeration() {
    for run in 0..20_000 {
        let mut stream = Stream::new(1, run);
        let sizes = [0, 1, 2, 3, 4];
        let (rows, columns) = (*stream.choice(&sizes).unwrap(), *stream.choice(&sizes).unwrap());
        let allowed = *stream.choice(&[0.4, 0.8, 1.0]).unwrap();
        let whole = run % 2 == 0; // ties
        let mut draw = || {
            let x = stream.between(-10.0, 10.0);
            if whole { x.round() } else { x }
        };
        let misses: Vec<f64> = (0..rows).map(|_| draw()).collect();
        let mut costs: Vec<f64> = (0..rows * columns).map(|_| draw()).collect();
        for cost in &mut costs {
            if stream.uniform() > allowed {
                *cost = NO;
            }
        }
        let k = *stream.choice(&[0, 1, 3, 10, 1000]).unwrap();
        let found = k_best_with_misses(&costs, rows, columns, &misses, k).unwrap();
        check(&found, &all(&costs, rows, columns, Some(&misses)), k);
        let found = k_best(&costs, rows, columns, k).unwrap();
        check(&found, &all(&costs, rows, columns, None), k);
    }
}

#[test]
fn the_same_numbers_give_the_same_order() {
    let costs = [1.0; 16];
    let found = k_best(&costs, 4, 4, 30).unwrap();
    assert_eq!(found.len(), 24);
    assert_eq!(found, k_best(&costs, 4, 4, 24).unwrap());
}

#[test]
fn errors_are_those_of_assign() {
    assert!(k_best(&[f64::NAN], 1, 1, 3).is_err());
    assert!(k_best_with_misses(&[1.0], 1, 1, &[NO], 3).is_err());
    assert!(k_best_with_misses(&[1.0], 1, 1, &[1.0, 2.0], 3).is_err());
}
