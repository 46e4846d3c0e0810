//! Kalman prediction and update in Joseph form.
//!
//! | symbol | name here            | shape    | meaning                                    |
//! |--------|----------------------|----------|--------------------------------------------|
//! | x, P   | `prior`, `posterior` | n, n×n   | state estimate and its covariance          |
//! | F, Q   | `Motion`             | n×n      | transition and motion noise over dt        |
//! | H, R   | `jacobian`, `noise`  | m×n, m×m | sensor matrix and noise                    |
//! | r      | `innovation`         | m        | measured minus predicted, angles wrapped   |
//! | S      | `cov`                | m×m      | its covariance, S = L Lᵀ                   |
//! | K      | `gain`               | n×m      | P Hᵀ S⁻¹, by solving with L; kept as Kᵀ    |
//!
//! predict:  x⁻ = f(x) + u,  P⁻ = F P Fᵀ + Q
//! update:   S = H P Hᵀ + R,  x⁺ = x + K r,  P⁺ = (I − K H) P (I − K H)ᵀ + K R Kᵀ
//! ν = L⁻¹ r is the whitened innovation, |ν|² the NIS, ln N(r; 0, S) = −½ (|ν|² + ln det S + m ln 2π).
//!
//! The Joseph form is evaluated as B = P − K (H P), P⁺ = B + (K R − B Hᵀ) Kᵀ: the same products in another
//! order, n²m instead of n³ operations. All of it is written with rows of length n: Bᵀ and P⁺ᵀ are what is computed.
//!
//! A NaN in the measurement means that this component was not observed: its row is left out.
//! How the matrices came about is no matter here: a rule that gives other F, Q, H, R (statistical linearisation) is
//! followed by the same update.
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §5.2; Joseph form ibid. (5.2.3-18).

use nalgebra::{DMatrix, DVector};

use super::correction::{Correction, Scratch};
use super::extended::Rule;
use super::measured_root::MeasuredRoot;
use super::prediction::{Course, Prediction};
use super::square_root::Form;
use crate::error::{Error, Result, require_size};
use crate::gaussian::{Gaussian, Gaussians};
use crate::linalg::copy_rows;
use crate::linalg::kernel::{self, BadPivot, known, sized};
use crate::linalg::sparse::Sparse;
use crate::model::Motion;

/// ln 2π.
pub const LN_TAU: f64 = 1.837_877_066_409_345_3;

/// The estimate `dt` seconds later; `input` (length n) is added to the predicted state.
pub fn predict(prior: &Gaussian, motion: &dyn Motion, dt: f64, input: Option<&DVector<f64>>) -> Result<Gaussian> {
    predict_by(Rule::Once, prior, motion, dt, input)
}

/// The same by any rule.
pub fn predict_by(
    rule: Rule,
    prior: &Gaussian,
    motion: &dyn Motion,
    dt: f64,
    input: Option<&DVector<f64>>,
) -> Result<Gaussian> {
    let mut prediction = Prediction::new(motion.space(), rule, Form::Joseph);
    let course = Course {
        motion,
        dt,
        input: input.map(DVector::as_slice),
        noise: None,
    };
    prediction.predict(prior, None, &course)?;
    Ok(prediction.state)
}

/// Several estimates `dt` seconds later.
#[derive(Debug, Clone, PartialEq)]
pub struct Predictions {
    /// The estimates.
    pub states: Gaussians,
    /// Whether each was found by the root of the covariance before, because its own came close to being singular.
    pub rooted: Vec<bool>,
}

/// Predicts several estimates by `dt` seconds.
pub fn predict_each<'a>(
    rule: Rule,
    priors: impl IntoIterator<Item = &'a Gaussian>,
    motion: &dyn Motion,
    dt: f64,
) -> Result<Predictions> {
    let space = motion.space();
    let mut prediction = Prediction::new(space, rule, Form::Joseph);
    let course = Course {
        motion,
        dt,
        input: None,
        noise: None,
    };
    let priors = priors.into_iter();
    let mut out = Predictions {
        states: Gaussians::new(space.dim),
        rooted: Vec::with_capacity(priors.size_hint().0),
    };
    out.states.reserve(priors.size_hint().0);
    for prior in priors {
        out.rooted.push(prediction.predict_definite(prior, &course)?);
        out.states.push(&prediction.state);
    }
    Ok(out)
}

