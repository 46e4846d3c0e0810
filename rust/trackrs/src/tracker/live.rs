//! A track inside the tracker, and when it is predicted from where.

use serde::{Deserialize, Serialize};

use super::lifecycle::{Start, Window};
use super::moments::TrackFilter;
use crate::error::Result;
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
}

/// The estimate after the last update, for predictions in one step (N13, `paper`).
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Stored {
    pub(super) time: f64,
    pub(super) state: Gaussian,
}

impl LiveTrack {
    /// The estimate at time `to`, the track standing at `from`.
    pub(super) fn ahead(&self, filter: TrackFilter, motion: &MotionModel, from: f64, to: f64) -> Result<Gaussian> {
        match &self.stored {
            Some(stored) => filter.predict(&stored.state, motion, to - stored.time),
            None => filter.predict(&self.state, motion, to - from),
        }
    }

    /// Takes over the estimate after an update at this time.
    pub(super) fn update(&mut self, state: Gaussian, time: f64) {
        if let Some(stored) = &mut self.stored {
            *stored = Stored {
                time,
                state: state.clone(),
            };
        }
        self.state = state;
    }

    pub(super) fn is_finite(&self) -> bool {
        let numbers = self.state.mean.iter().chain(self.state.cov.iter());
        numbers.chain(&self.existence).all(|v| v.is_finite())
    }

    /// Its position, from the leading components of the state.
    pub(super) fn position(&self, motion: &MotionModel) -> nalgebra::DVector<f64> {
        self.state.mean.rows(0, motion.position_dims()).into_owned()
    }
}
