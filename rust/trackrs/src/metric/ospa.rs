//! OSPA: a metric between finite sets of points.
//!
//! | symbol | name here | shape | meaning |
//! |--------|-----------|-------|---------|
//! | X, Y   | `few`, `many` | m×d, n×d | points as rows, m ≤ n after swapping |
//! | c      | `cutoff`  | scalar | largest distance that counts |
//! | p      | `order`   | scalar | exponent, at least 1 |
//! | d_c    |           | m×n   | min(c, Euclidean distance) |
//! | π      |           | m     | injection of the rows of X into those of Y |
//!
//! 1. `localisationᵖ = 1/n min over π of Σ_i d_c(x_i, y_π(i))ᵖ`
//! 2. `cardinalityᵖ = cᵖ (n − m) / n`
//! 3. `totalᵖ = localisationᵖ + cardinalityᵖ`, and 0 if both sets are empty.
//!
//! The assignment is solved on `d_cᵖ`: solved on `d_c` it would not give the minimum for p > 1. Pairs not closer than c
//! are as good as none, so that only the others are looked for (`near`).
//!
//! Reference: D. Schuhmacher, B.-T. Vo, B.-N. Vo, *A consistent metric for performance evaluation of multi-object
//! filters*, IEEE Trans. Signal Processing 56(8), 2008, equations (3) and (4).

use nalgebra::DMatrix;

use super::near::{Near, matched, near};
use crate::error::{Error, Result, require_positive};

/// OSPA and its parts, in the unit of the points: `total`ᵖ = `localisation`ᵖ + `cardinality`ᵖ.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ospa {
    /// The metric, at most the cutoff.
    pub total: f64,
    /// What the distances of matched points contribute.
    pub localisation: f64,
    /// What the difference in number contributes.
    pub cardinality: f64,
}

/// The OSPA distance of two sets of points, given as rows.
///
/// Either set may be empty: the distance of an empty set from any other is the cutoff.
pub fn ospa(x: &DMatrix<f64>, y: &DMatrix<f64>, cutoff: f64, order: f64) -> Result<Ospa> {
    let full = cutoff_power(cutoff, order)?;
    let (few, many) = if x.nrows() <= y.nrows() { (x, y) } else { (y, x) };
    let near = near(few, many, cutoff)?;
    let (m, n) = (few.nrows(), many.nrows());
    if n == 0 {
        return Ok(Ospa::default());
    }
    let mut sum = 0.0;
    for pair in matched(&near, [m, n], full, order)? {
        sum += pair.map_or(full, |Near { distance, .. }| power(distance, order));
    }
    let localisation = sum / n as f64;
    let cardinality = full * ((n - m) as f64 / n as f64);
    Ok(Ospa {
        total: root(localisation + cardinality, order),
        localisation: root(localisation, order),
        cardinality: root(cardinality, order),
    })
}

/// Checks the parameters that OSPA and GOSPA share, and gives cᵖ.
pub(super) fn cutoff_power(cutoff: f64, order: f64) -> Result<f64> {
    require_positive("c", cutoff)?;
    if !(order.is_finite() && order >= 1.0) {
        return Err(Error::invalid("p", order, "must be finite and at least 1"));
    }
    let full = power(cutoff, order);
    if (1e-290..=1e290).contains(&full) {
        return Ok(full);
    }
    Err(Error::invalid(
        "c",
        cutoff,
        "c to the power p must lie between 1e-290 and 1e290",
    ))
}

pub(super) fn power(value: f64, order: f64) -> f64 {
    if order == 1.0 {
        value
    } else if order == 2.0 {
        value * value
    } else {
        libm::pow(value, order)
    }
}

pub(super) fn root(value: f64, order: f64) -> f64 {
    if order == 1.0 {
        value
    } else if order == 2.0 {
        value.sqrt()
    } else {
        libm::pow(value, 1.0 / order)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a line.
    fn line(points: &[f64]) -> DMatrix<f64> {
        DMatrix::from_column_slice(points.len(), 1, points)
    }

    #[test]
    fn an_empty_set_is_one_cutoff_away() {
        let none = DMatrix::zeros(0, 0);
        let score = ospa(&none, &line(&[1.0, 2.0]), 7.0, 2.0).unwrap();
        assert_eq!((score.total, score.localisation, score.cardinality), (7.0, 0.0, 7.0));
        assert_eq!(ospa(&none, &none, 7.0, 2.0), Ok(Ospa::default()));
    }

    #[test]
    fn the_assignment_is_of_powers() {
        // Distances (1, 3) and (2, 2) tie for p = 1; their squares do not.
        let (x, y) = (line(&[0.0, 1.0]), line(&[2.0, 3.0]));
        assert_eq!(ospa(&x, &y, 60.0, 1.0).unwrap().total, 2.0);
        assert_eq!(ospa(&x, &y, 60.0, 2.0).unwrap().total, 2.0);
    }

    #[test]
    fn refuses_what_has_no_distance() {
        let (x, plane) = (line(&[0.0]), DMatrix::zeros(1, 2));
        assert!(matches!(
            ospa(&x, &plane, 1.0, 2.0),
            Err(Error::DimensionMismatch { .. })
        ));
        assert!(matches!(
            ospa(&line(&[0.0, f64::NAN]), &x, 1.0, 2.0),
            Err(Error::NonFinite { index: 1, .. })
        ));
        for (c, p) in [
            (0.0, 2.0),
            (f64::INFINITY, 2.0),
            (1.0, 0.5),
            (1.0, f64::NAN),
            (1e200, 2.0),
        ] {
            assert!(matches!(ospa(&x, &x, c, p), Err(Error::InvalidParameter { .. })));
        }
    }
}
