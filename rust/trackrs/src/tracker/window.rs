//! What a sensor has seen of a track in its last scans, and what follows from that: M of N, chances that are left, the end.

use serde::{Deserialize, Serialize};

use super::lifecycle::{Deletion, MofN};
use crate::error::{Error, Result};

/// What one sensor has seen of one track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Window {
    /// The last scans, newest in the lowest bit, 1 = hit.
    bits: u64,
    /// Scans since the first hit, up to 64.
    length: u32,
    /// Misses in a row.
    misses: u32,
}

impl Window {
    /// Takes in one scan. Scans before the first hit do not count.
    pub fn push(&mut self, hit: bool) {
        if !hit && self.length == 0 {
            return;
        }
        self.bits = self.bits << 1 | u64::from(hit);
        self.length = (self.length + 1).min(64);
        self.misses = if hit { 0 } else { self.misses.saturating_add(1) };
    }

    /// A window as if the sensor had just hit the track, for tracks that are given and not found.
    pub fn started() -> Self {
        let mut window = Self::default();
        window.push(true);
        window
    }

    /// Checks what was read back: no scan is remembered that was not counted.
    pub(super) fn check_restored(&self) -> Result<()> {
        let counted = if self.length < 64 {
            (1 << self.length) - 1
        } else {
            u64::MAX
        };
        if self.length <= 64 && self.bits & !counted == 0 {
            return Ok(());
        }
        let requirement = "must be the number of scans it remembers, at most 64";
        Err(Error::invalid("length of a track's window", self.length, requirement))
    }

    /// Whether this sensor ever hit the track.
    pub fn seen(&self) -> bool {
        self.length > 0
    }

    /// Misses among the last n scans, once there were so many; 1 ≤ n ≤ 64.
    pub(super) fn misses_of(&self, n: u32) -> Option<u32> {
        (self.length >= n).then(|| n - self.hits(n))
    }

    fn hits(&self, n: u32) -> u32 {
        (self.bits & (u64::MAX >> (64 - n))).count_ones()
    }

    /// At most N − M misses in the last N scans.
    fn alive(&self, rule: &MofN) -> bool {
        let window = self.length.min(rule.n);
        window - self.hits(rule.n) <= rule.n - rule.m
    }
}

/// Whether the windows satisfy M of N.
pub fn enough_hits(windows: &[Window], rule: &MofN) -> bool {
    windows.iter().any(|w| w.seen() && w.hits(rule.n) >= rule.m)
}

/// Whether a tentative track has no more chance.
pub fn hopeless(windows: &[Window], rule: &MofN) -> bool {
    !windows.iter().any(|w| w.seen() && w.alive(rule))
}

/// Whether a confirmed track ends; `idle` is the time since its last hit, seconds.
pub fn ended(windows: &[Window], idle: f64, rule: &Deletion) -> bool {
    let mut seen = windows.iter().filter(|w| w.seen()).peekable();
    let missed = seen.peek().is_some() && seen.all(|w| w.misses >= rule.max_misses);
    missed || rule.max_time.is_some_and(|limit| idle > limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: MofN = MofN {
        m: 3,
        n: 5,
        max_speed: 10.0,
        min_displacement: 0.0,
        min_separation: 0.0,
        pair_within: None,
    };

    fn window(scans: &[u8]) -> Window {
        let mut window = Window::default();
        for &hit in scans {
            window.push(hit == 1);
        }
        window
    }

    #[test]
    fn three_of_five() {
        assert!(enough_hits(&[window(&[1, 0, 1, 0, 1])], &RULE));
        assert!(!enough_hits(&[window(&[1, 0, 0, 1, 0, 1])], &RULE));
        assert!(!hopeless(&[window(&[1, 0, 0])], &RULE));
        assert!(hopeless(&[window(&[1, 0, 0, 0])], &RULE));
        assert!(hopeless(&[window(&[1, 1, 0, 0, 0])], &RULE));
    }

    #[test]
    fn a_window_remembers_no_scan_that_was_not_counted() {
        let mut good = window(&[1, 0, 1]);
        for _ in 0..70 {
            good.check_restored().unwrap();
            good.push(true);
        }
        for (bits, length) in [(1, 0), (0b1000, 3), (0, 65)] {
            let bad = Window {
                bits,
                length,
                misses: 0,
            };
            assert!(bad.check_restored().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_sensor_that_never_saw_the_track_has_no_say() {
        let blind = window(&[0, 0, 0, 0, 0, 0]);
        assert!(!hopeless(&[blind, window(&[1, 0])], &RULE));
        let rule = Deletion {
            max_misses: 2,
            max_time: None,
        };
        assert!(!ended(&[blind, window(&[1, 0])], 9.0, &rule));
        assert!(ended(&[blind, window(&[1, 0, 0])], 9.0, &rule));
        assert!(!ended(&[window(&[1]), window(&[1, 0, 0])], 9.0, &rule));
    }
}
