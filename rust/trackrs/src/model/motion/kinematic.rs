//! Random walk, constant velocity and constant acceleration: one chain of integrators per axis.
//!
//! | symbol | name here  | meaning                                                     |
//! |--------|------------|-------------------------------------------------------------|
//! | r      | `ORDER`    | derivatives in the state: 1 position, 2 velocity, 3 acceleration |
//! | q      | `Psd`      | spectral density of the white derivative of order r, per axis |
//! | σ      | `Std`      | its standard deviation if it is constant over each step      |
//!
//! With i, j = 0..r−1 counting derivatives:
//!
//! F_ij = dt^(j−i) / (j−i)!  for j ≥ i
//! white noise:  Q_ij = q dt^(2r−1−i−j) / [(r−1−i)! (r−1−j)! (2r−1−i−j)]
//! piecewise constant:  Γ_i = dt^(r−i) / (r−i)!,  Q = σ² Γ Γᵀ
//! as an estimator of the noise wants it:  white noise Q = (L ⊗ I) (I_r ⊗ diag q) (L ⊗ I)ᵀ,  L_ij ∝ dt^(r−i−1/2)
//!
//! White noise does not depend on how time is cut: Q(a+b) = F(b) Q(a) F(b)ᵀ + Q(b).
//! Piecewise-constant noise has rank one per axis and does depend on it.
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §6.2 and §6.3.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{Motion, NoiseInput};
use crate::error::{Error, Result, require_non_negative};
use crate::linalg::cholesky::Cholesky;

/// What drives a kinematic model; one value per axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum KinematicNoise {
    /// White noise of this spectral density: m²/s (random walk), m²/s³ (constant velocity) or m²/s⁵ (constant acceleration).
    Psd(Vec<f64>),
    /// Constant over each step with this standard deviation: m/s, m/s² or m/s³.
    Std(Vec<f64>),
}

impl KinematicNoise {
    fn values(&self) -> &[f64] {
        match self {
            Self::Psd(values) | Self::Std(values) => values,
        }
    }
}

macro_rules! kinematic {
    ($(#[$doc:meta])* $name:ident, $order:literal, $parameter:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub struct $name {
            noise: KinematicNoise,
        }

        impl $name {
            /// The model with one noise value per axis; as many axes as values.
            pub fn new(noise: KinematicNoise) -> Result<Self> {
                check(&noise, $parameter)?;
                Ok(Self { noise })
            }
        }

        impl Motion for $name {
            fn state_dim(&self) -> usize {
                $order * self.position_dims()
            }
            fn position_dims(&self) -> usize {
                self.noise.values().len()
            }
            fn labels(&self) -> Vec<String> {
                labels($order, self.position_dims())
            }
            fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
                propagate($order, self.position_dims(), state, dt)
            }
            fn jacobian(&self, _state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
                let mut f = DMatrix::zeros(self.state_dim(), self.state_dim());
                each_of_transition($order, self.position_dims(), dt, |i, j, value| f[(i, j)] = value);
                f
            }
            fn noise(&self, dt: f64) -> DMatrix<f64> {
                noise($order, &self.noise, dt)
            }
            fn transition_into(&self, dt: f64, out: &mut [f64]) {
                let n = self.state_dim();
                out.fill(0.0);
                each_of_transition($order, self.position_dims(), dt, |i, j, value| out[i * n + j] = value);
            }
            fn noise_into(&self, dt: f64, out: &mut [f64]) {
                let n = self.state_dim();
                out.fill(0.0);
                each_of_noise($order, &self.noise, dt, |i, j, value| out[i * n + j] = value);
            }
            fn is_linear(&self) -> bool {
                true
            }
            fn noise_input(&self, dt: f64) -> Option<NoiseInput> {
                noise_input($order, &self.noise, dt)
            }
        }
    };
}

kinematic!(
    /// Position that wanders; state `x y z`.
    RandomWalk, 1, "velocity"
);
kinematic!(
    /// Nearly constant velocity; state `x y z vx vy vz`.
    ConstantVelocity, 2, "accel"
);
kinematic!(
    /// Nearly constant acceleration; state `x y z vx vy vz ax ay az`.
    ConstantAcceleration, 3, "jerk"
);

