//! A rigid body: a kinematic motion some of whose axes are an attitude.
//!
//! | symbol | name here | shape | meaning                                                                |
//! |--------|-----------|-------|------------------------------------------------------------------------|
//! | F, Q   | `base`    | n×n   | kinematic motion of 6 axes (position, rotation) or 3 (rotation)        |
//! | θ      |           | 3     | attitude, a rotation vector: exp θ takes body to frame                 |
//! | ω, ω̇   |           | 3     | its rates as the base has them, in body axes                           |
//! | φ      | `turn`    | 3     | turn within the step, in body axes                                     |
//!
//! y = F x with θ set to zero,  φ = y_θ:  θ′ = log(exp θ exp φ), every other component as in y.
//! With δ as in [`StateSpace`]:  δ_θ′ = R(φ)ᵀ δ_θ + J_r(φ) (F_θ· δ without its attitude), the other rows as in F;
//! Q′ = J Q Jᵀ with J = J_r(φ) on the rows of the attitude and 1 elsewhere: noise enters φ.
//!
//! The rates are constant in body axes while the base says so; a body that turns freely about a fixed axis does just that.
//! Reference: Solà, Deray, Atchuthan (2018), A micro Lie theory for state estimation in robotics, eqs. (66)–(73), (143).
//! Deviation: over a step in which ω changes its direction exp(φ) is the first term of the Magnus series; the next one is
//! ω × ω̇ dt³/12: 4e-5 rad for 3 rad/s and 20 rad/s² across each other, at 50 Hz.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{Motion, MotionModel, NoiseInput};
use crate::error::{Error, Result};
use crate::linalg::symmetric::symmetrise;
use crate::model::rotation::{Rotation, right_jacobian};
use crate::model::space::{StateSpace, block};

/// A kinematic motion with an attitude among its axes; state `x y z rx ry rz vx vy vz wx wy wz …` or `rx ry rz wx wy wz …`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RigidBody {
    base: MotionModel,
    attitude: usize,
}

impl RigidBody {
    /// `base` with the last three of its axes, which begin at index `attitude`, as rotation.
    pub fn around(base: MotionModel, attitude: usize) -> Result<Self> {
        crate::error::require_size("position of the motion model", attitude + 3, base.position_dims())?;
        let f = base.jacobian(&DVector::zeros(base.state_dim()), 1.0);
        let keeps = (0..f.nrows()).all(|i| (attitude..attitude + 3).all(|j| f[(i, j)] == f64::from(u8::from(i == j))));
        if !base.is_linear() || !keeps {
            let requirement = "must be linear and move a body in every attitude alike";
            return Err(Error::invalid("motion", "given", requirement));
        }
        Ok(Self { base, attitude })
    }

    /// `base`, or the rigid body around it where a sensor needs an attitude that it does not have and could.
    pub(crate) fn if_needed(base: MotionModel, attitude: Option<usize>) -> Result<MotionModel> {
        match attitude {
            Some(at) if base.space().attitude.is_none() && at + 3 <= base.position_dims() => {
                Ok(MotionModel::RigidBody(Box::new(Self::around(base, at)?)))
            }
            _ => Ok(base),
        }
    }

    /// The kinematic motion.
    pub fn base(&self) -> &MotionModel {
        &self.base
    }

    /// y, the state moved on with the attitude left out.
    fn moved(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
        let mut start = state.clone();
        start.fixed_rows_mut::<3>(self.attitude).fill(0.0);
        self.base.propagate(&start, dt)
    }

    /// J M with J = `by` on the rows of the attitude.
    fn turn_rows(&self, matrix: &mut DMatrix<f64>, by: &Matrix3<f64>) {
        let rows = by * matrix.fixed_rows::<3>(self.attitude);
        matrix.fixed_rows_mut::<3>(self.attitude).copy_from(&rows);
    }

    /// J P Jᵀ.
    fn turned_cov(&self, mut cov: DMatrix<f64>, by: &Matrix3<f64>) -> DMatrix<f64> {
        self.turn_rows(&mut cov, by);
        cov.transpose_mut();
        self.turn_rows(&mut cov, by);
        symmetrise(&mut cov);
        cov
    }
}

