//! Tracks from an intensity: scans in, confirmed tracks out, by a mixture of Gaussians whose weights add to the expected number
//! of targets.
//!
//! For each scan:
//! 1. its rows are checked; what is refused becomes an event, and every row is booked in the ledger. A row with a missing
//!    component is refused, as is a scan whose reports have times of their own;
//! 2. if time has passed, targets survive, move, spawn and are born ([`crate::rfs::prediction`]);
//! 3. the scan updates the mixture ([`crate::rfs::extended_gm_phd`], [`crate::rfs::gm_phd`], [`crate::rfs::cphd`]), which is then reduced ([`crate::rfs::mixture`]);
//! 4. targets are extracted and get their labels (`labels.rs`); of every label it is told once that steps are done by roots;
//! 5. with adaptive birth, measurements that no component of weight gates leave births for the next scan: one in the middle of
//!    each set of them that hangs together.
//!
//! Reference: extended-target spec 3 to 5 and 10; Ristic, Clark, Vo, Vo (2012), Adaptive target birth intensity for PHD and
//! CPHD filters, IEEE TAES 48(2), for 5, here with cells in place of single measurements.

pub mod config;
pub mod engine;
mod labels;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use self::config::{AdaptiveBirth, IntensityUpdate, PhdConfig, Watch};
use self::labels::Labels;
use super::engine::Engine;
use super::intake::{Intake, Needs};
use super::lifecycle::start_state;
use super::look::Row;
use crate::error::{Error, Result, require_finite, require_non_negative, require_size};
use crate::event::{EventCode, EventLog, Ledger};
use crate::filter::extended::expect;
use crate::filter::kalman::predict_each;
use crate::model::{Motion, Sensor};
use crate::partition::distance::{DistancePartition, Thresholds};
use crate::partition::{Partition, Partitioner, Points};
use crate::rfs::Sight;
use crate::rfs::cphd::{Cardinality, CphdUpdate};
use crate::rfs::extended_gm_phd::unwrapped;
use crate::rfs::mixture::{Component, Merged};
use crate::rfs::prediction::{Birth, fresh};
use crate::rfs::spread::SpreadSensor;
use crate::scan::Scan;
use crate::state;
use crate::stats::chi_square;
use crate::track::Track;

/// Components below this weight explain no measurement.
const EXPLAINS: f64 = 0.1;
/// Measurements hang together up to this quantile of the distance of two of one target.
const LINK: f64 = 0.8;
/// Gate in which a component explains measurements.
const GATE: f64 = 0.999;

/// The tracker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PhdTracker {
    config: PhdConfig,
    intake: Intake,
    mixture: Vec<Component>,
    tracks: Vec<Track>,
    labels: Labels,
    pending: Vec<Birth>,
    cardinality: Option<Cardinality>,
}

impl PhdTracker {
    /// A tracker that has seen nothing yet.
    pub fn new(config: PhdConfig) -> Result<Self> {
        config.check()?;
        Ok(Self {
            intake: Intake::new(None, config.strict),
            mixture: Vec::new(),
            tracks: Vec::new(),
            labels: Labels::default(),
            pending: Vec::new(),
            cardinality: match &config.update {
                IntensityUpdate::Cardinalised(update) => Some(Cardinality::none(update.max_targets)),
                IntensityUpdate::Extended(_) | IntensityUpdate::Point(_) => None,
            },
            config,
        })
    }

    /// A tracker that knows of targets at a time; each may be there or not, with its weight.
    pub fn starting(config: PhdConfig, targets: &[Birth], time: f64) -> Result<Self> {
        let mut tracker = Self::new(config)?;
        require_finite("initial time", [&time])?;
        for target in targets {
            require_non_negative("initial weight", target.weight)?;
            require_size("initial state", tracker.config.motion.state_dim(), target.state.dim())?;
            tracker.mixture.push(Component {
                weight: target.weight,
                state: target.state.clone(),
                rate: tracker.config.fate.birth_rate,
                extent: tracker.config.update.extent().map(|model| model.prior.clone()),
                label: fresh(&mut tracker.labels.next_label),
                rooted: false,
            });
        }
        if let IntensityUpdate::Cardinalised(update) = &tracker.config.update {
            let weights: Vec<f64> = targets.iter().map(|target| target.weight).collect();
            tracker.cardinality = Some(Cardinality::independent(&weights, update.max_targets));
        }
        tracker.intake.time = Some(time);
        Ok(tracker)
    }

    /// What defines it.
    pub fn config(&self) -> &PhdConfig {
        &self.config
    }

    /// What was refused or repaired so far.
    pub fn events(&self) -> &EventLog {
        &self.intake.events
    }

    /// Where every row went so far.
    pub fn ledger(&self) -> &Ledger {
        &self.intake.ledger
    }

    /// The intensity after the last scan.
    pub fn mixture(&self) -> &[Component] {
        &self.mixture
    }

