//! Motion and sensor models.

use nalgebra::DVector;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use trackrs::model::motion::{
    ConstantAcceleration, ConstantVelocity, KinematicNoise, LinearMotion, RandomWalk, Singer,
};
use trackrs::model::sensor::{
    LinearSensor, PositionSensor, RangeArray, RangeArraySettings, RangeBearing, Side, SoundSpeed, SpeedProfile,
    check_platform,
};
use trackrs::model::{Motion as _, MotionModel, Sensor as _, SensorModel};
use trackrs::{Error, Result};

use crate::array;
use crate::custom::{CustomMotion, CustomSensor, Function};
use crate::error::{compute, to_python};
use crate::pose::{self, PoseFix};

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
    fn singer(py: Python<'_>, accel_std: Vec<f64>, time_constant: Vec<f64>, accel_psd: Vec<f64>) -> PyResult<Self> {
        let model = compute(py, || Singer::new(accel_std, time_constant, accel_psd))?;
        Ok(Self {
            model: MotionModel::Singer(model),
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

    #[staticmethod]
    #[pyo3(signature = (f, noise, labels, jacobian=None))]
    fn custom(
        py: Python<'_>,
        f: &Bound<'_, PyAny>,
        noise: &Bound<'_, PyAny>,
        labels: Vec<String>,
        jacobian: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let f = Function::new("f of CustomMotion", f);
        let jacobian = jacobian.map(|j| Function::new("jacobian of CustomMotion", j));
        let model = if noise.is_callable() {
            CustomMotion::with_noise_of_step(f, Function::new("noise of CustomMotion", noise), labels, jacobian)
        } else {
            let noise = array::matrix(&noise.extract()?, "noise")?;
            compute(py, || CustomMotion::with_fixed_noise(f, noise, labels, jacobian))?
        };
        Ok(Self {
            model: MotionModel::Custom(model),
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
        let matrix = compute(py, || Ok(self.model.jacobian(&origin, dt)))?;
        array::from_matrix(py, &matrix)
    }

    fn noise<'py>(&self, py: Python<'py>, dt: f64) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let matrix = compute(py, || Ok(self.model.noise(dt)))?;
        array::from_matrix(py, &matrix)
    }
}

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct Sensor {
    pub(crate) model: SensorModel,
}

/// What a position fix gives.
#[derive(IntoPyObject)]
pub(crate) struct Fix<'py> {
    position: Bound<'py, PyArray1<f64>>,
    cov: Bound<'py, PyArray2<f64>>,
    statistic: f64,
    dof: usize,
    p_value: f64,
    mirror: Option<Bound<'py, PyArray1<f64>>>,
}

/// What a stacked array is made of; `speeds` is none for ranges and for a profile, which is that of every array.
#[derive(IntoPyObject)]
pub(crate) struct Stacked<'py> {
    hydrophones: Bound<'py, PyArray2<f64>>,
    range_std: Vec<f64>,
    survey_std: Vec<f64>,
    depth_std: Option<f64>,
    speeds: Option<Vec<f64>>,
    side: Option<&'static str>,
}

fn side(name: Option<&str>) -> Result<Option<Side>> {
    match name {
        None => Ok(None),
        Some("above") => Ok(Some(Side::Above)),
        Some("below") => Ok(Some(Side::Below)),
        Some(other) => Err(Error::invalid("side", other, "must be above or below")),
    }
}

/// One speed, one per channel, or depths and speeds of a profile.
fn sound_speed(speeds: Option<Vec<f64>>, profile: Option<(Vec<f64>, Vec<f64>)>) -> Result<Option<SoundSpeed>> {
    Ok(match (speeds, profile) {
        (_, Some((depths, speeds))) => Some(SoundSpeed::Profile(SpeedProfile::new(depths, speeds)?)),
        (Some(speeds), None) if speeds.len() == 1 => Some(SoundSpeed::Uniform(speeds[0])),
        (Some(speeds), None) => Some(SoundSpeed::PerChannel(speeds)),
        (None, None) => None,
    })
}

#[pymethods]
impl Sensor {
    /// `bias` and `scale`: standard deviation and density of the extra states, where there are any.
    #[allow(clippy::too_many_arguments)]
    #[staticmethod]
    #[pyo3(signature = (hydrophones, range_std, depth_std=None, speeds=None, profile=None, side=None, preset=None, survey_std=None, bias=None, scale=None))]
    fn range_array(
        py: Python<'_>,
        hydrophones: PyReadonlyArray2<'_, f64>,
        range_std: Vec<f64>,
        depth_std: Option<f64>,
        speeds: Option<Vec<f64>>,
        profile: Option<(Vec<f64>, Vec<f64>)>,
        side: Option<&str>,
        preset: Option<&str>,
        survey_std: Option<Vec<f64>>,
        bias: Option<(Vec<f64>, f64)>,
        scale: Option<(f64, f64)>,
    ) -> PyResult<Self> {
        let hydrophones = array::matrix(&hydrophones, "hydrophones")?;
        let model = compute(py, || {
            let mut array = RangeArray::new(RangeArraySettings {
                hydrophones,
                range_std,
                survey_std: survey_std.unwrap_or_default(),
                depth_std,
                sound_speed: sound_speed(speeds, profile)?,
                side: self::side(side)?,
            })?;
            if let Some((std, psd)) = bias {
                array = array.with_bias(std, psd)?;
            }
            if let Some((std, psd)) = scale {
                array = array.with_scale(std, psd)?;
            }
            match preset {
                Some("bats") => array.require_bats(),
                Some("toss") => array.require_toss(),
                _ => Ok(array),
            }
        })?;
        Ok(Self {
            model: SensorModel::RangeArray(model),
        })
    }

