//! Geodesy: golden values, round trips over the whole range of heights, known similarities, Monte Carlo.

use std::f64::consts::{FRAC_PI_2, PI};

use approx::assert_relative_eq;
use nalgebra::{DMatrix, Matrix3, Rotation3, SMatrix, Vector3};
use proptest::prelude::*;
use rand_pcg::{Pcg64, rand_core::Rng};
use serde_json::Value;
use trackrs::geodesy::local::{Axes, LocalFrame};
use trackrs::geodesy::placement::{Fix, place_array};
use trackrs::geodesy::similarity::{Similarity, fit};
use trackrs::geodesy::wgs84::{ECCENTRICITY_SQUARED, Geodetic, SEMI_MAJOR_AXIS};
use trackrs::linalg::cholesky::Cholesky;

fn file(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    serde_json::from_value(value.clone()).unwrap()
}

fn points(value: &Value) -> Vec<Vector3<f64>> {
    let rows: Vec<[f64; 3]> = serde_json::from_value(value.clone()).unwrap();
    rows.into_iter().map(Vector3::from).collect()
}

fn degrees(value: &Value) -> Geodetic {
    let row = numbers(value);
    Geodetic::new(row[0].to_radians(), row[1].to_radians(), row[2]).unwrap()
}

/// Standard normal, by Box and Muller.
fn normal(random: &mut Pcg64) -> f64 {
    let mut uniform = || ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
    let radius = (-2.0 * uniform().ln()).sqrt();
    radius * (2.0 * PI * uniform()).cos()
}

#[test]
fn frames_match_the_golden_file() {
    let file = file(include_str!(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../tests/data/frames.json"
    )));
    let (lat, lon, height) = (
        numbers(&file["lat_rad"]),
        numbers(&file["lon_rad"]),
        numbers(&file["h"]),
    );
    let geodetic: Vec<_> = (0..lat.len())
        .map(|i| Geodetic::new(lat[i], lon[i], height[i]).unwrap())
        .collect();
    let ned = LocalFrame::new(geodetic[0], Axes::Ned).unwrap();
    let (ecef, local) = (points(&file["ecef"]), points(&file["ned_about_first"]));
    for (i, position) in geodetic.iter().enumerate() {
        assert_relative_eq!(position.to_ecef(), ecef[i], max_relative = 1e-9);
        // The reference subtracts coordinates of Earth's radius, so it is good to a few nanometres.
        assert_relative_eq!(ned.from_geodetic(position), local[i], epsilon = 5e-9);
    }
    let helmert = &file["helmert"];
    let found = fit(&points(&helmert["src"]), &points(&helmert["dst"]), None).unwrap();
    let rotation: Vec<[f64; 3]> = serde_json::from_value(helmert["R"].clone()).unwrap();
    assert_relative_eq!(
        found.similarity.scale,
        helmert["scale"].as_f64().unwrap(),
        epsilon = 1e-9
    );
    let rotation = Matrix3::from_row_slice(&rotation.concat());
    assert_relative_eq!(found.similarity.rotation, rotation, epsilon = 1e-9);
    let translation = Vector3::from_vec(numbers(&helmert["t"]));
    assert_relative_eq!(
        found.similarity.translation(),
        translation,
        max_relative = 1e-9,
        epsilon = 1e-9
    );
    assert!(found.variance < 1e-20 && found.dof == 5);
}

#[test]
fn frames_match_proj() {
    let file = file(include_str!(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../tests/data/geodesy_pyproj.json"
    )));
    let ecef = points(&file["ecef"]);
    for (row, expected) in file["geodetic_deg"].as_array().unwrap().iter().zip(&ecef) {
        let found = degrees(row).to_ecef();
        assert!((found - expected).norm() < 2e-8, "{row}: {found} {expected}");
    }
    for case in file["local"].as_array().unwrap() {
        let frame = LocalFrame::new(degrees(&case["origin_deg"]), Axes::Enu).unwrap();
        let enu = points(&case["enu"]);
        for (row, expected) in case["points_deg"].as_array().unwrap().iter().zip(&enu) {
            let found = frame.from_geodetic(&degrees(row));
            assert!((found - expected).norm() < 2e-8, "{row}: {found} {expected}");
        }
    }
}

/// Distance in metres between two positions that are close together; longitudes count by their circle.
fn distance(a: &Geodetic, b: &Geodetic) -> f64 {
    let turn = (a.lon - b.lon).abs();
    let across = turn.min((2.0 * PI - turn).abs()) * a.lat.cos();
    let radius = SEMI_MAJOR_AXIS + a.height;
    Vector3::new(radius * (a.lat - b.lat), radius * across, a.height - b.height).norm()
}

