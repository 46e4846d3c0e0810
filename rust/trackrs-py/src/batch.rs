//! Many tracks at once.

use std::sync::Mutex;

use numpy::PyUntypedArrayMethods;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArray4, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::prelude::*;
use trackrs::filter::batch::{self, Wanted};
use trackrs::lanes::Level;
use trackrs::model::{Motion as _, Sensor as _};

use crate::array;
use crate::error::{compute, count, go_on};
use crate::filter::Filter;
use crate::scans::lock;

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct TrackBatch {
    inner: Mutex<batch::TrackBatch>,
}

/// What a run gives; tracks first, then steps.
#[derive(IntoPyObject)]
pub(crate) struct BatchRun<'py> {
    means: Option<Bound<'py, PyArray3<f64>>>,
    covs: Option<Bound<'py, PyArray4<f64>>>,
    nis: Option<Bound<'py, PyArray2<f64>>>,
}

#[pymethods]
impl TrackBatch {
    /// Covariances of all tracks, or one for all.
    #[new]
    fn new(
        py: Python<'_>,
        filter: &Filter,
        time: f64,
        means: PyReadonlyArray2<'_, f64>,
        covs: PyReadonlyArray3<'_, f64>,
        threads: Option<i64>,
    ) -> PyResult<Self> {
        let (means, covs) = (array::c_slice(&means, "means")?, array::c_slice(&covs, "covs")?);
        let inner = compute(py, || {
            let made = batch::TrackBatch::new(filter.filter.clone(), time, means, covs)?;
            match threads {
                Some(threads) => made.with_threads(count("threads", threads)?),
                None => Ok(made),
            }
        })?;
        Ok(Self {
            inner: Mutex::new(inner),
        })
    }

    fn time(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(lock(py, &self.inner)?.time())
    }

    fn in_lanes(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(lock(py, &self.inner)?.in_lanes())
    }

    fn means<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let batch = lock(py, &self.inner)?;
        PyArray1::from_vec(py, batch.means()).reshape([batch.tracks(), batch.filter().motion().state_dim()])
    }

    fn covs<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let batch = lock(py, &self.inner)?;
        let n = batch.filter().motion().state_dim();
        PyArray1::from_vec(py, batch.covs()).reshape([batch.tracks(), n, n])
    }

    fn failures<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<u64>>> {
        Ok(PyArray1::from_slice(py, lock(py, &self.inner)?.failures()))
    }

    fn escalated<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<bool>>> {
        Ok(PyArray1::from_vec(py, lock(py, &self.inner)?.escalated()))
    }

    fn run<'py>(
        &self,
        py: Python<'py>,
        times: PyReadonlyArray1<'py, f64>,
        values: PyReadonlyArray3<'py, f64>,
        means: bool,
        covs: bool,
        nis: bool,
    ) -> PyResult<BatchRun<'py>> {
        let mut guard = lock(py, &self.inner)?;
        let batch = &mut *guard;
        let (n, tracks) = (batch.filter().motion().state_dim(), batch.tracks());
        let m = batch.filter().sensor().measurement_dim();
        let shape = values.shape();
        let (given, steps) = ([shape[0], shape[1], shape[2]], times.len());
        let (times, values) = (
            array::c_slice(&times, "times")?,
            array::c_slice(&values, "measurements")?,
        );
        let out = compute(py, || {
            for (name, expected, found) in [
                ("measurements, tracks,", tracks, given[0]),
                ("measurements, times,", steps, given[1]),
                ("measurement", m, given[2]),
            ] {
                trackrs::error::require_size(name, expected, found)?;
            }
            batch.run_while(times, values, Wanted { means, covs, nis }, go_on)
        })?;
        let flat = |values: Vec<f64>| PyArray1::from_vec(py, values);
        let kept = |wanted: bool, values: Vec<f64>| wanted.then(|| flat(values));
        Ok(BatchRun {
            means: kept(means, out.means)
                .map(|v| v.reshape([tracks, steps, n]))
                .transpose()?,
            covs: kept(covs, out.covs)
                .map(|v| v.reshape([tracks, steps, n, n]))
                .transpose()?,
            nis: kept(nis, out.nis).map(|v| v.reshape([tracks, steps])).transpose()?,
        })
    }
}

/// The levels of instructions of this machine, the best one first.
#[pyfunction]
pub(crate) fn simd_levels() -> Vec<&'static str> {
    Level::available().into_iter().map(Level::name).collect()
}
