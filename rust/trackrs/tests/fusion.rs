//! Several arrays: stacked, one after the other, and estimates fused by covariance intersection.

use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use trackrs::Gaussian;
use trackrs::error::Error;
use trackrs::filter::extended::linearise;
use trackrs::filter::fusion::{Criterion, covariance_intersection};
use trackrs::filter::kalman::MeasurementPrediction;
use trackrs::model::Sensor;
use trackrs::model::sensor::{PositionFix, RangeArray};

use crate::arrays::{bats, noisy, normal, toss};

const CRITERIA: [Criterion; 2] = [Criterion::Trace, Criterion::Determinant];

fn random_matrix(rows: usize, columns: usize, rng: &mut Pcg64) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| normal(rng))
}

fn random_estimate(n: usize, rng: &mut Pcg64) -> Gaussian {
    let root = random_matrix(n, n, rng);
    let cov = &root * root.transpose() + DMatrix::identity(n, n) * 0.05;
    Gaussian::new(random_matrix(n, 1, rng).column(0).into_owned(), cov).unwrap()
}

/// What is made small.
fn cost(cov: &DMatrix<f64>, criterion: Criterion) -> f64 {
    match criterion {
        Criterion::Trace => cov.trace(),
        Criterion::Determinant => cov.clone().symmetric_eigenvalues().map(f64::ln).sum(),
    }
}

/// P by the definition.
fn fused_cov(estimates: &[Gaussian], weights: &DVector<f64>) -> DMatrix<f64> {
    let n = estimates[0].dim();
    let mut sum = DMatrix::zeros(n, n);
    for (estimate, &w) in estimates.iter().zip(weights) {
        sum += estimate.cov.clone().try_inverse().unwrap() * w;
    }
    sum.try_inverse().unwrap()
}

fn prior() -> Gaussian {
    let mut rng = Pcg64::seed_from_u64(5);
    let root = random_matrix(9, 9, &mut rng);
    let mut mean = random_matrix(9, 1, &mut rng).column(0).into_owned();
    mean.rows_mut(0, 3).copy_from_slice(&[100.0, 200.0, 60.0]);
    Gaussian::new(mean, &root * root.transpose()).unwrap()
}

#[test]
fn stacked_fix_uses_all_ranges_and_the_depth() {
    let mut rng = Pcg64::seed_from_u64(1);
    let both = RangeArray::stack(&[bats(), toss()]).unwrap();
    assert_eq!((both.measurement_dim(), both.redundancy()), (10, 7));
    let state = DVector::from_vec(vec![300.0, -100.0, 80.0]);
    let z = noisy(&both, &state, &mut rng);
    let fix = both.fix(&z).unwrap();
    assert_eq!(fix.dof, 7);
    assert!((fix.position.mean - &state).norm() < 5.0);
    // Information adds up: ranges of both and one depth.
    let part = |used: &[usize]| {
        let keep = |(i, &v): (usize, &f64)| if used.contains(&i) { v } else { f64::NAN };
        let z = DVector::from_iterator(10, z.iter().enumerate().map(keep));
        both.fix_on(&z, Some(trackrs::model::sensor::Side::Above))
            .unwrap()
            .position
            .cov
    };
    let one = part(&[0, 1, 2, 9]);
    assert!((&one - &fix.position.cov).symmetric_eigenvalues().min() > 0.0);
}

