//! A measurement compared with what was expected of it, by any rule and in any form, in memory that serves one epoch after
//! another.
//!
//! Whatever the rule, what comes out is a line and its noise, H̃ and R̃ ([`super::extended`], [`super::sigma_points`]); the
//! update of [`super::kalman`] follows.

use nalgebra::DVector;

use super::chart::{Chart, attitude_of};
use super::correction::Correction;
use super::extended::{Linearised, Method, Rule, SMALL_STEP};
use super::kalman::Update;
use super::prediction::{Prediction, draw};
use super::sigma_points::{SigmaPoints, Spread};
use super::square_root::{Form, lower_cholesky, lower_root, solve_forward, solve_transposed};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::linalg::copy_rows;
use crate::linalg::kernel;
use crate::model::sensor::residual_into;
use crate::model::{Sensor, StateSpace};

/// One state and one measurement of it.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    pub(super) prior: &'a Gaussian,
    /// The factor of its covariance, in square-root form.
    pub(super) factor: Option<&'a [f64]>,
    /// The points of its prediction, where the rule carries them on.
    pub(super) carried: Option<&'a Spread>,
    pub(super) sensor: &'a dyn Sensor,
    pub(super) platform: Option<&'a DVector<f64>>,
}

impl<'a> Target<'a> {
    /// What was predicted, seen by a sensor at rest.
    pub(super) fn of(prediction: &'a Prediction, sensor: &'a dyn Sensor) -> Self {
        Self {
            prior: &prediction.state,
            factor: prediction.factor(),
            carried: prediction.carried(),
            sensor,
            platform: None,
        }
    }
}

/// A measurement compared with what was expected of it. Its memory serves one epoch after another.
#[derive(Debug, Clone)]
pub(super) struct Look {
    method: Method,
    space: StateSpace,
    pub(super) linearised: Linearised,
    /// NaN where not observed; a screen may set more of them before the correction.
    pub(super) innovation: DVector<f64>,
    pub(super) correction: Correction,
    /// R, and its factor in square-root form.
    noise: Vec<f64>,
    noise_root: Vec<f64>,
    spread: Option<Spread>,
    again: Linearised,
    point: DVector<f64>,
    pseudo: Vec<f64>,
}

impl Look {
    /// Memory for one kind of state and one sensor, whose own R is set.
    pub(super) fn new(space: StateSpace, sensor: &dyn Sensor, method: &Method) -> Result<Self> {
        let n = space.dim;
        let m = sensor.measurement_dim();
        let mut linearised = Linearised::sized(n, m);
        if method.form == Form::SquareRoot {
            linearised.prediction.root = Some(Box::default());
        }
        let mut noise = vec![0.0; m * m];
        copy_rows(&sensor.noise(), &mut noise);
        let mut look = Self {
            method: *method,
            space,
            again: linearised.clone(),
            linearised,
            innovation: DVector::zeros(m),
            correction: Correction::new(n, m),
            noise: vec![0.0; m * m],
            noise_root: vec![0.0; m * m],
            spread: None,
            point: DVector::zeros(n),
            pseudo: vec![0.0; m],
        };
        look.set_noise(&noise)?;
        Ok(look)
    }

    /// Sets R, m×m, for the epochs to come.
    pub(super) fn set_noise(&mut self, noise: &[f64]) -> Result<()> {
        self.noise.copy_from_slice(noise);
        for linearised in [&mut self.linearised, &mut self.again] {
            linearised.prediction.noise.copy_from_slice(noise);
        }
        if self.method.form == Form::SquareRoot {
            set_noise_root(noise, &mut self.noise_root)?;
        }
        Ok(())
    }

    /// Finds what is expected of the prior, and forms the innovation.
    pub(super) fn expect(&mut self, target: &Target<'_>, measurement: &[f64]) -> Result<()> {
        self.expect_alone(target)?;
        residual_into(
            target.sensor,
            measurement,
            self.linearised.expected.as_slice(),
            self.innovation.as_mut_slice(),
        );
        Ok(())
    }

