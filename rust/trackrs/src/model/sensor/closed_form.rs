//! Positions from two or three ranges in closed form: where an iteration starts.
//!
//! | symbol     | name here   | meaning                                   |
//! |------------|-------------|-------------------------------------------|
//! | p_i        | `positions` | hydrophones A, B, C, metres               |
//! | S_i        | `ranges`    | measured ranges, metres                   |
//! | Z          | `depth`     | depth of the target, metres, positive down |
//! | u, v, w    | same        | the target in the frame of the hydrophones |
//!
//! Known depth (U10):  η_i = |p_i|² − S_i² − 2 Z_i Z,
//! X = [η_A (Y_B − Y_C) + η_B (Y_C − Y_A) + η_C (Y_A − Y_B)] / (2 [X_A (Y_B − Y_C) + X_B (Y_C − Y_A) + X_C (Y_A − Y_B)]),
//! Y with X and Y exchanged. The same difference of two spheres gives X = [η_A − η_B − 2 Y (Y_A − Y_B)] / (2 (X_A − X_B)).
//!
//! Two spheres (U10b):  e_x along p_B − p_A (length d), e_y across it towards p_C (coordinates i, j), e_z = e_x × e_y;
//! u = (S_A² − S_B² + d²)/2d,  v = (S_A² − S_C² + i² + j²)/2j − (i/j) u,  w = ±√max(0, S_A² − u² − v²).
//!
//! Two circles: the same in the plane, with u and w only.
//!
//! Reference: paper of Xi, Liu, Tao, Lu, initial values; spec labels U10, U10b.
//! Deviation: the second form of X is printed there without the factor 2 on Y (Y_A − Y_B); it is right as above.

use nalgebra::{DVector, Vector2, Vector3};

use crate::error::{Error, Result};

/// Hydrophones closer to one line than this, relative to their distance, count as collinear.
pub(super) const COLLINEAR: f64 = 1e-6;

/// Two positions that are mirror images in the line or plane of the hydrophones and fit equally.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mirrored<T> {
    /// The one on the side of the positive normal.
    pub positive: T,
    /// The other.
    pub negative: T,
}

/// U10: the position at a known depth from three ranges, two of the three range equations being used.
pub fn known_depth(positions: &[Vector3<f64>; 3], ranges: [f64; 3], depth: f64) -> Result<Vector3<f64>> {
    let [a, b, c] = positions;
    let eta = |p: &Vector3<f64>, s: f64| p.norm_squared() - s * s - 2.0 * p.z * depth;
    let (ea, eb, ec) = (eta(a, ranges[0]), eta(b, ranges[1]), eta(c, ranges[2]));
    let x_bottom = 2.0 * (a.x * (b.y - c.y) + b.x * (c.y - a.y) + c.x * (a.y - b.y));
    let y_bottom = 2.0 * (a.y * (b.x - c.x) + b.y * (c.x - a.x) + c.y * (a.x - b.x));
    let size = (a - b).xy().norm().max((a - c).xy().norm()).max((b - c).xy().norm());
    // The two are one determinant, but for rounding.
    if x_bottom.abs().min(y_bottom.abs()) <= COLLINEAR * size * size {
        return Err(refused("the three hydrophones are collinear in plan"));
    }
    Ok(Vector3::new(
        (ea * (b.y - c.y) + eb * (c.y - a.y) + ec * (a.y - b.y)) / x_bottom,
        (ea * (b.x - c.x) + eb * (c.x - a.x) + ec * (a.x - b.x)) / y_bottom,
        depth,
    ))
}

/// U10b: both positions from three ranges. `floor` is the least |w|: zero gives the formula, more keeps the two apart.
pub fn two_spheres(positions: &[Vector3<f64>; 3], ranges: [f64; 3], floor: f64) -> Result<Mirrored<Vector3<f64>>> {
    let [a, b, c] = positions;
    let (ab, ac) = (b - a, c - a);
    let d = ab.norm();
    let ex = ab / d;
    let i = ex.dot(&ac);
    let across = ac - ex * i;
    let j = across.norm();
    // Written so that a distance of zero, which makes everything NaN, is caught as well.
    if !(d > 0.0 && j > COLLINEAR * d) {
        return Err(refused("the three hydrophones are collinear"));
    }
    let ey = across / j;
    let ez = ex.cross(&ey);
    let [s1, s2, s3] = ranges;
    let u = (s1 * s1 - s2 * s2 + d * d) / (2.0 * d);
    let v = (s1 * s1 - s3 * s3 + i * i + j * j) / (2.0 * j) - i / j * u;
    let w = (s1 * s1 - u * u - v * v).max(floor * floor).sqrt();
    let foot = a + ex * u + ey * v;
    Ok(Mirrored {
        positive: foot + ez * w,
        negative: foot - ez * w,
    })
}

