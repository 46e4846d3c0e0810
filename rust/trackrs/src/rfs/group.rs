//! Targets that share measurements, and the hypothesis that these are the superposition of all of them.
//!
//! | symbol   | name here    | shape | meaning                                                              |
//! |----------|--------------|-------|----------------------------------------------------------------------|
//! | J        | `members`    |       | components of a group: two of them with a common gated measurement   |
//! | r_j      | `existence`  |       | min(w_j, 0.999)                                                      |
//! | S        |              |       | the members that are detected                                        |
//! | y_zj     | `offsets`    | m     | measurement z as component j sees it (`view.rs`)                     |
//! | λ_j      |              | m     | spread of component j in the same axes                               |
//! | μ_j, v_j |              | m     | q(x_j): mean and variance of what is expected of j, from 0 and λ_j   |
//! | ρ_zj     | `shares`     |       | share of z that is of j                                              |
//! | n_j      | `counts`     |       | measurements of j                                                    |
//!
//! Given S, the measurements of a block are a Poisson process of intensity κ + Σ_j γ_j N(z; H x_j, R). Mean field, ten times
//! from the prediction, in the axes of `view.rs`, in which R is 1 and everything diagonal:
//!   l_zj = ln γ_j − ½ (m ln 2π + ln |R|) − ½ |y_zj − μ_j|² − ½ Σ v_j
//!   ρ_zj = e^l_zj / (κ + Σ_k e^l_zk),  n_j = Σ_z ρ_zj,  ȳ_j = Σ_z ρ_zj y_zj / n_j
//!   v_j = λ_j / (n_j λ_j + 1),  μ_j = n_j v_j ȳ_j
//!   E(S) = Σ_z ln(κ + Σ_j e^l_zj) − Σ_j γ_j − Σ_j KL(q_j ‖ prior_j)   at one more l
//!   KL = ½ Σ [1 / (n λ + 1) + μ² / λ − 1 + ln(n λ + 1)],  μ² / λ = λ (n ȳ / (n λ + 1))²
//!   ln h(S) = E(S) + Σ_S ln(r_j p_D) + Σ_{J∖S} ln(1 − r_j p_D)
//! S runs over all subsets but the empty one where J has at most four members, else over J and J without one.
//! Members with an extent have their own R, and the scatter of their measurements is weighed by `extent.rs`.
//! They compete with the partitions, whose evidence is Z Π_J (1 − r_j p_D).
//!
//! Reference: extended-target spec 8.3, here without its division by κ^n, so that κ may be 0.

use super::sums::{log_add, log_sum};

/// Above this predicted weight a component is a target that may share measurements.
pub(crate) const TRACKED: f64 = 0.5;
const MOST_CERTAIN: f64 = 0.999;
/// From so many members on only hypotheses with at most one missed are formed.
const ALL_SUBSETS: usize = 4;
/// From so many members on, which are copies of a component of great weight, only that of all: the others would take time and memory
/// with the square of their number.
const ONE_MISSED: usize = 64;
const ITERATIONS: usize = 10;
/// Fewer measurements than this change nothing.
const NOTHING: f64 = 1e-12;

/// Measurements that are independent of the others, and the tracked components that may have caused them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Block {
    pub(crate) measurements: Vec<usize>,
    pub(crate) members: Vec<usize>,
}

/// The blocks: first what no component gates, then one for every group. `gated[i]` are the measurements in the gate of
/// tracked component `tracked[i]`.
pub(crate) fn blocks(count: usize, tracked: &[usize], gated: &[Vec<usize>]) -> Vec<Block> {
    let mut owner: Vec<Option<usize>> = vec![None; count];
    // The group of every tracked component: the lowest of those it is connected with.
    let mut group: Vec<usize> = (0..tracked.len()).collect();
    for (i, measurements) in gated.iter().enumerate() {
        for &z in measurements {
            let Some(other) = owner[z] else {
                owner[z] = Some(i);
                continue;
            };
            let (a, b) = (group[other].min(group[i]), group[other].max(group[i]));
            group.iter_mut().filter(|g| **g == b).for_each(|g| *g = a);
        }
    }
    let of_group = |g: Option<usize>| Block {
        measurements: (0..count).filter(|&z| owner[z].map(|i| group[i]) == g).collect(),
        members: (0..tracked.len())
            .filter(|&i| Some(group[i]) == g)
            .map(|i| tracked[i])
            .collect(),
    };
    let mut out = vec![of_group(None)];
    out.extend(
        (0..tracked.len())
            .filter(|&i| group[i] == i && !gated[i].is_empty())
            .map(|i| of_group(Some(i))),
    );
    out
}

/// A member of a group as its block's measurements see it.
pub(crate) struct Member<'a> {
    /// y, m numbers for each measurement.
    pub(crate) offsets: Vec<f64>,
    /// λ.
    pub(crate) spread: &'a [f64],
    /// γ.
    pub(crate) rate: f64,
    /// r.
    pub(crate) existence: f64,
    /// m ln 2π + ln |R|, or of what this member has in place of R.
    pub(crate) log_volume: f64,
    /// Whether the scatter of its measurements is wanted.
    pub(crate) scattered: bool,
}

