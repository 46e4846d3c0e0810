//! Range bias and scale error as extra states, and starts from ranges that come one at a time.

use crate::arrays::{BATS, normal, settings, toss_rows};
#[allow(dead_code)] // other tests use the rest
use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use trackrs::Gaussian;
use trackrs::filter::screen::{ChiSquareScreen, ScreenMode, Verdict};
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::{PositionFix, RangeArray, RangeArraySettings, SoundSpeed, SpeedProfile};
use trackrs::model::{Motion, MotionModel, Sensor, SensorModel};

/// An array with all that a range can have: travel times through a profile, depth, biases and a scale error.
fn everything() -> RangeArray {
    let profile = SpeedProfile::new(vec![0.0, 100.0, 300.0], vec![1520.0, 1490.0, 1500.0]).unwrap();
    RangeArray::new(RangeArraySettings {
        sound_speed: Some(SoundSpeed::Profile(profile)),
        ..settings(&BATS, Some(0.3))
    })
    .unwrap()
    .with_bias(vec![2.0], 0.0)
    .unwrap()
    .with_scale(0.01, 0.0)
    .unwrap()
}

fn radios() -> RangeArray {
    RangeArray::new(RangeArraySettings {
        hydrophones: DMatrix::from_row_slice(4, 2, &[-46.6, 11.0, 11.0, -7.0, 22.1, 23.8, -17.7, 59.0]),
        range_std: vec![0.5],
        survey_std: Vec::new(),
        depth_std: None,
        sound_speed: None,
        side: None,
    })
    .unwrap()
}

fn velocity(dims: usize, psd: f64) -> MotionModel {
    MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![psd; dims])).unwrap())
}

/// x, v, three biases, scale.
fn state() -> DVector<f64> {
    DVector::from_vec(vec![-300.0, -250.0, 60.0, 14.0, 5.0, 0.1, 1.5, -2.0, 0.7, 0.012])
}

#[test]
fn derivatives_are_those_of_the_expected_measurement() {
    let (array, x) = (everything(), state());
    let analytic = array.jacobian(&x, None).unwrap();
    for j in 0..x.len() {
        let step = if j == 9 { 1e-5 } else { 1e-2 };
        let (mut up, mut down) = (x.clone(), x.clone());
        up[j] += step;
        down[j] -= step;
        let numeric = (array.observe(&up, None).unwrap() - array.observe(&down, None).unwrap()) / (2.0 * step);
        assert_relative_eq!(
            analytic.column(j).into_owned(),
            numeric,
            max_relative = 1e-6,
            epsilon = 1e-9
        );
    }
}

#[test]
fn errors_enter_as_declared_and_not_into_the_depth() {
    let plain = RangeArray::new(settings(&BATS, Some(0.3))).unwrap();
    let with = plain
        .clone()
        .with_bias(vec![2.0], 0.1)
        .unwrap()
        .with_scale(0.01, 0.0)
        .unwrap();
    let x = state();
    let (clean, seen) = (plain.observe(&x, None).unwrap(), with.observe(&x, None).unwrap());
    for i in 0..3 {
        assert_relative_eq!(seen[i], 1.012 * clean[i] + x[6 + i], epsilon = 1e-9);
    }
    assert_eq!(seen[3], clean[3]);
    let nuisance = with.nuisance().unwrap();
    assert_eq!(nuisance.labels, ["bias0", "bias1", "bias2", "scale"]);
    assert_eq!(nuisance.std, [2.0, 2.0, 2.0, 0.01]);
    assert_eq!(nuisance.walk_psd, [0.1, 0.1, 0.1, 0.0]);
    // A position alone has none of them; anything between is refused.
    let position = x.rows(0, 3).into_owned();
    assert_eq!(with.observe(&position, None).unwrap(), clean);
    assert!(with.observe(&x.rows(0, 6).into_owned(), None).is_err());
    assert!(plain.nuisance().is_none());
}

