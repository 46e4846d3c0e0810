//! Measurement update of the Gaussian-mixture PHD filter for extended targets, which give many measurements in a scan.
//!
//! | symbol   | name here    | meaning                                                                 |
//! |----------|--------------|-------------------------------------------------------------------------|
//! | w, m, P  | [`Component`] | a component of the predicted mixture                                    |
//! | p_D      | `detection_probability` | that a target gives measurements at all, and then Poisson(γ) many |
//! | κ        | `clutter_density` | false measurements per scan and unit of the measurement space         |
//! | W, |W|   | `cells.rs` | a cell of measurements, and how many they are                          |
//! | L_Wj     | `log_likelihoods` | w_j p_D p(|W|) N(stack W; …): weight of "W is of j"                   |
//! | d_W      |              | Σ_j L_Wj, for single measurements κ + Σ_j L_Wj                          |
//! | q_W      | `sums.rs` | probability that W is a cell                                           |
//!
//! In the order of the code, all weights as logarithms:
//! 1. The measurements fall into blocks: one for every group of targets that share gated measurements, and the rest
//!    (`group.rs`). Without `superposition` all are one block.
//! 2. The partitions of a block, or trees whose cuts are all summed over; every distinct cell once.
//! 3. ln L_Wj in O(1) of |W| (`view.rs`, and `spread.rs` where extents are learnt), d_W, q_W.
//! 4. In a block with two targets and more the hypotheses that its measurements are the superposition of several of them
//!    compete with the partitions; what these give is scaled by what is left to them.
//! 5. Components: missed (1 − p_D + p_D p(0)) w_j;  detected q_W L_Wj / d_W, updated by the cell's mean;  and those of step 4.
//!
//! Weights are those of the predicted mixture after birth. No 1/|W|! stands anywhere. With κ^−n left out of both sides of every
//! ratio κ may be 0.
//!
//! Reference: Granström, Lundquist, Orguner (2012), Extended target tracking using a Gaussian-mixture PHD filter, IEEE TAES
//! 48(4); extended-target spec 4 and 8. Deviation: the gate is the quantile of .999, which spec 8.3 gives as 13.8 for two
//! components.

use serde::{Deserialize, Serialize};

use super::Sight;
use super::cells::{Cells, Divisions};
use super::extent::ExtentModel;
use super::group::{Block, Found, Member, Superposition, TRACKED, Verdict, blocks};
use super::mixture::Component;
use super::rate::RateModel;
use super::spread::Seen;
use super::sums::{log_add, log_sum};
use super::view::{Noise, Posterior};
use crate::error::{Error, Result};
use crate::model::Sensor;
use crate::model::sensor::wrap_angle;
use crate::partition::lof::LocalOutlierFactor;
use crate::partition::{self, PartitionModel, Points};
use crate::stats::chi_square;

const GATE: f64 = 0.999;

/// How measurements become targets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExtendedUpdate {
    /// How the rates of targets are treated.
    pub rates: RateModel,
    /// How measurements are divided into cells.
    pub partition: PartitionModel,
    /// What is refused before they are divided.
    pub clutter_filter: Option<LocalOutlierFactor>,
    /// Whether targets may share measurements.
    pub superposition: bool,
    /// New components of this weight and below are not made.
    pub prune: f64,
    /// How extents are learnt; none: the sensor's noise is that of measurements about the target's centre.
    #[serde(default)]
    pub extent: Option<ExtentModel>,
}

/// Everything that a block needs of the scan.
struct Scene<'a> {
    update: &'a ExtendedUpdate,
    sight: &'a Sight<'a>,
    noise: Noise,
    log_clutter: f64,
    mixture: Vec<&'a Component>,
    seen: Vec<Seen>,
    log_counts: Vec<Vec<f64>>,
}