fn check(noise: &KinematicNoise, parameter: &str) -> Result<()> {
    let suffix = match noise {
        KinematicNoise::Psd(_) => "psd",
        KinematicNoise::Std(_) => "std",
    };
    if noise.values().is_empty() {
        return Err(Error::invalid("dims", 0, "must be at least 1"));
    }
    for &value in noise.values() {
        require_non_negative(&format!("{parameter}_{suffix}"), value)?;
    }
    Ok(())
}

pub(super) fn labels(order: usize, dims: usize) -> Vec<String> {
    let axis = |i: usize| match (dims, i) {
        (1..=3, i) => ["x", "y", "z"][i].to_string(),
        _ => format!("x{i}"),
    };
    ["", "v", "a"][..order]
        .iter()
        .flat_map(|prefix| (0..dims).map(move |i| format!("{prefix}{}", axis(i))))
        .collect()
}

fn propagate(order: usize, dims: usize, state: &DVector<f64>, dt: f64) -> DVector<f64> {
    let mut out = state.clone();
    for axis in 0..dims {
        for i in 0..order {
            for j in i + 1..order {
                out[i * dims + axis] += power_over_factorial(dt, j - i) * state[j * dims + axis];
            }
        }
    }
    out
}

/// Row, column and value of the numbers of F.
#[inline(always)]
fn each_of_transition(order: usize, dims: usize, dt: f64, mut put: impl FnMut(usize, usize, f64)) {
    for i in 0..order {
        for j in i..order {
            let value = power_over_factorial(dt, j - i);
            for axis in 0..dims {
                put(i * dims + axis, j * dims + axis, value);
            }
        }
    }
}

fn noise(order: usize, noise: &KinematicNoise, dt: f64) -> DMatrix<f64> {
    let n = order * noise.values().len();
    let mut q = DMatrix::zeros(n, n);
    each_of_noise(order, noise, dt, |i, j, value| q[(i, j)] = value);
    q
}

/// Row, column and value of the numbers of Q.
#[inline(always)]
fn each_of_noise(order: usize, noise: &KinematicNoise, dt: f64, mut put: impl FnMut(usize, usize, f64)) {
    let dims = noise.values().len();
    for i in 0..order {
        for j in 0..order {
            let (a, b) = (order - 1 - i, order - 1 - j);
            match noise {
                KinematicNoise::Psd(psd) => {
                    let power = power_over_factorial(dt, a) * power_over_factorial(dt, b) * dt;
                    for (axis, &value) in psd.iter().enumerate() {
                        put(i * dims + axis, j * dims + axis, value * power / ((a + b + 1) as f64));
                    }
                }
                KinematicNoise::Std(std) => {
                    let (left, right) = (power_over_factorial(dt, a + 1), power_over_factorial(dt, b + 1));
                    for (axis, &value) in std.iter().enumerate() {
                        put(i * dims + axis, j * dims + axis, value * value * left * right);
                    }
                }
            }
        }
    }
}

/// Γ and diag(σ²) of noise that is constant over a step. White noise enters as r independent noises of the density q
/// through Γ = L ⊗ I_d, where L Lᵀ is the Q of one axis of unit density.
fn noise_input(order: usize, noise: &KinematicNoise, dt: f64) -> Option<NoiseInput> {
    let dims = noise.values().len();
    let (factor, variances) = match noise {
        KinematicNoise::Std(std) => {
            let gamma = DMatrix::from_fn(order, 1, |i, _| power_over_factorial(dt, order - i));
            (gamma, std.iter().map(|s| s * s).collect::<Vec<_>>())
        }
        KinematicNoise::Psd(psd) => (unit_factor(order, dt)?, psd.clone()),
    };
    Some(NoiseInput {
        gain: factor.kronecker(&DMatrix::<f64>::identity(dims, dims)),
        repeat: factor.ncols(),
        cov: DMatrix::from_diagonal(&DVector::from_vec(variances)),
        rest: None,
    })
}

