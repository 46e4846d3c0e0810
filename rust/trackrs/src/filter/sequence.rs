//! A filter run over a whole sequence of one target's measurements.
//!
//! For k = 0..T: predict from the time before to t_k (the first from `initial.time`, dt = 0 allowed), then update with
//! row k of the measurements. A row that is NaN throughout is a prediction only.
//! Without an initial state the run begins where [`super::search`] finds one; rows before that are NaN.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::noise::{LimitedMemoryNoise, NoiseMemory};
use super::runner::{EpochResult, Runner};
use super::screen::{ChiSquareScreen, Screened, Verdict};
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

/// Everything a run gives. Sequences have one element per kept time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FilterRun {
    /// Estimates after the measurement.
    pub filtered: Vec<Gaussian>,
    /// Estimates before it; only with [`History::Full`].
    pub predicted: Vec<Gaussian>,
    /// F of the step to every time, from the time before or, at the first, from the initial state; n×n each, only with
    /// [`History::Full`].
    pub transitions: Vec<DMatrix<f64>>,
    /// Q of the same steps.
    pub motion_noises: Vec<DMatrix<f64>>,
    /// Innovations, length m each, NaN where not observed.
    pub innovations: Vec<DVector<f64>>,
    /// Innovation covariances, m×m each.
    pub innovation_covs: Vec<DMatrix<f64>>,
    /// Normalised innovation squared of every row; NaN where nothing was observed.
    pub nis: Vec<f64>,
    /// Observed components of every row.
    pub dof: Vec<usize>,
    /// Verdict on every component of every row, with its test; only with a screen.
    pub screened: Vec<Screened>,
    /// Q of the noise estimator in force after every row, d×d; only with one.
    pub q_hat: Vec<DMatrix<f64>>,
    /// R in force after every row, m×m; only with a noise estimator.
    pub r_hat: Vec<DMatrix<f64>>,
    /// Rows at which the filter started anew after a lock-out.
    pub restarts: Vec<usize>,
    /// Sum of the log-likelihoods of all rows.
    pub log_likelihood: f64,
    /// First row of the run with an estimate: 0 when an initial state was given. Rows before it are NaN.
    pub start: usize,
}

impl FilterRun {
    /// Adds what one epoch gave, row `row` of the run.
    pub(super) fn push(&mut self, row: usize, epoch: EpochResult, memory: Option<&NoiseMemory>, history: History) {
        if history == History::Last {
            self.forget();
        }
        let update = epoch.update;
        if update.dof > 0 && !epoch.restarted {
            self.log_likelihood += update.log_likelihood;
        }
        if history == History::Full {
            self.predicted.push(epoch.prediction.state);
            self.transitions.push(epoch.prediction.transition);
            self.motion_noises.push(epoch.prediction.noise);
        }
        if epoch.restarted {
            self.restarts.push(row);
        }
        self.filtered.push(update.posterior);
        self.innovations.push(update.innovation);
        self.innovation_covs.push(update.innovation_cov);
        self.nis.push(if update.dof > 0 { update.nis } else { f64::NAN });
        self.dof.push(update.dof);
        self.screened.extend(epoch.screened);
        if let Some(memory) = memory {
            self.q_hat.push(memory.q().clone());
            self.r_hat.push(memory.r().clone());
        }
    }

    fn forget(&mut self) {
        self.filtered.clear();
        self.innovations.clear();
        self.innovation_covs.clear();
        self.nis.clear();
        self.dof.clear();
        self.screened.clear();
        self.q_hat.clear();
        self.r_hat.clear();
    }
}

/// The measurements of a run.
#[derive(Debug, Clone, Copy)]
pub struct Sequence<'a> {
    /// T times, seconds, not decreasing.
    pub times: &'a [f64],
    /// T measurements, length m each, NaN = not observed.
    pub measurements: &'a [DVector<f64>],
    /// T vectors of length n (or without the lasting errors of the sensor), each added to the state predicted to its time.
    pub inputs: Option<&'a [DVector<f64>]>,
}

/// A Kalman or extended Kalman filter: one motion, one sensor.
#[derive(Debug, Clone)]
pub struct Filter {
    motion: MotionModel,
    sensor: SensorModel,
    screen: Option<ChiSquareScreen>,
    adapt: Option<LimitedMemoryNoise>,
    second_order: bool,
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
            screen: None,
            adapt: None,
            second_order: false,
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

