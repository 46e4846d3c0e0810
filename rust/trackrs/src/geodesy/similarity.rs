//! Seven-parameter similarity between two Cartesian frames, from common points.
//!
//! | symbol     | name here            | shape | meaning                                                     |
//! |------------|----------------------|-------|-------------------------------------------------------------|
//! | pᵢ, p′ᵢ    | `source`, `target`   | 3     | the same point in either frame, metres                      |
//! | wᵢ         | `weights`            |       | 1/variance of p′ᵢ up to a common factor; 1 where none given |
//! | s, R, t    | `scale`, `rotation`, `translation()` | | p′ = t + s R p                                  |
//! | μ, μ′      | `centre`, `image`    | 3     | a point of the source frame and its image, t = μ′ − s R μ   |
//! | vᵢ         | `residuals`          | 3     | p′ᵢ − t − s R pᵢ                                            |
//! | σ₀²        | `variance`           |       | a-posteriori variance of an observation of weight 1         |
//! | δc, λ, ω   |                      | 3,1,3 | errors of μ′, of ln s, and of R: exp(ω×) R                  |
//! | C, Σ       | `centred_cov`, `cov()` | 7×7 | covariance of (δc, λ, ω), and of (δt, λ, ω)                 |
//! | a×         |                      | 3×3   | matrix of the cross product, (a×) b = a × b                 |
//!
//! μ = Σ wᵢ pᵢ / Σ wᵢ,  μ′ likewise,  H = Σ wᵢ (p′ᵢ − μ′)(pᵢ − μ)ᵀ = U D Vᵀ,  S = diag(1, 1, det U det V)
//! R = U S Vᵀ,  s = tr(D S) / Σ wᵢ |pᵢ − μ|²                                                  (Umeyama, (34) to (43))
//! σ₀² = Σ wᵢ |vᵢ|² / (3n − 7)
//! At the solution, with qᵢ = s R (pᵢ − μ):  δp′ᵢ = Aᵢ (δc, λ, ω),  Aᵢ = [I, qᵢ, −qᵢ×]
//! C = σ₀² (Σ wᵢ Aᵢᵀ Aᵢ)⁻¹,  Σ = J C Jᵀ with δt = δc − λ m + m× ω,  m = s R μ
//! A point with covariance P:  p′ = μ′ + q,  P′ = A C Aᵀ + s² R P Rᵀ.
//!
//! First order in the errors; those of the source are not modelled apart, they show in σ₀². Everything is evaluated
//! about the centroid, so that coordinates of Earth's radius lose no digits.
//! References: Umeyama (1991), Least-squares estimation of transformation parameters between two point patterns, IEEE
//! PAMI 13(4), 376-380; Koch (1999), Parameter estimation and hypothesis testing in linear models, §3.2.
//! Deviations: weights, which Umeyama has not.

use nalgebra::{DMatrix, Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector3};

use super::local::turned;
use crate::error::{Error, Result, require_finite, require_positive, require_size};
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::{eigen_range, symmetrise};

/// Covariance of the seven parameters.
pub type Matrix7 = SMatrix<f64, 7, 7>;

/// Points whose second principal extent is below this share of the first lie on a line.
const COLLINEAR: f64 = 1e-6;

/// p′ = t + s R p, and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Similarity {
    /// s.
    pub scale: f64,
    /// R, a proper rotation.
    pub rotation: Matrix3<f64>,
    /// A point of the source frame, usually the centroid of the common points.
    pub centre: Vector3<f64>,
    /// Its image in the target frame.
    pub image: Vector3<f64>,
    /// Covariance of the errors of (image, ln s, small rotation vector); m², 1, rad².
    pub centred_cov: Matrix7,
}

/// A similarity from common points, with the residuals it leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct SimilarityFit {
    /// The similarity.
    pub similarity: Similarity,
    /// Target minus transformed source, one per point, metres.
    pub residuals: Vec<Vector3<f64>>,
    /// A-posteriori variance of an observation of weight 1; m² if there are no weights.
    pub variance: f64,
    /// Redundancy, 3n − 7.
    pub dof: usize,
}

