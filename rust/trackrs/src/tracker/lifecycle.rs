//! When a track begins, is confirmed, and ends.
//!
//! Hits and misses are counted for every sensor apart, because sensors have different rates and see different parts of
//! the scene: a sensor that has never seen a track says nothing about it by not seeing it.
//!
//! * A tentative track is confirmed once some sensor has hit it in M of its last N scans, it has moved far enough from
//!   where it began, not too fast, and stands clear of confirmed tracks. It is dropped once every sensor
//!   that ever hit it has missed it in more than N − M of its last N scans.
//! * A confirmed track ends once every sensor that ever hit it has missed it `max_misses` times in a row, after
//!   `max_time` seconds without a hit, or when it gets faster than a target can be.
//!
//! Where the associator keeps the probability that there is a target (JIPDA), that decides instead:
//! * A report begins a track with the probability `initial` times that of no track explaining it.
//! * Between scans existence decays with `lifetime`: r ← r e^(−Δt/lifetime).
//! * A tentative track is confirmed at `confirm`, if it has moved and stands clear as above; every track ends below `drop`.
//!
//! Either way a track begins from one report, at rest, or where `pair_within` is given from two (`two_point`).
//!
//! References: Bar-Shalom, Li (1995), §3.3 (M of N); Blackman, Popoli (1999), §6.2; Mušicki, Evans (2004), JIPDA.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_non_negative, require_positive, require_probability};
use crate::gaussian::Gaussian;
use crate::model::Motion;

/// Initiation by M hits in N scans.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MofN {
    /// Hits needed.
    pub m: u32,
    /// Scans they must fall in, at most 64.
    pub n: u32,
    /// Upper bound on the speed of a target, m/s.
    pub max_speed: f64,
    /// A track must have moved this far from its first report, metres. 0 confirms targets at rest.
    pub min_displacement: f64,
    /// No track is confirmed closer than this to a confirmed one, metres: one target may give several reports.
    pub min_separation: f64,
    /// If given, two reports begin a track, at most so many seconds apart; both are hits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pair_within: Option<f64>,
}

impl MofN {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        if self.m == 0 {
            return Err(Error::invalid("m", self.m, "must be at least 1"));
        }
        if self.n < self.m || self.n > 64 {
            return Err(Error::invalid("n", self.n, "must lie between m and 64"));
        }
        require_positive("max_speed", self.max_speed)?;
        require_non_negative("min_displacement", self.min_displacement)?;
        require_non_negative("min_separation", self.min_separation)
    }
}

/// Initiation, confirmation and end by the probability that there is a target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Existence {
    /// Upper bound on the speed of a target, m/s.
    pub max_speed: f64,
    /// Probability that a report which no track explains is of a new target.
    pub initial: f64,
    /// A track is confirmed from this existence on.
    pub confirm: f64,
    /// A track below this existence ends.
    pub drop: f64,
    /// How long a target stays on the average, seconds.
    pub lifetime: f64,
    /// As in [`MofN`].
    pub min_displacement: f64,
    /// No track begins or is confirmed closer than this to a confirmed one, metres.
    pub min_separation: f64,
    /// If given, two reports begin a track, at most so many seconds apart; `initial` is the probability of the pair.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pair_within: Option<f64>,
}

impl Existence {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        require_positive("max_speed", self.max_speed)?;
        require_probability("initial", self.initial)?;
        require_probability("confirm", self.confirm)?;
        require_positive("lifetime", self.lifetime)?;
        if !(self.drop >= 0.0 && self.drop < self.confirm) {
            return Err(Error::invalid(
                "drop",
                self.drop,
                "must be at least 0 and below confirm",
            ));
        }
        if self.initial <= self.drop {
            return Err(Error::invalid("initial", self.initial, "must be above drop"));
        }
        require_non_negative("min_displacement", self.min_displacement)?;
        require_non_negative("min_separation", self.min_separation)
    }

    /// Probability that a target stays for `dt` seconds.
    pub fn survival(&self, dt: f64) -> f64 {
        libm::exp(-dt / self.lifetime)
    }
}

/// How tracks begin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Initiator {
    /// By counting hits.
    MofN(MofN),
    /// By the probability of existence.
    Existence(Existence),
}

impl Initiator {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        match self {
            Self::MofN(rule) => rule.check(),
            Self::Existence(rule) => rule.check(),
        }?;
        self.pair_within()
            .map_or(Ok(()), |within| require_positive("pair_within", within))
    }

    /// How long a report waits for a second one to begin a track with, seconds; `None`: one report is enough.
    pub fn pair_within(&self) -> Option<f64> {
        match self {
            Self::MofN(rule) => rule.pair_within,
            Self::Existence(rule) => rule.pair_within,
        }
    }

    /// Upper bound on the speed of a target, m/s.
    pub fn max_speed(&self) -> f64 {
        match self {
            Self::MofN(rule) => rule.max_speed,
            Self::Existence(rule) => rule.max_speed,
        }
    }

    /// How far a track must have moved to be confirmed, metres.
    pub fn min_displacement(&self) -> f64 {
        match self {
            Self::MofN(rule) => rule.min_displacement,
            Self::Existence(rule) => rule.min_displacement,
        }
    }

    /// No track is confirmed closer than this to a confirmed one, metres.
    pub fn min_separation(&self) -> f64 {
        match self {
            Self::MofN(rule) => rule.min_separation,
            Self::Existence(rule) => rule.min_separation,
        }
    }
}

