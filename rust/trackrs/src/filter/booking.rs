//! The books of a run: which rows were used, and what happened on the way.

use super::run::FilterRun;
use super::runner::Epoch;
use super::screen::{Screened, Verdict};
use super::search::Start;
use crate::error::Result;
use crate::event::{Event, EventCode, EventLog};

/// Where in a run something happened.
pub(super) struct Place {
    pub(super) row: usize,
    pub(super) time: f64,
}

impl FilterRun {
    /// Books one row.
    pub(super) fn book(&mut self, place: &Place, measurement: &[f64], epoch: &Epoch<'_>) -> Result<()> {
        let (events, ledger) = (&mut self.books.events, &mut self.books.ledger);
        ledger.rows_in += 1;
        if epoch.escalated {
            let reason = "the covariance is nearly singular: carried as its square root from here on";
            record(events, place, EventCode::Escalated, reason)?;
        }
        if let Some(reason) = epoch.screened.and_then(rejection) {
            record(events, place, EventCode::Screened, &reason)?;
        }
        if epoch.held && ledger.waiting == 0 {
            let reason = "the prediction is too vague to use measurements by: they wait until they give a start";
            record(events, place, EventCode::Held, reason)?;
        }
        if epoch.restarted {
            let reason = "started anew from the last measurements";
            record(events, place, EventCode::Restarted, reason)?;
            ledger.used += 1 + std::mem::take(&mut ledger.waiting);
        } else if measurement.iter().all(|z| z.is_nan()) {
            ledger.drop_rows(EventCode::NotObserved, 1);
        } else if epoch.held {
            ledger.waiting += 1;
        } else if epoch.dof == 0 {
            ledger.drop_rows(EventCode::Screened, 1);
        } else {
            ledger.used += 1;
        }
        Ok(())
    }

    /// Books the rows up to and with the one that starts a run.
    pub(super) fn book_start(&mut self, start: &Start) -> Result<()> {
        let rows = start.row + 1;
        let before = rows - start.rows.min(rows);
        let ledger = &mut self.books.ledger;
        ledger.rows_in += rows as u64;
        ledger.used += (rows - before) as u64;
        if before == 0 {
            return Ok(());
        }
        ledger.drop_rows(EventCode::NotStarted, before as u64);
        let place = Place {
            row: start.row,
            time: start.initial.time,
        };
        let reason = format!("{before} rows before the start gave none");
        record(&mut self.books.events, &place, EventCode::NotStarted, &reason)
    }
}

fn record(events: &mut EventLog, place: &Place, code: EventCode, reason: &str) -> Result<()> {
    events.record(Event {
        code,
        time: place.time,
        sensor: String::new(),
        row: Some(place.row),
        reason: reason.into(),
    })
}

/// What was rejected, in words.
fn rejection(screened: &Screened) -> Option<String> {
    let verdicts = screened.verdicts.iter().enumerate();
    let rejected: Vec<String> = verdicts
        .filter(|&(_, verdict)| *verdict == Verdict::Rejected)
        .map(|(i, _)| i.to_string())
        .collect();
    let (list, p) = (rejected.join(", "), screened.p_value);
    (!rejected.is_empty()).then(|| format!("components {list} rejected; of all observed ones p = {p:.1e}"))
}
