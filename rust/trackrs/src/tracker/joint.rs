//! The reports of a scan, all at once, given to tracks: every track gets the mixture of its hypotheses (N19).
//!
//! | symbol    | name here  | meaning                                                                    |
//! |-----------|------------|----------------------------------------------------------------------------|
//! | t_1 ≤ … ≤ t_m | `epochs` | times of the reports; the last epoch is the scan's time                  |
//! | x_k, P_k  | `priors`   | the track predicted to epoch k, by steps t_0 → t_1 → …                     |
//! | β_j       | `Shares`   | probability of pair j; [`crate::association`]                              |
//!
//! 1. Every track is predicted to every epoch, and each report gated with the prediction at its own time.
//! 2. Hypothesis j: Kalman update at the report's time, then predicted to the scan's time by the same steps; hypothesis 0:
//!    prediction alone. The track becomes the Gaussian with the moments of the hypotheses, weighted by β.
//! 3. A scan is a hit where it is more likely than not that one of its reports is the track's.
//! 4. With existence (JIPDA), β is conditional on it, and a report is explained by Σ_i r_i β_ij.

use super::live::LiveTrack;
use super::look::{Look, Taker};
use super::multi_target::MultiTargetTracker;
use super::workspace::{Bench, Member};
use crate::association::associator::{Association, Associator};
use crate::association::existence::{Prospect, joint_existence};
use crate::association::jpda::{approximation, candidates};
use crate::association::marginals::Options;
use crate::association::odds::Odds;
use crate::error::Result;
use crate::event::EventCode;
use crate::filter::mixture::{Hypothesis, moment_match};
use crate::gating::mahalanobis::GatedTrack;
use crate::gaussian::Gaussian;
use crate::model::Motion;

/// P_D P_G of a track that surely exists must leave room for a scan in which it is not seen.
const MOST_SEEN: f64 = 1.0 - 1e-12;

/// Which tracks take part.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Group {
    Confirmed,
    Tentative,
    All,
}

impl Group {
    /// Whether it holds a track.
    pub(super) fn holds(self, track: &LiveTrack) -> bool {
        match self {
            Self::Confirmed => track.id.is_some(),
            Self::Tentative => track.id.is_none(),
            Self::All => true,
        }
    }
}

/// The predictions of every track to every epoch of a scan; where there is one epoch, the tracks themselves.
pub(super) struct Priors(pub(super) Vec<Vec<Gaussian>>);

impl Priors {
    fn of<'a>(&'a self, track: usize, epoch: usize, live: &'a LiveTrack) -> &'a Gaussian {
        self.0.get(track).map_or(&live.state, |priors| &priors[epoch])
    }
}

impl Bench {
    /// Puts the reports of a scan in order.
    pub(super) fn sort(&mut self, look: &Look) {
        self.sweeps.resize_with(look.epochs.len(), Default::default);
        for (epoch, sweep) in self.sweeps.iter_mut().enumerate() {
            sweep.set(
                &look.sensor,
                look.rows_of(epoch).map(|row| (row, look.rows[row].value.as_slice())),
            );
        }
    }

    /// Gates a track with the reports that no other has taken.
    fn compare(&mut self, track: usize, live: &LiveTrack, priors: &Priors, look: &Look) -> Result<()> {
        let from = self.pairs.len();
        let first = self.next_slot;
        let mut edge_log_likelihood = f64::NEG_INFINITY;
        let several = look.epochs.len() > 1;
        for epoch in 0..look.epochs.len() {
            let slot = first + epoch;
            self.gate_reports(slot, several, priors.of(track, epoch, live), epoch, look)?;
            self.epochs.resize(self.pairs.len(), epoch);
            if self.pairs.len() > from && epoch + 1 == look.epochs.len() {
                edge_log_likelihood = self.edge_log_likelihood(slot);
            }
        }
        let any = self.pairs.len() > from;
        self.members.push(Member {
            track,
            slot: first,
            pairs: (from, self.pairs.len()),
            edge_log_likelihood,
        });
        // What is expected of a track without a report is not needed again.
        self.next_slot += if any { look.epochs.len() } else { 0 };
        Ok(())
    }

    fn gated(&self) -> Vec<GatedTrack<'_>> {
        let gated = |member: &Member| GatedTrack {
            pairs: &self.pairs[member.pairs.0..member.pairs.1],
            edge_log_likelihood: member.edge_log_likelihood,
        };
        self.members.iter().map(gated).collect()
    }
}

impl MultiTargetTracker {
    /// Gives reports to the tracks of a group and updates them.
    pub(super) fn associate(
        &mut self,
        look: &mut Look,
        bench: &mut Bench,
        priors: &Priors,
        group: Group,
    ) -> Result<()> {
        bench.clear();
        for track in 0..self.tracks.len() {
            let live = &self.tracks[track];
            if !group.holds(live) {
                continue;
            }
            let before = bench.pairs.len();
            if let Err(error) = bench.compare(track, live, priors, look) {
                bench.pairs.truncate(before);
                bench.epochs.truncate(before);
                self.intake
                    .record(look.scan, EventCode::TrackSkipped, None, &error.to_string())?;
            }
        }
        let odds = self.config.odds(&look.scan.sensor);
        let reports = look.rows.len();
        let association = match self.config.associator {
            Associator::Jipda { coalescence_free } => {
                self.with_existence(bench, look, reports, &odds, coalescence_free)?
            }
            associator => associator.associate(&bench.gated(), reports, &odds)?,
        };
        if let Some(how) = &association.approximation {
            self.intake.record(look.scan, EventCode::Approximated, None, how)?;
        }
        let members = std::mem::take(&mut bench.members);
        for (member, &missed) in members.iter().zip(&association.missed) {
            let shares = &association.pairs[member.pairs.0..member.pairs.1];
            self.merge(look, bench, member, missed, shares, priors)?;
            self.hit_or_miss(look, bench, member, shares);
        }
        explain(look, bench, &members, &association.pairs, &self.tracks);
        bench.members = members;
        Ok(())
    }

