//! The position of a target from one measurement of a [`RangeArray`], with its covariance and the test of its redundancy.
//!
//! | symbol | name here     | shape | meaning                                              |
//! |--------|---------------|-------|------------------------------------------------------|
//! | L      | `measurement` | m     | ranges or travel times, perhaps the depth; NaN = not heard |
//! | B      | rows          | m×d   | ∂h/∂p of the heard components                        |
//! | R      | std²          | m×m   | their noise, diagonal                                |
//! | E, P_η |               | m×q, q×q | ∂h/∂η of the lasting errors, and their covariance ([`super::nuisance`]) |
//! | Σ      | `weights`     | m×m   | R + E P_η Eᵀ, with the factor that whitens           |
//! | N      | `information` | d×d   | Bᵀ Σ⁻¹ B                                             |
//!
//! Gauss-Newton with Levenberg's damping λ, which is zero as long as the residuals fall:
//! (N + λ I tr N/d) dp = Bᵀ Σ⁻¹ (L − h);  C = N⁻¹;  χ² = (L − h)ᵀ Σ⁻¹ (L − h) with m − d degrees of freedom.
//! h has no lasting error in it: their mean is zero. The measured range stands in E for the distance, so that Σ is constant.
//!
//! It starts from every closed-form position of the widest pair and the widest triple of heard hydrophones, both mirror
//! images included. The solution of least χ² counts. If another fits so nearly as well that the data do not decide
//! (χ² less than [`MIRROR_GAP`] larger), the fix is ambiguous: `side` decides, or it is an error.
//!
//! Reference: paper of Xi, Liu, Tao, Lu; spec labels U10, U10b, U11.

use nalgebra::{DMatrix, DVector, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::RangeArray;
use super::closed_form::{self, COLLINEAR, widest};
use super::heard::{Heard, list, unobservable};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::{eigen_range, symmetrise};
use crate::stats::chi_square;

/// Two solutions whose χ² differ by less than this are both possible: odds below exp(10) = 22 000.
pub const MIRROR_GAP: f64 = 20.0;
/// Least distance of a start from the plane of mirror symmetry, as a share of the range: on it the iteration cannot choose.
const OFF_PLANE: f64 = 0.05;
const MAX_ITERATIONS: usize = 100;
const MAX_DAMPING: f64 = 1e12;
/// The iteration has converged when a full step is shorter than this share of the largest range.
const TOLERANCE: f64 = 1e-11;
/// Two solutions closer than this share of the largest range are one.
const SAME: f64 = 1e-6;
/// Least ratio of the eigenvalues of N: below it the geometry leaves a direction undetermined.
const SINGULAR: f64 = 1e-12;

/// Which of two mirror images the target is: compared by depth, and by y in 2 dimensions or where depth is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// The smaller coordinate: above the hydrophones, depth being positive down.
    Above,
    /// The larger one.
    Below,
}

/// A position from one measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Fix {
    /// The position, length d, and its covariance.
    pub position: Gaussian,
    /// Sum of squared residuals over their variances; chi-square with `dof` degrees of freedom if all is right.
    pub statistic: f64,
    /// Heard components beyond the d that a position needs.
    pub dof: usize,
    /// Probability of a larger statistic; 1 with `dof = 0`, where nothing can contradict.
    pub p_value: f64,
    /// The other position that the measurement allows, where `side` had to decide.
    pub mirror: Option<DVector<f64>>,
}

struct Solution {
    position: DVector<f64>,
    cov: DMatrix<f64>,
    statistic: f64,
}

/// Linearisation at a position.
struct Normal {
    information: DMatrix<f64>,
    right: DVector<f64>,
    statistic: f64,
}

