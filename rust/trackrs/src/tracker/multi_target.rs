//! The multi-target tracker: scans in, confirmed tracks out.
//!
//! For each scan:
//! 1. its rows are checked; what is refused becomes an event, and every row is booked in the ledger;
//! 2. all tracks are predicted to its time;
//! 3. reports are gated with and given to confirmed tracks, then the remaining ones to tentative tracks;
//! 4. what confirmed tracks left over feeds the clutter map; a tentative track that took a static echo ends;
//! 5. tracks are confirmed and ended ([`super::lifecycle`]);
//! 6. reports that no track took, that are no static echo and lie in no confirmed track's gate start tentative tracks,
//!    at rest, with the speed bound as uncertainty.
//!
//! Sensors are taken one after the other as their scans come; a scan updates only what its own sensor can see.

use std::collections::BTreeMap;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::clutter_map::ClutterMapState;
use super::config::TrackerConfig;
use super::lifecycle::{Start, Window, ended, enough_hits, hopeless, moves, speed, start_state};
use super::look::{Look, Taker};
use crate::error::{Error, Result, require_finite, require_size};
use crate::event::{EventCode, EventLog, Ledger};
use crate::filter::extended::linearise;
use crate::filter::kalman;
use crate::gating::mahalanobis::{Expectation, GatedTrack, gate};
use crate::gaussian::Gaussian;
use crate::model::{Motion, Sensor};
use crate::scan::Scan;
use crate::state;
use crate::track::Track;

/// A track inside the tracker, tentative while it has no id.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct LiveTrack {
    id: Option<u64>,
    state: Gaussian,
    start: Start,
    born: f64,
    windows: Vec<Window>,
    last_hit: f64,
    hits: u64,
}

/// The tracker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct MultiTargetTracker {
    pub(super) config: TrackerConfig,
    pub(super) time: Option<f64>,
    tracks: Vec<LiveTrack>,
    next_id: u64,
    clutter: Option<ClutterMapState>,
    pub(super) last_scans: BTreeMap<String, Scan>,
    pub(super) events: EventLog,
    pub(super) ledger: Ledger,
}

