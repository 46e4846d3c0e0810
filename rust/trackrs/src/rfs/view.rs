//! A component as a sensor sees it, in axes in which the noise is 1 and everything else diagonal.
//!
//! | symbol | name here   | shape | meaning                                                              |
//! |--------|-------------|-------|----------------------------------------------------------------------|
//! | ĥ      | `expected`  | m     | measurement that is expected of the component                        |
//! | L      | `lower`     | m×m   | R = L Lᵀ                                                             |
//! | A, λ   | `axes`, `spread` | m×m, m | A R Aᵀ = 1,  A H P Hᵀ Aᵀ = diag λ                               |
//! | B      | `cross`     | n×m   | P Hᵀ Aᵀ                                                              |
//! | T      | `slope`     | m×n   | A H                                                                  |
//! | y      |             | m     | A (z̄ − ĥ), angles wrapped                                            |
//!
//! A mean z̄ of n measurements has noise R/n, so that with A = Qᵀ L⁻¹, L⁻¹ H P Hᵀ L⁻ᵀ = Q diag λ Qᵀ:
//!
//! ln N(stack z; …) = −n/2 (m ln 2π + ln |R|) − ½ Σ ln(n λ_i + 1) − ½ Σ n y_i² / (n λ_i + 1) − ½ tr(R⁻¹ S_W)
//! K y = B diag(n / (n λ + 1)) y;   P ← (1 − K T) P (1 − K T)ᵀ + K Kᵀ / n
//!
//! the O(1) form of the stacked update (extended-target spec 4.2), without a factorisation per cell.
//! Where S is more than H P Hᵀ + R (curvature, sigma points): P ← P − B diag(n / (n λ + 1)) Bᵀ, the same where h is linear.
//! What would be nearly singular by either is done by the root of P (`filter/escalation.rs`), from T and the noise
//! A (S − H P Hᵀ − R) Aᵀ + 1/n.

use nalgebra::{DMatrix, DVector};

use crate::error::Result;
use crate::filter::correction::Scratch;
use crate::filter::escalation::correct_by_root;
use crate::filter::extended::{Rule, expect};
use crate::filter::kalman::LN_TAU;
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;
use crate::linalg::symmetric::{symmetric_eigen, symmetrise};
use crate::model::Sensor;
use crate::model::sensor::residual_into;

/// The noise of a sensor, factorised once per scan.
pub(crate) struct Noise {
    cov: DMatrix<f64>,
    lower: Cholesky,
    /// m ln 2π + ln |R|.
    pub(crate) log_volume: f64,
}

impl Noise {
    pub(crate) fn of(sensor: &dyn Sensor) -> Result<Self> {
        let cov = sensor.noise();
        let lower = Cholesky::new(&cov, "measurement noise")?;
        let log_volume = cov.nrows() as f64 * LN_TAU + lower.log_determinant();
        Ok(Self { cov, lower, log_volume })
    }

    /// L⁻¹ z.
    pub(crate) fn whiten(&self, z: &[f64]) -> DVector<f64> {
        self.lower.whiten(&DVector::from_column_slice(z))
    }

    /// R.
    pub(crate) fn cov(&self) -> &DMatrix<f64> {
        &self.cov
    }
}

/// What a sensor sees of one component.
pub(crate) struct View {
    expected: Vec<f64>,
    axes: Vec<f64>,
    pub(crate) spread: Vec<f64>,
    cross: DMatrix<f64>,
    slope: DMatrix<f64>,
    /// A (S − H P Hᵀ − R) Aᵀ, where it may be more than nothing.
    bends: Option<DMatrix<f64>>,
    /// m ln 2π + ln |R|.
    pub(crate) log_volume: f64,
}