    /// Expected number of targets after the last scan.
    pub fn expected_targets(&self) -> f64 {
        self.mixture.iter().map(|component| component.weight).sum()
    }

    /// Length of the measured position, where extents are learnt.
    pub fn extent_dims(&self) -> Option<usize> {
        self.config.update.extent().map(|model| model.prior.cov.nrows())
    }

    /// Distribution of the number of targets, where the filter carries it.
    pub fn cardinality(&self) -> Option<&Cardinality> {
        self.cardinality.as_ref()
    }

    /// Whether a run over these scans would be accepted: known sensors, finite times that never decrease.
    pub fn check_run(&self, scans: &[Scan]) -> Result<()> {
        Engine::check_run(self, scans, self.intake.time)
    }

    /// Takes in all scans, which must be in the order of their times, and returns the confirmed tracks after each.
    pub fn run(&mut self, scans: &[Scan]) -> Result<Vec<Vec<Track>>> {
        self.check_run(scans)?;
        let tracks = scans.iter().map(|scan| self.step(scan)).collect::<Result<_>>()?;
        self.intake.ledger.check()?;
        Ok(tracks)
    }

    /// Takes in one scan and returns the confirmed tracks at its time: those whose targets are extracted. A scan that cannot be
    /// used leaves everything as it was and is recorded as an event.
    pub fn step(&mut self, scan: &Scan) -> Result<Vec<Track>> {
        self.update(scan)?;
        Ok(self.tracks.clone())
    }

    /// The confirmed tracks after the last scan.
    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// Takes in one scan; the tracks are those of [`Self::tracks`].
    pub fn update(&mut self, scan: &Scan) -> Result<()> {
        let watch = self.config.watch(&scan.sensor);
        let sensor = watch.map(|watch| &watch.sensor).map_err(|unknown| unknown.to_string());
        let Some(rows) = self.intake.admit(scan, sensor, Needs::Everything)? else {
            return Ok(());
        };
        self.predict(scan)?;
        let platform = scan.platform.as_ref().map(|p| DVector::from_row_slice(p));
        let measurements = flat(&rows);
        let watch = self.config.watch(&scan.sensor)?;
        let sight = Sight {
            sensor: &watch.sensor,
            platform: platform.as_ref(),
            rule: self.config.filter.rule(),
            detection_probability: watch.detection_probability,
            clutter_density: watch.clutter_density,
        };
        let mixture = &mut self.mixture;
        let skipped = match (&self.config.update, &mut self.cardinality) {
            (IntensityUpdate::Extended(update), _) => update.update(mixture, &measurements, &sight)?,
            (IntensityUpdate::Cardinalised(update), Some(cardinality)) => {
                update.update(mixture, cardinality, &measurements, &sight)?
            }
            (IntensityUpdate::Point(point) | IntensityUpdate::Cardinalised(CphdUpdate { point, .. }), _) => {
                point.update(mixture, &measurements, &sight)?
            }
        };
        if skipped > 0 {
            let reason = format!("{skipped} components cannot be compared with the scan");
            self.intake.record(scan, EventCode::TrackSkipped, None, &reason)?;
        }
        self.drop_diverged(scan)?;
        let merged = self.config.reduction.reduce(std::mem::take(&mut self.mixture));
        let copies = match &self.cardinality {
            None => merged.iter().map(|m| m.component.copies()).collect(),
            Some(cardinality) => heaviest(&merged, cardinality.mode()),
        };
        let extraction = self
            .labels
            .extract(merged, &copies, scan.time, self.config.confirmation);
        self.mixture = extraction.mixture;
        self.tracks = extraction.tracks;
        if let Some(rule) = self.config.adaptive_birth {
            let watch = self.config.watch(&scan.sensor)?;
            self.pending = self.unexplained(&rule, watch, platform.as_ref(), &measurements)?;
        }
        self.tell_rooted(scan)
    }

    /// Tells of every target once that steps of it are done by roots.
    fn tell_rooted(&mut self, scan: &Scan) -> Result<()> {
        let targets = self.labels.newly_rooted(&self.mixture);
        targets.into_iter().try_for_each(|id| self.intake.tell_rooted(scan, id))
    }

    fn predict(&mut self, scan: &Scan) -> Result<()> {
        let PhdConfig {
            motion, filter, fate, ..
        } = &self.config;
        let (rule, before) = (filter.rule(), self.intake.time.replace(scan.time));
        let dt = before.map_or(0.0, |before| scan.time - before);
        if before.is_some() && dt == 0.0 {
            return Ok(());
        }
        let next_label = &mut self.labels.next_label;
        let mut born = std::mem::take(&mut self.pending);
        let states = predict_each(rule, born.iter().map(|birth| &birth.state), motion, dt)?.states;
        for (birth, state) in born.iter_mut().zip(states.iter()) {
            birth.state = state;
        }
        let mixture = &mut self.mixture;
        fate.survive(mixture, motion, rule, self.config.update.rates(), dt, next_label)?;
        fate.bear(mixture, &born, next_label);
        if let Some(cardinality) = &mut self.cardinality {
            let births = fate.births.iter().chain(&born).map(|birth| birth.weight).sum();
            *cardinality = cardinality.predicted(fate.survival_probability, births);
        }
        if let Some(extent) = self.config.update.extent() {
            extent.predict(mixture, dt);
        }
        self.drop_diverged(scan)
    }

