//! Geodesy. Points travel as arrays (k, 3), covariances as (k, 3, 3).

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use trackrs::Error;
use trackrs::error::require_size;
use trackrs::geodesy::local::{Axes, LocalFrame as Core};
use trackrs::geodesy::placement::{Fix, place_array as place};
use trackrs::geodesy::similarity::{Matrix7, PointEstimate, Similarity as SimilarityCore, fit};
use trackrs::geodesy::wgs84::Geodetic;

use crate::array;
use crate::error::{compute, to_python};

/// The rows of an array (k, 3), finite.
fn points(array: &PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<Vec<Vector3<f64>>> {
    let rows = rows3(array, name)?;
    trackrs::error::require_finite(name, rows.iter().flat_map(|p| p.iter())).map_err(|e| to_python(array.py(), &e))?;
    Ok(rows)
}

/// The rows of an array (k, 3).
fn rows3(array: &PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<Vec<Vector3<f64>>> {
    require_size(&format!("{name} (columns)"), 3, array.shape()[1]).map_err(|e| to_python(array.py(), &e))?;
    let rows = array::rows(array, name)?;
    Ok(rows.iter().map(|row| Vector3::new(row[0], row[1], row[2])).collect())
}

/// The matrices of an array (k, 3, 3), checked to be covariances.
fn covariances(array: &PyReadonlyArray3<'_, f64>, name: &str) -> PyResult<Vec<Matrix3<f64>>> {
    let matrices = array::matrices(array, name)?;
    for matrix in &matrices {
        trackrs::linalg::symmetric::require_covariance(name, matrix, 3).map_err(|e| to_python(array.py(), &e))?;
    }
    Ok(matrices.iter().map(|m| Matrix3::from_fn(|i, j| m[(i, j)])).collect())
}

fn geodetic(rows: &[Vector3<f64>]) -> trackrs::Result<Vec<Geodetic>> {
    let each = rows.iter().enumerate();
    each.map(|(row, p)| Geodetic::of_row(row, p.x, p.y, p.z)).collect()
}

fn as_point(position: &Geodetic) -> Vector3<f64> {
    Vector3::new(position.lat, position.lon, position.height)
}

fn from_points<'py>(py: Python<'py>, points: &[Vector3<f64>]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let values = points.iter().flat_map(|p| p.iter().copied()).collect();
    PyArray1::from_vec(py, values).reshape([points.len(), 3])
}

fn from_covs<'py>(py: Python<'py>, covs: &[Matrix3<f64>]) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let values = covs.iter().flat_map(|c| c.iter().copied()).collect(); // symmetric: the order is one
    PyArray1::from_vec(py, values).reshape([covs.len(), 3, 3])
}

fn from_matrix3<'py>(py: Python<'py>, matrix: &Matrix3<f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    array::from_matrix(py, &DMatrix::from_fn(3, 3, |i, j| matrix[(i, j)]))
}

fn from_matrix7<'py>(py: Python<'py>, matrix: &Matrix7) -> PyResult<Bound<'py, PyArray2<f64>>> {
    array::from_matrix(py, &DMatrix::from_fn(7, 7, |i, j| matrix[(i, j)]))
}

fn from_vector3<'py>(py: Python<'py>, vector: &Vector3<f64>) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_slice(py, vector.as_slice())
}

/// A vector of three numbers.
fn vector3(array: &PyReadonlyArray1<'_, f64>, name: &str) -> PyResult<Vector3<f64>> {
    let vector: DVector<f64> = array::vector(array, name)?;
    require_size(name, 3, vector.len()).map_err(|e| to_python(array.py(), &e))?;
    Ok(Vector3::new(vector[0], vector[1], vector[2]))
}

/// A square matrix of this size.
fn square(array: &PyReadonlyArray2<'_, f64>, name: &str, size: usize) -> PyResult<DMatrix<f64>> {
    let matrix = array::matrix(array, name)?;
    let checked = require_size(name, size, matrix.nrows()).and_then(|()| require_size(name, size, matrix.ncols()));
    checked.map_err(|e| to_python(array.py(), &e))?;
    Ok(matrix)
}

#[pyfunction]
pub(crate) fn geodetic_to_ecef<'py>(
    py: Python<'py>,
    positions: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = rows3(&positions, "positions")?;
    let out: Vec<_> = compute(py, || Ok(geodetic(&rows)?.iter().map(Geodetic::to_ecef).collect()))?;
    from_points(py, &out)
}

