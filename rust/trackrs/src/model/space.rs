//! Where states live: numbers that add, and among them perhaps an attitude, which does not.
//!
//! | symbol | name here      | shape | meaning                                                   |
//! |--------|----------------|-------|-----------------------------------------------------------|
//! | θ      | rotation vector | 3    | the attitude of the mean, exp θ from body to frame        |
//! | δ      | `delta`        | n     | a small change of the state; its attitude part in body axes |
//!
//! retract:     θ ← log(exp θ exp δ_θ), |θ| ≤ π; every other component x ← x + δ
//! difference:  δ with `from` changed by δ = `to`: δ_θ = log((exp θ_from)⁻¹ exp θ_to), else to − from
//!
//! The covariance of such a state is that of δ: three rows for the attitude, no gimbal lock, no seam at the half turn.
//! Reference: Solà, Deray, Atchuthan (2018), A micro Lie theory for state estimation in robotics, eqs. (25), (26).

use nalgebra::{DVector, Vector3};

use super::rotation::{Rotation, vector_between};

/// The space of a state of `dim` numbers; those at `attitude`, `attitude + 1` and `attitude + 2` are a rotation vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StateSpace {
    /// Length n of the state, and of a change of it.
    pub dim: usize,
    /// Index of the rotation vector, where there is one.
    pub attitude: Option<usize>,
}

impl StateSpace {
    /// A space in which everything adds.
    pub fn euclidean(dim: usize) -> Self {
        Self { dim, attitude: None }
    }

    /// `mean` changed by `delta`.
    pub fn retract(&self, mean: &DVector<f64>, delta: &DVector<f64>) -> DVector<f64> {
        let mut out = mean + delta;
        if let Some(at) = self.attitude {
            let turned = Rotation::from_vector(&block(mean, at)) * Rotation::from_vector(&block(delta, at));
            out.fixed_rows_mut::<3>(at).copy_from(&turned.vector());
        }
        out
    }

    /// The change that leads from `from` to `to`.
    pub fn difference(&self, to: &DVector<f64>, from: &DVector<f64>) -> DVector<f64> {
        let mut out = to.clone();
        self.difference_into(to, from, &mut out);
        out
    }

    /// The same, length n each, without taking memory.
    pub(crate) fn difference_into(&self, to: &DVector<f64>, from: &DVector<f64>, out: &mut DVector<f64>) {
        to.sub_to(from, out);
        if let Some(at) = self.attitude {
            let turn = vector_between(&block(from, at), &block(to, at));
            out.fixed_rows_mut::<3>(at).copy_from(&turn);
        }
    }
}

/// Three numbers of a vector.
pub(super) fn block(vector: &DVector<f64>, at: usize) -> Vector3<f64> {
    vector.fixed_rows::<3>(at).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use std::f64::consts::PI;

    #[test]
    fn difference_undoes_retract() {
        let space = StateSpace {
            dim: 5,
            attitude: Some(1),
        };
        let mean = DVector::from_vec(vec![7.0, 2.0, -1.0, 2.0, 3.0]);
        let delta = DVector::from_vec(vec![0.5, 0.9, 0.4, -1.2, -0.1]);
        let moved = space.retract(&mean, &delta);
        assert_relative_eq!(space.difference(&moved, &mean), delta, epsilon = 1e-14);
        assert!(block(&moved, 1).norm() <= PI + 1e-15);
        let flat = StateSpace::euclidean(5);
        assert_eq!(flat.retract(&mean, &delta), &mean + &delta);
        assert_eq!(flat.difference(&moved, &mean), &moved - &mean);
    }

    #[test]
    fn the_half_turn_is_no_seam() {
        let space = StateSpace {
            dim: 3,
            attitude: Some(0),
        };
        let mean = DVector::from_vec(vec![0.0, 0.0, PI - 0.01]);
        let moved = space.retract(&mean, &DVector::from_vec(vec![0.0, 0.0, 0.03]));
        assert_relative_eq!(moved[2], 0.02 - PI, epsilon = 1e-14);
        assert_relative_eq!(space.difference(&moved, &mean)[2], 0.03, epsilon = 1e-14);
    }
}
