//! GOSPA: a metric between finite sets of points that counts missed and false targets apart.
//!
//! | symbol | name here | shape | meaning |
//! |--------|-----------|-------|---------|
//! | X, Y   | `truth`, `estimates` | m×d, n×d | points as rows |
//! | c, p   | `cutoff`, `order` | scalar | largest distance that counts, exponent |
//! | α      | `alpha`   | scalar | in (0, 2]; cᵖ/α is the price of one point too many |
//! | γ      | `pairs`   | list  | pairs (i, j) closer than c, no row used twice |
//!
//! 1. For m ≤ n (else swapped): `totalᵖ = min over injections π of Σ_i min(c, d(x_i, y_π(i)))ᵖ + cᵖ/α (n − m)`.
//! 2. γ: the pairs of the best π with d < c. The other pairs of π cost cᵖ each; the target is then missed and
//!    the estimate false, and each is charged half.
//! 3. `totalᵖ = localisation + missed + false_tracks`. For α = 2 this is
//!    `min over γ of Σ_γ dᵖ + cᵖ/2 (m − |γ|) + cᵖ/2 (n − |γ|)`.
//!
//! Reference: A. S. Rahmathullah, A. F. Garcia-Fernandez, L. Svensson, *Generalized optimal sub-pattern assignment
//! metric*, Fusion 2017, Definition 1 for (1) and Proposition 1 for (3). The reference gives parts for α = 2 only.
//! Ellipses: Yang, Baum, Granström (2016), Metrics for performance evaluation of elliptic extended object tracking methods,
//! MFI (Gaussian-Wasserstein distance).

use nalgebra::DMatrix;

use super::near::{Near, distances, matched, near};
use super::ospa::{cutoff_power, power, root};
use crate::error::{Error, Result, all_finite, require_size};
use crate::interrupt::ahead;
use crate::linalg::cholesky::Cholesky;

/// Far beyond what a singular value decomposition of an extent needs.
const MAX_SWEEPS: usize = 1000;

/// A target and an estimate that belong together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Row of the truth.
    pub truth: usize,
    /// Row of the estimates.
    pub estimate: usize,
    /// Their distance, below the cutoff.
    pub distance: f64,
}

/// GOSPA and its parts. The parts are p-th powers, without root: `total`ᵖ = `localisation` + `missed` + `false_tracks`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Gospa {
    /// The metric, in the unit of the points.
    pub total: f64,
    /// p-th powers of the distances of the pairs, summed.
    pub localisation: f64,
    /// p-th power that the missed targets contribute.
    pub missed: f64,
    /// p-th power that the false estimates contribute.
    pub false_tracks: f64,
    /// Pairs closer than the cutoff, in the order of the truth.
    pub pairs: Vec<Pair>,
    /// Targets without a pair.
    pub n_missed: usize,
    /// Estimates without a pair.
    pub n_false: usize,
}

/// The GOSPA distance of the estimates from the truth, given as rows; either may be empty.
pub fn gospa(truth: &DMatrix<f64>, estimates: &DMatrix<f64>, cutoff: f64, order: f64, alpha: f64) -> Result<Gospa> {
    check(cutoff, order, alpha)?;
    let near = near(truth, estimates, cutoff)?;
    score(&near, [truth.nrows(), estimates.nrows()], cutoff, order, alpha)
}

/// The same between ellipses: d² is the squared distance of the centres and that of the extents,
/// `tr (X + Y − 2 (X^½ Y X^½)^½)`, one extent per row, positive definite.
pub fn gospa_of_extents(
    truth: Ellipses<'_>,
    estimates: Ellipses<'_>,
    cutoff: f64,
    order: f64,
    alpha: f64,
) -> Result<Gospa> {
    let mut apart = distances(truth.centres, estimates.centres)?;
    let (m, n) = (truth.centres.nrows(), estimates.centres.nrows());
    require_size("extents of the truth", m, truth.extents.len())?;
    require_size("extents of the estimates", n, estimates.extents.len())?;
    for (i, x) in truth.extents.iter().enumerate() {
        ahead(100 * n);
        for (j, y) in estimates.extents.iter().enumerate() {
            let d = &mut apart[i * n + j];
            *d = (*d * *d + wasserstein_squared(x, y)?).sqrt();
        }
    }
    check(cutoff, order, alpha)?;
    let pairs = apart.iter().enumerate().map(|(at, &distance)| Near {
        row: at / n,
        column: at % n,
        distance,
    });
    let near: Vec<Near> = pairs.filter(|pair| pair.distance < cutoff).collect();
    score(&near, [m, n], cutoff, order, alpha)
}

fn check(cutoff: f64, order: f64, alpha: f64) -> Result<()> {
    cutoff_power(cutoff, order)?;
    if !(alpha > 0.0 && alpha <= 2.0) {
        return Err(Error::invalid("alpha", alpha, "must be above 0 and at most 2"));
    }
    Ok(())
}

/// Centres as rows, and a covariance for each.
#[derive(Debug, Clone, Copy)]
pub struct Ellipses<'a> {
    /// k×d.
    pub centres: &'a DMatrix<f64>,
    /// k matrices.
    pub extents: &'a [DMatrix<f64>],
}