    /// Finds what is expected of the prior.
    pub(super) fn expect_alone(&mut self, target: &Target<'_>) -> Result<()> {
        match (self.method.rule, target.carried) {
            (Rule::SigmaPoints(points), Some(carried)) if !points.redraws() => {
                self.expect_carried(&points, target, carried)
            }
            (Rule::SigmaPoints(points), _) if !target.sensor.is_linear_in_changes() => {
                self.expect_of_points(&points, target)
            }
            _ => self.expect_by_slope(target),
        }
    }

    /// h and H at the mean, with the curvature where the rule has it.
    fn expect_by_slope(&mut self, target: &Target<'_>) -> Result<()> {
        let linearised = &mut self.linearised;
        linearised.at(&target.prior.mean, target.sensor, target.platform)?;
        if self.method.rule == Rule::SecondOrder
            && let Some(curvature) = target.sensor.curvature(target.prior).transpose()?
        {
            linearised.expected += curvature.shift;
            for (i, noise) in linearised.prediction.noise.iter_mut().enumerate() {
                *noise = self.noise[i] + curvature.noise.as_slice()[i];
            }
            if self.method.form == Form::SquareRoot {
                set_noise_root(&linearised.prediction.noise, &mut self.noise_root)?;
            }
        }
        set_root(linearised, target, &self.noise_root);
        linearised.prediction.prepare(target.prior.cov.as_slice())
    }

    /// S, cross covariance and mean from points of the prior, as a line and its noise.
    fn expect_of_points(&mut self, points: &SigmaPoints, target: &Target<'_>) -> Result<()> {
        let n = target.prior.dim();
        let images = StateSpace {
            dim: self.innovation.len(),
            attitude: target.sensor.rotation(),
        };
        let spread = self.spread.get_or_insert_with(|| Spread::new(self.space, images));
        draw(spread, points, target.prior, target.factor)?;
        let (states, images) = (&spread.points, &mut spread.images);
        target.sensor.observe_all(states, n, target.platform, images)?;
        spread.summarise(points, target.sensor.angles());
        let expected = &mut self.linearised.prediction;
        self.linearised.expected.as_mut_slice().copy_from_slice(&spread.mean);
        spread.slope_into(&mut expected.cross, &mut expected.jacobian);
        expected.noise.copy_from_slice(&self.noise);
        spread.add_bends(&mut expected.noise);
        if let Some(root) = &mut expected.root {
            root.factor.clear();
            root.factor.extend_from_slice(spread.steps());
            root.seen.clone_from(&spread.slopes);
            root.noise.clone_from(&self.noise_root);
            root.noise.extend_from_slice(&spread.bends);
        }
        expected.prepare(target.prior.cov.as_slice())
    }

    /// The same from the points of the prediction, which lack its noise: S and cross covariance belong to P⁻ − Q (H11).
    /// K = P_xz S⁻¹ and P⁺ = P⁻ − K S Kᵀ; a screen sees H̃ = P_xzᵀ (P⁻)⁻¹.
    fn expect_carried(&mut self, points: &SigmaPoints, target: &Target<'_>, carried: &Spread) -> Result<()> {
        let (n, m) = (target.prior.dim(), self.innovation.len());
        let space = StateSpace {
            dim: m,
            attitude: target.sensor.rotation(),
        };
        let spread = self.spread.get_or_insert_with(|| Spread::new(self.space, space));
        let images = &mut spread.images;
        target.sensor.observe_all(&carried.images, n, target.platform, images)?;
        spread.summarise(points, target.sensor.angles());
        self.linearised.expected.as_mut_slice().copy_from_slice(&spread.mean);
        let mut s = self.noise.clone();
        add_products(m, m, &spread.slopes, &spread.slopes, &mut s);
        spread.add_bends(&mut s);
        kernel::symmetrise(m, &mut s);
        let mut cross = vec![0.0; n * m];
        add_products(n, m, &carried.slopes, &spread.slopes, &mut cross);
        carried.add_bends_with(spread, &mut cross);
        let mut lower = target.prior.cov.as_slice().to_vec();
        lower_cholesky(n, &mut lower, "predicted covariance")?;
        let mut solved = cross.clone();
        solve_forward(n, m, &lower, &mut solved);
        solve_transposed(n, m, &lower, &mut solved);
        let expected = &mut self.linearised.prediction;
        for (i, row) in solved.chunks_exact(m.max(1)).enumerate() {
            for (a, &x) in row.iter().enumerate() {
                expected.jacobian[a * n + i] = x;
                expected.cross[a * n + i] = cross[i * m + a];
            }
        }
        expected.sparse.set(n, &expected.jacobian);
        expected.given = true;
        expected.cov.as_mut_slice().copy_from_slice(&s);
        expected.factorise()
    }