impl MultiTargetTracker {
    /// A tracker that has seen nothing yet.
    pub fn new(config: TrackerConfig) -> Result<Self> {
        config.check()?;
        let mut tracker = Self {
            time: config.initial.iter().map(|s| s.time).reduce(f64::max),
            tracks: Vec::new(),
            next_id: 1,
            clutter: config.clutter_map.map(ClutterMapState::new),
            last_scans: BTreeMap::new(),
            events: EventLog::new(config.strict),
            ledger: Ledger::default(),
            config,
        };
        for start in tracker.config.initial.clone() {
            // All are brought to the latest of their times, so that one clock serves the whole tracker.
            let ahead = tracker.time.map_or(0.0, |now| now - start.time);
            let track = LiveTrack {
                id: Some(tracker.next_id),
                start: Start::new(
                    start
                        .state
                        .mean
                        .rows(0, tracker.config.motion.position_dims())
                        .as_slice(),
                ),
                state: kalman::predict(&start.state, &tracker.config.motion, ahead, None)?,
                windows: vec![Window::started(); tracker.config.sensors.len()],
                born: start.time,
                last_hit: start.time,
                hits: 0,
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
        &self.events
    }

    /// Where every row went so far.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// The confirmed tracks at the time of the last scan.
    pub fn tracks(&self) -> Vec<Track> {
        let report = |track: &LiveTrack| {
            track.id.map(|id| Track {
                id,
                time: self.time.unwrap_or(track.last_hit),
                state: track.state.clone(),
                last_hit: track.last_hit,
                hits: track.hits,
            })
        };
        self.tracks.iter().filter_map(report).collect()
    }

    /// Whether a run over these scans would be accepted: known sensors, finite times that never decrease.
    pub fn check_run(&self, scans: &[Scan]) -> Result<()> {
        let mut previous = self.time.unwrap_or(f64::NEG_INFINITY);
        for scan in scans {
            if !self.config.sensors.contains_key(&scan.sensor) {
                return Err(self.unknown_sensor(&scan.sensor));
            }
            require_finite("scan time", [&scan.time])?;
            if scan.time < previous {
                return Err(Error::TimeReversed {
                    time: scan.time,
                    previous,
                });
            }
            previous = scan.time;
        }
        Ok(())
    }

    /// Takes in all scans, which must be in the order of their times, and returns the confirmed tracks after each.
    pub fn run(&mut self, scans: &[Scan]) -> Result<Vec<Vec<Track>>> {
        self.check_run(scans)?;
        let tracks = scans.iter().map(|scan| self.step(scan)).collect::<Result<_>>()?;
        self.ledger.check()?;
        Ok(tracks)
    }

    /// Takes in one scan and returns the confirmed tracks at its time. A scan that cannot be used leaves the tracks as
    /// they were and is recorded as an event.
    pub fn step(&mut self, scan: &Scan) -> Result<Vec<Track>> {
        self.ledger.rows_in += scan.values.len() as u64;
        if let Some((code, reason)) = self.refusal(scan) {
            self.ledger.drop_rows(code, scan.values.len() as u64);
            self.record(scan, code, None, &reason)?;
            return Ok(self.tracks());
        }
        let reports = self.usable_rows(scan)?;
        self.ledger.used += reports.len() as u64;
        self.last_scans.insert(scan.sensor.clone(), scan.clone());
        self.predict(scan)?;
        let sensors = self.config.sensors.iter().enumerate();
        if let Some((index, (_, sensor))) = sensors.into_iter().find(|(_, (name, _))| **name == scan.sensor) {
            let mut look = Look::new(scan, index, sensor.clone(), reports);
            self.associate(&mut look, true)?;
            self.associate(&mut look, false)?;
            self.map_clutter(&mut look);
            self.end(&look);
            self.confirm(scan.time);
            self.initiate(&look)?;
        }
        Ok(self.tracks())
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
        if let Some(map) = &mut tracker.clutter {
            map.restore();
        }
        Ok(tracker)
    }

    fn check_restored(&self) -> Result<()> {
        self.config.check()?;
        self.time.map_or(Ok(()), |time| require_finite("time", [&time]))?;
        for track in &self.tracks {
            require_size("track state", self.config.motion.state_dim(), track.state.dim())?;
            require_size(
                "track start",
                self.config.motion.position_dims(),
                track.start.position().len(),
            )?;
            require_size("track windows", self.config.sensors.len(), track.windows.len())?;
        }
        Ok(())
    }

    fn predict(&mut self, scan: &Scan) -> Result<()> {
        let dt = self.time.map_or(0.0, |now| scan.time - now);
        self.time = Some(scan.time);
        if self.config.max_gap.is_some_and(|gap| dt > gap) && !self.tracks.is_empty() {
            let reason = format!("{dt} s without a scan: {} tracks ended", self.tracks.len());
            self.tracks.clear();
            self.record(scan, EventCode::GapReset, None, &reason)?;
        }
        for track in &mut self.tracks {
            track.state = kalman::predict(&track.state, &self.config.motion, dt, None)?;
        }
        let finite = |track: &LiveTrack| {
            track
                .state
                .mean
                .iter()
                .chain(track.state.cov.iter())
                .all(|v| v.is_finite())
        };
        let diverged = self.tracks.iter().filter(|track| !finite(track)).count();
        if diverged > 0 {
            self.tracks.retain(finite);
            let reason = format!("{diverged} tracks ended: {dt} s ahead their prediction is not finite");
            self.record(scan, EventCode::TrackDiverged, None, &reason)?;
        }
        Ok(())
    }

    /// Gives reports to tracks of one kind, confirmed or tentative, and updates them.
    fn associate(&mut self, look: &mut Look, confirmed: bool) -> Result<()> {
        let open: Vec<usize> = (0..look.reports.len())
            .filter(|&row| look.fates[row].taker.is_none())
            .collect();
        let candidates: Vec<DVector<f64>> = open.iter().map(|&row| look.reports[row].clone()).collect();
        let thresholds = self.config.gate.thresholds(look.sensor.measurement_dim())?;
        let mut members = Vec::new();
        let mut expectations = Vec::new();
        let mut gated = Vec::new();
        for index in 0..self.tracks.len() {
            if self.tracks[index].id.is_some() != confirmed {
                continue;
            }
            let compared = compare(&self.tracks[index].state, look, &candidates, &thresholds);
            match compared {
                Ok(compared) => {
                    members.push(index);
                    expectations.push(compared.expectation);
                    gated.push(compared.gated);
                }
                Err(error) => self.record(look.scan, EventCode::TrackSkipped, None, &error.to_string())?,
            }
        }
        let chosen = self.config.associator.associate(&gated, candidates.len())?;
        for (slot, &index) in members.iter().enumerate() {
            if confirmed {
                gated[slot]
                    .pairs
                    .iter()
                    .for_each(|pair| look.fates[open[pair.report]].near_confirmed = true);
            }
            let track = &mut self.tracks[index];
            track.windows[look.sensor_index].push(chosen[slot].is_some());
            let Some(pair) = chosen[slot].map(|choice| &gated[slot].pairs[choice]) else {
                continue;
            };
            let Expectation { prior, linearised } = &expectations[slot];
            track.state = linearised.prediction.update(prior, &pair.innovation)?.posterior;
            track.last_hit = look.scan.time;
            track.hits += 1;
            let row = open[pair.report];
            look.fates[row].taker = Some(Taker {
                track: index,
                confirmed,
            });
            if let Some(position) = &look.positions[row] {
                track.start.add(position.mean.as_slice());
            }
        }
        Ok(())
    }

    /// Feeds the clutter map with what confirmed tracks left over, and tells which of it is a static echo.
    fn map_clutter(&mut self, look: &mut Look) {
        let Some(map) = &mut self.clutter else {
            return;
        };
        for (fate, position) in look.fates.iter_mut().zip(&look.positions) {
            let Some(position) = position
                .as_ref()
                .filter(|_| !fate.taker.is_some_and(|taker| taker.confirmed))
            else {
                continue;
            };
            fate.echo = map.is_static(&position.mean);
            map.add(&position.mean, look.scan.time);
        }
    }

    fn end(&mut self, look: &Look) {
        let dims = self.config.motion.position_dims();
        let (begin, end) = (self.config.initiator, self.config.deletion);
        let mut on_echo = vec![false; self.tracks.len()];
        for fate in look.fates.iter().filter(|fate| fate.echo) {
            if let Some(taker) = fate.taker {
                on_echo[taker.track] = true;
            }
        }
        let mut on_echo = on_echo.into_iter();
        self.tracks.retain(|track| {
            let on_echo = on_echo.next().unwrap_or(false);
            if track.id.is_none() {
                return !on_echo && !hopeless(&track.windows, &begin);
            }
            let idle = look.scan.time - track.last_hit;
            !ended(&track.windows, idle, &end) && speed(&track.state, dims) <= begin.max_speed
        });
    }

    fn confirm(&mut self, time: f64) {
        let rule = self.config.initiator;
        let dims = self.config.motion.position_dims();
        for index in 0..self.tracks.len() {
            let track = &self.tracks[index];
            let ready = track.id.is_none()
                && enough_hits(&track.windows, &rule)
                && moves(&track.state, &track.start.position(), time - track.born, &rule);
            let position = |track: &LiveTrack| track.state.mean.rows(0, dims).into_owned();
            let clear = |other: &LiveTrack| (position(other) - position(track)).norm() >= rule.min_separation;
            if ready && self.tracks.iter().filter(|other| other.id.is_some()).all(clear) {
                self.tracks[index].id = Some(self.next_id);
                self.next_id += 1;
            }
        }
    }

    fn initiate(&mut self, look: &Look) -> Result<()> {
        for (row, (fate, position)) in look.fates.iter().zip(&look.positions).enumerate() {
            let Some(position) = position.as_ref().filter(|_| fate.is_free()) else {
                continue;
            };
            if self.tracks.len() >= self.config.max_tracks {
                self.record(look.scan, EventCode::TrackLimit, Some(row), "max_tracks is reached")?;
                continue;
            }
            let mut windows = vec![Window::default(); self.config.sensors.len()];
            windows[look.sensor_index].push(true);
            self.tracks.push(LiveTrack {
                id: None,
                state: start_state(position, &self.config.motion, self.config.initiator.max_speed),
                start: Start::new(position.mean.as_slice()),
                born: look.scan.time,
                windows,
                last_hit: look.scan.time,
                hits: 1,
            });
        }
        Ok(())
    }
}

/// A track seen by the sensor of a scan.
struct Compared {
    expectation: Expectation,
    gated: GatedTrack,
}

fn compare(prior: &Gaussian, look: &Look, candidates: &[DVector<f64>], thresholds: &[f64]) -> Result<Compared> {
    let expectation = Expectation {
        prior: prior.clone(),
        linearised: linearise(prior, &look.sensor, look.platform.as_ref())?,
    };
    let gated = gate(&expectation, &look.sensor, candidates, thresholds)?;
    Ok(Compared { expectation, gated })
}
