//! Gross errors found by the innovation: chi-square screening of a measurement before it is used.
//!
//! | symbol | name here      | shape | meaning                                                       |
//! |--------|----------------|-------|---------------------------------------------------------------|
//! | r      | `innovation`   | m     | measured minus predicted; NaN where not observed              |
//! | D      | `cov`          | m×m   | its covariance                                                |
//! | A_p    | `jacobian`     | m×d   | the sensor's derivative by the position                       |
//! | p_test | `allowance`    |       | position variance that a manoeuvre may add, m²                |
//! | α      | `alpha`        |       | probability of rejecting what is right                        |
//!
//! In the test only, D_t = D + p_test A_p A_pᵀ (U27): a manoeuvre moves all ranges consistently, a gross error does not.
//! p_test is [`ALLOWANCE`] range variances where none is given: the size of gross error that matters grows with the noise.
//! T = rᵀ D_t⁻¹ r over the observed components (U20), threshold χ²_{1−α}(m) (U22).
//! * whole vector (U24): T above the threshold rejects all components;
//! * per component (U25): r_i² / D_t,ii > χ²_{1−α}(1) rejects component i;
//! * snooping (U26): while T of the used ones is above their threshold, the component with the largest |u_i| / √(D_t⁻¹)_ii,
//!   u = D_t⁻¹ r, is dropped.
//!
//! Reference: Xi, Liu, Tao, Lu, Tracking submarine moving target with the adaptive estimation methodology, eqs. (13), (14);
//! Baarda (1968), A testing procedure for use in geodetic networks. Spec labels U20–U27.
//! Deviations: the paper has the whole-vector test only, and no allowance. U27 recommends 25 m², 4 m² or none by
//! redundancy for ranges of 1 m; 4 m² serves every redundancy better (200 runs each of the reference course with 10 % gross
//! errors: at 25 m² a quarter of the runs on three hydrophones is ever 10 m off, at none half of them, at 4 m² none).

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_non_negative, require_size};
use crate::linalg::cholesky::Cholesky;
use crate::model::Sensor;
use crate::stats::chi_square;

/// Recommended allowance, in variances of a range.
pub const ALLOWANCE: f64 = 4.0;

/// Which components a failed test rejects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum ScreenMode {
    /// All of them, as in the paper.
    Vector,
    /// Each on its own test.
    Component,
    /// The worst one, again and again until the rest passes.
    #[default]
    Snoop,
}

/// A chi-square screen for gross errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ChiSquareScreen {
    alpha: f64,
    mode: ScreenMode,
    allowance: Option<f64>,
    restart: bool,
}

/// What became of one component of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Verdict {
    /// It takes part in the update.
    Used,
    /// It failed the test.
    Rejected,
    /// It was not observed.
    Missing,
}

/// The outcome of one screening.
#[derive(Debug, Clone, PartialEq)]
pub struct Screened {
    /// One verdict per component.
    pub verdicts: Vec<Verdict>,
    /// T over all observed components, before any rejection.
    pub statistic: f64,
    /// Number of observed components.
    pub dof: usize,
    /// Probability of a T at least as large if nothing is wrong.
    pub p_value: f64,
}

impl Screened {
    /// The innovation with NaN in place of what was rejected.
    #[must_use]
    pub fn keep_used(&self, innovation: &DVector<f64>) -> DVector<f64> {
        let keep = |(i, &r): (usize, &f64)| if self.verdicts[i] == Verdict::Used { r } else { f64::NAN };
        DVector::from_iterator(innovation.len(), innovation.iter().enumerate().map(keep))
    }
}

impl ChiSquareScreen {
    /// A screen that rejects what is right with probability `alpha` in (0, 1); `allowance` in m², or `None` for what
    /// [`Self::allowance_for`] recommends.
    pub fn new(alpha: f64, mode: ScreenMode, allowance: Option<f64>) -> Result<Self> {
        if !(alpha > 0.0 && alpha < 1.0) {
            return Err(Error::invalid("alpha", alpha, "must lie strictly between 0 and 1"));
        }
        allowance.map_or(Ok(()), |value| require_non_negative("allowance", value))?;
        Ok(Self {
            alpha,
            mode,
            allowance,
            restart: true,
        })
    }

    /// The paper's test: the whole vector, no allowance, no restart. It loses a manoeuvring target.
    pub fn as_printed(alpha: f64) -> Result<Self> {
        Ok(Self::new(alpha, ScreenMode::Vector, Some(0.0))?.without_restart())
    }

    /// The same screen for a filter that goes on after a lock-out instead of starting anew.
    #[must_use]
    pub fn without_restart(mut self) -> Self {
        self.restart = false;
        self
    }

    /// Whether a filter starts anew after a lock-out.
    pub fn restarts(&self) -> bool {
        self.restart
    }

    /// The allowance in force for this sensor, m²: the one given, or for sensors that fix positions [`ALLOWANCE`] times the
    /// variance of a range, or none.
    pub fn allowance_for(&self, sensor: &dyn Sensor) -> f64 {
        let recommended = || {
            sensor
                .position_fix()
                .map_or(0.0, |fixer| ALLOWANCE * fixer.range_variance())
        };
        self.allowance.unwrap_or_else(recommended)
    }

