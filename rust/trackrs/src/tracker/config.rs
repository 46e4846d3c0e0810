//! What defines a multi-target tracker.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::clutter_map::ClutterMap;
use super::intake::unknown_sensor;
use super::lifecycle::{Deletion, Initiator, MofN};
use super::moments::TrackFilter;
use crate::association::associator::Associator;
use crate::association::odds::{Odds, require_detection};
use crate::error::{Error, Result, require_finite, require_non_negative, require_positive, require_size};
use crate::filter::sequence::InitialState;
use crate::gating::mahalanobis::Gate;
use crate::model::{Motion, MotionModel, Sensor, SensorModel};

/// Probability of detection where none is given.
pub const DETECTION_PROBABILITY: f64 = 0.9;

/// Everything that defines a tracker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrackerConfig {
    /// How targets move.
    pub motion: MotionModel,
    /// The sensors by name.
    pub sensors: BTreeMap<String, SensorModel>,
    /// The filter of every track.
    #[serde(default)]
    pub filter: TrackFilter,
    /// How reports are given to tracks.
    pub associator: Associator,
    /// Which reports a track may get.
    pub gate: Gate,
    /// Probability that a sensor reports a target, by its name; [`DETECTION_PROBABILITY`] where not given.
    #[serde(default)]
    pub detection_probability: BTreeMap<String, f64>,
    /// False reports per unit of the measurement space and scan, by the sensor's name, where known.
    #[serde(default)]
    pub clutter_density: BTreeMap<String, f64>,
    /// When tracks begin.
    pub initiator: Initiator,
    /// When they end, if that is not for their existence to decide; by [`Deletion::default`] if not given.
    pub deletion: Option<Deletion>,
    /// Static echoes start no tracks, where a map is kept.
    pub clutter_map: Option<ClutterMap>,
    /// All tracks end when no scan came for so many seconds, if bounded.
    pub max_gap: Option<f64>,
    /// No more than so many tracks, tentative ones and reports that wait for a second one included.
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
            filter: TrackFilter::default(),
            associator: Associator::default(),
            gate: Gate::new(0.99)?,
            detection_probability: BTreeMap::new(),
            clutter_density: BTreeMap::new(),
            initiator: Initiator::MofN(MofN {
                m: 3,
                n: 5,
                max_speed,
                min_displacement: 0.0,
                min_separation: 0.0,
                pair_within: None,
            }),
            deletion: None,
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
        let has_velocity = self.motion.state_dim() >= 2 * self.motion.position_dims();
        if let Some(within) = self.initiator.pair_within().filter(|_| !has_velocity) {
            let requirement = "must not be given: the motion has no velocity";
            return Err(Error::invalid("pair_within", within, requirement));
        }
        self.deletion.map_or(Ok(()), |rule| rule.check())?;
        self.check_association()?;
        self.clutter_map.map_or(Ok(()), |map| map.check())?;
        self.max_gap.map_or(Ok(()), |gap| require_positive("max_gap", gap))?;
        for start in &self.initial {
            require_finite("initial time", [&start.time])?;
            require_size("initial state", self.motion.state_dim(), start.state.dim())?;
        }
        Ok(())
    }

    /// What a sensor's detections are worth, as the associators need it.
    pub fn odds(&self, sensor: &str) -> Odds {
        let given = |map: &BTreeMap<String, f64>| map.get(sensor).copied();
        Odds {
            detection: given(&self.detection_probability).unwrap_or(DETECTION_PROBABILITY),
            gate: self.gate.probability(),
            density: given(&self.clutter_density).unwrap_or(0.0),
        }
    }

    /// The sensor of this name.
    pub fn sensor(&self, name: &str) -> Result<&SensorModel> {
        let found = self.sensors.get(name);
        found.ok_or_else(|| unknown_sensor(name, self.sensors.keys()))
    }

    fn check_association(&self) -> Result<()> {
        self.associator.check()?;
        for (sensor, &value) in &self.detection_probability {
            self.require_sensor(sensor)?;
            require_detection(&format!("detection_probability of \"{sensor}\""), value)?;
        }
        for (sensor, &value) in &self.clutter_density {
            self.require_sensor(sensor)?;
            require_non_negative(&format!("clutter_density of \"{sensor}\""), value)?;
        }
        if self.associator.needs_density() {
            if let Some(sensor) = self
                .sensors
                .keys()
                .find(|name| !self.clutter_density.contains_key(*name))
            {
                let name = format!("clutter_density of \"{sensor}\"");
                let requirement = "must be given for this associator: false reports per unit of the measurement space";
                return Err(Error::invalid(&name, "None", requirement));
            }
            require_detection("probability", self.gate.probability())?;
        }
        let by_existence = matches!(self.initiator, Initiator::Existence(_));
        if by_existence != matches!(self.associator, Associator::Jipda { .. }) {
            let requirement = "JIPDA and initiation by existence need one another";
            return Err(Error::invalid(
                "associator",
                "this one with this initiator",
                requirement,
            ));
        }
        if by_existence && self.deletion.is_some() {
            return Err(Error::invalid(
                "deletion",
                "given",
                "must not be: existence decides when tracks end",
            ));
        }
        Ok(())
    }

    fn require_sensor(&self, sensor: &str) -> Result<()> {
        self.sensor(sensor).map(|_| ())
    }
}
