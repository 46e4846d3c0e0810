//! A filter run over a whole sequence of one target's measurements.
//!
//! For k = 0..T: predict from the time before to t_k (the first from `initial.time`, dt = 0 allowed), then update with
//! row k of the measurements. A row that is NaN throughout is a prediction only.
//! Without an initial state the run begins where [`super::search`] finds one; rows before that are NaN.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::extended::Rule;
use super::noise::{LimitedMemoryNoise, NoiseMemory, QForm};
use super::run::FilterRun;
use super::runner::Runner;
use super::screen::ChiSquareScreen;
use super::search::{START_ALPHA, Start, Starter};
use super::{extended, kalman};
use crate::error::{Error, Result, require_finite, require_size};
use crate::gaussian::Gaussian;
use crate::model::motion::Augmented;
use crate::model::sensor::check_platform;
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
    /// Which row of the run the first of these is, where they are a piece of it.
    pub first_row: usize,
}

/// A Kalman or extended Kalman filter: one motion, one sensor.
#[derive(Debug, Clone)]
pub struct Filter {
    motion: MotionModel,
    sensor: SensorModel,
    rule: Rule,
    screen: Option<ChiSquareScreen>,
    adapt: Option<LimitedMemoryNoise>,
}

impl Filter {
    /// The extended Kalman filter of these models. The lasting errors of a sensor that has such are estimated with the
    /// target: they stand behind the state of the motion.
    pub fn extended(motion: MotionModel, sensor: SensorModel) -> Result<Self> {
        sensor.check(&motion)?;
        let motion = match sensor.nuisance() {
            Some(nuisance) => MotionModel::Augmented(Box::new(Augmented::new(motion, nuisance))),
            None => motion,
        };
        Ok(Self {
            motion,
            sensor,
            rule: Rule::Once,
            screen: None,
            adapt: None,
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
        self.rule = Rule::Iterated(iterations);
        Ok(self)
    }

    /// The same filter with its noise estimated as it runs; the models' own noise is what it begins with.
    pub fn with_adaptation(mut self, rule: LimitedMemoryNoise) -> Result<Self> {
        rule.check()?;
        if rule.q_form == QForm::Input && self.motion.noise_input(1.0).is_none() {
            return Err(Error::invalid(
                "adapt",
                "given",
                "needs a motion that says how its noise enters, or q_form = \"full\"",
            ));
        }
        self.adapt = Some(rule);
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
        self.rule = Rule::SecondOrder;
        Ok(self)
    }

    /// The screen for gross errors, where one is set.
    pub fn screen(&self) -> Option<&ChiSquareScreen> {
        self.screen.as_ref()
    }

    /// How the sensor is linearised.
    pub fn rule(&self) -> Rule {
        self.rule
    }

    /// An empty memory of the noise estimator, where one is set.
    pub(super) fn new_memory(&self, start: &Gaussian) -> Result<Option<NoiseMemory>> {
        let Some(rule) = self.adapt else {
            return Ok(None);
        };
        let q = match (rule.q_form, self.motion.noise_input(1.0)) {
            (QForm::Input, Some(input)) => input.cov,
            // What a full Q begins with is known with the first step.
            _ => DMatrix::from_element(start.dim(), start.dim(), f64::NAN),
        };
        NoiseMemory::new(rule, start.into(), q, self.sensor.noise()).map(Some)
    }

    /// Size of the motion noise that is estimated; 0 if none is.
    pub(super) fn adapted_dim(&self) -> usize {
        match self.adapt.map(|rule| rule.q_form) {
            None => 0,
            Some(QForm::Full) => self.motion.state_dim(),
            Some(QForm::Input) => self.motion.noise_input(1.0).map_or(0, |input| input.cov.nrows()),
        }
    }

    /// The motion model.
    pub fn motion(&self) -> &MotionModel {
        &self.motion
    }

    /// The sensor model.
    pub fn sensor(&self) -> &SensorModel {
        &self.sensor
    }

    /// The estimate `dt` seconds later.
    pub fn predict(&self, state: &Gaussian, dt: f64, input: Option<&DVector<f64>>) -> Result<Gaussian> {
        require_size("state", self.motion.state_dim(), state.dim())?;
        require_finite("dt", [&dt])?;
        if dt < 0.0 {
            return Err(Error::TimeReversed {
                time: dt,
                previous: 0.0,
            });
        }
        self.require_states("input", input)?;
        let input = input.map(|input| self.complete_input(input));
        Ok(kalman::predict(state, &self.motion, dt, input.as_ref()))
    }

    /// The estimate after one measurement (length m, NaN = not observed), taken from `platform` if the sensor moves.
    pub fn update(
        &self,
        state: &Gaussian,
        measurement: &DVector<f64>,
        platform: Option<&DVector<f64>>,
    ) -> Result<kalman::Update> {
        require_size("state", self.motion.state_dim(), state.dim())?;
        check_platform(&self.sensor, platform)?;
        self.require_possible(measurement.as_slice(), &"")?;
        extended::update(state, &self.sensor, measurement, platform, self.rule)
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
        let m = self.sensor.measurement_dim();
        let flat = flatten("measurement", measurements, m)?;
        let complete = inputs.map(|rows| self.flatten_inputs(rows)).transpose()?;
        let data = Sequence {
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
            run.push_start(self, &start, history);
            from = start.row + 1;
            Runner::new(self, &start.initial)?
        };
        run.reserve(times.len() - from, history);
        runner.advance(&data, from..times.len(), history, &mut run)?;
        Ok(run)
    }

    /// Inputs with or without the lasting errors of the sensor, one after the other.
    fn flatten_inputs(&self, rows: &[DVector<f64>]) -> Result<Vec<f64>> {
        self.require_states("input", rows)?;
        let complete: Vec<_> = rows.iter().map(|row| self.complete_input(row)).collect();
        flatten("input", &complete, self.motion.state_dim())
    }

    /// The search for the start of a run; an error if the models cannot start one.
    pub fn starter(&self) -> Result<Starter<'_>> {
        Starter::new(&self.motion, &self.sensor, START_ALPHA)
    }

    /// The rows of a run up to and with the one that starts it.
    pub fn begun(&self, start: &Start, history: History) -> FilterRun {
        let mut run = FilterRun::of(self);
        run.push_start(self, start, history);
        run
    }

    /// Refuses what no target could cause; a screen finds it by itself.
    fn require_possible(&self, measurement: &[f64], place: &dyn std::fmt::Display) -> Result<()> {
        let Some(i) = self.sensor.impossible(measurement) else {
            return Ok(());
        };
        let name = format!("measurement of channel {i}{place}");
        Err(Error::invalid(
            &name,
            measurement[i],
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
            for (row, measurement) in data.measurements.chunks_exact(m.max(1)).enumerate() {
                self.require_possible(measurement, &format_args!(" at row {}", data.first_row + row))?;
            }
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

/// Vectors of one length, one after the other.
fn flatten(name: &str, rows: &[DVector<f64>], width: usize) -> Result<Vec<f64>> {
    let mut flat = Vec::with_capacity(rows.len() * width);
    for row in rows {
        require_size(name, width, row.len())?;
        flat.extend_from_slice(row.as_slice());
    }
    Ok(flat)
}