    /// Screens one innovation. `jacobian` is m×n with the position in its first `position_dims` columns; `allowance` is
    /// what [`Self::allowance_for`] gives.
    pub fn screen(
        &self,
        innovation: &DVector<f64>,
        cov: &DMatrix<f64>,
        jacobian: &DMatrix<f64>,
        position_dims: usize,
        allowance: f64,
    ) -> Result<Screened> {
        let m = innovation.len();
        require_size("innovation covariance", m, cov.nrows())?;
        require_size("sensor Jacobian rows", m, jacobian.nrows())?;
        let by_position = jacobian.columns(0, position_dims.min(jacobian.ncols()));
        let test_cov = cov + by_position * by_position.transpose() * allowance;
        let observed: Vec<usize> = (0..m).filter(|&i| !innovation[i].is_nan()).collect();
        let whole = Tested::new(innovation, &test_cov, &observed)?;
        let used = match self.mode {
            ScreenMode::Vector if whole.statistic > self.threshold(observed.len())? => Vec::new(),
            ScreenMode::Vector => observed.clone(),
            ScreenMode::Component => {
                let threshold = self.threshold(1)?;
                let passes = |&i: &usize| innovation[i] * innovation[i] <= threshold * test_cov[(i, i)];
                observed.iter().copied().filter(passes).collect()
            }
            ScreenMode::Snoop => self.snoop(innovation, &test_cov, observed.clone())?,
        };
        let mut verdicts = vec![Verdict::Missing; m];
        for &i in &observed {
            verdicts[i] = if used.contains(&i) {
                Verdict::Used
            } else {
                Verdict::Rejected
            };
        }
        let dof = observed.len();
        Ok(Screened {
            verdicts,
            statistic: whole.statistic,
            dof,
            p_value: if dof > 0 {
                chi_square::survival(whole.statistic, dof)
            } else {
                f64::NAN
            },
        })
    }

    fn threshold(&self, dof: usize) -> Result<f64> {
        if dof == 0 {
            return Ok(0.0);
        }
        chi_square::upper_quantile(self.alpha, dof)
    }

    fn snoop(&self, innovation: &DVector<f64>, cov: &DMatrix<f64>, mut used: Vec<usize>) -> Result<Vec<usize>> {
        while !used.is_empty() {
            let tested = Tested::new(innovation, cov, &used)?;
            if tested.statistic <= self.threshold(used.len())? {
                break;
            }
            used.remove(tested.worst());
        }
        Ok(used)
    }
}

/// Some components of an innovation seen through their covariance.
struct Tested {
    statistic: f64,
    /// |u_i| / √(D⁻¹)_ii of each component.
    standardised: Vec<f64>,
}

impl Tested {
    fn new(innovation: &DVector<f64>, cov: &DMatrix<f64>, used: &[usize]) -> Result<Self> {
        let part = cov.select_rows(used).select_columns(used);
        let factor = Cholesky::new(&part, "innovation covariance")?;
        let r = innovation.select_rows(used);
        let inverse = factor.solve(&DMatrix::identity(used.len(), used.len()));
        let u = &inverse * &r;
        Ok(Self {
            statistic: factor.whiten(&r).norm_squared(),
            standardised: (0..used.len()).map(|i| u[i].abs() / inverse[(i, i)].sqrt()).collect(),
        })
    }

    fn worst(&self) -> usize {
        let larger = |best: usize, i: usize| {
            if self.standardised[i] > self.standardised[best] {
                i
            } else {
                best
            }
        };
        (1..self.standardised.len()).fold(0, larger)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(mode: ScreenMode, innovation: &[f64]) -> Vec<Verdict> {
        let m = innovation.len();
        let (cov, jacobian) = (DMatrix::identity(m, m), DMatrix::identity(m, m));
        let screen = ChiSquareScreen::new(0.01, mode, None).unwrap();
        screen
            .screen(&DVector::from_row_slice(innovation), &cov, &jacobian, 3, 0.0)
            .unwrap()
            .verdicts
    }

    #[test]
    fn each_mode_rejects_what_it_says() {
        use Verdict::{Missing, Rejected, Used};
        let innovation = [0.5, 9.0, f64::NAN, -0.3];
        assert_eq!(
            run(ScreenMode::Vector, &innovation),
            [Rejected, Rejected, Missing, Rejected]
        );
        assert_eq!(run(ScreenMode::Component, &innovation), [Used, Rejected, Missing, Used]);
        assert_eq!(run(ScreenMode::Snoop, &innovation), [Used, Rejected, Missing, Used]);
        assert_eq!(run(ScreenMode::Snoop, &[f64::NAN, f64::NAN]), [Missing, Missing]);
    }

    #[test]
    fn a_manoeuvre_is_allowed_for_and_an_error_is_not() {
        // Four sensors around the target; a jump of the target moves all, an error one.
        let jacobian = DMatrix::from_row_slice(4, 2, &[1.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, -1.0]);
        let cov = DMatrix::identity(4, 4);
        let screen = ChiSquareScreen::new(0.01, ScreenMode::Snoop, None).unwrap();
        let jump = &jacobian * DVector::from_row_slice(&[8.0, -5.0]);
        let verdicts = screen.screen(&jump, &cov, &jacobian, 2, 25.0).unwrap().verdicts;
        assert_eq!(verdicts, [Verdict::Used; 4]);
        let error = DVector::from_row_slice(&[8.0, 0.0, 0.0, 0.0]);
        let verdicts = screen.screen(&error, &cov, &jacobian, 2, 25.0).unwrap().verdicts;
        assert_eq!(verdicts.iter().filter(|&&v| v == Verdict::Rejected).count(), 1);
    }

    #[test]
    fn alpha_outside_its_domain_is_named() {
        for alpha in [0.0, 1.0, -0.1, f64::NAN] {
            let error = ChiSquareScreen::new(alpha, ScreenMode::Vector, None).unwrap_err();
            assert!(error.to_string().starts_with("alpha = "));
        }
    }
}
