//! The tracker by intensity as one that can be put back to where it stood.

use serde::{Deserialize, Serialize};

use super::PhdTracker;
use super::config::IntensityUpdate;
use super::labels::Labels;
use crate::error::{Result, require_non_negative, require_size};
use crate::event::{Books, EventCode, EventLog, Ledger};
use crate::model::{Motion, SensorModel};
use crate::rfs::cphd::Cardinality;
use crate::rfs::mixture::Component;
use crate::rfs::prediction::Birth;
use crate::scan::Scan;
use crate::track::Track;
use crate::tracker::engine::Engine;
use crate::tracker::intake::{Intake, IntakeState, Needs};

/// What a scan changes in a tracker by intensity, its books apart.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PhdState {
    clock: IntakeState,
    mixture: Vec<Component>,
    tracks: Vec<Track>,
    labels: Labels,
    pending: Vec<Birth>,
    cardinality: Option<Cardinality>,
}

impl Engine for PhdTracker {
    type State = PhdState;

    fn time(&self) -> Option<f64> {
        self.intake.time
    }

    fn strict(&self) -> bool {
        self.config.strict
    }

    fn max_gap(&self) -> Option<f64> {
        None
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
        let fits = |sensor: &SensorModel| Intake::fault(scan, sensor, Needs::Everything).is_none();
        self.config.watch(&scan.sensor).is_ok_and(|watch| fits(&watch.sensor))
    }

    fn check_run(&self, scans: &[Scan], before: Option<f64>) -> Result<()> {
        Intake::check_run(scans, before, |name| self.config.watch(name).map(|watch| &watch.sensor))
    }

    fn check_sensor(&self, name: &str) -> Result<()> {
        self.config.watch(name).map(|_| ())
    }

    fn update(&mut self, scan: &Scan) -> Result<()> {
        Self::update(self, scan)
    }

    fn state(&self) -> PhdState {
        PhdState {
            clock: self.intake.state(),
            mixture: self.mixture.clone(),
            tracks: self.tracks.clone(),
            labels: self.labels.clone(),
            pending: self.pending.clone(),
            cardinality: self.cardinality.clone(),
        }
    }

    fn set_state(&mut self, state: PhdState) {
        self.intake.set_state(state.clock);
        self.mixture = state.mixture;
        self.tracks = state.tracks;
        self.labels = state.labels;
        self.pending = state.pending;
        self.cardinality = state.cardinality;
    }

    fn forget(&mut self) {
        self.intake.forget();
        self.mixture.clear();
        self.tracks.clear();
        self.labels.forget();
        self.pending.clear();
        if let IntensityUpdate::Cardinalised(update) = &self.config.update {
            self.cardinality = Some(Cardinality::none(update.max_targets));
        }
    }

    fn check_restored(&mut self) -> Result<()> {
        self.config.check()?;
        self.intake.check_restored()?;
        self.labels.check_restored()?;
        let states = self.config.motion.state_dim();
        let components = self.mixture.iter().map(|c| &c.state);
        if let Some(model) = self.config.update.extent() {
            for extent in self.mixture.iter().filter_map(|c| c.extent.as_ref()) {
                extent.check(model.prior.cov.nrows())?;
            }
        }
        for component in &self.mixture {
            require_non_negative("weight of a component", component.weight)?;
        }
        for state in components.chain(self.pending.iter().map(|birth| &birth.state)) {
            require_size("component", states, state.dim())?;
        }
        Ok(())
    }
}
