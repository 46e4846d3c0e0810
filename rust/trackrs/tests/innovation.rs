//! Statistics of innovations against golden values and their distributions.

use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::Value;
use trackrs::Gaussian;
use trackrs::filter::paper_start::paper_start;
use trackrs::filter::start::{TimedFix, start_state};
use trackrs::metric::innovation::nis;
use trackrs::metric::whiteness::whiteness;

fn normal(rng: &mut Pcg64) -> f64 {
    let (u, v): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn golden(name: &str) -> Value {
    let path = format!("{}/../../tests/data/{name}.json", env!("CARGO_MANIFEST_DIR"));
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn vector(value: &Value) -> DVector<f64> {
    let values = value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap());
    DVector::from_vec(values.collect())
}

fn matrix(value: &Value) -> DMatrix<f64> {
    let rows: Vec<_> = value
        .as_array()
        .unwrap()
        .iter()
        .map(|row| vector(row).transpose())
        .collect();
    DMatrix::from_rows(&rows)
}

#[test]
fn rank_deficient_covariance() {
    let golden = golden("chi2_rank_deficient");
    let tests = nis(&[vector(&golden["r"])], &[matrix(&golden["D"])]).unwrap();
    assert_relative_eq!(
        tests.statistics[0],
        golden["expected"].as_f64().unwrap(),
        max_relative = 1e-9
    );
    assert_eq!(tests.dof[0] as u64, golden["rank"].as_u64().unwrap());
    // Two degrees of freedom: exp(-T/2).
    assert_relative_eq!(tests.p_values[0], (-0.5 * 1.93_f64).exp(), max_relative = 1e-9);
}

#[test]
fn starting_values_of_three_fixes() {
    let golden = golden("underwater_bats_kf");
    let init = &golden["init"];
    let fixes: Vec<TimedFix> = (0..3)
        .map(|i| TimedFix {
            time: golden["time"][i].as_f64().unwrap(),
            position: Gaussian::new(vector(&init["fix"][i]), matrix(&init["fix_cov"][i])).unwrap(),
        })
        .collect();
    let right = start_state(&fixes, 3, None).unwrap();
    assert_relative_eq!(right.state.mean, vector(&init["x0"]), max_relative = 1e-9);
    assert_relative_eq!(
        right.state.cov,
        matrix(&init["D0"]),
        max_relative = 1e-9,
        epsilon = 1e-9
    );
    let paper = paper_start(&fixes, 2.0, 1.0).unwrap();
    assert_relative_eq!(paper.state.mean, vector(&init["x0_paper_literal"]), max_relative = 1e-9);
}

/// Under whiteness the mean of the statistic is its degrees of freedom, with and without gaps.
#[test]
fn portmanteau_has_the_expectation_of_its_degrees_of_freedom() {
    let mut rng = Pcg64::seed_from_u64(11);
    let (runs, length, m) = (300, 60, 2);
    for gaps in [0.0, 0.3] {
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..runs {
            let rows: Vec<DVector<f64>> = (0..length)
                .map(|_| {
                    DVector::from_fn(m, |_, _| {
                        let missing = normal(&mut rng).abs() < gaps;
                        let value = normal(&mut rng);
                        if missing { f64::NAN } else { value }
                    })
                })
                .collect();
            let out = whiteness(&rows, &vec![DMatrix::identity(m, m); length], 5).unwrap();
            assert_eq!(out.dof, 20);
            sum += out.statistic;
            squares += out.statistic * out.statistic;
        }
        let mean = sum / f64::from(runs);
        let error = ((squares / f64::from(runs) - mean * mean) / f64::from(runs)).sqrt();
        assert!((mean - 20.0).abs() < 3.5 * error, "{mean} +- {error}");
    }
}
