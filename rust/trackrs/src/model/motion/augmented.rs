//! A motion with the lasting errors of a sensor behind it: x = [kinematic; η].
//!
//! f(x) = [f(kinematic); η],  F = blkdiag(F, I),  Q = blkdiag(Q, diag(w) dt): the errors stay, or wander as random walks.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{Motion, MotionModel, NoiseInput};
use crate::model::sensor::Nuisance;
use crate::model::space::StateSpace;

/// See the module's description.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Augmented {
    base: MotionModel,
    nuisance: Nuisance,
}

impl Augmented {
    /// `base` followed by these errors.
    pub fn new(base: MotionModel, nuisance: Nuisance) -> Self {
        Self { base, nuisance }
    }

    fn kinematic(&self, state: &DVector<f64>) -> DVector<f64> {
        state.rows(0, self.base.state_dim()).into_owned()
    }

    fn enlarge(&self, part: &DMatrix<f64>, rest: impl Fn(usize) -> f64) -> DMatrix<f64> {
        let (n, q) = (part.nrows(), self.nuisance.dim());
        let mut out = DMatrix::zeros(n + q, n + q);
        out.view_mut((0, 0), (n, n)).copy_from(part);
        for i in 0..q {
            out[(n + i, n + i)] = rest(i);
        }
        out
    }
}

impl Motion for Augmented {
    fn state_dim(&self) -> usize {
        self.base.state_dim() + self.nuisance.dim()
    }
    fn position_dims(&self) -> usize {
        self.base.position_dims()
    }
    fn labels(&self) -> Vec<String> {
        let mut labels = self.base.labels();
        labels.extend(self.nuisance.labels.iter().cloned());
        labels
    }
    fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
        let mut out = state.clone();
        let moved = self.base.propagate(&self.kinematic(state), dt);
        out.rows_mut(0, moved.len()).copy_from(&moved);
        out
    }
    fn jacobian(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        self.enlarge(&self.base.jacobian(&self.kinematic(state), dt), |_| 1.0)
    }
    fn noise(&self, dt: f64) -> DMatrix<f64> {
        self.enlarge(&self.base.noise(dt), |i| self.nuisance.walk_psd[i] * dt)
    }
    fn noise_at(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        let base = self.base.noise_at(&self.kinematic(state), dt);
        self.enlarge(&base, |i| self.nuisance.walk_psd[i] * dt)
    }
    fn space(&self) -> StateSpace {
        StateSpace {
            dim: self.state_dim(),
            attitude: self.base.space().attitude,
        }
    }
    fn is_linear(&self) -> bool {
        self.base.is_linear()
    }
    /// That of the base; how the errors wander is not the estimator's to find.
    fn noise_input(&self, dt: f64) -> Option<NoiseInput> {
        Some(self.behind(self.base.noise_input(dt)?, dt))
    }
    fn noise_input_at(&self, state: &DVector<f64>, dt: f64) -> Option<NoiseInput> {
        Some(self.behind(self.base.noise_input_at(&self.kinematic(state), dt)?, dt))
    }
}

impl Augmented {
    /// The base's noise, and the walks of the errors behind it.
    fn behind(&self, entry: NoiseInput, dt: f64) -> NoiseInput {
        let (rows, extra) = (entry.gain.nrows(), self.nuisance.dim());
        let nothing = || DMatrix::zeros(rows, rows);
        let walks = self.nuisance.walk_psd.iter().any(|&psd| psd > 0.0);
        let rest = (walks || entry.rest.is_some()).then(|| {
            let base = entry.rest.clone().unwrap_or_else(nothing);
            self.enlarge(&base, |i| self.nuisance.walk_psd[i] * dt)
        });
        NoiseInput {
            gain: entry.gain.insert_rows(rows, extra, 0.0),
            repeat: entry.repeat,
            cov: entry.cov,
            rest,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::motion::{ConstantVelocity, KinematicNoise};
    use approx::assert_relative_eq;

    fn augmented(psd: f64) -> Augmented {
        let base = ConstantVelocity::new(KinematicNoise::Std(vec![0.5, 0.5])).unwrap();
        let nuisance = Nuisance {
            labels: vec!["bias0".into(), "scale".into()],
            std: vec![1.0, 0.1],
            walk_psd: vec![psd, 0.0],
        };
        Augmented::new(MotionModel::ConstantVelocity(base), nuisance)
    }

    #[test]
    fn errors_stay_and_the_rest_is_the_base() {
        let motion = augmented(0.3);
        let x = DVector::from_vec(vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(motion.labels()[3..], ["vy", "bias0", "scale"]);
        let moved = motion.propagate(&x, 2.0);
        assert_eq!(moved.as_slice(), [7.0, 10.0, 3.0, 4.0, 5.0, 6.0]);
        assert_relative_eq!(motion.jacobian(&x, 2.0) * &x, moved);
        assert_relative_eq!(motion.propagate(&moved, -2.0), x, epsilon = 1e-14);
        let q = motion.noise(2.0);
        assert_eq!((q[(4, 4)], q[(5, 5)], q[(0, 4)]), (0.6, 0.0, 0.0));
        assert_eq!(motion.noise(0.0), DMatrix::zeros(6, 6));
        let rest = motion.noise_input(2.0).unwrap().rest.unwrap();
        assert_eq!((rest[(4, 4)], rest.sum()), (0.6, 0.6));
        let still = augmented(0.0);
        let entry = still.noise_input(2.0).unwrap();
        assert_relative_eq!(&entry.gain * entry.cov * entry.gain.transpose(), still.noise(2.0));
    }
}
