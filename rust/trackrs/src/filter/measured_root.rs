//! The measurement side of the square-root form: S, the gain and the posterior from the array of [`super::square_root`].

use super::kalman::MeasurementPrediction;
use super::square_root::{Array, Reflector, solve_root, square};
use crate::gaussian::{Gaussian, GaussianRef};
use crate::linalg::kernel::{self, BadPivot};

/// What is kept of the array of an update before it is turned.
#[derive(Debug, Clone, Default)]
pub(super) struct MeasuredRoot {
    /// U, n×n: any factor of P.
    pub(super) factor: Vec<f64>,
    /// V = U Hᵀ, n×m.
    pub(super) seen: Vec<f64>,
    /// Rows of length m whose product is R.
    pub(super) noise: Vec<f64>,
    work: Vec<f64>,
    weights: Vec<f64>,
    reflector: Reflector,
}

/// What turning it needs and gives.
#[derive(Debug, Clone, Default)]
pub(super) struct RootScratch {
    /// U of the posterior, n×n.
    pub(super) factor: Vec<f64>,
    seen: Vec<f64>,
    /// K̄ᵀ, m×n.
    mixed: Vec<f64>,
    weights: Vec<f64>,
    whitened: Vec<f64>,
}

impl MeasurementPrediction {
    /// S and its factor in square-root form, for U, V and the rows of R that are set.
    pub(super) fn prepare_root(&mut self) -> Result<(), BadPivot> {
        let (n, m) = (self.n, self.m);
        let Some(root) = &mut self.root else {
            return Ok(());
        };
        // H P = Vᵀ U.
        self.cross.fill(0.0);
        for (u, v) in root.factor.chunks_exact(n.max(1)).zip(root.seen.chunks_exact(m.max(1))) {
            for (&x, row) in v.iter().zip(self.cross.chunks_exact_mut(n.max(1))) {
                if x != 0.0 {
                    kernel::add_scaled(row, x, u);
                }
            }
        }
        // W, lower, whatever the number of rows of R.
        root.weights.clear();
        root.weights.extend_from_slice(&root.noise);
        root.reflector.triangularise(m, &mut root.weights);
        root.weights.truncate(m * m);
        // The rows of V and W, their columns in reverse, make a lower triangle whose transpose in reverse is that of S = L Lᵀ.
        root.work.clear();
        for row in root
            .weights
            .chunks_exact(m.max(1))
            .chain(root.seen.chunks_exact(m.max(1)))
        {
            root.work.extend(row.iter().rev());
        }
        root.reflector.triangularise(m, &mut root.work);
        for k in 0..m {
            let row = &root.work[(m - 1 - k) * m..(m - k) * m];
            let value = row[m - 1 - k];
            if !(value != 0.0 && value.is_finite()) {
                return Err(BadPivot { index: k, value });
            }
            let sign = value.signum();
            for i in 0..m {
                self.lower[i * m + k] = if i < k { 0.0 } else { sign * row[m - 1 - i] };
            }
        }
        let s = self.cov.as_mut_slice();
        for a in 0..m {
            for b in 0..=a {
                let sum = kernel::dot(&self.lower[a * m..=a * m + b], &self.lower[b * m..=b * m + b]);
                (s[a * m + b], s[b * m + a]) = (sum, sum);
            }
        }
        Ok(())
    }

    /// The columns of V and R of some components.
    pub(super) fn select_root(&self, components: &[usize], part: &mut Self) {
        let Some(root) = &self.root else {
            part.root = None;
            return;
        };
        let chosen = part.root.get_or_insert_default();
        chosen.factor.clone_from(&root.factor);
        for (rows, out) in [(&root.seen, &mut chosen.seen), (&root.noise, &mut chosen.noise)] {
            out.clear();
            for row in rows.chunks_exact(self.m.max(1)) {
                out.extend(components.iter().map(|&i| row[i]));
            }
        }
    }
}

impl MeasuredRoot {
    /// The posterior of a fully observed innovation, and the gain Kᵀ, m×n.
    pub(super) fn posterior_into(
        &self,
        prior: GaussianRef<'_>,
        innovation: &[f64],
        scratch: &mut RootScratch,
        gain: &mut [f64],
        out: &mut Gaussian,
    ) {
        let (n, m) = (prior.dim(), innovation.len());
        scratch.factor.clone_from(&self.factor);
        scratch.seen.clone_from(&self.seen);
        scratch.weights.clone_from(&self.weights);
        scratch.mixed.clear();
        scratch.mixed.resize(m * n, 0.0);
        let mut array = Array {
            factor: &mut scratch.factor,
            seen: &mut scratch.seen,
            gain: &mut scratch.mixed,
            weights: &mut scratch.weights,
        };
        array.rotate(n, m);
        scratch.whitened.clear();
        scratch.whitened.extend_from_slice(innovation);
        solve_root(m, &scratch.weights, &mut scratch.whitened);
        let mean = out.mean.as_mut_slice();
        mean.copy_from_slice(prior.mean);
        for (&y, row) in scratch.whitened.iter().zip(scratch.mixed.chunks_exact(n.max(1))) {
            kernel::add_scaled(mean, y, row);
        }
        square(n, &scratch.factor, out.cov.as_mut_slice());
        gain.copy_from_slice(&scratch.mixed);
        kernel::solve_lower::<0>(m, n, &scratch.weights, gain);
    }
}
