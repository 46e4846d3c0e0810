//! Covariance intersection: one estimate from several whose errors are correlated in an unknown way.
//!
//! | symbol   | name here     | shape  | meaning                                                        |
//! |----------|---------------|--------|----------------------------------------------------------------|
//! | x_i, P_i | `estimates`   | n, n×n | estimates of one state, each with an honest covariance         |
//! | w_i      | `weights`     | N      | w_i ≥ 0, Σ w_i = 1                                             |
//! | Y_i      | `information` | n×n    | P_i⁻¹                                                          |
//! | J(w)     |               |        | tr P (default) or ln det P, convex in w                        |
//! | s_i      | `slopes`      | N      | −∂J/∂w_i: tr(P Y_i P), or tr(P Y_i)                            |
//!
//! P⁻¹ = Σ w_i Y_i,  x = P Σ w_i Y_i x_i. For any weights P is at least the covariance of x's error, whatever the correlation
//! between the estimates; the weights that minimise J are used.
//!
//! Least J: w is optimal when s_i is the same for all w_i > 0 and not larger for any other (Kuhn-Tucker). From equal weights,
//! weight moves from the used estimate of least s to the one of largest s until that holds: the pairwise exchange, for two
//! estimates a single step. Along one such move, with M = Σ w Y = L Lᵀ and L⁻¹ (Y_to − Y_from) L⁻ᵀ = V Λ Vᵀ,
//! J'(t) = −Σ_k c_k λ_k/(1 + t λ_k)², c_k = |column k of L⁻ᵀ V|², or −Σ_k λ_k/(1 + t λ_k): increasing in t, so that its zero is
//! bracketed by [0, w_from] and found by halving.
//!
//! Fusion by P⁻¹ = Σ P_i⁻¹ would be right for independent errors only; tracks of one target share its motion noise.
//! Reference: Julier, Uhlmann (1997), A non-divergent estimation algorithm in the presence of unknown correlations;
//! Lacoste-Julien, Jaggi (2015) for the exchange; spec label U29.

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result, require_finite, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::{symmetric_eigen, symmetrise};

/// The exchange ends when the slopes of the used estimates agree to this share of the largest.
const AGREE: f64 = 1e-12;
/// Moves of weight smaller than this are rounding.
const SMALLEST_MOVE: f64 = 1e-15;
/// A bound that is not met in practice; weights short of the best would still be consistent.
const MAX_MOVES: usize = 10_000;
/// Halvings of [0, 1] down to the spacing of the numbers there.
const HALVINGS: usize = 60;

/// What the weights make small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Criterion {
    /// tr P, the mean squared error of the state. Its components should be in comparable units.
    #[default]
    Trace,
    /// det P, the volume of the ellipsoid; the same weights in any units.
    Determinant,
}

/// Several estimates as one.
#[derive(Debug, Clone, PartialEq)]
pub struct Intersection {
    /// The fused estimate.
    pub state: Gaussian,
    /// Share of each estimate in the information, at least 0, together 1.
    pub weights: DVector<f64>,
}

/// One estimate from several of the same state at the same time. `weights`, where given, are used as they are.
pub fn covariance_intersection(
    estimates: &[Gaussian],
    weights: Option<&DVector<f64>>,
    criterion: Criterion,
) -> Result<Intersection> {
    let Some(first) = estimates.first() else {
        return Err(Error::invalid("states", "an empty list", "must have at least one"));
    };
    let n = first.dim();
    let mut information = Vec::with_capacity(estimates.len());
    for (index, estimate) in estimates.iter().enumerate() {
        require_size(&format!("state {index}"), n, estimate.dim())?;
        let factor = Cholesky::new(&estimate.cov, &format!("covariance of state {index}"))?;
        information.push(inverse_of(&factor));
    }
    let weights = match weights {
        Some(given) => checked(given, estimates.len())?,
        None => best_weights(&information, criterion)?,
    };
    let mut used = (0..estimates.len()).filter(|&i| weights[i] > 0.0);
    if let (Some(only), None) = (used.next(), used.next()) {
        let state = estimates[only].clone();
        return Ok(Intersection { state, weights });
    }
    let factor = Cholesky::new(&mixture(&information, &weights), "fused information")?;
    let mut right = DVector::zeros(n);
    for ((estimate, y), &w) in estimates.iter().zip(&information).zip(&weights) {
        // Relative to the first: the difference keeps its digits where the states are far from the origin.
        right += y * (&estimate.mean - &first.mean) * w;
    }
    let right = DMatrix::from_column_slice(n, 1, right.as_slice());
    let state = Gaussian {
        mean: &first.mean + factor.solve(&right).column(0),
        cov: inverse_of(&factor),
    };
    state.require_finite("fused state")?;
    Ok(Intersection { state, weights })
}

