//! Singer's motion: an acceleration that forgets itself, and velocity jumps if wanted.
//!
//! | symbol | name here       | meaning                                                             |
//! |--------|-----------------|---------------------------------------------------------------------|
//! | σ      | `accel_std`     | stationary standard deviation of the acceleration, m/s², per axis   |
//! | τ      | `time_constant` | its correlation time, s, per axis: E a(t) a(t+s) = σ² exp(−s/τ)     |
//! | q      | `accel_psd`     | density of a white acceleration besides, m²/s³, per axis            |
//! | x      | same            | dt/τ                                                                |
//!
//! State of each axis: p, v, a.  F = [1, dt, τ²(x − 1 + e⁻ˣ); 0, 1, τ(1 − e⁻ˣ); 0, 0, e⁻ˣ]
//! Q = σ² B + q [dt³/3, dt²/2, 0; dt²/2, dt, 0; 0, 0, 0] with
//! B_pp = τ⁴ (1 − e⁻²ˣ − 4x e⁻ˣ + 2x − 2x² + 2x³/3),   B_pv = τ³ (1 + e⁻²ˣ − 2e⁻ˣ + 2x e⁻ˣ − 2x + x²),
//! B_pa = τ² (1 − e⁻²ˣ − 2x e⁻ˣ),   B_vv = τ² (4e⁻ˣ − 3 − e⁻²ˣ + 2x),   B_va = τ (1 + e⁻²ˣ − 2e⁻ˣ),   B_aa = 1 − e⁻²ˣ.
//!
//! The leading powers of x cancel in B: below x = [`SERIES`] its Taylor series are summed instead. The limit τ → ∞ is a
//! constant acceleration, τ → 0 with 2σ²τ fixed a constant velocity with a white acceleration of that density.
//! Q(a+b) = F(b) Q(a) F(b)ᵀ + Q(b): the noise does not depend on how time is cut.
//!
//! Reference: Singer (1970), IEEE Transactions on Aerospace and Electronic Systems 6(4), eqs. (8)–(15);
//! Bar-Shalom, Li, Kirubarajan (2001), §8.2.3.

use nalgebra::{DMatrix, DVector, Matrix3};
use serde::{Deserialize, Serialize};

use super::{Motion, kinematic};
use crate::error::{Error, Result, require_non_negative, require_positive, require_size};

/// Where the closed forms lose fewer digits than the series.
const SERIES: f64 = 1.5;
/// e⁻ˣ is zero beyond, and x e⁻ˣ must be so as well.
const FORGOTTEN: f64 = 745.0;

/// Singer's motion; state `x y z vx vy vz ax ay az`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Singer {
    accel_std: Vec<f64>,
    time_constant: Vec<f64>,
    accel_psd: Vec<f64>,
}

impl Singer {
    /// The model with one value of each per axis; as many axes as values.
    pub fn new(accel_std: Vec<f64>, time_constant: Vec<f64>, accel_psd: Vec<f64>) -> Result<Self> {
        if accel_std.is_empty() {
            return Err(Error::invalid("dims", 0, "must be at least 1"));
        }
        require_size("time_constant", accel_std.len(), time_constant.len())?;
        require_size("accel_psd", accel_std.len(), accel_psd.len())?;
        for i in 0..accel_std.len() {
            require_non_negative("accel_std", accel_std[i])?;
            require_positive("time_constant", time_constant[i])?;
            require_non_negative("accel_psd", accel_psd[i])?;
        }
        Ok(Self {
            accel_std,
            time_constant,
            accel_psd,
        })
    }

    /// A 3×3 matrix per axis, laid out in block order.
    fn spread(&self, axis: impl Fn(usize) -> Matrix3<f64>) -> DMatrix<f64> {
        let n = self.state_dim();
        let mut out = vec![0.0; n * n];
        self.spread_into(axis, &mut out);
        DMatrix::from_row_slice(n, n, &out)
    }

    /// The same row by row.
    fn spread_into(&self, axis: impl Fn(usize) -> Matrix3<f64>, out: &mut [f64]) {
        let dims = self.position_dims();
        out.fill(0.0);
        for k in 0..dims {
            let part = axis(k);
            for i in 0..3 {
                for j in 0..3 {
                    out[(i * dims + k) * 3 * dims + j * dims + k] = part[(i, j)];
                }
            }
        }
    }

    fn axis_noise(&self, k: usize, dt: f64) -> Matrix3<f64> {
        let (std, q) = (self.accel_std[k], self.accel_psd[k]);
        let mut out = correlation(self.time_constant[k], dt) * (std * std);
        out[(0, 0)] += q * dt * dt * dt / 3.0;
        out[(0, 1)] += q * dt * dt / 2.0;
        out[(1, 0)] += q * dt * dt / 2.0;
        out[(1, 1)] += q * dt;
        out
    }
}