    /// Corrects the prior by the innovation.
    pub(super) fn correct(&mut self, target: &Target<'_>, measurement: &[f64]) -> Result<()> {
        self.solve(target, measurement)?;
        if self.space.attitude.is_some() && self.correction.dof > 0 {
            self.correction.settle(self.space, &target.prior.mean);
        }
        Ok(())
    }

    /// The posterior as a change of the prior that adds.
    fn solve(&mut self, target: &Target<'_>, measurement: &[f64]) -> Result<()> {
        let prior = target.prior;
        let iterations = if let Rule::Iterated(count) = self.method.rule {
            count
        } else {
            1
        };
        self.correction
            .apply(&self.linearised.prediction, prior.into(), self.innovation.as_slice())?;
        if target.sensor.is_linear() || self.correction.dof == 0 {
            return Ok(());
        }
        for _ in 1..iterations {
            self.point.copy_from(&self.correction.posterior.mean);
            if let Some(at) = self.space.attitude {
                // The sum is the state, and H counts from there.
                let step = attitude_of(self.point.as_slice(), at) - attitude_of(prior.mean.as_slice(), at);
                let mut state = self.point.clone();
                let _ = Chart::of_step(self.space, prior.mean.as_slice(), state.as_mut_slice());
                self.again.at(&state, target.sensor, target.platform)?;
                Chart::transposed(at, &step).columns(prior.dim(), &mut self.again.prediction.jacobian);
            } else {
                self.again.at(&self.point, target.sensor, target.platform)?;
            }
            set_root(&mut self.again, target, &self.noise_root);
            self.again.prediction.prepare(prior.cov.as_slice())?;
            residual_into(
                target.sensor,
                measurement,
                self.again.expected.as_slice(),
                &mut self.pseudo,
            );
            let n = prior.dim();
            for (r, h) in self
                .pseudo
                .iter_mut()
                .zip(self.again.prediction.jacobian.chunks_exact(n.max(1)))
            {
                *r -= kernel::dot(h, prior.mean.as_slice()) - kernel::dot(h, self.point.as_slice());
            }
            self.correction
                .again(&self.again.prediction, prior.into(), &self.pseudo)?;
            let moved = |i: usize| {
                let step = self.correction.posterior.mean[i] - self.point[i];
                step * step > SMALL_STEP * SMALL_STEP * prior.cov[(i, i)]
            };
            if !(0..n).any(moved) {
                break;
            }
        }
        Ok(())
    }

    pub(super) fn record(self) -> Update {
        self.correction.record(&self.linearised.prediction, self.innovation)
    }
}

/// In square-root form, U, U Hᵀ and the factor of R of a linearisation.
fn set_root(linearised: &mut Linearised, target: &Target<'_>, noise_root: &[f64]) {
    let expected = &mut linearised.prediction;
    let (Some(root), Some(factor)) = (&mut expected.root, target.factor) else {
        return;
    };
    let (n, m) = (expected.n, expected.m);
    root.factor.clear();
    root.factor.extend_from_slice(factor);
    root.noise.clear();
    root.noise.extend_from_slice(noise_root);
    root.seen.clear();
    expected.sparse.set(n, &expected.jacobian);
    for row in factor.chunks_exact(n.max(1)) {
        root.seen.extend((0..m).map(|i| expected.sparse.row_dot(i, row)));
    }
}

/// The factor of R.
pub(super) fn set_noise_root(noise: &[f64], root: &mut [f64]) -> Result<()> {
    let m = noise.len().isqrt();
    lower_root(m, noise, &mut vec![0.0; m * m], root, "sensor noise")
}

/// Adds Aᵀ B, B with rows of length m, to `out`.
fn add_products(n: usize, m: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
    for (left, right) in a.chunks_exact(n.max(1)).zip(b.chunks_exact(m.max(1))) {
        for (&x, row) in left.iter().zip(out.chunks_exact_mut(m.max(1))) {
            kernel::add_scaled(row, x, right);
        }
    }
}
