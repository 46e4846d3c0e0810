//! Memory that serves a tracker scan after scan. Nothing in it outlives a scan but its size, and what is the same for every
//! scan of a sensor.

use nalgebra::{DMatrix, DVector};

use super::config::TrackerConfig;
use super::health::Limits;
use super::live::LiveTrack;
use super::look::Look;
use crate::error::Result;
use crate::filter::correction::Scratch;
use crate::filter::extended::{Expecting, Linearised};
use crate::filter::prediction::Prediction;
use crate::filter::square_root::Form;
use crate::gating::mahalanobis::{GatedPair, Gating};
use crate::gating::sweep::Sweep;
use crate::gaussian::Gaussian;
use crate::model::sensor::residual_into;
use crate::model::{Motion, Sensor, SensorModel};

/// Ended tracks whose memory is kept.
const MOST_SPARE: usize = 4096;

/// All of it.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    prediction: Option<Prediction>,
    /// By the sensor's place in the configuration.
    bench: Vec<Option<Box<Bench>>>,
    /// Tracks that have ended, for those that begin.
    spare: Vec<LiveTrack>,
    /// What is expected of the updates of healthy tracks.
    pub(super) limits: Option<Limits>,
}

/// A tracker that is copied begins with memory of its own.
impl Clone for Workspace {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Workspace {
    /// What predicts the tracks.
    pub(super) fn prediction(&mut self, config: &TrackerConfig) -> &mut Prediction {
        self.prediction
            .get_or_insert_with(|| Prediction::new(config.motion.space(), config.filter.rule(), Form::Joseph))
    }

    /// Takes in the tracks that do not stay; the others keep their order.
    pub(super) fn recycle(&mut self, tracks: &mut Vec<LiveTrack>, mut stays: impl FnMut(&LiveTrack) -> bool) {
        let mut kept = 0;
        for index in 0..tracks.len() {
            if stays(&tracks[index]) {
                if kept < index {
                    tracks.swap(kept, index);
                }
                kept += 1;
            }
        }
        self.spare.extend(tracks.drain(kept..));
        self.spare.truncate(MOST_SPARE);
    }

    /// Memory for a track.
    pub(super) fn blank(&mut self, config: &TrackerConfig) -> LiveTrack {
        let new = || LiveTrack::blank(config.motion.state_dim());
        self.spare.pop().unwrap_or_else(new)
    }

    /// The bench of a sensor, to be given back by [`Self::put_back`].
    pub(super) fn bench(&mut self, config: &TrackerConfig, index: usize, sensor: &SensorModel) -> Result<Box<Bench>> {
        if self.bench.len() <= index {
            self.bench.resize_with(index + 1, || None);
        }
        self.bench[index].take().map_or_else(|| Bench::new(config, sensor), Ok)
    }

    pub(super) fn put_back(&mut self, index: usize, bench: Box<Bench>) {
        self.bench[index] = Some(bench);
    }
}

/// A track that the sensor of a scan may have seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Member {
    pub(super) track: usize,
    /// Where its expectations begin.
    pub(super) slot: usize,
    /// Where its pairs begin and end.
    pub(super) pairs: (usize, usize),
    pub(super) edge_log_likelihood: f64,
}

/// Tracks and reports of one sensor's scan, compared.
#[derive(Debug)]
pub(super) struct Bench {
    expecting: Expecting,
    pub(super) gating: Gating,
    /// What is expected of tracks, and the first that is free.
    slots: Vec<Linearised>,
    pub(super) next_slot: usize,
    /// The reports of every epoch.
    pub(super) sweeps: Vec<Sweep>,
    pub(super) members: Vec<Member>,
    pub(super) pairs: Vec<GatedPair>,
    /// Epoch of each pair.
    pub(super) epochs: Vec<usize>,
    innovation: DVector<f64>,
    scratch: Scratch,
    /// The last update.
    pub(super) posterior: Gaussian,
}