/// A point and its covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct PointEstimate {
    /// Coordinates, metres.
    pub position: Vector3<f64>,
    /// Their covariance, m².
    pub cov: Matrix3<f64>,
}

impl Similarity {
    /// t, metres.
    pub fn translation(&self) -> Vector3<f64> {
        self.apply(&Vector3::zeros())
    }

    /// The rotation vector of R, radians: its axis times its angle, which lies in [0, π].
    pub fn rotation_vector(&self) -> Vector3<f64> {
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation));
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        let vector = Vector3::new(q.i, q.j, q.k) * sign;
        let sine = vector.norm();
        if sine > 0.0 {
            vector * (2.0 * libm::atan2(sine, q.w.abs()) / sine)
        } else {
            vector
        }
    }

    /// Σ, the covariance of (t, ln s, small rotation vector), 7×7.
    pub fn cov(&self) -> Matrix7 {
        let m = -self.arm(&Vector3::zeros());
        let mut j = Matrix7::identity();
        j.fixed_view_mut::<3, 1>(0, 3).copy_from(&-m);
        j.fixed_view_mut::<3, 3>(0, 4).copy_from(&m.cross_matrix());
        let out = j * self.centred_cov * j.transpose();
        (out + out.transpose()) * 0.5
    }

    /// The image of a point.
    pub fn apply(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.image + self.arm(point)
    }

    /// The image of a point with covariance `cov`, the uncertainty of the similarity included.
    pub fn propagate(&self, point: &Vector3<f64>, cov: &Matrix3<f64>) -> PointEstimate {
        let arm = self.arm(point);
        let a = design(&arm, 1.0);
        let own = a * self.centred_cov * a.transpose();
        let turned = turned(&self.rotation, cov) * (self.scale * self.scale);
        PointEstimate {
            position: self.image + arm,
            cov: (own + own.transpose()) * 0.5 + turned,
        }
    }

    /// q = s R (p − μ).
    fn arm(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * (point - self.centre) * self.scale
    }
}

/// The similarity that takes `source` to `target` with the least weighted sum of squared residuals.
///
/// Needs three points or more that do not lie on one line; `weights` are positive, one per point.
pub fn fit(source: &[Vector3<f64>], target: &[Vector3<f64>], weights: Option<&[f64]>) -> Result<SimilarityFit> {
    fit_named(["source", "target"], source, target, weights)
}

/// As [`fit`]; errors call the points by these names.
pub(super) fn fit_named(
    names: [&str; 2],
    source: &[Vector3<f64>],
    target: &[Vector3<f64>],
    weights: Option<&[f64]>,
) -> Result<SimilarityFit> {
    let n = source.len();
    require_size(names[1], n, target.len())?;
    if let Some(weights) = weights {
        require_size("weights", n, weights.len())?;
        for (i, &weight) in weights.iter().enumerate() {
            require_positive(&format!("weights[{i}]"), weight)?;
        }
    }
    let weight = |i: usize| weights.map_or(1.0, |w| w[i]);
    let total: f64 = (0..n).map(weight).sum();
    let source_spread = Spread::new(names[0], source, &weight, total)?;
    let target_spread = Spread::new(names[1], target, &weight, total)?;
    let mut h = Matrix3::zeros();
    for i in 0..n {
        h += (target[i] - target_spread.centre) * (source[i] - source_spread.centre).transpose() * (weight(i) / total);
    }
    let alignment = align(&h, names[1])?;
    let mut similarity = Similarity {
        scale: alignment.trace / source_spread.variance,
        rotation: alignment.rotation,
        centre: source_spread.centre,
        image: target_spread.centre,
        centred_cov: Matrix7::zeros(),
    };
    let residuals: Vec<_> = (0..n).map(|i| target[i] - similarity.apply(&source[i])).collect();
    let dof = 3 * n - 7;
    let sum: f64 = residuals
        .iter()
        .enumerate()
        .map(|(i, v)| weight(i) * v.norm_squared())
        .sum();
    let variance = sum / dof as f64;
    let information: Vec<_> = (0..n).map(|i| Matrix3::identity() * weight(i)).collect();
    similarity.centred_cov = normal_equations(&similarity, source, &information, &residuals)?.cofactor * variance;
    Ok(SimilarityFit {
        similarity,
        residuals,
        variance,
        dof,
    })
}

