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
use super::look::{Look, Row, Taker};
use super::multi_target::MultiTargetTracker;
use super::workspace::Bench;
use crate::association::npda::{Npda, betas, partial_update};
use crate::association::odds::shares;
use crate::error::Result;
use crate::event::EventCode;
use crate::gating::mahalanobis::GatedPair;
use crate::model::Motion;

impl MultiTargetTracker {
    /// Takes in the reports of a scan; the tracks stand at `start` seconds before and at the scan's time after it.
    pub(super) fn associate_in_turn(
        &mut self,
        look: &mut Look,
        bench: &mut Bench,
        npda: &Npda,
        start: f64,
    ) -> Result<()> {
        let mut hit = vec![false; self.tracks.len()];
        // What is expected of a track holds until it is predicted or updated.
        let mut known = vec![false; self.tracks.len()];
        let mut gating = Vec::new();
        let mut now = start;
        for row in 0..look.rows.len() {
            let time = look.rows[row].time;
            if time != now {
                self.advance(now, time)?;
                now = time;
                known.fill(false);
            }
            self.gate_row(look, bench, row, Group::Confirmed, &mut known, &mut gating)?;
            look.fates[row].near_confirmed = !gating.is_empty();
            if gating.is_empty() {
                self.gate_row(look, bench, row, Group::Tentative, &mut known, &mut gating)?;
            }
            for &track in &gating {
                known[track] = false;
            }
            self.share_out(look, bench, row, npda, &gating, &mut hit)?;
        }
        self.advance(now, look.scan.time)?;
        for (track, hit) in self.tracks.iter_mut().zip(hit) {
            track.looked_at(look.sensor_index, hit);
        }
        Ok(())
    }

    /// Finds the tracks of a group that gate a report; their pairs are those of the bench.
    fn gate_row(
        &mut self,
        look: &Look,
        bench: &mut Bench,
        row: usize,
        group: Group,
        known: &mut [bool],
        gating: &mut Vec<usize>,
    ) -> Result<()> {
        bench.clear();
        gating.clear();
        for (track, live) in self.tracks.iter().enumerate() {
            // What has lost its numbers on the way takes no further part.
            if !group.holds(live) || !live.is_finite() {
                continue;
            }
            match bench.gate_row(track, known[track], &live.state, row, look) {
                Ok(()) => known[track] = true,
                Err(error) => self
                    .intake
                    .record(look.scan, EventCode::TrackSkipped, Some(row), &error.to_string())?,
            }
            gating.resize(bench.pairs.len(), track);
        }
        Ok(())
    }

    fn share_out(
        &mut self,
        look: &mut Look,
        bench: &mut Bench,
        row: usize,
        npda: &Npda,
        gating: &[usize],
        hit: &mut [bool],
    ) -> Result<()> {
        let logs = |of: fn(&GatedPair) -> f64| -> Vec<f64> { bench.pairs.iter().map(of).collect() };
        let betas = if let Some(p) = npda.clutter_probability {
            betas(&logs(|pair| pair.log_likelihood), p)
        } else {
            let odds = self.config.odds(&look.scan.sensor);
            shares(&logs(|pair| pair.log_density), odds.log_clutter())
        };
        let explained: f64 = betas.iter().sum();
        let best = betas.iter().copied().fold(1.0 - explained, f64::max);
        let Row { time, value } = look.rows[row];
        let space = self.config.motion.space();
        let mut largest = 0.0;
        let pairs = std::mem::take(&mut bench.pairs);
        for ((&track, beta), pair) in gating.iter().zip(betas).zip(&pairs) {
            let live = &mut self.tracks[track];
            if bench.update(track, &live.state, &look.sensor, value.as_slice())? {
                live.rooted.again();
            }
            let updated = partial_update(&space, &live.state, &bench.posterior, beta, npda.covariance);
            live.update_from(&updated, time);
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
            live.hit_by(look, row, pair.nis);
            hit[track] = true;
        }
        bench.pairs = pairs;
        look.fates[row].explained = explained;
        Ok(())
    }
}
