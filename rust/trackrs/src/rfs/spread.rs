//! The spread of a target's measurements: its extent through the noise of a sensor.
//!
//! | symbol | name here   | shape | meaning                                                                      |
//! |--------|-------------|-------|------------------------------------------------------------------------------|
//! | X̂, κ   | [`Extent`]  | d×d   | expected covariance of a target's points about its centre, and its certainty |
//! | R      | `noise`     | d×d   | covariance of the sensor's noise                                             |
//! | Ŷ      | `cov`       | d×d   | X̂ + R: expected covariance of a measurement about the centre                 |
//! | κ_Y, ν | `certainty`, `dof` |  | Y ~ inverse Wishart of mean Ŷ; ν = κ_Y + d + 1                              |
//! | n, S   | `count`, `scatter` | d×d | number and scatter of the measurements of a cell                         |
//!
//! In the order of the code:
//!   through R   κ_Y / tr Ŷ² = κ / tr X̂²                                                                              (E3)
//!   scatter     ln ∫ p(S | Y) dP(Y) = −½ (n−1) d ln π + ln Γ_d(½ (ν+n−1)) − ln Γ_d(½ ν)
//!                 − ½ ν ln |1 + V⁻¹ S| − ½ (n−1) ln |V + S|,   V = κ_Y Ŷ                                             (E2)
//!   update      κ_Y + n − 1,  Ŷ⁺ = (V + S) / (κ_Y + n − 1),  X̂⁺ = Ŷ⁺ − R, eigenvalues at least ε of R                 (E4)
//! The n^(−d/2) of E2 is in the density of the mean (`view.rs`), which has Ŷ in place of R.
//!
//! Reference: docs/intensity_filters.md, section Extent; Feldmann, Fränken, Koch (2011), Tracking of extended objects and
//! group targets using random matrices, IEEE TSP 59(4). Deviations: E3 in place of their shrunk scatter; the mean of a cell
//! says nothing of X.

use nalgebra::{DMatrix, DVector};

use super::Sight;
use super::group::Found;
use super::mixture::Component;
use super::view::{Noise, View};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::{clip_eigenvalues, symmetrise};
use crate::model::sensor::Curvature;
use crate::model::{Motion, Sensor};
use crate::track::Extent;

const LN_PI: f64 = 1.144_729_885_849_400_2;
/// Least extent, of the sensor's noise.
const LEAST: f64 = 1e-3;
/// From here on more certainty of Y changes nothing, and its Γ functions lose their digits.
const MOST_CERTAIN: f64 = 1e6;

/// A component as a sensor sees it, and how its measurements spread, where it has an extent.
pub(crate) struct Seen {
    pub(crate) view: View,
    pub(crate) spread: Option<Spread>,
    /// Of the scatter of so many measurements and one more.
    log_volumes: Vec<f64>,
}

impl Seen {
    /// In a scan with `count` measurements.
    pub(crate) fn new(component: &Component, sight: &Sight<'_>, noise: &Noise, count: usize) -> Result<Self> {
        let look =
            |sensor: &dyn Sensor, noise: &Noise| View::new(&component.state, sensor, sight.platform, sight.rule, noise);
        let Some(extent) = &component.extent else {
            return Ok(Self {
                view: look(sight.sensor, noise)?,
                spread: None,
                log_volumes: Vec::new(),
            });
        };
        let spread = Spread::new(extent, noise.cov())?;
        let sensor = SpreadSensor::of(sight.sensor, Some(extent));
        Ok(Self {
            view: look(&sensor, &Noise::of(&sensor)?)?,
            log_volumes: spread.log_volumes(count),
            spread: Some(spread),
        })
    }

    /// What a cell is worth beside its mean, where there is an extent.
    pub(crate) fn log_scatter(&self, size: usize, scatter: &[f64]) -> Option<f64> {
        let (spread, k) = (self.spread.as_ref()?, size.saturating_sub(1));
        let volume = self.log_volumes.get(k)? - 0.5 * self.view.log_volume;
        Some(volume + spread.log_shape(k as f64, scatter))
    }

    /// The extent after so many measurements.
    pub(crate) fn extent_after(&self, extent: &Extent, count: f64, scatter: &[f64]) -> Extent {
        let spread = self.spread.as_ref();
        spread.map_or_else(|| extent.clone(), |spread| spread.updated(extent, count, scatter))
    }

