//! Cases of many tracks.

use nalgebra::DMatrix;
use trackrs::filter::batch::Wanted;
use trackrs::filter::sequence::Filter;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk};
use trackrs::model::sensor::{LinearSensor, PositionSensor};
use trackrs::model::{MotionModel, SensorModel};
use trackrs::stats::stream::Stream;

pub(crate) const ALL: Wanted = Wanted {
    means: true,
    covs: true,
    nis: true,
};

pub(crate) fn motion(dims: usize, order: usize) -> MotionModel {
    let psd = KinematicNoise::Psd((0..dims).map(|axis| 0.3 + 0.2 * axis as f64).collect());
    match order {
        1 => MotionModel::RandomWalk(RandomWalk::new(psd).unwrap()),
        2 => MotionModel::ConstantVelocity(ConstantVelocity::new(psd).unwrap()),
        _ => MotionModel::ConstantAcceleration(ConstantAcceleration::new(psd).unwrap()),
    }
}

pub(crate) fn sensor_std(dims: usize) -> Vec<f64> {
    (0..dims).map(|axis| 1.0 + 0.5 * axis as f64).collect()
}

pub(crate) fn filter(dims: usize, order: usize) -> Filter {
    let sensor = SensorModel::Position(PositionSensor::new(sensor_std(dims)).unwrap());
    Filter::kalman(motion(dims, order), sensor).unwrap()
}

/// Times with an interval of zero and others of their own; starts of their own; some components missing.
pub(crate) struct Case {
    pub(crate) times: Vec<f64>,
    pub(crate) means: Vec<f64>,
    pub(crate) covs: Vec<f64>,
    pub(crate) values: Vec<f64>,
}

pub(crate) fn case(n: usize, components: usize, tracks: usize, steps: usize, seed: u64) -> Case {
    let mut stream = Stream::new(seed, 0);
    let mut time = 0.0;
    let times: Vec<f64> = (0..steps)
        .map(|k| {
            time += [1.0, 1.0, 0.25, 0.0, 2.5][k % 5];
            time
        })
        .collect();
    let means = (0..tracks * n).map(|_| 3.0 * stream.normal()).collect();
    let mut covs = Vec::new();
    for _ in 0..tracks {
        let root = DMatrix::from_fn(n, n, |_, _| stream.normal());
        let cov = &root * root.transpose() + DMatrix::identity(n, n) * 0.5;
        let cov = (&cov + cov.transpose()) * 0.5;
        covs.extend_from_slice(cov.as_slice());
    }
    let values = (0..tracks * steps * components)
        .map(|_| {
            let value = 5.0 * stream.normal();
            if stream.uniform() < 0.15 { f64::NAN } else { value }
        })
        .collect();
    Case {
        times,
        means,
        covs,
        values,
    }
}

/// A sensor of so many components of n states: a dense H, an offset, and an R with or without correlations.
pub(crate) fn linear(
    n: usize,
    components: usize,
    correlated: bool,
    seed: u64,
) -> (DMatrix<f64>, DMatrix<f64>, Vec<f64>) {
    let mut stream = Stream::new(seed, 1);
    let rows = DMatrix::from_fn(components, n, |_, _| stream.normal());
    let root = DMatrix::from_fn(components, components, |i, j| match (i == j, correlated) {
        (true, _) => 1.0 + stream.uniform(),
        (false, true) => 0.7 * stream.normal(),
        (false, false) => 0.0,
    });
    let noise = &root * root.transpose();
    let noise = (&noise + noise.transpose()) * 0.5;
    let offset = (0..components).map(|_| stream.normal()).collect();
    (rows, noise, offset)
}

/// The filter of a motion and such a sensor.
pub(crate) fn linear_filter(motion: MotionModel, sensor: &(DMatrix<f64>, DMatrix<f64>, Vec<f64>)) -> Filter {
    let (rows, noise, offset) = sensor.clone();
    let sensor = LinearSensor::new(rows, noise, offset.into()).unwrap();
    Filter::kalman(motion, SensorModel::Linear(sensor)).unwrap()
}

pub(crate) fn same(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len()
        && a.iter()
            .zip(b)
            .all(|(a, b)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan()))
}