/// `tr (X + Y − 2 (X^½ Y X^½)^½)` as min over rotations U of ‖L − M U‖², X = L Lᵀ, Y = M Mᵀ, which does not cancel where X and Y
/// are almost the same. With Mᵀ L = W Σ Vᵀ the minimum is at U = W Vᵀ.
fn wasserstein_squared(x: &DMatrix<f64>, y: &DMatrix<f64>) -> Result<f64> {
    require_size("extent", x.nrows(), y.nrows())?;
    let (l, m) = (Cholesky::new(x, "extent")?, Cholesky::new(y, "extent")?);
    let overflow = || Error::Overflow {
        what: "distance of extents".into(),
    };
    let product = m.lower().transpose() * l.lower();
    if !all_finite(product.as_slice()) {
        return Err(overflow());
    }
    let svd = product
        .try_svd(true, true, f64::EPSILON, MAX_SWEEPS)
        .ok_or_else(overflow)?;
    let turn = svd.u.ok_or_else(overflow)? * svd.v_t.ok_or_else(overflow)?;
    Ok((l.lower() - m.lower() * turn).norm_squared())
}

fn score(near: &[Near], [m, n]: [usize; 2], cutoff: f64, order: f64, alpha: f64) -> Result<Gospa> {
    let full = cutoff_power(cutoff, order)?;
    let mut out = Gospa::default();
    for pair in matched(near, [m, n], full, order)?.into_iter().flatten() {
        out.localisation += power(pair.distance, order);
        out.pairs.push(Pair {
            truth: pair.row,
            estimate: pair.column,
            distance: pair.distance,
        });
    }
    out.n_missed = m - out.pairs.len();
    out.n_false = n - out.pairs.len();
    let beyond = 0.5 * full * (m.min(n) - out.pairs.len()) as f64;
    let surplus = |count: usize, other: usize| full * (count.saturating_sub(other) as f64 / alpha);
    out.missed = beyond + surplus(m, n);
    out.false_tracks = beyond + surplus(n, m);
    out.total = root(out.localisation + out.missed + out.false_tracks, order);
    if !out.total.is_finite() {
        let what = "GOSPA".into();
        return Err(Error::Overflow { what });
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(points: &[f64]) -> DMatrix<f64> {
        DMatrix::from_column_slice(points.len(), 1, points)
    }

    #[test]
    fn parts_of_a_small_scene() {
        // 0 is held at distance 3, 100 is missed, 40 and 300 are false.
        let score = gospa(&line(&[0.0, 100.0]), &line(&[40.0, 3.0, 300.0]), 20.0, 2.0, 2.0).unwrap();
        assert_eq!(
            score.pairs,
            [Pair {
                truth: 0,
                estimate: 1,
                distance: 3.0
            }]
        );
        assert_eq!((score.n_missed, score.n_false), (1, 2));
        assert_eq!(
            (score.localisation, score.missed, score.false_tracks),
            (9.0, 200.0, 400.0)
        );
        assert_eq!(score.total, 609.0_f64.sqrt());
    }

    #[test]
    fn an_alpha_that_makes_it_infinite_is_refused() {
        let found = gospa(&line(&[0.0]), &line(&[]), 5.0, 2.0, 1e-310);
        assert!(matches!(found, Err(Error::Overflow { .. })));
    }

    #[test]
    fn alpha_prices_the_difference_in_number_only() {
        let (truth, estimates) = (line(&[0.0, 50.0, 90.0]), line(&[1.0]));
        let score = gospa(&truth, &estimates, 10.0, 1.0, 1.0).unwrap();
        assert_eq!((score.localisation, score.missed, score.false_tracks), (1.0, 20.0, 0.0));
        assert!(gospa(&truth, &estimates, 10.0, 1.0, 0.0).is_err());
        assert!(gospa(&truth, &estimates, 10.0, 1.0, 2.5).is_err());
    }

    /// Ellipses of the same axes: the distance is that of the roots of the eigenvalues.
    #[test]
    fn ellipses_differ_in_place_and_size() {
        let (x, y) = (
            DMatrix::from_row_slice(1, 2, &[0.0, 0.0]),
            DMatrix::from_row_slice(1, 2, &[3.0, 0.0]),
        );
        let turn = DMatrix::from_row_slice(2, 2, &[0.8, -0.6, 0.6, 0.8]);
        let ellipse =
            |a: f64, b: f64| &turn * DMatrix::from_row_slice(2, 2, &[a * a, 0.0, 0.0, b * b]) * turn.transpose();
        let (large, small) = ([ellipse(20.0, 7.0)], [ellipse(16.0, 7.0)]);
        let of = |centres, extents| Ellipses { centres, extents };
        let both = gospa_of_extents(of(&x, &large), of(&y, &small), 60.0, 2.0, 2.0).unwrap();
        assert!((both.total - 5.0).abs() < 1e-9, "{}", both.total);
        let back = gospa_of_extents(of(&y, &small), of(&x, &large), 60.0, 2.0, 2.0).unwrap();
        assert!((both.total - back.total).abs() < 1e-9);
        let same = gospa_of_extents(of(&x, &large), of(&y, &large), 60.0, 2.0, 2.0).unwrap();
        assert!((same.total - gospa(&x, &y, 60.0, 2.0, 2.0).unwrap().total).abs() < 1e-6);
        assert!(gospa_of_extents(of(&x, &[]), of(&y, &small), 60.0, 2.0, 2.0).is_err());
        let flat = [DMatrix::zeros(2, 2)];
        assert!(gospa_of_extents(of(&x, &large), of(&y, &flat), 60.0, 2.0, 2.0).is_err());
    }

    #[test]
    fn a_distance_equal_to_the_cutoff_is_no_pair() {
        let score = gospa(&line(&[0.0]), &line(&[10.0]), 10.0, 2.0, 2.0).unwrap();
        assert!(score.pairs.is_empty());
        assert_eq!((score.missed, score.false_tracks, score.total), (50.0, 50.0, 10.0));
    }
}
