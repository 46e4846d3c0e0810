//! A camera that sees known points of a body: their image coordinates are the measurement.
//!
//! | symbol    | name here    | shape | meaning                                                        |
//! |-----------|--------------|-------|----------------------------------------------------------------|
//! | P_i       | `points`     | k×3   | points on the body, body coordinates, metres                   |
//! | p, R      | [`Pose`]     |       | position and attitude of the body in the camera frame: the state |
//! | X, Y, Z   | `seen`       | 3     | R P_i + p: camera coordinates, Z along the optical axis        |
//! | f, c      | [`Intrinsics`] | 2, 2 | focal lengths and principal point, pixels                     |
//! | σ         | `pixel_std`  |       | standard deviation of an image coordinate, pixels              |
//!
//! u_i = f_u X/Z + c_u,  v_i = f_v Y/Z + c_v;  R = diag(σ²), NaN = not seen
//! ∂(u, v)/∂(X, Y, Z) = [f_u/Z, 0, −f_u X/Z²; 0, f_v/Z, −f_v Y/Z²],  ∂(X, Y, Z)/∂(p, δ) = [I, −R P_i^], P_i^ u = P_i × u
//!
//! δ is the change of the attitude in body axes ([`StateSpace`]). Lens distortion must have been taken out.
//! A point with Z ≤ 0 has no image: an error that names it.
//! Reference: Hartley, Zisserman (2004), Multiple view geometry in computer vision, §6.1.
//!
//! [`StateSpace`]: crate::model::StateSpace

use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::pose::require_attitude;
use super::{Motion, PositionFix, Sensor};
use crate::error::{Error, Result, require_finite, require_positive, require_size, require_std};
use crate::model::rotation::{Rotation, cross_matrix};
use crate::model::space::block;

/// Focal lengths and principal point, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    focal: [f64; 2],
    centre: [f64; 2],
}

impl Intrinsics {
    /// Focal lengths (positive) and principal point along u and v.
    pub fn new(focal: [f64; 2], centre: [f64; 2]) -> Result<Self> {
        focal
            .iter()
            .try_for_each(|&f| require_positive("focal length of intrinsics", f))?;
        require_finite("intrinsics", &centre)?;
        Ok(Self { focal, centre })
    }

    /// Those of a camera matrix [f_u 0 c_u; 0 f_v c_v; 0 0 1].
    pub fn from_matrix(k: &Matrix3<f64>) -> Result<Self> {
        let zeros = [k[(0, 1)], k[(1, 0)], k[(2, 0)], k[(2, 1)]];
        if zeros.iter().any(|&v| v != 0.0) || k[(2, 2)] != 1.0 {
            let requirement = "must be [fu 0 cu; 0 fv cv; 0 0 1], without skew";
            return Err(Error::invalid("intrinsics", "given", requirement));
        }
        Self::new([k[(0, 0)], k[(1, 1)]], [k[(0, 2)], k[(1, 2)]])
    }

    /// Image coordinates as X/Z, Y/Z.
    pub(super) fn normalised(&self, image: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(
            (image.x - self.centre[0]) / self.focal[0],
            (image.y - self.centre[1]) / self.focal[1],
        )
    }
}

/// Position and attitude of the body in the camera frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pose {
    pub(super) position: Vector3<f64>,
    pub(super) attitude: Rotation,
}

impl Pose {
    /// Moved by a step of position (metres) and of attitude (radians, body axes).
    pub(super) fn moved(&self, step: &DVector<f64>) -> Self {
        Self {
            position: self.position + block(step, 0),
            attitude: self.attitude * Rotation::from_vector(&block(step, 3)),
        }
    }

    /// Position and rotation vector.
    pub(super) fn coordinates(&self) -> DVector<f64> {
        let turn = self.attitude.vector();
        DVector::from_iterator(6, self.position.iter().chain(turn.iter()).copied())
    }
}

/// Expected image of a point, and its derivative by position and attitude.
pub(super) struct ImagePoint {
    pub(super) image: Vector2<f64>,
    pub(super) gradient: SMatrix<f64, 2, 6>,
}

/// A calibrated camera that sees known points of one body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraSensor {
    #[serde(with = "crate::linalg::saved::matrix")]
    points: DMatrix<f64>,
    intrinsics: Intrinsics,
    pixel_std: f64,
}

