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

use serde::{Deserialize, Serialize};

use super::extent;
use super::rate::Rate;
use crate::error::{Error, Result, require_non_negative};
use crate::filter::mixture::moments;
use crate::gaussian::Gaussian;
use crate::linalg::kernel::{self, BadPivot, known, sized};
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
    /// Whether a step of it was done by the root of its covariance, because that came close to being singular.
    #[serde(default, skip_serializing_if = "is_false")]
    pub rooted: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_false(yes: &bool) -> bool {
    !yes
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
    ///
    /// One whose covariance is not positive definite has no distance from others and is merged with none.
    pub fn reduce(&self, mut components: Vec<Component>) -> Vec<Merged> {
        let mut order: Vec<(f64, usize)> = components.iter().map(|c| c.weight).zip(0..).collect();
        order.retain(|(weight, _)| *weight > self.prune);
        // Heaviest first; equal weights stay in their order.
        order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut places = Places::new(self.merge, order.iter().map(|&(_, i)| &components[i].state));
        let mut left: Vec<usize> = (0..order.len()).collect();
        let (mut kept, mut members) = (Vec::with_capacity(order.len()), Vec::new());
        while let [heaviest, rest @ ..] = &mut left[..] {
            let component = order[*heaviest].1;
            members.clear();
            members.push(component);
            let mut staying = 0;
            for at in 0..rest.len() {
                let i = rest[at];
                if places.joins(i, *heaviest, &components[order[i].1].state) {
                    members.push(order[i].1);
                } else {
                    rest[staying] = i;
                    staying += 1;
                }
            }
            left.copy_within(1..=staying, 0);
            left.truncate(staying);
            kept.push(Kept {
                component,
                labels: merge(&mut components, &members),
            });
        }
        if kept.len() > self.max_components {
            let weight = |kept: &Kept| components[kept.component].weight;
            let mut heaviest: Vec<usize> = (0..kept.len()).collect();
            heaviest.sort_by(|&a, &b| weight(&kept[b]).total_cmp(&weight(&kept[a])));
            let mut stays = vec![false; kept.len()];
            heaviest[..self.max_components].iter().for_each(|&i| stays[i] = true);
            let mut stays = stays.into_iter();
            kept.retain(|_| stays.next() == Some(true));
        }
        let mut components: Vec<Option<Component>> = components.into_iter().map(Some).collect();
        let merged = |Kept { component, labels }: Kept| {
            let component = components[component].take()?;
            Some(Merged { component, labels })
        };
        kept.into_iter().filter_map(merged).collect()
    }
}

/// Where a component stands that others went into.
struct Kept {
    component: usize,
    labels: Vec<u64>,
}

/// Where components are, in one piece of memory, since every one is compared with every other.
struct Places {
    /// U.
    merge: f64,
    /// n.
    dim: usize,
    means: Vec<f64>,
    /// U P_kk.
    reaches: Vec<f64>,
    /// Cholesky factors of P, n×n, of those that needed one so far, and where they begin.
    factors: Vec<f64>,
    factor_of: Vec<Option<usize>>,
    offset: Vec<f64>,
}

impl Places {
    fn new<'a>(merge: f64, states: impl ExactSizeIterator<Item = &'a Gaussian> + Clone) -> Self {
        let dim = states.clone().next().map_or(0, Gaussian::dim);
        let mut out = Self {
            merge,
            dim,
            means: Vec::with_capacity(states.len() * dim),
            reaches: Vec::with_capacity(states.len() * dim),
            factors: Vec::with_capacity(states.len() * dim * dim),
            factor_of: vec![None; states.len()],
            offset: Vec::with_capacity(dim),
        };
        for state in states {
            out.means.extend_from_slice(state.mean.as_slice());
            let variances = state.cov.as_slice().iter().step_by(dim + 1);
            out.reaches.extend(variances.map(|variance| merge * variance));
        }
        out
    }

    /// Whether component i, whose state this is, lies within U of the mean of j.
    fn joins(&mut self, i: usize, j: usize, state: &Gaussian) -> bool {
        let n = self.dim;
        let (from, to) = (&self.means[i * n..][..n], &self.means[j * n..][..n]);
        // eᵀ P⁻¹ e is at least e_k² / P_kk for every k.
        for ((x, y), reach) in from.iter().zip(to).zip(&self.reaches[i * n..][..n]) {
            let off = x - y;
            if off * off > *reach {
                return false;
            }
        }
        let Some(at) = self.factor_of[i].or_else(|| self.factorise(i, state)) else {
            return false;
        };
        let (from, to) = (&self.means[i * n..][..n], &self.means[j * n..][..n]);
        let e = &mut self.offset;
        e.clear();
        e.extend(from.iter().zip(to).map(|(x, y)| x - y));
        kernel::solve_lower::<1>(n, 1, &self.factors[at..][..n * n], e);
        kernel::dot(e, e) <= self.merge
    }

    fn factorise(&mut self, i: usize, state: &Gaussian) -> Option<usize> {
        let at = self.factors.len();
        self.factors.extend_from_slice(state.cov.as_slice());
        sized!(factor(self.dim, &mut self.factors[at..])).ok()?;
        self.factor_of[i] = Some(at);
        Some(at)
    }
}

fn factor<const N: usize>(n: usize, cov: &mut [f64]) -> std::result::Result<(), BadPivot> {
    kernel::cholesky(known::<N>(n), cov)
}

/// Puts all members into the first of them; the labels that went into it are returned, its own first.
fn merge(all: &mut [Component], members: &[usize]) -> Vec<u64> {
    let first = members[0];
    let mut labels = vec![all[first].label];
    if members.len() == 1 {
        return labels;
    }
    let parts = members.iter().map(|&i| &all[i]);
    for part in parts.clone() {
        if !labels.contains(&part.label) {
            labels.push(part.label);
        }
    }
    let rates: Vec<(f64, Rate)> = parts.clone().map(|c| (c.weight, c.rate)).collect();
    let extents: Vec<(f64, &Extent)> = parts
        .clone()
        .filter_map(|c| c.extent.as_ref().map(|extent| (c.weight, extent)))
        .collect();
    let space = StateSpace::euclidean(all[first].state.dim());
    let weight = parts.clone().map(|c| c.weight).sum();
    let rooted = parts.clone().any(|c| c.rooted && c.label == labels[0]);
    let state = moments(&space, parts.map(|c| (c.weight, &c.state)));
    let (rate, extent) = (Rate::merged(&rates), extent::merged(&extents));
    let target = &mut all[first];
    (target.weight, target.rooted) = (weight, rooted);
    if let Some(state) = state {
        target.state = state;
    }
    target.rate = rate.unwrap_or(target.rate);
    target.extent = extent.or_else(|| target.extent.take());
    labels
}
