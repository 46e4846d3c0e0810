//! How large a target is: an ellipse whose matrix has an inverse Wishart distribution. How it is predicted and merged; how it is
//! seen stands in `spread.rs`.
//!
//! | symbol | name here   | shape | meaning                                                                      |
//! |--------|-------------|-------|------------------------------------------------------------------------------|
//! | X̂, κ   | [`Extent`]  | d×d   | expected covariance of a target's points about its centre, and its certainty |
//! | τ      | `time_constant` |   | seconds in which certainty falls to 1/e                                      |
//!
//! Prediction: X̂ stays, κ ← max(κ e^(−dt/τ), min(κ, κ₀ min(1, tr X̂² / tr X̂₀²)))                                       (E5)
//! Merging:    X̂ = Σ w X̂_i / Σ w;  tr X̂² / κ = Σ w (tr X̂_i² / κ_i + ½ (tr X̂_i − tr X̂)²) / Σ w                         (E6)
//!
//! Reference: docs/intensity_filters.md, section Extent; Granström, Natale, Braca, Ludeno, Serafino (2015), Gamma Gaussian
//! inverse Wishart probability hypothesis density for extended target tracking using X-band marine radar data, IEEE TGRS
//! 53(12). Deviation: E6 in place of the least divergence.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::mixture::Component;
use crate::error::{Error, Result, require_positive};
use crate::model::Sensor;
use crate::track::Extent;

/// The extent with the moments of a mixture of them; the weights need not add to one.
pub(crate) fn merged(parts: &[(f64, &Extent)]) -> Option<Extent> {
    let &[(_, first), ..] = parts else { return None };
    if parts.len() == 1 {
        return Some(first.clone());
    }
    let total: f64 = parts.iter().map(|(weight, _)| weight).sum();
    let mut cov = DMatrix::zeros(first.cov.nrows(), first.cov.ncols());
    for (weight, part) in parts {
        cov += &part.cov * (weight / total);
    }
    let trace = cov.trace();
    let spread = |&(weight, part): &(f64, &Extent)| {
        let off = part.cov.trace() - trace;
        weight * (part.cov.norm_squared() / part.certainty + 0.5 * off * off)
    };
    let variance = parts.iter().map(spread).sum::<f64>() / total;
    let certainty = cov.norm_squared() / variance;
    (certainty.is_finite() && certainty > 0.0).then_some(Extent { cov, certainty })
}

/// How extents are treated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExtentModel {
    /// That of a new target.
    pub prior: Extent,
    /// τ, seconds.
    pub time_constant: f64,
}

impl ExtentModel {
    /// `Ok` if this sensor can be used with extents and the parameters are in their domain.
    pub(crate) fn check(&self, sensor: &dyn Sensor) -> Result<()> {
        let m = sensor.measurement_dim();
        if !sensor.is_linear() || !sensor.angles().is_empty() || !(2..=3).contains(&m) {
            let requirement =
                "must measure two or three coordinates of the position, linearly, where targets have an extent";
            return Err(Error::invalid("sensor", sensor.labels().join(" "), requirement));
        }
        require_positive("extent time constant", self.time_constant)?;
        self.prior.check(m)
    }