/// Result of one measurement update.
#[derive(Debug, Clone, PartialEq)]
pub struct Update {
    /// The estimate after the measurement.
    pub posterior: Gaussian,
    /// Measured minus predicted, angles wrapped; NaN where not observed. Length m.
    pub innovation: DVector<f64>,
    /// Covariance of the innovation of all m components.
    pub innovation_cov: DMatrix<f64>,
    /// L⁻¹ × innovation over the observed components; NaN where not observed. Length m.
    pub whitened: DVector<f64>,
    /// Normalised innovation squared, chi-square with `dof` degrees of freedom if the model is right.
    pub nis: f64,
    /// Number of observed components.
    pub dof: usize,
    /// ln N(innovation; 0, S) over the observed components.
    pub log_likelihood: f64,
}

/// What a sensor is expected to report of one state: everything of an update that does not depend on the report.
#[derive(Debug, Clone)]
pub struct MeasurementPrediction {
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) jacobian: Vec<f64>,
    /// H again, without its zeros.
    pub(super) sparse: Sparse,
    pub(super) noise: Vec<f64>,
    /// H P, m×n.
    pub(super) cross: Vec<f64>,
    pub(super) cov: DMatrix<f64>,
    pub(super) lower: Vec<f64>,
    /// Whether S and H P are given, so that P⁺ = P − K S Kᵀ.
    pub(super) given: bool,
    /// The same in square-root form.
    pub(super) root: Option<Box<MeasuredRoot>>,
}

/// An innovation seen through the covariance it should have.
#[derive(Debug, Clone, PartialEq)]
pub struct WhitenedInnovation {
    /// L⁻¹ r.
    pub whitened: DVector<f64>,
    /// |L⁻¹ r|².
    pub nis: f64,
    /// Length of r.
    pub dof: usize,
    /// ln N(r; 0, S).
    pub log_likelihood: f64,
}

impl MeasurementPrediction {
    /// Memory for m components of a state of length n.
    pub(super) fn sized(n: usize, m: usize) -> Self {
        Self {
            n,
            m,
            jacobian: vec![0.0; m * n],
            sparse: Sparse::default(),
            noise: vec![0.0; m * m],
            cross: vec![0.0; m * n],
            cov: DMatrix::zeros(m, m),
            lower: vec![0.0; m * m],
            given: false,
            root: None,
        }
    }

    /// Prepares the update of `prior` by a sensor with this Jacobian and noise.
    pub fn new(prior: &Gaussian, jacobian: &DMatrix<f64>, noise: &DMatrix<f64>) -> Result<Self> {
        require_size("sensor Jacobian columns", prior.dim(), jacobian.ncols())?;
        require_size("sensor noise", jacobian.nrows(), noise.nrows())?;
        let mut out = Self::sized(prior.dim(), jacobian.nrows());
        copy_rows(jacobian, &mut out.jacobian);
        copy_rows(noise, &mut out.noise);
        out.prepare(prior.cov.as_slice())?;
        Ok(out)
    }

    /// S and its factor for a state of covariance P and the H and R that are set.
    pub(super) fn prepare(&mut self, cov: &[f64]) -> Result<()> {
        let (n, m) = (self.n, self.m);
        self.sparse.set(n, &self.jacobian);
        if self.root.is_some() {
            return self.factorise();
        }
        sized!(cross(n, &self.sparse, cov, &mut self.cross));
        let s = self.cov.as_mut_slice();
        for (a, seen) in self.cross.chunks_exact(n.max(1)).enumerate() {
            for b in 0..=a {
                let noise = 0.5 * (self.noise[a * m + b] + self.noise[b * m + a]);
                let sum = self.sparse.row_dot(b, seen) + noise;
                (s[a * m + b], s[b * m + a]) = (sum, sum);
            }
        }
        self.factorise()
    }

    pub(super) fn factorise(&mut self) -> Result<()> {
        let m = self.m;
        let factored = if self.root.is_some() {
            self.prepare_root()
        } else {
            self.lower.copy_from_slice(self.cov.as_slice());
            sized!(factor(m, &mut self.lower))
        };
        factored.map_err(|pivot| Error::NotPositiveDefinite {
            what: "innovation covariance".into(),
            pivot: pivot.index,
            value: pivot.value,
        })
    }