#[test]
fn geodetic_round_trip_to_a_micrometre_from_trench_to_geostationary() {
    let heights = [
        -11e3, -4e3, -100.0, -1e-3, 0.0, 1e-3, 8.8e3, 4.08e5, 2.02e7, 3.5786e7, 4e7,
    ];
    let mut latitudes: Vec<f64> = (-180..=180).map(|i| f64::from(i) / 180.0 * FRAC_PI_2).collect();
    for tiny in [1e-15, 1e-12, 1e-9, 1e-6, 1e-4] {
        latitudes.extend([tiny, -tiny, FRAC_PI_2 - tiny, tiny - FRAC_PI_2]);
    }
    let mut longitudes: Vec<f64> = (-36..=36).map(|i| f64::from(i) / 36.0 * PI).collect();
    longitudes.extend([PI - 1e-12, 1e-12 - PI, 1e-15, -1e-9]);
    let mut worst: f64 = 0.0;
    for &height in &heights {
        for &lat in &latitudes {
            for &lon in &longitudes {
                let start = Geodetic::new(lat, lon, height).unwrap();
                let point = start.to_ecef();
                let back = Geodetic::from_ecef(&point).unwrap();
                worst = worst.max(distance(&start, &back)).max((back.to_ecef() - point).norm());
            }
        }
    }
    assert!(worst < 1e-7, "{worst}"); // ten times better than promised
}

#[test]
fn deep_inside_the_earth_it_is_still_the_same_point() {
    for height in [-1e5, -1e6, -6e6, -6.3e6] {
        for i in -90..=90 {
            let start = Geodetic::new(f64::from(i).to_radians().clamp(-FRAC_PI_2, FRAC_PI_2), 1.0, height).unwrap();
            let back = Geodetic::from_ecef(&start.to_ecef()).unwrap();
            assert!((back.to_ecef() - start.to_ecef()).norm() < 1e-6, "{start:?} {back:?}");
            assert!((back.height - height).abs() < 1e-6, "{start:?} {back:?}");
        }
    }
}

/// The normal to the ellipsoid, as the gradient of x²/a² + y²/a² + z²/b².
fn outward(position: &Geodetic) -> Vector3<f64> {
    let foot = Geodetic {
        height: 0.0,
        ..*position
    }
    .to_ecef();
    Vector3::new(foot.x, foot.y, foot.z / (1.0 - ECCENTRICITY_SQUARED)).normalize()
}

proptest! {
    #[test]
    fn local_frames_are_orthonormal_right_handed_and_reversible(
        lat in -FRAC_PI_2..=FRAC_PI_2, lon in -PI..=PI, height in -11e3..1e6, east in -1e5..1e5, north in -1e5..1e5, up in -1e4..1e5,
    ) {
        let origin = Geodetic::new(lat, lon, height).unwrap();
        let (ned, enu) = (LocalFrame::new(origin, Axes::Ned).unwrap(), LocalFrame::new(origin, Axes::Enu).unwrap());
        for frame in [&ned, &enu] {
            let r = frame.rotation();
            prop_assert!((r * r.transpose() - Matrix3::identity()).amax() < 1e-15);
            prop_assert!((r.determinant() - 1.0).abs() < 1e-15);
            prop_assert!(frame.from_geodetic(&origin).norm() < 1e-8);
        }
        prop_assert!((enu.rotation().row(2).transpose() - outward(&origin)).norm() < 1e-14);
        let point = Vector3::new(east, north, up);
        prop_assert!((enu.from_ecef(&enu.to_ecef(&point)) - point).norm() < 1e-8);
        prop_assert!((enu.from_geodetic(&enu.to_geodetic(&point).unwrap()) - point).norm() < 1e-7);
        let swapped = Vector3::new(north, east, -up);
        prop_assert!((ned.to_ecef(&swapped) - enu.to_ecef(&point)).norm() < 1e-8);
    }

    #[test]
    fn a_known_similarity_is_recovered(
        seed in any::<u64>(), angles in prop::array::uniform3(-PI..PI), scale in 0.01..100.0_f64, count in 3..12_usize, flat in any::<bool>(),
    ) {
        let mut random = Pcg64::new(seed.into(), 1);
        let turn = *Rotation3::from_euler_angles(angles[0], angles[1], angles[2]).matrix();
        let shift = Vector3::new(5e4, -3e4, 200.0);
        let source: Vec<_> = (0..count)
            .map(|_| Vector3::from_fn(|i, _| if flat && i == 2 { 7.0 } else { 100.0 * normal(&mut random) }))
            .collect();
        let target: Vec<_> = source.iter().map(|p| turn * p * scale + shift).collect();
        let weights: Vec<_> = (0..count).map(|i| 1.0 + i as f64).collect();
        // Three random points may nearly lie on a line: no claim about those.
        let (a, b) = (source[1] - source[0], source[2] - source[0]);
        prop_assume!(a.cross(&b).norm() > 0.1 * a.norm() * b.norm());
        let found = fit(&source, &target, Some(&weights)).unwrap();
        prop_assert!((found.similarity.rotation - turn).amax() < 1e-8);
        prop_assert!((found.similarity.rotation.determinant() - 1.0).abs() < 1e-13);
        prop_assert!((found.similarity.scale - scale).abs() < 1e-8 * scale);
        prop_assert!((found.similarity.translation() - shift).norm() < 1e-5);
        prop_assert_eq!(found.dof, 3 * count - 7);
    }
}