impl Motion for Singer {
    fn state_dim(&self) -> usize {
        3 * self.position_dims()
    }
    fn position_dims(&self) -> usize {
        self.accel_std.len()
    }
    fn labels(&self) -> Vec<String> {
        kinematic::labels(3, self.position_dims())
    }
    fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
        let dims = self.position_dims();
        let mut out = state.clone();
        for k in 0..dims {
            let f = transition(self.time_constant[k], dt);
            let (v, a) = (state[dims + k], state[2 * dims + k]);
            out[k] += dt * v + f[(0, 2)] * a;
            out[dims + k] += f[(1, 2)] * a;
            out[2 * dims + k] = f[(2, 2)] * a;
        }
        out
    }
    fn jacobian(&self, _state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        self.spread(|k| transition(self.time_constant[k], dt))
    }
    fn noise(&self, dt: f64) -> DMatrix<f64> {
        self.spread(|k| self.axis_noise(k, dt))
    }
    fn transition_into(&self, dt: f64, out: &mut [f64]) {
        self.spread_into(|k| transition(self.time_constant[k], dt), out);
    }
    fn noise_into(&self, dt: f64, out: &mut [f64]) {
        self.spread_into(|k| self.axis_noise(k, dt), out);
    }
    fn is_linear(&self) -> bool {
        true
    }
}

/// F of one axis.
fn transition(tau: f64, dt: f64) -> Matrix3<f64> {
    let x = dt / tau;
    let decay = libm::exp(-x);
    let velocity = -tau * libm::expm1(-x);
    let position = if x.abs() < SERIES {
        dt * dt * taylor(x, 2, |_, _| 1.0)
    } else {
        tau * (dt - velocity)
    };
    Matrix3::new(1.0, dt, position, 0.0, 1.0, velocity, 0.0, 0.0, decay)
}

/// B of one axis.
fn correlation(tau: f64, dt: f64) -> Matrix3<f64> {
    let x = dt / tau;
    let aa = -libm::expm1(-2.0 * x);
    let [pp, pv, pa, vv, va] = if x.abs() < SERIES {
        let square = dt * dt;
        [
            square * square * x * taylor(x, 5, |n, two_n| 4.0 * n - two_n),
            square * dt * x * taylor(x, 4, |n, two_n| two_n - 2.0 - 2.0 * n),
            square * x * taylor(x, 3, |n, two_n| 2.0 * n - two_n),
            square * x * taylor(x, 3, |_, two_n| 4.0 - two_n),
            dt * x * taylor(x, 2, |_, two_n| two_n - 2.0),
        ]
    } else {
        let e = libm::exp(-x);
        let xe = if x > FORGOTTEN { 0.0 } else { x * e };
        let square = tau * tau;
        [
            square * square * (aa - 4.0 * xe) + 2.0 * tau * dt * (square - tau * dt + dt * dt / 3.0),
            square * tau * (1.0 + e * e - 2.0 * e + 2.0 * xe) - tau * dt * (2.0 * tau - dt),
            square * (aa - 2.0 * xe),
            square * (4.0 * e - 3.0 - e * e) + 2.0 * tau * dt,
            tau * (1.0 + e * e - 2.0 * e),
        ]
    };
    Matrix3::new(pp, pv, pa, pv, vv, va, pa, va, aa)
}

