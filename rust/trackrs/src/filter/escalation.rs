//! From the Joseph form to the square root in the middle of a run.
//!
//! The Joseph form keeps a covariance definite up to a condition of 1e14. A run in that form looks at every P⁻ and P⁺: where
//! a component's variance, given the components before it, is 1e-14 of its variance or less, P is nearly singular
//! (`linalg::kernel::NEARLY_SINGULAR`). The epoch is then done again, and all that follow, in square-root form from the last
//! good P, whose factor still has the digits. What is measured is the condition of the correlation matrix, not that of P: units of
//! state components that differ by 1e7 or more make the second large and do no harm.
//!
//! In the experiment that the figure 1e14 comes from (4 states, 2 measured, R = I/c, 200 updates; `tests/square_root.rs`) runs
//! with c <= 1e14 need no root, and with c = 1e15 and more every run that the Joseph form would lose takes it in time.
//!
//! A tracker keeps of its tracks and of the components of its intensity P alone: there the step that would make the least eigenvalue
//! of the correlations 1e-14 or less, in whatever order of the components, is done by the root of the P before. What 16 digits cannot
//! hold of the result is added to the variances, a part of 4 n ε: the matrix itself is positive definite.
//!
//! Not everything has a square-root form: sigma points that are not drawn again, or whose weights make a difference of
//! squares, stay as they are. A P that was given with an indefinite part beyond rounding becomes the nearest that has none.

use nalgebra::DMatrix;

use super::correction::Scratch;
use super::extended::Method;
use super::kalman::MeasurementPrediction;
use super::look::{Look, set_noise_root};
use super::measured_root::MeasuredRoot;
use super::prediction::{Course, Prediction};
use super::runner::Runner;
use super::square_root::{Form, factor_of};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::linalg::symmetric::{SymmetricEigen, symmetric_eigen};
use crate::model::Motion;

impl Runner<'_> {
    /// Predicts once more, from the same state, by its root, and stays with roots; whether that is possible.
    pub(super) fn escalate(&mut self, dt: f64, input: Option<&[f64]>) -> bool {
        let Ok((look, factor)) = self.rooted() else {
            self.watch = false;
            return false;
        };
        let space = self.filter.motion().space();
        let new = || Prediction::new(space, self.method.rule, Form::SquareRoot);
        let (prediction, ahead) = (new(), new());
        let before = std::mem::replace(&mut self.prediction, prediction);
        self.factor = Some(factor);
        self.fixed = None;
        self.watch = false;
        if self.predict(dt, input).is_err() {
            (self.prediction, self.factor) = (before, None);
            return false;
        }
        (self.ahead, self.look) = (ahead, look);
        self.method.form = Form::SquareRoot;
        true
    }

    /// Goes on from a state whose covariance is carried as this factor.
    pub(super) fn resume(&mut self, factor: &[f64]) -> Result<()> {
        if self.watch {
            self.look = self.rooted()?.0;
            let new = || Prediction::new(self.filter.motion().space(), self.method.rule, Form::SquareRoot);
            (self.prediction, self.ahead) = (new(), new());
            (self.method.form, self.watch, self.fixed) = (Form::SquareRoot, false, None);
        }
        self.factor = Some(factor.to_vec());
        Ok(())
    }

    fn rooted(&self) -> Result<(Look, Vec<f64>)> {
        let method = Method {
            form: Form::SquareRoot,
            ..self.method
        };
        let mut look = Look::new(self.filter.motion().space(), self.filter.sensor(), &method)?;
        if let Some(memory) = &self.memory {
            look.set_noise(memory.r().as_slice())?;
        }
        Ok((look, root_of(&self.state.cov)?))
    }
}

impl Prediction {
    /// Predicts a state of which P alone is kept: by the root of P where P⁻ would be nearly singular. Whether that was so.
    pub(crate) fn predict_definite(&mut self, prior: &Gaussian, course: &Course<'_>) -> Result<bool> {
        self.predict(prior, None, course)?;
        if !self.state.is_barely_definite() {
            return Ok(false);
        }
        let mut rooted = self.in_form(Form::SquareRoot);
        let done = root_of(&prior.cov).and_then(|root| rooted.predict(prior, Some(&root), course));
        if done.is_ok() {
            self.state = rooted.state;
            round_up(&mut self.state);
        }
        Ok(done.is_ok())
    }
}

impl MeasurementPrediction {
    /// The posterior of an innovation of all components, for a state of which P alone is kept: by the root of P where P⁺ would
    /// be nearly singular. Whether that was so.
    pub(crate) fn definite_posterior_into(
        &self,
        prior: &Gaussian,
        innovation: &[f64],
        scratch: &mut Scratch,
        out: &mut Gaussian,
    ) -> bool {
        self.posterior_into(prior.into(), innovation, scratch, out);
        let line = [&self.jacobian[..], &self.noise[..]];
        out.is_barely_definite() && correct_by_root(prior, line, innovation, scratch, out).is_ok()
    }
}

/// The posterior of an innovation, by the root of the prior's covariance, from H (m×n) and R (m×m), row by row.
pub(crate) fn correct_by_root(
    prior: &Gaussian,
    [jacobian, noise]: [&[f64]; 2],
    innovation: &[f64],
    scratch: &mut Scratch,
    out: &mut Gaussian,
) -> Result<()> {
    let (n, m) = (prior.dim(), innovation.len());
    let mut rooted = MeasurementPrediction::sized(n, m);
    rooted.jacobian.copy_from_slice(jacobian);
    rooted.noise.copy_from_slice(noise);
    rooted.sparse.set(n, jacobian);
    let mut root = MeasuredRoot::default();
    root.factor = root_of(&prior.cov)?;
    root.noise.resize(m * m, 0.0);
    set_noise_root(noise, &mut root.noise)?;
    for row in root.factor.chunks_exact(n.max(1)) {
        root.seen.extend((0..m).map(|i| rooted.sparse.row_dot(i, row)));
    }
    rooted.root = Some(Box::new(root));
    rooted.prepare(prior.cov.as_slice())?;
    rooted.posterior_into(prior.into(), innovation, scratch, out);
    round_up(out);
    Ok(())
}

/// Adds to the variances what 16 digits cannot hold of a barely definite Uᵀ U, so that it is positive definite as a matrix too.
fn round_up(state: &mut Gaussian) {
    if state.is_barely_definite() {
        let (n, cov) = (state.mean.len(), state.cov.as_mut_slice());
        let rounding = 4.0 * n as f64 * f64::EPSILON;
        cov.iter_mut()
            .step_by(n + 1)
            .for_each(|variance| *variance *= 1.0 + rounding);
    }
}

/// A factor of a covariance or, where it was given with an indefinite part, of the semidefinite matrix nearest to it.
fn root_of(cov: &DMatrix<f64>) -> Result<Vec<f64>> {
    if let Ok(Some(factor)) = factor_of(Form::SquareRoot, cov) {
        return Ok(factor);
    }
    let SymmetricEigen { values, vectors } = symmetric_eigen(cov)?;
    let mut rows = Vec::with_capacity(cov.len());
    for (value, axis) in values.iter().zip(vectors.column_iter()) {
        let length = value.max(0.0).sqrt();
        rows.extend(axis.iter().map(|x| length * x));
    }
    Ok(rows)
}
