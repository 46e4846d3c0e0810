//! The reports of a scan one after the other, each shared out among the tracks at its own time (NPDA).
//!
//! For each report, in the order of their times:
//! 1. all tracks are predicted to its time, from where they stand or (N13, `paper`) from their last update;
//! 2. it is shared out among the confirmed tracks that gate it (N9, N10, N17), which are updated in part (N11, N12);
//! 3. if no confirmed track gates it, the same among tentative tracks; if none does, it may start a track (N14).
//!
//! Reports of one time come with d = 0, in the order of the rows: one track may have several of them.
//! A scan is a hit for a track that explains one of its reports at least half as well as whatever explains it best.
//!
//! Reference: [`crate::association::npda`].

use super::joint::Group;
use super::look::{Look, Taker};
use super::multi_target::MultiTargetTracker;
use crate::association::npda::{Npda, betas, partial_update};
use crate::association::odds::shares;
use crate::error::Result;
use crate::event::EventCode;
use crate::filter::extended::Linearised;
use crate::gating::mahalanobis::{Expectation, GatedPair, gate};
use crate::gaussian::Gaussian;
use crate::model::{Motion, Sensor};

/// A track that gates the report.
struct Gating {
    track: usize,
    prior: Gaussian,
    linearised: Linearised,
    pair: GatedPair,
}

impl MultiTargetTracker {
    /// Takes in the reports of a scan; the tracks stand at `start` seconds before and at the scan's time after it.
    pub(super) fn associate_in_turn(&mut self, look: &mut Look, npda: &Npda, start: f64) -> Result<()> {
        let mut hit = vec![false; self.tracks.len()];
        let mut now = start;
        for row in 0..look.rows.len() {
            let time = look.rows[row].time;
            self.advance(now, time)?;
            now = time;
            let mut gating = self.gating(look, row, Group::Confirmed)?;
            look.fates[row].near_confirmed = !gating.is_empty();
            if gating.is_empty() {
                gating = self.gating(look, row, Group::Tentative)?;
            }
            self.share_out(look, row, npda, gating, &mut hit)?;
        }
        self.advance(now, look.scan.time)?;
        for (track, hit) in self.tracks.iter_mut().zip(hit) {
            track.windows[look.sensor_index].push(hit);
        }
        Ok(())
    }

    /// Predicts all tracks from one time to another.
    pub(super) fn advance(&mut self, from: f64, to: f64) -> Result<()> {
        for track in &mut self.tracks {
            track.state = track.ahead(self.config.filter, &self.config.motion, from, to)?;
        }
        Ok(())
    }

    fn gating(&mut self, look: &Look, row: usize, group: Group) -> Result<Vec<Gating>> {
        let thresholds = self.config.gate.thresholds(look.sensor.measurement_dim())?;
        let reports = std::slice::from_ref(look.rows[row].value);
        let mut out = Vec::new();
        for track in group.members(&self.tracks) {
            let prior = self.tracks[track].state.clone();
            let expected = self.config.filter.expect(&prior, &look.sensor, look.platform.as_ref());
            let gated = expected.and_then(|linearised| {
                let expectation = Expectation { prior, linearised };
                let gated = gate(&expectation, &look.sensor, reports, &thresholds)?;
                Ok((expectation, gated))
            });
            match gated {
                Ok((Expectation { prior, linearised }, gated)) => {
                    out.extend(gated.pairs.into_iter().map(|pair| Gating {
                        track,
                        prior: prior.clone(),
                        linearised: linearised.clone(),
                        pair,
                    }));
                }
                Err(error) => self
                    .intake
                    .record(look.scan, EventCode::TrackSkipped, Some(row), &error.to_string())?,
            }
        }
        Ok(out)
    }

    fn share_out(
        &mut self,
        look: &mut Look,
        row: usize,
        npda: &Npda,
        gating: Vec<Gating>,
        hit: &mut [bool],
    ) -> Result<()> {
        let betas = if let Some(p) = npda.clutter_probability {
            betas(&log_likelihoods(&gating, |pair| pair.log_likelihood), p)
        } else {
            let odds = self.config.odds(&look.scan.sensor);
            shares(&log_likelihoods(&gating, |pair| pair.log_density), odds.log_clutter())
        };
        let explained: f64 = betas.iter().sum();
        let best = betas.iter().copied().fold(1.0 - explained, f64::max);
        let time = look.rows[row].time;
        let space = self.config.motion.space();
        let mut largest = 0.0;
        for (
            Gating {
                track,
                prior,
                linearised,
                pair,
            },
            beta,
        ) in gating.into_iter().zip(betas)
        {
            let updated = linearised.prediction.update(&prior, &pair.innovation)?.posterior;
            let live = &mut self.tracks[track];
            live.update(partial_update(&space, &prior, &updated, beta, npda.covariance), time);
            if beta > largest && explained >= 0.5 {
                largest = beta;
                look.fates[row].taker = Some(Taker {
                    track,
                    confirmed: live.id.is_some(),
                });
            }
            if beta < 0.5 * best {
                continue;
            }
            live.last_hit = time;
            live.hits += 1;
            hit[track] = true;
            if let Some(position) = &look.positions[row] {
                live.start.add(position.mean.as_slice());
            }
        }
        look.fates[row].explained = explained;
        Ok(())
    }
}

fn log_likelihoods(gating: &[Gating], of: impl Fn(&GatedPair) -> f64) -> Vec<f64> {
    gating.iter().map(|gating| of(&gating.pair)).collect()
}
