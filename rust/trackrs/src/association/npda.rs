//! Sequential probabilistic association (NPDA): one report at a time, shared out among the targets that may have sent it.
//!
//! | symbol (paper) | name here         | shape  | meaning                                                    |
//! |----------------|-------------------|--------|------------------------------------------------------------|
//! | P_c            | `clutter_probability` |    | probability that a gated report is of no target            |
//! | ln f_j         | `log_likelihoods` | M      | ln N(z; ẑ_j, S_j) of the gated targets                     |
//! | β_j            | `beta`            | M      | probability that the report is of target j                 |
//! | x⁻, P⁻         | `prior`           | n, n×n | prediction                                                 |
//! | x⁺, P⁺         | `updated`         | n, n×n | Kalman update as if the report surely were the target's: x⁻ + K₀ν, P⁻ − K₀ S K₀ᵀ |
//!
//! 1. β_j = (1 − P_c) f_j / Σ f (p12, N10), by log-sum-exp; det S_j stays in f_j (p11, N9), or with a spatial density
//!    β_j = f_j / (λ/a + Σ f) (N17, [`super::odds`]).
//! 2. x = x⁻ + β (x⁺ − x⁻) (p22, N11)
//! 3. P = (1 − c) P⁻ + c P⁺ (+ β(1 − β) (x⁺ − x⁻)(x⁺ − x⁻)ᵀ in the moment form) (N12) with
//!    c = β (moment: the mixture's own moments), β² (p24), 2β − β² (Joseph: covariance if the report surely were its own).
//!    c lies in [0, 1], so that P stays positive semidefinite.
//!
//! Reference: Liu, Xie, Huang, A new probabilistic data association filter based on probability theory, J. Electronics &
//! Information Technology 31(7), 2009; N9 to N14, N17.
//! Deviations: p19 prints S for S⁻¹ and p22 H for Hᵀ; the printed covariance is a choice, not the default; P_c = 0 and a
//! single gated target give β = 1.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::odds::shares;
use crate::error::{Error, Result};
use crate::gaussian::Gaussian;
use crate::linalg::symmetric::symmetrise;
use crate::model::space::StateSpace;

/// Which covariance a partial update leaves, N12.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum PartialCovariance {
    /// That of the mixture of update and prediction.
    #[default]
    Moment,
    /// P⁻ − β² K₀ S K₀ᵀ, as the paper prints it (p24).
    Paper,
    /// P⁻ − (2β − β²) K₀ S K₀ᵀ.
    Joseph,
}

/// Which targets are predicted to the time of a report, N13.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Bookkeeping {
    /// All, and so they are stored.
    #[default]
    Each,
    /// Stored are those that the report updates; the others are later predicted in one long step.
    Paper,
}

/// The sequential association.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Npda {
    /// P_c in [0, 1); by the sensor's clutter density where there is none.
    pub clutter_probability: Option<f64>,
    /// The covariance of a partial update.
    pub covariance: PartialCovariance,
    /// Who is predicted when.
    pub bookkeeping: Bookkeeping,
}

impl Default for Npda {
    fn default() -> Self {
        Self {
            clutter_probability: Some(0.0),
            covariance: PartialCovariance::default(),
            bookkeeping: Bookkeeping::default(),
        }
    }
}

impl Npda {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        match self.clutter_probability {
            Some(p) if !(0.0..1.0).contains(&p) => {
                let requirement = "must be at least 0 and below 1";
                Err(Error::invalid("clutter_probability", p, requirement))
            }
            _ => Ok(()),
        }
    }
}

/// Equation 1 with a constant clutter probability.
pub fn betas(log_likelihoods: &[f64], clutter_probability: f64) -> Vec<f64> {
    let betas = shares(log_likelihoods, f64::NEG_INFINITY).into_iter();
    betas.map(|beta| beta * (1.0 - clutter_probability)).collect()
}

/// Equations 2 and 3.
pub fn partial_update(
    space: &StateSpace,
    prior: &Gaussian,
    updated: &Gaussian,
    beta: f64,
    form: PartialCovariance,
) -> Gaussian {
    if beta >= 1.0 {
        return updated.clone();
    }
    let step: DVector<f64> = space.difference(&updated.mean, &prior.mean);
    let c = match form {
        PartialCovariance::Moment => beta,
        PartialCovariance::Paper => beta * beta,
        PartialCovariance::Joseph => beta * (2.0 - beta),
    };
    let mut cov = &prior.cov * (1.0 - c) + &updated.cov * c;
    if form == PartialCovariance::Moment {
        cov.ger(beta * (1.0 - beta), &step, &step, 1.0);
    }
    symmetrise(&mut cov);
    Gaussian {
        mean: space.retract(&prior.mean, &(step * beta)),
        cov,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::DMatrix;

    use crate::linalg::symmetric::eigen_range;

    fn pair() -> [Gaussian; 2] {
        // P⁺ = P⁻ − K S Kᵀ for H = (1 0), R = 1, ν = 3.
        let prior = Gaussian {
            mean: DVector::from_vec(vec![1.0, -2.0]),
            cov: DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 2.0]),
        };
        let gain = DVector::from_vec(vec![0.8, 0.2]);
        let updated = Gaussian {
            mean: &prior.mean + &gain * 3.0,
            cov: &prior.cov - &gain * gain.transpose() * 5.0,
        };
        [prior, updated]
    }

    #[test]
    fn shares_sum_to_what_is_not_clutter_and_do_not_underflow() {
        let betas = betas(&[-4000.0, -4001.0, -4700.0], 0.25);
        assert_relative_eq!(betas.iter().sum::<f64>(), 0.75, epsilon = 1e-15);
        assert_relative_eq!(betas[1] / betas[0], (-1.0_f64).exp(), max_relative = 1e-12);
        assert!(super::betas(&[], 0.25).is_empty());
        assert_eq!(super::betas(&[-9000.0], 0.0), [1.0]);
    }

    #[test]
    fn the_three_covariances_are_those_of_the_spec() {
        let [prior, updated] = pair();
        let gain = DVector::from_vec(vec![0.8, 0.2]);
        let (ksk, innovation) = (&gain * gain.transpose() * 5.0, 3.0);
        let space = StateSpace::euclidean(2);
        for beta in [0.0, 0.1, 0.5, 0.9, 1.0] {
            let spread = &gain * gain.transpose() * (beta * (1.0 - beta) * innovation * innovation);
            for (form, expected) in [
                (PartialCovariance::Moment, &prior.cov - &ksk * beta + spread),
                (PartialCovariance::Paper, &prior.cov - &ksk * (beta * beta)),
                (
                    PartialCovariance::Joseph,
                    &prior.cov - &ksk * (2.0 * beta - beta * beta),
                ),
            ] {
                let found = partial_update(&space, &prior, &updated, beta, form);
                assert_relative_eq!(found.cov, expected, epsilon = 1e-14);
                assert_relative_eq!(found.mean, &prior.mean + &gain * (beta * innovation), epsilon = 1e-14);
                assert!(eigen_range(&found.cov).unwrap().min > 0.0);
            }
        }
    }

    #[test]
    fn a_probability_of_one_is_refused() {
        for p in [1.0, -0.1, f64::NAN] {
            let npda = Npda {
                clutter_probability: Some(p),
                ..Npda::default()
            };
            assert!(npda.check().unwrap_err().to_string().contains("clutter_probability"));
        }
    }
}
