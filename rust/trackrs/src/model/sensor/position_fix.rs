//! What a filter asks of a sensor to start by itself, and the answers of a [`RangeArray`].

use nalgebra::DVector;

use super::fix::Fix;
use super::{RangeArray, Sensor};
use crate::error::Result;
use crate::gaussian::Gaussian;

/// A prediction is too vague to linearise a range at it if its standard deviation across the ray is this many measured
/// ranges: then it does not even know on which side of the hydrophone the target is.
pub const VAGUE: f64 = 2.0;

/// A sensor of which one measurement, or a few together, can fix a position.
pub trait PositionFix: Send + Sync {
    /// The position, or why there is none.
    fn fix(&self, measurement: &DVector<f64>) -> Result<Fix>;
    /// `dof` of a fix with every component observed.
    fn redundancy(&self) -> usize;
    /// Mean variance of the sensor's ranges, m².
    fn range_variance(&self) -> f64;
    /// Whether a measurement could be one of this sensor at all; the error says why not.
    fn check_values(&self, measurement: &DVector<f64>) -> Result<()>;
    /// Whether enough components are observed for a fix, and for its test if the sensor allows one.
    fn sufficient(&self, measurement: &[f64]) -> bool;
    /// Positions, mirror images included, from which an iteration may begin; the measurement need not be consistent.
    fn candidates(&self, measurement: &DVector<f64>) -> Result<Vec<DVector<f64>>>;
    /// Which of two positions that fit `measurement` equally well to take; an error if nothing says so.
    fn takes_first(&self, measurement: &DVector<f64>, first: &DVector<f64>, second: &DVector<f64>) -> Result<bool>;
    /// Whether the measurement cannot be linearised at a prediction as uncertain as this.
    fn vague(&self, prediction: &Gaussian, measurement: &[f64]) -> bool;
}

impl PositionFix for RangeArray {
    fn fix(&self, measurement: &DVector<f64>) -> Result<Fix> {
        self.fix_on(measurement, self.settings.side)
    }
    fn redundancy(&self) -> usize {
        self.measurement_dim().saturating_sub(self.dims())
    }
    fn range_variance(&self) -> f64 {
        let sum: f64 = self.settings.range_std.iter().map(|std| std * std).sum();
        sum / self.channels() as f64
    }
    fn check_values(&self, measurement: &DVector<f64>) -> Result<()> {
        RangeArray::check_values(self, measurement)
    }
    fn sufficient(&self, measurement: &[f64]) -> bool {
        let heard = |part: &[f64]| part.iter().filter(|v| !v.is_nan()).count();
        let (ranges, depths) = measurement.split_at(self.channels().min(measurement.len()));
        let (ranges, depths) = (heard(ranges), heard(depths));
        ranges + depths >= self.dims() + self.redundancy().min(1) && ranges + depths.min(1) >= self.dims()
    }
    fn candidates(&self, measurement: &DVector<f64>) -> Result<Vec<DVector<f64>>> {
        self.starts(&self.sorted(measurement)?)
    }
    fn takes_first(&self, measurement: &DVector<f64>, first: &DVector<f64>, second: &DVector<f64>) -> Result<bool> {
        let depth_known = measurement.get(self.channels()).is_some_and(|z| !z.is_nan());
        let scale = (first - second).norm();
        RangeArray::takes_first(self, first, second, self.settings.side, depth_known, scale)
    }
    fn vague(&self, prediction: &Gaussian, measurement: &[f64]) -> bool {
        let d = self.dims();
        if prediction.dim() < d || measurement.len() < self.channels() {
            return false;
        }
        let position = prediction.mean.rows(0, d);
        let cov = prediction.cov.view((0, 0), (d, d));
        let spread = cov.trace();
        // The spread across a ray is at most the whole: that alone spares most epochs the rest.
        let shortest = (0..self.channels())
            .filter(|&i| !measurement[i].is_nan())
            .map(|i| measurement[i] * self.metres_per_unit(i, None))
            .fold(f64::INFINITY, f64::min);
        if spread <= VAGUE * VAGUE * shortest * shortest {
            return false;
        }
        (0..self.channels()).filter(|&i| !measurement[i].is_nan()).any(|i| {
            let offset = position - self.hydrophone(i);
            let square = offset.norm_squared();
            let along = if square > 0.0 {
                offset.dot(&(cov * &offset)) / square
            } else {
                0.0
            };
            let range = measurement[i] * self.metres_per_unit(i, None);
            spread - along > VAGUE * VAGUE * range * range
        })
    }
}