impl ExtendedUpdate {
    /// `Ok` if every parameter is in its domain and this sensor can be used.
    pub fn check(&self, sensor: &dyn Sensor) -> Result<()> {
        if sensor.rotation().is_some() {
            return Err(Error::invalid("sensor", "a pose", "cannot give cells of measurements"));
        }
        self.extent.as_ref().map_or(Ok(()), |extent| extent.check(sensor))?;
        self.rates.check()?;
        // Partitions check their parameters before they look at points.
        let none = Points::whitened(&[], sensor.measurement_dim(), &sensor.noise())?;
        let partitioner = self.partition.as_partitioner();
        partition::partitions(partitioner, &none, self.clutter_filter.as_ref()).map(|_| ())
    }

    /// Updates the mixture by a scan of complete measurements, m numbers each.
    pub fn update(&self, mixture: &mut Vec<Component>, measurements: &[f64], sight: &Sight<'_>) -> Result<usize> {
        let m = sight.sensor.measurement_dim().max(1);
        let z = unwrapped(measurements, m, sight.sensor.angles());
        let noise = Noise::of(sight.sensor)?;
        let (mut seen, mut views) = (Vec::with_capacity(mixture.len()), Vec::with_capacity(mixture.len()));
        let mut is_seen = Vec::with_capacity(mixture.len());
        for component in mixture.iter() {
            let view = Seen::new(component, sight, &noise, z.len() / m);
            is_seen.push(view.is_ok());
            if let Ok(view) = view {
                views.push(view);
                seen.push(component);
            }
        }
        let skipped = mixture.len() - seen.len();
        let mut detected = Vec::new();
        if !z.is_empty() && !seen.is_empty() {
            let scene = Scene::new(self, seen, views, noise, sight, z.len() / m);
            for block in scene.blocks(&z)? {
                if block.measurements.is_empty() {
                    continue;
                }
                let mut part = Vec::with_capacity(block.measurements.len() * m);
                for &i in &block.measurements {
                    part.extend_from_slice(&z[i * m..(i + 1) * m]);
                }
                scene.resolve(&block, &part, &mut detected)?;
            }
        }
        for (component, _) in mixture.iter_mut().zip(is_seen).filter(|(_, is_seen)| *is_seen) {
            component.weight *= 1.0 - sight.detection_probability * (1.0 - self.rates.silent(component.rate));
        }
        mixture.append(&mut detected);
        Ok(skipped)
    }
}

impl<'a> Scene<'a> {
    /// The scene of a scan with so many measurements.
    fn new(
        update: &'a ExtendedUpdate,
        mixture: Vec<&'a Component>,
        seen: Vec<Seen>,
        noise: Noise,
        sight: &'a Sight<'a>,
        count: usize,
    ) -> Self {
        Self {
            update,
            sight,
            log_clutter: libm::log(sight.clutter_density),
            seen,
            log_counts: mixture.iter().map(|c| update.rates.log_counts(c.rate, count)).collect(),
            mixture,
            noise,
        }
    }

    fn dims(&self) -> usize {
        self.sight.sensor.measurement_dim().max(1)
    }

    /// y of every measurement as a component sees it.
    fn offsets(&self, component: usize, z: &[f64]) -> Vec<f64> {
        let m = self.dims();
        let (mut scratch, mut out) = (vec![0.0; m], vec![0.0; z.len()]);
        for (z, y) in z.chunks_exact(m).zip(out.chunks_exact_mut(m)) {
            self.seen[component].view.offset(self.sight.sensor, z, &mut scratch, y);
        }
        out
    }

    fn blocks(&self, z: &[f64]) -> Result<Vec<Block>> {
        let (m, count) = (self.dims(), z.len() / self.dims());
        if !self.update.superposition {
            return Ok(blocks(count, &[], &[]));
        }
        let gate = chi_square::quantile(GATE, m)?;
        let tracked: Vec<usize> = (0..self.mixture.len())
            .filter(|&j| self.mixture[j].weight > TRACKED)
            .collect();
        let mut gated = Vec::with_capacity(tracked.len());
        for &j in &tracked {
            let offsets = self.offsets(j, z);
            let inside = |&i: &usize| self.seen[j].view.distance_squared(&offsets[i * m..(i + 1) * m]) <= gate;
            gated.push((0..count).filter(inside).collect());
        }
        Ok(blocks(count, &tracked, &gated))
    }

