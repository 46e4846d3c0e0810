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

use nalgebra::DVector;

use super::live::LiveTrack;
use super::look::{Look, Taker};
use super::multi_target::MultiTargetTracker;
use crate::association::associator::{Association, Associator, Shares};
use crate::association::existence::{Prospect, joint_existence};
use crate::association::jpda::{approximation, candidates};
use crate::association::marginals::Options;
use crate::association::odds::Odds;
use crate::error::Result;
use crate::event::EventCode;
use crate::filter::mixture::{Hypothesis, moment_match};
use crate::gating::mahalanobis::{Expectation, GatedTrack, gate};
use crate::gaussian::Gaussian;
use crate::model::{Motion, Sensor};

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
    /// The tracks that it holds, leaving out what has lost its numbers.
    pub(super) fn members(self, tracks: &[LiveTrack]) -> Vec<usize> {
        let holds = |track: &LiveTrack| match self {
            Self::Confirmed => track.id.is_some(),
            Self::Tentative => track.id.is_none(),
            Self::All => true,
        };
        let numbered = tracks.iter().enumerate();
        let members = numbered.filter(|(_, track)| holds(track) && track.is_finite());
        members.map(|(index, _)| index).collect()
    }
}

/// A track seen by the sensor of a scan.
struct Member {
    track: usize,
    /// What it expects at every epoch with reports.
    expectations: Vec<Expectation>,
    gated: GatedTrack,
    /// Epoch of each gated pair.
    epochs: Vec<usize>,
}

impl MultiTargetTracker {
    /// Gives reports to the tracks of a group and updates them. `priors` holds, track by track, the predictions to every
    /// epoch of the scan.
    pub(super) fn associate(&mut self, look: &mut Look, priors: &[Vec<Gaussian>], group: Group) -> Result<()> {
        let epochs = look.epochs();
        let open: Vec<usize> = (0..look.rows.len())
            .filter(|&row| look.fates[row].taker.is_none())
            .collect();
        let mut members = Vec::new();
        for track in group.members(&self.tracks) {
            match self.compare(look, &priors[track], &epochs, &open) {
                Ok(member) => members.push(Member { track, ..member }),
                Err(error) => self
                    .intake
                    .record(look.scan, EventCode::TrackSkipped, None, &error.to_string())?,
            }
        }
        let odds = self.config.odds(&look.scan.sensor);
        let association = match self.config.associator {
            Associator::Jipda { coalescence_free } => {
                self.with_existence(&members, look, open.len(), &odds, coalescence_free)?
            }
            associator => {
                let gated: Vec<GatedTrack> = members.iter().map(|member| member.gated.clone()).collect();
                associator.associate(&gated, open.len(), &odds)?
            }
        };
        if let Some(how) = &association.approximation {
            self.intake.record(look.scan, EventCode::Approximated, None, how)?;
        }
        for (member, shares) in members.iter().zip(&association.tracks) {
            let state = self.mixture(member, shares, &epochs)?;
            self.hit_or_miss(look, &open, member, shares);
            let time = look.scan.time;
            self.tracks[member.track].update(state, time);
        }
        explain(look, &open, &members, &association.tracks, &self.tracks);
        Ok(())
    }

    fn compare(&self, look: &Look, priors: &[Gaussian], epochs: &[f64], open: &[usize]) -> Result<Member> {
        let thresholds = self.config.gate.thresholds(look.sensor.measurement_dim())?;
        let mut member = Member {
            track: 0,
            expectations: Vec::with_capacity(epochs.len()),
            gated: GatedTrack::default(),
            epochs: Vec::new(),
        };
        let mut before = 0;
        for (epoch, (&time, prior)) in epochs.iter().zip(priors).enumerate() {
            let reports: Vec<DVector<f64>> = open[before..]
                .iter()
                .map(|&row| &look.rows[row])
                .take_while(|row| row.time <= time)
                .map(|row| row.value.clone())
                .collect();
            let expectation = Expectation {
                linearised: self.config.filter.expect(prior, &look.sensor, look.platform.as_ref())?,
                prior: prior.clone(),
            };
            let mut gated = gate(&expectation, &look.sensor, &reports, &thresholds)?;
            for pair in &mut gated.pairs {
                pair.report += before;
            }
            member.epochs.resize(member.epochs.len() + gated.pairs.len(), epoch);
            member.gated.pairs.append(&mut gated.pairs);
            member.gated.edge_log_likelihood = gated.edge_log_likelihood;
            member.expectations.push(expectation);
            before += reports.len();
        }
        Ok(member)
    }

