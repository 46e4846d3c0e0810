//! A sensor that reports positions: z = p − s + v, v ~ N(0, diag(σ²)).
//!
//! p is the position of the target and s that of the platform, zero where the scan carries none:
//! a sensor on a moving platform reports positions relative to it.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{Motion, PositionFix, Sensor};
use crate::error::{Error, Result, require_size, require_std};
use crate::gaussian::Gaussian;

/// Position in 1, 2, 3 or more dimensions, with one standard deviation per axis (metres).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PositionSensor {
    std: Vec<f64>,
}

impl PositionSensor {
    /// A sensor with this standard deviation on each axis; as many axes as values.
    pub fn new(std: Vec<f64>) -> Result<Self> {
        if std.is_empty() {
            return Err(Error::invalid("dims", 0, "must be at least 1"));
        }
        std.iter().try_for_each(|&s| require_std("std", s))?;
        Ok(Self { std })
    }
}

impl Sensor for PositionSensor {
    fn measurement_dim(&self) -> usize {
        self.std.len()
    }
    fn labels(&self) -> Vec<String> {
        (0..self.std.len())
            .map(|i| {
                ["x", "y", "z"]
                    .get(i)
                    .map_or_else(|| format!("x{i}"), ToString::to_string)
            })
            .collect()
    }
    fn check(&self, motion: &dyn Motion) -> Result<()> {
        require_size("position of the motion model", self.std.len(), motion.position_dims())
    }
    fn observe(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        let mut z = state.rows(0, self.std.len()).into_owned();
        if let Some(platform) = platform {
            z -= platform;
        }
        Ok(z)
    }
    fn jacobian(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        Ok(DMatrix::identity(self.std.len(), state.len()))
    }
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        for (i, value) in expected.iter_mut().enumerate() {
            *value = state[i] - platform.map_or(0.0, |p| p[i]);
        }
        jacobian.fill(0.0);
        for i in 0..self.std.len() {
            jacobian[i * state.len() + i] = 1.0;
        }
        Ok(())
    }
    fn noise(&self) -> DMatrix<f64> {
        DMatrix::from_diagonal(&DVector::from_iterator(self.std.len(), self.std.iter().map(|s| s * s)))
    }
    fn is_linear(&self) -> bool {
        true
    }
    fn platform_dims(&self) -> Option<usize> {
        Some(self.std.len())
    }
    fn locate(&self, measurement: &DVector<f64>, platform: Option<&DVector<f64>>) -> Option<Gaussian> {
        if measurement.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let m = self.std.len();
        let mut cov = DMatrix::zeros(m, m);
        for (i, std) in self.std.iter().enumerate() {
            cov[(i, i)] = std * std;
        }
        Some(Gaussian {
            mean: platform.map_or_else(|| measurement.clone(), |p| measurement + p),
            cov,
        })
    }
    fn position_fix(&self) -> Option<&dyn PositionFix> {
        Some(self)
    }
}