impl Member<'_> {
    /// r of a predicted weight.
    pub(crate) fn existence(weight: f64) -> f64 {
        weight.min(MOST_CERTAIN)
    }
}

/// Who is detected, how likely that is, and with what.
pub(crate) struct Hypothesis {
    /// Which members are detected.
    pub(crate) detected: Vec<bool>,
    /// ln h(S), then ln p_S.
    pub(crate) log_weight: f64,
    /// For every detected member, in their order.
    pub(crate) found: Vec<Found>,
}

/// The measurements of a detected member.
pub(crate) struct Found {
    /// n.
    pub(crate) count: f64,
    /// ȳ.
    pub(crate) mean: Vec<f64>,
    /// Σ ρ (y − ȳ)(y − ȳ)ᵀ, m×m, where it is wanted.
    pub(crate) scatter: Vec<f64>,
}

/// What else a detected member's measurements are worth, given its place among the members: a logarithm.
pub(crate) type Worth<'a> = &'a dyn Fn(usize, &Found) -> f64;

/// Members that are all detected.
pub(crate) struct MeanField {
    /// E(S).
    pub(crate) bound: f64,
    /// For every member.
    pub(crate) found: Vec<Found>,
}

/// The model of a block.
pub(crate) struct Superposition {
    /// ln κ, −∞ without clutter.
    pub(crate) log_clutter: f64,
    /// p_D.
    pub(crate) detection_probability: f64,
    /// m.
    pub(crate) dims: usize,
}

/// All hypotheses with their probabilities, and that of none of them (its logarithm), given the evidence of the partitions.
pub(crate) struct Verdict {
    pub(crate) hypotheses: Vec<Hypothesis>,
    pub(crate) log_partitioned: f64,
}

