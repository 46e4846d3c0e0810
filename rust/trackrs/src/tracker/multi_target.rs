//! The multi-target tracker: scans in, confirmed tracks out.
//!
//! For each scan:
//! 1. its rows are checked; what is refused becomes an event, and every row is booked in the ledger;
//! 2. all tracks are predicted to its time, and to those of its reports where they have their own;
//! 3. reports are gated with and given to confirmed tracks, then the remaining ones to tentative tracks (`joint`); with
//!    existence probabilities all tracks compete; NPDA takes the reports one by one instead (`sequential`);
//! 4. what confirmed tracks left over feeds the clutter map; a tentative track that took a static echo ends;
//! 5. tracks are ended and confirmed ([`super::lifecycle`]), and confirmed ones judged by their last updates (`health`);
//! 6. reports that no track took, that are no static echo and lie in no confirmed track's gate start tentative tracks,
//!    at rest, with the speed bound as uncertainty. With existence probabilities every report does, with the probability
//!    that it is of no track. Where asked for, pairs of such reports start the tracks instead (`two_point`).
//!    A track whose reports are enough by then is confirmed at once.
//!
//! Sensors are taken one after the other as their scans come; a scan updates only what its own sensor can see.

use serde::{Deserialize, Serialize};

use super::clutter_map::ClutterMapState;
use super::config::TrackerConfig;
use super::engine::Engine;
use super::health::Monitor;
use super::intake::{Intake, Needs};
use super::joint::{Group, Priors};
use super::lifecycle::{Initiator, Start};
use super::live::{LiveTrack, Rooted};
use super::look::Look;
use super::two_point::Waiting;
use super::window::Window;
use super::workspace::Workspace;
use crate::association::associator::Associator;
use crate::error::{Error, Result};
use crate::event::{EventCode, EventLog, Ledger};
use crate::model::Motion;
use crate::scan::Scan;
use crate::state;
use crate::track::{Track, TrackRef};

/// The tracker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct MultiTargetTracker {
    pub(super) config: TrackerConfig,
    pub(super) intake: Intake,
    pub(super) tracks: Vec<LiveTrack>,
    /// Reports that wait for a second one to begin a track with, in the order of their times.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) waiting: Vec<Waiting>,
    pub(super) next_id: u64,
    pub(super) clutter: Option<ClutterMapState>,
    #[serde(skip)]
    pub(super) work: Workspace,
}

impl MultiTargetTracker {
    /// A tracker that has seen nothing yet.
    pub fn new(config: TrackerConfig) -> Result<Self> {
        config.check()?;
        let mut tracker = Self {
            intake: Intake::new(config.initial.iter().map(|s| s.time).reduce(f64::max), config.strict),
            tracks: Vec::new(),
            waiting: Vec::new(),
            next_id: 1,
            clutter: config.clutter_map.map(ClutterMapState::new),
            work: Workspace::default(),
            config,
        };
        for start in tracker.config.initial.clone() {
            // All are brought to the latest of their times, so that one clock serves the whole tracker.
            let ahead = tracker.intake.time.map_or(0.0, |now| now - start.time);
            let track = LiveTrack {
                id: Some(tracker.next_id),
                stored: tracker.stored(&start.state, start.time),
                existence: matches!(tracker.config.initiator, Initiator::Existence(_)).then_some(1.0),
                start: Start::new(
                    start
                        .state
                        .mean
                        .rows(0, tracker.config.motion.position_dims())
                        .as_slice(),
                ),
                state: tracker
                    .config
                    .filter
                    .predict(&start.state, &tracker.config.motion, ahead)?,
                windows: vec![Window::started(); tracker.config.sensors.len()],
                born: start.time,
                last_hit: start.time,
                hits: 0,
                monitor: Monitor::default(),
                rooted: Rooted::Never,
            };
            tracker.next_id += 1;
            tracker.tracks.push(track);
        }
        Ok(tracker)
    }

    /// What defines it.
    pub fn config(&self) -> &TrackerConfig {
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

    /// The confirmed tracks at the time of the last scan.
    pub fn tracks(&self) -> Vec<Track> {
        self.track_refs().map(|track| track.to_owned()).collect()
    }

    /// The same where they stand.
    pub fn track_refs(&self) -> impl Iterator<Item = TrackRef<'_>> + Clone {
        self.tracks.iter().filter_map(|track| {
            track.id.map(|id| TrackRef {
                id,
                time: self.intake.time.unwrap_or(track.last_hit),
                state: &track.state,
                last_hit: track.last_hit,
                hits: track.hits,
                existence: track.existence,
                extent: None,
                health: Some(track.monitor.health),
            })
        })
    }

    /// Whether a run over these scans would be accepted: known sensors, finite times that never decrease.
    pub fn check_run(&self, scans: &[Scan]) -> Result<()> {
        Intake::check_run(scans, self.intake.time, |sensor| self.config.sensor(sensor))
    }