    /// H, m×n row by row.
    pub fn jacobian(&self) -> &[f64] {
        &self.jacobian
    }

    /// R, m×m, and what the rule adds to it.
    pub fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// H P, m×n row by row.
    pub fn cross(&self) -> &[f64] {
        &self.cross
    }

    /// S, m×m.
    pub fn cov(&self) -> &DMatrix<f64> {
        &self.cov
    }

    /// ln det S.
    pub fn log_determinant(&self) -> f64 {
        kernel::log_determinant(self.m, &self.lower)
    }

    /// The innovation whitened by S; all components observed.
    pub fn whiten(&self, innovation: &DVector<f64>) -> WhitenedInnovation {
        let mut whitened = innovation.clone();
        let nis = self.nis(innovation.as_slice(), whitened.as_mut_slice());
        WhitenedInnovation {
            whitened,
            nis,
            dof: self.m,
            log_likelihood: self.log_likelihood(nis),
        }
    }

    /// |L⁻¹ r|² of an innovation of all components; `whitened` becomes L⁻¹ r.
    pub(crate) fn nis(&self, innovation: &[f64], whitened: &mut [f64]) -> f64 {
        whitened.copy_from_slice(innovation);
        kernel::solve_lower::<1>(self.m, 1, &self.lower, whitened);
        kernel::dot(whitened, whitened)
    }

    pub(crate) fn log_likelihood(&self, nis: f64) -> f64 {
        self.log_likelihood_of(nis, self.log_determinant())
    }

    /// The same where ln det S is known.
    pub(crate) fn log_likelihood_of(&self, nis: f64, log_determinant: f64) -> f64 {
        -0.5 * (nis + log_determinant + self.m as f64 * LN_TAU)
    }

    /// The same prediction for some of the components only.
    pub fn select(&self, components: &[usize]) -> Result<Self> {
        let mut part = Self::sized(self.n, components.len());
        self.select_into(components, &mut part)?;
        Ok(part)
    }

    pub(super) fn select_into(&self, components: &[usize], part: &mut Self) -> Result<()> {
        let (n, m, k) = (self.n, self.m, components.len());
        part.m = k;
        part.given = self.given;
        for matrix in [&mut part.jacobian, &mut part.cross] {
            matrix.resize(k * n, 0.0);
        }
        part.noise.resize(k * k, 0.0);
        part.lower.resize(k * k, 0.0);
        if part.cov.nrows() != k {
            part.cov = DMatrix::zeros(k, k);
        }
        for (a, &i) in components.iter().enumerate() {
            part.jacobian[a * n..(a + 1) * n].copy_from_slice(&self.jacobian[i * n..(i + 1) * n]);
            part.cross[a * n..(a + 1) * n].copy_from_slice(&self.cross[i * n..(i + 1) * n]);
            for (b, &j) in components.iter().enumerate() {
                part.noise[a * k + b] = self.noise[i * m + j];
                part.cov[(a, b)] = self.cov[(i, j)];
            }
        }
        part.sparse.set(n, &part.jacobian);
        self.select_root(components, part);
        part.factorise()
    }

    /// The posterior for a fully observed innovation.
    pub fn posterior(&self, prior: &Gaussian, innovation: &DVector<f64>) -> Gaussian {
        let mut out = prior.clone();
        self.posterior_into(prior.into(), innovation.as_slice(), &mut Scratch::default(), &mut out);
        out
    }

    /// The whole update record; NaN components of the innovation count as not observed.
    pub fn update(&self, prior: &Gaussian, innovation: &DVector<f64>) -> Result<Update> {
        require_size("innovation", self.m, innovation.len())?;
        let mut correction = Correction::new(self.n, self.m);
        correction.apply(self, prior.into(), innovation.as_slice())?;
        Ok(correction.record(self, innovation.clone()))
    }
}

/// H P, m×n.
fn cross<const N: usize>(n: usize, h: &Sparse, cov: &[f64], out: &mut [f64]) {
    let n = known::<N>(n);
    h.multiply::<N>(n, cov, out);
}

fn factor<const N: usize>(m: usize, s: &mut [f64]) -> std::result::Result<(), BadPivot> {
    kernel::cholesky(known::<N>(m), s)
}
