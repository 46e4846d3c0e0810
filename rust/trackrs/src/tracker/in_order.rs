//! A tracker that gets its scans in the order of their times, whatever order they come in.
//!
//! | symbol | name here         | meaning                                        |
//! |--------|-------------------|------------------------------------------------|
//! | T      | `Clock::newest`   | newest time that has come and is believed      |
//! | w      | `window`          | how far behind T a scan may come, seconds      |
//!
//! * [`Late::Drop`]: a scan older than the tracker's time is dropped.
//! * [`Late::Reorder`]: a scan waits until its time < T − w; then no scan can come any more that belongs before it.
//! * [`Late::Replay`]: a scan is taken in at once; if it belongs before others, the tracker goes back to before them and takes
//!   them in again (`journal`).
//! * Either way a scan with time < T − w is dropped, and both give, bit for bit, what [`Late::Drop`] gives for the same scans in
//!   order: by time, at equal times by the sensor's name, then by content.
//! * Memory: the scans inside the window, and with `Replay` one state per eight of them.
//! * Clocks that jump: `clock.rs`. A scan on trial is taken out again if it was wrong, and its rows become rejected ones.
//! * What waits is booked as waiting; what may be gone back to is booked once, however often it is taken in.

use serde::{Deserialize, Serialize};

use super::clock::{Clock, JUMP, Step, Trial};
use super::engine::Engine;
use super::journal::{Journal, check_order, order};
use crate::error::{Error, Result, require_finite, require_positive};
use crate::event::{EventCode, EventLog, Ledger};
use crate::scan::Scan;
use crate::state;

/// What becomes of scans that come late.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub enum Late {
    /// They are dropped.
    #[default]
    Drop,
    /// Scans wait for one another.
    Reorder {
        /// How far behind the newest time a scan may come, seconds.
        window: f64,
    },
    /// The tracker goes back to before them.
    Replay {
        /// How far behind the newest time a scan may come, seconds.
        window: f64,
    },
}

impl Late {
    /// How far behind the newest time a scan may come, seconds.
    pub fn window(self) -> Option<f64> {
        match self {
            Self::Drop => None,
            Self::Reorder { window } | Self::Replay { window } => Some(window),
        }
    }
}

/// A tracker, and what stands between it and its scans.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct InOrder<T: Engine> {
    tracker: T,
    late: Late,
    clock: Clock,
    /// Scans that wait for their turn, in order.
    waiting: Vec<Scan>,
    journal: Journal<T::State>,
}

impl<T: Engine> InOrder<T> {
    /// Puts scans in order for this tracker.
    pub fn new(tracker: T, late: Late) -> Result<Self> {
        late.window()
            .map_or(Ok(()), |window| require_positive("window", window))?;
        Ok(Self {
            clock: Clock::at(tracker.time()),
            tracker,
            late,
            waiting: Vec::new(),
            journal: Journal::default(),
        })
    }

    /// The tracker, after all scans that had their turn.
    pub fn tracker(&self) -> &T {
        &self.tracker
    }

    /// What was refused or repaired so far.
    pub fn events(&self) -> EventLog {
        let mut events = self.tracker.events().clone();
        for books in self.journal.books() {
            events.absorb(&books.events);
        }
        events
    }

    /// Where every row went so far.
    pub fn ledger(&self) -> Ledger {
        let mut ledger = self.tracker.ledger().clone();
        for books in self.journal.books() {
            ledger.absorb(&books.ledger);
        }
        let waiting: u64 = self.waiting.iter().map(|scan| scan.values.len() as u64).sum();
        ledger.rows_in += waiting;
        ledger.waiting += waiting;
        ledger
    }

    /// Takes in one scan. `seen` gets the tracker after every scan that has had its turn: with [`Late::Drop`] this one, with
    /// [`Late::Reorder`] none or several others, with [`Late::Replay`] the newest so far.
    pub fn step(&mut self, scan: &Scan, mut seen: impl FnMut(&T, &Scan)) -> Result<()> {
        if let Late::Reorder { .. } = self.late {
            return self.queue(scan, seen);
        }
        if self.admit(scan, &mut seen)? {
            let next = self.waiting.first().map_or(f64::INFINITY, |scan| scan.time);
            let taken = match self.late {
                Late::Replay { .. } => self.replay(scan.clone(), next),
                // A scan on trial can be taken out again.
                _ if self.clock.trial.is_some() => self.journal.insert(&mut self.tracker, scan.clone()),
                _ => self.tracker.update(scan),
            };
            if taken.is_err() {
                self.clock.trial = None;
            }
            taken?;
        }
        let newest = match self.late {
            Late::Replay { .. } => self.journal.last(),
            _ => None,
        };
        seen(&self.tracker, newest.unwrap_or(scan));
        Ok(())
    }

    /// Takes in one scan of many that are all there already, to be followed by [`Self::flush`]: with [`Late::Replay`] too, `seen`
    /// gets the tracker after every scan in the order of time.
    pub fn queue(&mut self, scan: &Scan, mut seen: impl FnMut(&T, &Scan)) -> Result<()> {
        let Some(window) = self.late.window() else {
            return self.step(scan, seen);
        };
        if self.admit(scan, &mut seen)? {
            let at = self.waiting.partition_point(|other| order(other, scan).is_le());
            self.waiting.insert(at, scan.clone());
        }
        let turn = self.clock.newest.map_or(f64::NEG_INFINITY, |newest| newest - window);
        self.release(turn, &mut seen)
    }

