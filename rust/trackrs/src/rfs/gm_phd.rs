//! Measurement update of the Gaussian-mixture PHD filter for point targets, which give at most one measurement in a scan.
//!
//! | symbol  | name here    | meaning                                                                  |
//! |---------|--------------|--------------------------------------------------------------------------|
//! | w, m, P | [`Component`] | a component of the predicted mixture                                     |
//! | p_D, κ  | [`Sight`]    | detection probability; false measurements per unit of the measurement space |
//! | q_j(z)  |              | N(z; ĥ_j, S_j)                                                            |
//! | L_jz    | `log_likelihood` | w_j p_D q_j(z)                                                        |
//!
//! D(x) = (1 − p_D) D⁻(x) + Σ_z Σ_j w_jz N(x; m_jz, P_jz),   w_jz = L_jz / (κ + Σ_l L_lz)
//!
//! with the Kalman update m_jz, P_jz of component j by z. Pairs outside the gate count as zero; what a gate loses is not put
//! back. In [`super::cphd`] the two terms get factors of their own.
//!
//! Reference: Vo, Ma (2006), The Gaussian mixture probability hypothesis density filter, IEEE TSP 54(11), eqs. 33 to 38;
//! docs/intensity_filters.md.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::mixture::Component;
use super::sums::{log_add, log_sum};
use super::{Sight, Updated};
use crate::error::Result;
use crate::filter::correction::Scratch;
use crate::filter::extended::{Linearised, expect};
use crate::gating::mahalanobis::Gate;
use crate::model::sensor::residual_into;

/// How measurements become targets.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PointUpdate {
    /// Pairs outside it count as impossible.
    pub gate: Gate,
    /// New components of this weight and below are not made.
    pub prune: f64,
}

/// A component and a measurement that may be its own.
struct Pair {
    component: usize,
    log_likelihood: f64,
    /// Where its innovation begins.
    innovation: usize,
}

/// All pairs of a scan.
pub(super) struct Pairs<'a> {
    mixture: &'a [Component],
    /// What the sensor should report of every component; none where that cannot be said.
    expected: Vec<Option<Linearised>>,
    of_measurement: Vec<Vec<Pair>>,
    /// z − ĥ of all pairs, angles wrapped.
    innovations: Vec<f64>,
    /// ln Σ_j L_jz.
    pub(super) log_targets: Vec<f64>,
    detection_probability: f64,
}

/// What the terms of the update are multiplied with.
pub(super) struct Factors {
    /// Of missed targets, beside 1 − p_D.
    pub(super) missed: f64,
    /// Of every measurement's L_jz, as a logarithm.
    pub(super) log_detected: Vec<f64>,
}

impl PointUpdate {
    /// The mixture after a scan of complete measurements, m numbers each.
    pub fn update(&self, mixture: &[Component], measurements: &[f64], sight: &Sight<'_>) -> Result<Updated> {
        let pairs = self.pairs(mixture, measurements, sight)?;
        let log_clutter = libm::log(sight.clutter_density);
        let factors = Factors {
            missed: 1.0,
            log_detected: pairs
                .log_targets
                .iter()
                .map(|&total| -log_add(total, log_clutter))
                .collect(),
        };
        Ok(self.assemble(&pairs, &factors))
    }

