//! Events: what a tracker or filter refused, repaired or received late, typed and counted; and the ledger of rows.
//!
//! Every row that comes in is used, rejected for a reason, late, a duplicate, or waits for its turn: [`Ledger::check`] asserts
//! `rows_in = used + rejected + late + duplicate + waiting`.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_count};

/// How many events are kept in full; all are counted.
pub const RECENT_EVENTS: usize = 1000;

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum EventCode {
    /// A scan older than the tracker's time was dropped.
    LateScan,
    /// A scan with the content of the sensor's last one, or a row twice in one scan, was dropped.
    Duplicate,
    /// A scan of a sensor that the tracker does not have was dropped.
    UnknownSensor,
    /// A scan whose time lies far ahead of all others was taken back, because the next one went on as before it.
    FutureScan,
    /// The clock was set back: all tracks were ended, and the tracker went on with the new time.
    ClockSetBack,
    /// A report with a time of its own that lies before the tracker's time was dropped.
    LateReport,
    /// A report whose own time is no number, or later than its scan's, was dropped.
    BadTime,
    /// A scan's time or platform position is not finite or has the wrong size; its rows were dropped.
    BadScan,
    /// A row with an infinite value was dropped.
    NonFinite,
    /// A row of the wrong length was dropped.
    WrongSize,
    /// A row with no observed component was dropped.
    NotObserved,
    /// A track could not be compared with the scan (covariance not positive definite, or target on the sensor);
    /// its prediction was kept.
    TrackSkipped,
    /// Tracks were ended because their prediction is not finite.
    TrackDiverged,
    /// All tracks were ended because the time since the scan before was longer than allowed.
    GapReset,
    /// Joint association probabilities were approximated, because the exact ones are beyond the budget.
    Approximated,
    /// A track's innovations are larger or smaller than its covariance says.
    TrackDegraded,
    /// They have been too large for long, or its reports stay away.
    TrackLost,
    /// The limit on the number of tracks was reached; reports started no track.
    TrackLimit,
    /// A covariance came close to being singular: it is carried as its square root from here on.
    Escalated,
    /// Components of a measurement failed the screen for gross errors and were not used.
    Screened,
    /// A filter that was lost started anew.
    Restarted,
    /// The prediction is too vague to use measurements by; they wait until together they give a start.
    Held,
    /// Rows before the start of a run gave none.
    NotStarted,
}

impl EventCode {
    /// The code in words, as it stands in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::LateScan => "late_scan",
            Self::Duplicate => "duplicate",
            Self::UnknownSensor => "unknown_sensor",
            Self::FutureScan => "future_scan",
            Self::ClockSetBack => "clock_set_back",
            Self::LateReport => "late_report",
            Self::BadTime => "bad_time",
            Self::BadScan => "bad_scan",
            Self::NonFinite => "non_finite",
            Self::WrongSize => "wrong_size",
            Self::NotObserved => "not_observed",
            Self::TrackSkipped => "track_skipped",
            Self::TrackDiverged => "track_diverged",
            Self::GapReset => "gap_reset",
            Self::Approximated => "approximated",
            Self::TrackDegraded => "track_degraded",
            Self::TrackLost => "track_lost",
            Self::TrackLimit => "track_limit",
            Self::Escalated => "escalated",
            Self::Screened => "screened",
            Self::Restarted => "restarted",
            Self::Held => "held",
            Self::NotStarted => "not_started",
        }
    }
}

/// One event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// What happened.
    pub code: EventCode,
    /// Time of the scan, seconds.
    pub time: f64,
    /// Its sensor; empty where there is only one.
    pub sensor: String,
    /// Row of the scan or of the run, where the event is about one row.
    pub row: Option<usize>,
    /// In words.
    pub reason: String,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at {} s", self.code.name(), self.time)?;
        if !self.sensor.is_empty() {
            write!(f, ", sensor \"{}\"", self.sensor)?;
        }
        if let Some(row) = self.row {
            write!(f, ", row {row}")?;
        }
        write!(f, ": {}", self.reason)
    }
}

/// All events counted, the last [`RECENT_EVENTS`] kept.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct EventLog {
    counts: BTreeMap<EventCode, u64>,
    recent: VecDeque<Event>,
    /// Whether the next event is an error.
    strict: bool,
}

impl EventLog {
    /// An empty log; a strict one turns the first event into an error.
    pub fn new(strict: bool) -> Self {
        Self {
            strict,
            ..Self::default()
        }
    }

    /// Records an event.
    pub fn record(&mut self, event: Event) -> Result<()> {
        if self.strict {
            return Err(Error::Strict {
                event: event.to_string(),
            });
        }
        self.note(event);
        Ok(())
    }

    /// Records an event that is no error in strict mode either: one about a track, not about what came in.
    pub fn note(&mut self, event: Event) {
        *self.counts.entry(event.code).or_default() += 1;
        if self.recent.len() == RECENT_EVENTS {
            self.recent.pop_front();
        }
        self.recent.push_back(event);
    }

    /// Takes over what another log has, as later than all of its own; no strictness is asked.
    pub fn absorb(&mut self, later: &Self) {
        for (code, count) in &later.counts {
            *self.counts.entry(*code).or_default() += count;
        }
        for event in &later.recent {
            if self.recent.len() == RECENT_EVENTS {
                self.recent.pop_front();
            }
            self.recent.push_back(event.clone());
        }
    }