    /// Takes in what waits.
    pub fn flush(&mut self, mut seen: impl FnMut(&T, &Scan)) -> Result<()> {
        self.release(f64::INFINITY, &mut seen)
    }

    /// Whether [`Self::queue`] would accept these scans: known sensors, finite times, and in order where late ones are dropped.
    pub fn check_run(&self, scans: &[Scan]) -> Result<()> {
        if self.late == Late::Drop {
            // What is on trial may be taken back.
            let before = self.clock.trial.and(self.clock.newest).or(self.tracker.time());
            return self.tracker.check_run(scans, before);
        }
        for scan in scans {
            self.tracker.check_sensor(&scan.sensor)?;
            require_finite("scan time", [&scan.time])?;
        }
        Ok(())
    }

    /// Whether a scan has a place in what is to be taken in; if not, it is booked.
    fn admit(&mut self, scan: &Scan, seen: &mut impl FnMut(&T, &Scan)) -> Result<bool> {
        if !self.tracker.has_a_place_for(scan) {
            self.tracker.update(scan)?;
            return Ok(false);
        }
        let gap = self.tracker.max_gap().unwrap_or(JUMP);
        let window = self.late.window();
        match self.clock.decide(scan.time, gap, window.unwrap_or(0.0)) {
            Trial::None => {}
            Trial::Believed if matches!(self.late, Late::Replay { .. }) => {}
            Trial::Believed => self.journal.settle(&mut self.tracker),
            Trial::Wrong => self.take_back(scan)?,
        }
        let step = self
            .clock
            .take(scan.time, &scan.sensor, gap, window.map_or(gap, |w| w.max(gap)));
        if step == Step::SetBack {
            self.release(f64::INFINITY, seen)?;
            self.journal.settle(&mut self.tracker);
            let reason = match self.tracker.time() {
                Some(before) => {
                    format!("the tracker stood at {before} s: all tracks ended, it goes on with the new time")
                }
                None => "the tracker goes on with the new time".into(),
            };
            self.tracker.forget();
            self.tracker.record(scan, EventCode::ClockSetBack, &reason)?;
        }
        let (Some(window), Some(newest)) = (window, self.clock.newest) else {
            return Ok(true);
        };
        if scan.time >= newest - window {
            return Ok(true);
        }
        let reason = format!("the newest is of {newest} s, the window {window} s long");
        self.tracker.refuse(scan, EventCode::LateScan, &reason)?;
        Ok(false)
    }

    /// Takes the scan on trial out again.
    fn take_back(&mut self, next: &Scan) -> Result<()> {
        let newest = self.clock.newest.unwrap_or(next.time);
        // What waits comes after all that had its turn.
        let wrong = match self.waiting.pop() {
            Some(scan) => Some(scan),
            None => self.journal.remove_last(&mut self.tracker)?,
        };
        let Some(wrong) = wrong else { return Ok(()) };
        let reason = format!(
            "the time before was {newest} s, the next is {} s: taken back",
            next.time
        );
        self.tracker.refuse(&wrong, EventCode::FutureScan, &reason)
    }

    /// Takes in what waits and is older than `turn`.
    fn release(&mut self, turn: f64, seen: &mut impl FnMut(&T, &Scan)) -> Result<()> {
        let mut left = std::mem::take(&mut self.waiting).into_iter().peekable();
        let mut taken = Ok(());
        while taken.is_ok()
            && let Some(scan) = left.next_if(|scan| scan.time < turn)
        {
            let on_trial = self.clock.trial.is_some_and(|trial| scan.time >= trial);
            let last = scan.clone();
            taken = match self.late {
                Late::Replay { .. } => {
                    let next = left.peek().map_or(f64::INFINITY, |scan: &Scan| scan.time);
                    self.replay(scan, next)
                }
                _ if on_trial => self.journal.insert(&mut self.tracker, scan),
                _ => self.tracker.update(&scan),
            };
            if taken.is_ok() {
                seen(&self.tracker, &last);
            } else if on_trial {
                self.clock.trial = None;
            }
        }
        self.waiting.extend(left);
        taken
    }

    /// Takes in a scan at its place, while the first that waits is of time `next`.
    fn replay(&mut self, scan: Scan, next: f64) -> Result<()> {
        self.journal.insert(&mut self.tracker, scan)?;
        if let (Some(newest), Some(window)) = (self.clock.newest, self.late.window()) {
            self.journal.settle_before(&mut self.tracker, next.min(newest - window));
        }
        Ok(())
    }

    /// Saves everything; see [`crate::state`].
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        state::to_bytes(self)
    }

    /// What goes on, bit for bit, where the saved one stood; also from the bytes of a tracker alone.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let corrupt = |error: Error| match error {
            Error::CorruptState { .. } => error,
            other => Error::CorruptState {
                reason: other.to_string(),
            },
        };
        let mut read: Self = match state::from_bytes(bytes) {
            Ok(read) => read,
            Err(error) => {
                let tracker = state::from_bytes::<T>(bytes).map_err(|_| error)?;
                Self::new(tracker, Late::Drop)?
            }
        };
        read.check_restored().map_err(corrupt)?;
        Ok(read)
    }

    fn check_restored(&mut self) -> Result<()> {
        self.tracker.check_restored()?;
        let window = self.late.window();
        window.map_or(Ok(()), |window| require_positive("window", window))?;
        self.clock.check_restored()?;
        check_order(self.waiting.iter())?;
        self.journal.check_restored(&self.tracker)
    }
}
