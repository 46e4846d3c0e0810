//! Mixtures of Gaussians that stand for an intensity: their weights add to the expected number of targets.
//!
//! | symbol      | name here  | meaning                                                         |
//! |-------------|------------|-----------------------------------------------------------------|
//! | w, m, P     | `weight`, `state` | a component                                              |
//! | T, U, J_max | `prune`, `merge`, `max_components` | what the reduction keeps                |
//!
//! Reduction, in the order of the code:
//! 1. components with w ≤ T go;
//! 2. the heaviest that is left, j, takes in all i with (m_i − m_j)ᵀ P_i⁻¹ (m_i − m_j) ≤ U, again and again; weights add and
//!    are never capped, moments are matched, the heaviest's label stays;
//! 3. the J_max heaviest stay; their weights are not rescaled.
//!
//! Extraction: w > ½ is ⌊w + ½⌋ targets.
//!
//! Reference: Vo, Ma (2006), The Gaussian mixture probability hypothesis density filter, IEEE TSP 54(11), tables II and III;
//! extended-target spec 5.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::extent;
use super::rate::Rate;
use crate::error::{Error, Result, require_non_negative};
use crate::filter::mixture::{Hypothesis, moment_match};
use crate::gaussian::Gaussian;
use crate::linalg::kernel;
use crate::model::StateSpace;
use crate::track::Extent;

/// From this weight on a component stands for a target.
pub const EXTRACT: f64 = 0.5;
/// No component is more targets than this.
const MOST_COPIES: u32 = 10_000;

/// One Gaussian of the mixture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Component {
    /// Expected number of targets in it.
    pub weight: f64,
    /// Where they are.
    pub state: Gaussian,
    /// How many measurements each gives; for point targets without meaning.
    pub rate: Rate,
    /// How large they are, where the filter learns it.
    #[serde(default)]
    pub extent: Option<Extent>,
    /// Whose it is: kept through survival and update.
    pub label: u64,
}

impl Component {
    /// How many targets it is extracted as.
    pub fn copies(&self) -> usize {
        if self.weight > EXTRACT {
            (1..=MOST_COPIES)
                .take_while(|&n| f64::from(n) <= self.weight + 0.5)
                .count()
        } else {
            0
        }
    }
}

/// What is kept of a mixture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reduction {
    /// Components of this weight and below go.
    pub prune: f64,
    /// Squared Mahalanobis distance up to which components are merged.
    pub merge: f64,
    /// So many are kept.
    pub max_components: usize,
}

impl Default for Reduction {
    fn default() -> Self {
        Self {
            prune: 1e-4,
            merge: 4.0,
            max_components: 100,
        }
    }
}

/// A component, and the labels of all that went into it, heaviest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Merged {
    /// The component.
    pub component: Component,
    /// Different from one another; the first is the component's own.
    pub labels: Vec<u64>,
}

impl Reduction {
    pub(crate) fn check(&self) -> Result<()> {
        require_non_negative("prune", self.prune)?;
        require_non_negative("merge", self.merge)?;
        if self.max_components == 0 {
            return Err(Error::invalid("max_components", 0, "must be at least 1"));
        }
        Ok(())
    }

    /// The reduced mixture.
    pub fn reduce(&self, components: Vec<Component>) -> Result<Vec<Merged>> {
        let mut left: Vec<Component> = components.into_iter().filter(|c| c.weight > self.prune).collect();
        // Heaviest first; equal weights stay in their order.
        left.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        let mut factors: Vec<Vec<f64>> = vec![Vec::new(); left.len()];
        let mut taken = vec![false; left.len()];
        let mut scratch = Vec::new();
        let (mut out, mut members) = (Vec::new(), Vec::new());
        for j in 0..left.len() {
            if taken[j] {
                continue;
            }
            members.clear();
            members.push(j);
            for i in j + 1..left.len() {
                if !taken[i] && self.joins(&left[i].state, &left[j].state.mean, &mut factors[i], &mut scratch)? {
                    taken[i] = true;
                    members.push(i);
                }
            }
            out.push(merged(&left, &members));
        }
        if out.len() > self.max_components {
            let mut order: Vec<usize> = (0..out.len()).collect();
            order.sort_by(|&a, &b| out[b].component.weight.total_cmp(&out[a].component.weight));
            let mut stays = vec![false; out.len()];
            order[..self.max_components].iter().for_each(|&i| stays[i] = true);
            let mut stays = stays.into_iter();
            out.retain(|_| stays.next() == Some(true));
        }
        Ok(out)
    }

    /// Whether a component lies within U of a mean; its factor is found when it is first needed.
    fn joins(&self, state: &Gaussian, mean: &DVector<f64>, factor: &mut Vec<f64>, e: &mut Vec<f64>) -> Result<bool> {
        let n = mean.len();
        e.clear();
        // eᵀ P⁻¹ e is at least e_k² / P_kk for every k.
        for k in 0..n {
            let off = state.mean[k] - mean[k];
            if off * off > self.merge * state.cov[(k, k)] {
                return Ok(false);
            }
            e.push(off);
        }
        if factor.is_empty() {
            factor.extend_from_slice(state.cov.as_slice());
            kernel::cholesky(n, factor).map_err(|pivot| Error::NotPositiveDefinite {
                what: "component covariance".into(),
                pivot: pivot.index,
                value: pivot.value,
            })?;
        }
        kernel::solve_lower::<1>(n, 1, factor, e);
        Ok(kernel::dot(e, e) <= self.merge)
    }
}

fn merged(all: &[Component], members: &[usize]) -> Merged {
    let first = &all[members[0]];
    if members.len() == 1 {
        return Merged {
            component: first.clone(),
            labels: vec![first.label],
        };
    }
    let mut labels: Vec<u64> = Vec::with_capacity(1);
    for &i in members {
        if !labels.contains(&all[i].label) {
            labels.push(all[i].label);
        }
    }
    let rates: Vec<(f64, Rate)> = members.iter().map(|&i| (all[i].weight, all[i].rate)).collect();
    let extent = |&i: &usize| all[i].extent.as_ref().map(|extent| (all[i].weight, extent));
    let extents: Vec<(f64, &Extent)> = members.iter().filter_map(extent).collect();
    let hypotheses = members.iter().map(|&i| Hypothesis {
        weight: all[i].weight,
        state: all[i].state.clone(),
    });
    let space = StateSpace::euclidean(first.state.dim());
    let component = Component {
        weight: members.iter().map(|&i| all[i].weight).sum(),
        state: moment_match(&space, hypotheses.collect()).unwrap_or_else(|| first.state.clone()),
        rate: Rate::merged(&rates).unwrap_or(first.rate),
        extent: extent::merged(&extents).or_else(|| first.extent.clone()),
        label: first.label,
    };
    Merged { component, labels }
}
