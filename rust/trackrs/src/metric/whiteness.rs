//! Whiteness of innovations: are those of different epochs uncorrelated, as they are if filter and model are right?
//!
//! | symbol   | name here          | shape | meaning                                                       |
//! |----------|--------------------|-------|---------------------------------------------------------------|
//! | r_t, S_t | `innovations`, `covs` | m, m×m | innovations and their claimed covariances; NaN = not observed |
//! | e_t      | `whitened`         | m     | L⁻¹ r over the observed components, S = L Lᵀ                  |
//! | n_i, v_i |                    |       | number and mean square of the e_ti there are                  |
//! | N_ij(k)  | `pairs`            |       | epochs t at which e_ti and e_(t−k)j both are                  |
//! | ρ_ij(k)  |                    |       | correlation of component i with j, k epochs before            |
//! | h        | `lags`             |       | largest k                                                     |
//!
//! ρ_ij(k) = Σ_t e_ti e_(t−k)j / (N_ij(k) √(v_i v_j)),  about N(0, 1/N_ij(k))
//! band: ±z_0.975/√N_ii(k);   Q = Σ_k Σ_ij a_ij N_ij(k) ρ_ij(k)²,  a_ii = 1 + 2/n_i,  a_ij = 1:  chi-square, about h m² degrees
//!
//! For one component without gaps Q is the statistic of Ljung and Box, n(n+2) Σ r²/(n−k); for several it is Hosking's with
//! the factor 1 + 2/n where it makes the expectation exact, and with the components of one epoch uncorrelated, as the
//! covariances claim. Gaps leave out their pairs and nothing else. Variances come from the data, so that Q is about time
//! alone; whether they are what the covariances say is for the NIS. The mean is not removed: it is zero, and a bias is a
//! correlation at every lag.
//!
//! References: Ljung, Box (1978), On a measure of lack of fit in time series models; Hosking (1980), The multivariate
//! portmanteau statistic; Stoffer, Toloi (1992) for gaps; Mehra (1970) for innovations.

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result, require_size};
use crate::linalg::cholesky::Cholesky;
use crate::stats::chi_square;

/// Half width of the band of probability 0.95 of a standard normal variable.
const BAND: f64 = 1.959_963_984_540_054;

/// Correlations of innovations over time, and the test that all are zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Whiteness {
    /// Element (k−1, i): correlation of component i with itself k epochs before, h×m; NaN without pairs.
    pub autocorrelations: DMatrix<f64>,
    /// Half width of the band about zero that holds each of them with probability 0.95 if the innovations are white, h×m.
    pub bands: DMatrix<f64>,
    /// Portmanteau statistic of all components and lags.
    pub statistic: f64,
    /// Its degrees of freedom.
    pub dof: usize,
    /// Probability of a larger statistic if the innovations are white; NaN without any pair.
    pub p_value: f64,
}

/// Tests T innovations of length m, in the order of time. NaN = component not observed.
pub fn whiteness(innovations: &[DVector<f64>], covs: &[DMatrix<f64>], lags: usize) -> Result<Whiteness> {
    require_size("covariances", innovations.len(), covs.len())?;
    if lags == 0 {
        return Err(Error::invalid("lags", 0, "must be at least 1"));
    }
    if lags >= innovations.len() {
        let requirement = format!("must be below the number of innovations, {}", innovations.len());
        return Err(Error::invalid("lags", lags, &requirement));
    }
    let m = innovations[0].len();
    let mut whitened = Vec::with_capacity(innovations.len());
    for (row, (innovation, cov)) in innovations.iter().zip(covs).enumerate() {
        require_size(&format!("innovation {row}"), m, innovation.len())?;
        whitened.push(whiten(row, innovation, cov)?);
    }
    let count = |i: usize| whitened.iter().filter(|e| !e[i].is_nan()).count() as f64;
    let counts: Vec<f64> = (0..m).map(count).collect();
    let mean_square = |i: usize| {
        let squares = whitened.iter().map(|e| e[i] * e[i]).filter(|s| !s.is_nan());
        squares.sum::<f64>() / counts[i]
    };
    let scales: Vec<f64> = (0..m).map(|i| mean_square(i).sqrt()).collect();
    let mut out = Whiteness {
        autocorrelations: DMatrix::from_element(lags, m, f64::NAN),
        bands: DMatrix::from_element(lags, m, f64::NAN),
        statistic: 0.0,
        dof: 0,
        p_value: f64::NAN,
    };
    for lag in 1..=lags {
        let lagged = Lagged::new(&whitened, lag, m);
        for i in 0..m {
            for j in 0..m {
                let pairs = lagged.pairs[(i, j)];
                let scale = scales[i] * scales[j];
                if pairs == 0.0 || scale == 0.0 {
                    continue;
                }
                let rho = lagged.sums[(i, j)] / (pairs * scale);
                let exact = if i == j { 1.0 + 2.0 / counts[i] } else { 1.0 };
                out.statistic += exact * pairs * rho * rho;
                out.dof += 1;
                if i == j {
                    out.autocorrelations[(lag - 1, i)] = rho;
                    out.bands[(lag - 1, i)] = BAND / pairs.sqrt();
                }
            }
        }
    }
    if out.dof > 0 {
        out.p_value = chi_square::survival(out.statistic, out.dof);
    }
    Ok(out)
}

