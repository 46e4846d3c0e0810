//! What a tracker took in lately, so that a scan can be put before others or taken out again.
//!
//! * The scans stand in one order, whatever order they came in: by time, then by the sensor's name, then by content.
//! * Before the first, and then every [`SPACING`] scans, the state of the tracker is kept.
//! * A scan that belongs before others: the tracker goes back to the last state kept before that place, and takes in the scan
//!   and all after it. What the scans after it had booked is forgotten and booked anew, so that no event and no row is doubled.
//! * A scan is settled once no scan can come before it any more; its books become the tracker's.

use std::cmp::Ordering;
use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::engine::Engine;
use crate::error::{Error, Result};
use crate::event::Books;
use crate::scan::Scan;

/// Scans from one state that is kept to the next.
const SPACING: usize = 8;

/// A scan that was taken in, and what became of its rows.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Entry {
    scan: Scan,
    books: Books,
}

/// The state before an entry.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Mark<S> {
    at: usize,
    state: S,
}

/// The scans that are not settled.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Journal<S> {
    entries: VecDeque<Entry>,
    marks: VecDeque<Mark<S>>,
}

impl<S> Default for Journal<S> {
    fn default() -> Self {
        Self {
            entries: VecDeque::new(),
            marks: VecDeque::new(),
        }
    }
}

impl<S: Clone> Journal<S> {
    /// The last scan in the order of time.
    pub(super) fn last(&self) -> Option<&Scan> {
        self.entries.back().map(|entry| &entry.scan)
    }

    /// The books of all scans, in their order.
    pub(super) fn books(&self) -> impl Iterator<Item = &Books> {
        self.entries.iter().map(|entry| &entry.books)
    }

    /// Takes a scan in at its place. If that fails, everything stands as if the scan had not come.
    pub(super) fn insert<T: Engine<State = S>>(&mut self, tracker: &mut T, scan: Scan) -> Result<()> {
        let at = self
            .entries
            .partition_point(|entry| order(&entry.scan, &scan) != Ordering::Greater);
        let books = Books::default();
        self.entries.insert(at, Entry { scan, books });
        let from = if at + 1 == self.entries.len() {
            at
        } else {
            self.rewind(tracker, at)
        };
        let taken = self.replay(tracker, from);
        if taken.is_err() {
            self.remove(tracker, at)?;
        }
        taken
    }

    /// Takes the last scan out again.
    pub(super) fn remove_last<T: Engine<State = S>>(&mut self, tracker: &mut T) -> Result<Option<Scan>> {
        match self.entries.len().checked_sub(1) {
            Some(at) => self.remove(tracker, at),
            None => Ok(None),
        }
    }

    fn remove<T: Engine<State = S>>(&mut self, tracker: &mut T, at: usize) -> Result<Option<Scan>> {
        let from = self.rewind(tracker, at);
        let removed = self.entries.remove(at).map(|entry| entry.scan);
        self.replay(tracker, from)?;
        while self.marks.back().is_some_and(|mark| mark.at >= self.entries.len()) {
            self.marks.pop_back();
        }
        Ok(removed)
    }

    /// Puts the tracker back to the last state kept before that place, and returns where it stands then.
    fn rewind<T: Engine<State = S>>(&mut self, tracker: &mut T, at: usize) -> usize {
        while self.marks.len() > 1 && self.marks.back().is_some_and(|mark| mark.at > at) {
            self.marks.pop_back();
        }
        self.marks.back().map_or(0, |mark| {
            tracker.set_state(mark.state.clone());
            mark.at
        })
    }

    /// Takes in the scans from that place on.
    fn replay<T: Engine<State = S>>(&mut self, tracker: &mut T, from: usize) -> Result<()> {
        for at in from..self.entries.len() {
            if self.marks.back().is_none_or(|mark| at >= mark.at + SPACING) {
                let state = tracker.state();
                self.marks.push_back(Mark { at, state });
            }
            let Entry { scan, books } = &mut self.entries[at];
            *books = Books::new(tracker.strict());
            tracker.swap_books(books);
            let taken = tracker.update(scan);
            tracker.swap_books(books);
            taken?;
        }
        Ok(())
    }

