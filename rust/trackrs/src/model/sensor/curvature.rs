//! What the curvature of a range adds to its mean and variance where the state is uncertain: the second-order filter.
//!
//! | symbol | name here  | shape | meaning                                                      |
//! |--------|------------|-------|--------------------------------------------------------------|
//! | P      | `prior.cov` |      | covariance of the state                                      |
//! | u      | `unit`     | d     | direction from the hydrophone to the target                  |
//! | G_i    | `hessian`  | n×n   | second derivative of component i                             |
//!
//! E h(x) = h(x̂) + ½ tr(G_i P),  cov h = H P Hᵀ + [½ tr(G_i P G_j P)]_ij  (x Gaussian, h quadratic).
//! Of a range h = (1 + s) |x − p| + b:  G_xx = (1 + s) (I − u uᵀ)/|x − p|,  G_xs = u, else 0. Of a travel time: times the
//! slowness. Of the depth: 0.
//!
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §10.3.2, eqs. (10.3.2-9), (10.3.2-14).
//! Deviation: the change of the slowness with depth has no part in G: it is smaller by the speed gradient times the range
//! over the speed.

use nalgebra::{DMatrix, DVector};

use super::{RangeArray, Sensor};
use crate::error::Result;
use crate::gaussian::Gaussian;

/// The second-order part of a prediction.
#[derive(Debug, Clone, PartialEq)]
pub struct Curvature {
    /// ½ tr(G_i P), length m: to be added to h(x̂).
    pub shift: DVector<f64>,
    /// ½ tr(G_i P G_j P), m×m: to be added to R.
    pub noise: DMatrix<f64>,
}

impl RangeArray {
    pub(super) fn curved(&self, prior: &Gaussian) -> Result<Curvature> {
        let (m, d) = (self.measurement_dim(), self.dims());
        let state = self.parts(&prior.mean)?;
        // The components that a range curves in: the position, and the scale error behind it.
        let first = prior.dim() - state.nuisance.len();
        let scale = self.scale_index().filter(|_| !state.nuisance.is_empty());
        let mut chosen: Vec<usize> = (0..d).collect();
        chosen.extend(scale.map(|index| first + index));
        let cov = prior.cov.select_rows(&chosen).select_columns(&chosen);
        let mut products = Vec::with_capacity(self.channels());
        let mut out = Curvature {
            shift: DVector::zeros(m),
            noise: DMatrix::zeros(m, m),
        };
        for i in 0..self.channels() {
            let row = self.row(i, state.position, state.nuisance)?;
            // The slowness, and what it leaves of the gradient for the direction.
            let slowness = row.by_bias;
            let distance = row.by_scale / slowness;
            let offset = |j: usize| (state.position[j] - self.settings.hydrophones[(i, j)]) / distance;
            let stretch = 1.0 + self.error_of(i, state.nuisance).scale;
            let hessian = DMatrix::from_fn(chosen.len(), chosen.len(), |a, b| {
                slowness
                    * match (a < d, b < d) {
                        (true, true) => stretch * (f64::from(u8::from(a == b)) - offset(a) * offset(b)) / distance,
                        (true, false) => offset(a),
                        (false, true) => offset(b),
                        (false, false) => 0.0,
                    }
            });
            let product = hessian * &cov;
            out.shift[i] = 0.5 * product.trace();
            products.push(product);
        }
        for (i, left) in products.iter().enumerate() {
            for (j, right) in products.iter().enumerate() {
                // tr(A B) = Σ A_ab B_ba
                out.noise[(i, j)] = 0.5 * left.component_mul(&right.transpose()).sum();
            }
        }
        Ok(out)
    }
}