    /// Range arrays as one: the arguments that make it.
    #[staticmethod]
    fn stack<'py>(py: Python<'py>, arrays: Vec<PyRef<'py, Self>>) -> PyResult<Stacked<'py>> {
        let models: Vec<SensorModel> = arrays.iter().map(|array| array.model.clone()).collect();
        let stacked = compute(py, || {
            let array = |(index, model): (usize, SensorModel)| match model {
                SensorModel::RangeArray(array) => Ok(array),
                _ => Err(Error::invalid(
                    &format!("array {index}"),
                    "given",
                    "must be a RangeArray",
                )),
            };
            let arrays = models.into_iter().enumerate().map(array).collect::<Result<Vec<_>>>()?;
            RangeArray::stack(&arrays)
        })?;
        let settings = stacked.settings();
        Ok(Stacked {
            hydrophones: array::from_matrix(py, &settings.hydrophones)?,
            range_std: settings.range_std.clone(),
            survey_std: settings.survey_std.clone(),
            depth_std: settings.depth_std,
            speeds: match &settings.sound_speed {
                Some(SoundSpeed::Uniform(speed)) => Some(vec![*speed]),
                Some(SoundSpeed::PerChannel(speeds)) => Some(speeds.clone()),
                Some(SoundSpeed::Profile(_)) | None => None,
            },
            side: settings.side.map(|side| match side {
                Side::Above => "above",
                Side::Below => "below",
            }),
        })
    }

    #[pyo3(signature = (value, side=None))]
    fn fix<'py>(&self, py: Python<'py>, value: PyReadonlyArray1<'py, f64>, side: Option<&str>) -> PyResult<Fix<'py>> {
        let value = array::vector(&value, "values")?;
        let fix = compute(py, || {
            let missing = || Error::invalid("sensor", "given", "must be able to fix positions");
            match (&self.model, self::side(side)?) {
                (SensorModel::RangeArray(array), Some(side)) => array.fix_on(&value, Some(side)),
                (model, _) => model.position_fix().ok_or_else(missing)?.fix(&value),
            }
        })?;
        Ok(Fix {
            position: array::from_vector(py, &fix.position.mean),
            cov: array::from_matrix(py, &fix.position.cov)?,
            statistic: fix.statistic,
            dof: fix.dof,
            p_value: fix.p_value,
            mirror: fix.mirror.map(|m| array::from_vector(py, &m)),
        })
    }

    #[staticmethod]
    fn position(py: Python<'_>, std: Vec<f64>) -> PyResult<Self> {
        Ok(Self {
            model: SensorModel::Position(compute(py, || PositionSensor::new(std))?),
        })
    }

    #[pyo3(signature = (angle_std, attitude, position_std=None))]
    #[staticmethod]
    fn pose(py: Python<'_>, angle_std: [f64; 3], attitude: &str, position_std: Option<[f64; 3]>) -> PyResult<Self> {
        let model = compute(py, || pose::sensor(angle_std, attitude, position_std))?;
        Ok(Self { model })
    }

    /// Reports of a pose sensor as measurements.
    fn measurements<'py>(&self, values: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pose::measurements(&self.model, &values)
    }

    #[staticmethod]
    fn camera(
        points: PyReadonlyArray2<'_, f64>,
        intrinsics: PyReadonlyArray2<'_, f64>,
        pixel_std: f64,
    ) -> PyResult<Self> {
        Ok(Self {
            model: pose::camera(&points, &intrinsics, pixel_std)?,
        })
    }

    fn pose_fix<'py>(&self, value: PyReadonlyArray1<'py, f64>) -> PyResult<PoseFix<'py>> {
        pose::fix(&self.model, &value)
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

    #[staticmethod]
    #[pyo3(signature = (h, noise, angles, jacobian=None))]
    fn custom(
        py: Python<'_>,
        h: &Bound<'_, PyAny>,
        noise: PyReadonlyArray2<'_, f64>,
        angles: Vec<usize>,
        jacobian: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let noise = array::matrix(&noise, "noise")?;
        let h = Function::new("h of CustomSensor", h);
        let jacobian = jacobian.map(|j| Function::new("jacobian of CustomSensor", j));
        let model = compute(py, || CustomSensor::new(h, noise, angles, jacobian))?;
        Ok(Self {
            model: SensorModel::Custom(model),
        })
    }

    /// Index of the rotation vector among the components.
    #[getter]
    fn rotation(&self) -> Option<usize> {
        self.model.rotation()
    }

    #[getter]
    fn angles(&self) -> Vec<usize> {
        self.model.angles().to_vec()
    }

    #[getter]
    fn measurement_dim(&self) -> usize {
        self.model.measurement_dim()
    }

    #[getter]
    fn labels(&self) -> Vec<String> {
        self.model.labels()
    }

    /// Names of the components that the sensor adds to the state.
    #[getter]
    fn extra_labels(&self) -> Vec<String> {
        self.model.nuisance().map_or_else(Vec::new, |nuisance| nuisance.labels)
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
