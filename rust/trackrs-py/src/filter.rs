//! Filters over one sequence.

use std::time::{Duration, Instant};

use nalgebra::{DMatrix, DVector};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use trackrs::Gaussian;
use trackrs::filter::noise::{EigenLimits, LimitedMemoryNoise, NoiseMethod};
use trackrs::filter::runner::Runner;
use trackrs::filter::screen::{ChiSquareScreen, ScreenMode, Verdict};
use trackrs::filter::search::Start;
use trackrs::filter::sequence::{self, FilterRun, History, InitialState, Sequence};
use trackrs::model::{Motion as _, Sensor as _};

use crate::array;
use crate::error::{compute, count, to_python};
use crate::model::{Motion, Sensor};

/// Work between two looks for Ctrl-C, and rows between two looks at the clock.
const CHUNK: Duration = Duration::from_millis(50);
const ROWS: usize = 16;
/// The same while a start is sought: a position fix costs tens of updates.
const START_CHUNK: usize = 256;

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Filter {
    filter: sequence::Filter,
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

/// What a run gives.
#[derive(IntoPyObject)]
pub(crate) struct Run<'py> {
    means: Bound<'py, PyArray2<f64>>,
    covs: Bound<'py, PyArray3<f64>>,
    predicted_means: Bound<'py, PyArray2<f64>>,
    predicted_covs: Bound<'py, PyArray3<f64>>,
    transitions: Bound<'py, PyArray3<f64>>,
    motion_noises: Bound<'py, PyArray3<f64>>,
    innovations: Bound<'py, PyArray2<f64>>,
    innovation_covs: Bound<'py, PyArray3<f64>>,
    nis: Bound<'py, PyArray1<f64>>,
    dof: Bound<'py, PyArray1<i64>>,
    /// 0 missing, 1 used, 2 rejected.
    verdicts: Bound<'py, PyArray2<i8>>,
    statistics: Bound<'py, PyArray1<f64>>,
    p_values: Bound<'py, PyArray1<f64>>,
    q_hat: Bound<'py, PyArray3<f64>>,
    r_hat: Bound<'py, PyArray3<f64>>,
    restarts: Vec<usize>,
    log_likelihood: f64,
    start: usize,
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
    fn extended(py: Python<'_>, motion: &Motion, sensor: &Sensor) -> PyResult<Self> {
        let filter = compute(py, || {
            sequence::Filter::extended(motion.model.clone(), sensor.model.clone())
        })?;
        Ok(Self { filter })
    }

    /// The same filter with the curvature of the sensor in its updates.
    fn with_second_order(&self, py: Python<'_>) -> PyResult<Self> {
        let filter = compute(py, || self.filter.clone().with_second_order())?;
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
    fn with_adaptation(
        &self,
        py: Python<'_>,
        window: i64,
        method: &str,
        first_epoch: i64,
        q_limits: (f64, f64),
        r_limits: (f64, f64),
    ) -> PyResult<Self> {
        let filter = compute(py, || {
            let method = match method {
                "em" => NoiseMethod::Em,
                "map" => NoiseMethod::Map,
                other => return Err(trackrs::Error::invalid("method", other, "must be em or map")),
            };
            let limits = |(min, max): (f64, f64)| EigenLimits { min, max };
            self.filter.clone().with_adaptation(LimitedMemoryNoise {
                window: count("window", window)?,
                method,
                first_epoch: count("first_epoch", first_epoch)?,
                q_limits: limits(q_limits),
                r_limits: limits(r_limits),
            })
        })?;
        Ok(Self { filter })
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
    #[pyo3(signature = (times, values, initial, history, inputs=None))]
    fn run<'py>(
        &self,
        py: Python<'py>,
        times: PyReadonlyArray1<'py, f64>,
        values: PyReadonlyArray2<'py, f64>,
        initial: Option<Initial<'py>>,
        history: &str,
        inputs: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Run<'py>> {
        let times = array::vector(&times, "times")?;
        let values = array::rows(&values, "values")?;
        let inputs = inputs.map(|u| array::rows(&u, "inputs")).transpose()?;
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
        let inputs = inputs.as_deref();
        compute(py, || {
            self.filter.check(times.as_slice(), &values, initial.as_ref(), inputs)
        })?;
        let (initial, mut run, begin) = if let Some(given) = initial {
            (given, FilterRun::default(), 0)
        } else {
            let start = self.find_start(py, times.as_slice(), &values, inputs)?;
            let run = self.filter.begun(&start, history);
            (start.initial, run, start.row + 1)
        };
        let data = Sequence {
            times: times.as_slice(),
            measurements: &values,
            inputs,
        };
        let mut runner = compute(py, || Runner::new(&self.filter, &initial))?;
        let mut row = begin;
        while row < times.len() {
            compute(py, || {
                let begun = Instant::now();
                while row < times.len() && begun.elapsed() < CHUNK {
                    let part = row..(row + ROWS).min(times.len());
                    row = part.end;
                    runner.advance(&data, part, history, &mut run)?;
                }
                Ok(())
            })?;
            py.check_signals()?;
        }
        self.to_python(py, &run)
    }
}

impl Filter {
    fn find_start(
        &self,
        py: Python<'_>,
        times: &[f64],
        values: &[DVector<f64>],
        inputs: Option<&[DVector<f64>]>,
    ) -> PyResult<Start> {
        let mut starter = compute(py, || self.filter.starter())?;
        for from in (0..times.len()).step_by(START_CHUNK) {
            let part = from..(from + START_CHUNK).min(times.len());
            let found = compute(py, || {
                starter.search(&times[part.clone()], &values[part.clone()], inputs.map(|u| &u[part]))
            })?;
            if let Some(start) = found {
                return Ok(Start {
                    row: from + start.row,
                    ..start
                });
            }
            py.check_signals()?;
        }
        Err(to_python(py, &starter.failure()))
    }

    fn to_python<'py>(&self, py: Python<'py>, run: &FilterRun) -> PyResult<Run<'py>> {
        let (n, m) = (self.filter.motion().state_dim(), self.filter.sensor().measurement_dim());
        let means = |list: &'_ [Gaussian]| array::from_rows(py, list.iter().map(|g| &g.mean), n);
        let covs = |list: &'_ [Gaussian]| array::from_symmetric(py, list.iter().map(|g| &g.cov), n);
        Ok(Run {
            means: means(&run.filtered)?,
            covs: covs(&run.filtered)?,
            predicted_means: means(&run.predicted)?,
            predicted_covs: covs(&run.predicted)?,
            transitions: array::from_square(py, run.transitions.iter(), n)?,
            motion_noises: array::from_square(py, run.motion_noises.iter(), n)?,
            innovations: array::from_rows(py, run.innovations.iter(), m)?,
            innovation_covs: array::from_symmetric(py, run.innovation_covs.iter(), m)?,
            nis: PyArray1::from_slice(py, &run.nis),
            dof: PyArray1::from_iter(py, run.dof.iter().map(|&d| i64::try_from(d).unwrap_or(i64::MAX))),
            verdicts: PyArray1::from_iter(
                py,
                run.screened.iter().flat_map(|s| s.verdicts.iter().map(|&v| code(v))),
            )
            .reshape([run.screened.len(), m])?,
            statistics: PyArray1::from_iter(py, run.screened.iter().map(|s| s.statistic)),
            p_values: PyArray1::from_iter(py, run.screened.iter().map(|s| s.p_value)),
            q_hat: array::from_symmetric(py, run.q_hat.iter(), run.q_hat.first().map_or(0, DMatrix::nrows))?,
            r_hat: array::from_symmetric(py, run.r_hat.iter(), m)?,
            restarts: run.restarts.clone(),
            log_likelihood: run.log_likelihood,
            start: run.start,
        })
    }
}

/// A verdict as the facade's `Verdict` numbers it.
fn code(verdict: Verdict) -> i8 {
    match verdict {
        Verdict::Missing => 0,
        Verdict::Used => 1,
        Verdict::Rejected => 2,
    }
}
