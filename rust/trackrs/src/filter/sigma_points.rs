//! Sigma points: the moments of a function of a Gaussian from its values at a few points.
//!
//! | symbol | name here   | shape  | meaning                                                          |
//! |--------|-------------|--------|------------------------------------------------------------------|
//! | P, L   | `lower`     | n×n    | covariance of the state, P = L Lᵀ; columns l_j                   |
//! | c      | `spread`    |        | n + κ, or α² (n + κ) in the scaled form                          |
//! | w      |             |        | 1/(2c), the weight of every point but the centre, which has 1 − 2nw |
//! | y₀, y±_j | `images`  | width  | the function at x and at x ± √c l_j                              |
//! | G      | `slopes`    | n×width | rows (y₊_j − y₋_j)/(2√c)                                        |
//! | δ_j    |             | width  | y₊_j + y₋_j − 2 y₀, its mean δ̄: zero where the function is linear |
//! | B      | `bends`     | (n+1)×width | rows √(w/2) (δ_j − δ̄), and last √|b̄| δ̄                     |
//!
//! mean:   ȳ = y₀ + w Σ δ_j
//! cross:  cov(x, y) = L G, so that the line that fits best has the slope F̃ = Gᵀ L⁻¹
//! cov:    cov(y) = Gᵀ G + Bᵀ B (the last row with the sign of b̄), b̄ = (wn/2)(1 + 2wn b), b = −1, or β − α² when scaled
//!
//! This is the sum over the points with their usual weights, put in an order without cancellation: for a linear function
//! B = 0 to rounding and F̃ is its matrix. Statistical linearisation is then F̃ and the noise Q + Bᵀ B, and everything that
//! works on matrices (screen, noise estimators, smoother) works on these.
//! Angles are compared with y₀ on the circle, so that their mean is one too. Attitudes ([`StateSpace`]) are drawn by retract, and
//! of images they are the turns from their mean m: m ← m exp(mean of log((exp m)⁻¹ exp y)) from m = y₀ on, until it moves by less
//! than [`MEAN_STEP`]; Q stands for an error about f(x), which is as good to second order.
//! Points: unscented (κ > −n; κ = 0 by default, with no negative weight), scaled, and cubature, which is κ = 0.
//!
//! Reference: Julier, Uhlmann (2004), Unscented filtering and nonlinear estimation, Proc. IEEE 92(3); Arasaratnam, Haykin
//! (2009), Cubature Kalman filters, IEEE Trans. AC 54(6); Lefebvre, Bruyninckx, De Schutter (2002) for the line that fits
//! best. Spec labels H3–H13.
//! Deviation: a singular P is accepted; directions without variance have no points of their own.

use nalgebra::Vector3;

use super::chart::attitude_of;
use super::square_root::{lower_cholesky, solve_transposed};
use crate::error::{Error, Result, require_positive};
use crate::linalg::kernel;
use crate::model::StateSpace;
use crate::model::rotation::Rotation;
use crate::model::sensor::wrap_angle;

/// A mean attitude that moves by less than this, radians, is the mean.
pub const MEAN_STEP: f64 = 1e-12;
const MEAN_TURNS: usize = 20;

/// How the points of a state are chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SigmaPoints {
    kappa: f64,
    scale: Option<Scale>,
    redraw: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Scale {
    alpha: f64,
    beta: f64,
}

impl SigmaPoints {
    /// 2n + 1 points with the centre weighted κ/(n + κ).
    pub fn unscented(kappa: f64) -> Self {
        Self {
            kappa,
            scale: None,
            redraw: true,
        }
    }

    /// The scaled form: c = α² (n + κ), the centre's weight in the covariance larger by 1 − α² + β.
    pub fn scaled(alpha: f64, beta: f64, kappa: f64) -> Result<Self> {
        require_positive("alpha", alpha)?;
        if !beta.is_finite() {
            return Err(Error::invalid("beta", beta, "must be finite"));
        }
        Ok(Self {
            scale: Some(Scale { alpha, beta }),
            ..Self::unscented(kappa)
        })
    }

    /// 2n points of equal weight.
    pub fn cubature() -> Self {
        Self::unscented(0.0)
    }

    /// The same points, not drawn again for the measurement: those of the last prediction are used, as the paper prints it.
    /// Innovation covariance and gain then lack the motion noise of that prediction (H11).
    #[must_use]
    pub fn carried(mut self) -> Self {
        self.redraw = false;
        self
    }

    /// Whether points are drawn again for the measurement.
    pub fn redraws(&self) -> bool {
        self.redraw
    }

    /// Whether a state of length n has such points.
    pub fn check(&self, n: usize) -> Result<()> {
        let c = self.weights(n).spread;
        if c.is_finite() && c > 0.0 {
            return Ok(());
        }
        let requirement = format!("must be above -n = -{n}, so that n + kappa is positive");
        Err(Error::invalid("kappa", self.kappa, &requirement))
    }

