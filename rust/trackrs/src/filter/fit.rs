//! A kinematic state fitted to the measurements of a short window, every one at its own time.
//!
//! | symbol   | name here     | shape | meaning                                                             |
//! |----------|---------------|-------|---------------------------------------------------------------------|
//! | x        | `state`       | n     | the state at the last time t: kinematic, then lasting errors η      |
//! | η₀, P_η  | `prior`       | q     | what is known of η beforehand; of the kinematic part nothing is     |
//! | Φ_k      |               | n×n   | ∂f(x, t_k − t)/∂x: the state brought back to the time of row k      |
//! | J_k      | `jacobian`    | m×n   | H_k Φ_k, H_k = ∂h/∂x at that state                                  |
//! | c_k, W_k | `shift`, `noise` | n, n×n | known inputs, and covariance of the motion noise w_k, gathered from t_k to t |
//! | Σ        | `cov`         | M×M   | covariance of all M measured components                             |
//!
//! z_k = h(Φ_k (x − c_k − w_k)) + e_k, and of two rows the later one's noise is part of the earlier one's, so that
//! c_k = c_{k+1} + F(t − t_{k+1}) u_{k+1},
//! W_k = W_{k+1} + F(t − t_{k+1}) Q(t_{k+1} − t_k) F(t − t_{k+1})ᵀ,  Σ_kl = J_k W_max(k,l) J_lᵀ + δ_kl R.
//! Gauss-Newton with Levenberg's damping λ, which is zero as long as the objective falls:
//! N = Jᵀ Σ⁻¹ J + blkdiag(0, P_η⁻¹),  (N + λ diag N) dx = Jᵀ Σ⁻¹ r − [0; P_η⁻¹ (η − η₀)],  Σ and J anew at every step.
//! P = N⁻¹;  χ² = rᵀ Σ⁻¹ r + (η − η₀)ᵀ P_η⁻¹ (η − η₀) with M − (n − q) degrees of freedom: η costs q and its prior gives q.
//!
//! The joint covariance of position, velocity and lasting errors is exact to first order. U12, the polynomial through three
//! fixes, is the case of three complete rows without lasting errors and as many unknowns as coordinates.
//! Reference: generalised least squares; spec labels U11, U12.

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result};
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::{eigen_range, symmetrise};
use crate::model::{Motion, Sensor, sensor};

const MAX_ITERATIONS: usize = 100;
const MAX_DAMPING: f64 = 1e12;
/// Converged when a full step is shorter than this share of the standard deviations.
const TOLERANCE: f64 = 1e-5;
/// Least eigenvalue of N, scaled to unit diagonal: below it the window leaves a direction undetermined.
const SINGULAR: f64 = 1e-12;

/// One measurement of a window.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub(super) time: f64,
    pub(super) measurement: DVector<f64>,
    /// Added to the state predicted from the row before.
    pub(super) input: Option<DVector<f64>>,
}

impl Row {
    /// Whether a known input moves the state here.
    pub(super) fn is_pushed(&self) -> bool {
        self.input.iter().flatten().any(|&v| v != 0.0)
    }
}

/// Measurements to fit a state to, and the models that say how.
pub(super) struct Window<'a> {
    motion: &'a dyn Motion,
    sensor: &'a dyn Sensor,
    rows: Vec<&'a Row>,
    last: f64,
    shift: Vec<DVector<f64>>,
    /// Row and component of all that is observed, row by row.
    observed: Vec<(usize, usize)>,
    noise: Vec<DMatrix<f64>>,
    sensor_noise: DMatrix<f64>,
    prior: Gaussian,
    prior_factor: Cholesky,
}

/// A fitted state.
pub(super) struct Fitted {
    /// At the time of the last row.
    pub(super) state: Gaussian,
    /// N.
    pub(super) information: DMatrix<f64>,
    /// χ².
    pub(super) statistic: f64,
    pub(super) dof: usize,
}

/// Everything at one state.
struct Here {
    jacobian: DMatrix<f64>,
    residual: DVector<f64>,
    factor: Cholesky,
}