/// Both positions in the plane from two ranges; `floor` as in [`two_spheres`].
pub fn two_circles(a: Vector2<f64>, b: Vector2<f64>, ranges: [f64; 2], floor: f64) -> Result<Mirrored<Vector2<f64>>> {
    let ab = b - a;
    let d = ab.norm();
    if d.is_nan() || d <= 0.0 {
        return Err(refused("the two hydrophones stand at one point of the plan"));
    }
    let ex = ab / d;
    let ey = Vector2::new(-ex.y, ex.x);
    let [s1, s2] = ranges;
    let u = (s1 * s1 - s2 * s2 + d * d) / (2.0 * d);
    let w = (s1 * s1 - u * u).max(floor * floor).sqrt();
    Ok(Mirrored {
        positive: a + ex * u + ey * w,
        negative: a + ex * u - ey * w,
    })
}

/// The two points farthest apart and the one farthest from their line.
pub(super) struct Widest {
    pub(super) first: usize,
    pub(super) second: usize,
    /// None where all points are collinear.
    pub(super) third: Option<usize>,
}

/// None where all points coincide; `tolerance` is relative to the distance of the farthest two.
pub(super) fn widest(points: &[DVector<f64>], tolerance: f64) -> Option<Widest> {
    let pairs = (0..points.len()).flat_map(|i| (i + 1..points.len()).map(move |j| (i, j)));
    let distance = |&(i, j): &(usize, usize)| (&points[i] - &points[j]).norm();
    let (first, second) = pairs.max_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let length = distance(&(first, second));
    if length <= 0.0 {
        return None;
    }
    let along = (&points[second] - &points[first]) / length;
    let height = |&i: &usize| {
        let offset = &points[i] - &points[first];
        (&offset - &along * along.dot(&offset)).norm()
    };
    let third = (0..points.len()).max_by(|a, b| height(a).total_cmp(&height(b)));
    Some(Widest {
        first,
        second,
        third: third.filter(|i| height(i) > tolerance * length),
    })
}

fn refused(reason: &str) -> Error {
    Error::Unobservable {
        sensor: "RangeArray".into(),
        reason: reason.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn phones() -> [Vector3<f64>; 3] {
        [
            Vector3::new(0.0, 0.0, 250.0),
            Vector3::new(1000.0, 0.0, 252.0),
            Vector3::new(500.0, 866.0, 248.0),
        ]
    }

    #[test]
    fn exact_ranges_give_the_position_back() {
        let target = Vector3::new(123.0, -45.0, 60.0);
        let ranges = phones().map(|p| (target - p).norm());
        let flat = known_depth(&phones(), ranges, 60.0).unwrap();
        assert_relative_eq!(flat, target, epsilon = 1e-9);
        let both = two_spheres(&phones(), ranges, 0.0).unwrap();
        let near = (both.positive - target).norm().min((both.negative - target).norm());
        assert!(near < 1e-9);
        for mirror in [both.positive, both.negative] {
            for (p, s) in phones().iter().zip(ranges) {
                assert_relative_eq!((mirror - p).norm(), s, epsilon = 1e-9);
            }
        }
    }

    /// The second printed form of X, with the factor it lacks in print.
    #[test]
    fn corrected_alternative_is_the_same_x() {
        let target = Vector3::new(123.0, -45.0, 60.0);
        let [a, b, c] = phones();
        let ranges = [a, b, c].map(|p| (target - p).norm() + 0.7);
        let fix = known_depth(&phones(), ranges, 60.0).unwrap();
        let eta = |p: Vector3<f64>, s: f64| p.norm_squared() - s * s - 2.0 * p.z * 60.0;
        for (p, q, s, t) in [(a, b, ranges[0], ranges[1]), (b, c, ranges[1], ranges[2])] {
            let x = (eta(p, s) - eta(q, t) - 2.0 * fix.y * (p.y - q.y)) / (2.0 * (p.x - q.x));
            assert_relative_eq!(x, fix.x, epsilon = 1e-9);
        }
    }

    #[test]
    fn collinear_hydrophones_are_refused() {
        let line = [0.0, 1.0, 3.0].map(|t| Vector3::new(100.0 * t, 50.0 * t, 20.0 * t));
        assert!(known_depth(&line, [300.0; 3], 10.0).is_err());
        assert!(two_spheres(&line, [300.0; 3], 0.0).is_err());
        assert!(two_spheres(&[line[0]; 3], [300.0; 3], 0.0).is_err());
        assert!(two_circles(line[0].xy(), line[0].xy(), [3.0; 2], 0.0).is_err());
    }
}
