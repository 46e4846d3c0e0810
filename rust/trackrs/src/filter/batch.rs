//! Many tracks, each with its own filter, all of one motion and one sensor and measured at the same times.
//!
//! Kalman filters of a random walk, constant velocity or constant acceleration, up to three axes, with a position sensor or a
//! linear one of up to three components go through [`crate::lanes`]: several tracks to a register. All others are run one track
//! after the other by [`super::sequence`]. Either way tracks are independent, so that threads take some each and the bits are
//! the same on any number of them.
//!
//! The lanes take the structure of the motion instead of products with F, so that their results agree with those of
//! [`Filter::run`] to rounding only. A track whose covariance comes close to being singular leaves them: from the first step of
//! that call on it is run by [`super::sequence`] and has its bits.

mod each;
mod kinematic;
mod pieces;

use std::ops::Range;

use nalgebra::DMatrix;

use self::each::Own;
use self::kinematic::structure;
use self::pieces::{InLanes, States, largest};
use super::sequence::Filter;
use super::square_root::Form;
use crate::error::{Error, Result, all_finite, require_finite, require_size};
use crate::lanes::Level;
use crate::lanes::tracks::lanes;
use crate::lanes::work::Outputs;
use crate::linalg::cholesky::Cholesky;
use crate::model::{Motion, Sensor, SensorModel};

/// Measurements, states and noise beyond this or below its inverse, and steps longer than this, are suspected of overflow.
const HUGE: f64 = 1e30;
const LONG: f64 = 1e10;

/// Many tracks at one time.
#[derive(Debug)]
pub struct TrackBatch {
    filter: Filter,
    tracks: usize,
    time: f64,
    level: Level,
    threads: usize,
    states: States,
    failures: Vec<u64>,
    /// Whether numbers have come in with which an estimate could overflow: only then is it looked at for that.
    huge: bool,
}

/// What is wanted of a run; all of it tracks first, then steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Wanted {
    /// Means.
    pub means: bool,
    /// Covariances.
    pub covs: bool,
    /// Normalised innovations squared.
    pub nis: bool,
}

/// What a run gives: flat, empty where not wanted. B tracks, T steps, n states.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BatchRun {
    /// B × T × n.
    pub means: Vec<f64>,
    /// B × T × n × n.
    pub covs: Vec<f64>,
    /// B × T; NaN where nothing was observed.
    pub nis: Vec<f64>,
}

impl BatchRun {
    /// The part of some tracks, of T steps and n states.
    fn of(&mut self, tracks: Range<usize>, steps: usize, n: usize) -> Outputs<'_> {
        let part = |width: usize| tracks.start * steps * width..tracks.end * steps * width;
        Outputs {
            means: self.means.get_mut(part(n)).unwrap_or_default(),
            covs: self.covs.get_mut(part(n * n)).unwrap_or_default(),
            nis: self.nis.get_mut(part(1)).unwrap_or_default(),
        }
    }
}

impl TrackBatch {
    /// Tracks of this filter that begin at `time`: means B × n, covariances B × n × n or n × n for all.
    pub fn new(filter: Filter, time: f64, means: &[f64], covs: &[f64]) -> Result<Self> {
        let n = filter.motion().state_dim();
        require_finite("time", [&time])?;
        require_finite("means", means)?;
        require_finite("covs", covs)?;
        if n == 0 || !means.len().is_multiple_of(n) {
            return Err(Error::invalid(
                "means",
                means.len(),
                "must have n numbers for every track",
            ));
        }
        let tracks = means.len() / n;
        let shared = covs.len() == n * n;
        if !shared {
            require_size("covs", tracks * n * n, covs.len())?;
        }
        let cov_of = |track: usize| {
            if shared {
                covs
            } else {
                &covs[track * n * n..(track + 1) * n * n]
            }
        };
        for track in 0..if shared { tracks.min(1) } else { tracks } {
            let name = if shared {
                "cov".to_string()
            } else {
                format!("cov of track {track}")
            };
            let cov = DMatrix::from_row_slice(n, n, cov_of(track));
            if cov != cov.transpose() {
                return Err(Error::invalid(&name, "a matrix", "must be symmetric"));
            }
            Cholesky::new(&cov, &name)?;
        }
        let level = Level::chosen()?;
        let mut noise = vec![filter.sensor().noise(), filter.motion().noise(1.0)];
        if let SensorModel::Linear(sensor) = filter.sensor() {
            noise.push(sensor.matrix().clone());
            noise.push(DMatrix::from_column_slice(
                sensor.offset().len(),
                1,
                sensor.offset().as_slice(),
            ));
        }
        let ordinary = |value: &f64| value.abs() <= HUGE && (*value == 0.0 || value.abs() >= 1.0 / HUGE);
        let all = means
            .iter()
            .chain(covs)
            .chain(noise.iter().flat_map(|noise| noise.iter()));
        let huge = !all.copied().all(|value| ordinary(&value));
        let in_lanes =
            structure(&filter).and_then(|known| Some((lanes(known.dims, known.order, tracks)?, known.sensor)));
        let states = match in_lanes {
            Some((mut lanes, sensor)) => {
                for track in 0..tracks {
                    lanes.set(track, &means[track * n..(track + 1) * n], cov_of(track));
                }
                States::Lanes(InLanes::new(lanes, sensor))
            }
            None => States::Each(
                (0..tracks)
                    .map(|track| Own::new(&means[track * n..(track + 1) * n], cov_of(track)))
                    .collect(),
            ),
        };
        Ok(Self {
            filter,
            tracks,
            time,
            level,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            states,
            failures: vec![0; tracks],
            huge,
        })
    }

