//! A filter run over a whole sequence of one target's measurements.
//!
//! For k = 0..T: predict from the time before to t_k (the first from `initial.time`, dt = 0 allowed), then update with
//! row k of the measurements. A row that is NaN throughout is a prediction only.
//! Without an initial state the run begins where [`super::search`] finds one; rows before that are NaN.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::adaptation::{Adaptation, NoiseRule};
use super::complete::flatten;
use super::extended::{Method, Rule};
use super::lead::Lead;
use super::run::FilterRun;
use super::runner::Runner;
use super::screen::ChiSquareScreen;
use super::search::{START_ALPHA, Start, Starter};
use super::sigma_points::SigmaPoints;
use super::square_root::Form;
use crate::error::{Error, Result, require_finite, require_non_negative, require_size};
use crate::gaussian::Gaussian;
use crate::model::motion::{Augmented, RigidBody};
use crate::model::{Motion, MotionModel, Sensor, SensorModel};

/// The estimate to begin with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InitialState {
    /// When it holds, seconds.
    pub time: f64,
    /// The estimate.
    pub state: Gaussian,
}

/// How much of a run is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum History {
    /// Predicted and filtered estimates at every time, and what smoothing needs besides.
    #[default]
    Full,
    /// Filtered estimates at every time.
    Filtered,
    /// The last filtered estimate.
    Last,
}

/// The measurements of a run.
#[derive(Debug, Clone, Copy)]
pub struct Sequence<'a> {
    /// T times, seconds, not decreasing.
    pub times: &'a [f64],
    /// T measurements of length m, one after the other; NaN = not observed.
    pub measurements: &'a [f64],
    /// T vectors of length n, each added to the state predicted to its time.
    pub inputs: Option<&'a [f64]>,
    /// T times by which to predict ahead after each measurement, seconds, as [`Lead::seconds`] gives them.
    pub leads: Option<&'a [f64]>,
    /// Which row of the run the first of these is, where they are a piece of it.
    pub first_row: usize,
}

/// A filter of one motion and one sensor, by any rule.
#[derive(Debug, Clone)]
pub struct Filter {
    motion: MotionModel,
    sensor: SensorModel,
    method: Method,
    steps: usize,
    horizon: Option<f64>,
    screen: Option<ChiSquareScreen>,
    adapt: Option<NoiseRule>,
    strict: bool,
}

impl Filter {
    /// The extended Kalman filter of these models. The lasting errors of a sensor that has such are estimated with the
    /// target: they stand behind the state of the motion. Where the sensor needs a rotation vector in the state, the motion
    /// becomes that of a [`RigidBody`].
    pub fn extended(motion: MotionModel, sensor: SensorModel) -> Result<Self> {
        let motion = RigidBody::if_needed(motion, sensor.attitude())?;
        sensor.check(&motion)?;
        let motion = match sensor.nuisance() {
            Some(nuisance) => MotionModel::Augmented(Box::new(Augmented::new(motion, nuisance))),
            None => motion,
        };
        Ok(Self {
            motion,
            sensor,
            method: Rule::Once.into(),
            steps: 1,
            horizon: None,
            screen: None,
            adapt: None,
            strict: false,
        })
    }

    /// The Kalman filter of these models, which must be linear.
    pub fn kalman(motion: MotionModel, sensor: SensorModel) -> Result<Self> {
        for (name, linear) in [("motion", motion.is_linear()), ("sensor", sensor.is_linear())] {
            if !linear {
                return Err(Error::invalid(
                    name,
                    "a nonlinear model",
                    "must be linear; use ExtendedKalmanFilter",
                ));
            }
        }
        Self::extended(motion, sensor)
    }

    /// The filter that finds the moments of these models by sigma points. Where both are linear and points are drawn again
    /// for each measurement, it is the Kalman filter, and no points are drawn at all.
    pub fn sigma_points(motion: MotionModel, sensor: SensorModel, points: SigmaPoints) -> Result<Self> {
        points.check(motion.state_dim())?;
        let mut filter = Self::extended(motion, sensor)?;
        filter.method.rule = Rule::SigmaPoints(points);
        Ok(filter)
    }

    /// The same filter with its covariances carried in this form.
    pub fn with_form(mut self, form: Form) -> Result<Self> {
        if let (Form::SquareRoot, Rule::SigmaPoints(points)) = (form, self.method.rule) {
            let refused = |requirement: &str| Err(Error::invalid("form", "square_root", requirement));
            if !points.redraws() {
                return refused("does not go with redraw=False: its covariance is a difference");
            }
            if !points.is_definite(self.motion.state_dim()) {
                return refused(
                    "needs covariances that are sums of squares: kappa must not be negative, or beta not too small",
                );
            }
        }
        self.method.form = form;
        Ok(self)
    }

