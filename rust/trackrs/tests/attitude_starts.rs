//! Filters with an attitude that start themselves: from poses and from images.

use crate::bodies::{body, camera, draw, filters, measured, nees, pose, record, start_of_body};
use crate::draws::normal;
use nalgebra::DVector;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use trackrs::filter::sequence::{Filter, History};
use trackrs::filter::smoother::fixed_interval;
use trackrs::metric::consistency::average_band;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk};
use trackrs::model::sensor::AttitudeForm;
use trackrs::model::{Motion, MotionModel};

/// From image points alone, without being told where the body is; some points hidden on the way.
#[test]
fn a_camera_filter_starts_itself_and_follows() {
    let sensor = camera(0.5);
    for (name, filter) in filters(&body(), &sensor) {
        let space = filter.motion().space();
        let mut start = start_of_body();
        start.cov *= 0.04;
        let mut data = record(&filter, &start, 0.05, 120, &mut Pcg64::seed_from_u64(12));
        for k in (10..120).filter(|k| k % 4 > 0) {
            data.values[k].rows_mut(2 * (k % 3), 4).fill(f64::NAN);
        }
        let run = filter
            .run(&data.times, &data.values, None, None, History::Full)
            .unwrap();
        assert_eq!(run.start, 2);
        let worst = (10..120)
            .map(|k| nees(space, &data.truth[k], &run.filtered.at(k)))
            .fold(0.0, f64::max);
        // Chi-square of 18 degrees of freedom is above 65 once in 3 million.
        assert!(worst < 65.0, "{name}: {worst}");
        let told = filter
            .run(&data.times, &data.values, Some(&data.initial), None, History::Last)
            .unwrap();
        let (found, told) = (run.filtered.at(119), told.filtered.at(0));
        let size = found.cov.diagonal().map(f64::sqrt);
        let apart = space.difference(&found.mean, &told.mean).component_div(&size);
        assert!(apart.amax() < 0.1, "{name}: {}", apart.amax());
        let back = fixed_interval(&run.epochs().unwrap()).unwrap();
        assert_eq!(back.states.len(), 118);
    }
}

/// The state that three poses give has the covariance that it states, for every kinematic motion and unequal steps.
#[test]
fn starts_from_three_poses_are_consistent() {
    let psd = |p: f64| KinematicNoise::Psd(vec![p; 6]);
    let motions = [
        (MotionModel::RandomWalk(RandomWalk::new(psd(0.02)).unwrap()), 1),
        (
            MotionModel::ConstantVelocity(ConstantVelocity::new(psd(0.05)).unwrap()),
            2,
        ),
        (
            MotionModel::ConstantAcceleration(ConstantAcceleration::new(psd(0.5)).unwrap()),
            3,
        ),
        (body(), 3),
    ];
    let (runs, times) = (400, [0.0, 0.04, 0.1]);
    for (motion, order) in motions {
        let n = 6 * order;
        let band = average_band(n, runs, 0.99).unwrap();
        let sensors = [
            pose(Some(2e-3), 5e-3, AttitudeForm::Quaternion),
            pose(Some(2e-3), 5e-3, AttitudeForm::Euler),
            camera(0.5),
        ];
        for (which, sensor) in sensors.into_iter().enumerate() {
            let filter = Filter::extended(motion.clone(), sensor).unwrap();
            let space = filter.motion().space();
            let (mut rng, mut sum, mut started) = (Pcg64::seed_from_u64(31), 0.0, 0);
            while started < runs {
                let mut state = DVector::from_fn(n, |i, _| [0.2, 1.0, 3.0][i / 6] * normal(&mut rng));
                state[2] += 1.5;
                if which < 2 {
                    state[5] += 3.1;
                }
                let mut values = Vec::new();
                for k in 0..3 {
                    if k > 0 {
                        let dt = times[k] - times[k - 1];
                        let noise = draw(&filter.motion().noise_at(&state, dt), &mut rng);
                        state = space.retract(&filter.motion().propagate(&state, dt), &noise);
                    }
                    values.push(measured(filter.sensor(), &state, &mut rng));
                }
                // One camera fix in a hundred fails its test.
                if let Ok(run) = filter.run(&times, &values, None, None, History::Full) {
                    assert_eq!(run.start, 2);
                    sum += nees(space, &state, &run.filtered.at(2));
                    started += 1;
                }
            }
            let mean = sum / runs as f64;
            assert!(
                (band.lower..band.upper).contains(&mean),
                "{n} states, sensor {which}: {mean}"
            );
        }
    }
}