/// One Gauss-Newton step and the covariance that goes with it.
pub(super) struct Step {
    /// (δc, λ, ω).
    pub(super) correction: SMatrix<f64, 7, 1>,
    /// (Σ Aᵢᵀ Wᵢ Aᵢ)⁻¹.
    pub(super) cofactor: Matrix7,
    /// Size of the correction as a share of the size of the array.
    pub(super) relative: f64,
}

/// Solves Σ Aᵢᵀ Wᵢ Aᵢ x = Σ Aᵢᵀ Wᵢ vᵢ. The columns are scaled by the rms length of qᵢ, or metres and radians would
/// spoil the factorisation.
pub(super) fn normal_equations(
    similarity: &Similarity,
    source: &[Vector3<f64>],
    information: &[Matrix3<f64>],
    residuals: &[Vector3<f64>],
) -> Result<Step> {
    let arms: Vec<_> = source.iter().map(|p| similarity.arm(p)).collect();
    let length = (arms.iter().map(Vector3::norm_squared).sum::<f64>() / arms.len() as f64).sqrt();
    let (mut n, mut g) = (Matrix7::zeros(), SMatrix::<f64, 7, 1>::zeros());
    for ((q, w), v) in arms.iter().zip(information).zip(residuals) {
        let a = design(q, length);
        n += a.transpose() * w * a;
        g += a.transpose() * (w * v);
    }
    let factor = Cholesky::new(
        &DMatrix::from_fn(7, 7, |i, j| n[(i, j)]),
        "normal matrix of the similarity",
    )?;
    let mut inverse = factor.solve(&DMatrix::identity(7, 7));
    symmetrise(&mut inverse);
    let scaled = Matrix7::from_fn(|i, j| inverse[(i, j)]) * g;
    let unit = |i: usize| if i < 3 { 1.0 } else { 1.0 / length };
    Ok(Step {
        correction: SMatrix::from_fn(|i, _| scaled[i] * unit(i)),
        cofactor: Matrix7::from_fn(|i, j| inverse[(i, j)] * unit(i) * unit(j)),
        relative: scaled.norm() / length,
    })
}

/// A = [I, q, −q×], the last four columns divided by `length`.
fn design(q: &Vector3<f64>, length: f64) -> SMatrix<f64, 3, 7> {
    let q = q / length;
    let mut a = SMatrix::<f64, 3, 7>::zeros();
    a.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
    a.fixed_view_mut::<3, 1>(0, 3).copy_from(&q);
    a.fixed_view_mut::<3, 3>(0, 4).copy_from(&-q.cross_matrix());
    a
}

struct Spread {
    centre: Vector3<f64>,
    variance: f64,
}

impl Spread {
    /// Centroid and mean squared distance from it; refuses points that leave a rotation free.
    fn new(name: &str, points: &[Vector3<f64>], weight: &impl Fn(usize) -> f64, total: f64) -> Result<Self> {
        const REQUIREMENT: &str = "must be at least 3 common points that are not on one line";
        require_finite(name, points.iter().flat_map(|p| p.iter()))?;
        if points.len() < 3 {
            return Err(Error::invalid(name, format!("{} points", points.len()), REQUIREMENT));
        }
        let mut centre = Vector3::zeros();
        for (i, p) in points.iter().enumerate() {
            centre += p * (weight(i) / total);
        }
        let mut scatter = Matrix3::zeros();
        for (i, p) in points.iter().enumerate() {
            scatter += (p - centre) * (p - centre).transpose() * (weight(i) / total);
        }
        let variance = scatter.trace();
        let dynamic = DMatrix::from_fn(3, 3, |i, j| scatter[(i, j)]);
        let range = eigen_range(&dynamic)?;
        let middle = variance - range.min - range.max;
        if middle <= COLLINEAR * COLLINEAR * range.max {
            return Err(Error::invalid(
                name,
                format!("{} collinear points", points.len()),
                REQUIREMENT,
            ));
        }
        Ok(Self { centre, variance })
    }
}

