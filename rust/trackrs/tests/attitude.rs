//! Filters and smoothers of states with an attitude: consistency, free turns, invariance, and what is not observed.

use crate::bodies::{Recording, body, camera, draw, filters, measured, nees, pose, record, start_of_body};
use crate::draws::normal;
use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use trackrs::Gaussian;
use trackrs::filter::lead::Lead;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::smoother::fixed_interval;
use trackrs::metric::consistency::average_band;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk};
use trackrs::model::sensor::AttitudeForm;
use trackrs::model::{Motion, MotionModel, Rotation, Sensor};

fn turning(psd: f64) -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![psd; 3])).unwrap())
}

/// Errors by `difference` have the covariance that the filter states: of a body that turns through the half turn, from poses
/// and from image points.
#[test]
fn filters_are_consistent() {
    let runs = 300;
    let band = average_band(18, runs, 0.99).unwrap();
    for (sensor, what) in [
        (pose(Some(2e-3), 0.01, AttitudeForm::Quaternion), "pose"),
        (camera(0.5), "camera"),
    ] {
        for (name, filter) in filters(&body(), &sensor) {
            let space = filter.motion().space();
            let (mut rng, mut sum, mut turned) = (Pcg64::seed_from_u64(5), 0.0, 0.0_f64);
            for _ in 0..runs {
                let data = record(&filter, &start_of_body(), 0.05, 25, &mut rng);
                let run = filter
                    .run(&data.times, &data.values, Some(&data.initial), None, History::Last)
                    .unwrap();
                sum += nees(space, &data.truth[24], &run.filtered.at(0));
                for state in &data.truth {
                    turned = turned.max(state.fixed_rows::<3>(3).norm());
                }
            }
            let mean = sum / runs as f64;
            assert!(turned > 3.1, "{turned}");
            assert!((band.lower..band.upper).contains(&mean), "{what}, {name}: {mean}");
        }
    }
}

/// A correction turns the axes that the covariance stands in: without the change of `chart.rs` this is 4.0.
#[test]
fn large_corrections_turn_the_covariance() {
    let (runs, std) = (4000, [0.3, 0.3, 0.01]);
    let band = average_band(3, runs, 0.99).unwrap();
    let walk = MotionModel::RandomWalk(RandomWalk::new(KinematicNoise::Psd(vec![0.0; 3])).unwrap());
    let start = Gaussian {
        mean: DVector::from_vec(vec![0.3, -2.0, 1.0]),
        cov: DMatrix::from_fn(3, 3, |i, j| if i == j { std[i] * std[i] } else { 0.0 }),
    };
    let filter = Filter::extended(walk, pose(None, 0.05, AttitudeForm::Quaternion)).unwrap();
    let space = filter.motion().space();
    let (mut rng, mut sum, mut without) = (Pcg64::seed_from_u64(8), 0.0, 0.0);
    for _ in 0..runs {
        let truth = space.retract(&start.mean, &draw(&start.cov, &mut rng));
        let z = measured(filter.sensor(), &truth, &mut rng);
        let posterior = filter.update(&start, &z, None).unwrap().posterior;
        sum += nees(space, &truth, &posterior);
        let gain = start.cov.clone() * (&start.cov + filter.sensor().noise()).try_inverse().unwrap();
        let cov = (DMatrix::identity(3, 3) - gain) * &start.cov;
        let mean = posterior.mean;
        without += nees(space, &truth, &Gaussian { mean, cov });
    }
    let (with, without) = (sum / runs as f64, without / runs as f64);
    assert!((band.lower..band.upper).contains(&with), "{with} not in {band:?}");
    assert!(without > 1.2 * band.upper, "{without}");
}

fn run_of(filter: &Filter, data: &Recording) -> trackrs::filter::run::FilterRun {
    filter
        .run(&data.times, &data.values, Some(&data.initial), None, History::Full)
        .unwrap()
}