    fn drop_diverged(&mut self, scan: &Scan) -> Result<()> {
        // A sum is finite only if all its terms are.
        let sum = |numbers: &[f64]| numbers.iter().sum::<f64>();
        let state = |c: &Component| sum(c.state.mean.as_slice()) + sum(c.state.cov.as_slice());
        let extent = |c: &Component| c.extent.as_ref().map_or(0.0, |e| e.cov.sum() + e.certainty);
        let finite = |c: &Component| (c.weight + state(c) + extent(c)).is_finite();
        let before = self.mixture.len();
        self.mixture.retain(finite);
        if self.mixture.len() == before {
            return Ok(());
        }
        let reason = format!("{} components are not finite", before - self.mixture.len());
        self.intake.record(scan, EventCode::TrackDiverged, None, &reason)
    }

    /// Births in the middle of measurements that nothing explains.
    fn unexplained(
        &self,
        rule: &AdaptiveBirth,
        watch: &Watch,
        platform: Option<&DVector<f64>>,
        measurements: &[f64],
    ) -> Result<Vec<Birth>> {
        let m = watch.sensor.measurement_dim().max(1);
        let gate = chi_square::quantile(GATE, m)?;
        let mut free = vec![true; measurements.len() / m];
        for component in self.mixture.iter().filter(|c| c.weight >= EXPLAINS) {
            let spread = SpreadSensor::of(&watch.sensor, component.extent.as_ref());
            let expected = expect(&component.state, &spread, platform, self.config.filter.rule());
            let Ok(expected) = expected else {
                continue;
            };
            for (z, free) in measurements.chunks_exact(m).zip(&mut free) {
                let z = DVector::from_column_slice(z);
                let innovation = crate::model::sensor::residual(&watch.sensor, &z, &expected.expected);
                *free = *free && expected.prediction.whiten(&innovation).nis > gate;
            }
        }
        let left: Vec<f64> = measurements
            .chunks_exact(m)
            .zip(&free)
            .filter(|(_, free)| **free)
            .flat_map(|(z, _)| z.iter().copied())
            .collect();
        let left = unwrapped(&left, m, watch.sensor.angles());
        let newborn = self.config.update.extent().map(|extent| &extent.prior);
        let points = Points::whitened(&left, m, &SpreadSensor::of(&watch.sensor, newborn).noise())?;
        // Two measurements of one target differ by noise of twice that covariance.
        let link = libm::sqrt(2.0 * chi_square::quantile(LINK, m)?);
        let cells = DistancePartition {
            thresholds: Thresholds::Range {
                lower: link,
                upper: link,
            },
            ..DistancePartition::default()
        };
        let mut births = Vec::new();
        for cell in cells.partitions(&points)?.iter().flat_map(Partition::cells) {
            if cell.len() < rule.min_measurements {
                continue;
            }
            let mut mean = DVector::zeros(m);
            for &i in &cell {
                mean += DVector::from_column_slice(&left[i * m..(i + 1) * m]) / cell.len() as f64;
            }
            if let Some(position) = watch.sensor.locate(&mean, platform) {
                births.push(Birth {
                    weight: rule.weight,
                    state: start_state(&position, &self.config.motion, rule.max_speed),
                });
            }
        }
        Ok(births)
    }

    /// Saves the tracker with everything it knows; see [`crate::state`].
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        state::to_bytes(self)
    }

    /// A tracker that goes on, bit for bit, where the saved one stood.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let mut tracker: Self = state::from_bytes(bytes)?;
        tracker.check_restored().map_err(|error| Error::CorruptState {
            reason: error.to_string(),
        })?;
        Ok(tracker)
    }
}

/// How many targets each component stands for, if there are `targets` of them: one after the other goes to the component that
/// has the most weight per target.
fn heaviest(merged: &[Merged], targets: usize) -> Vec<usize> {
    let mut copies = vec![0; merged.len()];
    for _ in 0..targets {
        let left = |i: usize| merged[i].component.weight / (copies[i] + 1) as f64;
        let best = (0..merged.len()).max_by(|&a, &b| left(a).total_cmp(&left(b)).then(b.cmp(&a)));
        let Some(best) = best else { break };
        copies[best] += 1;
    }
    copies
}

fn flat(rows: &[Row<'_>]) -> Vec<f64> {
    rows.iter().flat_map(|row| row.value.iter().copied()).collect()
}
