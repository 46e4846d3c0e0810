//! Motion models. State order is block order: all positions, then all velocities, then accelerations.

mod augmented;
mod kinematic;
mod linear;
mod rigid_body;
mod singer;

use std::fmt::Debug;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::space::StateSpace;
use crate::error::{Result, require_size};
use crate::linalg::copy_rows;

pub use augmented::Augmented;
pub use kinematic::{ConstantAcceleration, ConstantVelocity, KinematicNoise, RandomWalk};
pub use linear::LinearMotion;
pub use rigid_body::RigidBody;
pub use singer::Singer;

/// How a state moves on by `dt` seconds. `dt = 0` must be the identity without noise.
pub trait Motion: Debug + Send + Sync {
    /// Length n of the state.
    fn state_dim(&self) -> usize;
    /// Number of leading components that are a position.
    fn position_dims(&self) -> usize;
    /// Names of the state's components, length n.
    fn labels(&self) -> Vec<String>;
    /// f(x): the state `dt` seconds later, without noise.
    fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64>;
    /// ∂f/∂x at `state`, n×n.
    fn jacobian(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64>;
    /// Q: covariance of the noise gathered in `dt` seconds, n×n.
    fn noise(&self, dt: f64) -> DMatrix<f64>;
    /// The same where it depends on the state.
    fn noise_at(&self, _state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        self.noise(dt)
    }
    /// Writes f of several states, one after the other in `states`, where they are wanted. What runs and filters call, so
    /// that a model from outside may fail.
    fn propagate_all(&self, states: &[f64], dt: f64, out: &mut [f64]) -> Result<()> {
        let n = self.state_dim().max(1);
        for (state, out) in states.chunks_exact(n).zip(out.chunks_exact_mut(n)) {
            let moved = self.propagate(&DVector::from_column_slice(state), dt);
            require_size("propagated state", out.len(), moved.len())?;
            out.copy_from_slice(moved.as_slice());
        }
        Ok(())
    }
    /// Writes f(x) and ∂f/∂x, n×n row by row, where they are wanted.
    fn linearise_into(&self, state: &DVector<f64>, dt: f64, moved: &mut [f64], jacobian: &mut [f64]) -> Result<()> {
        let (f, slope) = (self.propagate(state, dt), self.jacobian(state, dt));
        require_size("propagated state", moved.len(), f.len())?;
        require_size("motion Jacobian rows", moved.len(), slope.nrows())?;
        require_size("motion Jacobian columns", moved.len(), slope.ncols())?;
        moved.copy_from_slice(f.as_slice());
        copy_rows(&slope, jacobian);
        Ok(())
    }
    /// Writes F of a linear motion, n×n row by row, where it is wanted.
    fn transition_into(&self, dt: f64, out: &mut [f64]) {
        copy_rows(&self.jacobian(&DVector::zeros(self.state_dim()), dt), out);
    }
    /// Writes Q the same way.
    fn noise_into(&self, dt: f64, out: &mut [f64]) {
        copy_rows(&self.noise(dt), out);
    }
    /// Whether f(x) = F(dt) x with an F that does not depend on x, so that the plain Kalman filter applies.
    fn is_linear(&self) -> bool;
    /// Whether a linear motion has the same F and Q over both of these time steps.
    fn same_over(&self, dt: f64, other: f64) -> bool {
        dt == other
    }
    /// How noise of a fixed covariance enters the state over `dt`, for models that have it so; what an estimator of the
    /// noise can estimate. Γ is zero for `dt = 0`.
    fn noise_input(&self, _dt: f64) -> Option<NoiseInput> {
        None
    }
    /// The same where it depends on the state; what [`Motion::noise_at`] is made of.
    fn noise_input_at(&self, _state: &DVector<f64>, dt: f64) -> Option<NoiseInput> {
        self.noise_input(dt)
    }
    /// The kinematic motion of small changes of a state that does not add, where this is one of such.
    fn base(&self) -> Option<&dyn Motion> {
        None
    }
    /// Where the states live: `jacobian`, `noise` and covariances are those of its differences.
    fn space(&self) -> StateSpace {
        StateSpace::euclidean(self.state_dim())
    }
}

/// How noise of a fixed covariance enters over a step: Q(dt) = Γ (I_r ⊗ C) Γᵀ + rest.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseInput {
    /// Γ, n×rd.
    pub gain: DMatrix<f64>,
    /// r: how many independent noises of covariance C enter.
    pub repeat: usize,
    /// C, d×d. It does not depend on dt.
    pub cov: DMatrix<f64>,
    /// What is added to Q and is not estimated, n×n.
    pub rest: Option<DMatrix<f64>>,
}

