//! The chi-square distribution against a 60-digit table, and its properties.

use proptest::prelude::*;
use serde_json::Value;
use trackrs::stats::chi_square::{cdf, quantile, survival, upper_quantile};

fn table(name: &str) -> Vec<Value> {
    let text = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/chi_square.json"));
    let file: Value = serde_json::from_str(text).unwrap();
    file[name].as_array().unwrap().clone()
}

fn dof(row: &Value) -> usize {
    usize::try_from(row["dof"].as_u64().unwrap()).unwrap()
}

#[track_caller]
fn assert_close(found: f64, row: &Value, field: &str) {
    let expected = row[field].as_f64().unwrap();
    let error = (found / expected - 1.0).abs();
    assert!(error < 1e-13, "{field} {found:e}, relative error {error:e}, {row}");
}

#[test]
fn tails_match_the_table() {
    for row in table("tails") {
        let x = row["x"].as_f64().unwrap();
        assert_close(cdf(x, dof(&row)), &row, "cdf");
        assert_close(survival(x, dof(&row)), &row, "survival");
    }
}

#[test]
fn quantiles_match_the_table() {
    for row in table("quantiles") {
        let p = row["probability"].as_f64().unwrap();
        assert_close(quantile(p, dof(&row)).unwrap(), &row, "x");
    }
    for row in table("upper_quantiles") {
        let alpha = row["alpha"].as_f64().unwrap();
        assert_close(upper_quantile(alpha, dof(&row)).unwrap(), &row, "x");
    }
}

/// The start of the iteration lies where the tail underflows.
#[test]
fn quantiles_at_the_edge_of_the_number_range() {
    for dof in (1..2000).step_by(7) {
        let found = survival(upper_quantile(1e-305, dof).unwrap(), dof);
        assert!((found / 1e-305 - 1.0).abs() < 1e-11, "dof {dof}: {found:e}");
    }
}

proptest! {
    #[test]
    fn quantile_inverts_the_distribution(exponent in -306.0..-0.31_f64, n in 2usize..3000) {
        let p = libm::pow(10.0, exponent);
        let x = upper_quantile(p, n).unwrap();
        let upper = survival(x, n);
        let lower = cdf(quantile(p, n).unwrap(), n);
        // What the rounding of x does: the upper tail falls by at most a half per unit of x, the lower grows as x^(n/2).
        let slack = 1e-14 * (1.0 + n as f64) + 2.0 * f64::EPSILON * x;
        prop_assert!((upper / p - 1.0).abs() < slack, "upper {upper:e} for {p:e}");
        prop_assert!((lower / p - 1.0).abs() < slack, "lower {lower:e} for {p:e}");
    }

    #[test]
    fn tails_are_monotone_and_sum_to_one(x in 0.0..5000.0_f64, step in 1e-3..100.0_f64, n in 1usize..5000) {
        prop_assert!(cdf(x + step, n) >= cdf(x, n));
        prop_assert!(survival(x + step, n) <= survival(x, n));
        prop_assert!((cdf(x, n) + survival(x, n) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn two_more_degrees_add_one_term(x in 0.01..300.0_f64, n in 1usize..300) {
        // Q(a + 1, t) = Q(a, t) + t^a e^-t / Γ(a + 1).
        let (a, t) = (0.5 * n as f64, 0.5 * x);
        let term = libm::exp(a * libm::log(t) - t - libm::lgamma(a + 1.0));
        let difference = survival(x, n + 2) - survival(x, n);
        prop_assert!((difference - term).abs() < 1e-12 * (term + survival(x, n + 2)) + 1e-15);
    }
}
