//! A sensor that reports poses: position and attitude, or the attitude alone.
//!
//! | symbol | name here      | shape | meaning                                                   |
//! |--------|----------------|-------|-----------------------------------------------------------|
//! | σ_p    | `position_std` | 3     | standard deviation of the position, metres                |
//! | σ_a    | `angle_std`    | 3     | standard deviation of the angles, radians, per component  |
//!
//! three angles:  z = [p, α, β, γ] + v, linear; their residuals wrap; the state holds the angles themselves
//! quaternion:    z = [p, θ], exp θ = q exp v: the state holds a rotation vector ([`StateSpace`]), σ_a stands in body axes
//!
//! A recorded quaternion becomes the rotation vector θ = log q once, at the edge ([`PoseSensor::measurement`]): q and −q become
//! the same. On changes of the state, and with residuals log(exp(θ̂)⁻¹ exp θ), H = [I 0] in both forms.
//! Reference: Sun, Zhang (2015), measurement equation; spec label H2.
//!
//! [`StateSpace`]: crate::model::StateSpace

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{Motion, PositionFix, Sensor};
use crate::error::{Error, Result, require_size, require_std};
use crate::model::rotation::reported_vector;

/// How an attitude is reported and held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum AttitudeForm {
    /// Three angles, each a coordinate of its own.
    Euler,
    /// A unit quaternion.
    Quaternion,
}

/// Position and attitude, or attitude alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseSensor {
    std: Vec<f64>,
    form: AttitudeForm,
    angles: Vec<usize>,
}

impl PoseSensor {
    /// A sensor with these standard deviations (metres, radians); without `position_std` it reports the attitude alone.
    pub fn new(position_std: Option<[f64; 3]>, angle_std: [f64; 3], form: AttitudeForm) -> Result<Self> {
        let position = position_std.as_ref().map_or(&[][..], |std| &std[..]);
        position.iter().try_for_each(|&s| require_std("position_std", s))?;
        angle_std.iter().try_for_each(|&s| require_std("angle_std", s))?;
        let first = position.len();
        Ok(Self {
            std: [position, &angle_std].concat(),
            form,
            angles: match form {
                AttitudeForm::Euler => (first..first + 3).collect(),
                AttitudeForm::Quaternion => Vec::new(),
            },
        })
    }

    /// Length of a report: that of a measurement, with four numbers for a quaternion.
    pub fn report_dim(&self) -> usize {
        self.std.len() + usize::from(self.form == AttitudeForm::Quaternion)
    }

    /// The measurement of one report: a quaternion w, x, y, z becomes a rotation vector, or NaN where one of its numbers is
    /// NaN; everything else stays. `what` names the quaternion in the error.
    pub fn measurement(&self, report: &DVector<f64>, what: &str) -> Result<DVector<f64>> {
        require_size("report of the PoseSensor", self.report_dim(), report.len())?;
        if self.form == AttitudeForm::Euler {
            return Ok(report.clone());
        }
        let first = self.std.len() - 3;
        let mut out = report.rows(0, self.std.len()).into_owned();
        let quaternion = [report[first], report[first + 1], report[first + 2], report[first + 3]];
        let vector = reported_vector(quaternion, what)?;
        out.fixed_rows_mut::<3>(first).copy_from(&vector);
        Ok(out)
    }
}

impl Sensor for PoseSensor {
    fn measurement_dim(&self) -> usize {
        self.std.len()
    }
    fn labels(&self) -> Vec<String> {
        let names = match self.form {
            AttitudeForm::Euler => ["x", "y", "z", "alpha", "beta", "gamma"],
            AttitudeForm::Quaternion => ["x", "y", "z", "rx", "ry", "rz"],
        };
        names[6 - self.std.len()..].iter().map(ToString::to_string).collect()
    }
    fn check(&self, motion: &dyn Motion) -> Result<()> {
        require_size("position of the motion model", self.std.len(), motion.position_dims())?;
        require_attitude(self, motion)
    }
    fn observe(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        Ok(state.rows(0, self.std.len()).into_owned())
    }
    fn jacobian(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        Ok(DMatrix::identity(self.std.len(), state.len()))
    }
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        _platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        let m = self.std.len();
        expected.copy_from_slice(&state.as_slice()[..m]);
        jacobian.fill(0.0);
        for i in 0..m {
            jacobian[i * state.len() + i] = 1.0;
        }
        Ok(())
    }
    fn noise(&self) -> DMatrix<f64> {
        DMatrix::from_diagonal(&DVector::from_iterator(self.std.len(), self.std.iter().map(|s| s * s)))
    }
    fn angles(&self) -> &[usize] {
        &self.angles
    }
    fn rotation(&self) -> Option<usize> {
        (self.form == AttitudeForm::Quaternion).then(|| self.std.len() - 3)
    }
    fn attitude(&self) -> Option<usize> {
        self.rotation()
    }
    fn is_linear(&self) -> bool {
        self.form == AttitudeForm::Euler
    }
    fn is_linear_in_changes(&self) -> bool {
        true
    }
    fn position_fix(&self) -> Option<&dyn PositionFix> {
        Some(self)
    }
}