impl<'a> Window<'a> {
    /// Rows in the order of time; `prior` is of the last components of the state.
    pub(super) fn new(
        rows: Vec<&'a Row>,
        motion: &'a dyn Motion,
        sensor: &'a dyn Sensor,
        prior: &Gaussian,
    ) -> Result<Self> {
        let n = motion.state_dim();
        let last = rows.last().map_or(0.0, |row| row.time);
        let origin = DVector::zeros(n);
        let mut shift = vec![DVector::zeros(n); rows.len()];
        let mut noise = vec![DMatrix::zeros(n, n); rows.len()];
        for k in (0..rows.len().saturating_sub(1)).rev() {
            let next = rows[k + 1];
            let f = motion.jacobian(&origin, last - next.time);
            noise[k] = &noise[k + 1] + &f * motion.noise(next.time - rows[k].time) * f.transpose();
            shift[k] = match &next.input {
                Some(input) => &shift[k + 1] + &f * input,
                None => shift[k + 1].clone(),
            };
        }
        let components = |(k, row): (usize, &&Row)| heard(row).into_iter().map(move |i| (k, i)).collect::<Vec<_>>();
        Ok(Self {
            motion,
            sensor,
            observed: rows.iter().enumerate().flat_map(components).collect(),
            rows,
            last,
            shift,
            noise,
            sensor_noise: sensor.noise(),
            prior: prior.clone(),
            prior_factor: Cholesky::new(&prior.cov, "prior of the lasting errors")?,
        })
    }

    /// The fit that the iteration finds from a position, at rest and with the lasting errors as known beforehand.
    pub(super) fn fit_from(&self, position: &DVector<f64>) -> Result<Fitted> {
        let (n, q) = (self.motion.state_dim(), self.prior.dim());
        let mut x = DVector::zeros(n);
        x.rows_mut(0, position.len()).copy_from(position);
        x.rows_mut(n - q, q).copy_from(&self.prior.mean);
        let mut damping = 0.0_f64;
        let more = |damping: f64| (damping * 10.0).max(1e-3);
        let mut here = self.look(&x)?;
        for _ in 0..MAX_ITERATIONS {
            if damping > MAX_DAMPING {
                break;
            }
            let normal = self.normal(&here, &x);
            let mut damped = normal.information.clone();
            for i in 0..n {
                damped[(i, i)] *= 1.0 + damping;
            }
            let Ok(factor) = Cholesky::new(&damped, "information of the start") else {
                damping = more(damping);
                continue;
            };
            let right = DMatrix::from_column_slice(n, 1, normal.right.as_slice());
            let step: DVector<f64> = factor.solve(&right).column(0).into();
            let trial = &x + &step;
            let before = self.objective(&here.factor, &here.residual, &x);
            let better = self.residual(&trial).is_ok_and(|residual| {
                self.objective(&here.factor, &residual, &trial) <= before + 1e-9 * (1.0 + before)
            });
            if !better {
                damping = more(damping);
                continue;
            }
            let short = step.dot(&(&normal.information * &step)) <= TOLERANCE * TOLERANCE;
            x = trial;
            here = self.look(&x)?;
            if short && damping == 0.0 {
                return self.finish(x, &here);
            }
            damping = if damping < 1e-2 { 0.0 } else { damping / 10.0 };
        }
        Err(refused("the fit of the first measurements did not converge"))
    }

    /// Number of kinematic components.
    fn kinematic(&self) -> usize {
        self.motion.state_dim() - self.prior.dim()
    }