    /// Whether all covariances are sums of squares, as a square-root form needs them.
    pub fn is_definite(&self, n: usize) -> bool {
        self.weights(n).mean_bend >= 0.0
    }

    fn weights(&self, n: usize) -> Weights {
        let size = n as f64;
        let (factor, b) = match self.scale {
            Some(Scale { alpha, beta }) => (alpha * alpha, beta - alpha * alpha),
            None => (1.0, -1.0),
        };
        let spread = factor * (size + self.kappa);
        let w = 0.5 / spread;
        // 1 + 2wn b in the order that is exactly 0 for b = −1 and κ = 0.
        let mean_bend = 0.5 * w * size * (spread + size * b) / spread;
        Weights { spread, w, mean_bend }
    }
}

struct Weights {
    spread: f64,
    w: f64,
    mean_bend: f64,
}

/// The points of a state and what a function makes of them. Its memory serves one epoch after another.
#[derive(Debug, Clone, Default)]
pub(super) struct Spread {
    n: usize,
    pub(super) width: usize,
    /// Where the points have an attitude, and where their images do.
    attitude: Option<usize>,
    image_attitude: Option<usize>,
    turns: Vec<Rotation>,
    /// Lᵀ row by row.
    steps: Vec<f64>,
    lower: Vec<f64>,
    /// (2n+1)×n: the centre, then x + √c l_j, then x − √c l_j.
    pub(super) points: Vec<f64>,
    /// What becomes of them, (2n+1)×width.
    pub(super) images: Vec<f64>,
    pub(super) mean: Vec<f64>,
    pub(super) slopes: Vec<f64>,
    pub(super) bends: Vec<f64>,
    /// Whether the last row of B counts as negative.
    pub(super) last_bend_negative: bool,
}

impl Spread {
    pub(super) fn new(space: StateSpace, images: StateSpace) -> Self {
        let (n, width) = (space.dim, images.dim);
        Self {
            n,
            width,
            attitude: space.attitude,
            image_attitude: images.attitude,
            turns: Vec::new(),
            steps: vec![0.0; n * n],
            lower: vec![0.0; n * n],
            points: vec![0.0; (2 * n + 1) * n],
            images: vec![0.0; (2 * n + 1) * width],
            mean: vec![0.0; width],
            slopes: vec![0.0; n * width],
            bends: vec![0.0; (n + 1) * width],
            last_bend_negative: false,
        }
    }

    /// Draws the points of a mean and covariance; `what` names the covariance in the error.
    pub(super) fn draw(&mut self, rule: &SigmaPoints, mean: &[f64], cov: &[f64], what: &str) -> Result<()> {
        self.lower.copy_from_slice(cov);
        lower_cholesky(self.n, &mut self.lower, what)?;
        self.place(rule, mean);
        Ok(())
    }

    /// The same from the factor L, n×n lower.
    pub(super) fn draw_from(&mut self, rule: &SigmaPoints, mean: &[f64], lower: &[f64]) {
        self.lower.copy_from_slice(lower);
        self.place(rule, mean);
    }

    fn place(&mut self, rule: &SigmaPoints, mean: &[f64]) {
        let n = self.n;
        for i in 0..n {
            for j in 0..n {
                self.steps[j * n + i] = if i < j { 0.0 } else { self.lower[i * n + j] };
            }
        }
        let root = rule.weights(n).spread.sqrt();
        for (k, point) in self.points.chunks_exact_mut(n.max(1)).enumerate() {
            point.copy_from_slice(mean);
            if k > 0 {
                let (j, sign) = if k <= n { (k - 1, root) } else { (k - 1 - n, -root) };
                kernel::add_scaled(point, sign, &self.steps[j * n..(j + 1) * n]);
            }
        }
        if let Some(at) = self.attitude {
            self.place_attitudes(root, mean, at);
        }
    }

    fn place_attitudes(&mut self, root: f64, mean: &[f64], at: usize) {
        let n = self.n;
        let centre = Rotation::from_vector(&attitude_of(mean, at));
        let (_, others) = self.points.split_at_mut(n);
        let (plus, minus) = others.split_at_mut(n * n);
        let pairs = plus.chunks_exact_mut(n).zip(minus.chunks_exact_mut(n));
        for ((ahead, behind), step) in pairs.zip(self.steps.chunks_exact(n)) {
            let step = attitude_of(step, at);
            // L is lower: most columns do not turn anything.
            if step.iter().all(|&x| x == 0.0) {
                continue;
            }
            let turn = Rotation::from_vector(&(step * root));
            ahead[at..at + 3].copy_from_slice((centre * turn).vector().as_slice());
            behind[at..at + 3].copy_from_slice((centre * turn.inverse()).vector().as_slice());
        }
    }

