//! Consistency of covariances with errors: NEES, its bands, and root mean square errors.
//!
//! | symbol | name here | shape | meaning |
//! |--------|-----------|-------|---------|
//! | e      | `errors`  | k×n   | estimate minus truth, one per row |
//! | P      | `covs`    | k of n×n | the covariances that the estimator claims |
//! | L      |           | n×n   | lower Cholesky factor, P = L Lᵀ |
//! | N      | `runs`    | count | independent values that an average is taken over |
//! | q_ν(s) |           | scalar | chi-square quantile at probability s, ν degrees of freedom |
//!
//! 1. `NEES = eᵀ P⁻¹ e = |L⁻¹ e|²`, chi-square with n degrees of freedom if P is the covariance of e.
//! 2. A sum of N of them is chi-square with nN degrees, so with probability β their average lies in
//!    `[q_nN((1 − β)/2), q_nN((1 + β)/2)] / N`. The band serves NIS as well, with the measurement's dimension for n.
//! 3. `RMSE = sqrt(1/k Σ |e|²)`.
//!
//! Reference: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
//! Wiley 2001, section 5.4.

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result, require_finite, require_probability, require_size};
use crate::linalg::cholesky::Cholesky;
use crate::stats::chi_square;

/// An interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

/// Chi-square tests, one per row. Without a degree of freedom statistic and p-value are NaN.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ChiSquareTests {
    /// Chi-square with `dof` degrees of freedom if the model is right.
    pub statistics: Vec<f64>,
    /// Degrees of freedom.
    pub dof: Vec<usize>,
    /// Probability of a statistic at least as large.
    pub p_values: Vec<f64>,
}

impl ChiSquareTests {
    pub(super) fn push(&mut self, statistic: f64, dof: usize) {
        self.dof.push(dof);
        if dof == 0 && statistic.is_finite() {
            self.statistics.push(f64::NAN);
            self.p_values.push(f64::NAN);
            return;
        }
        self.statistics.push(statistic);
        let impossible = statistic == f64::INFINITY;
        self.p_values.push(if impossible {
            0.0
        } else {
            chi_square::survival(statistic, dof)
        });
    }
}

/// eᵀ P⁻¹ e of every row of `errors` with its covariance. An error names the covariance by its row.
pub fn nees(errors: &DMatrix<f64>, covs: &[DMatrix<f64>]) -> Result<ChiSquareTests> {
    require_finite("errors", &errors.transpose())?;
    require_size("covariances", errors.nrows(), covs.len())?;
    let mut tests = ChiSquareTests::default();
    for (row, cov) in covs.iter().enumerate() {
        let what = format!("covariance {row}");
        require_size(&what, errors.ncols(), cov.nrows())?;
        let error: DVector<f64> = errors.row(row).transpose();
        tests.push(Cholesky::new(cov, &what)?.whiten(&error).norm_squared(), errors.ncols());
    }
    Ok(tests)
}

/// The interval that holds, with this probability, the average over `runs` independent values of a chi-square
/// statistic of `dof` degrees of freedom. The rest is split evenly between the two sides.
pub fn average_band(dof: usize, runs: usize, probability: f64) -> Result<Band> {
    require_probability("probability", probability)?;
    if runs == 0 {
        return Err(Error::invalid("runs", runs, "must be at least 1"));
    }
    let sum_dof = dof.saturating_mul(runs);
    let tail = 0.5 * (1.0 - probability);
    let lower = chi_square::quantile(tail, sum_dof)? / runs as f64;
    let upper = chi_square::upper_quantile(tail, sum_dof)? / runs as f64;
    Ok(Band {
        lower,
        // Of a band without width the two are one number, found in two ways.
        upper: upper.max(lower),
    })
}

/// Root mean square length of the rows of `errors`, of which there is at least one.
pub fn rmse(errors: &DMatrix<f64>) -> Result<f64> {
    require_finite("errors", &errors.transpose())?;
    if errors.nrows() == 0 {
        return Err(Error::invalid("errors", "0 rows", "must have at least one row"));
    }
    // Relative to the largest: squares must not overflow.
    let scale = errors.amax();
    if scale == 0.0 {
        return Ok(0.0);
    }
    let rmse = (errors.unscale(scale).norm_squared() / errors.nrows() as f64).sqrt() * scale;
    if rmse.is_finite() {
        return Ok(rmse);
    }
    Err(Error::Overflow { what: "RMSE".into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn nees_is_the_quadratic_form() {
        let errors = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 3.0, 4.0]);
        let covs = [
            DMatrix::identity(2, 2),
            DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 3.0]),
        ];
        let values = nees(&errors, &covs).unwrap().statistics;
        // P⁻¹ = [[3, -1], [-1, 2]] / 5
        assert_relative_eq!(values[0], 5.0);
        assert_relative_eq!(values[1], (27.0 - 24.0 + 32.0) / 5.0, max_relative = 1e-14);
    }

    #[test]
    fn errors_name_the_culprit() {
        let errors = DMatrix::from_row_slice(2, 1, &[1.0, 2.0]);
        let covs = [DMatrix::identity(1, 1), DMatrix::from_element(1, 1, -4.0)];
        let Err(Error::NotPositiveDefinite { what, pivot: 0, value }) = nees(&errors, &covs) else {
            panic!("a negative variance must be refused");
        };
        assert_eq!((what.as_str(), value), ("covariance 1", -4.0));
        assert!(matches!(
            nees(&errors, &covs[..1]),
            Err(Error::DimensionMismatch { .. })
        ));
        let nan = DMatrix::from_row_slice(1, 2, &[0.0, f64::NAN]);
        assert!(matches!(
            nees(&nan, &[DMatrix::identity(2, 2)]),
            Err(Error::NonFinite { index: 1, .. })
        ));
    }

    #[test]
    fn the_band_closes_on_the_degrees_of_freedom() {
        let band = average_band(4, 50, 0.95).unwrap();
        // chi-square quantiles of 200 degrees of freedom: 162.728 and 241.058
        assert_relative_eq!(band.lower, 162.728 / 50.0, max_relative = 1e-5);
        assert_relative_eq!(band.upper, 241.058 / 50.0, max_relative = 1e-5);
        assert_eq!(
            average_band(4, 1, 1.0),
            Ok(Band {
                lower: 0.0,
                upper: f64::INFINITY
            })
        );
        for (dof, runs, probability) in [(0, 5, 0.9), (5, 0, 0.9), (5, 5, 1.1), (5, 5, f64::NAN)] {
            assert!(average_band(dof, runs, probability).is_err());
        }
    }

    #[test]
    fn rmse_of_lengths() {
        let errors = DMatrix::from_row_slice(2, 2, &[3.0, 4.0, 0.0, 1.0]);
        assert_eq!(rmse(&errors), Ok(13.0_f64.sqrt()));
        assert!(rmse(&DMatrix::zeros(0, 2)).is_err());
    }
}
