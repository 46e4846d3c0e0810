//! Random finite sets: filters that carry the intensity of all targets together, as a mixture of Gaussians.
//!
//! An update turns the mixture, where it stands, into that after the scan, not reduced: first all components as missed, then
//! those that the measurements make. It returns how many components could not be compared with the scan, because the sensor
//! stands on them or their covariance is not positive definite: these do not count as missed. With an error the mixture stays
//! as it was. A covariance that would come close to being singular, predicted or updated, is found by the root of the one before
//! (`filter/escalation.rs`), and its component is marked as `rooted`.

pub(crate) mod cells;
pub mod cphd;
pub mod extended_gm_phd;
pub mod extent;
pub mod gm_phd;
pub(crate) mod group;
pub mod mixture;
pub mod prediction;
pub mod rate;
pub(crate) mod spread;
pub(crate) mod sums;
pub(crate) mod view;

use nalgebra::DVector;

use crate::filter::extended::Rule;
use crate::model::Sensor;

/// What a sensor measures, of what, and how it is seen.
pub struct Sight<'a> {
    /// The sensor.
    pub sensor: &'a dyn Sensor,
    /// Where it is, if it moves.
    pub platform: Option<&'a DVector<f64>>,
    /// How h is linearised.
    pub rule: Rule,
    /// p_D, in (0, 1].
    pub detection_probability: f64,
    /// κ.
    pub clutter_density: f64,
}