/// Rotation vectors and angles differ by a b/2 where two angles are a and b, their rates as much: by the square of the angles, so
/// that ten times smaller angles agree a hundred times better.
#[test]
fn small_angles_are_those_of_the_euler_filter() {
    let psd = [1e-6, 1e-6, 1e-6, 1e-2, 1e-2, 1e-2];
    let apart = |size: f64| {
        let scale: Vec<f64> = psd.iter().map(|p| p * size * size).collect();
        let motion = || {
            MotionModel::ConstantAcceleration(ConstantAcceleration::new(KinematicNoise::Psd(scale.clone())).unwrap())
        };
        let sensor = |form| pose(Some(1e-3 * size), 0.05 * size, form);
        let start = Gaussian {
            mean: DVector::zeros(18),
            cov: DMatrix::identity(18, 18) * (size * size),
        };
        let initial = InitialState {
            time: 0.0,
            state: start,
        };
        let mut rng = Pcg64::seed_from_u64(4);
        let times: Vec<f64> = (1..=60).map(|k| 0.05 * f64::from(k)).collect();
        let reports: Vec<DVector<f64>> = times
            .iter()
            .map(|t| {
                let phase = |i: usize| (1.0 + 0.3 * i as f64) * t + i as f64;
                DVector::from_fn(6, |i, _| size * (phase(i).sin() + 0.05 * normal(&mut rng)))
            })
            .collect();
        let turned = |report: &DVector<f64>| {
            let mut out = report.clone();
            let angles = [report[3], report[4], report[5]];
            out.fixed_rows_mut::<3>(3)
                .copy_from(&Rotation::from_angles(angles).vector());
            out
        };
        let vectors: Vec<_> = reports.iter().map(turned).collect();
        let euler = Filter::extended(motion(), sensor(AttitudeForm::Euler)).unwrap();
        let euler = euler
            .run(&times, &reports, Some(&initial), None, History::Full)
            .unwrap();
        let mut worst = 0.0_f64;
        for (name, filter) in filters(&motion(), &sensor(AttitudeForm::Quaternion)) {
            let run = filter
                .run(&times, &vectors, Some(&initial), None, History::Full)
                .unwrap();
            for k in 20..60 {
                let difference = run.filtered.at(k).mean - euler.filtered.at(k).mean;
                worst = worst.max(difference.fixed_rows::<3>(3).amax());
                assert!(difference.fixed_rows::<3>(0).amax() < 1e-3 * size * size, "{name}");
            }
        }
        worst
    };
    let (small, smaller) = (apart(1e-2), apart(1e-3));
    assert!(small < 1e-4 && smaller < 1e-6, "{small}, {smaller}");
}

/// A body that turns at 2 rad/s about an axis that leads it through both poles (pitch of 90 degrees), 40 turns.
#[test]
fn turns_through_the_poles_leave_no_trace() {
    for (name, filter) in filters(&turning(1e-4), &pose(None, 1e-3, AttitudeForm::Quaternion)) {
        let mut rng = Pcg64::seed_from_u64(3);
        let rate = Vector3::new(0.0, 2.0, 0.0);
        let attitude = |t: f64| Rotation::from_vector(&(rate * t));
        let times: Vec<f64> = (0..2500).map(|k| 0.05 * f64::from(k)).collect();
        let state = |t: f64| DVector::from_iterator(6, attitude(t).vector().iter().chain(rate.iter()).copied());
        let values: Vec<_> = times
            .iter()
            .map(|&t| measured(filter.sensor(), &state(t), &mut rng))
            .collect();
        let run = filter.run(&times, &values, None, None, History::Full).unwrap();
        assert_eq!(run.start, 2);
        let space = filter.motion().space();
        let pitch = |k: usize| attitude(times[k]).angles()[1];
        assert!((0..2500).any(|k| pitch(k) > 1.56) && (0..2500).any(|k| pitch(k) < -1.56));
        let mut worst = (0.0_f64, 0.0_f64);
        for (k, &time) in times.iter().enumerate().skip(50) {
            let error = space.difference(&run.filtered.at(k).mean, &state(time));
            worst = (worst.0.max(error.rows(0, 3).amax()), worst.1.max(run.nis[k]));
        }
        // 7350 errors of 0.5e-3 rad; chi-square of 3 degrees of freedom is above 30 once in 700 000.
        assert!(worst.0 < 3e-3 && worst.1 < 30.0, "{name}: {worst:?}");
    }
}

/// What the world calls its axes is no matter.
#[test]
fn another_world_frame_gives_the_same_estimates_in_it() {
    let turn = Rotation::from_vector(&Vector3::new(0.7, -2.0, 1.1));
    let rotated = |state: &DVector<f64>| {
        let mut out = state.clone();
        for at in [0, 6, 12].into_iter().filter(|at| at + 3 <= state.len()) {
            let moved = turn.rotate(&state.fixed_rows::<3>(at).into_owned());
            out.fixed_rows_mut::<3>(at).copy_from(&moved);
        }
        let attitude = turn * Rotation::from_vector(&state.fixed_rows::<3>(3).into_owned());
        out.fixed_rows_mut::<3>(3).copy_from(&attitude.vector());
        out
    };
    for (name, filter) in filters(&body(), &pose(Some(2e-3), 0.01, AttitudeForm::Quaternion)) {
        let space = filter.motion().space();
        let mut data = record(&filter, &start_of_body(), 0.05, 200, &mut Pcg64::seed_from_u64(6));
        let run = run_of(&filter, &data);
        data.initial.state.mean = rotated(&data.initial.state.mean);
        data.values = data.values.iter().map(rotated).collect();
        let there = run_of(&filter, &data);
        for k in 0..200 {
            assert_relative_eq!(run.nis[k], there.nis[k], max_relative = 1e-9, epsilon = 1e-9);
            let expected = rotated(&run.filtered.at(k).mean);
            let apart = space.difference(&there.filtered.at(k).mean, &expected);
            assert!(apart.amax() < 1e-9, "{name}: {}", apart.amax());
        }
    }
}