    /// The same filter with each prediction taken in so many equal steps, the points drawn anew for each.
    pub fn with_steps(mut self, steps: usize) -> Result<Self> {
        if steps == 0 {
            return Err(Error::invalid("steps", 0, "must be at least 1"));
        }
        self.steps = steps;
        self.check_steps()?;
        Ok(self)
    }

    /// The same filter with leads of at most `horizon` seconds.
    pub fn with_horizon(mut self, horizon: f64) -> Result<Self> {
        require_non_negative("horizon", horizon)?;
        self.horizon = Some(horizon);
        Ok(self)
    }

    fn check_steps(&self) -> Result<()> {
        if self.steps > 1 && matches!(self.adapt, Some(NoiseRule::LimitedMemory(_))) {
            let requirement = "must be 1 with LimitedMemoryNoise, which estimates the noise of a whole step";
            return Err(Error::invalid("steps", self.steps, requirement));
        }
        Ok(())
    }

    /// The same filter with a screen for gross errors.
    #[must_use]
    pub fn with_screen(mut self, screen: ChiSquareScreen) -> Self {
        self.screen = Some(screen);
        self
    }

    /// The same filter with at most so many linearisations of the sensor per measurement (see [`super::extended`]).
    pub fn with_iterations(mut self, iterations: usize) -> Result<Self> {
        if iterations == 0 {
            return Err(Error::invalid("iterations", 0, "must be at least 1"));
        }
        self.method.rule = Rule::Iterated(iterations);
        Ok(self)
    }

    /// The same filter with its noise estimated as it runs; the models' own noise is what it begins with.
    pub fn with_adaptation(mut self, rule: impl Into<NoiseRule>) -> Result<Self> {
        let rule = rule.into();
        rule.check(&self.motion)?;
        self.adapt = Some(rule);
        self.check_steps()?;
        Ok(self)
    }

    /// The same filter with the curvature of the sensor in its updates; an error if the sensor does not give it.
    pub fn with_second_order(mut self) -> Result<Self> {
        let unknown = Gaussian {
            mean: DVector::from_element(self.motion.state_dim(), 1.0),
            cov: DMatrix::identity(self.motion.state_dim(), self.motion.state_dim()),
        };
        if self.sensor.curvature(&unknown).is_none() {
            let requirement = "needs a sensor that gives its curvature, such as RangeArray";
            return Err(Error::invalid("second_order", true, requirement));
        }
        self.method.rule = Rule::SecondOrder;
        Ok(self)
    }

    /// The same filter with the first event of a run an error.
    #[must_use]
    pub fn with_strict(mut self) -> Self {
        self.strict = true;
        self
    }

    /// Whether the first event of a run is an error.
    pub fn strict(&self) -> bool {
        self.strict
    }

    /// Whether covariances that come close to being singular go on as square roots: those of the Joseph form do, where
    /// [`Self::with_form`] would allow it.
    pub(super) fn escalates(&self) -> bool {
        let allowed = match self.method.rule {
            Rule::SigmaPoints(points) => points.redraws() && points.is_definite(self.motion.state_dim()),
            _ => true,
        };
        allowed && self.method.form == Form::Joseph
    }

    /// The screen for gross errors, where one is set.
    pub fn screen(&self) -> Option<&ChiSquareScreen> {
        self.screen.as_ref()
    }

    /// How moments are found and covariances carried.
    pub fn method(&self) -> &Method {
        &self.method
    }

    /// Steps of each prediction.
    pub(super) fn steps(&self) -> usize {
        self.steps
    }

    /// Longest lead, seconds, where there is a limit.
    pub fn horizon(&self) -> Option<f64> {
        self.horizon
    }

    /// An empty memory of the noise estimator, where one is set.
    pub(super) fn new_memory(&self, start: &Gaussian) -> Result<Option<Adaptation>> {
        let begin = |rule: NoiseRule| rule.begin(&self.motion, &self.sensor, start);
        self.adapt.map(begin).transpose()
    }

    /// Whether any noise is estimated, of the motion or of the sensor.
    pub(super) fn adapts(&self) -> bool {
        self.adapt.is_some()
    }

    /// Size of the motion noise that is estimated; 0 if none is.
    pub(super) fn adapted_dim(&self) -> usize {
        self.adapt.map_or(0, |rule| rule.dim(&self.motion))
    }

