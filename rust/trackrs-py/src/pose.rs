//! Pose sensors and cameras.

use nalgebra::{DVector, Matrix3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use trackrs::error::require_size;
use trackrs::model::sensor::{AttitudeForm, CameraSensor, Intrinsics, PoseSensor};
use trackrs::model::{Rotation, Sensor as _, SensorModel};
use trackrs::{Error, Result};

use crate::array;
use crate::error::compute;

/// What a pose fix gives; quaternions are w, x, y, z.
#[derive(IntoPyObject)]
pub(crate) struct PoseFix<'py> {
    position: Bound<'py, PyArray1<f64>>,
    quaternion: Bound<'py, PyArray1<f64>>,
    cov: Bound<'py, PyArray2<f64>>,
    statistic: f64,
    dof: usize,
    p_value: f64,
    /// Position and quaternion.
    mirror: Option<Bound<'py, PyArray1<f64>>>,
}

/// Position and quaternion of a position and rotation vector.
fn with_quaternion(pose: &DVector<f64>) -> Vec<f64> {
    let quaternion = Rotation::from_vector(&pose.fixed_rows::<3>(3).into_owned()).quaternion();
    [&pose.as_slice()[..3], &quaternion].concat()
}

pub(crate) fn sensor(angle_std: [f64; 3], attitude: &str, position_std: Option<[f64; 3]>) -> Result<SensorModel> {
    let form = match attitude {
        "euler" => AttitudeForm::Euler,
        "quaternion" => AttitudeForm::Quaternion,
        other => return Err(Error::invalid("attitude", other, "must be euler or quaternion")),
    };
    PoseSensor::new(position_std, angle_std, form).map(SensorModel::Pose)
}

/// Reports as measurements; those of other sensors than a [`PoseSensor`] are measurements.
pub(crate) fn measurements<'py>(
    model: &SensorModel,
    values: &PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let reports = array::rows(values, "values")?;
    let rows = compute(values.py(), || {
        let SensorModel::Pose(sensor) = model else {
            return Ok(reports);
        };
        let named = reports.iter().enumerate();
        named
            .map(|(row, report)| sensor.measurement(report, &format!("quaternion of row {row}")))
            .collect()
    })?;
    array::from_rows(values.py(), rows.iter(), model.measurement_dim())
}

pub(crate) fn camera(
    points: &PyReadonlyArray2<'_, f64>,
    intrinsics: &PyReadonlyArray2<'_, f64>,
    pixel_std: f64,
) -> PyResult<SensorModel> {
    let py = points.py();
    let points = array::matrix(points, "points")?;
    let matrix = array::matrix(intrinsics, "intrinsics")?;
    compute(py, || {
        require_size("rows of intrinsics", 3, matrix.nrows())?;
        require_size("columns of intrinsics", 3, matrix.ncols())?;
        let matrix = Matrix3::from_column_slice(matrix.as_slice());
        CameraSensor::new(points, Intrinsics::from_matrix(&matrix)?, pixel_std).map(SensorModel::Camera)
    })
}

pub(crate) fn fix<'py>(model: &SensorModel, value: &PyReadonlyArray1<'py, f64>) -> PyResult<PoseFix<'py>> {
    let py = value.py();
    let value = array::vector(value, "values")?;
    let fix = compute(py, || match model {
        SensorModel::Camera(camera) => camera.fix(&value),
        _ => Err(Error::invalid("sensor", "given", "must be able to fix poses")),
    })?;
    let pose = with_quaternion(&fix.position.mean);
    Ok(PoseFix {
        position: PyArray1::from_slice(py, &pose[..3]),
        quaternion: PyArray1::from_slice(py, &pose[3..]),
        cov: array::from_matrix(py, &fix.position.cov)?,
        statistic: fix.statistic,
        dof: fix.dof,
        p_value: fix.p_value,
        mirror: fix.mirror.map(|m| PyArray1::from_vec(py, with_quaternion(&m))),
    })
}
