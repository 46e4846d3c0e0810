use nalgebra::{Matrix3, Vector2, Vector3};
use trackrs::geodesy::local::{Axes, LocalFrame};
use trackrs::geodesy::placement::{Fix, place_array};
use trackrs::geodesy::similarity::fit;
use trackrs::geodesy::wgs84::Geodetic;
use trackrs::model::Rotation;
use trackrs::model::rotation::{reported_vector, right_jacobian, right_jacobian_inverse, vector_between};
use trackrs::model::sensor::closed_form::{known_depth, two_circles, two_spheres};

use super::Source;
use super::source::finite;

fn vector(source: &mut Source<'_>) -> Vector3<f64> {
    Vector3::new(source.number(), source.number(), source.number())
}

fn vectors(source: &mut Source<'_>, count: usize) -> Vec<Vector3<f64>> {
    (0..count).map(|_| vector(source)).collect()
}

fn position(source: &mut Source<'_>) -> Geodetic {
    Geodetic {
        lat: source.number() / 60.0,
        lon: source.number() / 20.0,
        height: source.number(),
    }
}

pub(crate) fn geodetic(source: &mut Source<'_>) {
    let given = position(source);
    if let Ok(place) = Geodetic::new(given.lat, given.lon, given.height) {
        finite("ECEF", place.to_ecef().iter());
    }
    let point = vector(source) * 1e5;
    if let Ok(place) = Geodetic::from_ecef(&point) {
        assert!(place.lat.is_finite(), "{point:?} {place:?}");
        finite("geodetic", [&place.lat, &place.lon, &place.height]);
    }
}

pub(crate) fn local_frames(source: &mut Source<'_>) {
    let axes = if source.coin() { Axes::Ned } else { Axes::Enu };
    let Ok(frame) = LocalFrame::new(position(source), axes) else {
        return;
    };
    if let Ok(place) = frame.to_geodetic(&(vector(source) * 1e3)) {
        finite("geodetic", [&place.lat, &place.lon, &place.height]);
        finite("local", frame.from_geodetic(&place).iter());
    }
}

pub(crate) fn similarities(source: &mut Source<'_>) {
    let count = source.below(7);
    let (from, to) = (vectors(source, count), vectors(source, count));
    let size = source.about(count);
    let weights = source.coin().then(|| source.positives(size));
    if let Ok(found) = fit(&from, &to, weights.as_deref()) {
        finite("residuals", found.residuals.iter().flat_map(|r| r.iter()));
        finite("image", found.similarity.apply(&from[0]).iter());
        finite("covariance", found.similarity.cov().iter());
        let there = found.similarity.propagate(&from[0], &Matrix3::identity());
        finite("point", there.position.iter().chain(there.cov.iter()));
    }
}

pub(crate) fn placements(source: &mut Source<'_>) {
    let count = source.below(6);
    let elements = vectors(source, count);
    let origin = position(source);
    let fixes: Vec<Option<Fix>> = (0..count)
        .map(|_| {
            (source.below(4) > 0).then(|| Fix {
                position: Geodetic {
                    lat: origin.lat + source.tame() * 1e-6,
                    lon: origin.lon + source.tame() * 1e-6,
                    height: source.number(),
                },
                std: [source.positive(), source.positive(), source.positive()],
            })
        })
        .collect();
    if let Ok(placed) = place_array(&elements, &fixes, origin) {
        finite(
            "place",
            placed
                .elements
                .iter()
                .flat_map(|e| e.position.iter().chain(e.cov.iter())),
        );
        finite("survey", &placed.survey_std());
    }
}

pub(crate) fn rotations(source: &mut Source<'_>) {
    let quaternion = [source.number(), source.number(), source.number(), source.number()];
    let norm = quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
    let unit = if source.coin() {
        quaternion.map(|q| q / norm)
    } else {
        quaternion
    };
    if let Ok(turn) = Rotation::from_quaternion(unit, "quaternion") {
        finite("quaternion", &turn.quaternion());
        assert!(
            turn.vector().iter().all(|v| v.is_finite()),
            "{unit:?} {turn:?} {:?}",
            turn.vector()
        );
    }
    if let Ok(found) = reported_vector(unit, "quaternion") {
        let missing = unit.iter().any(|q| q.is_nan());
        assert!(missing || found.iter().all(|v| v.is_finite()), "{unit:?} {found:?}");
    }
    let (a, b) = (vector(source), vector(source));
    if a.iter().chain(b.iter()).all(|v| v.abs() < 1e6) {
        finite("between", vector_between(&a, &b).iter());
        finite("Jacobian", right_jacobian(&a).iter());
        // The inverse has poles at whole turns.
        let inverse = right_jacobian_inverse(&a);
        assert!(inverse.iter().all(|v| !v.is_nan()) || a.norm() > 6.0, "{a} {inverse}");
    }
}

pub(crate) fn closed_forms(source: &mut Source<'_>) {
    let places = [vector(source), vector(source), vector(source)];
    let ranges = [source.positive(), source.positive(), source.positive()];
    let floor = source.positive();
    let ordinary = places
        .iter()
        .flat_map(|p| p.iter())
        .chain(&ranges)
        .all(|v| v.abs() < 1e12 && (v.abs() > 1e-12 || *v == 0.0));
    let depth = source.tame();
    if let (Ok(found), true) = (known_depth(&places, ranges, depth), ordinary) {
        assert!(
            found.iter().all(|v| v.is_finite()),
            "{places:?} {ranges:?} {depth} {found:?}"
        );
    }
    if let (Ok(found), true) = (two_spheres(&places, ranges, floor), ordinary && floor.abs() < 1e12) {
        finite("position", found.positive.iter().chain(found.negative.iter()));
    }
    let plan = |v: Vector3<f64>| Vector2::new(v.x, v.y);
    let found = two_circles(plan(places[0]), plan(places[1]), [ranges[0], ranges[1]], floor);
    if let (Ok(found), true) = (found, ordinary && floor.abs() < 1e12) {
        finite("position", found.positive.iter().chain(found.negative.iter()));
    }
}
