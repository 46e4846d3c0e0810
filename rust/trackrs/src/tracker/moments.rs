//! How a tracker finds the moments of its tracks: by the rules of the filters.

use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::filter::extended::Rule;
use crate::filter::kalman::predict_by;
use crate::filter::sigma_points::SigmaPoints;
use crate::gaussian::Gaussian;
use crate::model::Motion;

/// The filter of every track. For linear models all of them are the Kalman filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum TrackFilter {
    /// Linearised at the mean ([`crate::filter::extended`]).
    #[default]
    Extended,
    /// The same, with the sensor's curvature where it has one.
    SecondOrder,
    /// By sigma points ([`crate::filter::sigma_points`]) of equal weight, which is the cubature filter.
    Unscented,
}

impl TrackFilter {
    pub(super) fn rule(self) -> Rule {
        match self {
            Self::Extended => Rule::Once,
            Self::SecondOrder => Rule::SecondOrder,
            Self::Unscented => Rule::SigmaPoints(SigmaPoints::cubature()),
        }
    }

    /// The estimate `dt` seconds later.
    pub(super) fn predict(self, prior: &Gaussian, motion: &dyn Motion, dt: f64) -> Result<Gaussian> {
        predict_by(self.rule(), prior, motion, dt, None)
    }
}
