//! What a filter asks of a sensor to start by itself, and the answers of a [`RangeArray`]; others are in `direct_fix.rs`.

use nalgebra::DVector;

use super::fix::Fix;
use super::{RangeArray, Sensor};
use crate::error::{Error, Result};
use crate::gaussian::Gaussian;

/// A prediction is too vague to linearise a range at it if its standard deviation across the ray is this many measured
/// ranges: then it does not even know on which side of the hydrophone the target is.
pub const VAGUE: f64 = 2.0;

/// A sensor of which one measurement, or a few together, can fix a position.
pub trait PositionFix: Send + Sync {
    /// The position, or why there is none.
    fn fix(&self, measurement: &DVector<f64>) -> Result<Fix>;
    /// What errors call the sensor.
    fn name(&self) -> &'static str {
        "the sensor"
    }
    /// `dof` of a fix with every component observed.
    fn redundancy(&self) -> usize {
        0
    }
    /// Mean variance of the sensor's ranges, m²; 0 where it has none.
    fn range_variance(&self) -> f64 {
        0.0
    }
    /// Whether a measurement could be one of this sensor at all; the error says why not.
    fn check_values(&self, measurement: &DVector<f64>) -> Result<()> {
        let index = measurement.iter().position(|v| v.is_infinite());
        let what = || "measurement".into();
        index.map_or(Ok(()), |index| Err(Error::NonFinite { what: what(), index }))
    }
    /// Whether enough components are observed for a fix, and for its test if the sensor allows one.
    fn sufficient(&self, measurement: &[f64]) -> bool {
        measurement.iter().all(|v| v.is_finite())
    }
    /// Whether several measurements, each with some of the components, make one with the means of their components.
    fn gathers(&self) -> bool {
        false
    }
    /// Which coordinates of a fix are angles, in radians.
    fn angles(&self) -> &[usize] {
        &[]
    }
    /// Positions, mirror images included, from which an iteration may begin; the measurement need not be consistent.
    fn candidates(&self, measurement: &DVector<f64>) -> Result<Vec<DVector<f64>>> {
        self.fix(measurement).map(|fix| vec![fix.position.mean])
    }
    /// Which of two positions that fit `measurement` equally well to take; an error if nothing says so.
    fn takes_first(&self, _measurement: &DVector<f64>, _first: &DVector<f64>, _second: &DVector<f64>) -> Result<bool> {
        Ok(true)
    }
    /// Whether the measurement cannot be linearised at a prediction as uncertain as this.
    fn vague(&self, _prediction: &Gaussian, _measurement: &[f64]) -> bool {
        false
    }
}

impl PositionFix for RangeArray {
    fn name(&self) -> &'static str {
        "the array"
    }
    fn gathers(&self) -> bool {
        true
    }
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
