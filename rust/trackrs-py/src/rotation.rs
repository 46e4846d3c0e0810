//! Rotations in their several forms, row by row.

use nalgebra::{DVector, Vector3};
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use trackrs::error::require_size;
use trackrs::model::Rotation;
use trackrs::model::rotation::{reported_vector, vector_between};

use crate::array;
use crate::error::compute;

type Rows<'py> = PyResult<Bound<'py, PyArray2<f64>>>;

/// Rows of `width` numbers, each converted.
fn each<'py, const N: usize>(
    values: &PyReadonlyArray2<'py, f64>,
    name: &str,
    width: usize,
    convert: impl Fn(usize, [f64; N]) -> trackrs::Result<Vec<f64>> + Send + Sync,
) -> Rows<'py> {
    let py = values.py();
    let rows = array::rows(values, name)?;
    let out = compute(py, || {
        let mut out = Vec::with_capacity(rows.len());
        for (i, row) in rows.iter().enumerate() {
            require_size(name, N, row.len())?;
            let numbers = std::array::from_fn(|j| row[j]);
            out.push(DVector::from_vec(convert(i, numbers)?));
        }
        Ok(out)
    })?;
    array::from_rows(py, out.iter(), width)
}

fn to_vec(vector: Vector3<f64>) -> Vec<f64> {
    vector.as_slice().to_vec()
}

#[pyfunction]
pub(crate) fn rotation_vectors(quaternions: PyReadonlyArray2<'_, f64>) -> Rows<'_> {
    each(&quaternions, "quaternions", 3, |i, q| {
        reported_vector(q, &format!("quaternion of row {i}")).map(to_vec)
    })
}

#[pyfunction]
pub(crate) fn rotation_quaternions(vectors: PyReadonlyArray2<'_, f64>) -> Rows<'_> {
    each(&vectors, "vectors", 4, |_, v| {
        Ok(Rotation::from_vector(&Vector3::from(v)).quaternion().to_vec())
    })
}

#[pyfunction]
pub(crate) fn rotation_angles(vectors: PyReadonlyArray2<'_, f64>) -> Rows<'_> {
    each(&vectors, "vectors", 3, |_, v| {
        Ok(Rotation::from_vector(&Vector3::from(v)).angles().to_vec())
    })
}

#[pyfunction]
pub(crate) fn rotation_from_angles(angles: PyReadonlyArray2<'_, f64>) -> Rows<'_> {
    each(&angles, "angles", 3, |_, a| {
        Ok(to_vec(Rotation::from_angles(a).vector()))
    })
}

/// Rows of six: the first vector turned on by the second.
#[pyfunction]
pub(crate) fn rotation_turned(pairs: PyReadonlyArray2<'_, f64>) -> Rows<'_> {
    each(&pairs, "pairs", 3, |_, [a, b, c, d, e, f]| {
        let [start, turn] = [Vector3::new(a, b, c), Vector3::new(d, e, f)].map(|v| Rotation::from_vector(&v));
        Ok(to_vec((start * turn).vector()))
    })
}

/// Rows of six: from the first vector to the second.
#[pyfunction]
pub(crate) fn rotation_between(pairs: PyReadonlyArray2<'_, f64>) -> Rows<'_> {
    each(&pairs, "pairs", 3, |_, [a, b, c, d, e, f]| {
        Ok(to_vec(vector_between(&Vector3::new(a, b, c), &Vector3::new(d, e, f))))
    })
}