    /// The scatter of what a member of a group got; empty without extents.
    pub(crate) fn scatter(&self, found: &Found) -> Vec<f64> {
        self.spread.as_ref().map_or_else(Vec::new, |spread| {
            self.view.turned_back(&spread.cov, &found.scatter).as_slice().to_vec()
        })
    }

    /// By how much E2 is above the density of the same scatter with Ŷ for certain.
    pub(crate) fn worth(&self, found: &Found) -> f64 {
        let Some(spread) = &self.spread else { return 0.0 };
        let m = spread.dims();
        let trace: f64 = found.scatter.iter().step_by(m + 1).sum();
        let certain = (found.count - 1.0).max(0.0) * self.view.log_volume + trace;
        spread.log_density(found.count, &self.scatter(found)) + 0.5 * certain
    }
}

/// Spread of the measurements of a target: its extent through the noise of a sensor.
pub(crate) struct Spread {
    noise: DMatrix<f64>,
    /// Ŷ.
    cov: DMatrix<f64>,
    certainty: f64,
    /// Cholesky factor of V.
    factor: Cholesky,
}

impl Spread {
    pub(crate) fn new(extent: &Extent, noise: &DMatrix<f64>) -> Result<Self> {
        let cov = &extent.cov + noise;
        let certainty = extent.certainty * (cov.norm_squared() / extent.cov.norm_squared());
        let certainty = certainty.min(MOST_CERTAIN.max(extent.certainty));
        Ok(Self {
            noise: noise.clone(),
            factor: Cholesky::new(&(&cov * certainty), "spread of measurements")?,
            cov,
            certainty,
        })
    }

    fn dims(&self) -> usize {
        self.cov.nrows()
    }

    /// ν.
    fn dof(&self) -> f64 {
        self.certainty + self.dims() as f64 + 1.0
    }

    /// −½ k d ln π + ln Γ_d(½ (ν+k)) − ln Γ_d(½ ν) for k = n − 1 = 0 … `max`.
    fn log_volumes(&self, max: usize) -> Vec<f64> {
        let (d, half) = (self.dims(), 0.5 * self.dof());
        let mut out: Vec<f64> = (0..=max.min(1)).map(|k| self.log_volume(k as f64)).collect();
        for k in 2..=max {
            // Γ_d(a + 1) / Γ_d(a) = Π_i (a − i/2), i = 0 … d − 1.
            let a = half + 0.5 * (k - 2) as f64;
            let ratio: f64 = (0..d).map(|i| a - 0.5 * i as f64).product();
            out.push(out[k - 2] + libm::log(ratio) - d as f64 * LN_PI);
        }
        out
    }

    fn log_volume(&self, k: f64) -> f64 {
        let half = 0.5 * self.dof();
        let log_gamma = |i: usize| {
            let a = half - 0.5 * i as f64;
            libm::lgamma(a + 0.5 * k) - libm::lgamma(a)
        };
        let d = self.dims();
        (0..d).map(log_gamma).sum::<f64>() - 0.5 * k * d as f64 * LN_PI
    }

    /// The rest of E2 for a scatter of k + 1 measurements, d×d column by column.
    fn log_shape(&self, k: f64, scatter: &[f64]) -> f64 {
        let more = log_determinant_with(self.factor.lower(), scatter);
        -0.5 * (self.dof() * more + k * (more + self.factor.log_determinant()))
    }

    /// E2 for a number of measurements that need not be whole.
    pub(crate) fn log_density(&self, count: f64, scatter: &[f64]) -> f64 {
        let k = (count - 1.0).max(0.0);
        self.log_volume(k) + self.log_shape(k, scatter)
    }

    /// The extent after a cell; `count` need not be whole.
    pub(crate) fn updated(&self, extent: &Extent, count: f64, scatter: &[f64]) -> Extent {
        let d = self.dims();
        if count <= 1.0 {
            return extent.clone();
        }
        let certainty = self.certainty + count - 1.0;
        let mut inner =
            (&self.cov * self.certainty + DMatrix::from_column_slice(d, d, scatter)) / certainty - &self.noise;
        symmetrise(&mut inner);
        let Ok(cov) = above(&inner, &self.noise) else {
            return extent.clone();
        };
        let certainty = certainty * (cov.norm_squared() / (&cov + &self.noise).norm_squared());
        Extent { cov, certainty }
    }
}