/// A motion model held by value: one of the library's own, which can be saved, or the user's.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "kind")]
#[non_exhaustive]
pub enum MotionModel {
    /// See [`RandomWalk`].
    RandomWalk(RandomWalk),
    /// See [`ConstantVelocity`].
    ConstantVelocity(ConstantVelocity),
    /// See [`ConstantAcceleration`].
    ConstantAcceleration(ConstantAcceleration),
    /// See [`Singer`].
    Singer(Singer),
    /// See [`LinearMotion`].
    Linear(LinearMotion),
    /// See [`RigidBody`].
    RigidBody(Box<RigidBody>),
    /// See [`Augmented`].
    Augmented(Box<Augmented>),
    /// A model from outside the library. It cannot be saved.
    #[serde(skip)]
    Custom(Arc<dyn Motion>),
}

impl MotionModel {
    fn as_motion(&self) -> &dyn Motion {
        match self {
            Self::RandomWalk(m) => m,
            Self::ConstantVelocity(m) => m,
            Self::ConstantAcceleration(m) => m,
            Self::Singer(m) => m,
            Self::Linear(m) => m,
            Self::RigidBody(m) => m.as_ref(),
            Self::Augmented(m) => m.as_ref(),
            Self::Custom(m) => m.as_ref(),
        }
    }
}

impl Motion for MotionModel {
    fn state_dim(&self) -> usize {
        self.as_motion().state_dim()
    }
    fn position_dims(&self) -> usize {
        self.as_motion().position_dims()
    }
    fn labels(&self) -> Vec<String> {
        self.as_motion().labels()
    }
    fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
        self.as_motion().propagate(state, dt)
    }
    fn jacobian(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        self.as_motion().jacobian(state, dt)
    }
    fn noise(&self, dt: f64) -> DMatrix<f64> {
        self.as_motion().noise(dt)
    }
    fn propagate_all(&self, states: &[f64], dt: f64, out: &mut [f64]) -> Result<()> {
        self.as_motion().propagate_all(states, dt, out)
    }
    fn linearise_into(&self, state: &DVector<f64>, dt: f64, moved: &mut [f64], jacobian: &mut [f64]) -> Result<()> {
        self.as_motion().linearise_into(state, dt, moved, jacobian)
    }
    fn transition_into(&self, dt: f64, out: &mut [f64]) {
        self.as_motion().transition_into(dt, out);
    }
    fn noise_into(&self, dt: f64, out: &mut [f64]) {
        self.as_motion().noise_into(dt, out);
    }
    fn is_linear(&self) -> bool {
        self.as_motion().is_linear()
    }
    fn same_over(&self, dt: f64, other: f64) -> bool {
        self.as_motion().same_over(dt, other)
    }
    fn noise_input(&self, dt: f64) -> Option<NoiseInput> {
        self.as_motion().noise_input(dt)
    }
    fn noise_at(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        self.as_motion().noise_at(state, dt)
    }
    fn noise_input_at(&self, state: &DVector<f64>, dt: f64) -> Option<NoiseInput> {
        self.as_motion().noise_input_at(state, dt)
    }
    fn base(&self) -> Option<&dyn Motion> {
        self.as_motion().base()
    }
    fn space(&self) -> StateSpace {
        self.as_motion().space()
    }
}
