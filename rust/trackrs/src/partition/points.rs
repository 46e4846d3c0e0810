//! Points and partitions of them.
//!
//! | symbol | name here     | shape | meaning                                                              |
//! |--------|---------------|-------|----------------------------------------------------------------------|
//! | z      | `values`      | n×d   | points, row by row                                                   |
//! | R      | `noise`       | d×d   | spread of one measurement about its target's centre                  |
//! | L      |               | d×d   | R = L Lᵀ                                                             |
//! | s      | `deviation`   |       | effective standard deviation √(tr R / d)                             |
//!
//! With R given, z ← s L⁻¹ z: one standard deviation is s in every direction, so lengths keep their unit, and the
//! Mahalanobis distance is d_M = |z_i − z_j| / s. An isotropic R leaves the points as they are, bit for bit.
//!
//! Reference: spec 6 and 9 of the extended-target filter; the factor s is ours.

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result, require_finite, require_size};
use crate::linalg::cholesky::Cholesky;

/// Differences beyond this would overflow when they are squared.
const MAX_SPREAD: f64 = 1e150;

/// Checked points: finite, at least one coordinate each.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    values: Vec<f64>,
    dims: usize,
    deviation: Option<f64>,
}

impl Points {
    /// Points of `dims` coordinates from a row-major slice.
    pub fn new(values: &[f64], dims: usize) -> Result<Self> {
        if dims == 0 {
            return Err(Error::invalid("points", "(n, 0)", "must have at least one column"));
        }
        require_size("points", values.len().div_ceil(dims) * dims, values.len())?;
        require_finite("points", values)?;
        let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
        if largest > MAX_SPREAD {
            return Err(Error::invalid("points", largest, "must lie within 1e150 of the origin"));
        }
        Ok(Self {
            values: values.to_vec(),
            dims,
            deviation: None,
        })
    }

    /// The same, whitened with the covariance `noise`. What is so many deviations away that squares would overflow is put
    /// at the bound.
    pub fn whitened(values: &[f64], dims: usize, noise: &DMatrix<f64>) -> Result<Self> {
        require_finite("points", values)?;
        let bounded =
            |values: &[f64]| -> Vec<f64> { values.iter().map(|v| v.clamp(-MAX_SPREAD, MAX_SPREAD)).collect() };
        let mut points = Self::new(&bounded(values), dims)?;
        if noise.shape() != (dims, dims) {
            return Err(Error::Shape {
                what: "noise".into(),
                expected: vec![dims, dims],
                found: vec![noise.nrows(), noise.ncols()],
            });
        }
        require_finite("noise", noise.as_slice())?;
        if *noise != noise.transpose() {
            return Err(Error::invalid("noise", "the matrix", "must be symmetric"));
        }
        let factor = Cholesky::new(noise, "noise")?;
        let deviation = libm::sqrt(noise.trace() / dims as f64);
        if *noise != DMatrix::from_diagonal_element(dims, dims, noise[(0, 0)]) {
            for row in points.values.chunks_exact_mut(dims) {
                let white = factor.whiten(&DVector::from_row_slice(row)) * deviation;
                row.copy_from_slice(white.as_slice());
            }
            return Self::new(&bounded(&points.values), dims).map(|points| points.with_deviation(deviation));
        }
        Ok(points.with_deviation(deviation))
    }