    /// The motion model.
    pub fn motion(&self) -> &MotionModel {
        &self.motion
    }

    /// The sensor model.
    pub fn sensor(&self) -> &SensorModel {
        &self.sensor
    }

    /// Runs over T times and measurements; `inputs`, where given, are T vectors added to the predicted states.
    /// Without `initial` the run starts itself, if the sensor can fix positions.
    pub fn run(
        &self,
        times: &[f64],
        measurements: &[DVector<f64>],
        initial: Option<&InitialState>,
        inputs: Option<&[DVector<f64>]>,
        history: History,
    ) -> Result<FilterRun> {
        self.run_ahead(times, measurements, initial, inputs, None, history)
    }

    /// The same, with a prediction ahead after every measurement ([`super::lead`]).
    pub fn run_ahead(
        &self,
        times: &[f64],
        measurements: &[DVector<f64>],
        initial: Option<&InitialState>,
        inputs: Option<&[DVector<f64>]>,
        lead: Option<&Lead>,
        history: History,
    ) -> Result<FilterRun> {
        let m = self.sensor.measurement_dim();
        let flat = flatten("measurement", measurements, m)?;
        let complete = inputs.map(|rows| self.flatten_inputs(rows)).transpose()?;
        let leads = lead.map(|lead| lead.seconds(times, self.horizon)).transpose()?;
        let data = Sequence {
            leads: leads.as_deref(),
            times,
            measurements: &flat,
            inputs: complete.as_deref(),
            first_row: 0,
        };
        self.check(&data, initial)?;
        let mut run = FilterRun::of(self);
        let mut from = 0;
        let mut runner = if let Some(initial) = initial {
            Runner::new(self, initial)?
        } else {
            let mut starter = self.starter()?;
            let Some(start) = starter.search(times, measurements, inputs)? else {
                return Err(starter.failure());
            };
            run.push_start(self, &start, history, leads.is_some())?;
            from = start.row + 1;
            let mut runner = Runner::new(self, &start.initial)?;
            if let Some(leads) = &leads {
                runner.look_ahead(leads[start.row], history, &mut run)?;
            }
            runner
        };
        run.reserve(times.len() - from, history);
        runner.advance(&data, from..times.len(), history, &mut run)?;
        Ok(run)
    }

    /// The search for the start of a run; an error if the models cannot start one.
    pub fn starter(&self) -> Result<Starter<'_>> {
        Starter::new(&self.motion, &self.sensor, START_ALPHA)
    }

    /// The rows of a run up to and with the one that starts it.
    /// With `leads`, that one's prediction ahead is still to come: [`Runner::look_ahead`].
    pub fn begun(&self, start: &Start, history: History, leads: bool) -> Result<FilterRun> {
        let mut run = FilterRun::of(self);
        run.push_start(self, start, history, leads)?;
        Ok(run)
    }

    /// Refuses what no target could cause, in measurements of the rows from `first_row` on, where these are rows; a screen finds
    /// it by itself.
    pub(super) fn require_possible(&self, measurements: &[f64], first_row: Option<usize>) -> Result<()> {
        let Some(i) = self.sensor.impossible(measurements) else {
            return Ok(());
        };
        let m = self.sensor.measurement_dim();
        let place = first_row.map_or_else(String::new, |first| format!(" at row {}", first + i / m));
        Err(Error::invalid(
            &format!("measurement of channel {}{place}", i % m),
            measurements[i],
            "must not be negative; a filter with a screen rejects such a value and goes on",
        ))
    }

    /// Whether a run of these would be accepted.
    pub fn check(&self, data: &Sequence<'_>, initial: Option<&InitialState>) -> Result<()> {
        let (n, m) = (self.motion.state_dim(), self.sensor.measurement_dim());
        let count = data.times.len();
        require_finite("times", data.times)?;
        require_size("measurements", count * m, data.measurements.len())?;
        if let Some(initial) = initial {
            require_finite("initial time", [&initial.time])?;
            self.require_states("initial state", [&initial.state.mean])?;
        }
        if let Some(inputs) = data.inputs {
            require_size("inputs", count * n, inputs.len())?;
            require_finite("input", inputs)?;
        }
        if self.screen.is_none() {
            self.require_possible(data.measurements, Some(data.first_row))?;
        }
        let mut previous = initial.map_or(f64::NEG_INFINITY, |i| i.time);
        for &time in data.times {
            if time < previous {
                return Err(Error::TimeReversed { time, previous });
            }
            previous = time;
        }
        Ok(())
    }
}
