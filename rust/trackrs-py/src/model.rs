//! Motion and sensor models.

use nalgebra::DVector;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise, LinearMotion, RandomWalk};
use trackrs::model::sensor::{LinearSensor, PositionSensor, RangeBearing, check_platform};
use trackrs::model::{Motion as _, MotionModel, Sensor as _, SensorModel};

use crate::array;
use crate::error::{compute, to_python};

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Motion {
    pub(crate) model: MotionModel,
}

fn kinematic_noise(psd: bool, values: Vec<f64>) -> KinematicNoise {
    if psd {
        KinematicNoise::Psd(values)
    } else {
        KinematicNoise::Std(values)
    }
}

#[pymethods]
impl Motion {
    #[staticmethod]
    fn random_walk(py: Python<'_>, values: Vec<f64>, psd: bool) -> PyResult<Self> {
        let model = compute(py, || RandomWalk::new(kinematic_noise(psd, values)))?;
        Ok(Self {
            model: MotionModel::RandomWalk(model),
        })
    }

    #[staticmethod]
    fn constant_velocity(py: Python<'_>, values: Vec<f64>, psd: bool) -> PyResult<Self> {
        let model = compute(py, || ConstantVelocity::new(kinematic_noise(psd, values)))?;
        Ok(Self {
            model: MotionModel::ConstantVelocity(model),
        })
    }

    #[staticmethod]
    fn constant_acceleration(py: Python<'_>, values: Vec<f64>, psd: bool) -> PyResult<Self> {
        let model = compute(py, || ConstantAcceleration::new(kinematic_noise(psd, values)))?;
        Ok(Self {
            model: MotionModel::ConstantAcceleration(model),
        })
    }

    #[staticmethod]
    fn linear(
        py: Python<'_>,
        transition: PyReadonlyArray2<'_, f64>,
        noise: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let (f, q) = (
            array::matrix(&transition, "transition")?,
            array::matrix(&noise, "noise")?,
        );
        Ok(Self {
            model: MotionModel::Linear(compute(py, || LinearMotion::new(f, q))?),
        })
    }

    #[getter]
    fn state_dim(&self) -> usize {
        self.model.state_dim()
    }

    #[getter]
    fn labels(&self) -> Vec<String> {
        self.model.labels()
    }

    fn transition<'py>(&self, py: Python<'py>, dt: f64) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let origin = DVector::zeros(self.model.state_dim());
        array::from_matrix(py, &self.model.jacobian(&origin, dt))
    }

    fn noise<'py>(&self, py: Python<'py>, dt: f64) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array::from_matrix(py, &self.model.noise(dt))
    }
}

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Sensor {
    pub(crate) model: SensorModel,
}

#[pymethods]
impl Sensor {
    #[staticmethod]
    fn position(py: Python<'_>, std: Vec<f64>) -> PyResult<Self> {
        Ok(Self {
            model: SensorModel::Position(compute(py, || PositionSensor::new(std))?),
        })
    }

    #[staticmethod]
    fn range_bearing(py: Python<'_>, position: [f64; 2], range_std: f64, bearing_std: f64) -> PyResult<Self> {
        let model = compute(py, || RangeBearing::new(position, range_std, bearing_std))?;
        Ok(Self {
            model: SensorModel::RangeBearing(model),
        })
    }

    #[staticmethod]
    fn linear(
        py: Python<'_>,
        matrix: PyReadonlyArray2<'_, f64>,
        noise: PyReadonlyArray2<'_, f64>,
        offset: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Self> {
        let (h, r) = (array::matrix(&matrix, "matrix")?, array::matrix(&noise, "noise")?);
        let d = array::vector(&offset, "offset")?;
        Ok(Self {
            model: SensorModel::Linear(compute(py, || LinearSensor::new(h, r, d))?),
        })
    }

    #[getter]
    fn measurement_dim(&self) -> usize {
        self.model.measurement_dim()
    }

    #[getter]
    fn labels(&self) -> Vec<String> {
        self.model.labels()
    }

    fn noise<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array::from_matrix(py, &self.model.noise())
    }

    #[pyo3(signature = (state, platform=None))]
    fn observe<'py>(
        &self,
        py: Python<'py>,
        state: PyReadonlyArray1<'py, f64>,
        platform: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let state = array::vector(&state, "state")?;
        let platform = platform.map(|p| array::vector(&p, "platform")).transpose()?;
        check_platform(&self.model, platform.as_ref()).map_err(|error| to_python(py, &error))?;
        let observed = compute(py, || self.model.observe(&state, platform.as_ref()))?;
        Ok(array::from_vector(py, &observed))
    }
}
