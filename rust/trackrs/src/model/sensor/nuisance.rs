//! Errors of a sensor that last, and are estimated with the target: extra components at the end of the state.
//!
//! | symbol | name here  | shape | meaning                                                             |
//! |--------|------------|-------|---------------------------------------------------------------------|
//! | η      |            | q     | the errors, zero on average                                         |
//! | P_η    | `std`²     | q×q   | their covariance before any measurement, diagonal                   |
//! | w      | `walk_psd` | q     | how fast they wander: η(t + dt) − η(t) has variance w dt            |
//!
//! Of a range array: η = [b_0 … b_{k−1}; s], as far as they are declared. A range is measured as h = (1 + s) |x − p| + b,
//! a travel time as that times the slowness; the depth has no such error.
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §7.3.3 (state augmentation); spec section 5 on sound speed and survey.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::RangeArray;
use crate::error::{Error, Result, require_non_negative, require_size, require_std};
use crate::gaussian::Gaussian;

/// What a sensor adds to the state.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Nuisance {
    /// Names of the components, length q.
    pub labels: Vec<String>,
    /// Standard deviations before any measurement, length q.
    pub std: Vec<f64>,
    /// Spectral densities of their random walks, length q.
    pub walk_psd: Vec<f64>,
}

impl Nuisance {
    /// Number q of components.
    pub fn dim(&self) -> usize {
        self.labels.len()
    }

    /// What is known of them before any measurement.
    pub fn prior(&self) -> Gaussian {
        let variances = DVector::from_iterator(self.dim(), self.std.iter().map(|s| s * s));
        Gaussian {
            mean: DVector::zeros(self.dim()),
            cov: DMatrix::from_diagonal(&variances),
        }
    }

    /// A kinematic state with these components behind it, known as before any measurement.
    #[must_use]
    pub fn extend(&self, state: &Gaussian) -> Gaussian {
        let (n, prior) = (state.dim(), self.prior());
        let full = n + self.dim();
        let mut out = Gaussian {
            mean: DVector::zeros(full),
            cov: DMatrix::zeros(full, full),
        };
        out.mean.rows_mut(0, n).copy_from(&state.mean);
        out.cov.view_mut((0, 0), (n, n)).copy_from(&state.cov);
        out.cov.view_mut((n, n), (self.dim(), self.dim())).copy_from(&prior.cov);
        out
    }
}

/// Range biases, one per hydrophone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct RangeBias {
    /// Metres, length k.
    pub(super) std: Vec<f64>,
    /// m²/s.
    psd: f64,
}

/// A relative error common to all ranges, such as that of the sound speed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct RangeScale {
    std: f64,
    /// 1/s.
    psd: f64,
}

/// The errors of one range: what is added to it in metres, and its relative error.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RangeError {
    pub(super) bias: f64,
    pub(super) scale: f64,
}

impl RangeArray {
    /// The array with one range bias per hydrophone as extra states, of standard deviation `std` in metres (one for all, or
    /// one per hydrophone) before any measurement, and wandering with the density `psd`, m²/s.
    pub fn with_bias(mut self, std: Vec<f64>, psd: f64) -> Result<Self> {
        let std = if std.len() == 1 {
            vec![std[0]; self.channels()]
        } else {
            std
        };
        require_size("bias_std", self.channels(), std.len())?;
        std.iter().try_for_each(|&value| require_std("bias_std", value))?;
        require_non_negative("bias_psd", psd)?;
        self.bias = Some(RangeBias { std, psd });
        Ok(self)
    }

    /// The array with one relative error of all ranges as an extra state, of standard deviation `std` before any
    /// measurement, and wandering with the density `psd`, 1/s.
    pub fn with_scale(mut self, std: f64, psd: f64) -> Result<Self> {
        require_std("scale_std", std)?;
        if std >= 1.0 {
            return Err(Error::invalid("scale_std", std, "must be less than 1: it is relative"));
        }
        require_non_negative("scale_psd", psd)?;
        self.scale = Some(RangeScale { std, psd });
        Ok(self)
    }

    /// Number q of extra states.
    pub(super) fn nuisance_dim(&self) -> usize {
        self.bias.as_ref().map_or(0, |bias| bias.std.len()) + usize::from(self.scale.is_some())
    }

    pub(super) fn declared(&self) -> Option<Nuisance> {
        let mut out = Nuisance::default();
        if let Some(bias) = &self.bias {
            out.labels = (0..bias.std.len()).map(|i| format!("bias{i}")).collect();
            out.std.clone_from(&bias.std);
            out.walk_psd = vec![bias.psd; bias.std.len()];
        }
        if let Some(scale) = self.scale {
            out.labels.push("scale".into());
            out.std.push(scale.std);
            out.walk_psd.push(scale.psd);
        }
        (out.dim() > 0).then_some(out)
    }

    /// Where the scale error stands among the extra states.
    pub(super) fn scale_index(&self) -> Option<usize> {
        self.scale.is_some().then(|| self.nuisance_dim() - 1)
    }

    /// The errors of a channel in these extra states; none of them, in a state that is a position alone.
    pub(super) fn error_of(&self, channel: usize, nuisance: &[f64]) -> RangeError {
        let bias = self.bias.as_ref().and_then(|_| nuisance.get(channel));
        let scale = self.scale_index().and_then(|index| nuisance.get(index));
        RangeError {
            bias: bias.copied().unwrap_or(0.0),
            scale: scale.copied().unwrap_or(0.0),
        }
    }

    /// Standard deviation of a channel's bias before any measurement, metres.
    pub(super) fn bias_std(&self, channel: usize) -> f64 {
        self.bias
            .as_ref()
            .and_then(|bias| bias.std.get(channel))
            .copied()
            .unwrap_or(0.0)
    }

    /// Standard deviation of the scale error before any measurement.
    pub(super) fn scale_std(&self) -> f64 {
        self.scale.map_or(0.0, |scale| scale.std)
    }
}