impl Motion for RigidBody {
    fn state_dim(&self) -> usize {
        self.base.state_dim()
    }
    fn position_dims(&self) -> usize {
        self.base.position_dims()
    }
    fn labels(&self) -> Vec<String> {
        let dims = self.position_dims();
        let prefixes = [["", "r"], ["v", "w"], ["a", "alpha"]];
        let name = |i: usize| {
            let (order, axis) = (i / dims, i % dims);
            let turns = axis >= self.attitude;
            let letter = ["x", "y", "z"][(if turns { axis - self.attitude } else { axis }).min(2)];
            prefixes.get(order).map_or_else(
                || format!("x{i}"),
                |pair| format!("{}{letter}", pair[usize::from(turns)]),
            )
        };
        (0..self.state_dim()).map(name).collect()
    }
    fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
        let mut out = self.moved(state, dt);
        let turn = Rotation::from_vector(&block(&out, self.attitude));
        let attitude = Rotation::from_vector(&block(state, self.attitude)) * turn;
        out.fixed_rows_mut::<3>(self.attitude).copy_from(&attitude.vector());
        out
    }
    fn jacobian(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        let turn = block(&self.moved(state, dt), self.attitude);
        let mut out = self.base.jacobian(state, dt);
        self.turn_rows(&mut out, &right_jacobian(&turn));
        let back = Rotation::from_vector(&turn).matrix().transpose();
        out.fixed_view_mut::<3, 3>(self.attitude, self.attitude)
            .copy_from(&back);
        out
    }
    /// Q of a body that does not turn; [`Motion::noise_at`] has it at a state.
    fn noise(&self, dt: f64) -> DMatrix<f64> {
        self.base.noise(dt)
    }
    fn noise_at(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        let by = right_jacobian(&block(&self.moved(state, dt), self.attitude));
        self.turned_cov(self.base.noise(dt), &by)
    }
    /// F x by the elements of F that are not zero: F is that of the base, which is linear.
    fn propagate_all(&self, states: &[f64], dt: f64, out: &mut [f64]) -> Result<()> {
        let (n, at) = (self.state_dim(), self.attitude);
        let f = self.base.jacobian(&DVector::zeros(n), dt);
        let every = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
        let elements: Vec<_> = every
            .filter(|&(i, j)| !(at..at + 3).contains(&j) && f[(i, j)] != 0.0)
            .map(|(i, j)| (i, j, f[(i, j)]))
            .collect();
        let mut last = (Vector3::zeros(), Rotation::identity());
        for (state, moved) in states.chunks_exact(n).zip(out.chunks_exact_mut(n)) {
            moved.fill(0.0);
            for &(i, j, value) in &elements {
                moved[i] += value * state[j];
            }
            // Most sigma points share the attitude of their centre.
            let attitude = Vector3::from_column_slice(&state[at..at + 3]);
            if attitude != last.0 {
                last = (attitude, Rotation::from_vector(&attitude));
            }
            let turn = Rotation::from_vector(&Vector3::from_column_slice(&moved[at..at + 3]));
            moved[at..at + 3].copy_from_slice((last.1 * turn).vector().as_slice());
        }
        Ok(())
    }
    fn is_linear(&self) -> bool {
        false
    }
    fn noise_input(&self, dt: f64) -> Option<NoiseInput> {
        self.base.noise_input(dt)
    }
    fn noise_input_at(&self, state: &DVector<f64>, dt: f64) -> Option<NoiseInput> {
        let mut input = self.base.noise_input(dt)?;
        let by = right_jacobian(&block(&self.moved(state, dt), self.attitude));
        self.turn_rows(&mut input.gain, &by);
        input.rest = input.rest.map(|rest| self.turned_cov(rest, &by));
        Some(input)
    }
    fn base(&self) -> Option<&dyn Motion> {
        Some(&self.base)
    }
    fn space(&self) -> StateSpace {
        StateSpace {
            dim: self.state_dim(),
            attitude: Some(self.attitude),
        }
    }
}
