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

use serde::{Deserialize, Serialize};

use super::Sight;
use super::mixture::Component;
use super::sums::{log_add, log_sum};
use crate::error::Result;
use crate::filter::correction::Corrections;
use crate::filter::extended::{Expecting, Linearised};
use crate::gating::mahalanobis::Gate;
use crate::model::sensor::residual_into;
use crate::stats::chi_square;

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
    measurement: usize,
    log_likelihood: f64,
    /// Where its innovation begins.
    innovation: usize,
    /// The component's correction.
    correction: usize,
}

/// All pairs of a scan.
pub(super) struct Pairs {
    /// By measurements, those of each by components.
    each: Vec<Pair>,
    /// Whether it can be said what the sensor should report of a component.
    seen: Vec<bool>,
    /// z − ĥ of all pairs, angles wrapped.
    innovations: Vec<f64>,
    corrections: Corrections,
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
    /// Updates the mixture by a scan of complete measurements, m numbers each.
    pub fn update(&self, mixture: &mut Vec<Component>, measurements: &[f64], sight: &Sight<'_>) -> Result<usize> {
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
        Ok(self.assemble(mixture, &pairs, &factors))
    }

    pub(super) fn pairs(&self, mixture: &[Component], measurements: &[f64], sight: &Sight<'_>) -> Result<Pairs> {
        let n = mixture.first().map_or(0, |component| component.state.dim());
        let m = sight.sensor.measurement_dim().max(1);
        let threshold = chi_square::quantile(self.gate.probability(), m)?;
        let log_detected = libm::log(sight.detection_probability);
        let count = measurements.len() / m;
        // Where the first component adds, only measurements near in it can be in the gate.
        let sorted = !sight.sensor.angles().contains(&0);
        let mut order: Vec<(f64, usize)> = (0..count).map(|z| (measurements[z * m], z)).collect();
        if sorted {
            order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        let mut expecting = Expecting::new(n, sight.sensor, sight.rule)?;
        let (mut innovation, mut whitened, mut widths) = (vec![0.0; m], vec![0.0; m], vec![0.0; m]);
        let mut out = Pairs {
            each: Vec::with_capacity(mixture.len()),
            seen: Vec::with_capacity(mixture.len()),
            innovations: Vec::with_capacity(mixture.len() * m),
            corrections: Corrections::new(n, m),
            log_targets: vec![f64::NEG_INFINITY; count],
            detection_probability: sight.detection_probability,
        };
        for (component, prior) in mixture.iter().enumerate() {
            let expected = expecting.of(&prior.state, sight.sensor, sight.platform);
            out.seen.push(expected.is_ok());
            let Ok(Linearised { expected, prediction }) = expected else {
                continue;
            };
            let s = prediction.cov();
            for (i, width) in widths.iter_mut().enumerate() {
                *width = libm::sqrt(threshold * s[(i, i)]);
            }
            let mut near = &order[..];
            if sorted {
                let centre = expected[0];
                let from = near.partition_point(|z| z.0 < centre - widths[0]);
                let to = near.partition_point(|z| z.0 <= centre + widths[0]);
                near = &near[from..to.max(from)];
            }
            let log_prior = libm::log(prior.weight) + log_detected;
            let mut correction = None;
            for &(_, measurement) in near {
                let measured = &measurements[measurement * m..][..m];
                residual_into(sight.sensor, measured, expected.as_slice(), &mut innovation);
                if innovation.iter().zip(&widths).any(|(r, width)| r.abs() > *width) {
                    continue;
                }
                let nis = prediction.nis(&innovation, &mut whitened);
                if nis <= threshold {
                    out.each.push(Pair {
                        component,
                        measurement,
                        log_likelihood: log_prior + prediction.log_likelihood(nis),
                        innovation: out.innovations.len(),
                        correction: *correction.get_or_insert_with(|| out.corrections.push(prediction, &prior.state)),
                    });
                    out.innovations.extend_from_slice(&innovation);
                }
            }
        }
        out.each.sort_by_key(|pair| pair.measurement);
        let mut terms = Vec::new();
        for pairs in out.each.chunk_by(|a, b| a.measurement == b.measurement) {
            terms.clear();
            terms.extend(pairs.iter().map(|pair| pair.log_likelihood));
            out.log_targets[pairs[0].measurement] = log_sum(&terms);
        }
        Ok(out)
    }

    pub(super) fn assemble(&self, mixture: &mut Vec<Component>, pairs: &Pairs, factors: &Factors) -> usize {
        for (component, seen) in mixture.iter_mut().zip(&pairs.seen) {
            let missed = if *seen { 1.0 - pairs.detection_probability } else { 1.0 };
            component.weight *= missed * factors.missed;
        }
        let m = pairs.corrections.measurement_dim();
        mixture.reserve(pairs.each.len());
        for pair in &pairs.each {
            let weight = libm::exp(pair.log_likelihood + factors.log_detected[pair.measurement]);
            if weight > self.prune {
                let prior = &mixture[pair.component];
                let innovation = &pairs.innovations[pair.innovation..][..m];
                mixture.push(Component {
                    weight,
                    state: pairs.corrections.posterior(pair.correction, &prior.state, innovation),
                    rate: prior.rate,
                    extent: None,
                    label: prior.label,
                    rooted: prior.rooted || pairs.corrections.is_rooted(pair.correction),
                });
            }
        }
        pairs.seen.iter().filter(|seen| !**seen).count()
    }
}

impl Pairs {
    /// Σ w over all components of the mixture, and over them as missed.
    pub(super) fn masses(&self, mixture: &[Component]) -> Masses {
        let mut out = Masses { all: 0.0, missed: 0.0 };
        for (component, seen) in mixture.iter().zip(&self.seen) {
            let missed = if *seen { 1.0 - self.detection_probability } else { 1.0 };
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
