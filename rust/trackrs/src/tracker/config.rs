//! What defines a multi-target tracker.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::clutter_map::ClutterMap;
use super::lifecycle::{Deletion, MofN};
use crate::association::nearest::Associator;
use crate::error::{Error, Result, require_finite, require_positive, require_size};
use crate::filter::sequence::InitialState;
use crate::gating::mahalanobis::Gate;
use crate::model::{Motion, MotionModel, Sensor, SensorModel};

/// Everything that defines a tracker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrackerConfig {
    /// How targets move.
    pub motion: MotionModel,
    /// The sensors by name.
    pub sensors: BTreeMap<String, SensorModel>,
    /// How reports are given to tracks.
    pub associator: Associator,
    /// Which reports a track may get.
    pub gate: Gate,
    /// When tracks begin.
    pub initiator: MofN,
    /// When they end.
    pub deletion: Deletion,
    /// Static echoes start no tracks, where a map is kept.
    pub clutter_map: Option<ClutterMap>,
    /// All tracks end when no scan came for so many seconds, if bounded.
    pub max_gap: Option<f64>,
    /// No more than so many tracks, tentative ones included.
    pub max_tracks: usize,
    /// The first event is an error.
    pub strict: bool,
    /// Tracks that are there from the beginning, confirmed.
    pub initial: Vec<InitialState>,
}

impl TrackerConfig {
    /// A tracker of these models with a gate of 0.99, 3 of 5 initiation and deletion after 5 misses.
    pub fn new(motion: MotionModel, sensors: BTreeMap<String, SensorModel>, max_speed: f64) -> Result<Self> {
        Ok(Self {
            motion,
            sensors,
            associator: Associator::default(),
            gate: Gate::new(0.99)?,
            initiator: MofN {
                m: 3,
                n: 5,
                max_speed,
                min_displacement: 0.0,
                min_separation: 0.0,
            },
            deletion: Deletion {
                max_misses: 5,
                max_time: None,
            },
            clutter_map: None,
            max_gap: None,
            max_tracks: 10_000,
            strict: false,
            initial: Vec::new(),
        })
    }

    /// Whether the parts fit together and every parameter lies in its domain.
    pub fn check(&self) -> Result<()> {
        if self.sensors.is_empty() {
            return Err(Error::invalid("sensors", "empty", "must name at least one sensor"));
        }
        for (name, sensor) in &self.sensors {
            sensor.check(&self.motion)?;
            if let Some(nuisance) = sensor.nuisance() {
                return Err(Error::invalid(
                    &format!("sensor \"{name}\""),
                    format!("one with the extra states {}", nuisance.labels.join(" ")),
                    "must have none: the tracker's states are those of the motion alone",
                ));
            }
        }
        if self.max_tracks == 0 {
            return Err(Error::invalid("max_tracks", 0, "must be at least 1"));
        }
        self.initiator.check()?;
        self.deletion.check()?;
        self.clutter_map.map_or(Ok(()), |map| map.check())?;
        self.max_gap.map_or(Ok(()), |gap| require_positive("max_gap", gap))?;
        for start in &self.initial {
            require_finite("initial time", [&start.time])?;
            require_size("initial state", self.motion.state_dim(), start.state.dim())?;
        }
        Ok(())
    }
}
