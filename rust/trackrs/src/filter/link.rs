//! The way from one epoch of a filter back to the one before it.
//!
//! | symbol   | name here   | shape  | meaning                                                             |
//! |----------|-------------|--------|---------------------------------------------------------------------|
//! | x_i, P_i | `filtered`  | n, n×n | estimate of epoch i given the data to i                             |
//! | x⁻, P⁻   | `predicted` | n, n×n | estimate of epoch i given the data to i−1                           |
//! | F, Q     | `transition`, `noise` | n×n | of the step from i−1 to i                                    |
//! | C        | `gain`      | n×n    | smoother gain from i to i−1; kept together with Cᵀ                  |
//! | D        | `rest`      | n×n    | covariance of epoch i−1 if epoch i were known and no data after i−1 |
//!
//! C = P_{i−1} Fᵀ (P⁻)⁻¹, by solving with the Cholesky factor of P⁻                                  (U14)
//! x_{i−1} = x + C (x_i − x⁻) + N(0, D),  D = (I − C F) P_{i−1} (I − C F)ᵀ + C Q Cᵀ                  (U15)
//! lag one: cov(x_i, x_{i−1} | data to k) = P_{i|k} Cᵀ                                               (U16)
//! Where little of a variance of P⁻ is left once the others are known, (U14) would lose as many digits as P⁻ is ill-conditioned. With
//! P = Uᵀ U, Q = Vᵀ V and the rows of [U, U Fᵀ; 0, V] reflected into the triangle [A, 0; B, E] it loses half as many:
//! Cᵀ = E⁻¹ B, D = Aᵀ A.                                                                             (U14 by factors)
//! A link does not depend on data after i−1. Where states hold an attitude, differences and sums are those of [`StateSpace`]; P_i|k
//! is counted from x⁻ on the way, and P_{i−1} from where x_{i−1} comes to stand (`chart.rs`).
//!
//! Reference and deviations: see [`super::smoother`].

use nalgebra::Vector3;

use super::chart::{Chart, settle_difference};
use super::square_root::{Reflector, lower_root, solve_forward, square};
use crate::error::{Error, Result};
use crate::gaussian::GaussianRef;
use crate::linalg::kernel::{self, BadPivot, known, sized};
use crate::model::StateSpace;

/// Share of a variance of P⁻ left once those before it are known, below which the link is made by factors.
pub(super) const LITTLE: f64 = 1e-2;

/// The step that leads to an epoch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step<'a> {
    /// Its number in the run, which errors name.
    pub(super) number: usize,
    pub(super) predicted: GaussianRef<'a>,
    pub(super) transition: &'a [f64],
    pub(super) noise: &'a [f64],
}

/// The way back: x_{i−1} = x + C (x_i − x⁻) + N(0, D).
#[derive(Debug, Clone)]
pub(super) struct Link {
    n: usize,
    space: StateSpace,
    before: Vec<f64>,
    predicted: Vec<f64>,
    gain: Vec<f64>,
    gain_transposed: Vec<f64>,
    rest: Vec<f64>,
}

/// Attitudes of x_i less x⁻, and of what that makes of x_{i−1}.
struct Turns {
    at: usize,
    later: Vector3<f64>,
    earlier: Vector3<f64>,
}

/// Matrices on the way to a link or back along one.
#[derive(Debug, Clone)]
pub(super) struct LinkScratch {
    lower: Vec<f64>,
    first: Vec<f64>,
    second: Vec<f64>,
    third: Vec<f64>,
    offset: Vec<f64>,
}

impl LinkScratch {
    pub(super) fn new(n: usize) -> Self {
        let square = || vec![0.0; n * n];
        Self {
            lower: square(),
            first: square(),
            second: square(),
            third: square(),
            offset: vec![0.0; n],
        }
    }

    /// The factor of P⁻ of the link made last, in the lower half; only after a link with [`Link::set`] giving true.
    pub(super) fn lower(&self) -> &[f64] {
        &self.lower
    }
}

impl Link {
    /// Memory for states of this space.
    pub(super) fn new(space: StateSpace) -> Self {
        let n = space.dim;
        Self {
            n,
            space,
            before: vec![0.0; n],
            predicted: vec![0.0; n],
            gain: vec![0.0; n * n],
            gain_transposed: vec![0.0; n * n],
            rest: vec![0.0; n * n],
        }
    }

    /// x⁻, the prediction of the later epoch.
    pub(super) fn predicted(&self) -> &[f64] {
        &self.predicted
    }

