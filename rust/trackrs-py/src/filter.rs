//! Filters over one sequence.

use std::time::{Duration, Instant};

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trackrs::error::require_size;
use trackrs::filter::nis_noise::NisScaledNoise;
use trackrs::filter::run::FilterRun;
use trackrs::filter::runner::Runner;
use trackrs::filter::screen::{ChiSquareScreen, ScreenMode};
use trackrs::filter::sequence::{self, History, InitialState};
use trackrs::filter::sigma_points::SigmaPoints;
use trackrs::filter::square_root::Form;
use trackrs::model::{Motion as _, Sensor as _};

use crate::array;
use crate::error::{compute, count, to_python};
use crate::given::Given;
use crate::model::{Motion, Sensor};
use crate::options;
use crate::run::Run;

/// Work between two looks for Ctrl-C, and rows before the first look at the clock.
const CHUNK: Duration = Duration::from_millis(50);
const ROWS: usize = 16;
/// Where rows last less than this between two looks, twice as many go before the next one.
const SHORT: Duration = Duration::from_millis(1);
/// Rows copied at once.
const PIECE: usize = 1024;

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Filter {
    pub(crate) filter: sequence::Filter,
}

/// Mean and covariance.
type Moments<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// Time, mean and covariance.
type Initial<'py> = (f64, PyReadonlyArray1<'py, f64>, PyReadonlyArray2<'py, f64>);

/// What an update gives.
#[derive(IntoPyObject)]
pub(crate) struct Update<'py> {
    mean: Bound<'py, PyArray1<f64>>,
    cov: Bound<'py, PyArray2<f64>>,
    innovation: Bound<'py, PyArray1<f64>>,
    innovation_cov: Bound<'py, PyArray2<f64>>,
    whitened: Bound<'py, PyArray1<f64>>,
    nis: f64,
    dof: usize,
    log_likelihood: f64,
}

#[pymethods]
impl Filter {
    #[staticmethod]
    fn kalman(py: Python<'_>, motion: &Motion, sensor: &Sensor) -> PyResult<Self> {
        let filter = compute(py, || {
            sequence::Filter::kalman(motion.model.clone(), sensor.model.clone())
        })?;
        Ok(Self { filter })
    }

    #[staticmethod]
    fn extended(py: Python<'_>, motion: &Motion, sensor: &Sensor, iterations: i64) -> PyResult<Self> {
        let filter = compute(py, || {
            let iterations = count("iterations", iterations)?;
            sequence::Filter::extended(motion.model.clone(), sensor.model.clone())?.with_iterations(iterations)
        })?;
        Ok(Self { filter })
    }

    /// The same filter with the curvature of the sensor in its updates.
    fn with_second_order(&self, py: Python<'_>) -> PyResult<Self> {
        let filter = compute(py, || self.filter.clone().with_second_order())?;
        Ok(Self { filter })
    }

    /// Unscented, scaled where alpha is given; cubature is kappa = 0.
    #[staticmethod]
    fn sigma_points(
        py: Python<'_>,
        motion: &Motion,
        sensor: &Sensor,
        kappa: f64,
        scale: Option<(f64, f64)>,
        redraw: bool,
    ) -> PyResult<Self> {
        let filter = compute(py, || {
            let points = match scale {
                Some((alpha, beta)) => SigmaPoints::scaled(alpha, beta, kappa)?,
                None => SigmaPoints::unscented(kappa),
            };
            let points = if redraw { points } else { points.carried() };
            sequence::Filter::sigma_points(motion.model.clone(), sensor.model.clone(), points)
        })?;
        Ok(Self { filter })
    }

    /// The same filter with its covariances carried in another form.
    fn with_form(&self, py: Python<'_>, form: &str) -> PyResult<Self> {
        let filter = compute(py, || {
            let form = match form {
                "joseph" => Form::Joseph,
                "square_root" => Form::SquareRoot,
                other => {
                    let requirement = "must be joseph or square_root";
                    return Err(trackrs::Error::invalid("form", other, requirement));
                }
            };
            self.filter.clone().with_form(form)
        })?;
        Ok(Self { filter })
    }

    /// The same filter with the first event of a run an error.
    fn with_strict(&self) -> Self {
        Self {
            filter: self.filter.clone().with_strict(),
        }
    }

    /// The same filter with each prediction in so many steps.
    fn with_steps(&self, py: Python<'_>, steps: i64) -> PyResult<Self> {
        let filter = compute(py, || self.filter.clone().with_steps(count("steps", steps)?))?;
        Ok(Self { filter })
    }