impl Superposition {
    /// Weighs the hypotheses of a group of at least two members against the partitions of their measurements.
    pub(crate) fn weigh(&self, members: &[Member<'_>], log_evidence: f64, worth: Worth<'_>) -> Verdict {
        let missed = |member: &Member<'_>| libm::log1p(-member.existence * self.detection_probability);
        let mut hypotheses = Vec::new();
        for detected in subsets(members.len()) {
            let chosen: Vec<&Member<'_>> = members
                .iter()
                .zip(&detected)
                .filter(|(_, d)| **d)
                .map(|(m, _)| m)
                .collect();
            let MeanField { bound, found } = self.mean_field(&chosen);
            let outcome = |(member, detected): (&Member<'_>, &bool)| {
                if *detected {
                    libm::log(member.existence * self.detection_probability)
                } else {
                    missed(member)
                }
            };
            let mut log_weight = bound + members.iter().zip(&detected).map(outcome).sum::<f64>();
            let who = (0..members.len()).filter(|&j| detected[j] && members[j].scattered);
            for (j, found) in who.zip(&found) {
                log_weight += worth(j, found);
            }
            hypotheses.push(Hypothesis {
                detected,
                log_weight,
                found,
            });
        }
        let partitioned = log_evidence + members.iter().map(missed).sum::<f64>();
        let weights: Vec<f64> = hypotheses.iter().map(|h| h.log_weight).collect();
        let total = log_add(log_sum(&weights), partitioned);
        if total == f64::NEG_INFINITY {
            hypotheses.clear();
            return Verdict {
                hypotheses,
                log_partitioned: 0.0,
            };
        }
        for hypothesis in &mut hypotheses {
            hypothesis.log_weight -= total;
        }
        Verdict {
            hypotheses,
            log_partitioned: partitioned - total,
        }
    }

    /// E(S), and what each of `members`, which are all detected, gets.
    pub(super) fn mean_field(&self, members: &[&Member<'_>]) -> MeanField {
        let (m, k) = (self.dims, members.len());
        let mut mean: Vec<Vec<f64>> = vec![vec![0.0; m]; k];
        let mut variance: Vec<Vec<f64>> = members.iter().map(|member| member.spread.to_vec()).collect();
        let log_rates: Vec<f64> = members.iter().map(|member| libm::log(member.rate)).collect();
        let measurements = members.first().map_or(0, |member| member.offsets.len() / m.max(1));
        let mut logs = vec![0.0; k];
        let scattered = members.iter().any(|member| member.scattered);
        let mut found: Vec<Found> = Vec::new();
        let mut evidence = 0.0;
        for iteration in 0..=ITERATIONS {
            let constants: Vec<f64> = (0..k)
                .map(|j| log_rates[j] - 0.5 * (members[j].log_volume + variance[j].iter().sum::<f64>()))
                .collect();
            let mut counts = vec![0.0; k];
            let mut sums = vec![0.0; k * m];
            let mut squares = vec![vec![0.0; if scattered { m * m } else { 0 }]; k];
            evidence = 0.0;
            for z in 0..measurements {
                let mut high = self.log_clutter;
                for (j, member) in members.iter().enumerate() {
                    let y = &member.offsets[z * m..(z + 1) * m];
                    let apart: f64 = y.iter().zip(&mean[j]).map(|(y, mean)| (y - mean) * (y - mean)).sum();
                    logs[j] = constants[j] - 0.5 * apart;
                    high = high.max(logs[j]);
                }
                let mut total = libm::exp(self.log_clutter - high);
                for log in &mut logs {
                    *log = libm::exp(*log - high);
                    total += *log;
                }
                evidence += high + libm::log(total);
                for (j, member) in members.iter().enumerate() {
                    let share = logs[j] / total;
                    counts[j] += share;
                    let y = &member.offsets[z * m..(z + 1) * m];
                    sums[j * m..(j + 1) * m]
                        .iter_mut()
                        .zip(y)
                        .for_each(|(sum, y)| *sum += share * y);
                    for (i, square) in squares[j].iter_mut().enumerate() {
                        *square += share * y[i / m] * y[i % m];
                    }
                }
            }
            if iteration == ITERATIONS {
                break;
            }
            found.clear();
            for (j, member) in members.iter().enumerate() {
                let n = counts[j];
                let inverse = if n > NOTHING { 1.0 / n } else { 0.0 };
                let average: Vec<f64> = sums[j * m..(j + 1) * m].iter().map(|sum| sum * inverse).collect();
                for i in 0..m {
                    variance[j][i] = member.spread[i] / (n * member.spread[i] + 1.0);
                    mean[j][i] = n * variance[j][i] * average[i];
                }
                let mut scatter = std::mem::take(&mut squares[j]);
                for (i, square) in scatter.iter_mut().enumerate() {
                    *square -= n * average[i / m] * average[i % m];
                }
                found.push(Found {
                    count: n,
                    mean: average,
                    scatter,
                });
            }
        }
        let cost = |(member, found): (&&Member<'_>, &Found)| {
            let axis = |(spread, y): (&f64, &f64)| {
                let factor = found.count * spread + 1.0;
                let pull = found.count * y / factor;
                1.0 / factor + spread * pull * pull - 1.0 + libm::log(factor)
            };
            member.rate + 0.5 * member.spread.iter().zip(&found.mean).map(axis).sum::<f64>()
        };
        evidence -= members.iter().zip(&found).map(cost).sum::<f64>();
        MeanField { bound: evidence, found }
    }
}

/// Who may be detected.
fn subsets(members: usize) -> Vec<Vec<bool>> {
    if members <= ALL_SUBSETS {
        let chosen = |bits: usize| (0..members).map(|j| (bits >> j) & 1 == 1).collect();
        return (1..1_usize << members).map(chosen).collect();
    }
    if members >= ONE_MISSED {
        return vec![vec![true; members]];
    }
    let mut out: Vec<Vec<bool>> = (0..members)
        .map(|missed| (0..members).map(|j| j != missed).collect())
        .collect();
    out.push(vec![true; members]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn components_with_a_common_measurement_form_a_group() {
        let gated = vec![vec![0, 1], vec![3], vec![1, 2], vec![]];
        let found = blocks(6, &[4, 5, 7, 9], &gated);
        let expected = [
            Block {
                measurements: vec![4, 5],
                members: vec![],
            },
            Block {
                measurements: vec![0, 1, 2],
                members: vec![4, 7],
            },
            Block {
                measurements: vec![3],
                members: vec![5],
            },
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn groups_join_through_a_third() {
        let found = blocks(4, &[0, 1, 2], &[vec![0], vec![2], vec![0, 2]]);
        assert_eq!(found[1].members, [0, 1, 2]);
        assert_eq!(found[0].measurements, [1, 3]);
    }

    #[test]
    fn subsets_are_all_or_one_missed() {
        assert_eq!(subsets(2), [vec![true, false], vec![false, true], vec![true, true]]);
        assert_eq!(subsets(4).len(), 15);
        assert_eq!(subsets(6).len(), 7);
    }

    /// One axis, one measurement: E of one target is below the logarithm of the exact evidence, and close to it.
    #[test]
    fn the_bound_is_below_the_evidence() {
        let model = Superposition {
            log_clutter: libm::log(1e-3),
            detection_probability: 0.9,
            dims: 1,
        };
        let (y, spread, rate) = (0.7, 0.8, 2.0);
        let member = Member {
            offsets: vec![y],
            spread: &[spread],
            rate,
            existence: 0.9,
            log_volume: crate::filter::kalman::LN_TAU,
            scattered: false,
        };
        let MeanField { bound, found } = model.mean_field(&[&member]);
        // ∫ e^−γ (κ + γ N(y; x, 1)) N(x; 0, λ) dx.
        let variance: f64 = 1.0 + spread;
        let density = (-0.5 * y * y / variance).exp() / (std::f64::consts::TAU * variance).sqrt();
        let exact = (1e-3 + rate * density).ln() - rate;
        assert!(bound <= exact && bound > exact - 1e-3, "{bound} {exact}");
        assert!((found[0].count - 1.0).abs() < 0.01);
    }
}