    pub(super) fn pairs<'a>(
        &self,
        mixture: &'a [Component],
        measurements: &[f64],
        sight: &Sight<'_>,
    ) -> Result<Pairs<'a>> {
        let m = sight.sensor.measurement_dim().max(1);
        let threshold = self.gate.thresholds(m)?.last().copied().unwrap_or(0.0);
        let log_detected = libm::log(sight.detection_probability);
        let count = measurements.len() / m;
        let mut of_measurement: Vec<Vec<Pair>> = (0..count).map(|_| Vec::new()).collect();
        let mut expected = Vec::with_capacity(mixture.len());
        // Where the first component adds, only measurements near in it can be in the gate.
        let sorted = !sight.sensor.angles().contains(&0);
        let first = |z: usize| measurements[z * m];
        let mut order: Vec<usize> = (0..count).collect();
        if sorted {
            order.sort_by(|&a, &b| first(a).total_cmp(&first(b)));
        }
        let (mut innovation, mut innovations) = (vec![0.0; m], Vec::new());
        for (component, prior) in mixture.iter().enumerate() {
            let Ok(linearised) = expect(&prior.state, sight.sensor, sight.platform, sight.rule) else {
                expected.push(None);
                continue;
            };
            let s = linearised.prediction.cov();
            let widths: Vec<f64> = (0..m).map(|i| libm::sqrt(threshold * s[(i, i)])).collect();
            let mut near = &order[..];
            if sorted {
                let centre = linearised.expected[0];
                let from = near.partition_point(|&z| first(z) < centre - widths[0]);
                let to = near.partition_point(|&z| first(z) <= centre + widths[0]);
                near = &near[from..to.max(from)];
            }
            let log_prior = libm::log(prior.weight) + log_detected;
            for &z in near {
                let measured = &measurements[z * m..(z + 1) * m];
                residual_into(sight.sensor, measured, linearised.expected.as_slice(), &mut innovation);
                if innovation.iter().zip(&widths).any(|(r, width)| r.abs() > *width) {
                    continue;
                }
                let white = linearised.prediction.whiten(&DVector::from_column_slice(&innovation));
                if white.nis <= threshold {
                    of_measurement[z].push(Pair {
                        component,
                        log_likelihood: log_prior + white.log_likelihood,
                        innovation: innovations.len(),
                    });
                    innovations.extend_from_slice(&innovation);
                }
            }
            expected.push(Some(linearised));
        }
        let total = |pairs: &Vec<Pair>| log_sum(&pairs.iter().map(|pair| pair.log_likelihood).collect::<Vec<_>>());
        Ok(Pairs {
            mixture,
            expected,
            log_targets: of_measurement.iter().map(total).collect(),
            of_measurement,
            innovations,
            detection_probability: sight.detection_probability,
        })
    }

    pub(super) fn assemble(&self, pairs: &Pairs<'_>, factors: &Factors) -> Updated {
        let mut components = pairs.mixture.to_vec();
        let mut skipped = 0;
        for (component, expected) in components.iter_mut().zip(&pairs.expected) {
            if expected.is_some() {
                component.weight *= (1.0 - pairs.detection_probability) * factors.missed;
            } else {
                component.weight *= factors.missed;
                skipped += 1;
            }
        }
        let mut scratch = Scratch::default();
        for (of_measurement, log_detected) in pairs.of_measurement.iter().zip(&factors.log_detected) {
            for pair in of_measurement {
                let weight = libm::exp(pair.log_likelihood + log_detected);
                let Some(expected) = pairs.expected[pair.component].as_ref().filter(|_| weight > self.prune) else {
                    continue;
                };
                let prior = &pairs.mixture[pair.component];
                let innovation = &pairs.innovations[pair.innovation..][..expected.expected.len()];
                components.push(Component {
                    weight,
                    state: expected
                        .prediction
                        .posterior_using(&prior.state, innovation, &mut scratch),
                    rate: prior.rate,
                    extent: None,
                    label: prior.label,
                });
            }
        }
        Updated { components, skipped }
    }
}

impl Pairs<'_> {
    /// Σ w over all components, and over them as missed.
    pub(super) fn masses(&self) -> Masses {
        let mut out = Masses { all: 0.0, missed: 0.0 };
        for (component, expected) in self.mixture.iter().zip(&self.expected) {
            let missed = expected.as_ref().map_or(1.0, |_| 1.0 - self.detection_probability);
            out.all += component.weight;
            out.missed += component.weight * missed;
        }
        out
    }
}

/// Expected numbers of targets.
pub(super) struct Masses {
    pub(super) all: f64,
    pub(super) missed: f64,
}