#[pyfunction]
pub(crate) fn ecef_to_geodetic<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = self::points(&points, "points")?;
    let convert = |p| Geodetic::from_ecef(p).map(|g| as_point(&g));
    let out: Vec<_> = compute(py, || rows.iter().map(convert).collect())?;
    from_points(py, &out)
}

#[pyclass(frozen, module = "trackrs._trackrs")]
pub(crate) struct LocalFrame {
    core: Core,
}

#[allow(clippy::wrong_self_convention)] // the frame is what is converted from and to, not the class
#[pymethods]
impl LocalFrame {
    #[new]
    fn new(py: Python<'_>, lat: f64, lon: f64, height: f64, axes: &str) -> PyResult<Self> {
        let axes = match axes {
            "ned" => Ok(Axes::Ned),
            "enu" => Ok(Axes::Enu),
            other => Err(Error::invalid("axes", other, "must be \"ned\" or \"enu\"")),
        };
        let core = compute(py, || Core::new(Geodetic { lat, lon, height }, axes?))?;
        Ok(Self { core })
    }

    fn rotation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        from_matrix3(py, self.core.rotation())
    }

    fn from_geodetic<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = rows3(&positions, "positions")?;
        let convert = |g: &Geodetic| self.core.from_geodetic(g);
        let out: Vec<_> = compute(py, || Ok(geodetic(&rows)?.iter().map(convert).collect()))?;
        from_points(py, &out)
    }

    fn to_geodetic<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self::points(&points, "points")?;
        let convert = |p| self.core.to_geodetic(p).map(|g| as_point(&g));
        let out: Vec<_> = compute(py, || rows.iter().map(convert).collect())?;
        from_points(py, &out)
    }

    fn from_ecef<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self::points(&points, "points")?;
        let out: Vec<_> = compute(py, || Ok(rows.iter().map(|p| self.core.from_ecef(p)).collect()))?;
        from_points(py, &out)
    }

    fn to_ecef<'py>(&self, py: Python<'py>, points: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self::points(&points, "points")?;
        let out: Vec<_> = compute(py, || Ok(rows.iter().map(|p| self.core.to_ecef(p)).collect()))?;
        from_points(py, &out)
    }

    fn cov_from_ecef<'py>(
        &self,
        py: Python<'py>,
        covs: PyReadonlyArray3<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let covs = covariances(&covs, "covs")?;
        let out: Vec<_> = compute(py, || Ok(covs.iter().map(|c| self.core.cov_from_ecef(c)).collect()))?;
        from_covs(py, &out)
    }

    fn cov_to_ecef<'py>(
        &self,
        py: Python<'py>,
        covs: PyReadonlyArray3<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let covs = covariances(&covs, "covs")?;
        let out: Vec<_> = compute(py, || Ok(covs.iter().map(|c| self.core.cov_to_ecef(c)).collect()))?;
        from_covs(py, &out)
    }
}

/// A similarity and everything that follows from it.
#[derive(IntoPyObject)]
pub(crate) struct Similarity<'py> {
    scale: f64,
    rotation: Bound<'py, PyArray2<f64>>,
    translation: Bound<'py, PyArray1<f64>>,
    rotation_vector: Bound<'py, PyArray1<f64>>,
    cov: Bound<'py, PyArray2<f64>>,
    centre: Bound<'py, PyArray1<f64>>,
    image: Bound<'py, PyArray1<f64>>,
    centred_cov: Bound<'py, PyArray2<f64>>,
    residuals: Bound<'py, PyArray2<f64>>,
    variance: f64,
    dof: usize,
}

impl<'py> Similarity<'py> {
    fn new(
        py: Python<'py>,
        core: &SimilarityCore,
        residuals: &[Vector3<f64>],
        variance: f64,
        dof: usize,
    ) -> PyResult<Self> {
        Ok(Self {
            scale: core.scale,
            rotation: from_matrix3(py, &core.rotation)?,
            translation: from_vector3(py, &core.translation()),
            rotation_vector: from_vector3(py, &core.rotation_vector()),
            cov: from_matrix7(py, &core.cov())?,
            centre: from_vector3(py, &core.centre),
            image: from_vector3(py, &core.image),
            centred_cov: from_matrix7(py, &core.centred_cov)?,
            residuals: from_points(py, residuals)?,
            variance,
            dof,
        })
    }
}

