//! Chi-square statistics of innovations: one by one, and summed over a window.
//!
//! | symbol | name here     | shape | meaning                                                          |
//! |--------|---------------|-------|------------------------------------------------------------------|
//! | r_k    | `innovations` | m     | innovation at epoch k; NaN = not observed                        |
//! | D_k    | `covs`        | m×m   | the covariance it should have                                    |
//! | λ, V   | `eigen`       |       | D = V diag(λ) Vᵀ over the observed components                    |
//! | T_k    | `statistics`  |       | rᵀ D⁺ r, chi-square with rank D degrees of freedom               |
//! | n      | `window`      |       | epochs with data in a sum                                        |
//!
//! 1. T = Σ (v_iᵀ r)²/λ_i over λ_i > 1e-12 λ_max; the others are dropped, dof is the number kept (U20, U21).
//! 2. A component of r along a dropped direction cannot be: D says that nothing varies there. Where it is more than ten
//!    standard deviations of the largest variance that is dropped, 1e-12 λ_max, T = ∞ and p = 0; smaller it is rounding.
//! 3. S_k = Σ T over the last n epochs that have data, dof = Σ of theirs (U23); without n over all of them (the paper's (15)).
//!
//! One T finds an isolated gross error; a sum dilutes it, but collects what a bias or a manoeuvre adds at every epoch.
//!
//! Reference: Xi, Liu, Tao, Lu, Tracking submarine moving target with the adaptive estimation methodology, eqs. (13) to (15).
//! Deviation: the paper's whole-run sum answers ever later; a window of about ten epochs is the alarm to use.

use nalgebra::{DMatrix, DVector};

use super::consistency::ChiSquareTests;
use crate::error::{Error, Result, require_size};
use crate::linalg::symmetric::{require_covariance, symmetric_eigen};

/// Eigenvalues up to this share of the largest count as zero.
pub const RANK_TOLERANCE: f64 = 1e-12;
/// Standard deviations along a dropped direction beyond which an innovation contradicts its covariance.
const CONTRADICTION: f64 = 10.0;

/// The normalised squares of innovations (length m each, NaN = not observed), also where a covariance is singular.
pub fn nis(innovations: &[DVector<f64>], covs: &[DMatrix<f64>]) -> Result<ChiSquareTests> {
    require_size("covariances", innovations.len(), covs.len())?;
    let mut tests = ChiSquareTests::default();
    for (row, (innovation, cov)) in innovations.iter().zip(covs).enumerate() {
        let what = format!("covariance {row}");
        require_size(&what, innovation.len(), cov.nrows())?;
        require_size(&what, innovation.len(), cov.ncols())?;
        if let Some(index) = innovation.iter().position(|r| r.is_infinite()) {
            let what = format!("innovation {row}");
            return Err(Error::NonFinite { what, index });
        }
        let observed: Vec<usize> = (0..innovation.len()).filter(|&i| !innovation[i].is_nan()).collect();
        let part = cov.select_rows(&observed).select_columns(&observed);
        require_covariance(&what, &part, observed.len())?;
        let eigen = symmetric_eigen(&part)?;
        let along = eigen.vectors.transpose() * innovation.select_rows(&observed);
        let limit = RANK_TOLERANCE * eigen.values.iter().copied().fold(0.0, f64::max);
        let (mut statistic, mut dof) = (0.0, 0);
        for (&value, &length) in eigen.values.iter().zip(&along) {
            if value > limit {
                statistic += length * length / value;
                dof += 1;
            } else if length.abs() > CONTRADICTION * limit.sqrt() {
                statistic = f64::INFINITY;
            }
        }
        tests.push(statistic, dof);
    }
    Ok(tests)
}

/// For every epoch the sum of `statistics` over the last `window` epochs that have data, all of them without a window.
///
/// An epoch without data (`dof` 0) repeats the sum before it. At each of the epochs `restarts`, whose own statistic is that
/// of the state given up there, the sum begins anew.
pub fn cumulative(
    statistics: &[f64],
    dof: &[usize],
    restarts: &[usize],
    window: Option<usize>,
) -> Result<ChiSquareTests> {
    require_size("dof", statistics.len(), dof.len())?;
    if window == Some(0) {
        return Err(Error::invalid("window", 0, "must be at least 1"));
    }
    let mut tests = ChiSquareTests::default();
    let mut segment = WindowSum::new(window);
    for (row, (&statistic, &dof)) in statistics.iter().zip(dof).enumerate() {
        if restarts.contains(&row) {
            segment = WindowSum::new(window);
        } else if dof > 0 {
            segment.push(statistic, dof);
        }
        let sum = segment.sum();
        tests.push(sum.statistic, sum.dof);
    }
    Ok(tests)
}

/// A statistic or a sum of them.
#[derive(Debug, Clone, Copy, Default)]
struct Term {
    statistic: f64,
    dof: usize,
}

impl Term {
    fn plus(self, other: Self) -> Self {
        Self {
            statistic: self.statistic + other.statistic,
            dof: self.dof + other.dof,
        }
    }
}

/// The sum of the last terms, without subtraction: one large term must not leave its rounding behind.
struct WindowSum {
    window: Option<usize>,
    /// Sums of the older terms of the window from each of them on, the oldest last.
    older: Vec<Term>,
    /// The newer terms, and their sum.
    newer: Vec<Term>,
    newer_sum: Term,
}