    /// JIPDA: existence changes with what the scan says, and the shares are those given existence.
    fn with_existence(
        &mut self,
        bench: &Bench,
        look: &Look,
        reports: usize,
        odds: &Odds,
        coalescence_free: bool,
    ) -> Result<Association> {
        let prospect = |(member, gated): (&Member, &GatedTrack)| {
            let track = &self.tracks[member.track];
            // A sensor that has never seen a track says nothing about it by not seeing it.
            let seen = track.windows[look.sensor_index].seen();
            Prospect {
                existence: track.existence.unwrap_or(1.0),
                detection: if seen { odds.seen().min(MOST_SEEN) } else { 0.0 },
                candidates: candidates(gated, odds).collect(),
            }
        };
        let prospects: Vec<Prospect> = bench.members.iter().zip(&bench.gated()).map(prospect).collect();
        let options = Options {
            prune: coalescence_free,
            ..Options::default()
        };
        let found = joint_existence(&prospects, reports, &options)?;
        let mut association = Association {
            approximation: approximation(found.method, found.error_bound),
            ..Association::default()
        };
        for (member, existing) in bench.members.iter().zip(found.tracks) {
            self.tracks[member.track].existence = Some(existing.existence);
            association.push(existing.missed, existing.candidates);
        }
        Ok(association)
    }

    /// Merges the hypotheses of one track at the scan's time.
    fn merge(
        &mut self,
        look: &Look,
        bench: &mut Bench,
        member: &Member,
        missed: f64,
        shares: &[f64],
        priors: &Priors,
    ) -> Result<()> {
        let (epochs, now) = (&look.epochs, look.epochs.len() - 1);
        let count = shares.iter().filter(|&&share| share > 0.0).count();
        let mut hypotheses = Vec::new();
        if count > 0 && missed > 0.0 {
            hypotheses.push(Hypothesis {
                weight: missed,
                state: self.tracks[member.track].state.clone(),
            });
        }
        for (slot, &weight) in shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
            let (pair, epoch) = (bench.pairs[member.pairs.0 + slot], bench.epochs[member.pairs.0 + slot]);
            let live = &mut self.tracks[member.track];
            let prior = priors.of(member.track, epoch, live);
            let measured = look.rows[pair.report].value.as_slice();
            if bench.update(member.slot + epoch, prior, &look.sensor, measured)? {
                live.rooted.again();
            }
            if epoch == now && count == 1 && hypotheses.is_empty() {
                live.update_from(&bench.posterior, look.scan.time);
                return Ok(());
            }
            let mut state = bench.posterior.clone();
            for step in epochs[epoch..].windows(2) {
                state = self
                    .config
                    .filter
                    .predict(&state, &self.config.motion, step[1] - step[0])?;
            }
            hypotheses.push(Hypothesis { weight, state });
        }
        let space = self.config.motion.space();
        let live = &mut self.tracks[member.track];
        match moment_match(&space, &hypotheses) {
            Some(state) => live.update_from(&state, look.scan.time),
            None => live.update_stays(look.scan.time),
        }
        Ok(())
    }

    fn hit_or_miss(&mut self, look: &Look, bench: &Bench, member: &Member, shares: &[f64]) {
        let track = &mut self.tracks[member.track];
        let hit = shares.iter().sum::<f64>() >= 0.5;
        track.looked_at(look.sensor_index, hit);
        let likeliest = (0..shares.len()).max_by(|&a, &b| shares[a].total_cmp(&shares[b]));
        let Some(slot) = likeliest.filter(|_| hit) else {
            return;
        };
        let pair = &bench.pairs[member.pairs.0 + slot];
        track.hit_by(look, pair.report, pair.nis);
    }
}

/// Books which track is the likeliest origin of each report, and how likely it is that some track is.
fn explain(look: &mut Look, bench: &Bench, members: &[Member], shares: &[f64], live: &[LiveTrack]) {
    let mut largest = vec![0.0; look.rows.len()];
    let mut taker: Vec<Option<Taker>> = vec![None; look.rows.len()];
    for member in members {
        let track = &live[member.track];
        let range = member.pairs.0..member.pairs.1;
        for (pair, &share) in bench.pairs[range.clone()].iter().zip(&shares[range]) {
            let report = pair.report;
            let fate = &mut look.fates[report];
            let confirmed = track.id.is_some();
            fate.near_confirmed |= confirmed;
            let weight = share * track.existence.unwrap_or(1.0);
            fate.explained += weight;
            if weight > largest[report] {
                largest[report] = weight;
                taker[report] = Some(Taker {
                    track: member.track,
                    confirmed,
                });
            }
        }
    }
    for (fate, taker) in look.fates.iter_mut().zip(taker) {
        if fate.taker.is_none() {
            fate.taker = taker.filter(|_| fate.explained >= 0.5);
        }
    }
}