/// Whether states of this motion hold the attitude where the sensor looks for it.
pub(super) fn require_attitude(sensor: &dyn Sensor, motion: &dyn Motion) -> Result<()> {
    if motion.space().attitude == sensor.attitude() {
        return Ok(());
    }
    let requirement = match sensor.attitude() {
        Some(_) => "must be a rigid body, whose state holds a rotation vector: this filter does not make it one",
        None => "must not be a rigid body: the sensor reports three angles",
    };
    Err(Error::invalid("motion", "given", requirement))
}

#[cfg(test)]
mod tests {
    use super::super::residual;
    use super::*;
    use approx::assert_relative_eq;
    use std::f64::consts::PI;

    fn pose(form: AttitudeForm) -> PoseSensor {
        PoseSensor::new(Some([1e-3; 3]), [2e-3; 3], form).unwrap()
    }

    #[test]
    fn quaternions_of_either_sign_are_one_measurement() {
        let sensor = pose(AttitudeForm::Quaternion);
        let q = [0.5, -0.1, 0.7, -0.5];
        let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
        let report =
            |sign: f64| DVector::from_iterator(7, [1.0, 2.0, 3.0].into_iter().chain(q.map(|c| sign * c / norm)));
        let measured = sensor.measurement(&report(1.0), "quaternion").unwrap();
        assert_eq!(measured, sensor.measurement(&report(-1.0), "quaternion").unwrap());
        assert_eq!(measured.rows(0, 3), report(1.0).rows(0, 3));
        let mut unseen = report(1.0);
        unseen[5] = f64::NAN;
        let measured = sensor.measurement(&unseen, "quaternion").unwrap();
        assert!(measured[2] == 3.0 && measured.rows(3, 3).iter().all(|v| v.is_nan()));
        let mut zero = report(0.0);
        zero.rows_mut(3, 4).fill(0.0);
        let error = sensor.measurement(&zero, "quaternion of row 8").unwrap_err();
        assert!(error.to_string().starts_with("quaternion of row 8"), "{error}");
        assert!(sensor.measurement(&DVector::zeros(6), "quaternion").is_err());
    }

    #[test]
    fn residuals_wrap_or_turn() {
        let euler = pose(AttitudeForm::Euler);
        let z = DVector::from_vec(vec![1.0, 1.0, 1.0, PI - 0.1, 0.0, 0.2]);
        let expected = DVector::from_vec(vec![0.0, 0.0, 0.0, -PI + 0.1, 0.0, 0.1]);
        let nu = residual(&euler, &z, &expected);
        assert_relative_eq!(
            nu,
            DVector::from_vec(vec![1.0, 1.0, 1.0, -0.2, 0.0, 0.1]),
            epsilon = 1e-14
        );
        let rotation = pose(AttitudeForm::Quaternion);
        let about = |angle: f64| DVector::from_vec(vec![0.0, 0.0, 0.0, 0.0, angle, 0.0]);
        let nu = residual(&rotation, &about(PI - 0.1), &about(-PI + 0.1));
        assert_relative_eq!(nu, about(-0.2), epsilon = 1e-14);
        let mut unseen = about(0.1);
        unseen[3] = f64::NAN;
        assert!(
            residual(&rotation, &unseen, &about(0.0))
                .rows(3, 3)
                .iter()
                .all(|v| v.is_nan())
        );
        unseen[4] = f64::INFINITY;
        assert!(residual(&rotation, &unseen, &about(0.0))[4].is_infinite());
    }

    #[test]
    fn attitude_alone() {
        let sensor = PoseSensor::new(None, [0.1, 0.2, 0.3], AttitudeForm::Quaternion).unwrap();
        assert_eq!((sensor.measurement_dim(), sensor.report_dim()), (3, 4));
        assert_eq!((sensor.rotation(), sensor.attitude()), (Some(0), Some(0)));
        assert_eq!(sensor.labels(), ["rx", "ry", "rz"]);
        assert_eq!(sensor.noise()[(2, 2)], 0.3 * 0.3);
        let error = PoseSensor::new(None, [0.1, 0.0, 0.3], AttitudeForm::Euler).unwrap_err();
        assert!(error.to_string().starts_with("angle_std = 0"), "{error}");
    }
}
