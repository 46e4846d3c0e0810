//! One step of a filter: an estimate in, an estimate out.
//!
//! In Joseph form a result that is nearly singular is made again by the square roots of what it came from, as a run does
//! it (`escalation.rs`); of estimates that are given away as mean and covariance nothing more can be kept.

use nalgebra::DVector;

use super::extended::{self, Method};
use super::kalman::Update;
use super::prediction::{Course, Prediction};
use super::sequence::Filter;
use super::square_root::{Form, factor_of};
use crate::error::{Error, Result, require_finite, require_size};
use crate::gaussian::Gaussian;
use crate::model::Motion;
use crate::model::sensor::check_platform;

impl Filter {
    /// The estimate `dt` seconds later.
    pub fn predict(&self, state: &Gaussian, dt: f64, input: Option<&DVector<f64>>) -> Result<Gaussian> {
        require_size("state", self.motion().state_dim(), state.dim())?;
        require_finite("dt", [&dt])?;
        if dt < 0.0 {
            return Err(Error::TimeReversed {
                time: dt,
                previous: 0.0,
            });
        }
        self.require_states("input", input)?;
        let input = input.map(|input| self.complete_input(input));
        let state = self.in_form(
            |method| self.predict_by(method, state, dt, input.as_ref()),
            |state| state,
        )?;
        state.require_finite("prediction")?;
        Ok(state)
    }

    fn predict_by(&self, method: Method, state: &Gaussian, dt: f64, input: Option<&DVector<f64>>) -> Result<Gaussian> {
        let mut prediction = Prediction::new(self.motion().space(), method.rule, method.form);
        let mut factor = factor_of(method.form, &state.cov)?;
        let mut state = state.clone();
        for step in 0..self.steps() {
            let course = Course {
                motion: self.motion(),
                dt: dt / self.steps() as f64,
                input: input.filter(|_| step + 1 == self.steps()).map(DVector::as_slice),
                noise: None,
            };
            prediction.predict(&state, factor.as_deref(), &course)?;
            state.clone_from(&prediction.state);
            factor = prediction.factor().map(<[f64]>::to_vec);
        }
        Ok(state)
    }

    /// The estimate after one measurement (length m, NaN = not observed), taken from `platform` if the sensor moves.
    pub fn update(
        &self,
        state: &Gaussian,
        measurement: &DVector<f64>,
        platform: Option<&DVector<f64>>,
    ) -> Result<Update> {
        require_size("state", self.motion().state_dim(), state.dim())?;
        check_platform(self.sensor(), platform)?;
        self.require_possible(measurement.as_slice(), None)?;
        let space = self.motion().space();
        let update = self.in_form(
            |method| extended::update_in(space, state, self.sensor(), measurement, platform, method),
            |update| &update.posterior,
        )?;
        update.posterior.require_finite("estimate")?;
        Ok(update)
    }

    /// What a step gives in the filter's form or, where that is nearly singular, by square roots.
    fn in_form<T>(&self, step: impl Fn(Method) -> Result<T>, estimate: impl Fn(&T) -> &Gaussian) -> Result<T> {
        let given = step(*self.method())?;
        if !(self.escalates() && estimate(&given).is_nearly_singular()) {
            return Ok(given);
        }
        if self.strict() {
            let event = "escalated: the covariance is nearly singular".into();
            return Err(Error::Strict { event });
        }
        let form = Form::SquareRoot;
        Ok(step(Method { form, ..*self.method() }).unwrap_or(given))
    }
}