/// The end of confirmed tracks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Deletion {
    /// Misses in a row by every sensor that ever hit the track.
    pub max_misses: u32,
    /// Seconds without a hit, if bounded.
    pub max_time: Option<f64>,
}

impl Default for Deletion {
    fn default() -> Self {
        Self {
            max_misses: 5,
            max_time: None,
        }
    }
}

impl Deletion {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        if self.max_misses == 0 {
            return Err(Error::invalid("max_misses", 0, "must be at least 1"));
        }
        self.max_time.map_or(Ok(()), |time| require_positive("max_time", time))
    }
}

/// Where a track began: the median of its first three reports, so that one stray report does not make it move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "SavedStart", into = "SavedStart")]
pub struct Start {
    dims: usize,
    /// Their positions, one after the other.
    reports: Vec<f64>,
}

/// What is saved of it: report by report.
#[derive(Serialize, Deserialize)]
struct SavedStart {
    reports: Vec<Vec<f64>>,
}

impl From<Start> for SavedStart {
    fn from(start: Start) -> Self {
        let reports = start.reports.chunks_exact(start.dims.max(1)).map(<[f64]>::to_vec);
        Self {
            reports: reports.collect(),
        }
    }
}

impl From<SavedStart> for Start {
    fn from(saved: SavedStart) -> Self {
        let dims = saved.reports.first().map_or(0, Vec::len);
        let whole = saved.reports.iter().filter(|report| report.len() == dims);
        Self {
            dims,
            reports: whole.flatten().copied().collect(),
        }
    }
}

impl Start {
    /// A track begun by a report at this position.
    pub fn new(position: &[f64]) -> Self {
        Self {
            dims: position.len(),
            reports: position.to_vec(),
        }
    }

    /// Begins anew with a report at this position.
    pub(super) fn reset(&mut self, position: &[f64]) {
        self.dims = position.len();
        self.reports.clear();
        self.reports.extend_from_slice(position);
    }

    /// Whether further reports count.
    pub fn is_open(&self) -> bool {
        self.reports.len() < 3 * self.dims
    }

    /// Takes in the position of a further report; only the first three count.
    pub fn add(&mut self, position: &[f64]) {
        if self.is_open() {
            self.reports.extend_from_slice(&position[..self.dims]);
        }
    }

    /// The median of each coordinate.
    pub fn position(&self) -> DVector<f64> {
        let median = |axis: usize| {
            let mut values = [0.0; 3];
            let coordinates = self.reports.iter().skip(axis).step_by(self.dims.max(1));
            let mut count = 0;
            for (value, &x) in values.iter_mut().zip(coordinates) {
                *value = x;
                count += 1;
            }
            let values = &mut values[..count];
            values.sort_by(f64::total_cmp);
            f64::midpoint(values[(count - 1) / 2], values[count / 2])
        };
        DVector::from_iterator(self.dims, (0..self.dims).map(median))
    }
}

/// A state of which only the position is known, or position and velocity: the rest is 0, and as uncertain as the speed
/// bound leaves it.
pub fn start_state(known: &Gaussian, motion: &dyn Motion, max_speed: f64) -> Gaussian {
    let n = motion.state_dim();
    let mut out = Gaussian {
        mean: DVector::zeros(n),
        cov: DMatrix::zeros(n, n),
    };
    start_state_into(known, motion, max_speed, &mut out);
    out
}

/// The same in the memory of a state.
pub(super) fn start_state_into(known: &Gaussian, motion: &dyn Motion, max_speed: f64, out: &mut Gaussian) {
    let (dims, n, m) = (motion.position_dims(), motion.state_dim(), known.dim());
    let (mean, cov) = (out.mean.as_mut_slice(), out.cov.as_mut_slice());
    mean.fill(0.0);
    mean[..m].copy_from_slice(known.mean.as_slice());
    cov.fill(0.0);
    for (i, column) in known.cov.as_slice().chunks_exact(m.max(1)).enumerate() {
        cov[i * n..i * n + m].copy_from_slice(column);
    }
    for i in m..n {
        let std = if i < 2 * dims {
            max_speed / 2.0
        } else {
            max_speed / 10.0
        };
        cov[i * n + i] = std * std;
    }
}

/// Whether a track has moved as a target does since it began `age` seconds ago: far enough, and not too fast, neither by
/// its estimate nor on the way it has come.
pub fn moves(state: &Gaussian, start: &DVector<f64>, age: f64, rule: &Initiator) -> bool {
    let displacement = (state.mean.rows(0, start.len()) - start).norm();
    let fast = speed(state, start.len()).max(if age > 0.0 { displacement / age } else { 0.0 }) > rule.max_speed();
    !fast && displacement >= rule.min_displacement()
}

/// Length of the velocity, 0 where the state has none.
pub fn speed(state: &Gaussian, dims: usize) -> f64 {
    if state.dim() >= 2 * dims {
        state.mean.rows(dims, dims).norm()
    } else {
        0.0
    }
}
