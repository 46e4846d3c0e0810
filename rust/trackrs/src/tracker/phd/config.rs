//! What defines a tracker by intensity.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_non_negative, require_positive, require_size};
use crate::model::{Motion, MotionModel, Sensor, SensorModel, StateSpace};
use crate::partition::PartitionModel;
use crate::partition::tree::TreePartition;
use crate::rfs::cphd::CphdUpdate;
use crate::rfs::extended_gm_phd::ExtendedUpdate;
use crate::rfs::extent::ExtentModel;
use crate::rfs::gm_phd::PointUpdate;
use crate::rfs::mixture::Reduction;
use crate::rfs::prediction::{Birth, Fate, require_rate};
use crate::rfs::rate::{Rate, RateModel};
use crate::tracker::intake::unknown_sensor;
use crate::tracker::moments::TrackFilter;

/// A sensor and what its reports are worth.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Watch {
    /// The sensor.
    pub sensor: SensorModel,
    /// Probability that it reports a target at all, in (0, 1].
    pub detection_probability: f64,
    /// False reports per scan and unit of its measurement space.
    pub clutter_density: f64,
}

/// Births where measurements lie that nothing explains.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AdaptiveBirth {
    /// Expected number of new targets in each such place.
    pub weight: f64,
    /// Upper bound on the speed of a target, m/s; two standard deviations of a newborn's velocity.
    pub max_speed: f64,
    /// So many measurements close to one another make a place.
    pub min_measurements: usize,
}

/// When what is extracted becomes a track, and when a track ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confirmation {
    /// Extractions that confirm a track.
    pub confirm_after: u32,
    /// Scans in a row without extraction that end it.
    pub end_after: u32,
}

impl Default for Confirmation {
    fn default() -> Self {
        Self {
            confirm_after: 2,
            end_after: 3,
        }
    }
}

/// What a scan does to a mixture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum IntensityUpdate {
    /// Targets give many measurements; see [`crate::rfs::extended_gm_phd`].
    Extended(ExtendedUpdate),
    /// They give one at most; see [`crate::rfs::gm_phd`].
    Point(PointUpdate),
    /// The same, with the distribution of their number; see [`crate::rfs::cphd`].
    Cardinalised(CphdUpdate),
}

impl IntensityUpdate {
    fn check(&self, sensor: &SensorModel) -> Result<()> {
        match self {
            Self::Extended(update) => update.check(sensor),
            Self::Cardinalised(update) if update.max_targets == 0 => {
                Err(Error::invalid("max_targets", 0, "must be at least 1"))
            }
            Self::Point(_) | Self::Cardinalised(_) => Ok(()),
        }
    }

    /// How extents are learnt, where they are.
    pub(super) fn extent(&self) -> Option<&ExtentModel> {
        match self {
            Self::Extended(update) => update.extent.as_ref(),
            Self::Point(_) | Self::Cardinalised(_) => None,
        }
    }

    /// How the rates of targets are treated.
    pub(super) fn rates(&self) -> RateModel {
        match self {
            Self::Extended(update) => update.rates,
            Self::Point(_) | Self::Cardinalised(_) => RateModel::Known,
        }
    }
}

/// Everything about a tracker by intensity.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PhdConfig {
    /// How targets move.
    pub motion: MotionModel,
    /// The sensors by name; the one without a name takes every scan.
    pub watches: BTreeMap<String, Watch>,
    /// How components are predicted and seen.
    pub filter: TrackFilter,
    /// Survival, spawning, birth.
    pub fate: Fate,
    /// Births from measurements.
    pub adaptive_birth: Option<AdaptiveBirth>,
    /// What a scan does to the mixture.
    pub update: IntensityUpdate,
    /// What is kept of it.
    pub reduction: Reduction,
    /// When there is a track.
    pub confirmation: Confirmation,
    /// The first event is an error.
    pub strict: bool,
}

/// Gamma shape of the rate of a newborn.
const BIRTH_SHAPE: f64 = 10.0;

impl PhdConfig {
    /// The default filter for extended targets: all cuts of two trees, learnt rates, shared measurements. Survival and detection
    /// have probability 0.99; the sensor takes every scan.
    pub fn new(
        motion: MotionModel,
        sensor: SensorModel,
        births: Vec<Birth>,
        detections_per_target: f64,
        clutter_density: f64,
    ) -> Self {
        let watch = Watch {
            sensor,
            detection_probability: 0.99,
            clutter_density,
        };
        let reduction = Reduction::default();
        Self {
            motion,
            watches: BTreeMap::from([(String::new(), watch)]),
            filter: TrackFilter::default(),
            fate: Fate {
                survival_probability: 0.99,
                births,
                birth_rate: Rate::with_mean(detections_per_target, BIRTH_SHAPE),
                spawns: Vec::new(),
            },
            adaptive_birth: None,
            update: IntensityUpdate::Extended(ExtendedUpdate {
                rates: RateModel::default(),
                partition: PartitionModel::Tree(TreePartition::default()),
                clutter_filter: None,
                superposition: true,
                prune: reduction.prune,
                extent: None,
            }),
            reduction,
            confirmation: Confirmation::default(),
            strict: false,
        }
    }

    /// `Ok` if the parts fit together and every parameter lies in its domain.
    pub fn check(&self) -> Result<()> {
        let states = self.motion.state_dim();
        if self.motion.space() != StateSpace::euclidean(states) {
            let requirement = "must have a state in which everything adds: a mixture of attitudes has no mean";
            return Err(Error::invalid("motion", "one with an attitude", requirement));
        }
        if self.watches.is_empty() {
            return Err(Error::invalid("sensors", "empty", "must name at least one sensor"));
        }
        for watch in self.watches.values() {
            watch.sensor.check(&self.motion)?;
            if let Some(nuisance) = watch.sensor.nuisance() {
                require_size("state", states, states + nuisance.labels.len())?;
            }
            require_positive("detection_probability", watch.detection_probability)?;
            if watch.detection_probability > 1.0 {
                let value = watch.detection_probability;
                return Err(Error::invalid("detection_probability", value, "must not be above 1"));
            }
            require_non_negative("clutter_density", watch.clutter_density)?;
            self.update.check(&watch.sensor)?;
        }
        self.fate.check(states)?;
        if matches!(self.update, IntensityUpdate::Cardinalised(_)) && !self.fate.spawns.is_empty() {
            let requirement = "must be empty: the distribution of the number of targets knows births alone";
            return Err(Error::invalid("spawns", "given", requirement));
        }
        require_rate(self.fate.birth_rate)?;
        if let Some(birth) = &self.adaptive_birth {
            require_non_negative("birth weight", birth.weight)?;
            require_positive("max_speed", birth.max_speed)?;
            if birth.min_measurements == 0 {
                return Err(Error::invalid("min_measurements", 0, "must be at least 1"));
            }
        }
        let Confirmation {
            confirm_after,
            end_after,
        } = self.confirmation;
        for (name, value) in [("confirm_after", confirm_after), ("end_after", end_after)] {
            if value == 0 {
                return Err(Error::invalid(name, 0, "must be at least 1"));
            }
        }
        self.reduction.check()
    }

    /// The sensor of this name, or the one without a name.
    pub(super) fn watch(&self, name: &str) -> Result<&Watch> {
        let found = self.watches.get(name).or_else(|| self.watches.get(""));
        found.ok_or_else(|| unknown_sensor(name, self.watches.keys()))
    }
}