/// Smoothed errors are smaller, and with their lag-one covariance consistent two by two.
#[test]
fn smoothing_is_better_and_as_honest() {
    let (runs, steps, at) = (400, 24, 12);
    let band = average_band(12, runs, 0.99).unwrap();
    let start = Gaussian {
        mean: DVector::from_vec(vec![0.0, 2.0, 1.0, 0.5, -1.0, 1.0]),
        cov: DMatrix::identity(6, 6) * 0.04,
    };
    for (name, filter) in filters(&turning(0.5), &pose(None, 0.05, AttitudeForm::Quaternion)) {
        let space = filter.motion().space();
        let (mut rng, mut sum, mut filtered, mut smoothed) = (Pcg64::seed_from_u64(7), 0.0, 0.0, 0.0);
        for _ in 0..runs {
            let data = record(&filter, &start, 0.05, steps, &mut rng);
            let run = run_of(&filter, &data);
            let back = fixed_interval(&run.epochs().unwrap()).unwrap();
            let error = |k: usize, mean: &DVector<f64>| space.difference(&data.truth[k], mean);
            filtered += error(at, &run.filtered.at(at).mean).norm_squared();
            smoothed += error(at, &back.states.at(at).mean).norm_squared();
            let (early, late) = (back.states.at(at), back.states.at(at + 1));
            let lag = back.lag_one.matrix(at);
            let mut cov = DMatrix::zeros(12, 12);
            cov.view_mut((0, 0), (6, 6)).copy_from(&late.cov);
            cov.view_mut((6, 6), (6, 6)).copy_from(&early.cov);
            cov.view_mut((0, 6), (6, 6)).copy_from(&lag);
            cov.view_mut((6, 0), (6, 6)).copy_from(&lag.transpose());
            let (late, early) = (error(at + 1, &late.mean), error(at, &early.mean));
            let both = DVector::from_iterator(12, late.iter().chain(early.iter()).copied());
            sum += both.dot(&nalgebra::Cholesky::new(cov).unwrap().solve(&both));
        }
        let mean = sum / runs as f64;
        assert!(smoothed < 0.8 * filtered, "{name}: {smoothed} {filtered}");
        assert!((band.lower..band.upper).contains(&mean), "{name}: {mean}");
    }
}

#[test]
fn what_is_not_observed_is_left_out() {
    for (name, filter) in filters(&body(), &pose(Some(2e-3), 0.01, AttitudeForm::Quaternion)) {
        let space = filter.motion().space();
        let mut data = record(&filter, &start_of_body(), 0.05, 60, &mut Pcg64::seed_from_u64(2));
        for k in (0..60).filter(|k| k % 3 > 0) {
            data.values[k][k % 3] = f64::NAN;
            data.values[k][3 + k % 2] = f64::NAN;
        }
        let run = run_of(&filter, &data);
        assert_eq!((run.dof[0], run.dof[1]), (6, 2));
        let last = nees(space, &data.truth[59], &run.filtered.at(59));
        // Chi-square of 18 degrees of freedom is above 51 once in 10 000.
        assert!(last < 51.0, "{name}: {last}");
        for value in &mut data.values {
            if value.rows(3, 3).iter().any(|v| v.is_nan()) {
                value.rows_mut(3, 3).fill(f64::NAN);
            }
        }
        assert_eq!(run_of(&filter, &data).filtered, run.filtered);
    }
}

#[test]
fn predictions_ahead_are_those_of_the_motion() {
    let lead = 0.12;
    for (name, filter) in filters(&body(), &pose(Some(2e-3), 0.01, AttitudeForm::Quaternion)) {
        let space = filter.motion().space();
        let data = record(&filter, &start_of_body(), 0.05, 40, &mut Pcg64::seed_from_u64(1));
        let ahead = Lead::Seconds(lead);
        let run = filter
            .run_ahead(&data.times, &data.values, None, None, Some(&ahead), History::Full)
            .unwrap();
        for k in 2..40 {
            let expected = filter.predict(&run.filtered.at(k), lead, None).unwrap();
            let found = run.leads.at(k);
            assert!(space.difference(&found.mean, &expected.mean).amax() < 1e-12, "{name}");
            let tolerance = 1e-9 * expected.cov.amax();
            assert_relative_eq!(found.cov, expected.cov, epsilon = tolerance);
            let turned = filter.motion().propagate(&run.filtered.at(k).mean, lead);
            assert!(space.difference(&found.mean, &turned).amax() < 0.02, "{name}");
        }
    }
}