/// The second-order terms against second differences of the expected measurement.
#[test]
fn curvature_is_the_second_derivative() {
    let array = RangeArray::new(settings(&toss_rows(), None))
        .unwrap()
        .with_bias(vec![2.0], 0.0)
        .unwrap()
        .with_scale(0.01, 0.0)
        .unwrap();
    let n = 13;
    let mean = DVector::from_fn(n, |i, _| if i == 12 { 0.02 } else { 40.0 + 17.0 * i as f64 });
    let root = DMatrix::from_fn(n, n, |i, j| {
        let size = if i == 12 { 1e-3 } else { 10.0 };
        size * ((i * 5 + j * 3) % 7) as f64 / 7.0
    });
    let prior = Gaussian {
        mean: mean.clone(),
        cov: &root * root.transpose(),
    };
    let step: Vec<f64> = (0..n).map(|i| if i == 12 { 1e-3 } else { 0.1 }).collect();
    let moved = |i: usize, a: f64, j: usize, b: f64| {
        let mut x = mean.clone();
        x[i] += a * step[i];
        x[j] += b * step[j];
        array.observe(&x, None).unwrap()
    };
    let m = array.measurement_dim();
    let mut hessians = vec![DMatrix::zeros(n, n); m];
    for i in 0..n {
        for j in 0..n {
            let second =
                moved(i, 1.0, j, 1.0) - moved(i, 1.0, j, -1.0) - moved(i, -1.0, j, 1.0) + moved(i, -1.0, j, -1.0);
            for (k, hessian) in hessians.iter_mut().enumerate() {
                hessian[(i, j)] = second[k] / (4.0 * step[i] * step[j]);
            }
        }
    }
    let found = array.curvature(&prior).unwrap().unwrap();
    for k in 0..m {
        let product = &hessians[k] * &prior.cov;
        assert_relative_eq!(found.shift[k], 0.5 * product.trace(), max_relative = 1e-4);
        for (l, other) in hessians.iter().enumerate() {
            let expected = 0.5 * (&product * other * &prior.cov).trace();
            assert_relative_eq!(found.noise[(k, l)], expected, max_relative = 1e-3, epsilon = 1e-6);
        }
    }
}

/// The covariance of a fix with lasting errors is the first-order propagation of R and P_η through the same weights.
#[test]
fn fix_counts_lasting_errors_in_covariance_and_test() {
    let plain = RangeArray::new(settings(&toss_rows(), None)).unwrap();
    let with = plain
        .clone()
        .with_bias(vec![3.0], 0.0)
        .unwrap()
        .with_scale(0.02, 0.0)
        .unwrap();
    let position = DVector::from_vec(vec![300.0, 200.0, 80.0]);
    let z = plain.observe(&position, None).unwrap();
    let fix = with.fix_on(&z, Some(trackrs::model::sensor::Side::Above)).unwrap();
    let b = plain.jacobian(&position, None).unwrap();
    let sigma = DMatrix::from_fn(6, 6, |i, j| {
        0.02 * 0.02 * z[i] * z[j] + if i == j { 1.0 + 9.0 } else { 0.0 }
    });
    let weight = sigma.try_inverse().unwrap();
    let cov = (b.transpose() * &weight * &b).try_inverse().unwrap();
    assert_relative_eq!(fix.position.cov, cov, max_relative = 1e-8);
    // What contradicts ranges of 1 m is nothing new where biases of 3 m are expected.
    let mut off = z;
    off[2] += 5.0;
    let side = Some(trackrs::model::sensor::Side::Above);
    assert!(plain.fix_on(&off, side).unwrap().p_value < 0.01);
    assert!(with.fix_on(&off, side).unwrap().p_value > 0.1);
}

/// One range per row, round the radios, four a second.
fn course(array: &RangeArray, rows: usize, scale: f64) -> (Vec<f64>, Vec<DVector<f64>>, Vec<DVector<f64>>) {
    let mut rng = Pcg64::seed_from_u64(4);
    let times: Vec<f64> = (0..rows).map(|k| 0.25 * k as f64).collect();
    let truth: Vec<_> = times
        .iter()
        .map(|t| DVector::from_vec(vec![-10.0 + 0.8 * t, 15.0 + 0.3 * t]))
        .collect();
    let heard = |(k, x): (usize, &DVector<f64>)| {
        let clean = array.observe(x, None).unwrap();
        let noise = 0.5 * normal(&mut rng);
        DVector::from_fn(4, |i, _| {
            if i == k % 4 {
                (1.0 + scale) * clean[i] + noise
            } else {
                f64::NAN
            }
        })
    };
    let values = truth.iter().enumerate().map(heard).collect();
    (times, values, truth)
}