    /// The same filter with its noise estimated as it runs; the models' own noise is what it begins with.
    pub fn with_adaptation(mut self, rule: LimitedMemoryNoise) -> Result<Self> {
        rule.check()?;
        if self.motion.noise_input(1.0).is_none() {
            return Err(Error::invalid(
                "adapt",
                "given",
                "needs a motion whose noise is constant over a step (accel_std=, jerk_std=) or a LinearMotion",
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
        self.second_order = true;
        Ok(self)
    }

    /// Linearises the sensor at a state, with this noise.
    pub(super) fn linearise(
        &self,
        state: &Gaussian,
        platform: Option<&DVector<f64>>,
        noise: DMatrix<f64>,
    ) -> Result<extended::Linearised> {
        let linearise = if self.second_order {
            extended::linearise_second_order
        } else {
            extended::linearise_with_noise
        };
        linearise(state, &self.sensor, platform, noise)
    }

    /// The screen for gross errors, where one is set.
    pub fn screen(&self) -> Option<&ChiSquareScreen> {
        self.screen.as_ref()
    }

    /// An empty memory of the noise estimator, where one is set.
    pub(super) fn new_memory(&self, start: &Gaussian) -> Result<Option<NoiseMemory>> {
        let (Some(rule), Some(entry)) = (self.adapt, self.motion.noise_input(1.0)) else {
            return Ok(None);
        };
        NoiseMemory::new(rule, start.clone(), entry.cov, self.sensor.noise()).map(Some)
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
        self.linearise(state, platform, self.sensor.noise())?
            .update(state, &self.sensor, measurement)
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
        self.check(times, measurements, initial, inputs)?;
        let data = Sequence {
            times,
            measurements,
            inputs,
        };
        let mut run = FilterRun::default();
        let mut from = 0;
        let mut runner = if let Some(initial) = initial {
            Runner::new(self, initial)?
        } else {
            let mut starter = self.starter()?;
            let Some(start) = starter.search(times, measurements, inputs)? else {
                return Err(starter.failure());
            };
            run = self.begun(&start, history);
            from = start.row + 1;
            Runner::new(self, &start.initial)?
        };
        runner.advance(&data, from..times.len(), history, &mut run)?;
        Ok(run)
    }

    /// The search for the start of a run; an error if the models cannot start one.
    pub fn starter(&self) -> Result<Starter<'_>> {
        Starter::new(&self.motion, &self.sensor, START_ALPHA)
    }

    /// The rows of a run up to and with the one that starts it.
    pub fn begun(&self, start: &Start, history: History) -> FilterRun {
        let (n, m) = (self.motion.state_dim(), self.sensor.measurement_dim());
        let unknown = Gaussian {
            mean: DVector::from_element(n, f64::NAN),
            cov: DMatrix::from_element(n, n, f64::NAN),
        };
        let rows = if history == History::Last { 1 } else { start.row + 1 };
        let mut run = FilterRun {
            filtered: vec![unknown.clone(); rows - 1],
            innovations: vec![DVector::from_element(m, f64::NAN); rows],
            innovation_covs: vec![DMatrix::from_element(m, m, f64::NAN); rows],
            nis: vec![f64::NAN; rows],
            dof: vec![0; rows],
            start: start.row,
            ..FilterRun::default()
        };
        run.filtered.push(start.initial.state.clone());
        if self.screen.is_some() {
            let untested = Screened {
                verdicts: vec![Verdict::Missing; m],
                statistic: f64::NAN,
                dof: 0,
                p_value: f64::NAN,
            };
            run.screened = vec![untested; rows];
        }
        if let Ok(Some(memory)) = self.new_memory(&start.initial.state) {
            run.q_hat = vec![memory.q().clone(); rows];
            run.r_hat = vec![memory.r().clone(); rows];
        }
        if history == History::Full {
            run.predicted = vec![unknown; rows];
            run.transitions = vec![DMatrix::identity(n, n); rows];
            run.motion_noises = vec![DMatrix::zeros(n, n); rows];
        }
        run
    }

    /// Whether a run of these would be accepted.
    pub fn check(
        &self,
        times: &[f64],
        measurements: &[DVector<f64>],
        initial: Option<&InitialState>,
        inputs: Option<&[DVector<f64>]>,
    ) -> Result<()> {
        require_finite("times", times)?;
        require_size("measurements", times.len(), measurements.len())?;
        if let Some(initial) = initial {
            require_finite("initial time", [&initial.time])?;
            self.require_states("initial state", [&initial.state.mean])?;
        }
        for row in measurements {
            require_size("measurement", self.sensor.measurement_dim(), row.len())?;
        }
        if let Some(inputs) = inputs {
            require_size("inputs", times.len(), inputs.len())?;
            self.require_states("input", inputs)?;
            for row in inputs {
                require_finite("input", row.iter())?;
            }
        }
        let mut previous = initial.map_or(f64::NEG_INFINITY, |i| i.time);
        for &time in times {
            if time < previous {
                return Err(Error::TimeReversed { time, previous });
            }
            previous = time;
        }
        Ok(())
    }
}
