//! Tracks against truth over time: GOSPA and OSPA, who was held by which track, false tracks, switches, consistency.
//!
//! At every scored time the truth is interpolated linearly, what lies outside the region is left out on both sides, and
//! the rest is paired by GOSPA. From the pairs follow
//! * held: of the times with every target inside the region, the share with every target paired;
//! * switch: a target is paired with another track than the one it was paired with last;
//! * fragment: a maximal run of pairs of one target with one track, misses between them allowed;
//! * false track: a track that was counted but never paired;
//! * position NEES: eᵀ P⁻¹ e of every pair, on the position.
//!
//! A track inside the region whose nearest target lies outside it, closer than the cutoff, is right about a target that
//! does not count: it does not count either.
//!
//! Reference: Rahmathullah, Garcia-Fernandez, Svensson (2017), Generalized optimal sub-pattern assignment metric;
//! Schuhmacher, Vo, Vo (2008), A consistent metric for performance evaluation of multi-object filters.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{DMatrix, DVector};

use super::gospa::{Gospa, gospa};
use super::ospa::{Ospa, ospa};
use crate::error::{Error, Result, require_finite, require_positive, require_size};
use crate::linalg::cholesky::Cholesky;
use crate::track::Track;

/// A target counts as present so long before its first and after its last known position, seconds.
pub const TRUTH_TOLERANCE: f64 = 0.5;

/// Where one target really was.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthPath {
    /// Its name.
    pub id: String,
    /// Times, seconds, increasing.
    pub times: Vec<f64>,
    /// Positions at these times.
    pub positions: Vec<DVector<f64>>,
}

impl TruthPath {
    /// A checked path: as many positions as times, all of one size and finite, times increasing.
    pub fn new(id: String, times: Vec<f64>, positions: Vec<DVector<f64>>) -> Result<Self> {
        require_size("truth positions", times.len(), positions.len())?;
        require_finite("truth times", &times)?;
        for position in &positions {
            require_size("truth position", positions[0].len(), position.len())?;
            require_finite("truth position", position.iter())?;
        }
        for pair in times.windows(2) {
            if pair[1] <= pair[0] {
                return Err(Error::TimeReversed {
                    time: pair[1],
                    previous: pair[0],
                });
            }
        }
        Ok(Self { id, times, positions })
    }

    /// The position at this time, interpolated; `None` where the target is not known to be present.
    pub fn at(&self, time: f64) -> Option<DVector<f64>> {
        let (first, last) = (*self.times.first()?, *self.times.last()?);
        if time < first - TRUTH_TOLERANCE || time > last + TRUTH_TOLERANCE {
            return None;
        }
        let after = self.times.partition_point(|&t| t < time);
        if after == 0 {
            return self.positions.first().cloned();
        }
        if after == self.times.len() {
            return self.positions.last().cloned();
        }
        let (t0, t1) = (self.times[after - 1], self.times[after]);
        let weight = (time - t0) / (t1 - t0);
        Some(&self.positions[after - 1] * (1.0 - weight) + &self.positions[after] * weight)
    }
}

/// The tracks at one scored time.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Seconds.
    pub time: f64,
    /// Tracks at that time.
    pub tracks: Vec<Track>,
    /// Centre of the scored region, for example the own ship.
    pub centre: Option<DVector<f64>>,
}

/// How tracks are scored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scoring {
    /// c: a target and a track farther apart than this do not match, metres.
    pub cutoff: f64,
    /// p, at least 1.
    pub order: f64,
    /// α of GOSPA, 2 for its decomposition into localisation, missed and false.
    pub alpha: f64,
    /// Radius of the scored region around each frame's centre, metres, if bounded.
    pub region: Option<f64>,
}

/// The score at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameScore {
    /// Seconds.
    pub time: f64,
    /// Targets inside the region.
    pub targets: usize,
    /// Tracks that count.
    pub tracks: usize,
    /// GOSPA with its parts.
    pub gospa: Gospa,
    /// OSPA with its parts, of the same order and cutoff.
    pub ospa: Ospa,
}