#[test]
fn single_ranges_start_a_run_and_a_gross_error_delays_it() {
    let array = radios().with_scale(0.1, 0.0).unwrap();
    let (times, mut values, truth) = course(&array, 200, 0.07);
    let filter = Filter::extended(velocity(2, 0.01), SensorModel::RangeArray(array)).unwrap();
    let clean = filter.run(&times, &values, None, None, History::Full).unwrap();
    assert!(clean.start < 16, "{}", clean.start);
    let at = |run: &trackrs::filter::run::FilterRun, k: usize| (run.filtered.at(k).mean.rows(0, 2) - &truth[k]).norm();
    assert!(at(&clean, clean.start) < 3.0 && at(&clean, 199) < 1.0);
    assert!((clean.filtered.at(199).mean[4] - 0.07).abs() < 0.01);
    values[5][1] += 30.0;
    let late = filter.run(&times, &values, None, None, History::Full).unwrap();
    assert!(late.start > 5 + clean.start - 3 && late.start < 32, "{}", late.start);
    assert!(at(&late, late.start) < 3.0);
}

/// Rows without any range change nothing but the time, and known inputs are taken back to every stamp.
#[test]
fn known_inputs_count_in_the_start() {
    let array = radios().with_scale(0.1, 0.0).unwrap();
    let (times, mut values, truth) = course(&array, 120, 0.07);
    let still = trackrs::model::motion::RandomWalk::new(KinematicNoise::Psd(vec![1e-4; 2])).unwrap();
    let filter = Filter::extended(MotionModel::RandomWalk(still), SensorModel::RangeArray(array)).unwrap();
    values[3].fill(f64::NAN);
    values[6].fill(f64::NAN);
    let inputs: Vec<_> = (0..truth.len())
        .map(|k| {
            if k == 0 {
                DVector::zeros(2)
            } else {
                &truth[k] - &truth[k - 1]
            }
        })
        .collect();
    let run = filter.run(&times, &values, None, Some(&inputs), History::Full).unwrap();
    assert!(run.start < 20, "{}", run.start);
    for (k, (estimate, position)) in run.filtered.iter().zip(&truth).enumerate().skip(run.start) {
        let error = estimate.mean.rows(0, 2) - position;
        assert!(error.norm() < 3.0, "{k}: {error}");
    }
    // The inputs of the lasting errors may be left out.
    let padded: Vec<_> = inputs.iter().map(|u| u.clone().insert_rows(2, 1, 0.0)).collect();
    let same = filter.run(&times, &values, None, Some(&padded), History::Full).unwrap();
    for row in run.start..times.len() {
        assert_eq!(same.filtered.at(row), run.filtered.at(row));
    }
}

#[test]
fn a_kinematic_initial_state_is_completed_by_the_prior() {
    let array = radios().with_bias(vec![0.3, 0.3, 0.3, 0.6], 1e-3).unwrap();
    let (times, values, _) = course(&array, 40, 0.0);
    let filter = Filter::extended(velocity(2, 0.01), SensorModel::RangeArray(array)).unwrap();
    let short = Gaussian::new(DVector::from_vec(vec![-10.0, 15.0, 0.8, 0.3]), DMatrix::identity(4, 4)).unwrap();
    let mut cov = DMatrix::identity(8, 8);
    for (i, std) in [0.3, 0.3, 0.3, 0.6_f64].iter().enumerate() {
        cov[(4 + i, 4 + i)] = std * std;
    }
    let full = Gaussian::new(short.mean.clone().insert_rows(4, 4, 0.0), cov).unwrap();
    let from = |state: Gaussian| {
        let initial = InitialState { time: 0.0, state };
        filter.run(&times, &values, Some(&initial), None, History::Full)
    };
    assert_eq!(from(short.clone()).unwrap().filtered, from(full).unwrap().filtered);
    let error = from(short.leading(3)).unwrap_err().to_string();
    assert!(error.contains("initial state has size 3, expected 8"), "{error}");
    assert_eq!(filter.motion().labels()[4..], ["bias0", "bias1", "bias2", "bias3"]);
}

