//! Scenes for the benchmarks of the core.

use nalgebra::{DMatrix, DVector};
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{MotionModel, SensorModel};
use trackrs::stats::stream::Stream;
use trackrs::{Gaussian, Scan};

/// So many numbers between two.
pub fn numbers(count: usize, low: f64, high: f64) -> Vec<f64> {
    let mut stream = Stream::new(1, 0);
    (0..count).map(|_| stream.between(low, high)).collect()
}

/// Constant velocity.
pub fn velocity(dims: usize) -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![0.1; dims])).unwrap())
}

/// Constant acceleration.
pub fn acceleration(dims: usize) -> MotionModel {
    MotionModel::ConstantAcceleration(ConstantAcceleration::new(KinematicNoise::Psd(vec![0.1; dims])).unwrap())
}

/// A sensor of positions.
pub fn positions(dims: usize) -> SensorModel {
    SensorModel::Position(PositionSensor::new(vec![1.0; dims]).unwrap())
}

/// An estimate of unit covariance.
pub fn standing(mean: Vec<f64>) -> Gaussian {
    let n = mean.len();
    Gaussian::new(DVector::from_vec(mean), DMatrix::identity(n, n)).unwrap()
}

/// Twenty scans of targets at rest, at one density whatever their number.
pub fn scans(targets: usize, clutter: usize) -> Vec<Scan> {
    let side = 100.0 * ((targets + clutter) as f64).sqrt();
    let mut stream = Stream::new(2, 0);
    let places: Vec<[f64; 2]> = (0..targets)
        .map(|_| [stream.between(0.0, side), stream.between(0.0, side)])
        .collect();
    let mut out = Vec::new();
    for k in 0..20 {
        let mut values = Vec::new();
        for place in &places {
            values.push(DVector::from_vec(vec![
                place[0] + stream.normal(),
                place[1] + stream.normal(),
            ]));
        }
        for _ in 0..clutter {
            values.push(DVector::from_vec(vec![
                stream.between(0.0, side),
                stream.between(0.0, side),
            ]));
        }
        out.push(Scan::new(f64::from(k), "radar", values));
    }
    out
}