impl WindowSum {
    fn new(window: Option<usize>) -> Self {
        Self {
            window,
            older: Vec::new(),
            newer: Vec::new(),
            newer_sum: Term::default(),
        }
    }

    fn push(&mut self, statistic: f64, dof: usize) {
        let term = Term { statistic, dof };
        self.newer_sum = self.newer_sum.plus(term);
        let Some(window) = self.window else { return };
        self.newer.push(term);
        if self.older.len() + self.newer.len() > window {
            if self.older.is_empty() {
                let mut sum = Term::default();
                for term in self.newer.drain(..).rev() {
                    sum = term.plus(sum);
                    self.older.push(sum);
                }
                self.newer_sum = Term::default();
            }
            self.older.pop();
        }
    }

    fn sum(&self) -> Term {
        self.older.last().copied().unwrap_or_default().plus(self.newer_sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::chi_square;
    use approx::assert_relative_eq;

    #[test]
    fn full_rank_is_the_quadratic_form_of_what_was_observed() {
        let cov = DMatrix::from_row_slice(3, 3, &[2.0, 0.5, 0.1, 0.5, 3.0, 0.2, 0.1, 0.2, 1.0]);
        let rows = [
            DVector::from_row_slice(&[1.0, -2.0, 0.5]),
            DVector::from_row_slice(&[1.0, f64::NAN, 0.5]),
            DVector::from_element(3, f64::NAN),
        ];
        let tests = nis(&rows, &[cov.clone(), cov.clone(), cov.clone()]).unwrap();
        let inverse = cov.clone().try_inverse().unwrap();
        assert_relative_eq!(
            tests.statistics[0],
            (rows[0].transpose() * inverse * &rows[0])[0],
            max_relative = 1e-13
        );
        let part = cov.select_rows(&[0, 2]).select_columns(&[0, 2]).try_inverse().unwrap();
        let r = rows[1].select_rows(&[0, 2]);
        assert_relative_eq!(
            tests.statistics[1],
            (r.transpose() * part * &r)[0],
            max_relative = 1e-13
        );
        assert_eq!(tests.dof, [3, 2, 0]);
        assert!(tests.statistics[2].is_nan() && tests.p_values[2].is_nan());
        assert_relative_eq!(tests.p_values[0], chi_square::survival(tests.statistics[0], 3));
    }

    #[test]
    fn an_innovation_outside_the_range_contradicts_its_covariance() {
        let cov = DMatrix::from_diagonal(&DVector::from_row_slice(&[4.0, 0.0]));
        let tests = nis(
            &[
                DVector::from_row_slice(&[2.0, 0.0]),
                DVector::from_row_slice(&[2.0, 1e-6]),
                DVector::from_row_slice(&[2.0, 1e-3]),
            ],
            &[cov.clone(), cov.clone(), cov],
        )
        .unwrap();
        assert_eq!(tests.statistics, [1.0, 1.0, f64::INFINITY]);
        assert_eq!(tests.dof, [1, 1, 1]);
        assert_eq!(tests.p_values[2], 0.0);
        let nothing_varies = nis(
            &[DVector::zeros(1), DVector::from_element(1, 1.0)],
            &vec![DMatrix::zeros(1, 1); 2],
        );
        let nothing_varies = nothing_varies.unwrap();
        assert!(nothing_varies.statistics[0].is_nan());
        assert_eq!(
            (nothing_varies.statistics[1], nothing_varies.p_values[1]),
            (f64::INFINITY, 0.0)
        );
    }

    #[test]
    fn sums_equal_those_of_the_definition() {
        let statistics: Vec<f64> = (0..40).map(|k| f64::from(k * 7 % 11) + 0.25).collect();
        let dof: Vec<usize> = (0..40).map(|k| if k % 5 == 3 { 0 } else { 1 + k % 3 }).collect();
        let restarts = [17];
        for window in [Some(1), Some(4), Some(100), None] {
            let tests = cumulative(&statistics, &dof, &restarts, window).unwrap();
            for row in 0..40 {
                let begin = if row >= 17 { 18 } else { 0 };
                let rows: Vec<usize> = (begin..=row).filter(|&k| dof[k] > 0).collect();
                let last = &rows[rows.len().saturating_sub(window.unwrap_or(40))..];
                assert_eq!(tests.dof[row], last.iter().map(|&k| dof[k]).sum::<usize>());
                let sum: f64 = last.iter().map(|&k| statistics[k]).sum();
                if last.is_empty() {
                    assert!(tests.statistics[row].is_nan());
                } else {
                    assert_relative_eq!(tests.statistics[row], sum, max_relative = 1e-14);
                }
            }
        }
        assert!(cumulative(&statistics, &dof, &[], Some(0)).is_err());
    }

    #[test]
    fn faults_are_named() {
        let bad = [
            (DMatrix::from_element(1, 1, -1.0), 1.0, "covariance 0"),
            (DMatrix::identity(2, 2), 1.0, "covariance 0"),
            (DMatrix::identity(1, 1), f64::INFINITY, "innovation 0"),
        ];
        for (cov, value, name) in bad {
            let error = nis(&[DVector::from_element(1, value)], &[cov]).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
