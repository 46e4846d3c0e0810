//! The correction of a state by a measurement, in memory that serves one epoch after another. Equations and symbols are
//! those of [`super::kalman`].

use nalgebra::{DMatrix, DVector};

use super::chart::Chart;
use super::kalman::{MeasurementPrediction, Update};
use super::measured_root::RootScratch;
use crate::error::{Error, Result};
use crate::gaussian::{Gaussian, GaussianRef};
use crate::linalg::kernel::{self, known, sized};
use crate::model::StateSpace;

/// Intermediate matrices of an update.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scratch {
    /// Kᵀ, m×n.
    gain: Vec<f64>,
    /// Bᵀ, n×n.
    left: Vec<f64>,
    /// (B Hᵀ)ᵀ, m×n.
    seen: Vec<f64>,
    /// (K R − B Hᵀ)ᵀ, m×n.
    rest: Vec<f64>,
    root: RootScratch,
}

impl Scratch {
    fn fit(&mut self, n: usize, m: usize) {
        for matrix in [&mut self.gain, &mut self.seen, &mut self.rest] {
            matrix.resize(m * n, 0.0);
        }
        self.left.resize(n * n, 0.0);
    }
}

impl MeasurementPrediction {
    /// The posterior for a fully observed innovation.
    pub(crate) fn posterior_into(
        &self,
        prior: GaussianRef<'_>,
        innovation: &[f64],
        scratch: &mut Scratch,
        out: &mut Gaussian,
    ) {
        let (n, m) = (self.n, self.m);
        scratch.fit(n, m);
        if self.given {
            self.subtract_into(prior, innovation, &mut scratch.gain, out);
            return;
        }
        if let Some(root) = &self.root {
            root.posterior_into(prior, innovation, &mut scratch.root, &mut scratch.gain, out);
            return;
        }
        match m {
            // The common numbers of components as constants too: the loops over them are in the middle of everything.
            1 => sized!(joseph_of_one(n, self, prior, innovation, scratch, out)),
            2 => sized!(joseph_of_two(n, self, prior, innovation, scratch, out)),
            3 => sized!(joseph_of_three(n, self, prior, innovation, scratch, out)),
            4 => sized!(joseph_of_four(n, self, prior, innovation, scratch, out)),
            _ => sized!(joseph_of_many(n, self, prior, innovation, scratch, out)),
        }
    }

    /// The posterior P − (L⁻¹ H P)ᵀ (L⁻¹ H P) of a given S = L Lᵀ and H P.
    fn subtract_into(&self, prior: GaussianRef<'_>, innovation: &[f64], gain: &mut [f64], out: &mut Gaussian) {
        let (n, m) = (self.n, self.m);
        gain.copy_from_slice(&self.cross[..m * n]);
        kernel::solve_lower::<0>(m, n, &self.lower, gain);
        let cov = out.cov.as_mut_slice();
        kernel::subtract_transposed_product::<0>(n, prior.cov, gain, gain, cov);
        kernel::symmetrise(n, cov);
        kernel::solve_upper::<0>(m, n, &self.lower, gain);
        let mean = out.mean.as_mut_slice();
        mean.copy_from_slice(prior.mean);
        for (row, &r) in gain.chunks_exact(n.max(1)).zip(innovation) {
            kernel::add_scaled(mean, r, row);
        }
    }
}

/// What the updates of some states by one sensor do whatever it reports: their gains and covariances. The innovation moves
/// the mean alone, x⁺ = x + K r.
pub(crate) struct Corrections {
    n: usize,
    m: usize,
    /// Kᵀ, m×n each, and P⁺, n×n each.
    gains: Vec<f64>,
    covs: Vec<f64>,
    /// Whether they were found by roots.
    rooted: Vec<bool>,
    /// No innovation.
    still: Vec<f64>,
    posterior: Gaussian,
    scratch: Scratch,
}

impl Corrections {
    /// Of no state yet.
    pub(crate) fn new(n: usize, m: usize) -> Self {
        Self {
            n,
            m,
            gains: Vec::new(),
            covs: Vec::new(),
            rooted: Vec::new(),
            still: vec![0.0; m],
            posterior: Gaussian {
                mean: DVector::zeros(n),
                cov: DMatrix::zeros(n, n),
            },
            scratch: Scratch::default(),
        }
    }

    /// m.
    pub(crate) fn measurement_dim(&self) -> usize {
        self.m
    }

    /// Adds that of a state of which this is expected; the index of it is returned.
    pub(crate) fn push(&mut self, expected: &MeasurementPrediction, prior: &Gaussian) -> usize {
        let rooted = expected.definite_posterior_into(prior, &self.still, &mut self.scratch, &mut self.posterior);
        self.rooted.push(rooted);
        self.gains.extend_from_slice(&self.scratch.gain);
        self.covs.extend_from_slice(self.posterior.cov.as_slice());
        self.rooted.len() - 1
    }

