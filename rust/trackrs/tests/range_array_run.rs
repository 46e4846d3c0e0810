//! Filters that start themselves from the fixes of a RangeArray.

use crate::arrays::{BATS, bats, noisy, settings, toss};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use trackrs::filter::sequence::{Filter, History};
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk};
use trackrs::model::sensor::RangeArray;
use trackrs::model::{MotionModel, SensorModel};

/// Steady course seen by the array, as a list of measurements one second apart.
fn course(array: &RangeArray, steps: usize, seed: u64) -> (Vec<f64>, Vec<DVector<f64>>, Vec<DVector<f64>>) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let times: Vec<f64> = (0..steps).map(|k| k as f64).collect();
    let truth: Vec<DVector<f64>> = times
        .iter()
        .map(|t| DVector::from_vec(vec![-300.0 + 14.0 * t, -250.0 + 5.0 * t, 50.0]))
        .collect();
    let values = truth.iter().map(|x| noisy(array, x, &mut rng)).collect();
    (times, values, truth)
}

fn models() -> [MotionModel; 3] {
    [
        MotionModel::RandomWalk(RandomWalk::new(KinematicNoise::Psd(vec![200.0; 3])).unwrap()),
        MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![0.1; 3])).unwrap()),
        MotionModel::ConstantAcceleration(ConstantAcceleration::new(KinematicNoise::Std(vec![0.05; 3])).unwrap()),
    ]
}

#[test]
fn a_run_starts_itself_and_goes_on_as_if_the_start_had_been_given() {
    for array in [bats(), toss()] {
        let (times, mut values, truth) = course(&array, 40, 3);
        // A gross error and a lost channel delay the start; they must not be in it.
        values[1][0] += 300.0;
        values[4][1] = f64::NAN;
        for motion in models() {
            let filter = Filter::extended(motion, SensorModel::RangeArray(array.clone())).unwrap();
            let run = filter.run(&times, &values, None, None, History::Full).unwrap();
            // TOSS still has redundancy without one channel, BATS has none.
            assert!(run.start >= if array == bats() { 7 } else { 4 }, "{}", run.start);
            assert_eq!((run.filtered.len(), run.predicted.len(), run.nis.len()), (40, 40, 40));
            assert!(run.filtered.at(run.start - 1).mean.iter().all(|v| v.is_nan()));
            assert!(run.nis[run.start].is_nan() && run.nis[run.start + 1].is_finite());
            let begun = trackrs::filter::sequence::InitialState {
                time: times[run.start],
                state: run.filtered.at(run.start),
            };
            let from = run.start + 1;
            let given = filter
                .run(&times[from..], &values[from..], Some(&begun), None, History::Full)
                .unwrap();
            assert!(given.filtered.iter().eq(run.filtered.iter().skip(from)));
            assert_eq!(given.log_likelihood, run.log_likelihood);
            let last = filter.run(&times, &values, None, None, History::Last).unwrap();
            assert_eq!((last.filtered.len(), last.start), (1, run.start));
            assert_eq!(last.filtered.at(0), run.filtered.at(39));
            for (estimate, position) in run.filtered.iter().zip(&truth).skip(run.start) {
                let error = estimate.mean.rows(0, 3) - position;
                assert!(error.norm() < 12.0, "{error}");
            }
            let short = filter
                .run(&times[..from], &values[..from], None, None, History::Last)
                .unwrap();
            assert_eq!((short.filtered.len(), short.filtered.at(0)), (1, begun.state));
        }
    }
}

#[test]
fn a_run_that_cannot_start_says_why() {
    let [walk, ..] = models();
    let filter = Filter::extended(walk.clone(), SensorModel::RangeArray(bats())).unwrap();
    let (times, values, _) = course(&bats(), 2, 3);
    let error = filter.run(&times, &values, None, None, History::Full).unwrap_err();
    assert!(error.to_string().contains("no 3 consecutive"), "{error}");
    let mut flat = settings(&BATS, None);
    flat.hydrophones.set_column(2, &DVector::from_element(3, 250.0));
    let array = RangeArray::new(flat).unwrap();
    let (times, values, _) = course(&array, 10, 3);
    let filter = Filter::extended(walk.clone(), SensorModel::RangeArray(array)).unwrap();
    let error = filter.run(&times, &values, None, None, History::Full).unwrap_err();
    assert!(error.to_string().contains("ambiguous"), "{error}");
    let whole = DMatrix::identity(3, 3);
    let plain = trackrs::model::sensor::LinearSensor::new(whole.clone(), whole, DVector::zeros(3)).unwrap();
    let filter = Filter::extended(walk, SensorModel::Linear(plain)).unwrap();
    let error = filter.run(&times, &values, None, None, History::Full).unwrap_err();
    assert!(error.to_string().contains("initial = missing"), "{error}");
}