fn checked(weights: &DVector<f64>, count: usize) -> Result<DVector<f64>> {
    require_size("weights", count, weights.len())?;
    require_finite("weights", weights.iter())?;
    if let Some(&negative) = weights.iter().find(|&&w| w < 0.0) {
        return Err(Error::invalid("weights", negative, "must not be negative"));
    }
    let sum = weights.sum();
    if (sum - 1.0).abs() > 1e-9 {
        let value = format!("given with sum {sum}");
        return Err(Error::invalid("weights", value, "must have sum 1"));
    }
    Ok(weights / sum)
}

/// A⁻¹ of a factorised A, symmetric bit for bit.
fn inverse_of(factor: &Cholesky) -> DMatrix<f64> {
    let n = factor.lower().nrows();
    let mut inverse = factor.solve(&DMatrix::identity(n, n));
    symmetrise(&mut inverse);
    inverse
}

/// Σ w_i Y_i.
fn mixture(information: &[DMatrix<f64>], weights: &DVector<f64>) -> DMatrix<f64> {
    let n = information[0].nrows();
    let mut sum = DMatrix::zeros(n, n);
    for (y, &w) in information.iter().zip(weights) {
        if w > 0.0 {
            sum += y * w;
        }
    }
    sum
}

fn best_weights(information: &[DMatrix<f64>], criterion: Criterion) -> Result<DVector<f64>> {
    let count = information.len();
    let mut weights = DVector::from_element(count, 1.0 / count as f64);
    for _ in 0..MAX_MOVES {
        let factor = Cholesky::new(&mixture(information, &weights), "fused information")?;
        let slopes = slopes(information, &inverse_of(&factor), criterion);
        let larger = |best: usize, i: usize| if slopes[i] > slopes[best] { i } else { best };
        let to = (1..count).fold(0, larger);
        let smaller = |best: usize, i: usize| {
            if weights[i] > 0.0 && slopes[i] < slopes[best] {
                i
            } else {
                best
            }
        };
        let from = (0..count).fold(to, smaller);
        if slopes[to] - slopes[from] <= AGREE * slopes[to] || weights[from] <= 0.0 {
            break;
        }
        let direction = &information[to] - &information[from];
        let moved = line_search(&factor, &direction, weights[from], criterion)?;
        if moved < SMALLEST_MOVE {
            break;
        }
        weights[to] += moved;
        // A whole move leaves exactly nothing behind.
        weights[from] = if moved < weights[from] {
            weights[from] - moved
        } else {
            0.0
        };
    }
    let sum = weights.sum();
    Ok(weights / sum)
}

/// s_i at P.
fn slopes(information: &[DMatrix<f64>], cov: &DMatrix<f64>, criterion: Criterion) -> Vec<f64> {
    let weight = match criterion {
        Criterion::Trace => cov * cov,
        Criterion::Determinant => cov.clone(),
    };
    information.iter().map(|y| y.component_mul(&weight).sum()).collect()
}

/// How much weight, of `most`, to move along `direction` from the information that `factor` is of.
fn line_search(factor: &Cholesky, direction: &DMatrix<f64>, most: f64, criterion: Criterion) -> Result<f64> {
    let n = direction.nrows();
    let lower = factor.lower();
    let singular = || Error::Internal {
        reason: "a Cholesky factor is singular".into(),
    };
    let half = lower.solve_lower_triangular(direction).ok_or_else(singular)?;
    let mut turned = lower.solve_lower_triangular(&half.transpose()).ok_or_else(singular)?;
    symmetrise(&mut turned);
    let eigen = symmetric_eigen(&turned)?;
    let back = lower
        .transpose()
        .solve_upper_triangular(&eigen.vectors)
        .ok_or_else(singular)?;
    let slope = |t: f64| -> f64 {
        let term = |k: usize| {
            let lambda = eigen.values[k];
            let scale = 1.0 / (1.0 + t * lambda);
            match criterion {
                Criterion::Trace => back.column(k).norm_squared() * lambda * scale * scale,
                Criterion::Determinant => lambda * scale,
            }
        };
        -(0..n).map(term).sum::<f64>()
    };
    if slope(most) <= 0.0 {
        return Ok(most);
    }
    let (mut low, mut high) = (0.0, most);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if slope(middle) > 0.0 {
            high = middle;
        } else {
            low = middle;
        }
    }
    Ok(low)
}
