//! How a mixture gets from one scan to the next: survival, spawning, birth.
//!
//! | symbol     | name here | meaning                                                             |
//! |------------|-----------|---------------------------------------------------------------------|
//! | p_S        | `survival_probability` | that a target is still there at the next scan          |
//! | w_l, d_l, Q_l | `Spawn` | what a target may give off: weight, offset, covariance               |
//! | w_b, m_b, P_b | `Birth` | where targets may appear                                             |
//!
//! In this order: survivors w ← p_S w, m ← f(m), P ← F P Fᵀ + Q;  spawned, of each component and each term: w_l w, f(m) + d_l,
//! F P Fᵀ + Q_l;  births. The weight that a target spawns with is that before it survives.
//!
//! Reference: Vo, Ma (2006), eqs. 21 to 29; extended-target spec 3.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::mixture::Component;
use super::rate::{Rate, RateModel};
use crate::error::{
    Error, Result, require_finite, require_non_negative, require_positive, require_probability, require_size,
};
use crate::filter::extended::Rule;
use crate::filter::kalman::predict_each;
use crate::filter::prediction::{Course, Prediction};
use crate::filter::square_root::Form;
use crate::gaussian::Gaussian;
use crate::linalg::symmetric::require_covariance;
use crate::model::Motion;

/// Where a target may appear.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Birth {
    /// Expected number of new targets per scan.
    pub weight: f64,
    /// Where.
    pub state: Gaussian,
}

/// What a target may give off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spawn {
    /// Expected number per target and scan.
    pub weight: f64,
    /// d, length n.
    #[serde(with = "crate::linalg::saved::vector")]
    pub offset: DVector<f64>,
    /// Q_l, n×n, in place of the motion's noise.
    #[serde(with = "crate::linalg::saved::matrix")]
    pub cov: DMatrix<f64>,
}

/// What becomes of targets between scans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fate {
    /// p_S.
    pub survival_probability: f64,
    /// Births of every scan.
    pub births: Vec<Birth>,
    /// Rate of the newborn.
    pub birth_rate: Rate,
    /// What targets give off.
    pub spawns: Vec<Spawn>,
}

impl Fate {
    pub(crate) fn check(&self, states: usize) -> Result<()> {
        require_probability("survival_probability", self.survival_probability)?;
        for birth in &self.births {
            require_non_negative("birth weight", birth.weight)?;
            require_size("birth state", states, birth.state.dim())?;
        }
        for spawn in &self.spawns {
            require_non_negative("spawn weight", spawn.weight)?;
            require_size("spawn offset", states, spawn.offset.len())?;
            require_finite("spawn offset", spawn.offset.iter())?;
            require_covariance("spawn cov", &spawn.cov, states)?;
        }
        Ok(())
    }

    /// Makes the mixture that of `dt` seconds later, without the newborn; with an error it stays as it is.
    pub(crate) fn survive(
        &self,
        mixture: &mut Vec<Component>,
        motion: &dyn Motion,
        rule: Rule,
        rates: RateModel,
        dt: f64,
        next_label: &mut u64,
    ) -> Result<()> {
        let predictions = predict_each(rule, mixture.iter().map(|component| &component.state), motion, dt)?;
        let mut spawned = Vec::with_capacity(mixture.len() * self.spawns.len());
        let mut spawning = Prediction::new(motion.space(), Rule::Once, Form::Joseph);
        for component in mixture.iter() {
            for spawn in &self.spawns {
                let course = Course {
                    motion,
                    dt,
                    input: Some(spawn.offset.as_slice()),
                    noise: Some(spawn.cov.as_slice()),
                };
                let rooted = spawning.predict_definite(&component.state, &course)?;
                spawned.push(Component {
                    weight: component.weight * spawn.weight,
                    state: spawning.state.clone(),
                    rate: rates.predicted(component.rate),
                    extent: None,
                    label: fresh(next_label),
                    rooted,
                });
            }
        }
        for (index, component) in mixture.iter_mut().enumerate() {
            let state = predictions.states.view(index);
            component.rooted |= predictions.rooted[index];
            component.weight *= self.survival_probability;
            component.state.mean.as_mut_slice().copy_from_slice(state.mean);
            component.state.cov.as_mut_slice().copy_from_slice(state.cov);
            component.rate = rates.predicted(component.rate);
        }
        mixture.extend(spawned);
        Ok(())
    }

    /// Adds the newborn, each with a label of its own.
    pub(crate) fn bear(&self, mixture: &mut Vec<Component>, births: &[Birth], next_label: &mut u64) {
        for birth in self.births.iter().chain(births).filter(|birth| birth.weight > 0.0) {
            mixture.push(Component {
                weight: birth.weight,
                state: birth.state.clone(),
                rate: self.birth_rate,
                extent: None,
                label: fresh(next_label),
                rooted: false,
            });
        }
    }
}

/// A label that nobody has.
pub(crate) fn fresh(next_label: &mut u64) -> u64 {
    let label = *next_label;
    *next_label = label.saturating_add(1);
    label
}

/// That a rate is one.
pub(crate) fn require_rate(rate: Rate) -> Result<()> {
    require_positive("shape of detections_per_target", rate.shape)?;
    let mean = rate.mean();
    if mean.is_finite() && mean > 0.0 {
        return Ok(());
    }
    Err(Error::invalid(
        "detections_per_target",
        mean,
        "must be positive and finite",
    ))
}