    /// Whether the covariance of that state was found by roots, because it came close to being singular.
    pub(crate) fn is_rooted(&self, index: usize) -> bool {
        self.rooted[index]
    }

    /// The posterior of that state for an innovation of all components.
    pub(crate) fn posterior(&self, index: usize, prior: &Gaussian, innovation: &[f64]) -> Gaussian {
        let (n, m) = (self.n, self.m);
        let mut mean = prior.mean.clone();
        for (row, &r) in self.gains[index * m * n..].chunks_exact(n.max(1)).zip(innovation) {
            kernel::add_scaled(mean.as_mut_slice(), r, row);
        }
        Gaussian {
            mean,
            cov: DMatrix::from_column_slice(n, n, &self.covs[index * n * n..][..n * n]),
        }
    }
}

macro_rules! joseph_of {
    ($($name:ident $m:expr;)*) => {
        $(fn $name<const N: usize>(
            n: usize,
            expected: &MeasurementPrediction,
            prior: GaussianRef<'_>,
            innovation: &[f64],
            scratch: &mut Scratch,
            out: &mut Gaussian,
        ) {
            joseph::<N>(known::<N>(n), ($m)(expected), expected, prior, innovation, scratch, out);
        })*
    };
}

joseph_of! {
    joseph_of_one |_| 1;
    joseph_of_two |_| 2;
    joseph_of_three |_| 3;
    joseph_of_four |_| 4;
    joseph_of_many |expected: &MeasurementPrediction| expected.m;
}

#[inline(always)]
fn joseph<const N: usize>(
    n: usize,
    m: usize,
    expected: &MeasurementPrediction,
    prior: GaussianRef<'_>,
    innovation: &[f64],
    scratch: &mut Scratch,
    out: &mut Gaussian,
) {
    let hp = &expected.cross[..m * n];
    let Scratch {
        gain, left, seen, rest, ..
    } = scratch;
    let (gain, left, seen, rest) = (
        &mut gain[..m * n],
        &mut left[..n * n],
        &mut seen[..m * n],
        &mut rest[..m * n],
    );
    let (innovation, lower) = (&innovation[..m], &expected.lower[..m * m]);
    gain.copy_from_slice(hp);
    kernel::solve_lower::<N>(m, n, lower, gain);
    kernel::solve_upper::<N>(m, n, lower, gain);
    let rows = gain.chunks_exact(n.max(1));
    let terms = innovation.iter().copied().zip(rows);
    kernel::combine::<N>(Some(prior.mean), terms, out.mean.as_mut_slice());
    kernel::subtract_transposed_product::<N>(n, &prior.cov[..n * n], hp, gain, left);
    expected.sparse.multiply::<N>(n, left, seen);
    kernel::multiply_sparse::<N>(m, n, &expected.noise, gain, rest);
    for (x, y) in rest.iter_mut().zip(seen.iter()) {
        *x -= y;
    }
    let cov = &mut out.cov.as_mut_slice()[..n * n];
    kernel::add_transposed_product::<N>(n, left, gain, rest, cov);
    kernel::symmetrise(n, cov);
}

/// An update by the observed components of a measurement. Its memory serves one epoch after another.
#[derive(Debug, Clone)]
pub(super) struct Correction {
    pub(super) posterior: Gaussian,
    pub(super) nis: f64,
    pub(super) dof: usize,
    pub(super) log_likelihood: f64,
    observed: Vec<usize>,
    /// The innovation of the observed components, and L⁻¹ times it.
    innovation: Vec<f64>,
    whitened: Vec<f64>,
    part: MeasurementPrediction,
    scratch: Scratch,
}

impl Correction {
    pub(super) fn new(n: usize, m: usize) -> Self {
        Self {
            posterior: Gaussian {
                mean: DVector::zeros(n),
                cov: DMatrix::zeros(n, n),
            },
            nis: f64::NAN,
            dof: 0,
            log_likelihood: 0.0,
            observed: Vec::with_capacity(m),
            innovation: Vec::with_capacity(m),
            whitened: Vec::with_capacity(m),
            part: MeasurementPrediction::sized(n, 0),
            scratch: Scratch::default(),
        }
    }

    /// The gain transposed, m×n row by row, with rows of zeros for what was not observed.
    pub(super) fn gain_into(&self, n: usize, out: &mut [f64]) {
        out.fill(0.0);
        for (row, &i) in self.scratch.gain.chunks_exact(n.max(1)).zip(&self.observed) {
            out[i * n..(i + 1) * n].copy_from_slice(row);
        }
    }