    /// Adds the components that a block's measurements make.
    fn resolve(&self, block: &Block, z: &[f64], out: &mut Vec<Component>) -> Result<()> {
        let mut cells = Cells::singles(z, &self.noise);
        let mut spread = self.noise.cov().clone();
        if let Some(extent) = &self.update.extent {
            cells = cells.with_matrices();
            spread += &extent.prior.cov;
        }
        let points = Points::whitened(z, self.dims(), &spread)?;
        let divisions = match (&self.update.partition, &self.update.clutter_filter) {
            (PartitionModel::Tree(tree), None) => cells.cuts(tree.trees(&points)?),
            (partition, filter) => {
                let partitions = partition::partitions(partition.as_partitioner(), &points, filter.as_ref())?;
                cells.flat(&partitions)
            }
        };
        self.weigh(block, z, &cells, &divisions, out);
        Ok(())
    }

    /// The same for given cells and divisions into them.
    fn weigh(&self, block: &Block, z: &[f64], cells: &Cells, divisions: &Divisions, out: &mut Vec<Component>) {
        let likelihoods = self.log_likelihoods(cells);
        let components = self.mixture.len();
        let log_weights = self.log_weights(cells, &likelihoods);
        let sum = divisions.sum(&log_weights);
        let mut log_left = 0.0;
        if block.members.len() > 1 {
            log_left = self.superpose(block, z, sum.log_evidence, out);
        }
        for cell in 0..cells.len() {
            let log_share = sum.log_shares[cell] + log_left - log_weights[cell];
            if log_weights[cell] == f64::NEG_INFINITY || sum.log_shares[cell] == f64::NEG_INFINITY {
                continue;
            }
            for j in 0..components {
                let weight = libm::exp(log_share + likelihoods[cell * components + j]);
                if weight > self.update.prune {
                    out.push(self.detected(j, cells, cell, weight));
                }
            }
        }
    }

    /// ln d_W.
    fn log_weights(&self, cells: &Cells, likelihoods: &[f64]) -> Vec<f64> {
        let mut out: Vec<f64> = likelihoods.chunks_exact(self.mixture.len()).map(log_sum).collect();
        for (log_weight, &size) in out.iter_mut().zip(&cells.sizes) {
            if size == 1 {
                *log_weight = log_add(*log_weight, self.log_clutter);
            }
        }
        out
    }

    /// ln L_Wj, cell by cell.
    fn log_likelihoods(&self, cells: &Cells) -> Vec<f64> {
        let m = self.dims();
        let (mut scratch, mut y) = (vec![0.0; m], vec![0.0; m]);
        let log_detected = libm::log(self.sight.detection_probability);
        let priors: Vec<f64> = self
            .mixture
            .iter()
            .map(|c| libm::log(c.weight) + log_detected)
            .collect();
        let mut out = Vec::with_capacity(cells.len() * self.mixture.len());
        for cell in 0..cells.len() {
            let size = cells.sizes[cell];
            let n = size as f64;
            let common = -0.5 * (n * self.noise.log_volume + cells.scatters[cell]);
            for ((seen, counts), prior) in self.seen.iter().zip(&self.log_counts).zip(&priors) {
                seen.view
                    .offset(self.sight.sensor, cells.mean(cell), &mut scratch, &mut y);
                let scatter = seen.log_scatter(size, cells.matrix(cell)).unwrap_or(common);
                out.push(prior + counts[size] + scatter + seen.view.log_density(&y, n));
            }
        }
        out
    }

    /// Component j updated by a cell.
    fn detected(&self, j: usize, cells: &Cells, cell: usize, weight: f64) -> Component {
        let y = self.offsets(j, cells.mean(cell));
        self.updated(j, &y, cells.sizes[cell] as f64, cells.matrix(cell), weight)
    }

    fn updated(&self, j: usize, y: &[f64], count: f64, scatter: &[f64], weight: f64) -> Component {
        let (component, seen) = (self.mixture[j], &self.seen[j]);
        let extent = component.extent.as_ref();
        let Posterior { state, rooted } = seen.view.posterior(&component.state, y, count);
        Component {
            weight,
            state,
            rate: self.update.rates.detected(component.rate, count),
            extent: extent.map(|extent| seen.extent_after(extent, count, scatter)),
            label: component.label,
            rooted: component.rooted || rooted,
        }
    }