    /// The same batch at this level of instructions; the bits are the same at all.
    #[must_use]
    pub fn at_level(mut self, level: Level) -> Self {
        self.level = level;
        self
    }

    /// The same batch on at most so many threads; the bits are the same on any number.
    pub fn with_threads(mut self, threads: usize) -> Result<Self> {
        if threads == 0 {
            return Err(Error::invalid("threads", 0, "must be at least 1"));
        }
        self.threads = threads;
        Ok(self)
    }

    /// How many tracks.
    pub fn tracks(&self) -> usize {
        self.tracks
    }

    /// Their time, seconds.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Their filter.
    pub fn filter(&self) -> &Filter {
        &self.filter
    }

    /// Whether several tracks share a register.
    pub fn in_lanes(&self) -> bool {
        matches!(self.states, States::Lanes(..))
    }

    /// Per track, how many measurements were left out because the innovation covariance was not positive definite.
    pub fn failures(&self) -> &[u64] {
        &self.failures
    }

    /// Per track, whether its covariance came close to being singular and is carried as its square root since.
    pub fn escalated(&self) -> Vec<bool> {
        let escalated = |own: &Own| own.factor.is_some() && self.filter.method().form == Form::Joseph;
        let of = |track: usize| match &self.states {
            States::Lanes(own) => own.left.get(&track).is_some_and(escalated),
            States::Each(tracks) => escalated(&tracks[track]),
        };
        (0..self.tracks).map(of).collect()
    }

    /// Means B × n.
    pub fn means(&self) -> Vec<f64> {
        self.copied().0
    }

    /// Covariances B × n × n.
    pub fn covs(&self) -> Vec<f64> {
        self.copied().1
    }

    fn copied(&self) -> (Vec<f64>, Vec<f64>) {
        let n = self.filter.motion().state_dim();
        let (mut means, mut covs) = (vec![0.0; self.tracks * n], vec![0.0; self.tracks * n * n]);
        for (track, (mean, cov)) in means.chunks_exact_mut(n).zip(covs.chunks_exact_mut(n * n)).enumerate() {
            match &self.states {
                States::Lanes(own) => own.get(track, mean, cov),
                States::Each(tracks) => tracks[track].get(mean, cov),
            }
        }
        (means, covs)
    }

    /// Takes in T measurements of every track, B × T × m; NaN = not observed.
    pub fn run(&mut self, times: &[f64], values: &[f64], wanted: Wanted) -> Result<BatchRun> {
        self.run_while(times, values, wanted, || true)
    }

    /// The same, as long as `go_on` says so, which is asked every few hundredths of a second. After an error the tracks
    /// are as they were.
    pub fn run_while(
        &mut self,
        times: &[f64],
        values: &[f64],
        wanted: Wanted,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<BatchRun> {
        let (n, m) = (self.filter.motion().state_dim(), self.filter.sensor().measurement_dim());
        require_size("measurements", self.tracks * times.len() * m, values.len())?;
        require_finite("times", times)?;
        if largest(values, self.threads) > HUGE {
            if let Some(index) = values.iter().position(|value| value.is_infinite()) {
                return Err(Error::NonFinite {
                    what: "measurement".into(),
                    index,
                });
            }
            self.huge = true;
        }
        let mut previous = self.time;
        for &time in times {
            if time < previous {
                return Err(Error::TimeReversed { time, previous });
            }
            self.huge = self.huge || time - previous > LONG;
            previous = time;
        }
        let rows = self.tracks * times.len();
        // Zeros cost nothing until they are written over, and everything is.
        let sized = |wanted: bool, width: usize| vec![0.0; if wanted { rows * width } else { 0 }];
        let mut out = BatchRun {
            means: sized(wanted.means, n),
            covs: sized(wanted.covs, n * n),
            nis: sized(wanted.nis, 1),
        };
        let size = self.first_piece(times.len());
        // One piece is not interrupted, and lanes do not fail but by overflow.
        let strict = self.filter.strict();
        let may_fail = !self.in_lanes() || self.tracks > size || self.huge || strict;
        let copy = may_fail.then(|| (self.states.copied(), self.failures.clone()));
        let mut result = self.run_pieces(times, values, size, &mut out, &mut go_on);
        if result.is_ok() && self.huge {
            result = self.require_finite();
        }
        match (result, copy) {
            (Ok(()), _) => {
                self.time = previous;
                Ok(out)
            }
            (Err(error), copy) => {
                if let Some((states, failures)) = copy {
                    (self.states, self.failures) = (states, failures);
                }
                Err(error)
            }
        }
    }

    fn require_finite(&self) -> Result<()> {
        let n = self.filter.motion().state_dim().max(1);
        let (means, covs) = self.copied();
        let tracks = means.chunks_exact(n).zip(covs.chunks_exact(n * n));
        let finite = |(mean, cov): (&[f64], &[f64])| all_finite(mean) && all_finite(cov);
        match tracks.map(finite).position(|finite| !finite) {
            None => Ok(()),
            Some(track) => Err(Error::Overflow {
                what: format!("estimate of track {track}"),
            }),
        }
    }
}
