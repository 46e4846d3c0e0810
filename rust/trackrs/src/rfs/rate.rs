//! How many measurements a target gives in a scan: Poisson, its mean known, or gamma distributed and learnt.
//!
//! | symbol   | name here     | meaning                                                             |
//! |----------|---------------|---------------------------------------------------------------------|
//! | γ        |               | mean number of measurements                                         |
//! | a, b     | `shape`, `inverse_scale` | γ ~ Gamma(a, b), mean a/b                                |
//! | η        | `forgetting`  | a/η, b/η from one scan to the next: the mean stays, the variance grows |
//! | γ_min    | `floor`       | least mean after a detection                                        |
//!
//! Known: γ = a/b;          ln p(n) = n ln γ − γ + …,  missed e^−γ.
//! Learnt: γ marginalised;  p(n) = Γ(a+n)/Γ(a) b^a / (b+1)^(a+n),  missed (b/(b+1))^a;
//!         detected: a + n, b + 1, then a ≥ γ_min b;  missed: kept.
//! Neither has 1/n!, because the measurements of a cell are told apart.
//!
//! Reference: extended-target spec 4 and 8.1; Granström, Orguner (2012), A PHD filter for tracking multiple extended
//! targets using random matrices, IEEE TSP 60(11) (gamma rates). A lower rate in the missed branch would breed ghosts.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_positive};

/// Gamma distribution of a rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// a.
    pub shape: f64,
    /// b.
    pub inverse_scale: f64,
}

impl Rate {
    /// The distribution with this mean and shape.
    pub fn with_mean(mean: f64, shape: f64) -> Self {
        Self {
            shape,
            inverse_scale: shape / mean,
        }
    }

    /// a/b.
    pub fn mean(self) -> f64 {
        self.shape / self.inverse_scale
    }

    /// The gamma distribution with the moments of a mixture of them; the weights need not add to one.
    pub(crate) fn merged(parts: &[(f64, Self)]) -> Option<Self> {
        if let [(_, only)] = parts {
            return Some(*only);
        }
        let total: f64 = parts.iter().map(|(weight, _)| weight).sum();
        let mean = parts.iter().map(|(weight, rate)| weight * rate.mean()).sum::<f64>() / total;
        let spread = |&(weight, rate): &(f64, Self)| {
            let off = rate.mean() - mean;
            weight * (rate.shape / (rate.inverse_scale * rate.inverse_scale) + off * off)
        };
        let variance = parts.iter().map(spread).sum::<f64>() / total;
        let shape = mean * mean / variance;
        (shape.is_finite() && shape > 0.0).then(|| Self::with_mean(mean, shape))
    }
}

/// How the rates of targets are treated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum RateModel {
    /// Every target keeps its mean.
    Known,
    /// They are learnt.
    Learnt {
        /// η, at least 1.
        forgetting: f64,
        /// γ_min.
        floor: f64,
    },
}

impl Default for RateModel {
    fn default() -> Self {
        Self::Learnt {
            forgetting: 1.05,
            floor: 3.0,
        }
    }
}

impl RateModel {
    pub(crate) fn check(self) -> Result<()> {
        let Self::Learnt { forgetting, floor } = self else {
            return Ok(());
        };
        require_positive("rate_floor", floor)?;
        if forgetting >= 1.0 && forgetting.is_finite() {
            return Ok(());
        }
        Err(Error::invalid("rate_forgetting", forgetting, "must be at least 1"))
    }

    /// One scan later.
    pub(crate) fn predicted(self, rate: Rate) -> Rate {
        match self {
            Self::Known => rate,
            Self::Learnt { forgetting, .. } => Rate {
                shape: rate.shape / forgetting,
                inverse_scale: rate.inverse_scale / forgetting,
            },
        }
    }

