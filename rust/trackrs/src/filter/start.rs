//! A state from position fixes at different times.
//!
//! | symbol   | name here    | shape | meaning                                                       |
//! |----------|--------------|-------|---------------------------------------------------------------|
//! | r        | `order`      |       | derivatives in the state: 1 position, 2 velocity, 3 acceleration |
//! | p_i, C_i | `position`   | d, d×d | fixes at t_1 < … < t_r, and their covariances                |
//! | V        | `vandermonde` | r×r  | V_ij = (t_i − t_r)^j / j!                                     |
//! | W_i      | `noise`      | n×n   | covariance of the motion noise from t_i to t_r                |
//!
//! The polynomial through r fixes, at the time of the last (U12): x = (V⁻¹ ⊗ I) [p_1; …; p_r],
//! P = (V⁻¹ ⊗ I) blkdiag(C_1, …, C_r) (V⁻¹ ⊗ I)ᵀ: position, velocity and acceleration are strongly correlated.
//!
//! With a motion model, the noise between the fixes is added: p_i = v_i (x − w_i) + e_i with v_i row i of V ⊗ I, so that
//! E[v_i w_i (v_j w_j)ᵀ] = v_i W_j v_jᵀ for i ≤ j joins the covariance of the fixes. Without one it is U12 as it stands. Of a
//! motion whose accelerations fade v_i are the first rows of F(t_i − t_r).
//!
//! Fixes with angles or an attitude (`local_fixes`) are counted from the last one, where these are small and add.
//!
//! Reference: paper of Xi, Liu, Tao, Lu, initial values; spec label U12.
//! Deviation: the paper takes the velocity of the first interval and a block-diagonal covariance.

use nalgebra::{DMatrix, DVector};

use super::chart::{Chart, attitude_of};
use super::sequence::InitialState;
use crate::error::{Error, Result, require_finite, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::symmetric::symmetrise;
use crate::model::Motion;
use crate::model::rotation::vector_between;
use crate::model::sensor::wrap_angle;

/// A position at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct TimedFix {
    /// Seconds.
    pub time: f64,
    /// Position and covariance.
    pub position: Gaussian,
}

/// The state at the last of `order` fixes: position, velocity and acceleration as far as `order` goes.
///
/// With a `motion` its noise between the fixes counts in the covariance.
pub fn start_state(fixes: &[TimedFix], order: usize, motion: Option<&dyn Motion>) -> Result<InitialState> {
    let d = check(fixes, order, motion)?;
    let times: Vec<f64> = fixes.iter().map(|f| f.time).collect();
    let last = times[order - 1];
    let vandermonde = DMatrix::from_fn(order, order, |i, j| {
        let t = times[i] - last;
        [1.0, t, t * t / 2.0][j]
    });
    let Some(inverse) = vandermonde.clone().try_inverse() else {
        return Err(Error::invalid("times of the fixes", "given", "must lie farther apart"));
    };
    let mut stacked = DVector::zeros(order * d);
    let mut cov = DMatrix::zeros(order * d, order * d);
    for (i, fix) in fixes.iter().enumerate() {
        stacked.rows_mut(i * d, d).copy_from(&fix.position.mean);
        cov.view_mut((i * d, i * d), (d, d)).copy_from(&fix.position.cov);
    }
    let identity = DMatrix::<f64>::identity(d, d);
    let polynomial = vandermonde.kronecker(&identity);
    let mut solve = inverse.kronecker(&identity);
    if let Some(motion) = motion {
        let rows = rows_of(motion, &times, d);
        if rows != polynomial {
            let undetermined = || Error::invalid("times of the fixes", "given", "must lie farther apart");
            solve = rows.clone().try_inverse().ok_or_else(undetermined)?;
        }
        add_noise(&mut cov, &times, &rows, motion);
    }
    let mean = &solve * stacked;
    let mut cov = &solve * cov * solve.transpose();
    symmetrise(&mut cov);
    let state = Gaussian { mean, cov };
    state.require_finite("start")?;
    Ok(InitialState { time: last, state })
}

/// These fixes in coordinates that add, as angles (`angles`) and attitudes (`attitude`) do not: angles the shorter way from
/// those of the last fix, attitudes as turns φ_i = log((exp θ_r)⁻¹ exp θ_i) with the covariance J_r⁻¹(φ_i) C_i J_r⁻ᵀ(φ_i).
pub(super) fn local_fixes(fixes: &[TimedFix], angles: &[usize], attitude: Option<usize>) -> Vec<TimedFix> {
    let mut local = fixes.to_vec();
    let Some(last) = fixes.last().map(|fix| &fix.position.mean) else {
        return local;
    };
    for fix in &mut local {
        let Gaussian { mean, cov } = &mut fix.position;
        for &i in angles {
            mean[i] = last[i] + wrap_angle(mean[i] - last[i]);
        }
        if let Some(at) = attitude {
            let turn = vector_between(&attitude_of(last.as_slice(), at), &attitude_of(mean.as_slice(), at));
            mean.fixed_rows_mut::<3>(at).copy_from(&turn);
            Chart::back(at, &turn).both(last.len(), cov.as_mut_slice());
        }
    }
    local
}

