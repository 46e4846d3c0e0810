//! The pose of a body from one image by a [`CameraSensor`], with its covariance and the test of its redundancy.
//!
//! | symbol | name here     | shape | meaning                                              |
//! |--------|---------------|-------|------------------------------------------------------|
//! | z      | `measurement` | 2k    | image coordinates, pixels; NaN = not seen            |
//! | H      | `gradient`    | m×6   | their derivative by position and attitude            |
//! | N      | `information` | 6×6   | Hᵀ H / σ²                                            |
//!
//! Gauss-Newton on the manifold with Levenberg's damping λ (Marquardt's scaling), zero as long as the residuals fall:
//! (N + λ diag N) δ = Hᵀ (z − h)/σ²,  p ← p + δ_p,  R ← R exp(δ_θ);  C = N⁻¹;  χ² = |z − h|²/σ², m − 6 degrees of freedom.
//!
//! It starts from every closed-form pose ([`super::camera_start`]). The solution of least χ² counts. A plane far away looks
//! nearly the same in two attitudes: if the other fits so nearly as well that the image does not decide (χ² less than
//! [`MIRROR_GAP`] larger), it is reported as the mirror.
//!
//! Reference: Hartley, Zisserman (2004), Multiple view geometry in computer vision, §7.2 and A6.2; N⁻¹ is the Cramér-Rao bound
//! at the solution. The two minima of a plane: Schweighofer, Pinz (2006), IEEE Transactions on Pattern Analysis 28(12).

use nalgebra::{DMatrix, DVector, Vector2, Vector3};