struct Alignment {
    rotation: Matrix3<f64>,
    trace: f64,
}

/// The proper rotation R of largest tr(Rᵀ H), and that trace.
fn align(h: &Matrix3<f64>, name: &str) -> Result<Alignment> {
    let view = faer::MatRef::from_column_major_slice(h.as_slice(), 3, 3);
    let svd = view.svd().map_err(|_| Error::NonFinite {
        what: "singular values of the common points".into(),
        index: 0,
    })?;
    let u = Matrix3::from_fn(|i, j| svd.U()[(i, j)]);
    let v = Matrix3::from_fn(|i, j| svd.V()[(i, j)]);
    let d = svd.S().column_vector();
    let sign = if u.determinant() * v.determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    // Where this sum vanishes, other rotations fit as well.
    if d[1] + sign * d[2] <= 1e-14 * d[0] {
        return Err(Error::invalid(
            name,
            "given",
            "must be the image of the other points: these determine no rotation",
        ));
    }
    Ok(Alignment {
        rotation: u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v.transpose(),
        trace: d[0] + d[1] + sign * d[2],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Vec<Vector3<f64>> {
        [
            [0.0, 0.0, 5.0],
            [900.0, 10.0, 0.0],
            [450.0, 800.0, -3.0],
            [300.0, 200.0, 40.0],
        ]
        .map(Vector3::from)
        .to_vec()
    }

    #[test]
    fn too_few_and_collinear_points_are_named() {
        let good = points();
        let line: Vec<_> = (0..4).map(|i| Vector3::new(1.0, 2.0, 3.0) * f64::from(i)).collect();
        let text = |s: &[Vector3<f64>], t: &[Vector3<f64>]| fit(s, t, None).unwrap_err().to_string();
        assert!(text(&good[..2], &good[..2]).starts_with("source = 2 points"));
        assert!(text(&line, &good).starts_with("source = 4 collinear points"));
        assert!(text(&good, &line).starts_with("target = 4 collinear points"));
        assert!(text(&[good[0]; 4], &good).starts_with("source = 4 collinear points"));
        assert!(matches!(
            fit(&good, &good[..3], None),
            Err(Error::DimensionMismatch { .. })
        ));
        let weights = fit(&good, &good, Some(&[1.0, 1.0, 0.0, 1.0])).unwrap_err().to_string();
        assert!(weights.starts_with("weights[2] = 0"));
        let mut bad = points();
        bad[1].y = f64::NAN;
        assert!(matches!(fit(&good, &bad, None), Err(Error::NonFinite { index: 4, .. })));
    }

    #[test]
    fn rotation_vector_is_the_logarithm_up_to_half_a_turn() {
        for angle in [0.0, 1e-9, 0.3, 3.0, std::f64::consts::PI - 1e-9] {
            let vector = Vector3::new(1.0, -2.0, 2.0) / 3.0 * angle;
            let similarity = Similarity {
                scale: 1.0,
                rotation: *Rotation3::from_scaled_axis(vector).matrix(),
                centre: Vector3::zeros(),
                image: Vector3::zeros(),
                centred_cov: Matrix7::zeros(),
            };
            assert!(
                (similarity.rotation_vector() - vector).norm() < 1e-13 * (1.0 + angle),
                "{angle}"
            );
        }
    }

    #[test]
    fn a_planar_array_is_not_mirrored() {
        let source: Vec<_> = points().iter().map(|p| Vector3::new(p.x, p.y, 0.0)).collect();
        let turn = Rotation3::from_euler_angles(2.0, -0.4, 1.0);
        let target: Vec<_> = source
            .iter()
            .map(|p| turn * p * 1.2 + Vector3::new(5.0, 6.0, 7.0))
            .collect();
        let found = fit(&source, &target, None).unwrap();
        assert!((found.similarity.rotation - turn.matrix()).amax() < 1e-12);
        assert!((found.similarity.scale - 1.2).abs() < 1e-12);
    }
}
