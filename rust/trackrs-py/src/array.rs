//! NumPy arrays in and out. The facade hands over C-contiguous float64; anything else is refused by name.

use nalgebra::{DMatrix, DVector};
use numpy::ndarray::Dimension;
use numpy::{
    Element, PyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1,
    PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use trackrs::Gaussian;
use trackrs::linalg::stack::{Repeats, Stack};

use crate::error::exception;

/// The numbers of an array, row by row. `as_slice` alone would also take Fortran order and so transpose it.
pub(crate) fn c_slice<'a, D: Dimension>(array: &'a PyReadonlyArray<'_, f64, D>, name: &str) -> PyResult<&'a [f64]> {
    match array.as_slice() {
        Ok(slice) if array.is_c_contiguous() => Ok(slice),
        _ => Err(unfit(array.py(), name)),
    }
}

fn unfit(py: Python<'_>, name: &str) -> PyErr {
    let message = format!("{name} must be a C-contiguous, aligned float64 array");
    exception(py, "DimensionError", message)
}

/// A vector.
pub(crate) fn vector(array: &PyReadonlyArray1<'_, f64>, name: &str) -> PyResult<DVector<f64>> {
    let slice = c_slice(array, name)?;
    Ok(DVector::from_row_slice(slice))
}

/// A matrix.
pub(crate) fn matrix(array: &PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<DMatrix<f64>> {
    let slice = c_slice(array, name)?;
    let shape = array.shape();
    Ok(DMatrix::from_row_slice(shape[0], shape[1], slice))
}

/// The same, copied while nobody else runs, without the book-keeping of who else reads or writes: of a few numbers that
/// is most of the cost.
pub(crate) fn copied(array: &Bound<'_, PyArray2<f64>>, name: &str) -> PyResult<DMatrix<f64>> {
    match array.to_vec() {
        Ok(values) if array.is_c_contiguous() => {
            let shape = array.shape();
            Ok(DMatrix::from_row_slice(shape[0], shape[1], &values))
        }
        _ => Err(unfit(array.py(), name)),
    }
}

/// The rows of a matrix as vectors.
pub(crate) fn rows(array: &PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<Vec<DVector<f64>>> {
    let mut out = Vec::new();
    read_rows(array, name, &mut out)?;
    Ok(out)
}

/// The same in the memory of others.
pub(crate) fn read_rows(array: &PyReadonlyArray2<'_, f64>, name: &str, out: &mut Vec<DVector<f64>>) -> PyResult<()> {
    let slice = c_slice(array, name)?;
    let (count, width) = (array.shape()[0], array.shape()[1]);
    let values = |row: usize| &slice[row * width..(row + 1) * width];
    out.truncate(count);
    for (k, row) in out.iter_mut().enumerate() {
        if row.len() == width {
            row.as_mut_slice().copy_from_slice(values(k));
        } else {
            *row = DVector::from_column_slice(values(k));
        }
    }
    out.extend((out.len()..count).map(|k| DVector::from_column_slice(values(k))));
    Ok(())
}

/// The matrices of an array (k, m, n).
pub(crate) fn matrices(array: &PyReadonlyArray3<'_, f64>, name: &str) -> PyResult<Vec<DMatrix<f64>>> {
    let slice = c_slice(array, name)?;
    let (rows, columns) = (array.shape()[1], array.shape()[2]);
    let size = (rows * columns).max(1);
    Ok(slice
        .chunks_exact(size)
        .map(|part| DMatrix::from_row_slice(rows, columns, part))
        .collect())
}

/// A checked Gaussian.
pub(crate) fn gaussian(mean: &PyReadonlyArray1<'_, f64>, cov: &PyReadonlyArray2<'_, f64>) -> PyResult<Gaussian> {
    let (mean_, cov_) = (vector(mean, "mean")?, matrix(cov, "cov")?);
    Gaussian::new(mean_, cov_).map_err(|error| crate::error::to_python(mean.py(), &error))
}

/// Makes an array that nobody else holds read-only.
pub(crate) fn frozen<T: Element, D: Dimension>(array: Bound<'_, PyArray<T, D>>) -> PyResult<Bound<'_, PyArray<T, D>>> {
    drop(array.try_readwrite()?.make_nonwriteable());
    Ok(array)
}

/// A vector out.
pub(crate) fn from_vector<'py>(py: Python<'py>, vector: &DVector<f64>) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_slice(py, vector.as_slice())
}

/// A matrix out, row-major.
pub(crate) fn from_matrix<'py>(py: Python<'py>, matrix: &DMatrix<f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let values = matrix.transpose().as_slice().to_vec();
    PyArray1::from_vec(py, values).reshape([matrix.nrows(), matrix.ncols()])
}

/// Vectors of one length out, as the rows of an array (k, n).
pub(crate) fn from_rows<'py, 'a>(
    py: Python<'py>,
    rows: impl ExactSizeIterator<Item = &'a DVector<f64>>,
    width: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let count = rows.len();
    let mut values = Vec::with_capacity(count * width);
    rows.for_each(|row| values.extend_from_slice(row.as_slice()));
    PyArray1::from_vec(py, values).reshape([count, width])
}

/// Symmetric matrices of one size out, as an array (k, n, n).
pub(crate) fn from_symmetric<'py, 'a>(
    py: Python<'py>,
    matrices: impl ExactSizeIterator<Item = &'a DMatrix<f64>>,
    size: usize,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let count = matrices.len();
    let mut values = Vec::with_capacity(count * size * size);
    matrices.for_each(|matrix| values.extend_from_slice(matrix.as_slice()));
    PyArray1::from_vec(py, values).reshape([count, size, size])
}

/// Vectors of one length out, as the rows of an array (k, n); their memory is handed over.
pub(crate) fn from_vectors(py: Python<'_>, stack: Stack) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let shape = [stack.len(), stack.shape()[1]];
    PyArray1::from_vec(py, stack.into_values()).reshape(shape)
}

/// Square matrices of a run out, as an array (k, n, n); one of them where all are the same.
pub(crate) fn from_repeats(py: Python<'_>, repeats: Repeats) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let distinct = repeats.distinct();
    let out = if distinct.len() == 1 {
        distinct.clone()
    } else {
        repeats.into_stack()
    };
    from_matrices(py, out)
}

/// Matrices out, as an array (k, m, n); their memory is handed over.
pub(crate) fn from_matrices(py: Python<'_>, stack: Stack) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let [rows, columns] = stack.shape();
    let shape = [stack.len(), rows, columns];
    PyArray1::from_vec(py, stack.into_values()).reshape(shape)
}