    /// The same filter with a longest lead, seconds.
    fn with_horizon(&self, py: Python<'_>, horizon: f64) -> PyResult<Self> {
        let filter = compute(py, || self.filter.clone().with_horizon(horizon))?;
        Ok(Self { filter })
    }

    /// The same filter with its noise estimated from residuals; `memory` is its name, its window and its factor.
    #[allow(clippy::too_many_arguments)]
    fn with_residual_noise(
        &self,
        py: Python<'_>,
        memory: (String, i64, f64),
        r: &str,
        q: Option<&str>,
        r_limits: (f64, f64),
        q_floor: f64,
        diagonal: bool,
        first_epoch: i64,
    ) -> PyResult<Self> {
        let filter = compute(py, || {
            let rule = options::residual_noise(&memory, r, q, r_limits, q_floor, diagonal, first_epoch)?;
            self.filter.clone().with_adaptation(rule)
        })?;
        Ok(Self { filter })
    }

    /// The same filter with its motion noise scaled by the innovations.
    fn with_nis_noise(&self, py: Python<'_>, psd_limits: [f64; 2], eta: f64, cap: f64) -> PyResult<Self> {
        let rule = NisScaledNoise { psd_limits, eta, cap };
        let filter = compute(py, || self.filter.clone().with_adaptation(rule))?;
        Ok(Self { filter })
    }

    /// The same filter with a screen for gross errors.
    #[pyo3(signature = (alpha, mode, restart, allowance=None))]
    fn with_screen(
        &self,
        py: Python<'_>,
        alpha: f64,
        mode: &str,
        restart: bool,
        allowance: Option<f64>,
    ) -> PyResult<Self> {
        let screen = compute(py, || {
            let mode = match mode {
                "vector" => ScreenMode::Vector,
                "component" => ScreenMode::Component,
                "snoop" => ScreenMode::Snoop,
                other => {
                    return Err(trackrs::Error::invalid(
                        "mode",
                        other,
                        "must be vector, component or snoop",
                    ));
                }
            };
            let screen = ChiSquareScreen::new(alpha, mode, allowance)?;
            Ok(if restart { screen } else { screen.without_restart() })
        })?;
        Ok(Self {
            filter: self.filter.clone().with_screen(screen),
        })
    }

    /// The same filter with its noise estimated; limits as (lowest, highest) eigenvalue.
    #[allow(clippy::too_many_arguments)]
    fn with_adaptation(
        &self,
        py: Python<'_>,
        window: i64,
        r_window: Option<i64>,
        method: &str,
        forms: (String, String),
        first_epoch: i64,
        q_limits: (f64, f64),
        r_limits: (f64, f64),
    ) -> PyResult<Self> {
        let filter = compute(py, || {
            let rule = options::limited_memory(window, r_window, method, &forms, first_epoch, [q_limits, r_limits])?;
            self.filter.clone().with_adaptation(rule)
        })?;
        Ok(Self { filter })
    }

    /// Names of the state's components.
    #[getter]
    fn labels(&self) -> Vec<String> {
        self.filter.motion().labels()
    }

    /// Whether a run needs no initial state.
    #[getter]
    fn starts(&self) -> bool {
        self.filter.sensor().position_fix().is_some()
    }