/// Five elements, a kilometre across, far from the origin of their own frame.
fn array() -> Vec<Vector3<f64>> {
    [
        [4000.0, 0.0, 250.0],
        [5000.0, 30.0, 262.0],
        [4500.0, 866.0, 248.0],
        [4400.0, 300.0, 330.0],
        [4900.0, 700.0, 255.0],
    ]
    .map(Vector3::from)
    .to_vec()
}

fn truth() -> Similarity {
    Similarity {
        scale: 1.02,
        rotation: *Rotation3::from_euler_angles(0.1, -0.3, 2.0).matrix(),
        centre: Vector3::zeros(),
        image: Vector3::new(700.0, -900.0, 30.0),
        centred_cov: SMatrix::zeros(),
    }
}

/// (δt, λ, ω) of an estimate against the truth.
fn errors(found: &Similarity, truth: &Similarity) -> [f64; 7] {
    let turn = Similarity {
        rotation: found.rotation * truth.rotation.transpose(),
        ..truth.clone()
    };
    let (shift, omega) = (found.translation() - truth.translation(), turn.rotation_vector());
    let scale = (found.scale / truth.scale).ln();
    [shift.x, shift.y, shift.z, scale, omega.x, omega.y, omega.z]
}

/// Mean of eᵀ P⁻¹ e over `runs` errors of dimension n, and the bound of five standard deviations of that mean.
fn assert_consistent(what: &str, sum: f64, n: f64, runs: u32) {
    let runs = f64::from(runs);
    let bound = 5.0 * (2.0 * n / runs).sqrt();
    assert!(
        (sum / runs - n).abs() < bound,
        "{what}: {} is not {n} +- {bound}",
        sum / runs
    );
}

fn mahalanobis(cov: &DMatrix<f64>, error: &[f64]) -> f64 {
    let factor = Cholesky::new(cov, "covariance").unwrap();
    factor.whiten(&nalgebra::DVector::from_row_slice(error)).norm_squared()
}

#[test]
fn covariance_of_the_seven_parameters_is_that_of_monte_carlo() {
    const RUNS: u32 = 4000;
    let (source, truth, mut random) = (array(), truth(), Pcg64::new(31, 1));
    let stds = [0.2, 0.2, 0.5, 0.3, 1.0];
    let weights: Vec<f64> = stds.iter().map(|s| 1.0 / (s * s)).collect();
    let far = Vector3::new(2000.0, -500.0, 0.0);
    let own = Matrix3::from_diagonal(&Vector3::new(4.0, 1.0, 0.25));
    let (mut parameters, mut point, mut variance) = (0.0, 0.0, 0.0);
    for _ in 0..RUNS {
        let noisy =
            |(p, std): (&Vector3<f64>, &f64)| truth.apply(p) + Vector3::from_fn(|_, _| std * normal(&mut random));
        let target: Vec<_> = source.iter().zip(&stds).map(noisy).collect();
        let mut found = fit(&source, &target, Some(&weights)).unwrap();
        variance += found.variance;
        // Against the known variance, 1: the estimated one would make this an F statistic.
        found.similarity.centred_cov /= found.variance;
        let cov = found.similarity.cov();
        let cov = DMatrix::from_fn(7, 7, |i, j| cov[(i, j)]);
        parameters += mahalanobis(&cov, &errors(&found.similarity, &truth));
        let start = far + Vector3::new(2.0, 1.0, 0.5).map(|s| s * normal(&mut random));
        let image = found.similarity.propagate(&start, &own);
        let error = image.position - truth.apply(&far);
        point += mahalanobis(&DMatrix::from_fn(3, 3, |i, j| image.cov[(i, j)]), error.as_slice());
    }
    assert_consistent("parameters", parameters, 7.0, RUNS);
    assert_consistent("propagated point", point, 3.0, RUNS);
    let bound = 5.0 * (2.0 / (8.0 * f64::from(RUNS))).sqrt();
    assert!((variance / f64::from(RUNS) - 1.0).abs() < bound);
}

