//! The cardinalised PHD filter: beside the intensity it carries the distribution of the number of targets.
//!
//! | symbol    | name here     | meaning                                                                  |
//! |-----------|---------------|--------------------------------------------------------------------------|
//! | ρ(n)      | `log_probabilities` | probability of n targets, n = 0 … N (logarithms)                   |
//! | p_S, b    |               | survival probability; expected number of births, which is Poisson         |
//! | W, φ      | `all`, `missed` | Σ w and Σ (1 − p_D) w: expected targets, and those missed               |
//! | L_z       | `targets`     | Σ_j w_j p_D q_j(z)                                                       |
//! | c_j(Z)    |               | coefficient of x^j in Π_{z ∈ Z} (κ + L_z x)                              |
//!
//! Prediction:  ρ⁻(n) = Σ_j Poisson(n − j; b) Σ_{l ≥ j} C(l, j) p_S^j (1 − p_S)^{l − j} ρ(l)
//! Update, with Poisson clutter and P(n, k) = n! / (n − k)!:
//!   Υ_u(n; Z) = Σ_j c_j(Z) P(n, j + u) φ^{n − j − u} / W^n
//!   ρ⁺(n) ∝ Υ_0(n; Z) ρ(n)
//!   missed:  w (1 − p_D) ⟨Υ_1(Z), ρ⟩ / ⟨Υ_0(Z), ρ⟩;   of z:  L_jz ⟨Υ_1(Z ∖ z), ρ⟩ / ⟨Υ_0(Z), ρ⟩
//!
//! The c_j are the elementary symmetric functions of L_z / κ times κ^|Z|, so that κ may be 0; the number of clutter points in the
//! whole field of view cancels. Measurements that no component gates are a common factor. All sums are of logarithms, and
//! the c_j(Z ∖ z) of all z come from halving Z again and again, without division: O(|Z|² log |Z|).
//!
//! Reference: Vo, Vo, Cantoni (2007), Analytic implementations of the cardinalized probability hypothesis density filter, IEEE
//! TSP 55(7), eqs. 13 to 20; docs/intensity_filters.md.

use serde::{Deserialize, Serialize};

use super::Sight;
use super::gm_phd::{Factors, PointUpdate};
use super::mixture::Component;
use super::sums::{log_add, log_sum};
use crate::error::Result;

/// Terms below this share of the largest are nothing.
const NEGLIGIBLE: f64 = -80.0;

/// Distribution of the number of targets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cardinality {
    log_probabilities: Vec<f64>,
}

impl Cardinality {
    /// No target for certain, of at most so many.
    pub fn none(max_targets: usize) -> Self {
        let mut log_probabilities = vec![f64::NEG_INFINITY; max_targets + 1];
        log_probabilities[0] = 0.0;
        Self { log_probabilities }
    }

    /// Targets that are there with these probabilities, independent of one another; weights above 1 count as 1.
    pub fn independent(weights: &[f64], max_targets: usize) -> Self {
        let factors: Vec<[f64; 2]> = weights
            .iter()
            .map(|w| [libm::log1p(-w.clamp(0.0, 1.0)), libm::log(w.clamp(0.0, 1.0))])
            .collect();
        let mut found = polynomial(&factors, max_targets + 1);
        found.resize(max_targets + 1, f64::NEG_INFINITY);
        Self::normalised(found)
    }

    /// ρ(n) for n = 0 … N.
    pub fn probabilities(&self) -> Vec<f64> {
        self.log_probabilities.iter().map(|&p| libm::exp(p)).collect()
    }

    /// The likeliest number.
    pub fn mode(&self) -> usize {
        let mut best = 0;
        for (n, &p) in self.log_probabilities.iter().enumerate() {
            if p > self.log_probabilities[best] {
                best = n;
            }
        }
        best
    }

    /// One scan later.
    pub(crate) fn predicted(&self, survival: f64, births: f64) -> Self {
        let count = self.log_probabilities.len();
        let factorials = log_factorials(count);
        let (log_stay, log_go) = (libm::log(survival), libm::log1p(-survival));
        // ln of x^k, where 0⁰ = 1.
        let power = |log: f64, k: usize| if k == 0 { 0.0 } else { log * k as f64 };
        let mut staying = Vec::with_capacity(count);
        for j in 0..count {
            let terms: Vec<f64> = (j..count)
                .map(|l| {
                    let choices = factorials[l] - factorials[j] - factorials[l - j];
                    self.log_probabilities[l] + choices + power(log_stay, j) + power(log_go, l - j)
                })
                .collect();
            staying.push(log_sum(&terms));
        }
        let log_births = libm::log(births);
        let born: Vec<f64> = (0..count)
            .map(|k| power(log_births, k) - births - factorials[k])
            .collect();
        Self::normalised(product(&staying, &born, count))
    }

    fn normalised(mut log_probabilities: Vec<f64>) -> Self {
        let total = log_sum(&log_probabilities);
        if total == f64::NEG_INFINITY {
            return Self::none(log_probabilities.len().saturating_sub(1));
        }
        for p in &mut log_probabilities {
            *p -= total;
        }
        Self { log_probabilities }
    }
}

