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
use crate::model::Sensor;
use crate::model::sensor::residual_into;
use crate::stats::chi_square;

/// A gate that holds a target's own report with this probability.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SavedGate")]
pub struct Gate {
    probability: f64,
}

/// A gate as it is saved, unchecked.
#[derive(Deserialize)]
struct SavedGate {
    probability: f64,
}

impl TryFrom<SavedGate> for Gate {
    type Error = crate::Error;

    fn try_from(saved: SavedGate) -> Result<Self> {
        Self::new(saved.probability)
    }
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
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GatedPair {
    /// Index of the report.
    pub report: usize,
    /// d².
    pub nis: f64,
    /// ln N(z; ẑ, S) over the observed components.
    pub log_likelihood: f64,
    /// The same as a density over all components: those not observed count as they do on the average.
    pub log_density: f64,
}

/// A track's gate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GatedTrack<'a> {
    /// Pairs inside it, in the order of the reports.
    pub pairs: &'a [GatedPair],
    /// ln N of a fully observed report on the gate's edge; −∞ without a gate.
    pub edge_log_likelihood: f64,
}

impl Default for GatedTrack<'_> {
    fn default() -> Self {
        Self {
            pairs: &[],
            edge_log_likelihood: f64::NEG_INFINITY,
        }
    }
}

/// The pairs inside the gate of a track of which this is expected, in the order of the reports. `thresholds` are those of
/// [`Gate::thresholds`].
pub fn gate(
    expected: &Linearised,
    sensor: &dyn Sensor,
    reports: &[DVector<f64>],
    thresholds: &[f64],
) -> Result<Vec<GatedPair>> {
    let mut gating = Gating::new(thresholds.to_vec());
    let mut pairs = Vec::new();
    gating.look(expected, sensor);
    for (report, measured) in reports.iter().enumerate() {
        gating.try_pair(expected, sensor, report, measured.as_slice(), &mut pairs)?;
    }
    Ok(pairs)
}

/// The gate of one track after another, in memory that serves them all.
#[derive(Debug)]
pub(crate) struct Gating {
    thresholds: Vec<f64>,
    half_widths: Vec<f64>,
    innovation: Vec<f64>,
    whitened: Vec<f64>,
    /// ln det S, once a pair needs it.
    log_determinant: Option<f64>,
    /// Whether a residual is the difference, component by component.
    differs: bool,
}

impl Gating {
    /// With the thresholds of a [`Gate`].
    pub(crate) fn new(thresholds: Vec<f64>) -> Self {
        let dims = thresholds.len().saturating_sub(1);
        Self {
            thresholds,
            half_widths: vec![0.0; dims],
            innovation: vec![0.0; dims],
            whitened: vec![0.0; dims],
            log_determinant: None,
            differs: false,
        }
    }

    /// Turns to a track.
    pub(crate) fn look(&mut self, expected: &Linearised, sensor: &dyn Sensor) {
        self.differs = sensor.angles().is_empty() && sensor.rotation().is_none();
        let full = self.thresholds.last().copied().unwrap_or(0.0);
        let (cov, m) = (expected.prediction.cov().as_slice(), self.half_widths.len());
        for (i, width) in self.half_widths.iter_mut().enumerate() {
            *width = (full * cov[i * m + i]).sqrt();
        }
        self.log_determinant = None;
    }

    /// How far the box around the gate reaches, component by component.
    pub(crate) fn half_widths(&self) -> &[f64] {
        &self.half_widths
    }

    /// ln N on the edge of the gate of that track.
    pub(crate) fn edge_log_likelihood(&mut self, expected: &Linearised) -> f64 {
        self.log_likelihood(expected, 0.0) - 0.5 * self.thresholds.last().copied().unwrap_or(0.0)
    }

    fn log_likelihood(&mut self, expected: &Linearised, nis: f64) -> f64 {
        let prediction = &expected.prediction;
        let determinant = *self.log_determinant.get_or_insert_with(|| prediction.log_determinant());
        prediction.log_likelihood_of(nis, determinant)
    }

    /// Adds the pair of that track and this report, if the gate holds it.
    #[inline]
    pub(crate) fn try_pair(
        &mut self,
        expected: &Linearised,
        sensor: &dyn Sensor,
        report: usize,
        measured: &[f64],
        pairs: &mut Vec<GatedPair>,
    ) -> Result<()> {
        // The full-dimensional threshold is the largest, and a NaN never exceeds it.
        let outside = |(r, w): (f64, &f64)| r.abs() > *w;
        let expectation = expected.expected.as_slice();
        if self.differs {
            // Most pairs end here, many at the first component.
            let differences = measured.iter().zip(expectation).map(|(z, expected)| z - expected);
            if differences.zip(&self.half_widths).any(outside) {
                return Ok(());
            }
        }
        residual_into(sensor, measured, expectation, &mut self.innovation);
        let (innovation, m) = (&self.innovation, self.innovation.len());
        if innovation.iter().copied().zip(&self.half_widths).any(outside) {
            return Ok(());
        }
        let prediction = &expected.prediction;
        if innovation.iter().any(|r| r.is_nan()) {
            let observed: Vec<usize> = (0..m).filter(|&i| !innovation[i].is_nan()).collect();
            let values: Vec<f64> = observed.iter().map(|&i| innovation[i]).collect();
            let white = prediction.select(&observed)?.whiten(&DVector::from_vec(values));
            if white.nis <= self.thresholds[white.dof] {
                pairs.push(GatedPair {
                    report,
                    nis: white.nis,
                    log_likelihood: white.log_likelihood,
                    log_density: white.log_likelihood + unobserved(prediction, &white),
                });
            }
            return Ok(());
        }
        let nis = prediction.nis(innovation, &mut self.whitened);
        if nis <= self.thresholds[m] {
            let log_likelihood = self.log_likelihood(expected, nis);
            pairs.push(GatedPair {
                report,
                nis,
                log_likelihood,
                log_density: log_likelihood,
            });
        }
        Ok(())
    }
}

/// ln ∫ N² of the k components that were not observed, given the others: −½ (k ln 4π + ln det S − ln det S_observed).
fn unobserved(prediction: &MeasurementPrediction, white: &WhitenedInnovation) -> f64 {
    let missing = prediction.cov().nrows() - white.dof;
    // The determinant of the observed part is in its likelihood.
    let log_determinant = -2.0 * white.log_likelihood - white.nis - white.dof as f64 * LN_TAU;
    -0.5 * (missing as f64 * (LN_TAU + LN_2) + prediction.log_determinant() - log_determinant)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::extended::{Rule, linearise, update};
    use crate::gaussian::Gaussian;
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
        let gated = gate(&linearise(&prior, &radar, None).unwrap(), &radar, &reports, &thresholds).unwrap();
        let mut expected = Vec::new();
        for (report, measured) in reports.iter().enumerate() {
            let update = update(&prior, &radar, measured, None, Rule::Once).unwrap();
            if update.nis <= thresholds[update.dof] {
                expected.push((report, update.nis, update.log_likelihood));
            }
        }
        let found: Vec<_> = gated.iter().map(|p| (p.report, p.nis, p.log_likelihood)).collect();
        assert_eq!(found, expected);
        assert!(found.len() > 50 && found.len() < reports.len() / 2, "{}", found.len());
    }
}
