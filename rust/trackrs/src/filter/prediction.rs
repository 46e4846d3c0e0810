//! The prediction step, in memory that serves one epoch after another.
//!
//! | symbol | name here    | shape  | meaning                                     |
//! |--------|--------------|--------|---------------------------------------------|
//! | x, P   | `prior`      | n, n×n | the estimate to begin with                  |
//! | F, Q   | `transition`, `noise` | n×n | of the motion over dt, or of a rule that stands in for it |
//! | u      | `input`      | n      | known input                                 |
//!
//! x⁻ = f(x) + u,  P⁻ = F P Fᵀ + Q, the lower half computed and mirrored. F and Q of a linear motion are made anew only
//! when dt changes, and their zeros are passed over.
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §5.2.

use nalgebra::{DMatrix, DVector};

use super::kalman::copy_rows;
use crate::gaussian::Gaussian;
use crate::linalg::kernel::{self, known, sized};
use crate::linalg::sparse::Sparse;
use crate::model::Motion;

/// A prediction and the matrices that made it, which a smoother needs again. Its memory serves one epoch after another.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// The estimate before the measurement.
    pub state: Gaussian,
    transition: Vec<f64>,
    noise: Vec<f64>,
    /// F again.
    sparse: Sparse,
    /// A row of F P, and (F P)ᵀ.
    product: Vec<f64>,
    transposed: Vec<f64>,
    /// The step that F is of, and that for which Q is the model's own; NaN: none.
    transition_dt: f64,
    noise_dt: f64,
}

impl Prediction {
    /// Memory for a state of length n.
    pub fn new(n: usize) -> Self {
        Self {
            state: Gaussian {
                mean: DVector::zeros(n),
                cov: DMatrix::zeros(n, n),
            },
            transition: vec![0.0; n * n],
            noise: vec![0.0; n * n],
            sparse: Sparse::default(),
            product: vec![0.0; n],
            transposed: vec![0.0; n * n],
            transition_dt: f64::NAN,
            noise_dt: f64::NAN,
        }
    }

    /// F, n×n, row by row.
    pub fn transition(&self) -> &[f64] {
        &self.transition
    }

    /// Q, n×n, row by row.
    pub fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// Predicts `dt` seconds ahead with the model's own noise; `input` (length n) is added to the predicted state.
    pub fn predict(&mut self, prior: &Gaussian, motion: &dyn Motion, dt: f64, input: Option<&[f64]>) {
        if dt != self.noise_dt {
            copy_rows(&motion.noise(dt), &mut self.noise);
            self.noise_dt = dt;
        }
        self.propagate(prior, motion, dt, input);
    }

    /// The same with this Q (n×n) instead of the model's own.
    pub fn predict_with(
        &mut self,
        prior: &Gaussian,
        motion: &dyn Motion,
        dt: f64,
        input: Option<&[f64]>,
        noise: &[f64],
    ) {
        self.noise.copy_from_slice(noise);
        self.noise_dt = f64::NAN;
        self.propagate(prior, motion, dt, input);
    }

    fn propagate(&mut self, prior: &Gaussian, motion: &dyn Motion, dt: f64, input: Option<&[f64]>) {
        let n = prior.dim();
        let linear = motion.is_linear();
        if !linear || dt != self.transition_dt {
            copy_rows(&motion.jacobian(&prior.mean, dt), &mut self.transition);
            self.sparse.set(n, &self.transition);
            self.transition_dt = dt;
        }
        if !linear {
            self.state.mean.copy_from(&motion.propagate(&prior.mean, dt));
        }
        let (mean, cov) = (self.state.mean.as_mut_slice(), self.state.cov.as_mut_slice());
        if linear {
            for (i, x) in mean.iter_mut().enumerate() {
                *x = self.sparse.row_dot(i, prior.mean.as_slice());
            }
        }
        if let Some(input) = input {
            kernel::add_scaled(mean, 1.0, input);
        }
        let work = [&mut self.product[..], &mut self.transposed[..]];
        sized!(predict_cov(
            n,
            &self.sparse,
            &self.noise,
            prior.cov.as_slice(),
            work,
            cov
        ));
    }

    /// Makes this the prediction of a state that was reached from nothing: F = 0, Q = P.
    pub fn cut(&mut self, start: &Gaussian) {
        self.state.clone_from(start);
        self.transition.fill(0.0);
        self.noise.copy_from_slice(start.cov.as_slice());
        (self.transition_dt, self.noise_dt) = (f64::NAN, f64::NAN);
    }
}

/// P⁻ = F P Fᵀ + Q as F (F P)ᵀ + Q, the lower half computed and mirrored.
fn predict_cov<const N: usize>(
    n: usize,
    f: &Sparse,
    noise: &[f64],
    cov: &[f64],
    work: [&mut [f64]; 2],
    out: &mut [f64],
) {
    let n = known::<N>(n);
    let [row, transposed] = work;
    f.multiply_transposed::<N>(n, cov, row, transposed);
    f.add_product::<N>(n, noise, transposed, out);
    kernel::mirror(n, out);
}