    /// Checks what was read back.
    pub(crate) fn check_restored(&self) -> Result<()> {
        self.counts
            .values()
            .try_for_each(|&count| require_count("events", count))
    }

    /// Number of events of each code.
    pub fn counts(&self) -> &BTreeMap<EventCode, u64> {
        &self.counts
    }

    /// The last events, oldest first.
    pub fn recent(&self) -> impl Iterator<Item = &Event> {
        self.recent.iter()
    }
}

/// Where every row went.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Ledger {
    /// Rows received.
    pub rows_in: u64,
    /// Rows that took part in tracking.
    pub used: u64,
    /// Rows dropped because they or their scan were late.
    pub late: u64,
    /// Rows dropped because they had been received before.
    pub duplicate: u64,
    /// Rows of scans that wait for their turn.
    #[serde(default, skip_serializing_if = "is_none")]
    pub waiting: u64,
    /// Rows dropped for another reason.
    pub rejected: BTreeMap<EventCode, u64>,
}

impl Ledger {
    /// Books `rows` dropped rows under the event that dropped them.
    pub fn drop_rows(&mut self, code: EventCode, rows: u64) {
        match code {
            EventCode::LateScan | EventCode::LateReport => self.late += rows,
            EventCode::Duplicate => self.duplicate += rows,
            _ => *self.rejected.entry(code).or_default() += rows,
        }
    }

    /// Adds what another has booked.
    pub fn absorb(&mut self, other: &Self) {
        self.rows_in += other.rows_in;
        self.used += other.used;
        self.late += other.late;
        self.duplicate += other.duplicate;
        self.waiting += other.waiting;
        for (code, rows) in &other.rejected {
            *self.rejected.entry(*code).or_default() += rows;
        }
    }

    /// Checks what was read back.
    pub(crate) fn check_restored(&self) -> Result<()> {
        require_count("rows", self.rows_in)?;
        self.check()
    }

    /// The conservation law: no row is lost and none is counted twice.
    pub fn check(&self) -> Result<()> {
        let out = [self.used, self.late, self.duplicate, self.waiting];
        let out = out.iter().chain(self.rejected.values());
        let out = out.fold(0_u64, |sum, &rows| sum.saturating_add(rows));
        if out == self.rows_in {
            return Ok(());
        }
        Err(Error::Internal {
            reason: format!("{} rows came in and {out} were accounted for", self.rows_in),
        })
    }
}

/// What was refused, and where the rows went.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Books {
    /// The events.
    pub events: EventLog,
    /// The rows.
    pub ledger: Ledger,
}

impl Books {
    /// Empty ones; strict ones turn the first event into an error.
    pub fn new(strict: bool) -> Self {
        Self {
            events: EventLog::new(strict),
            ledger: Ledger::default(),
        }
    }

    /// Checks what was read back.
    pub(crate) fn check_restored(&self) -> Result<()> {
        self.events.check_restored()?;
        self.ledger.check_restored()
    }

    /// Takes over what others have, as later than all of their own.
    pub fn absorb(&mut self, later: &Self) {
        self.events.absorb(&later.events);
        self.ledger.absorb(&later.ledger);
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_none(rows: &u64) -> bool {
    *rows == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(code: EventCode) -> Event {
        Event {
            code,
            time: 1.0,
            sensor: "radar".into(),
            row: Some(3),
            reason: "why".into(),
        }
    }

    #[test]
    fn all_events_are_counted_and_the_last_kept() {
        let mut log = EventLog::new(false);
        for _ in 0..RECENT_EVENTS + 5 {
            log.record(event(EventCode::Duplicate)).unwrap();
        }
        assert_eq!(log.counts()[&EventCode::Duplicate], 1005);
        assert_eq!(log.recent().count(), RECENT_EVENTS);
    }

    #[test]
    fn strict_log_refuses() {
        let error = EventLog::new(true).record(event(EventCode::NonFinite)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "strict mode: non_finite at 1 s, sensor \"radar\", row 3: why"
        );
    }

    #[test]
    fn a_lost_row_breaks_the_ledger() {
        let mut ledger = Ledger {
            rows_in: 3,
            used: 1,
            ..Ledger::default()
        };
        ledger.drop_rows(EventCode::LateScan, 1);
        assert!(ledger.check().is_err());
        ledger.drop_rows(EventCode::NonFinite, 1);
        assert!(ledger.check().is_ok());
    }

    #[test]
    fn books_that_no_tracker_has_kept_are_refused() {
        let ledger = |rows_in, used, late| Ledger {
            rows_in,
            used,
            late,
            ..Ledger::default()
        };
        ledger(3, 2, 1).check_restored().unwrap();
        for [rows_in, used, late] in [[3, 2, 0], [u64::MAX, u64::MAX, 0], [u64::MAX, u64::MAX, 7]] {
            assert!(ledger(rows_in, used, late).check_restored().is_err());
        }
        let mut log = EventLog::default();
        log.counts.insert(EventCode::Duplicate, u64::MAX);
        assert!(log.check_restored().is_err());
    }
}