/// What a scan does to the number of targets.
struct Counted {
    cardinality: Cardinality,
    factors: Factors,
}

/// The update of mixture and cardinality.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CphdUpdate {
    /// That of the mixture.
    pub point: PointUpdate,
    /// N: more targets than that there never are.
    pub max_targets: usize,
}

impl CphdUpdate {
    /// Updates the mixture and the cardinality by a scan of complete measurements, m numbers each.
    pub fn update(
        &self,
        mixture: &mut Vec<Component>,
        cardinality: &mut Cardinality,
        measurements: &[f64],
        sight: &Sight<'_>,
    ) -> Result<usize> {
        let pairs = self.point.pairs(mixture, measurements, sight)?;
        let masses = pairs.masses(mixture);
        let scan = Counts {
            all: libm::log(masses.all),
            missed: libm::log(masses.missed),
            clutter: libm::log(sight.clutter_density),
            targets: &pairs.log_targets,
        };
        let counted = scan.update(cardinality);
        *cardinality = counted.cardinality;
        Ok(self.point.assemble(mixture, &pairs, &counted.factors))
    }
}

/// What the number of targets depends on: the logarithms of W, φ, κ and all L_z.
struct Counts<'a> {
    all: f64,
    missed: f64,
    clutter: f64,
    targets: &'a [f64],
}

impl Counts<'_> {
    fn update(&self, prior: &Cardinality) -> Counted {
        let count = prior.log_probabilities.len();
        let factorials = log_factorials(count);
        let gated: Vec<usize> = (0..self.targets.len())
            .filter(|&z| self.targets[z] > f64::NEG_INFINITY)
            .collect();
        let factors: Vec<[f64; 2]> = gated.iter().map(|&z| [self.clutter, self.targets[z]]).collect();
        let all = polynomial(&factors, count);
        // ln of P(n, k) φ^{n − k} / W^n, −∞ where it is zero.
        let term = |n: usize, k: usize| {
            if k > n {
                return f64::NEG_INFINITY;
            }
            let missed = if n == k { 0.0 } else { self.missed * (n - k) as f64 };
            let share = if n == 0 { 0.0 } else { -self.all * n as f64 };
            factorials[n] - factorials[n - k] + missed + share
        };
        let posterior: Vec<f64> = (0..count)
            .map(|n| {
                let terms: Vec<f64> = all.iter().enumerate().map(|(j, c)| c + term(n, j)).collect();
                prior.log_probabilities[n] + log_sum(&terms)
            })
            .collect();
        let log_total = log_sum(&posterior);
        // ⟨P(n, j + 1) φ^{n − j − 1} / W^n, ρ⟩ for every j.
        let with_one_more: Vec<f64> = (0..all.len())
            .map(|j| {
                let terms: Vec<f64> = (0..count)
                    .map(|n| prior.log_probabilities[n] + term(n, j + 1))
                    .collect();
                log_sum(&terms)
            })
            .collect();
        let weigh = |coefficients: &[f64]| {
            let terms: Vec<f64> = coefficients.iter().zip(&with_one_more).map(|(c, g)| c + g).collect();
            log_sum(&terms) - log_total
        };
        let mut log_detected = vec![f64::NEG_INFINITY; self.targets.len()];
        let mut missed = 1.0;
        if log_total > f64::NEG_INFINITY {
            missed = libm::exp(weigh(&all));
            leave_one_out(&factors, &[0.0], count, &mut |index, others| {
                log_detected[gated[index]] = weigh(others);
            });
        }
        Counted {
            cardinality: if log_total > f64::NEG_INFINITY {
                Cardinality::normalised(posterior)
            } else {
                prior.clone()
            },
            factors: Factors { missed, log_detected },
        }
    }
}

fn log_factorials(count: usize) -> Vec<f64> {
    let mut out = vec![0.0; count.max(1)];
    for n in 1..count {
        out[n] = out[n - 1] + libm::log(n as f64);
    }
    out
}

/// Coefficients of the product of two polynomials, the first `limit` of them.
fn product(a: &[f64], b: &[f64], limit: usize) -> Vec<f64> {
    let high = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (floor_a, floor_b) = (high(a) + NEGLIGIBLE * 10.0, high(b) + NEGLIGIBLE * 10.0);
    let size = (a.len() + b.len()).saturating_sub(1).min(limit);
    let mut out = vec![f64::NEG_INFINITY; size];
    for (i, &x) in a.iter().enumerate().filter(|(_, x)| **x >= floor_a) {
        for (j, &y) in b
            .iter()
            .enumerate()
            .take(size.saturating_sub(i))
            .filter(|(_, y)| **y >= floor_b)
        {
            out[i + j] = log_add(out[i + j], x + y);
        }
    }
    out
}

/// Coefficients of Π (κ + L x), the first `limit` of them.
fn polynomial(factors: &[[f64; 2]], limit: usize) -> Vec<f64> {
    match factors {
        [] => vec![0.0],
        [only] => only[..limit.min(2)].to_vec(),
        _ => {
            let (left, right) = factors.split_at(factors.len() / 2);
            product(&polynomial(left, limit), &polynomial(right, limit), limit)
        }
    }
}