    #[pyo3(signature = (mean, cov, dt, known=None))]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        mean: PyReadonlyArray1<'py, f64>,
        cov: PyReadonlyArray2<'py, f64>,
        dt: f64,
        known: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Moments<'py>> {
        let state = array::gaussian(&mean, &cov)?;
        let input = known.map(|u| array::vector(&u, "input")).transpose()?;
        let out = compute(py, || self.filter.predict(&state, dt, input.as_ref()))?;
        Ok((array::from_vector(py, &out.mean), array::from_matrix(py, &out.cov)?))
    }

    #[pyo3(signature = (mean, cov, value, platform=None))]
    fn update<'py>(
        &self,
        py: Python<'py>,
        mean: PyReadonlyArray1<'py, f64>,
        cov: PyReadonlyArray2<'py, f64>,
        value: PyReadonlyArray1<'py, f64>,
        platform: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Update<'py>> {
        let state = array::gaussian(&mean, &cov)?;
        let value = array::vector(&value, "value")?;
        let platform = platform.map(|p| array::vector(&p, "platform")).transpose()?;
        let out = compute(py, || self.filter.update(&state, &value, platform.as_ref()))?;
        Ok(Update {
            mean: array::from_vector(py, &out.posterior.mean),
            cov: array::from_matrix(py, &out.posterior.cov)?,
            innovation: array::from_vector(py, &out.innovation),
            innovation_cov: array::from_matrix(py, &out.innovation_cov)?,
            whitened: array::from_vector(py, &out.whitened),
            nis: out.nis,
            dof: out.dof,
            log_likelihood: out.log_likelihood,
        })
    }

    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (times, values, initial, history, inputs=None, lead=None))]
    fn run<'py>(
        &self,
        py: Python<'py>,
        times: PyReadonlyArray1<'py, f64>,
        values: PyReadonlyArray2<'py, f64>,
        initial: Option<Initial<'py>>,
        history: &str,
        inputs: Option<PyReadonlyArray2<'py, f64>>,
        lead: Option<options::Lead>,
    ) -> PyResult<Run<'py>> {
        let times_given = array::c_slice(&times, "times")?;
        let leads = lead
            .map(|lead| lead.seconds(times_given, self.filter.horizon()))
            .transpose();
        let leads = leads.map_err(|error| to_python(py, &error))?;
        let (n, m) = (self.filter.motion().state_dim(), self.filter.sensor().measurement_dim());
        require_width(py, "measurement", m, values.shape()[1])?;
        let inputs = inputs.map(|inputs| self.complete_inputs(py, &inputs, n)).transpose()?;
        let given = Given {
            leads: leads.as_deref(),
            times: times_given,
            values: array::c_slice(&values, "values")?,
            inputs: inputs.as_deref(),
        };
        let initial = initial.map(|(time, mean, cov)| {
            let state = array::gaussian(&mean, &cov)?;
            Ok::<_, PyErr>(InitialState { time, state })
        });
        let initial = initial.transpose()?;
        let history = match history {
            "full" => History::Full,
            "filtered" => History::Filtered,
            "last" => History::Last,
            other => {
                let error = trackrs::Error::invalid("history", other, "must be full, filtered or last");
                return Err(crate::error::to_python(py, &error));
            }
        };
        let whole = given.piece(0..given.times.len(), m, n);
        let checked = self.filter.check(&whole.sequence(), initial.as_ref());
        checked.map_err(|error| to_python(py, &error))?;
        drop(whole);
        let (initial, mut run, begin) = if let Some(initial) = initial {
            (initial, FilterRun::of(&self.filter), 0)
        } else {
            let start = given.find_start(py, &self.filter, n)?;
            let run = self.filter.begun(&start, history, leads.is_some());
            let run = run.map_err(|error| to_python(py, &error))?;
            (start.initial, run, start.row + 1)
        };
        run.reserve(given.times.len() - begin, history);
        let mut runner = compute(py, || Runner::new(&self.filter, &initial))?;
        if let (Some(leads), 1..) = (&leads, begin) {
            compute(py, || runner.look_ahead(leads[begin - 1], history, &mut run))?;
        }
        let (mut row, mut rows) = (begin, ROWS);
        while row < given.times.len() {
            // A copy, because another thread may write to the arrays while the interpreter is released.
            let piece = given.piece(row..(row + PIECE).min(given.times.len()), m, n);
            let data = piece.sequence();
            let mut done = 0;
            while done < data.times.len() {
                compute(py, || {
                    let (begun, mut looked) = (Instant::now(), Duration::ZERO);
                    while done < data.times.len() && looked < CHUNK {
                        let part = done..(done + rows).min(data.times.len());
                        done = part.end;
                        runner.advance(&data, part, history, &mut run)?;
                        let now = begun.elapsed();
                        rows = next_rows(rows, now.saturating_sub(looked));
                        looked = now;
                    }
                    Ok(())
                })?;
                py.check_signals()?;
            }
            row += data.times.len();
        }
        drop(runner);
        Run::new(py, run)
    }
}

/// Rows until the next look at the clock, after so many that lasted so long.
fn next_rows(rows: usize, lasted: Duration) -> usize {
    if lasted < SHORT {
        (2 * rows).min(PIECE)
    } else if lasted > CHUNK {
        1
    } else {
        rows
    }
}

fn require_width(py: Python<'_>, name: &str, expected: usize, found: usize) -> PyResult<()> {
    require_size(name, expected, found).map_err(|error| to_python(py, &error))
}

impl Filter {
    /// T×n inputs; those that leave out the lasting errors of the sensor with zeros in their place.
    fn complete_inputs(&self, py: Python<'_>, inputs: &PyReadonlyArray2<'_, f64>, n: usize) -> PyResult<Vec<f64>> {
        let width = inputs.shape()[1];
        if width != self.filter.kinematic_dim() {
            require_width(py, "input", n, width)?;
        }
        let flat = array::c_slice(inputs, "inputs")?;
        let mut complete = vec![0.0; inputs.shape()[0] * n];
        for (to, from) in complete.chunks_exact_mut(n).zip(flat.chunks_exact(width)) {
            to[..width].copy_from_slice(from);
        }
        Ok(complete)
    }
}
