use nalgebra::DVector;
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::tracker::phd::PhdTracker;
use trackrs::{Error, Scan};

use super::{Source, trackers};

/// A saved state with some of its bytes changed, and a checksum that fits again.
fn altered(source: &mut Source<'_>, mut bytes: Vec<u8>) -> Vec<u8> {
    let body = bytes.len() - 4;
    for _ in 0..source.below(6) {
        let at = usize::from(source.byte()) << 8 | usize::from(source.byte());
        bytes[at % body] = source.byte();
    }
    let cut = if source.below(8) == 0 { source.below(64) } else { 0 };
    bytes.truncate(body - cut.min(body));
    let checksum = crc32fast::hash(&bytes).to_le_bytes();
    bytes.extend(checksum);
    bytes
}

fn refused<T>(result: Result<T, Error>) -> Option<T> {
    match result {
        Ok(value) => Some(value),
        Err(Error::CorruptState { .. }) => None,
        Err(other) => panic!("{other}"),
    }
}

/// A tracker with tracks, tentative ones and a clutter map.
fn tracker() -> Vec<u8> {
    let bytes: Vec<u8> = (0..768_u16)
        .map(|k| if k < 2 { 0 } else { (k % 251 * 37 % 251) as u8 })
        .collect();
    let source = &mut Source::new(&bytes);
    let mut tracker = trackers::config(source)
        .and_then(MultiTargetTracker::new)
        .expect("a tracker");
    for k in 0..6 {
        let scan = trackers::scan(source, f64::from(k));
        tracker.step(&scan).expect("a scan");
    }
    tracker.to_bytes().expect("bytes")
}

fn mixture() -> Vec<u8> {
    let bytes: Vec<u8> = (0..768_u16)
        .map(|k| if k < 2 { 0 } else { (k % 251 * 91 % 251) as u8 })
        .collect();
    let source = &mut Source::new(&bytes);
    let mut tracker = trackers::intensity_tracker(source).expect("a tracker");
    for k in 0..4 {
        let scan = trackers::scan(source, f64::from(k));
        tracker.step(&scan).expect("a scan");
    }
    tracker.to_bytes().expect("bytes")
}

thread_local! {
    static TRACKER: Vec<u8> = tracker();
    static MIXTURE: Vec<u8> = mixture();
}

pub(crate) fn bytes_of_trackers(source: &mut Source<'_>) {
    drop(MultiTargetTracker::from_bytes(source.rest()));
    let bytes = altered(source, TRACKER.with(Clone::clone));
    if let Some(mut tracker) = refused(MultiTargetTracker::from_bytes(&bytes)) {
        // A changed number can be a valid one; the tracker it gives must work.
        let later = tracker.step(&Scan::new(1e3, "lidar", vec![DVector::zeros(2)]));
        assert!(later.is_ok() || tracker.config().strict, "{later:?}");
    }
}

pub(crate) fn bytes_of_mixtures(source: &mut Source<'_>) {
    drop(PhdTracker::from_bytes(source.rest()));
    let bytes = altered(source, MIXTURE.with(Clone::clone));
    if let Some(mut tracker) = refused(PhdTracker::from_bytes(&bytes)) {
        let later = tracker.step(&Scan::new(1e3, "lidar", vec![DVector::zeros(2)]));
        assert!(later.is_ok() || tracker.config().strict, "{later:?}");
    }
}