impl Bench {
    fn new(config: &TrackerConfig, sensor: &SensorModel) -> Result<Box<Self>> {
        let (n, m) = (config.motion.state_dim(), sensor.measurement_dim());
        Ok(Box::new(Self {
            expecting: Expecting::new(n, sensor, config.filter.rule())?,
            gating: Gating::new(config.gate.thresholds(m)?),
            slots: Vec::new(),
            next_slot: 0,
            sweeps: Vec::new(),
            members: Vec::new(),
            pairs: Vec::new(),
            epochs: Vec::new(),
            innovation: DVector::zeros(m),
            scratch: Scratch::default(),
            posterior: Gaussian {
                mean: DVector::zeros(n),
                cov: DMatrix::zeros(n, n),
            },
        }))
    }

    /// Forgets what was compared.
    pub(super) fn clear(&mut self) {
        self.members.clear();
        self.pairs.clear();
        self.epochs.clear();
        self.next_slot = 0;
    }

    /// Adds the pairs of an estimate and the reports of an epoch that no track has taken, and keeps what is expected of it in
    /// this slot if it has any, or is to be kept `anyway`.
    pub(super) fn gate_reports(
        &mut self,
        slot: usize,
        anyway: bool,
        prior: &Gaussian,
        epoch: usize,
        look: &Look,
    ) -> Result<()> {
        let Self {
            expecting,
            gating,
            pairs,
            sweeps,
            ..
        } = self;
        let before = pairs.len();
        let expected = expecting.of(prior, &look.sensor, look.platform.as_ref())?;
        gating.look(expected, &look.sensor);
        for report in sweeps[epoch].near(expected.expected.as_slice(), gating.half_widths()) {
            if look.fates[report].taker.is_none() {
                let measured = look.rows[report].value.as_slice();
                gating.try_pair(expected, &look.sensor, report, measured, pairs)?;
            }
        }
        // In the order of the reports.
        pairs[before..].sort_unstable_by_key(|pair| pair.report);
        if anyway || pairs.len() > before {
            self.keep(slot);
        }
        Ok(())
    }

    /// Adds the pair of an estimate and one report, if its gate holds it. What is expected is found anew unless the slot has it.
    pub(super) fn gate_row(
        &mut self,
        slot: usize,
        known: bool,
        prior: &Gaussian,
        row: usize,
        look: &Look,
    ) -> Result<()> {
        if !known {
            self.expecting.of(prior, &look.sensor, look.platform.as_ref())?;
            self.keep(slot);
        }
        let expected = &self.slots[slot];
        self.gating.look(expected, &look.sensor);
        let measured = look.rows[row].value.as_slice();
        self.gating
            .try_pair(expected, &look.sensor, row, measured, &mut self.pairs)
    }

    fn keep(&mut self, slot: usize) {
        if self.slots.len() <= slot {
            self.slots.resize_with(slot + 1, || self.expecting.slot());
        }
        self.expecting.keep(&mut self.slots[slot]);
    }

    /// ln N on the edge of the gate of that track.
    pub(super) fn edge_log_likelihood(&mut self, slot: usize) -> f64 {
        self.gating.edge_log_likelihood(&self.slots[slot])
    }

    /// Updates an estimate of which `slot` holds what was expected; the result is in `posterior`. Whether it was done by roots,
    /// because it would be nearly singular.
    pub(super) fn update(
        &mut self,
        slot: usize,
        prior: &Gaussian,
        sensor: &SensorModel,
        measured: &[f64],
    ) -> Result<bool> {
        let Linearised { expected, prediction } = &self.slots[slot];
        residual_into(sensor, measured, expected.as_slice(), self.innovation.as_mut_slice());
        let innovation = self.innovation.as_slice();
        let (scratch, posterior) = (&mut self.scratch, &mut self.posterior);
        if !innovation.iter().any(|r| r.is_nan()) {
            return Ok(prediction.definite_posterior_into(prior, innovation, scratch, posterior));
        }
        let observed: Vec<usize> = (0..innovation.len()).filter(|&i| !innovation[i].is_nan()).collect();
        let innovation: Vec<f64> = observed.iter().map(|&i| innovation[i]).collect();
        let prediction = prediction.select(&observed)?;
        Ok(prediction.definite_posterior_into(prior, &innovation, scratch, posterior))
    }
}
