//! The starting state of the underwater paper, from three position fixes, as printed. See [`super::start`] for a right one.
//!
//! | symbol   | name here      | shape  | meaning                                            |
//! |----------|----------------|--------|----------------------------------------------------|
//! | p_i, C_i | `fixes`        | d, d×d | position fixes at t_1 < t_2 < t_3                  |
//! | σ_1      | `velocity_std` |        | standard deviation of a velocity component, m/s    |
//! | σ_2      | `accel_std`    |        | standard deviation of an acceleration, m/s²        |
//!
//! V' = (p_2 − p_1)/(t_2 − t_1),  V'' = (p_3 − p_2)/(t_3 − t_2),  a = (V'' − V')/(t_3 − t_2)
//! x = [p_3; V'; a],  P = blkdiag(C_3, σ_1² I, σ_2² I), at t_3.
//!
//! What is wrong with it: V' is the velocity in the middle of the first interval, one and a half steps before t_3; a is
//! right for equal steps only, else the divisor is (t_3 − t_1)/2; and P leaves out that position, velocity and acceleration
//! come from the same fixes and are strongly correlated.
//!
//! Reference: Xi, Liu, Tao, Lu, initial values; the spec under U12.

use nalgebra::{DMatrix, DVector};

use super::sequence::InitialState;
use super::start::{TimedFix, start_state};
use crate::error::{Result, require_positive, require_size};
use crate::gaussian::Gaussian;

/// The state of position, velocity and acceleration at the last of three fixes, by the rule of the paper.
pub fn paper_start(fixes: &[TimedFix], velocity_std: f64, accel_std: f64) -> Result<InitialState> {
    require_positive("velocity_std", velocity_std)?;
    require_positive("accel_std", accel_std)?;
    require_size("fixes", 3, fixes.len())?;
    // The right rule refuses the same fixes, and says why.
    let right = start_state(fixes, 3, None)?;
    let d = fixes[0].position.dim();
    let velocity = |i: usize| {
        let dt = fixes[i + 1].time - fixes[i].time;
        (&fixes[i + 1].position.mean - &fixes[i].position.mean) / dt
    };
    let (first, second) = (velocity(0), velocity(1));
    let accel = (second - &first) / (fixes[2].time - fixes[1].time);
    let mut mean = DVector::zeros(3 * d);
    let mut cov = DMatrix::zeros(3 * d, 3 * d);
    let position = &fixes[2].position;
    for (block, part) in [&position.mean, &first, &accel].into_iter().enumerate() {
        mean.rows_mut(block * d, d).copy_from(part);
    }
    cov.view_mut((0, 0), (d, d)).copy_from(&position.cov);
    for i in 0..d {
        cov[(d + i, d + i)] = velocity_std * velocity_std;
        cov[(2 * d + i, 2 * d + i)] = accel_std * accel_std;
    }
    let state = Gaussian { mean, cov };
    state.require_finite("start")?;
    Ok(InitialState {
        time: right.time,
        state,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(time: f64, x: f64) -> TimedFix {
        TimedFix {
            time,
            position: Gaussian {
                mean: DVector::from_element(1, x),
                cov: DMatrix::from_element(1, 1, 2.0),
            },
        }
    }

    #[test]
    fn unequal_steps_as_printed() {
        let fixes = [fix(0.0, 1.0), fix(1.0, 3.0), fix(3.0, 11.0)];
        let start = paper_start(&fixes, 2.0, 1.0).unwrap();
        assert_eq!(start.time, 3.0);
        assert_eq!(start.state.mean.as_slice(), [11.0, 2.0, 1.0]);
        let diagonal = DVector::from_row_slice(&[2.0, 4.0, 1.0]);
        assert_eq!(start.state.cov, DMatrix::from_diagonal(&diagonal));
    }

    #[test]
    fn bad_input_is_named() {
        let fixes = [fix(0.0, 1.0), fix(1.0, 3.0), fix(1.0, 11.0)];
        assert!(paper_start(&fixes, 2.0, 1.0).is_err());
        assert!(paper_start(&fixes[..2], 2.0, 1.0).is_err());
        let error = paper_start(&fixes, 0.0, 1.0).unwrap_err().to_string();
        assert!(error.starts_with("velocity_std"), "{error}");
    }
}
