//! RangeArray against an independent reference, finite differences, simulation, and geometries that must be refused.

use crate::arrays::{BATS, bats, noisy, settings, toss, toss_rows};
use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::Value;
use trackrs::filter::sequence::{Filter, History};
use trackrs::filter::start::{TimedFix, start_state};
use trackrs::model::motion::{ConstantAcceleration, KinematicNoise};
use trackrs::model::sensor::{Fix, PositionFix, RangeArray, Side, SoundSpeed, SpeedProfile, closed_form};
use trackrs::model::{MotionModel, Sensor, SensorModel};
use trackrs::stats::chi_square;
use trackrs::{Error, Gaussian};

fn vector(value: &Value) -> DVector<f64> {
    DVector::from_iterator(
        value.as_array().unwrap().len(),
        value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()),
    )
}

fn matrix(value: &Value) -> DMatrix<f64> {
    let rows: Vec<DVector<f64>> = value.as_array().unwrap().iter().map(vector).collect();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn golden() -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/underwater_bats_kf.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn assert_close(what: &str, got: &DMatrix<f64>, expected: &DMatrix<f64>) {
    let off = (got - expected).amax() / expected.amax();
    assert!(off < 1e-9, "{what}: relative difference {off:e}");
}

fn close(what: &str, got: &DVector<f64>, expected: &DVector<f64>) {
    for i in 0..expected.len() {
        let off = (got[i] - expected[i]).abs();
        assert!(
            off <= 1e-9 * expected[i].abs().max(1e-3 * expected.amax()),
            "{what}[{i}]: {off:e}"
        );
    }
}

#[test]
fn golden_closed_form_fixes_and_start() {
    let golden = golden();
    let phones: [Vector3<f64>; 3] = BATS.map(Vector3::from);
    let times = vector(&golden["time"]);
    let mut fixes = Vec::new();
    for k in 0..3 {
        let z = vector(&golden["L"][k]);
        let start = closed_form::known_depth(&phones, [z[0], z[1], z[2]], z[3]).unwrap();
        let start = DVector::from_column_slice(start.as_slice());
        close("closed form", &start, &vector(&golden["init"]["closed_form"][k]));
        let fix = bats().fix(&z).unwrap();
        close("fix", &fix.position.mean, &vector(&golden["init"]["fix"][k]));
        assert_close("fix_cov", &fix.position.cov, &matrix(&golden["init"]["fix_cov"][k]));
        assert_eq!((fix.dof, fix.mirror), (1, None));
        assert_eq!(fix.p_value, chi_square::survival(fix.statistic, 1));
        fixes.push(TimedFix {
            time: times[k],
            position: fix.position,
        });
    }
    let start = start_state(&fixes, 3, None).unwrap();
    close("x0", &start.state.mean, &vector(&golden["init"]["x0"]));
    assert_close("D0", &start.state.cov, &matrix(&golden["init"]["D0"]));
}

#[test]
fn golden_filter_steps() {
    let golden = golden();
    let motion = ConstantAcceleration::new(KinematicNoise::Std(vec![golden["Q"][0][0].as_f64().unwrap().sqrt(); 3]));
    let filter = Filter::extended(
        MotionModel::ConstantAcceleration(motion.unwrap()),
        SensorModel::RangeArray(bats()),
    )
    .unwrap();
    let times = vector(&golden["time"]);
    let values: Vec<DVector<f64>> = golden["L"].as_array().unwrap().iter().map(vector).collect();
    let initial = trackrs::filter::sequence::InitialState {
        time: times[2],
        state: Gaussian::new(vector(&golden["init"]["x0"]), matrix(&golden["init"]["D0"])).unwrap(),
    };
    let run = filter
        .run(
            &times.as_slice()[3..],
            &values[3..],
            Some(&initial),
            None,
            History::Full,
        )
        .unwrap();
    assert_eq!(run.start, 0);
    for (k, step) in golden["steps"].as_array().unwrap().iter().enumerate() {
        let (xp, xf) = (vector(&step["xp"]), vector(&step["xf"]));
        close("xp", &run.predicted.at(k).mean, &xp);
        assert_close("Pp", &run.predicted.at(k).cov, &matrix(&step["Pp"]));
        close("h", &bats().observe(&xp, None).unwrap(), &vector(&step["h"]));
        assert_close("A", &bats().jacobian(&xp, None).unwrap(), &matrix(&step["A"]));
        assert_relative_eq!(run.innovations.vector(k), vector(&step["r"]), epsilon = 1e-8);
        assert_close("D", &run.innovation_covs.matrix(k), &matrix(&step["D"]));
        assert_relative_eq!(run.nis[k], step["chi2"].as_f64().unwrap(), max_relative = 1e-8);
        close(
            "x⁻ + K r",
            &run.filtered.at(k).mean,
            &(&xp + matrix(&step["K"]) * vector(&step["r"])),
        );
        close("xf", &run.filtered.at(k).mean, &xf);
        assert_close("Pf", &run.filtered.at(k).cov, &matrix(&step["Pf"]));
    }
}

#[test]
fn jacobian_is_the_derivative() {
    let profile = SpeedProfile::new(vec![0.0, 40.0, 80.0, 400.0], vec![1525.0, 1520.0, 1488.0, 1496.0]).unwrap();
    let speeds = [
        None,
        Some(SoundSpeed::Uniform(1500.0)),
        Some(SoundSpeed::PerChannel(vec![1490.0, 1500.0, 1510.0])),
        Some(SoundSpeed::Profile(profile)),
    ];
    for speed in speeds {
        let unit = if speed.is_some() { 1e-3 } else { 1.0 };
        let mut settings = settings(&BATS, Some(0.3));
        settings.sound_speed = speed;
        let array = RangeArray::new(settings).unwrap();
        let state = DVector::from_vec(vec![-300.0, 400.0, 63.0, 1.0, 2.0, 3.0]);
        let h = array.jacobian(&state, None).unwrap();
        assert_eq!(h.shape(), (4, 6));
        for k in 0..6 {
            let (mut ahead, mut behind) = (state.clone(), state.clone());
            ahead[k] += 1e-2;
            behind[k] -= 1e-2;
            let slope = (array.observe(&ahead, None).unwrap() - array.observe(&behind, None).unwrap()) / 2e-2;
            assert_relative_eq!(h.column(k).into_owned(), slope, epsilon = 1e-7 * unit);
        }
    }
}

#[test]
fn profile_depth_dependence_matters_and_fixes_take_travel_times() {
    let profile = SpeedProfile::new(vec![0.0, 40.0, 80.0, 400.0], vec![1525.0, 1520.0, 1488.0, 1496.0]).unwrap();
    let target = DVector::from_vec(vec![120.0, 300.0, 63.0]);
    for depth_std in [Some(0.3), None] {
        for speed in [SoundSpeed::Uniform(1490.0), SoundSpeed::Profile(profile.clone())] {
            let mut settings = settings(&BATS, depth_std);
            settings.sound_speed = Some(speed);
            settings.side = Some(Side::Above);
            let array = RangeArray::new(settings).unwrap();
            let fix = array.fix(&array.observe(&target, None).unwrap()).unwrap();
            assert_relative_eq!(fix.position.mean, target, epsilon = 1e-5);
        }
    }
}

/// The fix is unbiased, its covariance is that of its errors, and its statistic is chi-square.
#[test]
fn fix_covariance_is_honest() {
    let mut rng = Pcg64::seed_from_u64(20);
    let runs = 1000;
    for (array, redundancy) in [(bats(), 1), (toss(), 3)] {
        let target = DVector::from_vec(vec![-200.0, 350.0, 60.0]);
        let (mut nees, mut statistic, mut rejected) = (0.0, 0.0, 0);
        for _ in 0..runs {
            let fix = array.fix(&noisy(&array, &target, &mut rng)).unwrap();
            let error = DMatrix::from_column_slice(3, 1, (&fix.position.mean - &target).as_slice());
            let factor = trackrs::linalg::cholesky::Cholesky::new(&fix.position.cov, "cov").unwrap();
            nees += (error.transpose() * factor.solve(&error))[(0, 0)];
            statistic += fix.statistic;
            rejected += u32::from(fix.p_value < 0.05);
            assert_eq!(fix.dof, redundancy);
        }
        for (sum, dof) in [(nees, 3 * runs), (statistic, redundancy * runs)] {
            let low = chi_square::quantile(0.0005, dof).unwrap();
            let high = chi_square::upper_quantile(0.0005, dof).unwrap();
            assert!(sum > low && sum < high, "{sum} outside {low}..{high}");
        }
        assert!((25..=80).contains(&rejected), "{rejected} of 1000 at level 0.05");
    }
}

/// Every position around the array is found from its exact ranges, far outside and close above included.
#[test]
fn fixes_find_the_target_from_anywhere() {
    let mut rng = Pcg64::seed_from_u64(7);
    for array in [bats(), toss()] {
        for _ in 0..300 {
            let target = DVector::from_vec(vec![
                rng.random_range(-2500.0..3500.0),
                rng.random_range(-2500.0..3500.0),
                rng.random_range(5.0..200.0),
            ]);
            let fix = array.fix(&array.observe(&target, None).unwrap()).unwrap();
            assert_relative_eq!(fix.position.mean, target, epsilon = 1e-4);
            assert!(fix.statistic < 1e-9);
        }
    }
}

#[test]
fn any_heard_channels_will_do() {
    let target = DVector::from_vec(vec![200.0, -100.0, 60.0]);
    let mut z = toss().observe(&target, None).unwrap();
    for (missing, dof) in [(5, 2), (2, 1), (0, 0)] {
        z[missing] = f64::NAN;
        let fix = toss().fix(&z).unwrap();
        assert_relative_eq!(fix.position.mean, target, epsilon = 1e-5);
        assert_eq!(fix.dof, dof);
    }
    assert_eq!(toss().fix(&z).unwrap().p_value, 1.0);
    z[1] = f64::NAN;
    let error = toss().fix(&z).unwrap_err().to_string();
    assert!(error.contains("needs 3 ranges, 2 heard (channels [3, 4])"), "{error}");
}

fn ambiguous(array: &RangeArray, z: &DVector<f64>) -> String {
    match array.fix_on(z, None) {
        Err(error @ Error::Unobservable { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    }
}

fn both_sides(array: &RangeArray, z: &DVector<f64>) -> [Fix; 2] {
    [Side::Above, Side::Below].map(|side| array.fix_on(z, Some(side)).unwrap())
}

#[test]
fn mirror_images_are_reported_and_chosen() {
    // Three hydrophones in the plane z = 250, and six of them: no data can tell the sides apart.
    let mut flat: Vec<[f64; 3]> = BATS.to_vec();
    for p in &mut flat {
        p[2] = 250.0;
    }
    let target = DVector::from_vec(vec![100.0, 200.0, 60.0]);
    for extra in [&[][..], &[[900.0, 900.0, 250.0], [-400.0, 100.0, 250.0]][..]] {
        flat.extend_from_slice(extra);
        let array = RangeArray::new(settings(&flat, None)).unwrap();
        let z = array.observe(&target, None).unwrap();
        assert!(ambiguous(&array, &z).contains("ambiguous"));
        assert!(array.locate(&z, None).is_none());
        let [above, below] = both_sides(&array, &z);
        assert_relative_eq!(above.position.mean, target, epsilon = 1e-6);
        assert_relative_eq!(below.position.mean[2], 440.0, epsilon = 1e-6);
        assert_eq!(above.mirror.as_ref(), Some(&below.position.mean));
        assert_eq!(below.mirror.as_ref(), Some(&above.position.mean));
    }
    // Depth and two ranges, or two ranges in the plane: mirrored in the line, told apart by y.
    let array = RangeArray::new(settings(&[[0.0, 0.0, 250.0], [1000.0, 0.0, 252.0]], Some(0.3))).unwrap();
    let z = array.observe(&target, None).unwrap();
    assert!(ambiguous(&array, &z).contains("(100.00, -200.00, 60.00)"));
    let [above, below] = both_sides(&array, &z);
    assert_relative_eq!(above.position.mean[1], -200.0, epsilon = 1e-6);
    assert_relative_eq!(below.position.mean[1], 200.0, epsilon = 1e-6);
    let mut plane = settings(&BATS, None);
    plane.hydrophones = DMatrix::from_row_slice(2, 2, &[0.0, 0.0, 0.0, 500.0]);
    let array = RangeArray::new(plane).unwrap();
    let z = array.observe(&target, None).unwrap();
    // These two have the same y.
    assert!(ambiguous(&array, &z).contains("ambiguous"));
    assert!(
        array
            .fix_on(&z, Some(Side::Above))
            .unwrap_err()
            .to_string()
            .contains("cannot tell")
    );
}

#[test]
fn a_bumpy_floor_tells_the_sides_apart_only_when_heard_well() {
    let target = DVector::from_vec(vec![500.0, 300.0, 60.0]);
    let mut precise = settings(&toss_rows(), None);
    let array = RangeArray::new(precise.clone()).unwrap();
    let z = array.observe(&target, None).unwrap();
    let fix = array.fix(&z).unwrap();
    assert_eq!(fix.mirror, None);
    assert_relative_eq!(fix.position.mean, target, epsilon = 1e-5);
    precise.range_std = vec![30.0];
    let coarse = RangeArray::new(precise).unwrap();
    assert!(ambiguous(&coarse, &z).contains("side"));
    assert!(coarse.fix_on(&z, Some(Side::Above)).unwrap().mirror.is_some());
}

#[test]
fn hydrophones_in_the_plane() {
    let mut plane = settings(&BATS, None);
    plane.hydrophones = DMatrix::from_row_slice(3, 2, &[0.0, 0.0, 1000.0, 0.0, 400.0, 700.0]);
    let array = RangeArray::new(plane).unwrap();
    let target = DVector::from_vec(vec![-120.0, 640.0]);
    let fix = array.fix(&array.observe(&target, None).unwrap()).unwrap();
    assert_relative_eq!(fix.position.mean, target, epsilon = 1e-6);
    assert_eq!((fix.dof, fix.mirror), (1, None));
}

#[test]
fn degenerate_geometries_and_absurd_ranges_are_refused_by_name() {
    let refused = |array: &RangeArray, z: &[f64], what: &str| {
        let error = array.fix(&DVector::from_column_slice(z)).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    };
    let line = RangeArray::new(settings(&[[0.0; 3], [100.0, 0.0, 0.0], [300.0, 0.0, 0.0]], None)).unwrap();
    refused(&line, &[300.0, 280.0, 320.0], "channels 0, 1, 2 are collinear");
    let pole = RangeArray::new(settings(&[[0.0, 0.0, 10.0], [0.0, 0.0, 90.0]], Some(1.0))).unwrap();
    refused(&pole, &[100.0, 100.0, 50.0], "one point of the plan");
    let nan = f64::NAN;
    refused(&bats(), &[300.0, nan, nan, 60.0], "needs 2 ranges, 1 heard");
    refused(&bats(), &[nan; 4], "needs 3 ranges, 0 heard");
    refused(&bats(), &[700.0, -1.0, 700.0, 60.0], "channel 1");
    refused(&bats(), &[700.0, 700.0, f64::INFINITY, 60.0], "index 2");
    refused(&bats(), &[600.0, 600.0, 9000.0, 60.0], "range of channel 2 = 9000 m");
    refused(&bats(), &[100.0, 950.0, 900.0, 60.0], "range of channel 0");
    refused(&bats(), &[700.0, 700.0, 700.0], "size 3, expected 4");
}

#[test]
fn a_gross_error_shows_in_the_redundancy() {
    let target = DVector::from_vec(vec![200.0, -100.0, 60.0]);
    let mut z = toss().observe(&target, None).unwrap();
    z[3] += 40.0;
    assert!(toss().fix(&z).unwrap().p_value < 1e-6);
}