    fn members(&self, components: &[usize], z: &[f64]) -> Vec<Member<'_>> {
        let member = |&j: &usize| Member {
            offsets: self.offsets(j, z),
            spread: &self.seen[j].view.spread,
            rate: self.mixture[j].rate.mean(),
            existence: Member::existence(self.mixture[j].weight),
            log_volume: self.seen[j].view.log_volume,
            scattered: self.seen[j].spread.is_some(),
        };
        components.iter().map(member).collect()
    }

    fn verdict(&self, components: &[usize], z: &[f64], log_evidence: f64) -> Verdict {
        let model = Superposition {
            log_clutter: self.log_clutter,
            detection_probability: self.sight.detection_probability,
            dims: self.dims(),
        };
        let worth = |member: usize, found: &Found| self.seen[components[member]].worth(found);
        model.weigh(&self.members(components, z), log_evidence, &worth)
    }

    /// Adds the components of the hypotheses of a group; what is left to the partitions is returned as its logarithm.
    fn superpose(&self, block: &Block, z: &[f64], log_evidence: f64, out: &mut Vec<Component>) -> f64 {
        let verdict = self.verdict(&block.members, z, log_evidence);
        for hypothesis in &verdict.hypotheses {
            let weight = libm::exp(hypothesis.log_weight);
            if weight <= self.update.prune {
                continue;
            }
            let mut found = hypothesis.found.iter();
            for (&j, detected) in block.members.iter().zip(&hypothesis.detected) {
                match detected.then(|| found.next()).flatten() {
                    Some(found) if found.count > 0.0 => {
                        let scatter = self.seen[j].scatter(found);
                        out.push(self.updated(j, &found.mean, found.count, &scatter, weight));
                    }
                    Some(_) => {}
                    None => {
                        let missed = 1.0 - self.sight.detection_probability;
                        let r = Member::existence(self.mixture[j].weight);
                        out.push(Component {
                            weight: weight * r * missed / (1.0 - r * self.sight.detection_probability),
                            ..(*self.mixture[j]).clone()
                        });
                    }
                }
            }
        }
        verdict.log_partitioned
    }
}

/// The measurements with their angles continuous: counted on from the far side of the largest gap between any two, so that
/// differences and means of neighbours need no wrapping.
pub(crate) fn unwrapped(measurements: &[f64], m: usize, angles: &[usize]) -> Vec<f64> {
    use std::f64::consts::TAU;
    let mut out = measurements.to_vec();
    for &angle in angles {
        for value in out.iter_mut().skip(angle).step_by(m) {
            *value = wrap_angle(*value);
        }
        let mut values: Vec<f64> = out.iter().skip(angle).step_by(m).copied().collect();
        values.sort_by(f64::total_cmp);
        let (Some(&first), Some(&last)) = (values.first(), values.last()) else {
            continue;
        };
        let mut largest = (first + TAU - last, first);
        for pair in values.windows(2) {
            if pair[1] - pair[0] > largest.0 {
                largest = (pair[1] - pair[0], pair[1]);
            }
        }
        for value in out.iter_mut().skip(angle).step_by(m) {
            if *value < largest.1 {
                *value += TAU;
            }
        }
    }
    out
}

#[cfg(test)]
mod golden;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_counted_on_from_the_largest_gap() {
        let z = unwrapped(&[5.0, 3.1, 6.0, -3.1, 7.0, 2.9], 2, &[1]);
        assert!((z[3] - (std::f64::consts::TAU - 3.1)).abs() < 1e-15);
        assert_eq!((z[1], z[5], z[0]), (3.1, 2.9, 5.0));
        assert_eq!(unwrapped(&[1.0, 2.0], 2, &[]), [1.0, 2.0]);
        // Bearings of different turns are the same places.
        let turned = unwrapped(&[3.1 - std::f64::consts::TAU, 3.0], 1, &[0]);
        assert!((turned[0] - 3.1).abs() < 1e-14 && turned[1] == 3.0, "{turned:?}");
    }
}
