use nalgebra::{DMatrix, DVector};
use std::time::Instant;
use trackrs::Gaussian;
use trackrs::filter::noise::LimitedMemoryNoise;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::model::motion::{ConstantAcceleration, KinematicNoise};
use trackrs::model::sensor::{RangeArray, RangeArraySettings};
use trackrs::model::{MotionModel, SensorModel};

fn main() {
    let kind = std::env::args().nth(1).unwrap_or_default();
    let adapt = kind == "adaptive";
    let noise = if adapt { KinematicNoise::Std(vec![0.1; 3]) } else { KinematicNoise::Psd(vec![0.01; 3]) };
    let motion = MotionModel::ConstantAcceleration(ConstantAcceleration::new(noise).unwrap());
    let sensor = RangeArray::new(RangeArraySettings {
        hydrophones: DMatrix::from_row_slice(3, 3, &[0.0, 0.0, 0.0, 400.0, 0.0, 10.0, 0.0, 400.0, -10.0]),
        range_std: vec![1.0], depth_std: Some(0.5), sound_speed: None, side: None,
    }).unwrap();
    let phones = [[0.0, 0.0, 0.0], [400.0, 0.0, 10.0], [0.0, 400.0, -10.0]];
    let t = 2000;
    let values: Vec<DVector<f64>> = (0..t).map(|k| {
        let th = k as f64 * 0.01;
        let p = [150.0 + 80.0 * th.sin(), 40.0 + 80.0 * th.cos(), -30.0 + 10.0 * (0.5 * th).sin()];
        let mut z: Vec<f64> = phones.iter().map(|a| (0..3).map(|i| (p[i] - a[i]).powi(2)).sum::<f64>().sqrt() + ((k * 7919) % 13) as f64 / 6.0 - 1.0).collect();
        z.push(p[2]);
        DVector::from_vec(z)
    }).collect();
    let times: Vec<f64> = (1..=t).map(|k| k as f64 * 0.5).collect();
    let mut filter = Filter::extended(motion, SensorModel::RangeArray(sensor)).unwrap();
    if adapt { filter = filter.with_adaptation(LimitedMemoryNoise::default()).unwrap(); }
    let d: Vec<f64> = [25.0, 1.0, 0.1].iter().flat_map(|&x| [x; 3]).collect();
    let initial = InitialState { time: 0.0, state: Gaussian {
        mean: DVector::from_vec(vec![150.0, 120.0, -30.0, 0.5, -0.3, 0.0, 0.0, 0.0, 0.0]),
        cov: DMatrix::from_diagonal(&DVector::from_vec(d)) } };
    for history in [History::Last, History::Filtered, History::Full] {
        let reps = if adapt { 10 } else { 200 };
        let mut best = f64::MAX;
        for _ in 0..reps {
            let begun = Instant::now();
            let run = filter.run(&times, &values, Some(&initial), None, history).unwrap();
            best = best.min(begun.elapsed().as_secs_f64());
            std::hint::black_box(run);
        }
        println!("{history:?}: {:.3} us per epoch at best", best / t as f64 * 1e6);
    }
}
