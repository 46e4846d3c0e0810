//! Noise estimated as a run goes on: the rules there are, and what they have in common.
//!
//! An adaptation says which noise the next step is predicted with and which R its measurement has, and takes in what each
//! epoch gave. Each rule has a file of its own: [`super::noise`], [`super::residual_noise`], [`super::nis_noise`].

use nalgebra::{DMatrix, DVector};

use super::nis_noise::{NisMemory, NisScaledNoise};
use super::noise::{LimitedMemoryNoise, NoiseMemory, ProcessedEpoch, QForm};
use super::residual_noise::{ResidualHistory, ResidualNoise};
use crate::error::{Error, Result};
use crate::gaussian::{Gaussian, GaussianRef};
use crate::model::{Motion, Sensor};

/// A rule by which noise is estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoiseRule {
    /// See [`LimitedMemoryNoise`].
    LimitedMemory(LimitedMemoryNoise),
    /// See [`ResidualNoise`].
    Residual(ResidualNoise),
    /// See [`NisScaledNoise`].
    NisScaled(NisScaledNoise),
}

impl From<LimitedMemoryNoise> for NoiseRule {
    fn from(rule: LimitedMemoryNoise) -> Self {
        Self::LimitedMemory(rule)
    }
}

impl From<ResidualNoise> for NoiseRule {
    fn from(rule: ResidualNoise) -> Self {
        Self::Residual(rule)
    }
}

impl From<NisScaledNoise> for NoiseRule {
    fn from(rule: NisScaledNoise) -> Self {
        Self::NisScaled(rule)
    }
}

impl NoiseRule {
    /// Checks the parameters, and that this motion has what the rule changes.
    pub(super) fn check(&self, motion: &dyn Motion) -> Result<()> {
        let needs_input = match self {
            Self::LimitedMemory(rule) => {
                rule.check()?;
                rule.q_form == QForm::Input
            }
            Self::Residual(rule) => {
                rule.check()?;
                rule.q.is_some() && rule.q_floor > 0.0
            }
            Self::NisScaled(rule) => {
                rule.check()?;
                true
            }
        };
        if needs_input && motion.noise_input(1.0).is_none() {
            let requirement = match self {
                Self::LimitedMemory(_) => "needs a motion that says how its noise enters, or q_form = \"full\"",
                _ => "needs a motion that says how its noise enters",
            };
            return Err(Error::invalid("adapt", "given", requirement));
        }
        Ok(())
    }

    /// Size of the motion noise that is estimated; 0 if none is.
    pub(super) fn dim(&self, motion: &dyn Motion) -> usize {
        let input = || motion.noise_input(1.0).map_or(0, |input| input.cov.nrows());
        match self {
            Self::LimitedMemory(rule) if rule.q_form == QForm::Input => input(),
            Self::LimitedMemory(_) => motion.state_dim(),
            Self::Residual(rule) => rule.q.map_or(0, |_| motion.state_dim()),
            Self::NisScaled(_) => input(),
        }
    }

    /// An empty memory, with the models' own noise to begin with.
    pub(super) fn begin(&self, motion: &dyn Motion, sensor: &dyn Sensor, start: &Gaussian) -> Result<Adaptation> {
        let n = start.dim();
        Ok(match *self {
            Self::LimitedMemory(rule) => {
                let q = match (rule.q_form, motion.noise_input(1.0)) {
                    (QForm::Input, Some(input)) => input.cov,
                    // What a full Q begins with is known with the first step.
                    _ => DMatrix::from_element(n, n, f64::NAN),
                };
                Adaptation::LimitedMemory(Box::new(
                    NoiseMemory::new(rule, start.into(), q, sensor.noise())?.in_space(motion.space()),
                ))
            }
            Self::Residual(rule) => Adaptation::Residual(Box::new(ResidualHistory::new(rule, n, sensor.noise()))),
            Self::NisScaled(rule) => Adaptation::NisScaled(Box::new(NisMemory::new(rule, motion, sensor.noise())?)),
        })
    }
}

/// What the correction of an epoch gave, as an adaptation needs it.
#[derive(Debug, Clone, Copy)]
pub struct Corrected<'a> {
    /// The innovation, NaN where a component was missing or rejected; length m.
    pub innovation: &'a [f64],
    /// Kᵀ, m×n row by row, zero where not used.
    pub gain: &'a [f64],
    /// Normalised innovation squared of the used components.
    pub nis: f64,
    /// Number of used components.
    pub dof: usize,
}

/// The memory of a rule and the noise in force.
#[derive(Debug, Clone)]
pub enum Adaptation {
    /// Of [`LimitedMemoryNoise`].
    LimitedMemory(Box<NoiseMemory>),
    /// Of [`ResidualNoise`].
    Residual(Box<ResidualHistory>),
    /// Of [`NisScaledNoise`].
    NisScaled(Box<NisMemory>),
}

impl Adaptation {
    /// The motion noise in force, d×d.
    pub fn q(&self) -> &DMatrix<f64> {
        match self {
            Self::LimitedMemory(memory) => memory.q(),
            Self::Residual(memory) => memory.q(),
            Self::NisScaled(memory) => memory.q(),
        }
    }

    /// R in force, m×m.
    pub fn r(&self) -> &DMatrix<f64> {
        match self {
            Self::LimitedMemory(memory) => memory.r(),
            Self::Residual(memory) => memory.r(),
            Self::NisScaled(memory) => memory.r(),
        }
    }

    /// The motion noise of a step of length `dt` from `state`, n×n.
    pub fn step_noise(&mut self, motion: &dyn Motion, state: &DVector<f64>, dt: f64) -> Result<&[f64]> {
        match self {
            Self::LimitedMemory(memory) => memory.step_noise(motion, state, dt),
            Self::Residual(memory) => Ok(memory.step_noise(motion, state, dt)),
            Self::NisScaled(memory) => Ok(memory.step_noise(motion, state, dt)),
        }
    }

    /// Takes in an epoch.
    pub fn push(&mut self, epoch: &ProcessedEpoch<'_>, corrected: &Corrected<'_>, sensor: &dyn Sensor) -> Result<()> {
        match self {
            Self::LimitedMemory(memory) => memory.push(epoch, sensor),
            Self::Residual(memory) => memory.push(epoch, corrected, sensor),
            Self::NisScaled(memory) => {
                memory.push(corrected);
                Ok(())
            }
        }
    }

    /// Forgets the epochs after a restart at `start`; the noise in force stays.
    pub fn restart(&mut self, start: GaussianRef<'_>) {
        match self {
            Self::LimitedMemory(memory) => memory.restart(start),
            Self::Residual(memory) => memory.restart(),
            Self::NisScaled(_) => {}
        }
    }
}