/// ln |1 + (L Lᵀ)⁻¹ S| of a positive semidefinite S, d×d.
fn log_determinant_with(lower: &DMatrix<f64>, scatter: &[f64]) -> f64 {
    let d = lower.nrows();
    let mut inner = [0.0; 9];
    let inner = &mut inner[..d * d];
    inner.copy_from_slice(scatter);
    // L⁻¹ S L⁻ᵀ: columns, then rows.
    for transposed in [false, true] {
        for column in 0..d {
            let at = |row: usize| if transposed { column + row * d } else { row + column * d };
            for row in 0..d {
                let mut sum = inner[at(row)];
                for i in 0..row {
                    sum -= lower[(row, i)] * inner[at(i)];
                }
                inner[at(row)] = sum / lower[(row, row)];
            }
        }
    }
    // The determinant of 1 + M as the sum of the principal minors of M, so that a small M is not lost beside 1.
    let at = |i: usize, j: usize| inner[i + j * d];
    let pair = |i: usize, j: usize| at(i, i) * at(j, j) - at(i, j) * at(j, i);
    let excess = match d {
        1 => at(0, 0),
        2 => at(0, 0) + at(1, 1) + pair(0, 1),
        _ => {
            let all = at(0, 0) * pair(1, 2) - at(0, 1) * (at(1, 0) * at(2, 2) - at(1, 2) * at(2, 0))
                + at(0, 2) * (at(1, 0) * at(2, 1) - at(1, 1) * at(2, 0));
            at(0, 0) + at(1, 1) + at(2, 2) + pair(0, 1) + pair(0, 2) + pair(1, 2) + all
        }
    };
    libm::log1p(excess.max(0.0))
}

/// The nearest matrix that is nowhere below `LEAST` of the noise.
fn above(cov: &DMatrix<f64>, noise: &DMatrix<f64>) -> Result<DMatrix<f64>> {
    let factor = Cholesky::new(noise, "measurement noise")?;
    let whitened = factor.whiten_both(cov);
    let clipped = clip_eigenvalues(&whitened, LEAST, f64::MAX)?;
    if clipped == whitened {
        return Ok(cov.clone());
    }
    let mut out = factor.lower() * clipped * factor.lower().transpose();
    symmetrise(&mut out);
    Ok(out)
}

/// A sensor whose measurements have another spread than its own.
#[derive(Debug)]
pub(crate) struct SpreadSensor<'a> {
    sensor: &'a dyn Sensor,
    cov: DMatrix<f64>,
}

impl<'a> SpreadSensor<'a> {
    /// Of targets with this extent, or without one.
    pub(crate) fn of(sensor: &'a dyn Sensor, extent: Option<&Extent>) -> Self {
        let mut cov = sensor.noise();
        if let Some(extent) = extent {
            cov += &extent.cov;
        }
        Self { sensor, cov }
    }
}

impl Sensor for SpreadSensor<'_> {
    fn measurement_dim(&self) -> usize {
        self.sensor.measurement_dim()
    }
    fn labels(&self) -> Vec<String> {
        self.sensor.labels()
    }
    fn check(&self, motion: &dyn Motion) -> Result<()> {
        self.sensor.check(motion)
    }
    fn observe(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        self.sensor.observe(state, platform)
    }
    fn jacobian(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        self.sensor.jacobian(state, platform)
    }
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        self.sensor.linearise_into(state, platform, expected, jacobian)
    }
    fn observe_all(&self, states: &[f64], n: usize, platform: Option<&DVector<f64>>, out: &mut [f64]) -> Result<()> {
        self.sensor.observe_all(states, n, platform, out)
    }
    fn noise(&self) -> DMatrix<f64> {
        self.cov.clone()
    }
    fn angles(&self) -> &[usize] {
        self.sensor.angles()
    }
    fn rotation(&self) -> Option<usize> {
        self.sensor.rotation()
    }
    fn platform_dims(&self) -> Option<usize> {
        self.sensor.platform_dims()
    }
    fn is_linear(&self) -> bool {
        self.sensor.is_linear()
    }
    fn is_linear_in_changes(&self) -> bool {
        self.sensor.is_linear_in_changes()
    }
    fn curvature(&self, prior: &Gaussian) -> Option<Result<Curvature>> {
        self.sensor.curvature(prior)
    }
}

#[cfg(test)]
mod tests;