#[test]
fn array_by_array_is_the_stacked_update_at_one_linearisation() {
    let mut rng = Pcg64::seed_from_u64(2);
    let both = RangeArray::stack(&[bats(), toss()]).unwrap();
    let prior = prior();
    let z = noisy(&both, &prior.mean, &mut rng) + DVector::from_fn(10, |_, _| 3.0 * normal(&mut rng));
    let linearised = linearise(&prior, &both, None).unwrap();
    let innovation = &z - &linearised.expected;
    let stacked = linearised.prediction.update(&prior, &innovation).unwrap();
    let jacobian = both.jacobian(&prior.mean, None).unwrap();
    let mut state = prior.clone();
    for channels in [0..3, 3..9, 9..10] {
        // The innovation against the state so far, on the same tangent.
        let tangent = &innovation - &jacobian * (&state.mean - &prior.mean);
        let seen = DVector::from_fn(10, |i, _| if channels.contains(&i) { tangent[i] } else { f64::NAN });
        let prediction = MeasurementPrediction::new(&state, &jacobian, &both.noise()).unwrap();
        state = prediction.update(&state, &seen).unwrap().posterior;
    }
    assert_relative_eq!(
        state.mean,
        stacked.posterior.mean,
        epsilon = 1e-12,
        max_relative = 1e-12
    );
    assert_relative_eq!(state.cov, stacked.posterior.cov, epsilon = 1e-12, max_relative = 1e-12);
}

#[test]
fn one_that_dominates_is_the_answer() {
    let mut rng = Pcg64::seed_from_u64(3);
    for criterion in CRITERIA {
        for n in [1, 4, 9] {
            let best = random_estimate(n, &mut rng);
            let worse =
                |factor: f64, rng: &mut Pcg64| Gaussian::new(random_estimate(n, rng).mean, &best.cov * factor).unwrap();
            let all = [worse(1.5, &mut rng), best.clone(), worse(4.0, &mut rng)];
            let out = covariance_intersection(&all, None, criterion).unwrap();
            assert_eq!(out.state, best);
            assert_eq!(out.weights.as_slice(), [0.0, 1.0, 0.0]);
        }
    }
    let one = random_estimate(3, &mut rng);
    let alone = covariance_intersection(std::slice::from_ref(&one), None, Criterion::Trace).unwrap();
    assert_eq!(alone.state, one);
}

#[test]
fn equals_share_equally() {
    let mut rng = Pcg64::seed_from_u64(4);
    let a = random_estimate(4, &mut rng);
    let b = Gaussian::new(-&a.mean, a.cov.clone()).unwrap();
    let out = covariance_intersection(&[a.clone(), b], None, Criterion::Trace).unwrap();
    assert_eq!(out.weights.as_slice(), [0.5, 0.5]);
    assert_relative_eq!(out.state.mean, DVector::zeros(4), epsilon = 1e-12);
    assert_relative_eq!(out.state.cov, a.cov, max_relative = 1e-10);
}

/// Crossed ellipses: by symmetry the weight is a half, P = 2 (Y_1 + Y_2)⁻¹.
#[test]
fn crossed_ellipses() {
    let cov = |a: f64, b: f64| DMatrix::from_diagonal(&DVector::from_row_slice(&[a, b]));
    let all = [(1.0, 9.0), (9.0, 1.0)].map(|(a, b)| Gaussian::new(DVector::from_element(2, a), cov(a, b)).unwrap());
    for criterion in CRITERIA {
        let out = covariance_intersection(&all, None, criterion).unwrap();
        assert_relative_eq!(out.weights[0], 0.5, epsilon = 1e-12);
        assert_relative_eq!(out.state.cov, cov(1.8, 1.8), max_relative = 1e-12);
        // (1/1 + 9/9)/(1 + 1/9) and (1/9 + 9/1)/(1/9 + 1)
        let mean = DVector::from_row_slice(&[1.8, 8.2]);
        assert_relative_eq!(out.state.mean, mean, max_relative = 1e-12);
    }
}

