//! A track as it is reported: one estimate of one target at one time.

use serde::{Deserialize, Serialize};

use crate::gaussian::Gaussian;

/// A confirmed track at one time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Track {
    /// Identity, unique within its tracker, counted from 1 in the order of confirmation.
    pub id: u64,
    /// Time of the estimate, seconds.
    pub time: f64,
    /// The estimate.
    pub state: Gaussian,
    /// Time of the last report given to the track, seconds; earlier than `time` while it coasts.
    pub last_hit: f64,
    /// Reports given to the track so far.
    pub hits: u64,
    /// Probability that there is a target, where the tracker keeps it.
    #[serde(default)]
    pub existence: Option<f64>,
}