impl View {
    pub(crate) fn new(
        state: &Gaussian,
        sensor: &dyn Sensor,
        platform: Option<&DVector<f64>>,
        rule: Rule,
        noise: &Noise,
    ) -> Result<Self> {
        let (n, m) = (state.dim(), sensor.measurement_dim());
        let seen = expect(state, sensor, platform, rule)?;
        let inside = noise.lower.whiten_both(&(seen.prediction.cov() - &noise.cov));
        let eigen = symmetric_eigen(&inside)?;
        let mut inverse = DMatrix::identity(m, m);
        for mut column in inverse.column_iter_mut() {
            let whitened = noise.lower.whiten(&column.clone_owned());
            column.copy_from(&whitened);
        }
        let axes = eigen.vectors.transpose() * inverse;
        let crossing = DMatrix::from_row_slice(m, n, seen.prediction.cross());
        let more = || DMatrix::from_row_slice(m, m, seen.prediction.noise()) - &noise.cov;
        let bends = (rule != Rule::Once).then(|| &axes * more() * axes.transpose());
        Ok(Self {
            expected: seen.expected.as_slice().to_vec(),
            cross: (&axes * crossing).transpose(),
            slope: &axes * DMatrix::from_row_slice(m, n, seen.prediction.jacobian()),
            bends,
            axes: axes.transpose().as_slice().to_vec(),
            spread: eigen.values.iter().map(|value| value.max(0.0)).collect(),
            log_volume: noise.log_volume,
        })
    }

    /// y of a measurement, or a mean of them; `scratch` has its length.
    pub(crate) fn offset(&self, sensor: &dyn Sensor, z: &[f64], scratch: &mut [f64], y: &mut [f64]) {
        residual_into(sensor, z, &self.expected, scratch);
        for (y, axis) in y.iter_mut().zip(self.axes.chunks_exact(scratch.len().max(1))) {
            *y = axis.iter().zip(scratch.iter()).map(|(a, r)| a * r).sum();
        }
    }

    /// A⁻¹ M A⁻ᵀ of a matrix in the axes of the view, m×m: A⁻¹ = R Aᵀ.
    pub(crate) fn turned_back(&self, noise: &DMatrix<f64>, inner: &[f64]) -> DMatrix<f64> {
        let m = noise.nrows();
        let back = noise * DMatrix::from_column_slice(m, m, &self.axes);
        &back * DMatrix::from_column_slice(m, m, inner) * back.transpose()
    }

    /// −½ Σ ln(n λ + 1) − ½ Σ n y² / (n λ + 1).
    pub(crate) fn log_density(&self, y: &[f64], n: f64) -> f64 {
        let (mut volume, mut distance) = (1.0, 0.0);
        for (y, spread) in y.iter().zip(&self.spread) {
            let factor = n * spread + 1.0;
            volume *= factor;
            distance += n * y * y / factor;
        }
        -0.5 * (libm::log(volume) + distance)
    }

    /// y² / (λ + 1): the squared Mahalanobis distance of one measurement.
    pub(crate) fn distance_squared(&self, y: &[f64]) -> f64 {
        y.iter()
            .zip(&self.spread)
            .map(|(y, spread)| y * y / (spread + 1.0))
            .sum()
    }

    /// The component after a mean of n measurements at y; n need not be whole.
    pub(crate) fn posterior(&self, prior: &Gaussian, y: &[f64], n: f64) -> Posterior {
        let mut gain = self.cross.clone();
        for (mut column, spread) in gain.column_iter_mut().zip(&self.spread) {
            column *= n / (n * spread + 1.0);
        }
        let mean = &prior.mean + &gain * DVector::from_column_slice(y);
        let mut cov = prior.cov.clone();
        if self.bends.is_none() {
            let mut kept = DMatrix::identity(prior.dim(), prior.dim());
            kept.gemm(-1.0, &gain, &self.slope, 1.0);
            cov = &kept * &prior.cov * kept.transpose();
            cov.gemm(1.0 / n, &gain, &gain.transpose(), 1.0);
        } else {
            cov.gemm(-1.0, &gain, &self.cross.transpose(), 1.0);
        }
        symmetrise(&mut cov);
        let mut state = Gaussian { mean, cov };
        let rooted = state.is_barely_definite() && self.correct_by_root(prior, y, n, &mut state).is_ok();
        Posterior { state, rooted }
    }

    fn correct_by_root(&self, prior: &Gaussian, y: &[f64], n: f64, out: &mut Gaussian) -> Result<()> {
        let mut noise = DMatrix::identity(y.len(), y.len()) / n;
        if let Some(bends) = &self.bends {
            noise += bends;
        }
        let rows = self.slope.transpose();
        let line = [rows.as_slice(), noise.as_slice()];
        correct_by_root(prior, line, y, &mut Scratch::default(), out)
    }
}

/// A component after an update.
pub(crate) struct Posterior {
    pub(crate) state: Gaussian,
    /// Whether it was found by the root of the covariance before, because its own came close to being singular.
    pub(crate) rooted: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::sigma_points::SigmaPoints;
    use crate::model::sensor::{LinearSensor, RangeBearing};
    use crate::stats::stream::Stream;