/// L of one axis of unit density. Scaled by powers of dt it is that of dt = 1, which keeps a short step from vanishing.
fn unit_factor(order: usize, dt: f64) -> Option<DMatrix<f64>> {
    let unit = self::noise(order, &KinematicNoise::Psd(vec![1.0]), 1.0);
    let factor = Cholesky::new(&unit, "noise of unit density").ok()?;
    let scale = |i: usize| (i + 1..order).fold(dt.sqrt(), |scale, _| scale * dt);
    Some(DMatrix::from_fn(order, order, |i, j| scale(i) * factor.lower()[(i, j)]))
}

/// dtᵏ / k! for k ≤ 3.
#[inline]
fn power_over_factorial(dt: f64, k: usize) -> f64 {
    match k {
        0 => 1.0,
        1 => dt,
        2 => dt * dt / 2.0,
        _ => dt * dt * dt / 6.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn white_noise_does_not_depend_on_how_time_is_cut() {
        let model = ConstantAcceleration::new(KinematicNoise::Psd(vec![0.7, 2.0])).unwrap();
        let x = DVector::from_element(6, 1.0);
        let (a, b) = (0.3, 1.9);
        let f = model.jacobian(&x, b);
        let cut = &f * model.noise(a) * f.transpose() + model.noise(b);
        assert_relative_eq!(cut, model.noise(a + b), max_relative = 1e-13, epsilon = 1e-15);
        assert_relative_eq!(model.propagate(&x, b), f * x, epsilon = 1e-15);
    }

    #[test]
    fn textbook_constant_velocity_in_block_order() {
        let dt = 2.0;
        let psd = ConstantVelocity::new(KinematicNoise::Psd(vec![3.0, 3.0]))
            .unwrap()
            .noise(dt);
        assert_eq!(psd[(0, 0)], 3.0 * dt * dt * dt / 3.0);
        assert_eq!(psd[(1, 3)], 3.0 * dt * dt / 2.0);
        assert_eq!(psd[(2, 2)], 3.0 * dt);
        assert_eq!(psd[(0, 1)], 0.0);
        let std = ConstantVelocity::new(KinematicNoise::Std(vec![3.0])).unwrap().noise(dt);
        assert_eq!(std, DMatrix::from_row_slice(2, 2, &[36.0, 36.0, 36.0, 36.0]));
    }

    #[test]
    fn zero_interval_is_the_identity() {
        let model = ConstantVelocity::new(KinematicNoise::Std(vec![1.0; 3])).unwrap();
        assert_eq!(model.jacobian(&DVector::zeros(6), 0.0), DMatrix::identity(6, 6));
        assert_eq!(model.noise(0.0), DMatrix::zeros(6, 6));
        assert_eq!(model.labels(), ["x", "y", "z", "vx", "vy", "vz"]);
    }

    #[test]
    fn written_row_by_row_they_are_the_same() {
        for noise in [
            KinematicNoise::Psd(vec![0.7, 2.0, 3.1]),
            KinematicNoise::Std(vec![0.7, 2.0, 3.1]),
        ] {
            let models: [&dyn Motion; 3] = [
                &RandomWalk::new(noise.clone()).unwrap(),
                &ConstantVelocity::new(noise.clone()).unwrap(),
                &ConstantAcceleration::new(noise.clone()).unwrap(),
            ];
            for model in models {
                let n = model.state_dim();
                let mut out = vec![f64::NAN; n * n];
                model.noise_into(0.3, &mut out);
                assert_eq!(DMatrix::from_row_slice(n, n, &out), model.noise(0.3));
                out.fill(f64::NAN);
                model.transition_into(0.3, &mut out);
                assert_eq!(
                    DMatrix::from_row_slice(n, n, &out),
                    model.jacobian(&DVector::zeros(n), 0.3)
                );
            }
        }
    }

    #[test]
    fn negative_density_is_refused_by_its_name() {
        let error = ConstantVelocity::new(KinematicNoise::Psd(vec![-1.0])).unwrap_err();
        assert!(error.to_string().starts_with("accel_psd = -1"), "{error}");
    }
}