    fn with_deviation(self, deviation: f64) -> Self {
        Self {
            deviation: Some(deviation),
            ..self
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.values.len() / self.dims
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Coordinates of each.
    pub fn dims(&self) -> usize {
        self.dims
    }

    /// The effective standard deviation, where a covariance was given.
    pub fn deviation(&self) -> Option<f64> {
        self.deviation
    }

    /// All coordinates, row by row.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The coordinates of one point.
    #[inline]
    pub fn point(&self, index: usize) -> &[f64] {
        &self.values[index * self.dims..(index + 1) * self.dims]
    }

    /// Squared distance of two points.
    #[inline]
    pub fn distance_squared(&self, i: usize, j: usize) -> f64 {
        squared(self.point(i), self.point(j))
    }

    /// These of the points, in this order.
    #[must_use]
    pub fn select(&self, indices: &[usize]) -> Self {
        Self {
            values: indices.iter().flat_map(|&i| self.point(i)).copied().collect(),
            ..*self
        }
    }
}

/// Squared distance.
#[inline(always)]
pub(crate) fn squared(a: &[f64], b: &[f64]) -> f64 {
    // Two coordinates are the common case; both ways sum in the same order.
    if let ([a0, a1], [b0, b1]) = (a, b) {
        let (u, v) = (a0 - b0, a1 - b1);
        return u * u + v * v;
    }
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        sum += (x - y) * (x - y);
    }
    sum
}

/// Disjoint cells that cover all points, numbered in the order of their first points.
///
/// So two partitions into the same cells are equal.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Partition {
    labels: Vec<usize>,
    count: usize,
}

impl Partition {
    /// The partition into points of equal labels, each below `bound`.
    pub(crate) fn from_labels(labels: &[usize], bound: usize) -> Self {
        let mut names = vec![usize::MAX; bound];
        let mut count = 0;
        let labels = labels.iter().map(|&label| {
            if names[label] == usize::MAX {
                names[label] = count;
                count += 1;
            }
            names[label]
        });
        let labels = labels.collect();
        Self { labels, count }
    }

    /// The partition of labels below `bound` in which every point without one is a cell of its own.
    pub(crate) fn with_singletons(labels: &[Option<usize>], bound: usize) -> Self {
        let mut next = bound;
        let mut fresh = || {
            next += 1;
            next - 1
        };
        let full: Vec<usize> = labels.iter().map(|label| label.unwrap_or_else(&mut fresh)).collect();
        Self::from_labels(&full, next)
    }

    /// The label of every point.
    pub fn labels(&self) -> &[usize] {
        &self.labels
    }

    /// How many cells there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no cell, because there is no point.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The points of every cell, ascending.
    pub fn cells(&self) -> Vec<Vec<usize>> {
        let mut cells = vec![Vec::new(); self.count];
        for (point, &label) in self.labels.iter().enumerate() {
            cells[label].push(point);
        }
        cells
    }

    /// The same with one cell divided by labels of its points.
    #[must_use]
    pub(crate) fn with_split(&self, cell: &[usize], parts: &[usize]) -> Self {
        let mut labels = self.labels.clone();
        for (&point, &part) in cell.iter().zip(parts) {
            labels[point] = self.count + part;
        }
        Self::from_labels(&labels, self.count + cell.len())
    }

    /// The partition of `size` points of which this one has divided those at `kept`; the others are cells of their own.
    #[must_use]
    pub(crate) fn embedded(&self, kept: &[usize], size: usize) -> Self {
        let mut labels = vec![None; size];
        for (&point, &label) in kept.iter().zip(&self.labels) {
            labels[point] = Some(label);
        }
        Self::with_singletons(&labels, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_numbered_by_their_first_points() {
        let partition = Partition::from_labels(&[3, 0, 3, 1], 4);
        assert_eq!(partition.labels(), [0, 1, 0, 2]);
        assert_eq!(partition.cells(), [vec![0, 2], vec![1], vec![3]]);
        assert_eq!(partition.embedded(&[0, 2, 3, 5], 6).labels(), [0, 1, 2, 0, 3, 4]);
    }

    #[test]
    fn whitened_distances_are_mahalanobis_distances() {
        let noise = DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 2.0]);
        let values = [1.0, 2.0, -3.0, 0.5];
        let points = Points::whitened(&values, 2, &noise).unwrap();
        let difference = DVector::from_row_slice(&[4.0, 1.5]);
        let expected = (difference.transpose() * noise.try_inverse().unwrap() * difference)[0];
        let found = points.distance_squared(0, 1) / points.deviation().unwrap().powi(2);
        assert!((found - expected).abs() < 1e-12);
        let isotropic = Points::whitened(&values, 2, &DMatrix::from_diagonal_element(2, 2, 9.0)).unwrap();
        assert_eq!((isotropic.values(), isotropic.deviation()), (&values[..], Some(3.0)));
    }
}