    /// JIPDA: existence changes with what the scan says, and the shares are those given existence.
    fn with_existence(
        &mut self,
        members: &[Member],
        look: &Look,
        reports: usize,
        odds: &Odds,
        coalescence_free: bool,
    ) -> Result<Association> {
        let prospect = |member: &Member| {
            let track = &self.tracks[member.track];
            // A sensor that has never seen a track says nothing about it by not seeing it.
            let seen = track.windows[look.sensor_index].seen();
            Prospect {
                existence: track.existence.unwrap_or(1.0),
                detection: if seen { odds.seen().min(MOST_SEEN) } else { 0.0 },
                candidates: candidates(&member.gated, odds).collect(),
            }
        };
        let prospects: Vec<Prospect> = members.iter().map(prospect).collect();
        let options = Options {
            prune: coalescence_free,
            ..Options::default()
        };
        let found = joint_existence(&prospects, reports, &options)?;
        let mut tracks = Vec::with_capacity(members.len());
        for (member, existing) in members.iter().zip(found.tracks) {
            self.tracks[member.track].existence = Some(existing.existence);
            tracks.push(Shares {
                missed: existing.missed,
                pairs: existing.candidates,
            });
        }
        Ok(Association {
            tracks,
            approximation: approximation(found.method, found.error_bound),
        })
    }

    /// The hypotheses of one track at the scan's time, merged.
    fn mixture(&self, member: &Member, shares: &Shares, epochs: &[f64]) -> Result<Gaussian> {
        let prior = &self.tracks[member.track].state;
        let mut hypotheses = Vec::new();
        if shares.missed > 0.0 {
            hypotheses.push(Hypothesis {
                weight: shares.missed,
                state: prior.clone(),
            });
        }
        for (slot, (&weight, &epoch)) in shares.pairs.iter().zip(&member.epochs).enumerate() {
            if weight <= 0.0 {
                continue;
            }
            let Expectation { prior, linearised } = &member.expectations[epoch];
            let innovation = &member.gated.pairs[slot].innovation;
            let mut state = linearised.prediction.update(prior, innovation)?.posterior;
            for step in epochs[epoch..].windows(2) {
                state = self
                    .config
                    .filter
                    .predict(&state, &self.config.motion, step[1] - step[0])?;
            }
            hypotheses.push(Hypothesis { weight, state });
        }
        let space = self.config.motion.space();
        Ok(moment_match(&space, &hypotheses).unwrap_or_else(|| prior.clone()))
    }

    fn hit_or_miss(&mut self, look: &Look, open: &[usize], member: &Member, shares: &Shares) {
        let track = &mut self.tracks[member.track];
        let hit = shares.pairs.iter().sum::<f64>() >= 0.5;
        track.windows[look.sensor_index].push(hit);
        let likeliest = (0..shares.pairs.len()).max_by(|&a, &b| shares.pairs[a].total_cmp(&shares.pairs[b]));
        let Some(slot) = likeliest.filter(|_| hit) else {
            return;
        };
        let row = open[member.gated.pairs[slot].report];
        track.last_hit = look.rows[row].time;
        track.hits += 1;
        if let Some(position) = &look.positions[row] {
            track.start.add(position.mean.as_slice());
        }
    }
}

/// Books which track is the likeliest origin of each report, and how likely it is that some track is.
fn explain(look: &mut Look, open: &[usize], members: &[Member], tracks: &[Shares], live: &[LiveTrack]) {
    let mut largest = vec![0.0; open.len()];
    let mut taker: Vec<Option<Taker>> = vec![None; open.len()];
    for (member, shares) in members.iter().zip(tracks) {
        let track = &live[member.track];
        for (pair, &share) in member.gated.pairs.iter().zip(&shares.pairs) {
            let fate = &mut look.fates[open[pair.report]];
            let confirmed = track.id.is_some();
            fate.near_confirmed |= confirmed;
            let weight = share * track.existence.unwrap_or(1.0);
            fate.explained += weight;
            if weight > largest[pair.report] {
                largest[pair.report] = weight;
                taker[pair.report] = Some(Taker {
                    track: member.track,
                    confirmed,
                });
            }
        }
    }
    for (&row, taker) in open.iter().zip(taker) {
        let fate = &mut look.fates[row];
        fate.taker = taker.filter(|_| fate.explained >= 0.5);
    }
}