    fn random(rows: usize, columns: usize, stream: &mut Stream) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| stream.normal())
    }

    /// Where nothing is singular the root changes nothing, with curvature and sigma points neither.
    #[test]
    fn the_posterior_by_the_root_is_the_posterior() {
        let mut stream = Stream::new(9, 0);
        let sensor = RangeBearing::new([0.0, 0.0], 1.0, 0.05).unwrap();
        let noise = Noise::of(&sensor).unwrap();
        for rule in [
            Rule::Once,
            Rule::SecondOrder,
            Rule::SigmaPoints(SigmaPoints::cubature()),
        ] {
            for n in [1.0, 2.5, 40.0] {
                let half = random(4, 4, &mut stream) * 3.0;
                let prior = Gaussian {
                    mean: DVector::from_vec(vec![20.0, 15.0, 1.0, -1.0]),
                    cov: &half * half.transpose() + DMatrix::identity(4, 4),
                };
                let view = View::new(&prior, &sensor, None, rule, &noise).unwrap();
                let y = [0.7, -1.3];
                let expected = view.posterior(&prior, &y, n);
                let mut found = prior.clone();
                view.correct_by_root(&prior, &y, n, &mut found).unwrap();
                assert!(!expected.rooted);
                assert!((&found.mean - &expected.state.mean).amax() < 1e-12 * found.mean.amax());
                let error = (&found.cov - &expected.state.cov).amax() / prior.cov.amax();
                assert!(error < 1e-12, "{rule:?} {n}: {error:e}");
            }
        }
    }

    /// Mean and noise of a cell against all its measurements stacked, as the literature writes the update.
    #[test]
    fn a_cell_is_the_stack_of_its_measurements() {
        let mut stream = Stream::new(8, 0);
        for case in 0..200 {
            let (n, m, count) = (4, 1 + case % 3, 1 + case % 6);
            let half = random(n, n, &mut stream);
            let prior = Gaussian {
                mean: random(n, 1, &mut stream).column(0).into_owned(),
                cov: &half * half.transpose() + DMatrix::identity(n, n),
            };
            let (h, half) = (random(m, n, &mut stream), random(m, m, &mut stream));
            let r = &half * half.transpose() + DMatrix::identity(m, m);
            let sensor = LinearSensor::new(h.clone(), r.clone(), DVector::zeros(m)).unwrap();
            let z = random(m, count, &mut stream) * 3.0;

            let stacked_h = DMatrix::from_fn(m * count, n, |i, j| h[(i % m, j)]);
            let stacked_r = DMatrix::from_fn(m * count, m * count, |i, j| {
                if i / m == j / m { r[(i % m, j % m)] } else { 0.0 }
            });
            let s = &stacked_h * &prior.cov * stacked_h.transpose() + stacked_r;
            let innovation = DVector::from_column_slice(z.as_slice()) - &stacked_h * &prior.mean;
            let factor = Cholesky::new(&s, "S").unwrap();
            let log_density = -0.5
                * ((m * count) as f64 * LN_TAU + factor.log_determinant() + factor.whiten(&innovation).norm_squared());
            let gain = factor.solve(&(&stacked_h * &prior.cov)).transpose();
            let mean = &prior.mean + &gain * &innovation;
            let cov = &prior.cov - &gain * &stacked_h * &prior.cov;

            let noise = Noise::of(&sensor).unwrap();
            let view = View::new(&prior, &sensor, None, Rule::Once, &noise).unwrap();
            let average = z.column_mean();
            let (mut scratch, mut y) = (vec![0.0; m], vec![0.0; m]);
            view.offset(&sensor, average.as_slice(), &mut scratch, &mut y);
            let scatter: f64 = z
                .column_iter()
                .map(|z| noise.whiten((z - &average).as_slice()).norm_squared())
                .sum();
            let n_z = count as f64;
            let found = -0.5 * (n_z * noise.log_volume + scatter) + view.log_density(&y, n_z);
            assert!(
                (found - log_density).abs() < 1e-12 * log_density.abs().max(1.0),
                "{found} {log_density}"
            );
            let Posterior { state: posterior, .. } = view.posterior(&prior, &y, n_z);
            assert!((posterior.mean - &mean).amax() < 1e-12 * mean.amax().max(1.0));
            assert!((posterior.cov - &cov).amax() < 1e-12 * prior.cov.amax());
        }
    }
}