impl CameraSensor {
    /// A camera that sees `points` (k×3, metres, body coordinates) with `pixel_std` pixels on each image coordinate.
    pub fn new(points: DMatrix<f64>, intrinsics: Intrinsics, pixel_std: f64) -> Result<Self> {
        require_size("dimensions of points", 3, points.ncols())?;
        if points.nrows() == 0 {
            return Err(Error::invalid("points", "an empty array", "must have at least one"));
        }
        require_finite("points", points.transpose().iter())?;
        require_std("pixel_std", pixel_std)?;
        Ok(Self {
            points,
            intrinsics,
            pixel_std,
        })
    }

    /// Number k of points.
    pub fn count(&self) -> usize {
        self.points.nrows()
    }

    /// The camera's intrinsics.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// σ, pixels.
    pub fn pixel_std(&self) -> f64 {
        self.pixel_std
    }

    /// Point i of the body.
    pub(super) fn point(&self, i: usize) -> Vector3<f64> {
        Vector3::new(self.points[(i, 0)], self.points[(i, 1)], self.points[(i, 2)])
    }

    /// Where point i of a body in this pose is seen.
    pub(super) fn image_of(&self, i: usize, pose: &Pose) -> Result<ImagePoint> {
        let point = self.point(i);
        let matrix = pose.attitude.matrix();
        let seen = matrix * point + pose.position;
        let depth = seen.z;
        if depth <= 0.0 || depth.is_nan() {
            return Err(unobservable(format!("point {i} lies behind the camera, z = {depth} m")));
        }
        let ([fu, fv], [cu, cv]) = (self.intrinsics.focal, self.intrinsics.centre);
        let (x, y) = (seen.x / depth, seen.y / depth);
        let (a, b) = (fu / depth, fv / depth);
        let by_seen = Matrix2x3::new(a, 0.0, -a * x, 0.0, b, -b * y);
        let mut gradient = SMatrix::<f64, 2, 6>::zeros();
        gradient.fixed_columns_mut::<3>(0).copy_from(&by_seen);
        let by_turn = -(by_seen * matrix * cross_matrix(&point));
        gradient.fixed_columns_mut::<3>(3).copy_from(&by_turn);
        Ok(ImagePoint {
            image: Vector2::new(fu * x + cu, fv * y + cv),
            gradient,
        })
    }
}

fn pose_of(state: &DVector<f64>) -> Result<Pose> {
    if state.len() < 6 {
        return Err(Error::dimension("state", 6, state.len()));
    }
    Ok(Pose {
        position: block(state, 0),
        attitude: Rotation::from_vector(&block(state, 3)),
    })
}

impl Sensor for CameraSensor {
    fn measurement_dim(&self) -> usize {
        2 * self.count()
    }
    fn labels(&self) -> Vec<String> {
        (0..self.count())
            .flat_map(|i| [format!("u{i}"), format!("v{i}")])
            .collect()
    }
    fn check(&self, motion: &dyn Motion) -> Result<()> {
        require_size("position of the motion model", 6, motion.position_dims())?;
        require_attitude(self, motion)
    }
    fn observe(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        let pose = pose_of(state)?;
        let mut out = DVector::zeros(self.measurement_dim());
        for i in 0..self.count() {
            out.fixed_rows_mut::<2>(2 * i)
                .copy_from(&self.image_of(i, &pose)?.image);
        }
        Ok(out)
    }
    fn jacobian(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        let pose = pose_of(state)?;
        let mut out = DMatrix::zeros(self.measurement_dim(), state.len());
        for i in 0..self.count() {
            let gradient = self.image_of(i, &pose)?.gradient;
            out.fixed_view_mut::<2, 6>(2 * i, 0).copy_from(&gradient);
        }
        Ok(out)
    }
    fn noise(&self) -> DMatrix<f64> {
        let m = self.measurement_dim();
        DMatrix::from_diagonal_element(m, m, self.pixel_std * self.pixel_std)
    }
    fn attitude(&self) -> Option<usize> {
        Some(3)
    }
    fn position_fix(&self) -> Option<&dyn PositionFix> {
        Some(self)
    }
}

pub(super) fn unobservable(reason: String) -> Error {
    Error::Unobservable {
        sensor: "CameraSensor".into(),
        reason,
    }
}