#[test]
fn faults_are_named() {
    let good = Gaussian::new(DVector::zeros(2), DMatrix::identity(2, 2)).unwrap();
    let flat = Gaussian::new(DVector::zeros(2), DMatrix::zeros(2, 2)).unwrap();
    let small = Gaussian::new(DVector::zeros(1), DMatrix::identity(1, 1)).unwrap();
    let fuse = |second: &Gaussian, weights: Option<&[f64]>| {
        let weights = weights.map(DVector::from_row_slice);
        covariance_intersection(&[good.clone(), second.clone()], weights.as_ref(), Criterion::Trace).unwrap_err()
    };
    assert!(matches!(fuse(&flat, None), Error::NotPositiveDefinite { what, .. } if what == "covariance of state 1"));
    assert_eq!(fuse(&small, None), Error::dimension("state 1", 2, 1));
    for weights in [&[0.5, 0.6][..], &[1.5, -0.5], &[1.0], &[f64::NAN, 1.0]] {
        assert!(fuse(&good, Some(weights)).to_string().contains("weights"));
    }
    assert!(covariance_intersection(&[], None, Criterion::Trace).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Kuhn-Tucker by probing: no move of weight from one estimate to another makes the cost smaller.
    #[test]
    fn weights_are_a_minimum_and_sum_to_one(seed in 0_u64..100_000, n in 1_usize..10, count in 2_usize..7) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let all: Vec<Gaussian> = (0..count).map(|_| random_estimate(n, &mut rng)).collect();
        for criterion in CRITERIA {
            let out = covariance_intersection(&all, None, criterion).unwrap();
            prop_assert!((out.weights.sum() - 1.0).abs() < 1e-12);
            prop_assert!(out.weights.min() >= 0.0);
            let least = cost(&out.state.cov, criterion);
            prop_assert!((least - cost(&fused_cov(&all, &out.weights), criterion)).abs() < 1e-9 * (1.0 + least.abs()));
            for from in 0..count {
                for to in 0..count {
                    let step = out.weights[from].min(1e-3);
                    let mut moved = out.weights.clone();
                    moved[from] -= step;
                    moved[to] += step;
                    prop_assert!(cost(&fused_cov(&all, &moved), criterion) >= least - 1e-10 * (1.0 + least.abs()));
                }
            }
        }
    }

    #[test]
    fn order_does_not_matter(seed in 0_u64..100_000, count in 2_usize..7) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let all: Vec<Gaussian> = (0..count).map(|_| random_estimate(4, &mut rng)).collect();
        let turned: Vec<Gaussian> = all.iter().rev().cloned().collect();
        for criterion in CRITERIA {
            let (a, b) = (
                covariance_intersection(&all, None, criterion).unwrap(),
                covariance_intersection(&turned, None, criterion).unwrap(),
            );
            prop_assert!((&a.state.mean - &b.state.mean).amax() < 1e-7);
            prop_assert!((&a.state.cov - &b.state.cov).amax() < 1e-9 * a.state.cov.amax());
        }
    }

    /// P is at least the covariance of the error for every correlation that two estimates can have.
    #[test]
    fn consistent_for_every_correlation(seed in 0_u64..100_000, n in 1_usize..7, full in any::<bool>()) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let all = [random_estimate(n, &mut rng), random_estimate(n, &mut rng)];
        let out = covariance_intersection(&all, None, Criterion::Trace).unwrap();
        // C = L_1 U L_2ᵀ with |U| ≤ 1 makes [[P_1, C], [Cᵀ, P_2]] a covariance, and every one is of this form.
        let svd = random_matrix(n, n, &mut rng).svd(true, true);
        let spectrum = svd.singular_values.map(|s| if full { 1.0 } else { s / (1.0 + s) });
        let turn = svd.u.unwrap() * DMatrix::from_diagonal(&spectrum) * svd.v_t.unwrap();
        let lower = |g: &Gaussian| g.cov.clone().cholesky().unwrap().l();
        let cross = lower(&all[0]) * turn * lower(&all[1]).transpose();
        let gain = |i: usize| &out.state.cov * all[i].cov.clone().try_inverse().unwrap() * out.weights[i];
        let (a, b) = (gain(0), gain(1));
        let mixed = &a * &cross * b.transpose();
        let error = &a * &all[0].cov * a.transpose() + &b * &all[1].cov * b.transpose() + &mixed + mixed.transpose();
        let margin = (&out.state.cov - error).symmetric_eigenvalues().min();
        prop_assert!(margin > -1e-9 * out.state.cov.amax(), "{}", margin);
    }
}
