//! Models that are Python functions. The interpreter is held only while one is called.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use trackrs::error::{Error, Result, require_finite};
use trackrs::linalg::symmetric::require_covariance;
use trackrs::model::numeric::differentiate;
use trackrs::model::{Motion, Sensor};

use crate::error::keep_raised;

/// A Python function of states, called with an array (k, n).
#[derive(Debug)]
pub(crate) struct Function {
    name: String,
    call: Py<PyAny>,
}

impl Function {
    /// `name` is what errors call it.
    pub(crate) fn new(name: &str, call: &Bound<'_, PyAny>) -> Self {
        let own = call.getattr("__name__").and_then(|own| own.extract::<String>());
        let name = own.map_or_else(|_| name.to_string(), |own| format!("{name} ({own})"));
        Self {
            name,
            call: call.clone().unbind(),
        }
    }

    fn failed(&self, error: PyErr) -> Error {
        let reason = error.to_string();
        keep_raised(error);
        Error::Callable {
            name: self.name.clone(),
            reason,
        }
    }

    /// Calls it with the states, rows of length n, and perhaps a time; its values, `shape` for each state, go to `out`.
    fn values(&self, states: &[f64], n: usize, dt: Option<f64>, shape: &[usize], out: &mut [f64]) -> Result<()> {
        Python::attach(|py| {
            let count = states.len().checked_div(n).unwrap_or(0);
            let given = PyArray1::from_slice(py, states)
                .reshape([count, n])
                .map_err(|e| self.failed(e))?;
            let arguments = match dt {
                Some(dt) => PyTuple::new(
                    py,
                    [
                        given.into_any(),
                        dt.into_pyobject(py).map_err(|e| self.failed(e.into()))?.into_any(),
                    ],
                ),
                None => PyTuple::new(py, [given.into_any()]),
            };
            let found = arguments
                .and_then(|arguments| self.call.bind(py).call1(arguments))
                .map_err(|e| self.failed(e))?;
            self.copy(&found, &[&[count], shape].concat(), out)
        })
    }

    fn copy(&self, found: &Bound<'_, PyAny>, shape: &[usize], out: &mut [f64]) -> Result<()> {
        let direct = found.extract::<PyReadonlyArrayDyn<'_, f64>>();
        let array = if let Ok(array) = direct {
            array
        } else {
            let converted = found
                .py()
                .import("numpy")
                .and_then(|numpy| numpy.call_method1("asarray", (found, "f8")))
                .and_then(|made| Ok(made.cast_into::<PyArrayDyn<f64>>()?.try_readonly()?));
            converted.map_err(|e| {
                self.failed(PyTypeError::new_err(format!(
                    "{} must return an array of numbers: {e}",
                    self.name
                )))
            })?
        };
        if array.shape() != shape {
            return Err(Error::Shape {
                what: format!("output of {}", self.name),
                expected: shape.to_vec(),
                found: array.shape().to_vec(),
            });
        }
        match array.as_slice() {
            Ok(values) if array.is_c_contiguous() => out.copy_from_slice(values),
            _ => out.iter_mut().zip(array.as_array().iter()).for_each(|(x, &y)| *x = y),
        }
        require_finite(&format!("output of {}", self.name), out.iter())
    }
}

/// Q: one matrix for every step, or a function of the step.
#[derive(Debug)]
enum Noise {
    Fixed(DMatrix<f64>),
    OfStep(Function),
}

/// A motion by Python functions.
#[derive(Debug)]
pub(crate) struct CustomMotion {
    labels: Vec<String>,
    f: Function,
    noise: Noise,
    jacobian: Option<Function>,
}

impl CustomMotion {
    pub(crate) fn with_fixed_noise(
        f: Function,
        noise: DMatrix<f64>,
        labels: Vec<String>,
        jacobian: Option<Function>,
    ) -> Result<Arc<Self>> {
        require_covariance("noise", &noise, labels.len())?;
        Ok(Arc::new(Self {
            labels,
            f,
            noise: Noise::Fixed(noise),
            jacobian,
        }))
    }

    pub(crate) fn with_noise_of_step(
        f: Function,
        noise: Function,
        labels: Vec<String>,
        jacobian: Option<Function>,
    ) -> Arc<Self> {
        Arc::new(Self {
            labels,
            f,
            noise: Noise::OfStep(noise),
            jacobian,
        })
    }
}