    /// After a detection with so many measurements, not necessarily a whole number.
    pub(crate) fn detected(self, rate: Rate, count: f64) -> Rate {
        match self {
            Self::Known => rate,
            Self::Learnt { floor, .. } => {
                let inverse_scale = rate.inverse_scale + 1.0;
                Rate {
                    shape: (rate.shape + count).max(floor * inverse_scale),
                    inverse_scale,
                }
            }
        }
    }

    /// Probability of no measurement at all.
    pub(crate) fn silent(self, rate: Rate) -> f64 {
        let Rate { shape, inverse_scale } = rate;
        match self {
            Self::Known => libm::exp(-rate.mean()),
            Self::Learnt { .. } => libm::exp(-shape * libm::log1p(1.0 / inverse_scale)),
        }
    }

    /// ln p(n) for n = 0 … `max`.
    pub(crate) fn log_counts(self, rate: Rate, max: usize) -> Vec<f64> {
        let Rate { shape, inverse_scale } = rate;
        let mut out = Vec::with_capacity(max + 1);
        match self {
            Self::Known => {
                let (mean, log) = (rate.mean(), libm::log(rate.mean()));
                out.extend((0..=max).map(|n| n as f64 * log - mean));
            }
            Self::Learnt { .. } => {
                let mut sum = -shape * libm::log1p(1.0 / inverse_scale);
                let log = libm::log(inverse_scale + 1.0);
                out.push(sum);
                for n in 0..max {
                    sum += libm::log(shape + n as f64) - log;
                    out.push(sum);
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn learnt_counts_are_the_marginal_of_poisson_and_gamma() {
        let (model, rate) = (
            RateModel::default(),
            Rate {
                shape: 7.5,
                inverse_scale: 0.6,
            },
        );
        let Rate {
            shape: a,
            inverse_scale: b,
        } = rate;
        for (n, &found) in model.log_counts(rate, 40).iter().enumerate() {
            let n = n as f64;
            let expected = libm::lgamma(a + n) - libm::lgamma(a) + a * b.ln() - (a + n) * (b + 1.0).ln();
            assert!((found - expected).abs() < 1e-12, "{n}: {found} {expected}");
        }
        assert!((model.silent(rate).ln() - model.log_counts(rate, 0)[0]).abs() < 1e-14);
        // Told apart or not, the probabilities of all counts add to one.
        let total: f64 = model
            .log_counts(rate, 400)
            .iter()
            .enumerate()
            .map(|(n, log)| libm::exp(log - libm::lgamma(n as f64 + 1.0)))
            .sum();
        assert!((total - 1.0).abs() < 1e-12, "{total}");
    }

    #[test]
    fn a_merged_rate_has_the_mixtures_moments() {
        let parts = [(0.2, Rate::with_mean(5.0, 4.0)), (0.6, Rate::with_mean(12.0, 9.0))];
        let merged = Rate::merged(&parts).unwrap();
        let mean = (0.2 * 5.0 + 0.6 * 12.0) / 0.8;
        let second = (0.2 * (25.0 / 4.0 + 25.0) + 0.6 * (144.0 / 9.0 + 144.0)) / 0.8;
        assert!((merged.mean() - mean).abs() < 1e-13);
        let variance = merged.shape / merged.inverse_scale.powi(2);
        assert!((variance - (second - mean * mean)).abs() < 1e-12);
    }

    #[test]
    fn detections_raise_the_rate_and_the_floor_holds_it() {
        let model = RateModel::default();
        let rate = model.detected(Rate::with_mean(10.0, 10.0), 20.0);
        assert_eq!((rate.shape, rate.inverse_scale), (30.0, 2.0));
        let starved = model.detected(
            Rate {
                shape: 1.0,
                inverse_scale: 4.0,
            },
            1.0,
        );
        assert_eq!(starved.mean(), 3.0);
        assert_eq!(RateModel::Known.detected(rate, 5.0), rate);
        assert!(
            RateModel::Learnt {
                forgetting: 0.9,
                floor: 3.0
            }
            .check()
            .is_err()
        );
    }
}