impl RangeArray {
    /// The position fix of one measurement; `side` decides where mirror images fit as well.
    pub fn fix_on(&self, measurement: &DVector<f64>, side: Option<Side>) -> Result<Fix> {
        let heard = self.heard(measurement)?;
        let weights = self.weights(measurement, &heard.observed)?;
        let scale = heard.ranges.iter().copied().fold(1.0, f64::max);
        let mut solutions: Vec<Solution> = Vec::new();
        let mut failure = None;
        for start in self.starts(&heard)? {
            match self.iterate(measurement, &heard.observed, &weights, start, scale) {
                Ok(new) => {
                    let known = |s: &Solution| (&s.position - &new.position).norm() < SAME * scale;
                    if !solutions.iter().any(known) {
                        solutions.push(new);
                    }
                }
                Err(error) => failure = Some(error),
            }
        }
        solutions.sort_by(|a, b| a.statistic.total_cmp(&b.statistic));
        let mut solutions = solutions.into_iter();
        let Some(best) = solutions.next() else {
            return Err(failure.unwrap_or_else(|| unobservable("there is no position to start from".into())));
        };
        let rival = solutions.next().filter(|s| s.statistic - best.statistic < MIRROR_GAP);
        let (chosen, mirror) = match rival {
            None => (best, None),
            Some(rival) => {
                let (chosen, other) = self.choose(best, rival, side, heard.depth.is_some(), scale)?;
                (chosen, Some(other.position))
            }
        };
        let dof = heard.observed.len() - self.dims();
        Ok(Fix {
            statistic: chosen.statistic,
            dof,
            p_value: if dof == 0 {
                1.0
            } else {
                chi_square::survival(chosen.statistic, dof)
            },
            position: Gaussian {
                mean: chosen.position,
                cov: chosen.cov,
            },
            mirror,
        })
    }

    fn choose(
        &self,
        best: Solution,
        rival: Solution,
        side: Option<Side>,
        depth_known: bool,
        scale: f64,
    ) -> Result<(Solution, Solution)> {
        let first = self.takes_first(&best.position, &rival.position, side, depth_known, scale)?;
        Ok(if first { (best, rival) } else { (rival, best) })
    }

    /// Which of two positions that fit equally well to take; an error if nothing says so.
    pub(super) fn takes_first(
        &self,
        first: &DVector<f64>,
        second: &DVector<f64>,
        side: Option<Side>,
        depth_known: bool,
        scale: f64,
    ) -> Result<bool> {
        let axis = if depth_known { 1 } else { self.dims() - 1 };
        let difference = first[axis] - second[axis];
        let both = format!("{} or {}", show(first), show(second));
        let Some(side) = side else {
            return Err(unobservable(format!(
                "the fix is ambiguous, mirror images fit equally well: {both}; choose with side = \"above\" or \"below\""
            )));
        };
        if difference.abs() < SAME * scale {
            return Err(unobservable(format!(
                "the fix is ambiguous, mirror images fit equally well: {both}; side cannot tell them apart"
            )));
        }
        Ok((difference < 0.0) == (side == Side::Above))
    }

    /// The factor of Σ of the observed components.
    fn weights(&self, measurement: &DVector<f64>, observed: &[usize]) -> Result<Cholesky> {
        let count = observed.len();
        let scale_std = self.scale_std();
        let sigma = DMatrix::from_fn(count, count, |a, b| {
            let (i, j) = (observed[a], observed[b]);
            let ranges = i < self.channels() && j < self.channels();
            let common = if ranges {
                scale_std * scale_std * measurement[i] * measurement[j]
            } else {
                0.0
            };
            if a != b {
                return common;
            }
            let own = self.std(i);
            let bias = self.bias_std(i);
            let bias = if bias > 0.0 {
                bias / self.metres_per_unit(i, None)
            } else {
                0.0
            };
            own * own + bias * bias + common
        });
        Cholesky::new(&sigma, "covariance of the ranges")
    }

    /// Closed-form positions to start from.
    pub(super) fn starts(&self, heard: &Heard) -> Result<Vec<DVector<f64>>> {
        let points: Vec<DVector<f64>> = heard.channels.iter().map(|&i| self.hydrophone(i)).collect();
        let name = |slots: &[usize]| list(&slots.iter().map(|&i| heard.channels[i]).collect::<Vec<_>>());
        let all: Vec<usize> = (0..points.len()).collect();
        let s = &heard.ranges;
        if self.dims() == 3 && heard.depth.is_none() {
            let Some((i, j, l)) = widest(&points, COLLINEAR).and_then(|w| Some((w.first, w.second, w.third?))) else {
                let reason = format!("the hydrophones of channels {} are collinear", name(&all));
                return Err(unobservable(reason));
            };
            let triple = [i, j, l].map(|i| Vector3::new(points[i][0], points[i][1], points[i][2]));
            let both = closed_form::two_spheres(&triple, [s[i], s[j], s[l]], OFF_PLANE * s[i].max(s[j]))?;
            return Ok([both.positive, both.negative]
                .map(|p| p.as_slice().to_vec().into())
                .into());
        }
        let depth = heard.depth.unwrap_or(0.0);
        let drop = |i: usize| heard.depth.map_or(0.0, |z| z - points[i][2]);
        let flat: Vec<DVector<f64>> = points.iter().map(|p| p.rows(0, 2).into_owned()).collect();
        let lift = |x: f64, y: f64| {
            let coordinates = [x, y, depth];
            DVector::from_column_slice(&coordinates[..self.dims()])
        };
        let Some(wide) = widest(&flat, COLLINEAR) else {
            let reason = format!(
                "the hydrophones of channels {} stand at one point of the plan",
                name(&all)
            );
            return Err(unobservable(reason));
        };
        let (i, j) = (wide.first, wide.second);
        let plan = |i: usize| (s[i] * s[i] - drop(i) * drop(i)).max(0.0).sqrt();
        let at = |i: usize| Vector2::new(flat[i][0], flat[i][1]);
        let both = closed_form::two_circles(at(i), at(j), [plan(i), plan(j)], OFF_PLANE * s[i].max(s[j]))?;
        let mut starts = vec![
            lift(both.positive.x, both.positive.y),
            lift(both.negative.x, both.negative.y),
        ];
        if let Some(l) = wide.third {
            let triple = [i, j, l].map(|i| Vector3::new(flat[i][0], flat[i][1], depth - drop(i)));
            let p = closed_form::known_depth(&triple, [s[i], s[j], s[l]], depth)?;
            starts.push(lift(p.x, p.y));
        }
        Ok(starts)
    }