    /// Makes the attitudes of the images turns from their mean, which it returns.
    fn turns_from_mean(&mut self, w: f64, at: usize) -> Rotation {
        let width = self.width;
        self.turns.clear();
        let attitudes = self.images.chunks_exact(width).map(|image| attitude_of(image, at));
        self.turns.extend(attitudes.map(|v| Rotation::from_vector(&v)));
        let mut mean = self.turns.first().copied().unwrap_or(Rotation::identity());
        let rest = 1.0 - 2.0 * w * self.n as f64;
        for _ in 0..MEAN_TURNS {
            let back = mean.inverse();
            let mut step = Vector3::zeros();
            for (i, (turn, image)) in self.turns.iter().zip(self.images.chunks_exact_mut(width)).enumerate() {
                let vector = (back * *turn).vector();
                image[at..at + 3].copy_from_slice(vector.as_slice());
                step += vector * if i == 0 { rest } else { w };
            }
            if step.norm() < MEAN_STEP {
                break;
            }
            mean = mean * Rotation::from_vector(&step);
        }
        mean
    }

    /// Lᵀ, row by row.
    pub(super) fn steps(&self) -> &[f64] {
        &self.steps
    }

    /// Mean, slopes and bends of the images; those at `angles` are compared on the circle.
    pub(super) fn summarise(&mut self, rule: &SigmaPoints, angles: &[usize]) {
        let (n, width) = (self.n, self.width);
        let Weights { spread, w, mean_bend } = rule.weights(n);
        let turned = self.image_attitude.map(|at| (at, self.turns_from_mean(w, at)));
        let (centre, others) = self.images.split_at_mut(width);
        for image in others.chunks_exact_mut(width.max(1)) {
            for (y, y0) in image.iter_mut().zip(centre.iter()) {
                *y -= y0;
            }
            for &i in angles {
                image[i] = wrap_angle(image[i]);
            }
        }
        let (plus, minus) = others.split_at(n * width);
        let half = 0.5 / spread.sqrt();
        for ((g, a), b) in self.slopes.iter_mut().zip(plus).zip(minus) {
            *g = half * (a - b);
        }
        let (bends, last) = self.bends.split_at_mut(n * width);
        last.fill(0.0);
        for ((d, a), b) in bends.iter_mut().zip(plus).zip(minus) {
            *d = a + b;
        }
        for row in bends.chunks_exact(width.max(1)) {
            kernel::add_scaled(last, 1.0, row);
        }
        self.mean.copy_from_slice(centre);
        kernel::add_scaled(&mut self.mean, w, last);
        for &i in angles {
            self.mean[i] = wrap_angle(self.mean[i]);
        }
        if let Some((at, mean)) = turned {
            let rest = Rotation::from_vector(&attitude_of(&self.mean, at));
            self.mean[at..at + 3].copy_from_slice((mean * rest).vector().as_slice());
        }
        let root = (0.5 * w).sqrt();
        let mean_of = 1.0 / n.max(1) as f64;
        for d in last.iter_mut() {
            *d *= mean_of;
        }
        for row in bends.chunks_exact_mut(width.max(1)) {
            row.iter_mut()
                .zip(last.iter())
                .for_each(|(d, mean)| *d = root * (*d - mean));
        }
        let weight = mean_bend.abs().sqrt();
        for d in last.iter_mut() {
            *d *= weight;
        }
        self.last_bend_negative = mean_bend < 0.0;
    }

    /// Adds the lower half of Bᵀ B to that of `out`, width×width.
    pub(super) fn add_bends(&self, out: &mut [f64]) {
        self.add_bends_with(self, out);
    }

    /// Adds B_selfᵀ B_other, width×other width, to `out`; of a square the lower half alone would do.
    pub(super) fn add_bends_with(&self, other: &Self, out: &mut [f64]) {
        let width = other.width.max(1);
        let rows = self
            .bends
            .chunks_exact(self.width.max(1))
            .zip(other.bends.chunks_exact(width));
        for (k, (left, right)) in rows.enumerate() {
            let sign = if k == self.n && self.last_bend_negative {
                -1.0
            } else {
                1.0
            };
            for (&x, row) in left.iter().zip(out.chunks_exact_mut(width)) {
                if x != 0.0 {
                    kernel::add_scaled(row, sign * x, right);
                }
            }
        }
    }

    /// F̃, width×n row by row, into `out`; `work` is n×width.
    pub(super) fn slope_into(&self, work: &mut [f64], out: &mut [f64]) {
        let (n, width) = (self.n, self.width);
        work.copy_from_slice(&self.slopes);
        solve_transposed(n, width, &self.lower, work);
        for j in 0..n {
            for i in 0..width {
                out[i * n + j] = work[j * width + i];
            }
        }
    }
}
