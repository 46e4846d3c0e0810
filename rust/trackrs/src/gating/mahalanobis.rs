//! Ellipsoidal gates with sparse output.
//!
//! | symbol | name here     | meaning                                                     |
//! |--------|---------------|-------------------------------------------------------------|
//! | ẑ_i, S_i | `Linearised` | what track i expects of the sensor                          |
//! | d²     | `nis`         | (z_j − ẑ_i)ᵀ S_i⁻¹ (z_j − ẑ_i), angles wrapped               |
//! | γ      | `threshold`   | chi-square quantile of the gate probability for the observed components |
//!
//! A pair is kept if d² ≤ γ. First a box test: |z_j − ẑ_i|_c ≤ √(γ S_i,cc) holds for every component c of
//! every point inside the ellipsoid, so that a pair outside the box needs no solve.
//! A report with missing components is compared on the observed ones, with the quantile of their number. Against a density
//! of false reports per unit of the whole measurement space they are put at the mean of their own density, ∫ N².
//!
//! Reference: Bar-Shalom, Li (1995), Multitarget-Multisensor Tracking, §1.4.2.

use std::f64::consts::LN_2;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::error::{Result, require_probability};
use crate::filter::extended::Linearised;
use crate::filter::kalman::{LN_TAU, MeasurementPrediction, WhitenedInnovation};
use crate::gaussian::Gaussian;
use crate::model::{Sensor, sensor};
use crate::stats::chi_square;

/// A gate that holds a target's own report with this probability.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    probability: f64,
}

impl Gate {
    /// A gate of this probability in [0, 1]; 1 lets everything through.
    pub fn new(probability: f64) -> Result<Self> {
        require_probability("probability", probability)?;
        Ok(Self { probability })
    }

    /// Probability that the gate holds the target's own report.
    pub fn probability(&self) -> f64 {
        self.probability
    }

    /// Thresholds on d² for 0 to `dims` observed components.
    pub fn thresholds(&self, dims: usize) -> Result<Vec<f64>> {
        let quantiles = (1..=dims).map(|dof| chi_square::quantile(self.probability, dof));
        std::iter::once(Ok(0.0)).chain(quantiles).collect()
    }
}

/// A pair inside the gate.
#[derive(Debug, Clone, PartialEq)]
pub struct GatedPair {
    /// Index of the report.
    pub report: usize,
    /// d².
    pub nis: f64,
    /// ln N(z; ẑ, S) over the observed components.
    pub log_likelihood: f64,
    /// The same as a density over all components: those not observed count as they do on the average.
    pub log_density: f64,
    /// z − ẑ, angles wrapped; NaN where not observed.
    pub innovation: DVector<f64>,
}

/// A track's gate: the pairs inside it, in the order of the reports.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GatedTrack {
    /// Pairs inside the gate.
    pub pairs: Vec<GatedPair>,
    /// ln N of a fully observed report on the gate's edge; −∞ without a gate.
    pub edge_log_likelihood: f64,
}

/// A track's estimate and what the sensor should report of it.
#[derive(Debug, Clone)]
pub struct Expectation {
    /// The predicted state.
    pub prior: Gaussian,
    /// The sensor linearised there.
    pub linearised: Linearised,
}

/// The pairs inside one track's gate. `thresholds` are those of [`Gate::thresholds`].
pub fn gate(
    track: &Expectation,
    sensor: &dyn Sensor,
    reports: &[DVector<f64>],
    thresholds: &[f64],
) -> Result<GatedTrack> {
    let prediction = &track.linearised.prediction;
    let full = thresholds.last().copied().unwrap_or(0.0);
    let half_widths = prediction.cov().diagonal().map(|variance| (full * variance).sqrt());
    let mut pairs = Vec::new();
    for (report, measured) in reports.iter().enumerate() {
        let innovation = sensor::residual(sensor, measured, &track.linearised.expected);
        // The full-dimensional threshold is the largest, and a NaN never exceeds it.
        if innovation.iter().zip(half_widths.iter()).any(|(r, w)| r.abs() > *w) {
            continue;
        }
        let white = whiten(prediction, &innovation)?;
        if white.nis <= thresholds[white.dof] {
            pairs.push(GatedPair {
                report,
                nis: white.nis,
                log_likelihood: white.log_likelihood,
                log_density: white.log_likelihood + unobserved(prediction, &white),
                innovation,
            });
        }
    }
    let at_center = prediction.whiten(&DVector::zeros(half_widths.len())).log_likelihood;
    Ok(GatedTrack {
        pairs,
        edge_log_likelihood: at_center - 0.5 * full,
    })
}

fn whiten(prediction: &MeasurementPrediction, innovation: &DVector<f64>) -> Result<WhitenedInnovation> {
    if innovation.iter().all(|r| !r.is_nan()) {
        return Ok(prediction.whiten(innovation));
    }
    let observed: Vec<usize> = (0..innovation.len()).filter(|&i| !innovation[i].is_nan()).collect();
    let part = prediction.select(&observed)?;
    Ok(part.whiten(&innovation.select_rows(&observed)))
}

/// ln ∫ N² of the k components that were not observed, given the others: −½ (k ln 4π + ln det S − ln det S_observed).
fn unobserved(prediction: &MeasurementPrediction, white: &WhitenedInnovation) -> f64 {
    let missing = prediction.cov().nrows() - white.dof;
    if missing == 0 {
        return 0.0;
    }
    // The determinant of the observed part is in its likelihood.
    let log_determinant = -2.0 * white.log_likelihood - white.nis - white.dof as f64 * LN_TAU;
    -0.5 * (missing as f64 * (LN_TAU + LN_2) + prediction.log_determinant() - log_determinant)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::extended::{Rule, linearise, update};
    use crate::model::sensor::RangeBearing;
    use nalgebra::DMatrix;

    /// The box test and the missing components must not change what the definition says of any pair.
    #[test]
    fn the_gate_holds_the_pairs_that_the_definition_holds() {
        let radar = RangeBearing::new([0.0, 0.0], 10.0, 0.02).unwrap();
        let prior = Gaussian::new(
            DVector::from_vec(vec![-300.0, 2.0, 1.0, 0.0]),
            DMatrix::from_diagonal(&DVector::from_vec(vec![100.0, 60.0, 1.0, 1.0])),
        )
        .unwrap();
        let mut reports = Vec::new();
        for i in -12..=12 {
            for j in -12..=12 {
                // Bearings on both sides of the seam at π.
                let bearing = std::f64::consts::PI + 0.01 * f64::from(j);
                reports.push(DVector::from_vec(vec![300.0 + 5.0 * f64::from(i), bearing]));
            }
            reports.push(DVector::from_vec(vec![300.0 + 5.0 * f64::from(i), f64::NAN]));
        }
        let thresholds = Gate::new(0.9).unwrap().thresholds(2).unwrap();
        let track = Expectation {
            linearised: linearise(&prior, &radar, None).unwrap(),
            prior: prior.clone(),
        };
        let gated = gate(&track, &radar, &reports, &thresholds).unwrap();
        let mut expected = Vec::new();
        for (report, measured) in reports.iter().enumerate() {
            let update = update(&prior, &radar, measured, None, Rule::Once).unwrap();
            if update.nis <= thresholds[update.dof] {
                expected.push((report, update.nis, update.log_likelihood));
            }
        }
        let found: Vec<_> = gated
            .pairs
            .iter()
            .map(|p| (p.report, p.nis, p.log_likelihood))
            .collect();
        assert_eq!(found, expected);
        assert!(found.len() > 50 && found.len() < reports.len() / 2, "{}", found.len());
    }
}