    /// Makes this the link from the end of `step` to the filtered estimate `before` it. False where nothing moves and no
    /// noise enters: then C = I, and P⁻ need not have a factor.
    pub(super) fn set(&mut self, before: GaussianRef<'_>, step: &Step<'_>, scratch: &mut LinkScratch) -> Result<bool> {
        let n = self.n;
        self.before.copy_from_slice(before.mean);
        self.predicted.copy_from_slice(step.predicted.mean);
        let moves = !identity(n, step.transition) || step.noise.iter().any(|&q| q != 0.0);
        if moves {
            sized!(factor(n, step.predicted.cov, &mut scratch.lower)).map_err(|pivot| singular(pivot, step.number))?;
        }
        let left = |i: usize| scratch.lower[i * n + i] * scratch.lower[i * n + i];
        if moves && (0..n).any(|i| left(i) < LITTLE * step.predicted.cov[i * n + i]) && self.by_factors(before, step) {
            return Ok(moves);
        }
        sized!(fill(n, self, before.cov, step, moves, scratch));
        Ok(moves)
    }

    /// The same by factors; false where P or Q has none.
    fn by_factors(&mut self, before: GaussianRef<'_>, step: &Step<'_>) -> bool {
        let n = self.n;
        let (mut u, mut v, mut work) = (vec![0.0; n * n], vec![0.0; n * n], vec![0.0; n * n]);
        let known = lower_root(n, before.cov, &mut work, &mut u, "covariance")
            .and_then(|()| lower_root(n, step.noise, &mut work, &mut v, "motion noise"));
        if known.is_err() {
            return false;
        }
        let mut rows = vec![0.0; 4 * n * n];
        for (i, row) in rows.chunks_exact_mut(2 * n).enumerate() {
            let (earlier, later) = row.split_at_mut(n);
            if i < n {
                let u = &u[i * n..(i + 1) * n];
                earlier.copy_from_slice(u);
                for (x, f) in later.iter_mut().zip(step.transition.chunks_exact(n)) {
                    *x = kernel::dot(u, f);
                }
            } else {
                later.copy_from_slice(&v[(i - n) * n..(i - n + 1) * n]);
            }
        }
        Reflector::default().triangularise(2 * n, &mut rows);
        for (i, row) in rows.chunks_exact(2 * n).enumerate() {
            let (earlier, later) = row.split_at(n);
            if i < n {
                u[i * n..(i + 1) * n].copy_from_slice(earlier);
            } else {
                self.gain_transposed[(i - n) * n..(i - n + 1) * n].copy_from_slice(earlier);
                v[(i - n) * n..(i - n + 1) * n].copy_from_slice(later);
            }
        }
        solve_forward(n, n, &v, &mut self.gain_transposed);
        kernel::transpose(n, &self.gain_transposed, &mut self.gain);
        square(n, &u, &mut self.rest);
        true
    }

    /// The estimate of the earlier epoch, from that of the later one.
    pub(super) fn back(&self, later: GaussianRef<'_>, scratch: &mut LinkScratch, mean: &mut [f64], cov: &mut [f64]) {
        let n = self.n;
        if let Some(turns) = self.turns(later) {
            // P_i|k, counted from x⁻.
            let mut counted = later.cov.to_vec();
            Chart::back(turns.at, &turns.later).both(n, &mut counted);
            let later = GaussianRef { cov: &counted, ..later };
            sized!(back(n, self, later, scratch, mean, cov));
            let _ = Chart::of_step(self.space, &self.before, mean);
            Chart::forth(turns.at, &turns.earlier).both(n, cov);
            return;
        }
        sized!(back(n, self, later, scratch, mean, cov));
    }

    /// cov(x_i, x_{i−1}) from the estimate of the later epoch, n×n row by row.
    pub(super) fn lag_one(&self, later: GaussianRef<'_>, out: &mut [f64]) {
        let n = self.n;
        let Some(turns) = self.turns(later) else {
            kernel::multiply::<0>(n, n, later.cov, &self.gain_transposed, out);
            return;
        };
        let mut half = later.cov.to_vec();
        Chart::back(turns.at, &turns.later).columns(n, &mut half);
        kernel::multiply::<0>(n, n, &half, &self.gain_transposed, out);
        Chart::forth(turns.at, &turns.earlier).columns(n, out);
    }

    /// Makes x_i − x⁻ the change that leads from x⁻ to x_i.
    pub(super) fn settle(&self, later: &[f64], offset: &mut [f64]) -> Option<Chart> {
        let at = self.space.attitude?;
        let turn = settle_difference(self.space, later, &self.predicted, offset)?;
        Some(Chart::back(at, &turn))
    }

