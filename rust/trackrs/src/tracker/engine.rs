//! What a tracker must be able to do for time to be put in order around it ([`super::in_order`]).

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::Result;
use crate::event::{Books, EventCode, EventLog, Ledger};
use crate::scan::Scan;

/// A tracker that takes scans in the order of their times and can be put back to where it stood.
pub trait Engine: Clone + Serialize + DeserializeOwned {
    /// Everything a scan changes, the books apart.
    type State: Clone + Serialize + DeserializeOwned;

    /// Time of the last scan it took, seconds.
    fn time(&self) -> Option<f64>;

    /// Whether the first event is an error.
    fn strict(&self) -> bool;

    /// Longest time without a scan that leaves tracks alive, seconds, if bounded.
    fn max_gap(&self) -> Option<f64>;

    /// What was refused or repaired.
    fn events(&self) -> &EventLog;

    /// Where the rows went.
    fn ledger(&self) -> &Ledger;

    /// Puts other books in the place of its own.
    fn swap_books(&mut self, books: &mut Books);

    /// Takes over what other books have.
    fn absorb(&mut self, later: &Books);

    /// Drops a whole scan: all its rows are booked under that code.
    fn refuse(&mut self, scan: &Scan, code: EventCode, reason: &str) -> Result<()>;

    /// Records an event about a scan.
    fn record(&mut self, scan: &Scan, code: EventCode, reason: &str) -> Result<()>;

    /// Whether the scan has a place in time and fits a sensor; one that has not is refused by [`Self::update`].
    fn has_a_place_for(&self, scan: &Scan) -> bool;

    /// Whether a run over these scans would be accepted: known sensors, finite times that never decrease from `before` on.
    fn check_run(&self, scans: &[Scan], before: Option<f64>) -> Result<()>;

    /// Whether it knows the sensor.
    fn check_sensor(&self, name: &str) -> Result<()>;

    /// Takes in one scan.
    fn update(&mut self, scan: &Scan) -> Result<()>;

    /// What can be put back.
    fn state(&self) -> Self::State;

    /// Stands where it stood; the books stay as they are.
    fn set_state(&mut self, state: Self::State);

    /// Ends all tracks and forgets the time. Identities are not given again.
    fn forget(&mut self);

    /// Whether what was read back is a tracker; completes what is not saved.
    fn check_restored(&mut self) -> Result<()>;
}