/// After two minutes of silence the prediction says nothing; ranges are held until they give a position, and what the
/// filter knows of the scale error is kept. The smoother bridges the gap.
#[test]
fn a_long_gap_is_bridged() {
    let array = radios().with_scale(0.1, 0.0).unwrap();
    let (mut times, values, truth) = course(&array, 400, 0.07);
    for time in &mut times[200..] {
        *time += 120.0;
    }
    let filter = Filter::extended(velocity(2, 0.1), SensorModel::RangeArray(array))
        .unwrap()
        .with_second_order()
        .unwrap()
        .with_screen(ChiSquareScreen::new(1e-3, ScreenMode::Snoop, Some(0.0)).unwrap());
    let run = filter.run(&times, &values, None, None, History::Full).unwrap();
    assert_eq!(run.restarts.len(), 1);
    let again = run.restarts[0];
    assert!((202..220).contains(&again), "{again}");
    assert!((200..again).all(|k| run.screened[k].verdicts == [Verdict::Missing; 4] && run.dof[k] == 0));
    let scale = |k: usize| run.filtered.at(k).cov[(4, 4)].sqrt();
    assert!(scale(again) <= scale(199) * (1.0 + 1e-9));
    assert!((run.filtered.at(again).mean.rows(0, 2) - &truth[again]).norm() < 3.0);
    let smoothed = trackrs::filter::smoother::fixed_interval(&run.epochs().unwrap()).unwrap();
    for (k, position) in truth.iter().enumerate().take(again).skip(200) {
        let error = smoothed.states.at(k - run.start).mean.rows(0, 2) - position;
        assert!(error.norm() < 6.0, "{k}: {error}");
    }
}

#[test]
fn a_filter_locked_out_of_single_ranges_starts_anew() {
    let array = radios();
    let (times, values, truth) = course(&array, 200, 0.0);
    let filter = Filter::extended(velocity(2, 0.01), SensorModel::RangeArray(array))
        .unwrap()
        .with_screen(ChiSquareScreen::new(1e-3, ScreenMode::Snoop, Some(0.0)).unwrap());
    let wrong = InitialState {
        time: 0.0,
        state: Gaussian::new(DVector::from_vec(vec![-40.0, 40.0, 0.0, 0.0]), DMatrix::identity(4, 4)).unwrap(),
    };
    let run = filter.run(&times, &values, Some(&wrong), None, History::Full).unwrap();
    assert_eq!(run.restarts.len(), 1);
    assert!(run.restarts[0] < 40, "{:?}", run.restarts);
    assert!((run.filtered.at(199).mean.rows(0, 2) - &truth[199]).norm() < 1.0);
}

#[test]
fn nothing_degenerate_poisons_the_state() {
    let array = radios()
        .with_bias(vec![0.3], 0.0)
        .unwrap()
        .with_scale(0.1, 0.0)
        .unwrap();
    let (times, mut values, _) = course(&array, 60, 0.05);
    let filter = Filter::extended(velocity(2, 0.01), SensorModel::RangeArray(array.clone())).unwrap();
    // Negative and absurd ranges, all missing, the same time twice: the start waits.
    values[0][0] = -3.0;
    values[4][0] = 1e6;
    values[7].fill(f64::NAN);
    let mut same = times.clone();
    same[9] = same[8];
    let run = filter.run(&same, &values, None, None, History::Full).unwrap();
    assert!(run.start > 7);
    assert!(
        run.filtered
            .iter()
            .skip(run.start)
            .all(|g| g.mean.iter().chain(g.cov.iter()).all(|v| v.is_finite()))
    );
    values[2][2] = f64::INFINITY;
    assert!(matches!(
        filter.run(&times, &values, None, None, History::Full),
        Err(trackrs::Error::NonFinite { .. })
    ));
    let all_missing = vec![DVector::from_element(4, f64::NAN); 60];
    let error = filter.run(&times, &all_missing, None, None, History::Full).unwrap_err();
    assert!(error.to_string().contains("needs 2 ranges, 0 heard"), "{error}");
    // A target on a hydrophone: an error that names the channel, and the estimate as it was.
    let on = DVector::from_vec(vec![11.0, -7.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let error = array.jacobian(&on, None).unwrap_err().to_string();
    assert!(error.contains("channel 1"), "{error}");
    for (name, broken) in [
        ("bias_std", radios().with_bias(vec![0.0], 0.0)),
        ("bias_std", radios().with_bias(vec![1.0, 2.0], 0.0)),
        ("bias_std", radios().with_bias(vec![f64::NAN], 0.0)),
        ("bias_psd", radios().with_bias(vec![1.0], -1.0)),
        ("scale_std", radios().with_scale(-0.1, 0.0)),
        ("scale_std", radios().with_scale(1.0, 0.0)),
        ("scale_psd", radios().with_scale(0.1, f64::INFINITY)),
    ] {
        let error = broken.unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
    assert!(array.sufficient(&[1.0, 1.0, 1.0, f64::NAN]));
    assert!(!array.sufficient(&[1.0, 1.0, f64::NAN, f64::NAN]));
}
