//! Tracks come and go: what of a scan no track took, which tracks are confirmed, end, or begin.

use super::health::Monitor;
use super::lifecycle::{Existence, Initiator, moves, speed, start_state_into};
use super::live::{LiveTrack, Rooted, Stored, distance};
use super::look::Look;
use super::multi_target::MultiTargetTracker;
use super::two_point::{Waiting, pair_up};
use super::window::{Window, ended, enough_hits, hopeless};
use crate::association::associator::Associator;
use crate::association::npda::{Bookkeeping, Npda};
use crate::error::Result;
use crate::event::EventCode;
use crate::gaussian::Gaussian;
use crate::linalg::symmetric::symmetrise;
use crate::model::Motion;

/// Reports that may begin a track, and their rows.
#[derive(Default)]
struct Free {
    rows: Vec<usize>,
    reports: Vec<Waiting>,
}

impl MultiTargetTracker {
    /// Feeds the clutter map with what confirmed tracks left over, and tells which of it is a static echo.
    pub(super) fn map_clutter(&mut self, look: &mut Look) {
        let Some(map) = &mut self.clutter else {
            return;
        };
        for row in 0..look.rows.len() {
            if look.fates[row].taker.is_some_and(|taker| taker.confirmed) {
                continue;
            }
            if let Some(position) = look.position(row) {
                look.fates[row].echo = map.is_static(&position.mean);
                map.add(&position.mean, look.rows[row].time);
            }
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
        self.work.recycle(&mut self.tracks, |track| {
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
            let separation = rule.min_separation();
            let clear = |other: &LiveTrack| distance(other.position(motion), position) >= separation;
            let mut confirmed = self.tracks.iter().filter(|other| other.id.is_some());
            if ready && (separation == 0.0 || confirmed.all(clear)) {
                self.tracks[index].id = Some(self.next_id);
                self.next_id += 1;
            }
        }
    }

    /// Starts tracks from what no track took: each report a track, or each pair that one makes with a report of before.
    pub(super) fn initiate(&mut self, look: &Look) -> Result<()> {
        let Free { rows, reports } = self.free_reports(look)?;
        let initiator = self.config.initiator;
        let Some(within) = initiator.pair_within() else {
            for (&row, report) in rows.iter().zip(&reports) {
                if self.has_room(look, row)? {
                    self.try_begin(look, row, report, None)?;
                }
            }
            return Ok(());
        };
        let partners = pair_up(&self.waiting, &reports, initiator.max_speed(), within);
        for ((&row, report), partner) in rows.iter().zip(&reports).zip(&partners) {
            if let Some(first) = partner.and_then(|index| self.waiting.get(index).cloned()) {
                self.try_begin(look, row, report, Some(&first))?;
            }
        }
        let mut index = 0..;
        self.waiting.retain(|first| {
            let paired = partners.contains(&index.next());
            !paired && look.scan.time - first.time <= within
        });
        for ((row, report), partner) in rows.into_iter().zip(reports).zip(partners) {
            if partner.is_none() && self.has_room(look, row)? {
                self.waiting.push(report);
            }
        }
        Ok(())
    }

    /// The reports that may begin a track.
    fn free_reports(&mut self, look: &Look) -> Result<Free> {
        let mut free = Free::default();
        for (row, fate) in look.fates.iter().enumerate() {
            let counted = matches!(self.config.initiator, Initiator::MofN(_));
            if fate.echo || counted && !fate.is_free() {
                continue;
            }
            let Some(mut position) = look.position(row) else {
                continue;
            };
            let unexplained = 1.0 - fate.explained.min(1.0);
            let is_free = match self.config.initiator {
                Initiator::MofN(_) => true,
                Initiator::Existence(rule) => {
                    rule.initial * unexplained >= rule.drop && self.is_clear(&position, &rule)
                }
            };
            if !is_free {
                continue;
            }
            if !position.mean.iter().chain(position.cov.iter()).all(|v| v.is_finite()) {
                let reason = "the position of a report is not finite: it begins no track";
                self.intake
                    .record(look.scan, EventCode::TrackDiverged, Some(row), reason)?;
                continue;
            }
            // Exactly symmetric, as it is saved.
            symmetrise(&mut position.cov);
            free.rows.push(row);
            free.reports.push(Waiting {
                time: look.rows[row].time,
                position,
                sensor: look.sensor_index,
                unexplained,
            });
        }
        Ok(free)
    }

    /// Whether one more track, or report that waits for a second one, may be kept.
    fn has_room(&mut self, look: &Look, row: usize) -> Result<bool> {
        let room = self.tracks.len() + self.waiting.len() < self.config.max_tracks;
        if !room {
            self.intake
                .record(look.scan, EventCode::TrackLimit, Some(row), "max_tracks is reached")?;
        }
        Ok(room)
    }

    /// The same as [`Self::begin_track`]; where the state is too large to be a number, no track begins.
    fn try_begin(&mut self, look: &Look, row: usize, report: &Waiting, first: Option<&Waiting>) -> Result<()> {
        match self.begin_track(look.scan.time, report, first) {
            Ok(()) => Ok(()),
            Err(error) => {
                let reason = format!("no track begins: {error}");
                self.intake
                    .record(look.scan, EventCode::TrackDiverged, Some(row), &reason)
            }
        }
    }

    /// A tentative track from a report, and perhaps one of before, brought to `now`.
    fn begin_track(&mut self, now: f64, report: &Waiting, first: Option<&Waiting>) -> Result<()> {
        let max_speed = self.config.initiator.max_speed();
        let earliest = first.unwrap_or(report);
        let mut track = self.work.blank(&self.config);
        let motion = &self.config.motion;
        match first {
            Some(first) => start_state_into(&report.line_from(first)?, motion, max_speed, &mut track.state),
            None => start_state_into(&report.position, motion, max_speed, &mut track.state),
        }
        track.id = None;
        track.stored = self.stored(&track.state, report.time);
        track.windows.clear();
        track.windows.resize(self.config.sensors.len(), Window::default());
        track.start.reset(earliest.position.mean.as_slice());
        track.hits = 0;
        track.monitor = Monitor::default();
        track.rooted = Rooted::Never;
        track.existence = match self.config.initiator {
            Initiator::MofN(_) => None,
            Initiator::Existence(rule) => Some(rule.initial),
        };
        for part in first.into_iter().chain([report]) {
            track.windows[part.sensor].push(true);
            track.hits += 1;
            track.existence = track.existence.map(|existence| existence * part.unexplained);
        }
        if first.is_some() {
            track.start.add(report.position.mean.as_slice());
        }
        (track.born, track.last_hit) = (earliest.time, report.time);
        if report.time < now {
            let prediction = self.work.prediction(&self.config);
            // Those that predict in long steps stand where they are stored.
            track.advance(prediction, &self.config.motion, report.time, now)?;
        }
        self.tracks.push(track);
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
        let (motion, at) = (&self.config.motion, report.mean.as_slice());
        let far = |track: &LiveTrack| distance(track.position(motion), at) >= rule.min_separation;
        self.tracks.iter().filter(|track| track.id.is_some()).all(far)
    }
}