    /// Settles scans before which none can come that is not older than `time`, as far as the states that are kept allow.
    pub(super) fn settle_before<T: Engine<State = S>>(&mut self, tracker: &mut T, time: f64) {
        while let Some(second) = self.marks.get(1).map(|mark| mark.at) {
            if !self
                .entries
                .get(second.wrapping_sub(1))
                .is_some_and(|entry| entry.scan.time < time)
            {
                return;
            }
            for entry in self.entries.drain(..second) {
                tracker.absorb(&entry.books);
            }
            self.marks.pop_front();
            for mark in &mut self.marks {
                mark.at -= second;
            }
        }
    }

    /// Settles all scans.
    pub(super) fn settle<T: Engine<State = S>>(&mut self, tracker: &mut T) {
        for entry in self.entries.drain(..) {
            tracker.absorb(&entry.books);
        }
        self.marks.clear();
    }

    /// Whether what was read back fits together; completes what is not saved.
    pub(super) fn check_restored<T: Engine<State = S>>(&mut self, tracker: &T) -> Result<()> {
        let corrupt = |reason: &str| Error::CorruptState { reason: reason.into() };
        let first = self.marks.front().map(|mark| mark.at);
        if first != (!self.entries.is_empty()).then_some(0) {
            return Err(corrupt(
                "no state is kept before the scans that can still be gone back to",
            ));
        }
        let places = self.marks.iter().map(|mark| mark.at);
        if !places.clone().is_sorted_by(|a, b| a < b) || places.max().is_some_and(|at| at >= self.entries.len()) {
            return Err(corrupt("its kept states are not in order"));
        }
        check_order(self.entries.iter().map(|entry| &entry.scan))?;
        self.entries.iter().try_for_each(|entry| entry.books.check_restored())?;
        for mark in &mut self.marks {
            let mut probe = tracker.clone();
            probe.set_state(mark.state.clone());
            probe.check_restored()?;
            mark.state = probe.state();
        }
        Ok(())
    }
}

/// Whether scans read back have times, and stand in order.
pub(super) fn check_order<'a>(scans: impl Iterator<Item = &'a Scan> + Clone) -> Result<()> {
    let timed = scans.clone().all(|scan| scan.time.is_finite());
    if timed && scans.is_sorted_by(|a, b| order(a, b) != Ordering::Greater) {
        return Ok(());
    }
    Err(Error::CorruptState {
        reason: "its scans are not in order".into(),
    })
}

/// The order of scans: by time, then by the sensor's name, then by content.
pub(super) fn order(a: &Scan, b: &Scan) -> Ordering {
    let optional = |x: &Option<Vec<f64>>, y: &Option<Vec<f64>>| match (x, y) {
        (Some(x), Some(y)) => numbers(x, y),
        _ => x.is_some().cmp(&y.is_some()),
    };
    a.time
        .partial_cmp(&b.time)
        .unwrap_or(Ordering::Equal)
        .then_with(|| a.sensor.cmp(&b.sensor))
        .then_with(|| a.values.len().cmp(&b.values.len()))
        .then_with(|| {
            let rows = a.values.iter().zip(&b.values);
            rows.map(|(x, y)| numbers(x.as_slice(), y.as_slice()))
                .find(|found| found.is_ne())
                .unwrap_or(Ordering::Equal)
        })
        .then_with(|| optional(&a.platform, &b.platform))
        .then_with(|| optional(&a.times, &b.times))
}

fn numbers(a: &[f64], b: &[f64]) -> Ordering {
    a.iter().map(|v| v.to_bits()).cmp(b.iter().map(|v| v.to_bits()))
}