#[pyfunction]
#[pyo3(signature = (source, target, weights=None))]
pub(crate) fn fit_similarity<'py>(
    py: Python<'py>,
    source: PyReadonlyArray2<'py, f64>,
    target: PyReadonlyArray2<'py, f64>,
    weights: Option<PyReadonlyArray1<'py, f64>>,
) -> PyResult<Similarity<'py>> {
    let (source, target) = (points(&source, "source")?, points(&target, "target")?);
    let weights = weights.map(|w| array::vector(&w, "weights")).transpose()?;
    let out = compute(py, || fit(&source, &target, weights.as_ref().map(DVector::as_slice)))?;
    Similarity::new(py, &out.similarity, &out.residuals, out.variance, out.dof)
}

/// Points and their covariances.
#[derive(IntoPyObject)]
pub(crate) struct Points<'py> {
    positions: Bound<'py, PyArray2<f64>>,
    covs: Bound<'py, PyArray3<f64>>,
}

impl<'py> Points<'py> {
    fn new(py: Python<'py>, estimates: &[PointEstimate]) -> PyResult<Self> {
        let (positions, covs): (Vec<_>, Vec<_>) = estimates.iter().map(|e| (e.position, e.cov)).unzip();
        Ok(Self {
            positions: from_points(py, &positions)?,
            covs: from_covs(py, &covs)?,
        })
    }
}

#[allow(clippy::too_many_arguments)]
#[pyfunction]
pub(crate) fn apply_similarity<'py>(
    py: Python<'py>,
    scale: f64,
    rotation: PyReadonlyArray2<'py, f64>,
    centre: PyReadonlyArray1<'py, f64>,
    image: PyReadonlyArray1<'py, f64>,
    centred_cov: PyReadonlyArray2<'py, f64>,
    points: PyReadonlyArray2<'py, f64>,
    covs: PyReadonlyArray3<'py, f64>,
) -> PyResult<Points<'py>> {
    let rotation = square(&rotation, "rotation", 3)?;
    let centred_cov = square(&centred_cov, "centred_cov", 7)?;
    let core = SimilarityCore {
        scale,
        rotation: Matrix3::from_fn(|i, j| rotation[(i, j)]),
        centre: vector3(&centre, "centre")?,
        image: vector3(&image, "image")?,
        centred_cov: Matrix7::from_fn(|i, j| centred_cov[(i, j)]),
    };
    let (points, covs) = (self::points(&points, "points")?, covariances(&covs, "covs")?);
    let out: Vec<_> = compute(py, || {
        require_size("covs", points.len(), covs.len())?;
        Ok(points.iter().zip(&covs).map(|(p, c)| core.propagate(p, c)).collect())
    })?;
    Points::new(py, &out)
}

/// An array in NED.
#[derive(IntoPyObject)]
pub(crate) struct Placement<'py> {
    elements: Points<'py>,
    similarity: Similarity<'py>,
    chi_square: f64,
    survey_std: Bound<'py, PyArray1<f64>>,
}

/// `fixes` are latitude, longitude and height, a row of NaN where an element has none; `stds` to the north, east and
/// downwards.
#[pyfunction]
pub(crate) fn place_array<'py>(
    py: Python<'py>,
    elements: PyReadonlyArray2<'py, f64>,
    fixes: PyReadonlyArray2<'py, f64>,
    stds: PyReadonlyArray2<'py, f64>,
    origin: (f64, f64, f64),
) -> PyResult<Placement<'py>> {
    let elements = points(&elements, "elements")?;
    let (fixes, stds) = (rows3(&fixes, "fixes")?, rows3(&stds, "std")?);
    let out = compute(py, || {
        require_size("std", fixes.len(), stds.len())?;
        let fix = |(p, std): (&Vector3<f64>, &Vector3<f64>)| {
            let position = Geodetic {
                lat: p.x,
                lon: p.y,
                height: p.z,
            };
            let std = [std.x, std.y, std.z];
            (!p.iter().all(|v| v.is_nan())).then_some(Fix { position, std })
        };
        let fixes: Vec<_> = fixes.iter().zip(&stds).map(fix).collect();
        let (lat, lon, height) = origin;
        place(&elements, &fixes, Geodetic { lat, lon, height })
    })?;
    let missing = Vector3::repeat(f64::NAN);
    let residuals: Vec<_> = out.residuals.iter().map(|v| v.unwrap_or(missing)).collect();
    Ok(Placement {
        elements: Points::new(py, &out.elements)?,
        similarity: Similarity::new(py, &out.similarity, &residuals, out.variance, out.dof)?,
        chi_square: out.chi_square,
        survey_std: PyArray1::from_vec(py, out.survey_std()),
    })
}