/// For every factor the product of `outside` and all other factors.
fn leave_one_out(factors: &[[f64; 2]], outside: &[f64], limit: usize, each: &mut impl FnMut(usize, &[f64])) {
    fn halve(factors: &[[f64; 2]], first: usize, outside: &[f64], limit: usize, each: &mut impl FnMut(usize, &[f64])) {
        if factors.len() <= 1 {
            if !factors.is_empty() {
                each(first, outside);
            }
            return;
        }
        let middle = factors.len() / 2;
        let (left, right) = factors.split_at(middle);
        halve(
            left,
            first,
            &product(outside, &polynomial(right, limit), limit),
            limit,
            each,
        );
        halve(
            right,
            first + middle,
            &product(outside, &polynomial(left, limit), limit),
            limit,
            each,
        );
    }
    halve(factors, 0, outside, limit, each);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::stream::Stream;

    /// Υ_u and the update by the definition: sums over all subsets of at most four measurements, all n, no logarithms.
    #[test]
    fn the_update_is_the_definitions() {
        let mut stream = Stream::new(6, 0);
        let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
        let fall = |n: usize, k: usize| if k > n { 0.0 } else { factorial(n) / factorial(n - k) };
        for case in 0..300 {
            let m = case % 5;
            let clutter = if case % 7 == 0 { 0.0 } else { stream.between(0.1, 2.0) };
            let targets: Vec<f64> = (0..m).map(|_| stream.between(0.05, 3.0)).collect();
            let (all, share) = (stream.between(0.5, 4.0), stream.between(0.05, 0.6));
            let missed = all * share;
            let count = 9;
            let weights: Vec<f64> = (0..count).map(|_| stream.uniform()).collect();
            let total: f64 = weights.iter().sum();
            let rho: Vec<f64> = weights.iter().map(|w| w / total).collect();
            let upsilon = |u: usize, n: usize, measurements: &[f64]| {
                let mut sum = 0.0;
                for subset in 0..1_usize << measurements.len() {
                    let inside = |z: usize| (subset >> z) & 1 == 1;
                    let j = (0..measurements.len()).filter(|&z| inside(z)).count();
                    let product: f64 = (0..measurements.len())
                        .map(|z| if inside(z) { measurements[z] } else { clutter })
                        .product();
                    if j + u <= n {
                        let power = i32::try_from(n - j - u).unwrap();
                        sum += product * fall(n, j + u) * missed.powi(power) / all.powi(i32::try_from(n).unwrap());
                    }
                }
                sum
            };
            let inner =
                |u: usize, measurements: &[f64]| (0..count).map(|n| upsilon(u, n, measurements) * rho[n]).sum::<f64>();
            let evidence = inner(0, &targets);
            let counts = Counts {
                all: all.ln(),
                missed: missed.ln(),
                clutter: libm::log(clutter),
                targets: &targets.iter().map(|t| t.ln()).collect::<Vec<_>>(),
            };
            let prior = Cardinality {
                log_probabilities: rho.iter().map(|p| p.ln()).collect(),
            };
            let found = counts.update(&prior);
            for (n, p) in found.cardinality.probabilities().iter().enumerate() {
                let expected = upsilon(0, n, &targets) * rho[n] / evidence;
                assert!((p - expected).abs() < 1e-12, "{p} {expected}");
            }
            let expected = inner(1, &targets) / evidence;
            assert!((found.factors.missed - expected).abs() < 1e-11 * expected.max(1.0));
            for z in 0..m {
                let mut others = targets.clone();
                others.remove(z);
                let expected = inner(1, &others) / evidence;
                assert!((found.factors.log_detected[z].exp() - expected).abs() < 1e-11 * expected.max(1.0));
            }
            // The intensity's mass is the mean of the cardinality.
            let mass = found.factors.missed * missed
                + (0..m)
                    .map(|z| found.factors.log_detected[z].exp() * targets[z])
                    .sum::<f64>();
            let mean: f64 = found
                .cardinality
                .probabilities()
                .iter()
                .enumerate()
                .map(|(n, p)| n as f64 * p)
                .sum();
            assert!((mass - mean).abs() < 1e-10, "{mass} {mean}");
        }
    }

    #[test]
    fn the_prediction_is_survival_and_birth() {
        let mut cardinality = Cardinality::none(60);
        for _ in 0..200 {
            cardinality = cardinality.predicted(0.9, 1.5);
        }
        // The fixed point is Poisson with mean b / (1 − p_S).
        for (n, p) in cardinality.probabilities().iter().enumerate().take(40) {
            let expected = (n as f64 * 15.0_f64.ln() - 15.0 - libm::lgamma(n as f64 + 1.0)).exp();
            assert!((p - expected).abs() < 1e-7, "{n}: {p} {expected}");
        }
        let gone = cardinality.predicted(0.0, 0.0);
        assert_eq!(gone.mode(), 0);
        assert_eq!(cardinality.predicted(1.0, 0.0).mode(), cardinality.mode());
    }
}