#[test]
fn an_array_with_gps_fixes_is_placed_with_honest_covariances() {
    const RUNS: u32 = 3000;
    let origin = Geodetic::new(0.95, PI - 1e-4, 12.0).unwrap(); // the array lies across the antimeridian
    let frame = LocalFrame::new(origin, Axes::Ned).unwrap();
    let (elements, mut random) = (array(), Pcg64::new(32, 1));
    let truth = Similarity { scale: 1.0, ..truth() };
    let std = [0.3, 0.4, 1.5];
    let (mut placed, mut chi_square) = ([0.0; 5], 0.0);
    for _ in 0..RUNS {
        let fix = |(i, p): (usize, &Vector3<f64>)| {
            let noisy = truth.apply(p) + Vector3::from(std).map(|s| s * normal(&mut random));
            let position = frame.to_geodetic(&noisy).unwrap();
            (i < 4).then_some(Fix { position, std })
        };
        let fixes: Vec<_> = elements.iter().enumerate().map(fix).collect();
        let found = place_array(&elements, &fixes, origin).unwrap();
        assert_eq!((found.dof, found.residuals[4]), (5, None));
        chi_square += found.chi_square;
        for (sum, (estimate, p)) in placed.iter_mut().zip(found.elements.iter().zip(&elements)) {
            let error = estimate.position - truth.apply(p);
            *sum += mahalanobis(&DMatrix::from_fn(3, 3, |i, j| estimate.cov[(i, j)]), error.as_slice());
        }
    }
    for (i, sum) in placed.into_iter().enumerate() {
        assert_consistent(&format!("element {i}"), sum, 3.0, RUNS);
    }
    assert_consistent("chi-square", chi_square, 5.0, RUNS);
}

#[test]
fn exact_fixes_place_the_array_exactly_and_the_rest_is_refused_by_name() {
    let origin = Geodetic::new(-0.3, -3.1, 0.0).unwrap();
    let frame = LocalFrame::new(origin, Axes::Ned).unwrap();
    let (elements, truth) = (array(), truth());
    let fix = |p: &Vector3<f64>| Fix {
        position: frame.to_geodetic(&truth.apply(p)).unwrap(),
        std: [0.5, 0.5, 1.0],
    };
    let mut fixes: Vec<_> = elements.iter().map(|p| Some(fix(p))).collect();
    fixes[1] = None;
    let found = place_array(&elements, &fixes, origin).unwrap();
    for (estimate, p) in found.elements.iter().zip(&elements) {
        assert!((estimate.position - truth.apply(p)).norm() < 1e-6);
    }
    assert!(found.chi_square < 1e-9);

    let text = |elements: &[Vector3<f64>], fixes: &[Option<Fix>]| {
        place_array(elements, fixes, origin).unwrap_err().to_string()
    };
    let two = [fixes[0], None, fixes[2], None, None];
    assert!(text(&elements, &two).starts_with("fixes = 2 of 5 elements"));
    let line: Vec<_> = (0..5).map(|i| Vector3::new(100.0, 10.0, 1.0) * f64::from(i)).collect();
    let on_line: Vec<_> = line.iter().map(|p| Some(fix(p))).collect();
    assert!(text(&line, &on_line).starts_with("elements with a fix = 5 collinear points"));
    let mut degrees = fixes.clone();
    degrees[3] = Some(Fix {
        position: Geodetic {
            lat: -17.0,
            lon: -177.0,
            height: 0.0,
        },
        std: [1.0; 3],
    });
    assert!(text(&elements, &degrees).starts_with("lat[3] = -17"));
    degrees[3] = Some(Fix {
        std: [1.0, 0.0, 1.0],
        ..fix(&elements[3])
    });
    assert!(text(&elements, &degrees).starts_with("std[3] = 0"));
}
