//! A batch piece by piece: so many tracks at a time through all steps of a call, on several threads.
//!
//! Between two pieces it is asked whether to go on. The first is short; those after it grow or shrink until one lasts as long as
//! [`LASTING`] says: long enough that beginning threads does not count, short enough for who waits.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::ops::Range;
use std::time::{Duration, Instant};

use super::each::{Each, Own};
use super::kinematic::steps;
use super::{BatchRun, TrackBatch};
use crate::error::{Error, Result};
use crate::lanes::block::{self, LANES};
use crate::lanes::tracks::{Lanes, RawSensor};
use crate::model::{Motion, Sensor};
use crate::threads::{PARTS, share_out};

/// Less work in lanes than this is not worth a thread of its own: some tenths of a millisecond.
const PER_THREAD: usize = 400_000;
/// Fewer measurements than this are not worth a thread to look at them.
const LOOKED_AT: usize = 250_000;
/// Work of the first piece, in lanes and track by track.
const PIECE: usize = 32_000_000;
const PIECE_EACH: usize = 80_000;
/// So long a piece should last.
const LASTING: Range<Duration> = Duration::from_millis(12)..Duration::from_millis(36);

/// Where the tracks are.
#[derive(Debug)]
pub(super) enum States {
    Lanes(InLanes),
    Each(Vec<Own>),
}

/// Tracks in lanes.
#[derive(Debug)]
pub(super) struct InLanes {
    tracks: Box<dyn Lanes>,
    sensor: RawSensor,
    /// Those that have left them.
    pub(super) left: BTreeMap<usize, Own>,
}

impl InLanes {
    pub(super) fn new(tracks: Box<dyn Lanes>, sensor: RawSensor) -> Self {
        let left = BTreeMap::new();
        Self { tracks, sensor, left }
    }

    /// Reads a track.
    pub(super) fn get(&self, track: usize, mean: &mut [f64], cov: &mut [f64]) {
        match self.left.get(&track) {
            Some(own) => own.get(mean, cov),
            None => self.tracks.get(track, mean, cov),
        }
    }
}

impl States {
    pub(super) fn copied(&self) -> Self {
        match self {
            Self::Lanes(own) => Self::Lanes(InLanes {
                tracks: own.tracks.copied(),
                sensor: own.sensor.clone(),
                left: own.left.clone(),
            }),
            Self::Each(tracks) => Self::Each(tracks.clone()),
        }
    }
}

/// The largest absolute value, of several threads; what is NaN does not count.
pub(super) fn largest(values: &[f64], threads: usize) -> f64 {
    let threads = threads.min(values.len() / LOOKED_AT);
    if threads <= 1 {
        return block::largest(values);
    }
    let size = values.len().div_ceil(threads * PARTS);
    let mut most = vec![0.0; values.len().div_ceil(size)];
    let parts = values.chunks(size).zip(&mut most);
    let Ok(()) = share_out(parts, threads, |(part, most)| {
        *most = block::largest(part);
        Ok::<_, Infallible>(())
    });
    most.into_iter().fold(0.0, f64::max)
}

/// The work of a step of one track: numbers of its covariance, and what does not depend on them.
fn work(n: usize) -> usize {
    n * n + 16
}

/// The size of the piece after one of this size that lasted so long, a multiple of `least` as that was.
fn next_size(size: usize, least: usize, lasted: Duration) -> usize {
    if lasted < LASTING.start {
        2 * size
    } else if lasted > LASTING.end {
        (size / 2).next_multiple_of(least).max(least)
    } else {
        size
    }
}

impl TrackBatch {
    /// Sizes of pieces are multiples of it: whole blocks of lanes, or a track for each thread.
    fn least_piece(&self) -> usize {
        if self.in_lanes() { LANES } else { self.threads }
    }

    /// Tracks in the first piece of a call with so many steps.
    pub(super) fn first_piece(&self, steps: usize) -> usize {
        let piece = if self.in_lanes() { PIECE } else { PIECE_EACH };
        let tracks = piece / (steps.max(1) * work(self.filter.motion().state_dim()));
        let least = self.least_piece();
        tracks.next_multiple_of(least).max(least)
    }

    /// All tracks through all steps, from pieces of this size on.
    pub(super) fn run_pieces(
        &mut self,
        times: &[f64],
        values: &[f64],
        mut size: usize,
        out: &mut BatchRun,
        go_on: &mut dyn FnMut() -> bool,
    ) -> Result<()> {
        let (n, m) = (self.filter.motion().state_dim(), self.filter.sensor().measurement_dim());
        let least = self.least_piece();
        let lane_steps = if self.in_lanes() {
            steps(self.filter.motion(), self.time, times)
        } else {
            Vec::new()
        };
        let each = Each {
            filter: &self.filter,
            time: self.time,
            times,
        };
        let mut first = 0;
        while first < self.tracks {
            if first > 0 && !go_on() {
                return Err(Error::Interrupted);
            }
            let begun = Instant::now();
            let tracks = first..(first + size).min(self.tracks);
            let values = &values[first * times.len() * m..tracks.end * times.len() * m];
            match &mut self.states {
                States::Lanes(own) => {
                    let mut singular = vec![false; tracks.len()];
                    own.tracks.advance(
                        tracks.clone(),
                        &lane_steps,
                        &own.sensor,
                        values,
                        out.of(tracks.clone(), times.len(), n),
                        &mut self.failures[tracks.clone()],
                        &mut singular,
                        self.level,
                        self.threads
                            .min(tracks.len() * times.len() * work(n) / PER_THREAD)
                            .max(1),
                    );
                    let leaving = if singular.contains(&true) { tracks.clone() } else { 0..0 };
                    for track in leaving.filter(|&track| singular[track - tracks.start]) {
                        own.left
                            .entry(track)
                            .or_insert_with(|| Own::leaving(own.tracks.as_mut(), track, n));
                    }
                    for (&track, own) in own.left.range_mut(tracks.clone()) {
                        let from = (track - tracks.start) * times.len() * m;
                        let values = &values[from..from + times.len() * m];
                        let out = out.of(track..track + 1, times.len(), n);
                        each.run(std::slice::from_mut(own), values, out, 1)?;
                    }
                }
                States::Each(own) => {
                    let out = out.of(tracks.clone(), times.len(), n);
                    each.run(&mut own[tracks.clone()], values, out, self.threads)?;
                }
            }
            first = tracks.end;
            size = next_size(size, least, begun.elapsed());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_grow_and_shrink_until_they_last_as_they_should() {
        let lasts = |size: usize| Duration::from_micros(10 * size as u64);
        for (begun, least) in [(LANES, LANES), (3, 3), (1, 1), (1 << 20, LANES), (3 << 20, 3)] {
            let mut size = begun;
            for _ in 0..20 {
                size = next_size(size, least, lasts(size));
                assert!(size.is_multiple_of(least));
            }
            assert!(LASTING.contains(&lasts(size)), "{size}");
        }
        assert_eq!(next_size(LANES, LANES, Duration::from_secs(1)), LANES);
        assert_eq!(next_size(1, 1, Duration::from_secs(1)), 1);
    }

    #[test]
    fn the_largest_is_the_same_on_any_number_of_threads() {
        let mut values: Vec<f64> = (0..500_000).map(|k| f64::from((k * 79) % 1000) - 500.0).collect();
        values[3] = f64::NAN;
        values[499_999] = -1e40;
        for threads in 1..=6 {
            assert_eq!(largest(&values, threads), 1e40);
        }
        assert_eq!(largest(&[], 4), 0.0);
        assert_eq!(largest(&[f64::NAN], 4), 0.0);
    }
}
