//! The two arrays of the reference scenario, and noise.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_pcg::Pcg64;
use trackrs::model::Sensor;
use trackrs::model::sensor::{RangeArray, RangeArraySettings, Side};

pub(crate) fn settings(rows: &[[f64; 3]], depth_std: Option<f64>) -> RangeArraySettings {
    RangeArraySettings {
        hydrophones: DMatrix::from_fn(rows.len(), 3, |i, j| rows[i][j]),
        range_std: vec![1.0],
        survey_std: Vec::new(),
        depth_std,
        sound_speed: None,
        side: None,
    }
}

pub(crate) const BATS: [[f64; 3]; 3] = [[0.0, 0.0, 250.0], [1000.0, 0.0, 252.0], [500.0, 866.0, 248.0]];

pub(crate) fn bats() -> RangeArray {
    RangeArray::new(settings(&BATS, Some(0.3))).unwrap()
}

pub(crate) fn toss_rows() -> [[f64; 3]; 6] {
    let heights = [0.0, 12.0, -8.0, 15.0, -12.0, 5.0];
    std::array::from_fn(|i| {
        let angle = (15.0 + 60.0 * i as f64).to_radians();
        [
            700.0 + 1200.0 * angle.cos(),
            500.0 + 1200.0 * angle.sin(),
            300.0 + heights[i],
        ]
    })
}

pub(crate) fn toss() -> RangeArray {
    let rows = toss_rows();
    RangeArray::toss(DMatrix::from_fn(6, 3, |i, j| rows[i][j]), 1.0, None, Side::Above).unwrap()
}

pub(crate) fn normal(rng: &mut Pcg64) -> f64 {
    let (u, v): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

pub(crate) fn noisy(array: &RangeArray, state: &DVector<f64>, rng: &mut Pcg64) -> DVector<f64> {
    let noise = array.noise();
    let mut z = array.observe(state, None).unwrap();
    for i in 0..z.len() {
        z[i] += noise[(i, i)].sqrt() * normal(rng);
    }
    z
}
