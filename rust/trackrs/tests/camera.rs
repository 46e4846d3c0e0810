//! CameraSensor: derivatives, the Cramér-Rao bound, global minima, and images that must be refused.

use crate::draws::normal;
use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trackrs::Error;
use trackrs::model::sensor::{CameraSensor, Intrinsics};
use trackrs::model::{Rotation, Sensor, StateSpace};
use trackrs::stats::chi_square;

const POSE: StateSpace = StateSpace {
    dim: 6,
    attitude: Some(3),
};

fn camera(points: &[[f64; 3]], pixel_std: f64) -> CameraSensor {
    let points = DMatrix::from_fn(points.len(), 3, |i, j| points[i][j]);
    let intrinsics = Intrinsics::new([1000.0, 1000.0], [640.0, 480.0]).unwrap();
    CameraSensor::new(points, intrinsics, pixel_std).unwrap()
}

/// A centre point and four at 10 cm in a cross.
const CROSS: [[f64; 3]; 5] = [
    [0.0, 0.0, 0.0],
    [0.1, 0.0, 0.0],
    [0.0, 0.1, 0.0],
    [-0.1, 0.0, 0.0],
    [0.0, -0.1, 0.0],
];

fn pose(position: [f64; 3], turn: [f64; 3]) -> DVector<f64> {
    DVector::from_iterator(6, position.into_iter().chain(turn))
}

/// The cross, 1 m away, its plane tilted by 30 degrees.
fn tilted() -> DVector<f64> {
    pose([0.0, 0.0, 1.0], [30.0_f64.to_radians(), 0.0, 0.0])
}

fn seen(camera: &CameraSensor, state: &DVector<f64>, rng: &mut Pcg64) -> DVector<f64> {
    let std = camera.pixel_std();
    camera.observe(state, None).unwrap().map(|v| v + std * normal(rng))
}

fn any_turn(rng: &mut Pcg64) -> Rotation {
    let mut q = [0.0; 4].map(|_: f64| normal(rng));
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    q = q.map(|c| c / norm);
    Rotation::from_quaternion(q, "q").unwrap()
}

fn random_pose(rng: &mut Pcg64, distance: f64) -> DVector<f64> {
    let turn = any_turn(rng).vector();
    let (a, b) = (rng.random_range(-0.4..0.4), rng.random_range(-0.4..0.4));
    pose([a * distance, b * distance, distance], [turn.x, turn.y, turn.z])
}

#[test]
fn jacobian_is_the_derivative_on_the_manifold() {
    let mut rng = Pcg64::seed_from_u64(3);
    let camera = camera(&[[0.1, 0.2, -0.1], [-0.2, 0.1, 0.3], [0.0, -0.3, 0.1]], 1.0);
    for _ in 0..50 {
        let state = random_pose(&mut rng, 2.0).insert_rows(6, 6, 0.7);
        let space = StateSpace {
            dim: 12,
            attitude: Some(3),
        };
        let h = camera.jacobian(&state, None).unwrap();
        for k in 0..12 {
            let mut step = DVector::zeros(12);
            step[k] = 1e-5;
            let ahead = camera.observe(&space.retract(&state, &step), None).unwrap();
            let behind = camera.observe(&space.retract(&state, &-step), None).unwrap();
            assert_relative_eq!(h.column(k).into_owned(), (ahead - behind) / 2e-5, epsilon = 1e-5);
        }
    }
}

/// Over N draws a ratio of standard deviations has the standard deviation 1/sqrt(2N) = 0.016.
#[test]
fn errors_are_those_of_the_cramer_rao_bound() {
    let mut rng = Pcg64::seed_from_u64(11);
    let camera = camera(&CROSS, 0.3);
    let h = camera.jacobian(&tilted(), None).unwrap();
    let bound = (h.transpose() * &h / (0.3 * 0.3)).try_inverse().unwrap();
    let draws = 2000;
    let (mut squares, mut nees, mut statistic) = (DVector::zeros(6), 0.0, 0.0);
    for _ in 0..draws {
        let fix = camera.fix(&seen(&camera, &tilted(), &mut rng)).unwrap();
        assert!(fix.mirror.is_none() && fix.dof == 4);
        let error = POSE.difference(&fix.position.mean, &tilted());
        let information = fix.position.cov.clone().try_inverse().unwrap();
        nees += (error.transpose() * information * &error)[0];
        squares += error.component_mul(&error);
        statistic += fix.statistic;
    }
    let n = f64::from(draws);
    for i in 0..6 {
        let ratio = (squares[i] / n / bound[(i, i)]).sqrt();
        assert!((ratio - 1.0).abs() < 0.07, "component {i}: {ratio}");
    }
    // Chi-square sums of 6 and 4 degrees of freedom per draw, four standard deviations to either side.
    assert!((nees / n - 6.0).abs() < 4.0 * (12.0 / n).sqrt(), "{}", nees / n);
    assert!(
        (statistic / n - 4.0).abs() < 4.0 * (8.0 / n).sqrt(),
        "{}",
        statistic / n
    );
}

