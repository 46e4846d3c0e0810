//! Rotations: unit quaternions, rotation vectors, matrices and the three angles, and the Jacobians between them.
//!
//! | symbol  | name here       | meaning                                                                     |
//! |---------|-----------------|-----------------------------------------------------------------------------|
//! | q       | [`Rotation`]    | unit quaternion w + x i + y j + z k (Hamilton): takes body to frame coordinates |
//! | v, θ    | `vector`        | rotation vector, axis times angle θ = |v|, radians                          |
//! | v^    | `cross_matrix`  | v^ u = v × u                                                              |
//! | J_r     | `right_jacobian` | exp(v + dv) = exp(v) exp(J_r dv)                                           |
//!
//! exp v = (cos θ/2, v sin(θ/2)/θ);  log q = 2 atan2(|q⃗|, w) q⃗/|q⃗| for w ≥ 0, else that of −q: |log q| ≤ π
//! R = I + 2w q⃗^ + 2 (q⃗^)²
//! J_r = I − (1 − cos θ)/θ² v^ + (θ − sin θ)/θ³ (v^)²
//! J_r⁻¹ = I + ½ v^ + (1 − (θ/2) cot(θ/2))/θ² (v^)²
//! angles (α, β, γ): R = R_z(γ) R_y(β) R_x(α), |β| ≤ π/2
//!
//! Where a formula loses its digits, near θ = 0, its series takes over. At θ = π two vectors name one rotation; of these
//! the log takes the one whose first component that is not zero is positive.
//!
//! Reference: Solà, Deray, Atchuthan (2018), A micro Lie theory for state estimation in robotics, eqs. (132)–(145);
//! quaternion of a matrix: Shepperd (1978), Journal of Guidance and Control 1(3).

use std::ops::Mul;

use nalgebra::{Matrix3, Vector3};

use crate::error::{Error, Result, require_finite};

/// A recorded quaternion must have norm 1 within this: two printed decimals are enough for it, a mistake in the order of
/// the columns or in their meaning seldom is. It is then normalised.
pub const NORM_TOLERANCE: f64 = 0.01;

/// A rotation from body to frame coordinates, held as a unit quaternion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    w: f64,
    xyz: Vector3<f64>,
}

impl Rotation {
    /// No rotation.
    pub fn identity() -> Self {
        Self {
            w: 1.0,
            xyz: Vector3::zeros(),
        }
    }

    /// The rotation of a quaternion w, x, y, z of norm 1 within [`NORM_TOLERANCE`]; `what` names it in the error.
    pub fn from_quaternion(quaternion: [f64; 4], what: &str) -> Result<Self> {
        require_finite(what, &quaternion)?;
        let [w, x, y, z] = quaternion;
        let norm = quaternion.iter().map(|c| c * c).sum::<f64>().sqrt();
        if (norm - 1.0).abs() > NORM_TOLERANCE {
            let value = format!("({w}, {x}, {y}, {z}) with norm {norm}");
            let requirement = format!("must have norm 1 within {NORM_TOLERANCE}");
            return Err(Error::invalid(what, value, &requirement));
        }
        Ok(Self {
            w: w / norm,
            xyz: Vector3::new(x, y, z) / norm,
        })
    }

    /// exp: the rotation of a rotation vector of any length.
    pub fn from_vector(vector: &Vector3<f64>) -> Self {
        let square = vector.norm_squared();
        let angle = square.sqrt();
        let share = if square < 1e-8 {
            0.5 - square / 48.0
        } else {
            libm::sin(0.5 * angle) / angle
        };
        Self {
            w: libm::cos(0.5 * angle),
            xyz: vector * share,
        }
    }

    /// The rotation R_z(γ) R_y(β) R_x(α).
    pub fn from_angles([alpha, beta, gamma]: [f64; 3]) -> Self {
        Self::from_vector(&(Vector3::z() * gamma))
            * Self::from_vector(&(Vector3::y() * beta))
            * Self::from_vector(&(Vector3::x() * alpha))
    }