    /// All components `dt` seconds later; those without extent are new.
    pub(crate) fn predict(&self, mixture: &mut [Component], dt: f64) {
        let kept = libm::exp(-dt / self.time_constant);
        let vaguest = self.prior.certainty / self.prior.cov.norm_squared();
        for component in mixture {
            match &mut component.extent {
                Some(extent) => {
                    let least = self.prior.certainty.min(vaguest * extent.cov.norm_squared());
                    extent.certainty = (extent.certainty * kept).max(least.min(extent.certainty));
                }
                new => *new = Some(self.prior.clone()),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extent(axes: [f64; 2], certainty: f64) -> Extent {
        Extent {
            cov: DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&axes)),
            certainty,
        }
    }

    #[test]
    fn a_mixture_of_equals_is_one_of_them_and_one_of_unequals_is_less_certain() {
        let (a, b) = (extent([400.0, 50.0], 20.0), extent([100.0, 50.0], 20.0));
        let same = merged(&[(0.3, &a), (1.2, &a)]).unwrap();
        assert!((same.cov - &a.cov).amax() < 1e-12 && (same.certainty - 20.0).abs() < 1e-12);
        let both = merged(&[(0.25, &a), (0.75, &b)]).unwrap();
        assert!((both.cov[(0, 0)] - 175.0).abs() < 1e-12);
        // 2 tr X̂²/κ against the variance of the trace of the mixture.
        let variance = |e: &Extent| 2.0 * e.cov.norm_squared() / e.certainty;
        let spread = 0.25 * (450.0_f64 - 225.0).powi(2) + 0.75 * (150.0_f64 - 225.0).powi(2);
        let expected = 0.25 * variance(&a) + 0.75 * variance(&b) + spread;
        assert!((variance(&both) - expected).abs() < 1e-10 * expected);
        assert!(merged(&[]).is_none());
    }

    #[test]
    fn certainty_goes_but_not_below_that_of_a_newborn() {
        let model = ExtentModel {
            prior: extent([225.0, 225.0], 5.0),
            time_constant: 10.0,
        };
        let after = |extent: Extent, dt: f64| {
            let mut mixture = [Component {
                weight: 1.0,
                state: crate::Gaussian::new(nalgebra::DVector::zeros(1), DMatrix::identity(1, 1)).unwrap(),
                rate: crate::rfs::rate::Rate::with_mean(1.0, 1.0),
                extent: Some(extent),
                label: 0,
                rooted: false,
            }];
            model.predict(&mut mixture, dt);
            mixture[0].extent.clone().unwrap()
        };
        let kept = after(extent([300.0, 80.0], 50.0), 10.0);
        assert!((kept.certainty - 50.0 / 1.0_f64.exp()).abs() < 1e-12);
        assert_eq!(kept.cov, extent([300.0, 80.0], 50.0).cov);
        assert_eq!(after(extent([300.0, 300.0], 50.0), 1e3).certainty, 5.0);
        // As vague as the prior in square metres, and vaguer than that stays as it is.
        assert!((after(extent([22.5, 22.5], 3.0), 1e3).certainty - 0.05).abs() < 1e-12);
        assert_eq!(after(extent([22.5, 22.5], 0.01), 1e3).certainty, 0.01);
        assert_eq!(after(extent([300.0, 80.0], 50.0), 0.0).certainty, 50.0);
    }

    #[test]
    fn extents_need_positions_and_a_prior() {
        use crate::model::sensor::{PositionSensor, RangeBearing};
        let model = |prior: Extent, time_constant: f64| ExtentModel { prior, time_constant };
        let sensor = PositionSensor::new(vec![20.0; 2]).unwrap();
        let fault = |model: ExtentModel, sensor: &dyn Sensor| model.check(sensor).unwrap_err().to_string();
        assert!(model(extent([225.0, 100.0], 5.0), 30.0).check(&sensor).is_ok());
        assert!(fault(model(extent([225.0, 100.0], 0.0), 30.0), &sensor).contains("certainty"));
        assert!(fault(model(extent([225.0, 100.0], 5.0), 0.0), &sensor).contains("time constant"));
        assert!(fault(model(extent([225.0, 0.0], 5.0), 1.0), &sensor).contains("extent"));
        let wide = PositionSensor::new(vec![20.0; 3]).unwrap();
        assert!(fault(model(extent([225.0, 100.0], 5.0), 1.0), &wide).contains("extent"));
        let polar = RangeBearing::new([0.0; 2], 20.0, 0.01).unwrap();
        assert!(fault(model(extent([225.0, 100.0], 5.0), 1.0), &polar).contains("linearly"));
    }
}