/// The residuals of a global minimum are never larger than those of the truth.
#[test]
fn fixes_are_global_minima() {
    let mut rng = Pcg64::seed_from_u64(5);
    let (mut missed, mut total) = (0, 0);
    for draw in 0..3000 {
        let depth = [0.0, 0.02, 1.0][draw % 3];
        let points: Vec<[f64; 3]> = (0..rng.random_range(4..9))
            .map(|_| [1.0, 1.0, depth].map(|size| size * rng.random_range(-1.0..1.0)))
            .collect();
        let std = [1e-6, 0.3][draw / 3 % 2];
        let camera = camera(&points, std);
        let distance = [3.0, 6.0, 15.0][draw / 6 % 3];
        let truth = random_pose(&mut rng, distance);
        let Ok(expected) = camera.observe(&truth, None) else {
            continue;
        };
        let z = seen(&camera, &truth, &mut rng);
        let at_truth = (&z - expected).norm_squared() / (std * std);
        total += 1;
        let found = camera.fix(&z).is_ok_and(|fix| fix.statistic < at_truth + 1e-3);
        missed += u32::from(!found);
    }
    // Sets seen nearly edge on have valleys along which the iteration does not end.
    assert!(total > 2900 && missed <= 3, "{missed} of {total}");
}

#[test]
fn exact_images_give_the_pose_back_from_any_four_points() {
    let camera = camera(&CROSS, 1e-6);
    let whole = camera.observe(&tilted(), None).unwrap();
    for hidden in 0..=5 {
        let mut z = whole.clone();
        if hidden < 5 {
            // Of the last point one coordinate is left.
            z[2 * hidden] = f64::NAN;
            if hidden < 4 {
                z[2 * hidden + 1] = f64::NAN;
            }
        }
        let fix = camera.fix(&z).unwrap();
        assert_relative_eq!(fix.position.mean, tilted(), epsilon = 1e-9);
        assert_eq!(fix.dof, z.iter().filter(|v| !v.is_nan()).count() - 6);
        assert!(fix.p_value > 0.999);
    }
}

#[test]
fn a_plane_far_away_has_a_mirror() {
    let camera = camera(&CROSS, 0.3);
    let far = pose([1.0, 0.5, 10.0], [0.5, 0.3, 0.0]);
    let fix = camera.fix(&camera.observe(&far, None).unwrap()).unwrap();
    let mirror = fix.mirror.unwrap();
    assert_relative_eq!(fix.position.mean, far, epsilon = 1e-6);
    assert_relative_eq!(
        mirror.rows(0, 3).into_owned(),
        far.rows(0, 3).into_owned(),
        epsilon = 0.02
    );
    let normal = |p: &DVector<f64>| Rotation::from_vector(&p.fixed_rows::<3>(3).into_owned()).rotate(&Vector3::z());
    let sight = far.fixed_rows::<3>(0).normalize();
    // Mirror images in the line of sight: n + n' is along it.
    let sum = normal(&far) + normal(&mirror);
    assert!(sum.cross(&sight).norm() < 0.02, "{sum}");
    assert!(normal(&far).dot(&normal(&mirror)) < 0.9);
}

#[test]
fn a_wrong_point_fails_the_test_of_redundancy() {
    let camera = camera(&CROSS, 0.3);
    let mut z = camera.observe(&tilted(), None).unwrap();
    z[2] += 6.0;
    let fix = camera.fix(&z).unwrap();
    assert!(fix.p_value < 1e-6);
    assert_relative_eq!(fix.p_value, chi_square::survival(fix.statistic, 4));
}

#[test]
fn what_cannot_be_seen_or_fixed_says_why() {
    let text = |error: Error| {
        assert!(matches!(error, Error::Unobservable { .. }), "{error}");
        error.to_string()
    };
    let cross = camera(&CROSS, 0.3);
    let behind = text(
        cross
            .observe(&pose([0.0, 0.0, 0.02], [1.5, 0.0, 0.0]), None)
            .unwrap_err(),
    );
    assert!(behind.contains("point 4 lies behind the camera"), "{behind}");
    let mut z = cross.observe(&tilted(), None).unwrap();
    z[0] = f64::NAN;
    z[5] = f64::NAN;
    assert!(text(cross.fix(&z).unwrap_err()).contains("needs 4 points, 3 seen (1, 3, 4)"));
    z.fill(f64::NAN);
    assert!(text(cross.fix(&z).unwrap_err()).ends_with("0 seen"));
    z[3] = f64::INFINITY;
    assert!(matches!(cross.fix(&z), Err(Error::NonFinite { index: 3, .. })));
    let line = camera(&[[0.0; 3], [0.1, 0.1, 0.0], [0.2, 0.2, 0.0], [-0.1, -0.1, 0.0]], 0.3);
    let z = line.observe(&tilted(), None).unwrap();
    assert!(text(line.fix(&z).unwrap_err()).contains("(0, 1, 2, 3) are collinear"));
    let same = camera(&[[0.3; 3]; 4], 0.3);
    assert!(text(same.fix(&same.observe(&tilted(), None).unwrap()).unwrap_err()).contains("collinear"));
    assert!(cross.fix(&DVector::zeros(3)).is_err());
    let blind = CameraSensor::new(DMatrix::zeros(0, 3), *cross.intrinsics(), 0.3).unwrap_err();
    assert!(blind.to_string().starts_with("points"), "{blind}");
    assert!(CameraSensor::new(DMatrix::zeros(4, 2), *cross.intrinsics(), 0.3).is_err());
    assert!(CameraSensor::new(DMatrix::zeros(4, 3), *cross.intrinsics(), 0.0).is_err());
    assert!(Intrinsics::new([1000.0, 0.0], [0.0, 0.0]).is_err());
    let skewed = Matrix3::new(1000.0, 2.0, 640.0, 0.0, 1000.0, 480.0, 0.0, 0.0, 1.0);
    assert!(
        Intrinsics::from_matrix(&skewed)
            .unwrap_err()
            .to_string()
            .starts_with("intrinsics")
    );
}