/// The dimension d of the fixes.
fn check(fixes: &[TimedFix], order: usize, motion: Option<&dyn Motion>) -> Result<usize> {
    if !(1..=3).contains(&order) {
        return Err(Error::invalid("order", order, "must be 1, 2 or 3"));
    }
    require_size("fixes", order, fixes.len())?;
    let d = fixes[0].position.dim();
    for fix in fixes {
        require_size("position of a fix", d, fix.position.dim())?;
        require_finite("time of a fix", [&fix.time])?;
    }
    if let Some(motion) = motion {
        require_size("state of the motion model", order * d, motion.state_dim())?;
    }
    for pair in fixes.windows(2) {
        let (previous, time) = (pair[0].time, pair[1].time);
        if time < previous {
            return Err(Error::TimeReversed { time, previous });
        }
        if time == previous {
            return Err(Error::invalid("time of a fix", time, "must differ from the one before"));
        }
    }
    Ok(d)
}

/// The positions at these times of a state at the last of them.
fn rows_of(motion: &dyn Motion, times: &[f64], d: usize) -> DMatrix<f64> {
    let n = motion.state_dim();
    let origin = DVector::zeros(n);
    let last = times.last().copied().unwrap_or_default();
    let mut rows = DMatrix::zeros(times.len() * d, n);
    for (i, time) in times.iter().enumerate() {
        let back = motion.jacobian(&origin, time - last);
        rows.rows_mut(i * d, d).copy_from(&back.rows(0, d));
    }
    rows
}

fn add_noise(cov: &mut DMatrix<f64>, times: &[f64], rows: &DMatrix<f64>, motion: &dyn Motion) {
    let (order, n) = (times.len(), motion.state_dim());
    let d = n / order;
    let origin = DVector::zeros(n);
    let last = times[order - 1];
    let mut noise = DMatrix::zeros(n, n);
    for j in (0..order.saturating_sub(1)).rev() {
        let f = motion.jacobian(&origin, last - times[j + 1]);
        noise += &f * motion.noise(times[j + 1] - times[j]) * f.transpose();
        let right = &noise * rows.rows(j * d, d).transpose();
        for i in 0..=j {
            let block = rows.rows(i * d, d) * &right;
            let mut upper = cov.view_mut((i * d, j * d), (d, d));
            upper += &block;
            if i < j {
                let mut lower = cov.view_mut((j * d, i * d), (d, d));
                lower += block.transpose();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise};
    use approx::assert_relative_eq;

    fn fix(time: f64, x: f64, variance: f64) -> TimedFix {
        TimedFix {
            time,
            position: Gaussian {
                mean: DVector::from_vec(vec![x]),
                cov: DMatrix::from_element(1, 1, variance),
            },
        }
    }

    #[test]
    fn equal_steps_are_the_difference_formulas() {
        let (dt, p) = (0.5, [1.0, 2.0, 4.5]);
        let fixes = [fix(0.0, p[0], 1.0), fix(dt, p[1], 2.0), fix(2.0 * dt, p[2], 3.0)];
        let start = start_state(&fixes, 3, None).unwrap();
        let v = (3.0 * p[2] - 4.0 * p[1] + p[0]) / (2.0 * dt);
        let a = (p[2] - 2.0 * p[1] + p[0]) / (dt * dt);
        assert_relative_eq!(start.state.mean, DVector::from_vec(vec![p[2], v, a]), epsilon = 1e-12);
        assert_relative_eq!(start.state.cov[(2, 2)], (1.0 + 8.0 + 3.0) / dt.powi(4), epsilon = 1e-9);
        let two = start_state(&fixes[1..], 2, None).unwrap();
        assert_relative_eq!(two.state.mean[1], (p[2] - p[1]) / dt, epsilon = 1e-12);
        assert_eq!(two.time, 1.0);
        assert_eq!(start_state(&fixes[2..], 1, None).unwrap().state, fixes[2].position);
    }

    /// The information filter over the same fixes, started from nothing, is the same estimate.
    #[test]
    fn noise_between_fixes_agrees_with_a_filter_from_a_flat_prior() {
        let fixes = [fix(0.0, 1.0, 1.0), fix(0.7, 2.0, 2.0), fix(2.0, 4.5, 3.0)];
        let models: [(&dyn Motion, usize); 2] = [
            (&ConstantAcceleration::new(KinematicNoise::Psd(vec![0.5])).unwrap(), 3),
            (&ConstantVelocity::new(KinematicNoise::Std(vec![0.8])).unwrap(), 2),
        ];
        for (motion, order) in models {
            let used = &fixes[3 - order..];
            let start = start_state(used, order, Some(motion)).unwrap();
            let mut state = Gaussian {
                mean: DVector::zeros(order),
                cov: DMatrix::identity(order, order) * 1e8,
            };
            let mut now = used[0].time;
            for f in used {
                state = super::super::kalman::predict(&state, motion, f.time - now, None).unwrap();
                now = f.time;
                let h = DMatrix::identity(1, order);
                let r = &f.position.mean - &h * &state.mean;
                let prediction = super::super::kalman::MeasurementPrediction::new(&state, &h, &f.position.cov).unwrap();
                state = prediction.posterior(&state, &r);
            }
            assert_relative_eq!(start.state.mean, state.mean, max_relative = 1e-4);
            assert_relative_eq!(start.state.cov, state.cov, max_relative = 1e-4);
        }
    }

    #[test]
    fn times_must_increase_and_counts_agree() {
        let at = |t| fix(t, 1.0, 1.0);
        assert!(matches!(
            start_state(&[at(1.0), at(0.0)], 2, None),
            Err(Error::TimeReversed { .. })
        ));
        assert!(start_state(&[at(1.0), at(1.0)], 2, None).is_err());
        assert!(start_state(&[at(1.0)], 2, None).is_err());
        assert!(start_state(&[], 0, None).is_err());
    }
}