use super::camera::{CameraSensor, Pose, unobservable};
use super::fix::{Fix, MIRROR_GAP};
use super::heard::list;
use super::{Sensor, camera_start};
use crate::error::{Error, Result, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::{eigen_range, symmetrise};
use crate::model::space::StateSpace;
use crate::stats::chi_square;

/// Points that must be seen whole: three have up to four poses, with nothing to choose by.
pub(super) const POINTS: usize = 4;
const MAX_ITERATIONS: usize = 100;
const MAX_DAMPING: f64 = 1e12;
/// The iteration has converged when a full step is shorter than this in standard deviations of the pose…
const TOLERANCE: f64 = 1e-7;
/// …or than this share of the largest image coordinate, where rounding is that large against the noise.
const ROUNDING: f64 = 1e-13;
/// Two solutions closer than this share of the distance and of a radian are one.
const SAME: f64 = 1e-6;
/// Least ratio of the eigenvalues of N, its diagonal scaled to 1: below it the points leave a direction undetermined.
const SINGULAR: f64 = 1e-14;

struct Solution {
    pose: Pose,
    cov: DMatrix<f64>,
    statistic: f64,
}

/// Linearisation at a pose.
struct Normal {
    information: DMatrix<f64>,
    right: DVector<f64>,
    statistic: f64,
}

impl CameraSensor {
    /// The pose that one measurement gives: position and rotation vector, with the covariance of their changes (the attitude's
    /// in body axes).
    pub fn fix(&self, measurement: &DVector<f64>) -> Result<Fix> {
        let observed = self.observed(measurement)?;
        let mut solutions: Vec<Solution> = Vec::new();
        let mut failure = None;
        for start in self.starts(measurement)? {
            match self.iterate(measurement, &observed, start) {
                Ok(new) => {
                    if !solutions.iter().any(|known| same(known, &new)) {
                        solutions.push(new);
                    }
                }
                Err(error) => failure = Some(error),
            }
        }
        solutions.sort_by(|a, b| a.statistic.total_cmp(&b.statistic));
        let mut solutions = solutions.into_iter();
        let Some(best) = solutions.next() else {
            return Err(failure.unwrap_or_else(|| unobservable("there is no pose to start from".into())));
        };
        let mirror = solutions.next().filter(|s| s.statistic - best.statistic < MIRROR_GAP);
        let dof = observed.len() - 6;
        Ok(Fix {
            p_value: chi_square::survival(best.statistic, dof),
            statistic: best.statistic,
            dof,
            position: Gaussian {
                mean: best.pose.coordinates(),
                cov: best.cov,
            },
            mirror: mirror.map(|s| s.pose.coordinates()),
        })
    }

    /// Components that are not NaN.
    fn observed(&self, measurement: &DVector<f64>) -> Result<Vec<usize>> {
        require_size("measurement", self.measurement_dim(), measurement.len())?;
        if let Some(index) = measurement.iter().position(|v| v.is_infinite()) {
            let what = "measurement".into();
            return Err(Error::NonFinite { what, index });
        }
        Ok((0..measurement.len()).filter(|&i| !measurement[i].is_nan()).collect())
    }

    /// Closed-form poses from the points of which both coordinates are seen.
    fn starts(&self, measurement: &DVector<f64>) -> Result<Vec<Pose>> {
        let image = |i: usize| Vector2::new(measurement[2 * i], measurement[2 * i + 1]);
        let whole = whole(measurement.as_slice());
        if whole.len() < POINTS {
            let seen = if whole.is_empty() {
                String::new()
            } else {
                format!(" ({})", list(&whole))
            };
            let reason = format!("a pose fix needs {POINTS} points, {} seen{seen}", whole.len());
            return Err(unobservable(reason));
        }
        let points: Vec<Vector3<f64>> = whole.iter().map(|&i| self.point(i)).collect();
        let rays: Vec<Vector2<f64>> = whole.iter().map(|&i| self.intrinsics().normalised(&image(i))).collect();
        camera_start::poses(&points, &rays)
            .ok_or_else(|| unobservable(format!("the points seen ({}) are collinear", list(&whole))))
    }

    fn normal(&self, measurement: &DVector<f64>, observed: &[usize], pose: &Pose) -> Result<Normal> {
        let mut normal = Normal {
            information: DMatrix::zeros(6, 6),
            right: DVector::zeros(6),
            statistic: 0.0,
        };
        for &component in observed {
            let (i, axis) = (component / 2, component % 2);
            let expected = self.image_of(i, pose)?;
            let residual = (measurement[component] - expected.image[axis]) / self.pixel_std();
            let gradient = expected.gradient.row(axis).transpose() / self.pixel_std();
            normal.information += gradient * gradient.transpose();
            normal.right += gradient * residual;
            normal.statistic += residual * residual;
        }
        Ok(normal)
    }

    fn iterate(&self, measurement: &DVector<f64>, observed: &[usize], start: Pose) -> Result<Solution> {
        let mut pose = start;
        let mut here = self.normal(measurement, observed, &pose)?;
        let mut damping = 0.0_f64;
        let more = |damping: f64| (damping * 10.0).max(1e-3);
        let largest = observed.iter().map(|&i| measurement[i].abs()).fold(0.0, f64::max);
        let tolerance = TOLERANCE.max(ROUNDING * largest / self.pixel_std());
        for _ in 0..MAX_ITERATIONS {
            if damping > MAX_DAMPING {
                break;
            }
            let damped = &here.information + DMatrix::from_diagonal(&(here.information.diagonal() * damping));
            let Ok(factor) = Cholesky::new(&damped, "information of the fix") else {
                damping = more(damping);
                continue;
            };
            let right = DMatrix::from_column_slice(6, 1, here.right.as_slice());
            let step: DVector<f64> = factor.solve(&right).column(0).into_owned();
            let trial = pose.moved(&step);
            let short = step.dot(&here.right) <= tolerance * tolerance;
            match self.normal(measurement, observed, &trial) {
                // A full step as short as this ends it, whatever rounding makes of the statistic.
                Ok(there) if short && damping == 0.0 => return solution(trial, &there),
                Ok(there) if there.statistic <= here.statistic + tolerance * (1.0 + here.statistic.sqrt()) => {
                    pose = trial;
                    here = there;
                    damping = if damping < 1e-3 { 0.0 } else { damping / 10.0 };
                }
                _ => damping = more(damping),
            }
        }
        Err(unobservable(format!(
            "the pose fix did not converge in {MAX_ITERATIONS} iterations"
        )))
    }
}

/// Points of which both coordinates are seen.
pub(super) fn whole(measurement: &[f64]) -> Vec<usize> {
    let seen = measurement.chunks_exact(2).enumerate();
    seen.filter(|(_, image)| image.iter().all(|v| v.is_finite()))
        .map(|(i, _)| i)
        .collect()
}

fn solution(pose: Pose, normal: &Normal) -> Result<Solution> {
    let singular = || unobservable("the points leave a direction of the pose undetermined".into());
    let size = normal.information.diagonal().map(f64::sqrt);
    let scaled = DMatrix::from_fn(6, 6, |i, j| normal.information[(i, j)] / (size[i] * size[j]));
    if !scaled.iter().all(|v| v.is_finite()) || eigen_range(&scaled)?.min <= SINGULAR {
        return Err(singular());
    }
    let factor = Cholesky::new(&scaled, "information of the fix").map_err(|_| singular())?;
    let inverse = factor.solve(&DMatrix::identity(6, 6));
    let mut cov = DMatrix::from_fn(6, 6, |i, j| inverse[(i, j)] / (size[i] * size[j]));
    symmetrise(&mut cov);
    Ok(Solution {
        pose,
        cov,
        statistic: normal.statistic,
    })
}

fn same(a: &Solution, b: &Solution) -> bool {
    let space = StateSpace {
        dim: 6,
        attitude: Some(3),
    };
    let apart = space.difference(&a.pose.coordinates(), &b.pose.coordinates());
    apart.rows(0, 3).norm() < SAME * a.pose.position.norm() && apart.rows(3, 3).norm() < SAME
}
