//! The multi-target tracker as one that can be put back to where it stood.

use serde::{Deserialize, Serialize};

use super::clutter_map::ClutterMapState;
use super::engine::Engine;
use super::intake::{Intake, IntakeState, Needs};
use super::live::LiveTrack;
use super::multi_target::MultiTargetTracker;
use super::two_point::Waiting;
use super::window::Window;
use crate::error::{Result, require_count, require_finite, require_probability, require_size};
use crate::event::{Books, EventCode, EventLog, Ledger};
use crate::model::{Motion, SensorModel};
use crate::scan::Scan;

/// What a scan changes in a tracker, its books apart.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrackerState {
    clock: IntakeState,
    tracks: Vec<LiveTrack>,
    waiting: Vec<Waiting>,
    next_id: u64,
    clutter: Option<ClutterMapState>,
}

impl Engine for MultiTargetTracker {
    type State = TrackerState;

    fn time(&self) -> Option<f64> {
        self.intake.time
    }

    fn strict(&self) -> bool {
        self.config.strict
    }

    fn max_gap(&self) -> Option<f64> {
        self.config.max_gap
    }

    fn events(&self) -> &EventLog {
        &self.intake.events
    }

    fn ledger(&self) -> &Ledger {
        &self.intake.ledger
    }

    fn swap_books(&mut self, books: &mut Books) {
        self.intake.swap_books(books);
    }

    fn absorb(&mut self, later: &Books) {
        self.intake.absorb(later);
    }

    fn refuse(&mut self, scan: &Scan, code: EventCode, reason: &str) -> Result<()> {
        self.intake.refuse(scan, code, reason)
    }

    fn record(&mut self, scan: &Scan, code: EventCode, reason: &str) -> Result<()> {
        self.intake.record(scan, code, None, reason)
    }

    fn has_a_place_for(&self, scan: &Scan) -> bool {
        let fits = |sensor: &SensorModel| Intake::fault(scan, sensor, Needs::Something).is_none();
        self.config.sensor(&scan.sensor).is_ok_and(fits)
    }

    fn check_run(&self, scans: &[Scan], before: Option<f64>) -> Result<()> {
        Intake::check_run(scans, before, |sensor| self.config.sensor(sensor))
    }

    fn check_sensor(&self, name: &str) -> Result<()> {
        self.config.sensor(name).map(|_| ())
    }

    fn update(&mut self, scan: &Scan) -> Result<()> {
        Self::update(self, scan)
    }

    fn state(&self) -> TrackerState {
        TrackerState {
            clock: self.intake.state(),
            tracks: self.tracks.clone(),
            waiting: self.waiting.clone(),
            next_id: self.next_id,
            clutter: self.clutter.clone(),
        }
    }

    fn set_state(&mut self, state: TrackerState) {
        self.intake.set_state(state.clock);
        self.tracks = state.tracks;
        self.waiting = state.waiting;
        self.next_id = state.next_id;
        self.clutter = state.clutter;
    }

    fn forget(&mut self) {
        self.intake.forget();
        self.tracks.clear();
        self.waiting.clear();
        self.clutter = self.config.clutter_map.map(ClutterMapState::new);
    }

    fn check_restored(&mut self) -> Result<()> {
        self.check_parts()?;
        if let Some(map) = &mut self.clutter {
            map.restore();
        }
        Ok(())
    }
}

impl MultiTargetTracker {
    fn check_parts(&self) -> Result<()> {
        self.config.check()?;
        self.intake.check_restored()?;
        require_count("tracks", self.next_id)?;
        for report in &self.waiting {
            report.check_restored(self.config.motion.position_dims(), self.config.sensors.len())?;
        }
        for track in &self.tracks {
            require_size("track state", self.config.motion.state_dim(), track.state.dim())?;
            require_size(
                "track start",
                self.config.motion.position_dims(),
                track.start.position().len(),
            )?;
            require_size("track windows", self.config.sensors.len(), track.windows.len())?;
            require_count("reports of a track", track.hits)?;
            track.windows.iter().try_for_each(Window::check_restored)?;
            track
                .existence
                .map_or(Ok(()), |r| require_probability("track existence", r))?;
            if let Some(stored) = &track.stored {
                require_finite("time of a track", [&stored.time])?;
                require_size("stored state", track.state.dim(), stored.state.dim())?;
            }
        }
        Ok(())
    }
}