impl Motion for CustomMotion {
    fn state_dim(&self) -> usize {
        self.labels.len()
    }
    fn position_dims(&self) -> usize {
        self.labels.len()
    }
    fn labels(&self) -> Vec<String> {
        self.labels.clone()
    }
    fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
        let mut out = DVector::zeros(state.len());
        // A failure is kept and raised; what is made of NaN does not reach anybody.
        if self.propagate_all(state.as_slice(), dt, out.as_mut_slice()).is_err() {
            out.fill(f64::NAN);
        }
        out
    }
    fn propagate_all(&self, states: &[f64], dt: f64, out: &mut [f64]) -> Result<()> {
        if dt == 0.0 {
            out.copy_from_slice(states);
            return Ok(());
        }
        let n = self.labels.len();
        self.f.values(states, n, Some(dt), &[n], out)
    }
    fn jacobian(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        let n = state.len();
        let (mut moved, mut slope) = (vec![0.0; n], vec![f64::NAN; n * n]);
        if self.linearise_into(state, dt, &mut moved, &mut slope).is_err() {
            slope.fill(f64::NAN);
        }
        DMatrix::from_row_slice(n, n, &slope)
    }
    fn linearise_into(&self, state: &DVector<f64>, dt: f64, moved: &mut [f64], jacobian: &mut [f64]) -> Result<()> {
        let n = state.len();
        if dt == 0.0 {
            moved.copy_from_slice(state.as_slice());
            jacobian.fill(0.0);
            (0..n).for_each(|i| jacobian[i * (n + 1)] = 1.0);
            return Ok(());
        }
        if let Some(slope) = &self.jacobian {
            self.propagate_all(state.as_slice(), dt, moved)?;
            return slope.values(state.as_slice(), n, Some(dt), &[n, n], jacobian);
        }
        let mut values = |states: &[f64], out: &mut [f64]| self.propagate_all(states, dt, out);
        differentiate(state.as_slice(), &[], &mut values, moved, jacobian)
    }
    fn noise(&self, dt: f64) -> DMatrix<f64> {
        let n = self.labels.len();
        if dt == 0.0 {
            return DMatrix::zeros(n, n);
        }
        match &self.noise {
            Noise::Fixed(noise) => noise.clone(),
            Noise::OfStep(noise) => noise.of_step(n, dt).unwrap_or_else(|error| {
                crate::error::keep_error(&error);
                DMatrix::from_element(n, n, f64::NAN)
            }),
        }
    }
    fn is_linear(&self) -> bool {
        false
    }
}

impl Function {
    /// A covariance n×n that depends on the step.
    fn of_step(&self, n: usize, dt: f64) -> Result<DMatrix<f64>> {
        let mut out = vec![0.0; n * n];
        Python::attach(|py| {
            let found = self.call.bind(py).call1((dt,)).map_err(|e| self.failed(e))?;
            self.copy(&found, &[n, n], &mut out)
        })?;
        let noise = DMatrix::from_row_slice(n, n, &out);
        require_covariance(&format!("output of {}", self.name), &noise, n)?;
        Ok(noise)
    }
}

/// A sensor by Python functions.
#[derive(Debug)]
pub(crate) struct CustomSensor {
    h: Function,
    noise: DMatrix<f64>,
    angles: Vec<usize>,
    jacobian: Option<Function>,
}

impl CustomSensor {
    pub(crate) fn new(
        h: Function,
        noise: DMatrix<f64>,
        angles: Vec<usize>,
        jacobian: Option<Function>,
    ) -> Result<Arc<Self>> {
        let m = noise.nrows();
        require_covariance("noise", &noise, m)?;
        if let Some(&beyond) = angles.iter().find(|&&i| i >= m) {
            let requirement = format!("must name components of a measurement of {m}");
            return Err(Error::invalid("angles", beyond, &requirement));
        }
        Ok(Arc::new(Self {
            h,
            noise,
            angles,
            jacobian,
        }))
    }
}

impl Sensor for CustomSensor {
    fn measurement_dim(&self) -> usize {
        self.noise.nrows()
    }
    fn labels(&self) -> Vec<String> {
        (0..self.noise.nrows()).map(|i| format!("z{i}")).collect()
    }
    fn check(&self, _motion: &dyn Motion) -> Result<()> {
        Ok(())
    }
    fn observe(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        let mut out = DVector::zeros(self.noise.nrows());
        self.observe_all(state.as_slice(), state.len(), None, out.as_mut_slice())?;
        Ok(out)
    }
    fn observe_all(&self, states: &[f64], n: usize, _platform: Option<&DVector<f64>>, out: &mut [f64]) -> Result<()> {
        self.h.values(states, n, None, &[self.noise.nrows()], out)
    }
    fn jacobian(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        let (n, m) = (state.len(), self.noise.nrows());
        let (mut expected, mut slope) = (vec![0.0; m], vec![0.0; m * n]);
        self.linearise_into(state, None, &mut expected, &mut slope)?;
        Ok(DMatrix::from_row_slice(m, n, &slope))
    }
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        _platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        let (n, m) = (state.len(), self.noise.nrows());
        if let Some(slope) = &self.jacobian {
            self.observe_all(state.as_slice(), n, None, expected)?;
            return slope.values(state.as_slice(), n, None, &[m, n], jacobian);
        }
        let mut values = |states: &[f64], out: &mut [f64]| self.observe_all(states, n, None, out);
        differentiate(state.as_slice(), &self.angles, &mut values, expected, jacobian)
    }
    fn noise(&self) -> DMatrix<f64> {
        self.noise.clone()
    }
    fn angles(&self) -> &[usize] {
        &self.angles
    }
}