    /// The rotation of an orthonormal matrix of determinant 1.
    pub fn from_matrix(r: &Matrix3<f64>) -> Self {
        let trace = r.trace();
        // The largest of the four components is computed first: the others divide by it.
        let sizes = [trace, r[(0, 0)], r[(1, 1)], r[(2, 2)]];
        let largest = (0..4).fold(0, |best, i| if sizes[i] > sizes[best] { i } else { best });
        let (w, xyz) = if largest == 0 {
            let w = 0.5 * (1.0 + trace).max(0.0).sqrt();
            let odd = Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]);
            (w, odd / (4.0 * w))
        } else {
            let i = largest - 1;
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let own = 0.5 * (1.0 + 2.0 * r[(i, i)] - trace).max(0.0).sqrt();
            let mut xyz = Vector3::zeros();
            xyz[i] = own;
            xyz[j] = (r[(i, j)] + r[(j, i)]) / (4.0 * own);
            xyz[k] = (r[(i, k)] + r[(k, i)]) / (4.0 * own);
            ((r[(k, j)] - r[(j, k)]) / (4.0 * own), xyz)
        };
        Self { w, xyz }.renormalised()
    }

    /// w, x, y, z with w ≥ 0: of q and −q, which are one rotation, always the same.
    pub fn quaternion(&self) -> [f64; 4] {
        let first = [self.w, self.xyz.x, self.xyz.y, self.xyz.z]
            .into_iter()
            .find(|c| *c != 0.0);
        let sign = if first.is_some_and(|c| c < 0.0) { -1.0 } else { 1.0 };
        [sign * self.w, sign * self.xyz.x, sign * self.xyz.y, sign * self.xyz.z]
    }

    /// log: the rotation vector, of length at most π.
    pub fn vector(&self) -> Vector3<f64> {
        let [w, x, y, z] = self.quaternion();
        let xyz = Vector3::new(x, y, z);
        let sine = xyz.norm();
        if sine < 1e-4 {
            let ratio = sine / w;
            return xyz * (2.0 / w * (1.0 - ratio * ratio / 3.0));
        }
        xyz * (2.0 * libm::atan2(sine, w) / sine)
    }

    /// α, β, γ of R_z(γ) R_y(β) R_x(α); at |β| = π/2, where only γ ∓ α counts, α is zero.
    pub fn angles(&self) -> [f64; 3] {
        let r = self.matrix();
        let level = libm::hypot(r[(0, 0)], r[(1, 0)]);
        let beta = libm::atan2(-r[(2, 0)], level);
        if level < 1e-12 {
            return [0.0, beta, libm::atan2(-r[(0, 1)], r[(1, 1)])];
        }
        [
            libm::atan2(r[(2, 1)], r[(2, 2)]),
            beta,
            libm::atan2(r[(1, 0)], r[(0, 0)]),
        ]
    }

    /// R, which takes body to frame coordinates.
    pub fn matrix(&self) -> Matrix3<f64> {
        let cross = cross_matrix(&self.xyz);
        Matrix3::identity() + cross * (2.0 * self.w) + cross * cross * 2.0
    }

    /// The rotation back.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self {
            w: self.w,
            xyz: -self.xyz,
        }
    }

    /// A body vector in frame coordinates.
    pub fn rotate(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        let twist = self.xyz.cross(vector) * 2.0;
        vector + twist * self.w + self.xyz.cross(&twist)
    }

    fn renormalised(self) -> Self {
        let norm = (self.w * self.w + self.xyz.norm_squared()).sqrt();
        Self {
            w: self.w / norm,
            xyz: self.xyz / norm,
        }
    }
}

/// First the right rotation, then the left. The product is normalised, so that rounding does not add up over a run.
impl Mul for Rotation {
    type Output = Self;

    fn mul(self, right: Self) -> Self {
        Self {
            w: self.w * right.w - self.xyz.dot(&right.xyz),
            xyz: right.xyz * self.w + self.xyz * right.w + self.xyz.cross(&right.xyz),
        }
        .renormalised()
    }
}