/// Σ_{n ≥ first} c(n, 2ⁿ) (−1)ⁿ xⁿ⁻ᶠⁱʳˢᵗ / n!
fn taylor(x: f64, first: u32, coefficient: impl Fn(f64, f64) -> f64) -> f64 {
    let (mut factor, mut two_n, mut sum) = (1.0, 1.0, 0.0_f64);
    for n in 1..=first {
        factor /= -f64::from(n);
        two_n *= 2.0;
    }
    for n in first..first + 40 {
        let term = factor * coefficient(f64::from(n), two_n);
        sum += term;
        if term.abs() <= 0.1 * f64::EPSILON * sum.abs() {
            break;
        }
        factor *= -x / f64::from(n + 1);
        two_n *= 2.0;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn singer(std: f64, tau: f64, psd: f64) -> Singer {
        Singer::new(vec![std], vec![tau], vec![psd]).unwrap()
    }

    #[test]
    fn written_row_by_row_they_are_the_same() {
        let model = Singer::new(vec![1.0, 2.0], vec![5.0, 9.0], vec![0.0, 0.3]).unwrap();
        let mut out = [f64::NAN; 36];
        model.noise_into(0.7, &mut out);
        assert_eq!(DMatrix::from_row_slice(6, 6, &out), model.noise(0.7));
        model.transition_into(0.7, &mut out);
        assert_eq!(
            DMatrix::from_row_slice(6, 6, &out),
            model.jacobian(&DVector::zeros(6), 0.7)
        );
    }

    #[test]
    fn noise_equals_the_closed_forms_with_many_digits() {
        let text = include_str!(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../tests/data/singer_noise.json"
        ));
        let golden: serde_json::Value = serde_json::from_str(text).unwrap();
        let places = [(0, 0, 5), (0, 1, 4), (0, 2, 3), (1, 1, 3), (1, 2, 2), (2, 2, 1)];
        for row in golden["rows"].as_array().unwrap() {
            let x = row["x"].as_f64().unwrap();
            // τ and σ other than 1 check the scaling.
            let (tau, std): (f64, f64) = (0.25, 3.0);
            let q = singer(std, tau, 0.0).noise(x * tau);
            for ((i, j, power), value) in places.into_iter().zip(row["b"].as_array().unwrap()) {
                let scale = std * std * libm::pow(tau, (4 - i - j) as f64) * libm::pow(x, f64::from(power));
                let expected = value.as_f64().unwrap() * scale;
                assert_relative_eq!(q[(i, j)], expected, max_relative = 2e-14);
            }
        }
    }

    #[test]
    fn noise_does_not_depend_on_how_time_is_cut() {
        let model = Singer::new(vec![2.0, 0.5], vec![0.3, 4.0], vec![0.7, 0.0]).unwrap();
        let x = DVector::from_vec(vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        for (a, b) in [(0.3, 1.9), (1e-4, 3e-3), (0.02, 0.4)] {
            let f = model.jacobian(&x, b);
            let cut = &f * model.noise(a) * f.transpose() + model.noise(b);
            assert_relative_eq!(cut, model.noise(a + b), max_relative = 1e-13);
            assert_relative_eq!(
                model.propagate(&model.propagate(&x, a), b),
                model.propagate(&x, a + b),
                max_relative = 1e-14
            );
            assert_relative_eq!(model.propagate(&x, b), &f * &x, max_relative = 1e-15);
        }
        assert_eq!(model.noise(0.0), DMatrix::zeros(6, 6));
        assert_eq!(model.propagate(&x, 0.0), x);
    }

    #[test]
    fn limits_are_constant_acceleration_and_constant_velocity() {
        let dt = 0.7;
        let slow = singer(1.0, 1e200, 0.0);
        assert_relative_eq!(
            slow.jacobian(&DVector::zeros(3), dt)[(0, 2)],
            dt * dt / 2.0,
            max_relative = 1e-15
        );
        assert_relative_eq!(slow.jacobian(&DVector::zeros(3), dt)[(1, 2)], dt, max_relative = 1e-15);
        let jerk = slow.noise(dt) * (1e200 / 2.0);
        assert_relative_eq!(jerk[(0, 0)], dt.powi(5) / 20.0, max_relative = 1e-14);
        assert_relative_eq!(jerk[(2, 2)], dt, max_relative = 1e-14);
        for tau in [1e-9, 1e-100, 1e-250] {
            let fast = singer(libm::sqrt(3.0 / (2.0 * tau)), tau, 0.0).noise(dt);
            assert_relative_eq!(fast[(0, 0)], 3.0 * dt.powi(3) / 3.0, max_relative = 1e-8);
            assert_relative_eq!(fast[(0, 1)], 3.0 * dt.powi(2) / 2.0, max_relative = 1e-8);
            assert_relative_eq!(fast[(1, 1)], 3.0 * dt, max_relative = 1e-8);
        }
        let white = singer(0.0, 1.0, 3.0).noise(dt);
        assert_relative_eq!(white[(0, 1)], 3.0 * dt * dt / 2.0, max_relative = 1e-15);
    }

    #[test]
    fn parameters_are_refused_by_name() {
        for (std, tau, psd, name) in [
            (-1.0, 1.0, 0.0, "accel_std"),
            (1.0, 0.0, 0.0, "time_constant"),
            (1.0, 1.0, f64::NAN, "accel_psd"),
        ] {
            let error = Singer::new(vec![std], vec![tau], vec![psd]).unwrap_err().to_string();
            assert!(error.starts_with(name), "{error}");
        }
        assert!(Singer::new(vec![], vec![], vec![]).is_err());
        assert!(Singer::new(vec![1.0], vec![1.0, 2.0], vec![0.0]).is_err());
    }
}