    /// By how much the attitudes of the two epochs change; none where everything adds.
    fn turns(&self, later: GaussianRef<'_>) -> Option<Turns> {
        let at = self.space.attitude?;
        let mut offset: Vec<f64> = later.mean.iter().zip(&self.predicted).map(|(x, y)| x - y).collect();
        let turn = settle_difference(self.space, later.mean, &self.predicted, &mut offset)?;
        let row = |i: usize| kernel::dot(&self.gain[(at + i) * self.n..(at + i + 1) * self.n], &offset);
        Some(Turns {
            at,
            later: turn,
            earlier: Vector3::new(row(0), row(1), row(2)),
        })
    }
}

fn identity(n: usize, matrix: &[f64]) -> bool {
    let one = |i: usize| if i.is_multiple_of(n + 1) { 1.0 } else { 0.0 };
    matrix.iter().enumerate().all(|(i, &value)| value == one(i))
}

fn singular(pivot: BadPivot, step: usize) -> Error {
    Error::NotPositiveDefinite {
        what: format!("predicted covariance at step {step}"),
        pivot: pivot.index,
        value: pivot.value,
    }
}

/// The factor of P⁻. A pivot within rounding of zero is refused too: the gain would be noise, and whether a singular
/// matrix leaves +1e-17 or −1e-17 there is chance.
fn factor<const N: usize>(n: usize, cov: &[f64], lower: &mut [f64]) -> std::result::Result<(), BadPivot> {
    let n = known::<N>(n);
    lower.copy_from_slice(cov);
    kernel::cholesky(n, lower)?;
    for i in 0..n {
        let value = lower[i * n + i] * lower[i * n + i];
        if value <= n as f64 * f64::EPSILON * cov[i * n + i] {
            return Err(BadPivot { index: i, value });
        }
    }
    Ok(())
}

fn fill<const N: usize>(
    n: usize,
    link: &mut Link,
    cov: &[f64],
    step: &Step<'_>,
    moves: bool,
    scratch: &mut LinkScratch,
) {
    let n = known::<N>(n);
    let (f, q) = (step.transition, step.noise);
    let (gain, gain_transposed, rest) = (&mut link.gain, &mut link.gain_transposed, &mut link.rest);
    let LinkScratch {
        lower,
        first,
        second,
        third,
        ..
    } = scratch;
    if !moves {
        gain.fill(0.0);
        (0..n).for_each(|i| gain[i * n + i] = 1.0);
        gain_transposed.copy_from_slice(gain);
        rest.fill(0.0);
        return;
    }
    kernel::multiply_sparse::<N>(n, n, f, cov, gain_transposed);
    kernel::solve_lower::<N>(n, n, lower, gain_transposed);
    kernel::solve_upper::<N>(n, n, lower, gain_transposed);
    kernel::transpose(n, gain_transposed, gain);
    // I − C F, its transpose, and what it makes of P.
    kernel::multiply::<N>(n, n, gain, f, first);
    for (i, x) in first.iter_mut().enumerate() {
        *x = if i.is_multiple_of(n + 1) { 1.0 } else { 0.0 } - *x;
    }
    kernel::transpose(n, first, second);
    kernel::multiply::<N>(n, n, first, cov, third);
    rest.fill(0.0);
    kernel::add_product_lower(n, n, third, second, rest);
    kernel::multiply::<N>(n, n, gain, q, third);
    kernel::add_product_lower(n, n, third, gain_transposed, rest);
    kernel::mirror(n, rest);
}

fn back<const N: usize>(
    n: usize,
    link: &Link,
    later: GaussianRef<'_>,
    scratch: &mut LinkScratch,
    mean: &mut [f64],
    cov: &mut [f64],
) {
    let n = known::<N>(n);
    let LinkScratch { first, offset, .. } = scratch;
    for ((d, x), predicted) in offset.iter_mut().zip(later.mean).zip(&link.predicted) {
        *d = x - predicted;
    }
    let _ = settle_difference(link.space, later.mean, &link.predicted, offset);
    mean.copy_from_slice(&link.before);
    for (k, &d) in offset.iter().enumerate() {
        kernel::add_scaled(mean, d, &link.gain_transposed[k * n..(k + 1) * n]);
    }
    kernel::multiply::<N>(n, n, &link.gain, later.cov, first);
    cov.copy_from_slice(&link.rest);
    kernel::add_product_lower(n, n, first, &link.gain_transposed, cov);
    kernel::mirror(n, cov);
}
