//! Range and bearing in the plane.
//!
//! | symbol | name here              | meaning                                        |
//! |--------|------------------------|------------------------------------------------|
//! | s      | `origin`               | position of the sensor: its own plus the platform's |
//! | d      | `offset`               | target minus sensor                            |
//! | r, θ   | `range`, `bearing`     | |d|, atan2(d_y, d_x), wrapped to (−π, π]       |
//!
//! h = [r, θ],  H = [d_x/r, d_y/r; −d_y/r², d_x/r²] on the position.
//! One report gives p = s + r (cos θ, sin θ) with covariance J R Jᵀ, J = [cos θ, −r sin θ; sin θ, r cos θ].
//! With x north and y east the bearing is the compass bearing; with x east and y north it counts counter-clockwise from east.
//!
//! Reference: Liu, Xie, Huang (2009), eqs. (16), (17); spec labels N4–N6, N14.

use nalgebra::{DMatrix, DVector, Vector2};
use serde::{Deserialize, Serialize};

use super::{Motion, Sensor};
use crate::error::{Error, Result, require_finite, require_size, require_std};
use crate::gaussian::Gaussian;

/// A radar or sonar in the plane that measures range (metres) and bearing (radians).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RangeBearing {
    position: [f64; 2],
    range_std: f64,
    bearing_std: f64,
}

impl RangeBearing {
    /// A sensor at `position` (metres), or at that offset from the platform where a scan carries one.
    pub fn new(position: [f64; 2], range_std: f64, bearing_std: f64) -> Result<Self> {
        require_finite("position", &position)?;
        require_std("range_std", range_std)?;
        require_std("bearing_std", bearing_std)?;
        Ok(Self {
            position,
            range_std,
            bearing_std,
        })
    }

    fn origin(&self, platform: Option<&DVector<f64>>) -> Vector2<f64> {
        let own = Vector2::from(self.position);
        platform.map_or(own, |p| own + Vector2::new(p[0], p[1]))
    }

    fn offset(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<Vector2<f64>> {
        let offset = Vector2::new(state[0], state[1]) - self.origin(platform);
        if offset.norm_squared() > 0.0 {
            return Ok(offset);
        }
        Err(Error::Unobservable {
            sensor: "RangeBearing".into(),
            reason: "the target stands on the sensor".into(),
        })
    }
}

impl Sensor for RangeBearing {
    fn measurement_dim(&self) -> usize {
        2
    }
    fn labels(&self) -> Vec<String> {
        vec!["range".into(), "bearing".into()]
    }
    fn check(&self, motion: &dyn Motion) -> Result<()> {
        require_size("position of the motion model", 2, motion.position_dims())
    }
    fn observe(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        let d = self.offset(state, platform)?;
        Ok(DVector::from_vec(vec![libm::hypot(d.x, d.y), libm::atan2(d.y, d.x)]))
    }
    fn jacobian(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        let d = self.offset(state, platform)?;
        let r = libm::hypot(d.x, d.y);
        let mut h = DMatrix::zeros(2, state.len());
        h[(0, 0)] = d.x / r;
        h[(0, 1)] = d.y / r;
        h[(1, 0)] = -d.y / r / r;
        h[(1, 1)] = d.x / r / r;
        Ok(h)
    }
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        let d = self.offset(state, platform)?;
        let r = libm::hypot(d.x, d.y);
        expected.copy_from_slice(&[r, libm::atan2(d.y, d.x)]);
        jacobian.fill(0.0);
        let n = state.len();
        (jacobian[0], jacobian[1]) = (d.x / r, d.y / r);
        (jacobian[n], jacobian[n + 1]) = (-d.y / r / r, d.x / r / r);
        Ok(())
    }
    fn noise(&self) -> DMatrix<f64> {
        let variances = [self.range_std * self.range_std, self.bearing_std * self.bearing_std];
        DMatrix::from_diagonal(&DVector::from_row_slice(&variances))
    }
    fn angles(&self) -> &[usize] {
        &[1]
    }
    fn platform_dims(&self) -> Option<usize> {
        Some(2)
    }
    fn locate(&self, measurement: &DVector<f64>, platform: Option<&DVector<f64>>) -> Option<Gaussian> {
        let (r, theta) = (measurement[0], measurement[1]);
        if !r.is_finite() || !theta.is_finite() || r < 0.0 {
            return None;
        }
        let (sin, cos) = libm::sincos(theta);
        let j = DMatrix::from_row_slice(2, 2, &[cos, -r * sin, sin, r * cos]);
        let origin = self.origin(platform);
        Some(Gaussian {
            mean: DVector::from_vec(vec![origin.x + r * cos, origin.y + r * sin]),
            cov: &j * self.noise() * j.transpose(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn radar() -> RangeBearing {
        RangeBearing::new([10.0, -5.0], 20.0, 1e-3).unwrap()
    }

    #[test]
    fn a_report_locates_the_target_that_made_it() {
        let platform = DVector::from_vec(vec![100.0, 50.0]);
        let state = DVector::from_vec(vec![-300.0, 400.0, 1.0, 2.0]);
        let z = radar().observe(&state, Some(&platform)).unwrap();
        let fix = radar().locate(&z, Some(&platform)).unwrap();
        assert_relative_eq!(fix.mean, state.rows(0, 2).into_owned(), epsilon = 1e-10);
    }

    #[test]
    fn jacobian_is_the_derivative() {
        let state = DVector::from_vec(vec![-300.0, 400.0, 1.0, 2.0]);
        let h = radar().jacobian(&state, None).unwrap();
        for k in 0..4 {
            let mut ahead = state.clone();
            let mut behind = state.clone();
            ahead[k] += 1e-3;
            behind[k] -= 1e-3;
            let slope = (radar().observe(&ahead, None).unwrap() - radar().observe(&behind, None).unwrap()) / 2e-3;
            assert_relative_eq!(h.column(k).into_owned(), slope, epsilon = 1e-9);
        }
    }

    #[test]
    fn target_on_the_sensor_is_an_error() {
        let state = DVector::from_vec(vec![10.0, -5.0]);
        assert!(matches!(radar().observe(&state, None), Err(Error::Unobservable { .. })));
    }
}