/// What became of one target.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TargetScore {
    /// Its name.
    pub id: String,
    /// Scored times with the target inside the region.
    pub present: usize,
    /// Of these, times with a track paired with it.
    pub held: usize,
    /// Tracks that held it one after the other.
    pub fragments: usize,
    /// Changes from one track to another.
    pub switches: usize,
    /// The longest time one track held it, as a share of `present`.
    pub longest: f64,
}

/// The scores of a whole run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Evaluation {
    /// One score per frame.
    pub frames: Vec<FrameScore>,
    /// One score per target.
    pub targets: Vec<TargetScore>,
    /// Mean GOSPA over the frames.
    pub gospa: f64,
    /// Mean OSPA over the frames.
    pub ospa: f64,
    /// Mean p-th power of the localisation part of GOSPA.
    pub localisation: f64,
    /// Mean p-th power of the missed part.
    pub missed: f64,
    /// Mean p-th power of the false part.
    pub false_tracks: f64,
    /// Share of the frames with all targets in the region in which all are held; NaN if there is none.
    pub all_held: f64,
    /// Changes of track, all targets together.
    pub switches: usize,
    /// Ids of tracks that were counted but never paired.
    pub false_ids: Vec<u64>,
    /// Their number per minute between the first and the last frame.
    pub false_per_minute: f64,
    /// Root mean square distance of the pairs, metres; NaN without a pair.
    pub rmse: f64,
    /// Mean position NEES of the pairs, equal to the number of dimensions if covariances are honest; NaN without a pair.
    pub nees: f64,
}

/// Scores the frames against the truth.
pub fn evaluate(truth: &[TruthPath], frames: &[Frame], scoring: &Scoring) -> Result<Evaluation> {
    if let Some(radius) = scoring.region {
        require_positive("region", radius)?;
    }
    let mut names = BTreeSet::new();
    if let Some(path) = truth.iter().find(|path| !names.insert(&path.id)) {
        return Err(Error::invalid("truth", &path.id, "must be there once"));
    }
    let mut tally = Tally::new(truth);
    let mut scores = Vec::with_capacity(frames.len());
    for frame in frames {
        scores.push(score(truth, frame, scoring, &mut tally)?);
    }
    let found = tally.finish(scores, frames);
    for (name, value) in [("RMSE", found.rmse), ("NEES", found.nees)] {
        if value.is_infinite() {
            return Err(Error::Overflow { what: name.into() });
        }
    }
    Ok(found)
}

fn score(truth: &[TruthPath], frame: &Frame, scoring: &Scoring, tally: &mut Tally) -> Result<FrameScore> {
    let dims = truth
        .iter()
        .find_map(|path| path.positions.first())
        .map_or(0, DVector::len);
    if let Some(centre) = &frame.centre {
        require_size("coordinates of a centre", dims, centre.len())?;
    }
    let present: Vec<(usize, DVector<f64>)> = truth
        .iter()
        .enumerate()
        .filter_map(|(i, path)| Some((i, path.at(frame.time)?)))
        .collect();
    let inside = |position: &DVector<f64>| match (&frame.centre, scoring.region) {
        (Some(centre), Some(radius)) => (position - centre).norm() <= radius,
        _ => true,
    };
    let counted: Vec<&(usize, DVector<f64>)> = present.iter().filter(|(_, p)| inside(p)).collect();
    let mut tracks: Vec<(&Track, DVector<f64>)> = Vec::new();
    let mut ids = BTreeSet::new();
    for track in &frame.tracks {
        if !ids.insert(track.id) {
            let value = format!("{} twice at {} s", track.id, frame.time);
            return Err(Error::invalid("track id", value, "must be there once at a time"));
        }
        if track.state.dim() < dims {
            return Err(Error::dimension("track state", dims, track.state.dim()));
        }
        let position = track.state.mean.rows(0, dims).into_owned();
        let distance = |other: &DVector<f64>| (other - &position).norm();
        let nearest = present.iter().min_by(|a, b| distance(&a.1).total_cmp(&distance(&b.1)));
        let excused = nearest.is_some_and(|(_, p)| !inside(p) && distance(p) < scoring.cutoff);
        if inside(&position) && !excused {
            tracks.push((track, position));
        }
    }
    let targets = stack(counted.iter().map(|(_, p)| p), dims);
    let estimates = stack(tracks.iter().map(|(_, p)| p), dims);
    let gospa = gospa(&targets, &estimates, scoring.cutoff, scoring.order, scoring.alpha)?;
    tally.all_present += usize::from(!truth.is_empty() && counted.len() == truth.len());
    tally.all_held += usize::from(!truth.is_empty() && gospa.pairs.len() == truth.len());
    for (index, _) in &counted {
        tally.targets[*index].score.present += 1;
    }
    tally.seen.extend(tracks.iter().map(|(track, _)| track.id));
    for pair in &gospa.pairs {
        let (track, position) = &tracks[pair.estimate];
        let (index, target) = counted[pair.truth];
        tally.pair(*index, track.id);
        let error = target - position;
        let factor = Cholesky::new(&track.state.leading(dims).cov, "track position covariance")?;
        tally.nees.push(factor.whiten(&error).norm_squared());
        tally.squared_errors.push(error.norm_squared());
    }
    Ok(FrameScore {
        time: frame.time,
        targets: counted.len(),
        tracks: tracks.len(),
        ospa: ospa(&targets, &estimates, scoring.cutoff, scoring.order)?,
        gospa,
    })
}