    fn normal(
        &self,
        measurement: &DVector<f64>,
        observed: &[usize],
        weights: &Cholesky,
        position: &DVector<f64>,
    ) -> Result<Normal> {
        let d = self.dims();
        let mut rows = DMatrix::zeros(observed.len(), d);
        let mut residual = DVector::zeros(observed.len());
        for (slot, &i) in observed.iter().enumerate() {
            let row = self.row(i, position.as_slice(), &[])?;
            residual[slot] = measurement[i] - row.value;
            for j in 0..d {
                rows[(slot, j)] = row.gradient[j];
            }
        }
        let residual = weights.whiten(&residual);
        for j in 0..d {
            rows.set_column(j, &weights.whiten(&rows.column(j).into_owned()));
        }
        Ok(Normal {
            information: rows.transpose() * &rows,
            right: rows.transpose() * &residual,
            statistic: residual.norm_squared(),
        })
    }

    /// U11 from one start.
    fn iterate(
        &self,
        measurement: &DVector<f64>,
        observed: &[usize],
        weights: &Cholesky,
        start: DVector<f64>,
        scale: f64,
    ) -> Result<Solution> {
        let d = self.dims();
        let mut position = start;
        let mut here = self.normal(measurement, observed, weights, &position)?;
        let mut damping = 0.0_f64;
        let more = |damping: f64| (damping * 10.0).max(1e-3);
        for _ in 0..MAX_ITERATIONS {
            if damping > MAX_DAMPING {
                break;
            }
            let mean_pivot = here.information.trace() / d as f64;
            let damped = &here.information + DMatrix::identity(d, d) * (damping * mean_pivot);
            let Ok(factor) = Cholesky::new(&damped, "information of the fix") else {
                damping = more(damping);
                continue;
            };
            let right = DMatrix::from_column_slice(d, 1, here.right.as_slice());
            let trial = &position + factor.solve(&right).column(0);
            let short = (&trial - &position).norm() <= TOLERANCE * scale;
            match self.normal(measurement, observed, weights, &trial) {
                // A full step as short as this ends it, whatever rounding makes of the statistic.
                Ok(there) if short && damping == 0.0 => return solution(trial, &there),
                Ok(there) if there.statistic <= here.statistic + 1e-9 => {
                    position = trial;
                    here = there;
                    damping = if damping < 1e-3 { 0.0 } else { damping / 10.0 };
                }
                _ => damping = more(damping),
            }
        }
        Err(unobservable(format!(
            "the position fix did not converge in {MAX_ITERATIONS} iterations"
        )))
    }
}

fn solution(position: DVector<f64>, normal: &Normal) -> Result<Solution> {
    let d = position.len();
    let range = eigen_range(&normal.information)?;
    let singular = || unobservable("the geometry leaves a direction of the position undetermined".into());
    if range.min <= SINGULAR * range.max {
        return Err(singular());
    }
    let factor = Cholesky::new(&normal.information, "information of the fix").map_err(|_| singular())?;
    let mut cov = factor.solve(&DMatrix::identity(d, d));
    symmetrise(&mut cov);
    Ok(Solution {
        position,
        cov,
        statistic: normal.statistic,
    })
}

fn show(position: &DVector<f64>) -> String {
    let coordinates: Vec<String> = position.iter().map(|x| format!("{x:.2}")).collect();
    format!("({}) m", coordinates.join(", "))
}
