//! A track inside the tracker, and when it is predicted from where.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::health::Monitor;
use super::lifecycle::Start;
use super::look::Look;
use super::window::Window;
use crate::error::Result;
use crate::filter::prediction::{Course, Prediction};
use crate::gaussian::Gaussian;
use crate::model::{Motion, MotionModel};

/// A track inside the tracker, tentative while it has no id.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct LiveTrack {
    pub(super) id: Option<u64>,
    /// The estimate at the tracker's time.
    pub(super) state: Gaussian,
    /// Where predictions begin, if not at `state`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) stored: Option<Stored>,
    pub(super) start: Start,
    pub(super) born: f64,
    pub(super) windows: Vec<Window>,
    pub(super) last_hit: f64,
    pub(super) hits: u64,
    /// Probability that there is a target, where that is kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) existence: Option<f64>,
    #[serde(default, skip_serializing_if = "Monitor::is_empty")]
    pub(super) monitor: Monitor,
    #[serde(default, skip_serializing_if = "Rooted::is_never")]
    pub(super) rooted: Rooted,
}

/// Whether a step of a track was done by roots, because its covariance came close to being singular.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(super) enum Rooted {
    #[default]
    Never,
    /// In this scan for the first time.
    Now,
    Before,
}

impl Rooted {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
    fn is_never(&self) -> bool {
        *self == Self::Never
    }

    /// It happened in this scan.
    pub(super) fn again(&mut self) {
        if *self == Self::Never {
            *self = Self::Now;
        }
    }
}

/// The estimate after the last update, for predictions in one step (N13, `paper`).
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Stored {
    pub(super) time: f64,
    pub(super) state: Gaussian,
}

impl LiveTrack {
    /// Memory for a track.
    pub(super) fn blank(n: usize) -> Self {
        Self {
            id: None,
            state: Gaussian {
                mean: DVector::zeros(n),
                cov: DMatrix::zeros(n, n),
            },
            stored: None,
            start: Start::new(&[]),
            born: 0.0,
            windows: Vec::new(),
            last_hit: 0.0,
            hits: 0,
            existence: None,
            monitor: Monitor::default(),
            rooted: Rooted::Never,
        }
    }

    /// Predicts the estimate from one time to another.
    pub(super) fn advance(
        &mut self,
        prediction: &mut Prediction,
        motion: &MotionModel,
        from: f64,
        to: f64,
    ) -> Result<()> {
        let (prior, dt) = match &self.stored {
            Some(stored) => (&stored.state, to - stored.time),
            None => (&self.state, to - from),
        };
        let course = Course {
            motion,
            dt,
            input: None,
            noise: None,
        };
        if prediction.predict_definite(prior, &course)? {
            self.rooted.again();
        }
        copy(&prediction.state, &mut self.state);
        Ok(())
    }

    /// Takes over the estimate after an update at this time.
    pub(super) fn update_from(&mut self, state: &Gaussian, time: f64) {
        copy(state, &mut self.state);
        self.update_stays(time);
    }

    /// The same where the estimate stays what it is.
    pub(super) fn update_stays(&mut self, time: f64) {
        if let Some(stored) = &mut self.stored {
            stored.time = time;
            copy(&self.state, &mut stored.state);
        }
    }

    /// Books that a report of a scan is its own.
    pub(super) fn hit_by(&mut self, look: &Look, row: usize, nis: f64) {
        if self.id.is_some() {
            let observed = look.rows[row].value.iter().filter(|v| !v.is_nan()).count();
            self.monitor.hit(nis, observed);
        }
        self.last_hit = look.rows[row].time;
        self.hits += 1;
        if self.start.is_open()
            && let Some(position) = look.position(row)
        {
            self.start.add(position.mean.as_slice());
        }
    }

    /// Books whether a scan of a sensor gave it a report.
    pub(super) fn looked_at(&mut self, sensor: usize, hit: bool) {
        self.windows[sensor].push(hit);
        if self.windows[sensor].seen() {
            self.monitor.look(hit);
        }
    }

    pub(super) fn is_finite(&self) -> bool {
        // Without a branch, so that several numbers are looked at at once.
        let all = |numbers: &[f64]| numbers.iter().fold(true, |all, v| all & v.is_finite());
        all(self.state.mean.as_slice()) && all(self.state.cov.as_slice()) && self.existence.is_none_or(f64::is_finite)
    }

    /// Its position, from the leading components of the state.
    pub(super) fn position(&self, motion: &MotionModel) -> &[f64] {
        &self.state.mean.as_slice()[..motion.position_dims()]
    }
}

fn copy(from: &Gaussian, to: &mut Gaussian) {
    to.mean.as_mut_slice().copy_from_slice(from.mean.as_slice());
    to.cov.as_mut_slice().copy_from_slice(from.cov.as_slice());
}

/// The distance of two points.
pub(super) fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}