/// v^.
pub fn cross_matrix(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// J_r(v): exp(v + dv) = exp(v) exp(J_r dv) to first order.
pub fn right_jacobian(v: &Vector3<f64>) -> Matrix3<f64> {
    let square = v.norm_squared();
    let angle = square.sqrt();
    let half = 0.5 * angle;
    let first = if square < 1e-8 {
        0.5 - square / 24.0
    } else {
        let sine = libm::sin(half) / angle;
        2.0 * sine * sine
    };
    let second = if square < 1.0 {
        // Σ (−θ²)^k / (2k + 3)!
        let mut term = 1.0 / 6.0;
        let mut sum = term;
        for k in 1..10 {
            term *= -square / f64::from((2 * k + 2) * (2 * k + 3));
            sum += term;
        }
        sum
    } else {
        (angle - libm::sin(angle)) / (square * angle)
    };
    let cross = cross_matrix(v);
    Matrix3::identity() - cross * first + cross * cross * second
}

/// J_r⁻¹(v), for |v| < 2π.
pub fn right_jacobian_inverse(v: &Vector3<f64>) -> Matrix3<f64> {
    let square = v.norm_squared();
    let half = 0.5 * square.sqrt();
    let second = if square < 0.25 {
        // Bernoulli numbers: Σ |B_2k| θ^(2k−2) / (2k)!
        let coefficients = [
            1.0 / 12.0,
            1.0 / 720.0,
            1.0 / 30240.0,
            1.0 / 1_209_600.0,
            1.0 / 47_900_160.0,
            691.0 / 1_307_674_368_000.0,
        ];
        coefficients.iter().rev().fold(0.0, |sum, c| sum * square + c)
    } else {
        (1.0 - half * libm::cos(half) / libm::sin(half)) / square
    };
    let cross = cross_matrix(v);
    Matrix3::identity() + cross * 0.5 + cross * cross * second
}

/// The rotation vector of a recorded quaternion; NaN, not observed, if one of its numbers is.
pub fn reported_vector(quaternion: [f64; 4], what: &str) -> Result<Vector3<f64>> {
    let infinite = quaternion.iter().any(|c| c.is_infinite());
    if !infinite && quaternion.iter().any(|c| c.is_nan()) {
        return Ok(Vector3::repeat(f64::NAN));
    }
    Ok(Rotation::from_quaternion(quaternion, what)?.vector())
}

/// log(exp(a)⁻¹ exp(b)): the rotation from `a` to `b` in body coordinates, at most a half turn.
pub fn vector_between(a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
    (Rotation::from_vector(a).inverse() * Rotation::from_vector(b)).vector()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn vectors(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
        (-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64, -8.0..0.0_f64).prop_map(move |(x, y, z, e)| {
            let v = Vector3::new(x, y, z + 1e-3);
            v * (limit * libm::pow(10.0, e) / v.norm())
        })
    }

    /// e^A by its series, the definition that the closed forms are compared with.
    fn series(a: &Matrix3<f64>) -> Matrix3<f64> {
        let (mut term, mut sum) = (Matrix3::identity(), Matrix3::identity());
        for k in 1..60 {
            term = term * a / f64::from(k);
            sum += term;
        }
        sum
    }

    proptest! {
        #[test]
        fn the_matrix_is_the_exponential(v in vectors(PI)) {
            let r = Rotation::from_vector(&v).matrix();
            assert_relative_eq!(r, series(&cross_matrix(&v)), epsilon = 1e-13);
            assert_relative_eq!(Rotation::from_matrix(&r).vector(), v, epsilon = 1e-14, max_relative = 1e-9);
        }

        #[test]
        fn log_undoes_exp_at_every_scale(v in vectors(PI * (1.0 - 1e-9))) {
            assert_relative_eq!(Rotation::from_vector(&v).vector(), v, epsilon = 1e-300, max_relative = 1e-14);
            let back = Rotation::from_vector(&(v * (1.0 - 2.0 * PI / v.norm())));
            assert_relative_eq!(back.vector(), v, epsilon = 1e-14, max_relative = 1e-6);
        }

        #[test]
        fn products_are_products_of_matrices(a in vectors(PI), b in vectors(PI), u in vectors(5.0)) {
            let (p, q) = (Rotation::from_vector(&a), Rotation::from_vector(&b));
            assert_relative_eq!((p * q).matrix(), p.matrix() * q.matrix(), epsilon = 1e-14);
            assert_relative_eq!(p.rotate(&u), p.matrix() * u, epsilon = 1e-14);
            assert_relative_eq!((p * p.inverse()).vector(), Vector3::zeros(), epsilon = 1e-15);
            let back = Rotation::from_angles(p.angles());
            assert_relative_eq!(back.matrix(), p.matrix(), epsilon = 1e-12);
            let flipped = p.quaternion().map(|c| -c);
            prop_assert_eq!(Rotation::from_quaternion(flipped, "q").unwrap().quaternion(),
                            Rotation::from_quaternion(p.quaternion(), "q").unwrap().quaternion());
        }

        #[test]
        fn the_right_jacobian_is_the_integral_and_its_inverse_the_inverse(v in vectors(PI)) {
            // J_r = ∫₀¹ exp(−s v^) ds, term by term.
            let a = -cross_matrix(&v);
            let (mut term, mut sum) = (Matrix3::identity(), Matrix3::identity());
            for k in 1..60 {
                term = term * a / f64::from(k + 1);
                sum += term;
            }
            assert_relative_eq!(right_jacobian(&v), sum, epsilon = 1e-14);
            assert_relative_eq!(right_jacobian_inverse(&v) * sum, Matrix3::identity(), epsilon = 1e-13);
        }

        #[test]
        fn the_right_jacobian_is_the_derivative(v in vectors(3.0), d in vectors(1.0)) {
            let step = d / d.norm() * 1e-5;
            let change = (vector_between(&v, &(v + step)) - vector_between(&v, &(v - step))) / 2.0;
            assert_relative_eq!(change, right_jacobian(&v) * step, epsilon = 1e-14);
        }
    }

    #[test]
    fn series_join_the_formulas() {
        for angle in [1e-4, 0.5, 1.0] {
            let axis = Vector3::new(2.0, -1.0, 2.0) / 3.0;
            let (below, above) = (axis * (angle * (1.0 - 1e-12)), axis * (angle * (1.0 + 1e-12)));
            assert_relative_eq!(right_jacobian(&below), right_jacobian(&above), epsilon = 4e-12 * angle);
            assert_relative_eq!(
                right_jacobian_inverse(&below),
                right_jacobian_inverse(&above),
                epsilon = 4e-12 * angle
            );
        }
    }

    #[test]
    fn half_turns_and_gimbal_lock() {
        let half = Rotation::from_vector(&(Vector3::new(-1.0, 2.0, -2.0) * (PI / 3.0)));
        assert_relative_eq!(half.vector().norm(), PI, epsilon = 1e-15);
        let exact = Rotation::from_quaternion([0.0, -1.0, 0.0, 0.0], "q").unwrap();
        assert_relative_eq!(exact.vector(), Vector3::x() * PI, epsilon = 1e-15);
        for beta in [FRAC_PI_2, -FRAC_PI_2] {
            let lock = Rotation::from_angles([0.3, beta, 0.8]);
            assert_relative_eq!(
                Rotation::from_angles(lock.angles()).matrix(),
                lock.matrix(),
                epsilon = 1e-7
            );
        }
        let given = [0.4, -1.1, 2.5];
        for (angle, expected) in Rotation::from_angles(given).angles().into_iter().zip(given) {
            assert_relative_eq!(angle, expected, epsilon = 1e-14);
        }
    }

    #[test]
    fn quaternions_that_are_none_are_refused_by_name() {
        let rounded = Rotation::from_quaternion([0.707, 0.0, 0.708, 0.0], "q").unwrap();
        assert_relative_eq!(rounded.vector(), Vector3::y() * 1.572_21, epsilon = 1e-4);
        for bad in [[0.0; 4], [1.1, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.0]] {
            let error = Rotation::from_quaternion(bad, "quaternion of row 3").unwrap_err();
            assert!(error.to_string().starts_with("quaternion of row 3 = ("), "{error}");
        }
        let inf = Rotation::from_quaternion([1.0, f64::INFINITY, 0.0, 0.0], "q").unwrap_err();
        assert!(matches!(inf, Error::NonFinite { index: 1, .. }));
    }
}