    fn finish(&self, x: DVector<f64>, here: &Here) -> Result<Fitted> {
        let n = x.len();
        let information = self.normal(here, &x).information;
        let undetermined = || refused("the first measurements leave a direction of the state undetermined");
        let scale = information.diagonal().map(f64::sqrt);
        let scaled = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (scale[i] * scale[j]));
        if !scaled.iter().all(|v| v.is_finite()) || eigen_range(&scaled)?.min <= SINGULAR {
            return Err(undetermined());
        }
        let factor = Cholesky::new(&scaled, "information of the start").map_err(|_| undetermined())?;
        let inverse = factor.solve(&DMatrix::identity(n, n));
        let mut cov = DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] / (scale[i] * scale[j]));
        symmetrise(&mut cov);
        Ok(Fitted {
            statistic: self.objective(&here.factor, &here.residual, &x),
            dof: self.observed.len().saturating_sub(self.kinematic()),
            state: Gaussian { mean: x, cov },
            information,
        })
    }

    /// The state at the time of row k.
    fn then(&self, x: &DVector<f64>, k: usize) -> DVector<f64> {
        self.motion
            .propagate(&(x - &self.shift[k]), self.rows[k].time - self.last)
    }

    fn residual(&self, x: &DVector<f64>) -> Result<DVector<f64>> {
        let mut out = Vec::with_capacity(self.observed.len());
        for (k, row) in self.rows.iter().enumerate() {
            let expected = self.sensor.observe(&self.then(x, k), None)?;
            let residual = sensor::residual(self.sensor, &row.measurement, &expected);
            out.extend(heard(row).into_iter().map(|i| residual[i]));
        }
        Ok(DVector::from_vec(out))
    }

    fn look(&self, x: &DVector<f64>) -> Result<Here> {
        let mut jacobian = DMatrix::zeros(self.observed.len(), x.len());
        let mut slot = 0;
        for (k, row) in self.rows.iter().enumerate() {
            let back = self.motion.jacobian(x, row.time - self.last);
            let rows = self.sensor.jacobian(&self.then(x, k), None)? * back;
            for i in heard(row) {
                jacobian.set_row(slot, &rows.row(i));
                slot += 1;
            }
        }
        Ok(Here {
            factor: Cholesky::new(&self.cov(&jacobian), "covariance of the first measurements")?,
            residual: self.residual(x)?,
            jacobian,
        })
    }

    /// Σ.
    fn cov(&self, jacobian: &DMatrix<f64>) -> DMatrix<f64> {
        let count = self.observed.len();
        let mut cov = DMatrix::zeros(count, count);
        for (b, &(l, j)) in self.observed.iter().enumerate() {
            let through = &self.noise[l] * jacobian.row(b).transpose();
            for (a, &(k, i)) in self.observed.iter().enumerate().take(b + 1) {
                let mut value = (jacobian.row(a) * &through)[0];
                if k == l {
                    value += self.sensor_noise[(i, j)];
                }
                cov[(a, b)] = value;
                cov[(b, a)] = value;
            }
        }
        cov
    }

    fn off_prior(&self, x: &DVector<f64>) -> DVector<f64> {
        x.rows(self.kinematic(), self.prior.dim()) - &self.prior.mean
    }

    fn objective(&self, factor: &Cholesky, residual: &DVector<f64>, x: &DVector<f64>) -> f64 {
        factor.whiten(residual).norm_squared() + self.prior_factor.whiten(&self.off_prior(x)).norm_squared()
    }

    fn normal(&self, here: &Here, x: &DVector<f64>) -> Normal {
        let (first, q) = (self.kinematic(), self.prior.dim());
        let mut rows = here.jacobian.clone();
        for j in 0..rows.ncols() {
            let column = here.factor.whiten(&rows.column(j).into_owned());
            rows.set_column(j, &column);
        }
        let mut information = rows.transpose() * &rows;
        let mut right = rows.transpose() * here.factor.whiten(&here.residual);
        let inverse = self.prior_factor.solve(&DMatrix::identity(q, q));
        let mut block = information.view_mut((first, first), (q, q));
        block += &inverse;
        let mut tail = right.rows_mut(first, q);
        tail -= inverse * self.off_prior(x);
        Normal { information, right }
    }
}

struct Normal {
    information: DMatrix<f64>,
    right: DVector<f64>,
}

/// Components that a row has.
fn heard(row: &Row) -> Vec<usize> {
    (0..row.measurement.len())
        .filter(|&i| !row.measurement[i].is_nan())
        .collect()
}

fn refused(reason: &str) -> Error {
    Error::Unobservable {
        sensor: "the array".into(),
        reason: reason.into(),
    }
}
