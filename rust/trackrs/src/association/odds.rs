//! What a sensor's detections are worth against its false reports, and how one report, or one track, is shared out.
//!
//! | symbol | name here   | meaning                                                                     |
//! |--------|-------------|-----------------------------------------------------------------------------|
//! | P_D    | `detection` | probability that the sensor reports a target                                |
//! | P_G    | `gate`      | probability that the report lies in the target's gate                       |
//! | λ      | `density`   | false reports per unit of the measurement space and look                    |
//! | a      |             | P_D / (1 − P_D P_G)                                                         |
//! | f_j    |             | likelihoods that exclude one another: of targets for one report, of reports for one target |
//!
//! β_j = f_j / (λ/a + Σ f) (N17 and, over the reports of one target, N18), by log-sum-exp.
//! λ = 0 is the limit: with clutter impossible, β_j = f_j / Σ f. So is P_D P_G = 1.
//!
//! Reference: N17, N18; Bar-Shalom, Li (1995), §3.4.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_non_negative};

/// ln of what stands for 0 in sums over joint events, where a logarithm must be finite: less than a report 400 sigma away.
const LOG_NOTHING: f64 = -1e5;

/// Detections and false reports of one sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Odds {
    /// P_D, above 0.
    pub detection: f64,
    /// P_G, above 0.
    pub gate: f64,
    /// λ.
    pub density: f64,
}

impl Odds {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        require_detection("detection_probability", self.detection)?;
        require_detection("probability", self.gate)?;
        require_non_negative("clutter_density", self.density)
    }

    /// P_D P_G.
    pub fn seen(&self) -> f64 {
        self.detection * self.gate
    }

    /// ln(λ/a): −∞ where nothing but a target can explain a report.
    pub fn log_clutter(&self) -> f64 {
        if self.density == 0.0 {
            return f64::NEG_INFINITY;
        }
        libm::log(self.density) + libm::log1p(-self.seen()) - libm::log(self.detection)
    }

    /// ln(1 − P_D P_G), finite.
    pub fn log_miss(&self) -> f64 {
        libm::log1p(-self.seen()).max(LOG_NOTHING)
    }

    /// ln(P_D / λ), finite.
    pub fn log_hit(&self) -> f64 {
        libm::log(self.detection) - libm::log(self.density).max(LOG_NOTHING)
    }
}

/// `Ok` if the value lies in (0, 1].
pub fn require_detection(name: &str, value: f64) -> Result<()> {
    if value > 0.0 && value <= 1.0 {
        return Ok(());
    }
    Err(Error::invalid(name, value, "must be above 0 and at most 1"))
}

/// The probability of each alternative when `e^log_rest` is the weight of none of them.
pub fn shares(log_weights: &[f64], log_rest: f64) -> Vec<f64> {
    let largest = log_weights.iter().copied().fold(log_rest, f64::max);
    if largest == f64::NEG_INFINITY {
        return vec![0.0; log_weights.len()];
    }
    let scaled: Vec<f64> = log_weights.iter().map(|&w| libm::exp(w - largest)).collect();
    let total = scaled.iter().sum::<f64>() + libm::exp(log_rest - largest);
    scaled.iter().map(|w| w / total).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_taken() {
        let odds = |detection, gate, density| Odds {
            detection,
            gate,
            density,
        };
        assert_eq!(shares(&[-2000.0], odds(0.9, 1.0, 0.0).log_clutter()), [1.0]);
        assert_eq!(
            shares(&[-2000.0, -2000.0], odds(1.0, 1.0, 1e-3).log_clutter()),
            [0.5, 0.5]
        );
        assert!(shares(&[], odds(0.9, 1.0, 1e-3).log_clutter()).is_empty());
        assert_eq!(shares(&[f64::NEG_INFINITY], f64::NEG_INFINITY), [0.0]);
        assert!(odds(1.0, 1.0, 0.0).log_miss().is_finite() && odds(1.0, 1.0, 0.0).log_hit().is_finite());
    }

    #[test]
    fn one_report_is_shared_as_the_textbook_has_it() {
        let odds = Odds {
            detection: 0.8,
            gate: 0.95,
            density: 0.02,
        };
        let f: [f64; 3] = [0.1, 0.03, 0.004];
        let a = 0.8 / (1.0 - 0.8 * 0.95);
        let total = 0.02 + a * f.iter().sum::<f64>();
        let found = shares(&f.map(f64::ln), odds.log_clutter());
        for (beta, f) in found.iter().zip(f) {
            approx::assert_relative_eq!(*beta, a * f / total, max_relative = 1e-14);
        }
    }
}
