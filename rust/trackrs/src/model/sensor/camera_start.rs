//! Poses from image points in closed form, where the iteration of a pose fix starts: scaled orthography, both ways round.
//!
//! | symbol | name here   | shape | meaning                                                                 |
//! |--------|-------------|-------|-------------------------------------------------------------------------|
//! | d, V   | `view`      | 3, 3×3 | mean direction of the rays, and the rotation that takes the z axis to it |
//! | m_i    | `rays`      | 2     | V⁻¹ ray of point i, as x/z, y/z                                         |
//! | E, s   | `axes`      | 3×3, 3 | principal axes of the points about their centroid, and their spreads    |
//! | P̃_i   | `local`     | 3     | Eᵀ (P_i − centroid)                                                     |
//! | A      | `affine`    | 2×3   | m_i ≈ A P̃_i + m̄, by least squares: about the first two rows of R̃, over the depth |
//!
//! R = V R̃ Eᵀ. From points in a plane (z̃ = 0) A has two columns; with γ its largest singular value and B = A/γ,
//! I − Bᵀ B = b bᵀ has rank one, and ±b completes the columns: two attitudes, mirror images in the line of sight.
//! Points out of a plane give A all three columns, and R̃ from the nearest rows of equal length: one attitude. All three are
//! tried; a set of little depth, or one that is seen from near, may need any of them.
//!
//! The position for an attitude is linear: [1, 0, −x_i; 0, 1, −y_i] (R P_i + p) = 0 for every ray (x_i, y_i, 1).
//!
//! Reference: DeMenthon, Davis (1995), International Journal of Computer Vision 15, scaled orthography; both attitudes of a
//! plane: Oberkampf, DeMenthon, Davis (1996), Computer Vision and Image Understanding 63(3), and, with the view turned to the
//! rays, Collins, Bartoli (2014), International Journal of Computer Vision 109, §4.
//! Deviation: an affine fit stands for the homography. It needs three points that are not on one line, where a homography needs
//! four of which no three are; the fix iterates anyway.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

use super::camera::Pose;
use crate::model::rotation::Rotation;

/// Points closer to one line than this share of their spread count as collinear.
const COLLINEAR: f64 = 1e-6;
/// Points closer to one plane than this share of their spread count as planar.
const PLANAR: f64 = 1e-3;

/// Poses in which `points` (body coordinates) are seen about along `rays` (x/z, y/z); None if the points are on one line.
pub(super) fn poses(points: &[Vector3<f64>], rays: &[Vector2<f64>]) -> Option<Vec<Pose>> {
    let count = points.len() as f64;
    let centroid = points.iter().sum::<Vector3<f64>>() / count;
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - centroid) * (p - centroid).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let spread = order.map(|i| eigen.eigenvalues[i].max(0.0).sqrt());
    if spread[1] <= COLLINEAR * spread[0] || spread[1].is_nan() {
        return None;
    }
    let (first, second) = (eigen.eigenvectors.column(order[0]), eigen.eigenvectors.column(order[1]));
    let axes = Matrix3::from_columns(&[first.into(), second.into(), first.cross(&second)]);

    let direction = rays
        .iter()
        .map(|m| Vector3::new(m.x, m.y, 1.0).normalize())
        .sum::<Vector3<f64>>();
    let view = turn_to(&direction.normalize());
    let turned: Vec<Vector2<f64>> = rays
        .iter()
        .map(|m| view.transpose() * Vector3::new(m.x, m.y, 1.0))
        .map(|r| Vector2::new(r.x, r.y) / r.z.max(f64::MIN_POSITIVE))
        .collect();
    let local: Vec<Vector3<f64>> = points.iter().map(|p| axes.transpose() * (p - centroid)).collect();

    let planar = affine(&local, &turned, 2)?;
    let mut attitudes = from_plane(&planar.fixed_columns::<2>(0).into_owned());
    if spread[2] > PLANAR * spread[0] {
        attitudes.extend(affine(&local, &turned, 3).and_then(|a| from_solid(&a)));
    }
    let pose = |r: Matrix3<f64>| {
        let attitude = view * r * axes.transpose();
        Some(Pose {
            position: position(points, rays, &attitude)?,
            attitude: Rotation::from_matrix(&attitude),
        })
    };
    Some(attitudes.into_iter().filter_map(pose).collect())
}

/// The shortest rotation that takes the z axis to `direction`, which has length 1 and z > 0.
fn turn_to(direction: &Vector3<f64>) -> Matrix3<f64> {
    let (x, y, z) = (direction.x, direction.y, direction.z);
    let a = 1.0 / (1.0 + z);
    Matrix3::new(
        1.0 - a * x * x,
        -a * x * y,
        x,
        -a * x * y,
        1.0 - a * y * y,
        y,
        -x,
        -y,
        z,
    )
}

/// A from the first `columns` coordinates of the points, the other column zero.
fn affine(local: &[Vector3<f64>], images: &[Vector2<f64>], columns: usize) -> Option<Matrix2x3<f64>> {
    let mean = images.iter().sum::<Vector2<f64>>() / images.len() as f64;
    let mut normal = Matrix3::identity();
    normal.view_mut((0, 0), (columns, columns)).fill(0.0);
    let mut right = Matrix2x3::zeros();
    for (p, m) in local.iter().zip(images) {
        let mut used = *p;
        used.rows_mut(columns, 3 - columns).fill(0.0);
        normal += used * used.transpose();
        right += (m - mean) * used.transpose();
    }
    Some(right * normal.try_inverse()?)
}

/// The two attitudes of a plane seen as A.
fn from_plane(a: &Matrix2<f64>) -> Vec<Matrix3<f64>> {
    let scale = a.singular_values().max();
    if scale <= 0.0 || scale.is_nan() {
        return Vec::new();
    }
    let b = a / scale;
    let rest = Matrix2::identity() - b.transpose() * b;
    let size = [rest[(0, 0)].max(0.0).sqrt(), rest[(1, 1)].max(0.0).sqrt()];
    let third = Vector2::new(size[0], if rest[(0, 1)] < 0.0 { -size[1] } else { size[1] });
    [third, -third]
        .into_iter()
        .map(|row| {
            let first = Vector3::new(b[(0, 0)], b[(1, 0)], row.x).normalize();
            let second = Vector3::new(b[(0, 1)], b[(1, 1)], row.y);
            let second = (second - first * first.dot(&second)).normalize();
            Matrix3::from_columns(&[first, second, first.cross(&second)])
        })
        .collect()
}

/// The attitude of points out of a plane seen as A.
fn from_solid(a: &Matrix2x3<f64>) -> Option<Matrix3<f64>> {
    let svd = a.svd(true, true);
    let rows = svd.u? * svd.v_t?;
    let (first, second) = (rows.row(0).transpose(), rows.row(1).transpose());
    let third = first.cross(&second);
    Some(Matrix3::from_rows(&[
        first.transpose(),
        second.transpose(),
        third.transpose(),
    ]))
}

/// p for a given R, by least squares.
fn position(points: &[Vector3<f64>], rays: &[Vector2<f64>], attitude: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (p, m) in points.iter().zip(rays) {
        let across = Matrix2x3::new(1.0, 0.0, -m.x, 0.0, 1.0, -m.y);
        let product = across.transpose() * across;
        normal += product;
        right -= product * (attitude * p);
    }
    let solved = normal.try_inverse()? * right;
    // The sign of the whole is free in the equations: the body stands before the camera.
    Some(if solved.z < 0.0 { -solved } else { solved })
}