fn stack<'a>(points: impl ExactSizeIterator<Item = &'a DVector<f64>>, dims: usize) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(points.len(), dims);
    for (mut row, point) in out.row_iter_mut().zip(points) {
        row.copy_from(&point.transpose());
    }
    out
}

/// What is gathered over the frames.
struct Tally {
    targets: Vec<TargetTally>,
    seen: BTreeSet<u64>,
    paired: BTreeSet<u64>,
    all_present: usize,
    all_held: usize,
    nees: Vec<f64>,
    squared_errors: Vec<f64>,
}

struct TargetTally {
    score: TargetScore,
    track: Option<u64>,
    held_by: BTreeMap<u64, usize>,
}

impl Tally {
    fn new(truth: &[TruthPath]) -> Self {
        let target = |path: &TruthPath| TargetTally {
            score: TargetScore {
                id: path.id.clone(),
                ..TargetScore::default()
            },
            track: None,
            held_by: BTreeMap::new(),
        };
        Self {
            targets: truth.iter().map(target).collect(),
            seen: BTreeSet::new(),
            paired: BTreeSet::new(),
            all_present: 0,
            all_held: 0,
            nees: Vec::new(),
            squared_errors: Vec::new(),
        }
    }

    fn pair(&mut self, target: usize, track: u64) {
        self.paired.insert(track);
        let tally = &mut self.targets[target];
        tally.score.held += 1;
        if tally.track != Some(track) {
            tally.score.fragments += 1;
            tally.score.switches += usize::from(tally.track.is_some());
        }
        tally.track = Some(track);
        *tally.held_by.entry(track).or_default() += 1;
    }

    fn finish(self, frames: Vec<FrameScore>, input: &[Frame]) -> Evaluation {
        let mean = |part: fn(&FrameScore) -> f64| average(frames.iter().map(part));
        let false_ids: Vec<u64> = self.seen.difference(&self.paired).copied().collect();
        let minutes = match (input.first(), input.last()) {
            (Some(first), Some(last)) => (last.time - first.time) / 60.0,
            _ => 0.0,
        };
        let finish = |mut tally: TargetTally| {
            let longest = tally.held_by.values().max().copied().unwrap_or(0);
            tally.score.longest = longest as f64 / tally.score.present.max(1) as f64;
            tally.score
        };
        let targets: Vec<TargetScore> = self.targets.into_iter().map(finish).collect();
        Evaluation {
            gospa: mean(|f| f.gospa.total),
            ospa: mean(|f| f.ospa.total),
            localisation: mean(|f| f.gospa.localisation),
            missed: mean(|f| f.gospa.missed),
            false_tracks: mean(|f| f.gospa.false_tracks),
            all_held: self.all_held as f64 / self.all_present as f64,
            switches: targets.iter().map(|t| t.switches).sum(),
            false_per_minute: if minutes > 0.0 {
                false_ids.len() as f64 / minutes
            } else {
                f64::NAN
            },
            false_ids,
            rmse: average(self.squared_errors.into_iter()).sqrt(),
            nees: average(self.nees.into_iter()),
            frames,
            targets,
        }
    }
}

/// The mean, NaN of nothing.
fn average(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}
