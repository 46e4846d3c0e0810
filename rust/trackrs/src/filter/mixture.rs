//! A Gaussian mixture becomes the one Gaussian with its mean and covariance.
//!
//! | symbol   | name here    | shape  | meaning                                              |
//! |----------|--------------|--------|------------------------------------------------------|
//! | w_i      | `weight`     |        | probability of hypothesis i                          |
//! | x_i, P_i | `state`      | n, n×n | estimate under hypothesis i                          |
//! | e_i      |              | n      | x_i − x, in the space of the states                  |
//!
//! x = Σ w_i x_i / Σ w_i,  P = Σ w_i (P_i + e_i e_iᵀ) / Σ w_i.
//! States that do not add are averaged as differences from the likeliest: x = x_k ⊕ Σ w_i (x_i ⊖ x_k), once; the change of
//! axes between the x_i and x is neglected.
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §1.4.16.

use crate::gaussian::Gaussian;
use crate::linalg::symmetric::symmetrise;
use crate::model::space::StateSpace;

/// An estimate under one hypothesis.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// Its probability, not negative.
    pub weight: f64,
    /// The estimate.
    pub state: Gaussian,
}

/// The Gaussian with the mixture's moments; `None` where no weight is positive. A single hypothesis stays as it is, bit
/// for bit.
pub fn moment_match(space: &StateSpace, hypotheses: &[Hypothesis]) -> Option<Gaussian> {
    moments(space, hypotheses.iter().map(|h| (h.weight, &h.state)))
}

/// The same of weights and estimates, wherever they are.
pub(crate) fn moments<'a>(
    space: &StateSpace,
    hypotheses: impl Iterator<Item = (f64, &'a Gaussian)> + Clone,
) -> Option<Gaussian> {
    let hypotheses = hypotheses.filter(|(weight, _)| *weight > 0.0);
    let (_, likeliest) = hypotheses.clone().max_by(|a, b| a.0.total_cmp(&b.0))?;
    if hypotheses.clone().nth(1).is_none() {
        return Some(likeliest.clone());
    }
    let total: f64 = hypotheses.clone().map(|(weight, _)| weight).sum();
    let origin = &likeliest.mean;
    let mut e = space.difference(origin, origin);
    let mut shift = e.clone();
    for (weight, state) in hypotheses.clone() {
        space.difference_into(&state.mean, origin, &mut e);
        add(shift.as_mut_slice(), e.as_slice(), weight / total);
    }
    let mean = space.retract(origin, &shift);
    let mut cov = &likeliest.cov * 0.0;
    for (weight, state) in hypotheses {
        let share = weight / total;
        space.difference_into(&state.mean, &mean, &mut e);
        add(cov.as_mut_slice(), state.cov.as_slice(), share);
        cov.ger(share, &e, &e, 1.0);
    }
    symmetrise(&mut cov);
    Some(Gaussian { mean, cov })
}

fn add(sum: &mut [f64], term: &[f64], share: f64) {
    for (sum, x) in sum.iter_mut().zip(term) {
        *sum += x * share;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::{DMatrix, DVector};

    fn hypothesis(weight: f64, mean: [f64; 2], variance: f64) -> Hypothesis {
        Hypothesis {
            weight,
            state: Gaussian {
                mean: DVector::from_row_slice(&mean),
                cov: DMatrix::identity(2, 2) * variance,
            },
        }
    }

    #[test]
    fn moments_are_those_of_the_mixture() {
        let parts = vec![
            hypothesis(0.2, [0.0, 1.0], 1.0),
            hypothesis(0.5, [3.0, 1.0], 2.0),
            hypothesis(0.3, [-1.0, 2.0], 4.0),
        ];
        let found = moment_match(&StateSpace::euclidean(2), &parts).unwrap();
        let second: DMatrix<f64> = parts
            .iter()
            .map(|h| (&h.state.cov + &h.state.mean * h.state.mean.transpose()) * h.weight)
            .sum();
        assert_relative_eq!(found.mean, DVector::from_vec(vec![1.2, 1.3]), epsilon = 1e-15);
        assert_relative_eq!(
            found.cov,
            second - &found.mean * found.mean.transpose(),
            epsilon = 1e-14
        );
    }

    #[test]
    fn a_single_hypothesis_stays_and_none_is_none() {
        let space = StateSpace::euclidean(2);
        let only = hypothesis(0.3, [0.1, 0.2], 0.7);
        let found = moment_match(&space, &[hypothesis(0.0, [9.0, 9.0], 9.0), only.clone()]);
        assert_eq!(found, Some(only.state));
        assert_eq!(moment_match(&space, &[]), None);
    }
}