    /// The factor of the posterior's covariance, after an update in square-root form that observed anything.
    pub(super) fn factor(&self) -> Option<&[f64]> {
        let factor = &self.scratch.root.factor;
        (self.dof > 0 && !factor.is_empty()).then_some(factor)
    }

    /// Makes the posterior, a sum, the change of a prior with an attitude, and counts its error from there.
    pub(super) fn settle(&mut self, space: StateSpace, prior: &DVector<f64>) {
        let Some(chart) = Chart::of_step(space, prior.as_slice(), self.posterior.mean.as_mut_slice()) else {
            return;
        };
        chart.both(space.dim, self.posterior.cov.as_mut_slice());
        chart.columns(space.dim, &mut self.scratch.root.factor);
    }

    /// Updates `prior`; NaN components of the innovation count as not observed.
    pub(super) fn apply(
        &mut self,
        expected: &MeasurementPrediction,
        prior: GaussianRef<'_>,
        innovation: &[f64],
    ) -> Result<()> {
        self.observed.clear();
        self.innovation.clear();
        for (index, &r) in innovation.iter().enumerate() {
            if r.is_infinite() {
                return Err(Error::NonFinite {
                    what: "measurement".into(),
                    index,
                });
            }
            if !r.is_nan() {
                self.observed.push(index);
                self.innovation.push(r);
            }
        }
        let used = self.used(expected)?;
        if !used {
            self.posterior.mean.as_mut_slice().copy_from_slice(prior.mean);
            self.posterior.cov.as_mut_slice().copy_from_slice(prior.cov);
        }
        let all = self.observed.len() == innovation.len();
        let expected = if all { expected } else { &self.part };
        self.whitened.clone_from(&self.innovation);
        kernel::solve_lower::<1>(expected.m, 1, &expected.lower, &mut self.whitened);
        self.nis = kernel::dot(&self.whitened, &self.whitened);
        self.dof = self.observed.len();
        self.log_likelihood = expected.log_likelihood(self.nis);
        if used {
            expected.posterior_into(prior, &self.innovation, &mut self.scratch, &mut self.posterior);
        }
        Ok(())
    }

    /// The posterior of the observed components again, for another linearisation with this innovation.
    pub(super) fn again(
        &mut self,
        expected: &MeasurementPrediction,
        prior: GaussianRef<'_>,
        innovation: &[f64],
    ) -> Result<()> {
        self.innovation.clear();
        self.innovation.extend(self.observed.iter().map(|&i| innovation[i]));
        if self.used(expected)? {
            let all = self.observed.len() == innovation.len();
            let expected = if all { expected } else { &self.part };
            expected.posterior_into(prior, &self.innovation, &mut self.scratch, &mut self.posterior);
        }
        Ok(())
    }

    /// Prepares the part of the observed components where some are missing; whether there are any.
    fn used(&mut self, expected: &MeasurementPrediction) -> Result<bool> {
        if self.observed.len() < expected.m {
            expected.select_into(&self.observed, &mut self.part)?;
        }
        Ok(!self.observed.is_empty())
    }

    /// The update as a record.
    pub(super) fn record(self, expected: &MeasurementPrediction, innovation: DVector<f64>) -> Update {
        let mut whitened = DVector::from_element(innovation.len(), f64::NAN);
        for (&i, &value) in self.observed.iter().zip(&self.whitened) {
            whitened[i] = value;
        }
        Update {
            posterior: self.posterior,
            innovation,
            innovation_cov: expected.cov.clone(),
            whitened,
            nis: self.nis,
            dof: self.dof,
            log_likelihood: self.log_likelihood,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_update_in_two_parts_is_the_update() {
        let numbers = |rows, columns| DMatrix::from_fn(rows, columns, |i, j| ((i * 7 + j * 5 + 3) % 11) as f64 - 4.7);
        let cov = |n| {
            let root = numbers(n, n);
            &root * root.transpose() + DMatrix::identity(n, n)
        };
        for (n, m) in [(4, 2), (5, 3), (3, 1)] {
            let mut corrections = Corrections::new(n, m);
            let innovation = DVector::from_fn(m, |i, _| 0.7 - i as f64);
            let states = [1.0, 3.0].map(|scale| Gaussian {
                mean: DVector::from_fn(n, |i, _| scale * (i as f64 - 0.3)),
                cov: cov(n) * scale,
            });
            let expect = |state| MeasurementPrediction::new(state, &numbers(m, n), &cov(m)).unwrap();
            let indices = states.each_ref().map(|state| corrections.push(&expect(state), state));
            for (state, index) in states.iter().zip(indices) {
                let whole = expect(state).posterior(state, &innovation);
                assert_eq!(corrections.posterior(index, state, innovation.as_slice()), whole);
            }
        }
    }
}