    /// Takes in all scans, which must be in the order of their times, and returns the confirmed tracks after each.
    pub fn run(&mut self, scans: &[Scan]) -> Result<Vec<Vec<Track>>> {
        self.check_run(scans)?;
        let tracks = scans.iter().map(|scan| self.step(scan)).collect::<Result<_>>()?;
        self.intake.ledger.check()?;
        Ok(tracks)
    }

    /// Takes in one scan and returns the confirmed tracks at its time. A scan that cannot be used leaves the tracks as
    /// they were and is recorded as an event.
    pub fn step(&mut self, scan: &Scan) -> Result<Vec<Track>> {
        self.update(scan)?;
        Ok(self.tracks())
    }

    /// The same without a copy of the tracks, which are those of [`Self::track_refs`].
    pub fn update(&mut self, scan: &Scan) -> Result<()> {
        let sensor = self.config.sensor(&scan.sensor).map_err(|error| error.to_string());
        let Some(reports) = self.intake.admit(scan, sensor, Needs::Something)? else {
            return Ok(());
        };
        let sensors = self.config.sensors.iter().enumerate();
        if let Some((index, (_, sensor))) = sensors.into_iter().find(|(_, (name, _))| **name == scan.sensor) {
            let mut look = Look::new(scan, index, sensor.clone(), reports);
            let before = self.begin(scan)?;
            let mut bench = self.work.bench(&self.config, index, &look.sensor)?;
            if let Associator::Npda(npda) = self.config.associator {
                self.associate_in_turn(&mut look, &mut bench, &npda, before)?;
            } else {
                let priors = self.predict(&look, before)?;
                bench.sort(&look);
                if matches!(self.config.associator, Associator::Jipda { .. }) {
                    self.associate(&mut look, &mut bench, &priors, Group::All)?;
                } else {
                    self.associate(&mut look, &mut bench, &priors, Group::Confirmed)?;
                    self.associate(&mut look, &mut bench, &priors, Group::Tentative)?;
                }
            }
            self.work.put_back(index, bench);
            self.tell_rooted(scan)?;
            self.map_clutter(&mut look);
            self.end(&look);
            self.check_health(&look)?;
            self.confirm(scan.time);
            self.initiate(&look)?;
            self.drop_diverged(scan, || "their estimate".into())?;
            self.confirm(scan.time);
        }
        Ok(())
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

    /// Ends what cannot go on to the scan's time, and puts the clock there. Returns where the tracks stand.
    fn begin(&mut self, scan: &Scan) -> Result<f64> {
        let before = self.intake.time.unwrap_or(scan.time);
        let dt = scan.time - before;
        self.intake.time = Some(scan.time);
        if self.config.max_gap.is_some_and(|gap| dt > gap) {
            self.waiting.clear();
            if !self.tracks.is_empty() {
                let reason = format!("{dt} s without a scan: {} tracks ended", self.tracks.len());
                self.tracks.clear();
                self.intake.record(scan, EventCode::GapReset, None, &reason)?;
            }
        }
        if let Initiator::Existence(rule) = self.config.initiator {
            let survival = rule.survival(dt);
            for track in &mut self.tracks {
                track.existence = track.existence.map(|existence| existence * survival);
            }
        }
        Ok(before)
    }

    /// Predicts all tracks from one time to another.
    pub(super) fn advance(&mut self, from: f64, to: f64) -> Result<()> {
        // Nothing moves in no time.
        if from == to {
            return Ok(());
        }
        let prediction = self.work.prediction(&self.config);
        for track in &mut self.tracks {
            track.advance(prediction, &self.config.motion, from, to)?;
        }
        Ok(())
    }

    /// The predictions of every track to every epoch of the scan; the tracks stand at the last one afterwards.
    fn predict(&mut self, look: &Look, before: f64) -> Result<Priors> {
        let several = look.epochs.len() > 1;
        let mut priors = vec![Vec::new(); if several { self.tracks.len() } else { 0 }];
        let mut now = before;
        for &time in &look.epochs {
            self.advance(now, time)?;
            now = time;
            for (priors, track) in priors.iter_mut().zip(&self.tracks) {
                priors.push(track.state.clone());
            }
        }
        let mut tracks = self.tracks.iter();
        priors.retain(|_| tracks.next().is_some_and(LiveTrack::is_finite));
        let ahead = look.scan.time - before;
        self.drop_diverged(look.scan, || format!("{ahead} s ahead their prediction"))?;
        Ok(Priors(priors))
    }

    /// Tells of every track once that steps of it are done by roots.
    fn tell_rooted(&mut self, scan: &Scan) -> Result<()> {
        for track in self.tracks.iter_mut().filter(|track| track.rooted == Rooted::Now) {
            track.rooted = Rooted::Before;
            self.intake.tell_rooted(scan, track.id)?;
        }
        Ok(())
    }

    fn drop_diverged(&mut self, scan: &Scan, what: impl Fn() -> String) -> Result<()> {
        let count = self.tracks.iter().filter(|track| !track.is_finite()).count();
        if count == 0 {
            return Ok(());
        }
        self.tracks.retain(LiveTrack::is_finite);
        let reason = format!("{count} tracks ended: {} is not finite", what());
        self.intake.record(scan, EventCode::TrackDiverged, None, &reason)
    }
}