/// L⁻¹ r over the observed components.
fn whiten(row: usize, innovation: &DVector<f64>, cov: &DMatrix<f64>) -> Result<DVector<f64>> {
    let m = innovation.len();
    let what = format!("covariance {row}");
    require_size(&what, m, cov.nrows())?;
    require_size(&what, m, cov.ncols())?;
    if let Some(index) = innovation.iter().position(|r| r.is_infinite()) {
        let what = format!("innovation {row}");
        return Err(Error::NonFinite { what, index });
    }
    let observed: Vec<usize> = (0..m).filter(|&i| !innovation[i].is_nan()).collect();
    let part = cov.select_rows(&observed).select_columns(&observed);
    let white = Cholesky::new(&part, &what)?.whiten(&innovation.select_rows(&observed));
    let mut out = DVector::from_element(m, f64::NAN);
    for (slot, &i) in observed.iter().enumerate() {
        out[i] = white[slot];
    }
    Ok(out)
}

/// Sums over all pairs of epochs `lag` apart, m×m.
struct Lagged {
    sums: DMatrix<f64>,
    pairs: DMatrix<f64>,
}

impl Lagged {
    fn new(whitened: &[DVector<f64>], lag: usize, m: usize) -> Self {
        let mut out = Self {
            sums: DMatrix::zeros(m, m),
            pairs: DMatrix::zeros(m, m),
        };
        for (before, now) in whitened.iter().zip(whitened.iter().skip(lag)) {
            for j in 0..m {
                for i in 0..m {
                    let product = now[i] * before[j];
                    if !product.is_nan() {
                        out.sums[(i, j)] += product;
                        out.pairs[(i, j)] += 1.0;
                    }
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn rows(values: &[f64]) -> Vec<DVector<f64>> {
        values.iter().map(|&v| DVector::from_element(1, v)).collect()
    }

    #[test]
    fn one_component_is_the_test_of_ljung_and_box() {
        let values: Vec<f64> = (0..30).map(|k| f64::from(k * k % 17) - 8.0).collect();
        let n = values.len() as f64;
        let total: f64 = values.iter().map(|v| v * v).sum();
        let q: f64 = (1..=5)
            .map(|k| {
                let r: f64 = values.windows(k + 1).map(|w| w[0] * w[k]).sum::<f64>() / total;
                n * (n + 2.0) * r * r / (n - k as f64)
            })
            .sum();
        // The scale of the claimed covariances does not matter.
        let out = whiteness(&rows(&values), &vec![DMatrix::from_element(1, 1, 9.0); 30], 5).unwrap();
        assert_relative_eq!(out.statistic, q, max_relative = 1e-12);
        assert_eq!(out.dof, 5);
        assert_relative_eq!(out.bands[(4, 0)], 1.96 / 25.0_f64.sqrt(), max_relative = 1e-4);
    }

    #[test]
    fn gaps_leave_out_their_pairs() {
        let mut values: Vec<f64> = (0..20).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
        values[5] = f64::NAN;
        let out = whiteness(&rows(&values), &vec![DMatrix::identity(1, 1); 20], 2).unwrap();
        assert_relative_eq!(out.autocorrelations[(0, 0)], -1.0, max_relative = 1e-12);
        assert_relative_eq!(out.autocorrelations[(1, 0)], 1.0, max_relative = 1e-12);
        assert_relative_eq!(out.bands[(0, 0)], BAND / 17.0_f64.sqrt(), max_relative = 1e-12);
        let silent = whiteness(&rows(&[f64::NAN; 9]), &vec![DMatrix::identity(1, 1); 9], 2).unwrap();
        assert_eq!(silent.dof, 0);
        assert!(silent.p_value.is_nan());
    }

    #[test]
    fn faults_are_named() {
        let unit = vec![DMatrix::identity(1, 1); 3];
        for (lags, values, covs, name) in [
            (0, [1.0, 2.0, 3.0], &unit, "lags"),
            (3, [1.0, 2.0, 3.0], &unit, "lags"),
            (1, [1.0, f64::INFINITY, 3.0], &unit, "innovation 1"),
            (
                1,
                [1.0, 2.0, 3.0],
                &vec![DMatrix::from_element(1, 1, 0.0); 3],
                "covariance 0",
            ),
        ] {
            let error = whiteness(&rows(&values), covs, lags).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
