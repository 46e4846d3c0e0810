//! Tracks come and go: what of a scan no track took, which tracks are confirmed, end, or begin.

use super::lifecycle::{Existence, Initiator, Start, Window, ended, enough_hits, hopeless, moves, speed, start_state};
use super::live::{LiveTrack, Stored};
use super::look::Look;
use super::multi_target::MultiTargetTracker;
use crate::association::associator::Associator;
use crate::association::npda::{Bookkeeping, Npda};
use crate::error::Result;
use crate::event::EventCode;
use crate::gaussian::Gaussian;
use crate::model::Motion;

impl MultiTargetTracker {
    /// Feeds the clutter map with what confirmed tracks left over, and tells which of it is a static echo.
    pub(super) fn map_clutter(&mut self, look: &mut Look) {
        let Some(map) = &mut self.clutter else {
            return;
        };
        for ((fate, position), row) in look.fates.iter_mut().zip(&look.positions).zip(&look.rows) {
            let Some(position) = position
                .as_ref()
                .filter(|_| !fate.taker.is_some_and(|taker| taker.confirmed))
            else {
                continue;
            };
            fate.echo = map.is_static(&position.mean);
            map.add(&position.mean, row.time);
        }
    }

    /// Ends tracks, and confirms others.
    pub(super) fn end(&mut self, look: &Look) {
        let dims = self.config.motion.position_dims();
        let (begin, deletion) = (self.config.initiator, self.config.deletion.unwrap_or_default());
        let mut on_echo = vec![false; self.tracks.len()];
        for fate in look.fates.iter().filter(|fate| fate.echo) {
            if let Some(taker) = fate.taker {
                on_echo[taker.track] = true;
            }
        }
        let mut on_echo = on_echo.into_iter();
        self.tracks.retain(|track| {
            let on_echo = on_echo.next().unwrap_or(false);
            if track.id.is_none() && on_echo || track.id.is_some() && speed(&track.state, dims) > begin.max_speed() {
                return false;
            }
            match &begin {
                Initiator::Existence(rule) => track.existence.is_none_or(|r| r >= rule.drop),
                Initiator::MofN(rule) if track.id.is_none() => !hopeless(&track.windows, rule),
                Initiator::MofN(_) => !ended(&track.windows, look.scan.time - track.last_hit, &deletion),
            }
        });
    }

    pub(super) fn confirm(&mut self, time: f64) {
        let rule = self.config.initiator;
        let motion = &self.config.motion;
        for index in 0..self.tracks.len() {
            let track = &self.tracks[index];
            let believed = match &rule {
                Initiator::MofN(rule) => enough_hits(&track.windows, rule),
                Initiator::Existence(rule) => track.existence.is_some_and(|r| r >= rule.confirm),
            };
            let ready = track.id.is_none()
                && believed
                && moves(&track.state, &track.start.position(), time - track.born, &rule);
            let position = track.position(motion);
            let clear = |other: &LiveTrack| (other.position(motion) - &position).norm() >= rule.min_separation();
            if ready && self.tracks.iter().filter(|other| other.id.is_some()).all(clear) {
                self.tracks[index].id = Some(self.next_id);
                self.next_id += 1;
            }
        }
    }

    /// Starts tracks from reports, each at its own time.
    pub(super) fn initiate(&mut self, look: &Look) -> Result<()> {
        for (row, (fate, position)) in look.fates.iter().zip(&look.positions).enumerate() {
            let Some(position) = position else {
                continue;
            };
            let existence = match self.config.initiator {
                Initiator::MofN(_) => None,
                Initiator::Existence(rule) => Some(rule.initial * (1.0 - fate.explained.min(1.0))),
            };
            let free = match self.config.initiator {
                Initiator::MofN(_) => fate.is_free(),
                Initiator::Existence(rule) => {
                    !fate.echo && existence.is_some_and(|r| r >= rule.drop) && self.is_clear(position, &rule)
                }
            };
            if !free {
                continue;
            }
            if self.tracks.len() >= self.config.max_tracks {
                self.intake
                    .record(look.scan, EventCode::TrackLimit, Some(row), "max_tracks is reached")?;
                continue;
            }
            let mut windows = vec![Window::default(); self.config.sensors.len()];
            windows[look.sensor_index].push(true);
            let (motion, born) = (&self.config.motion, look.rows[row].time);
            let state = start_state(position, motion, self.config.initiator.max_speed());
            self.tracks.push(LiveTrack {
                id: None,
                stored: self.stored(&state, born),
                state: if born < look.scan.time {
                    self.config.filter.predict(&state, motion, look.scan.time - born)?
                } else {
                    state
                },
                start: Start::new(position.mean.as_slice()),
                born,
                windows,
                last_hit: born,
                hits: 1,
                existence,
            });
        }
        Ok(())
    }

    /// What an associator that predicts in long steps remembers of an estimate.
    pub(super) fn stored(&self, state: &Gaussian, time: f64) -> Option<Stored> {
        let keeps = matches!(
            self.config.associator,
            Associator::Npda(Npda {
                bookkeeping: Bookkeeping::Paper,
                ..
            })
        );
        keeps.then(|| Stored {
            time,
            state: state.clone(),
        })
    }

    /// Whether no confirmed track stands so near that the report is likely another echo of its target.
    fn is_clear(&self, report: &Gaussian, rule: &Existence) -> bool {
        let far =
            |track: &LiveTrack| (track.position(&self.config.motion) - &report.mean).norm() >= rule.min_separation;
        self.tracks.iter().filter(|track| track.id.is_some()).all(far)
    }
}
