//! Squared Mahalanobis distances of many tracks and many reports whose components add: all of them, or those inside a gate.
//!
//! | symbol   | name here   | shape    | meaning                                             |
//! |----------|-------------|----------|-----------------------------------------------------|
//! | ẑ_i, S_i | `Expected`  | m, m×m   | what track i expects of the sensor                  |
//! | W_i      | `lower`     | m×m      | L⁻¹ of S_i = L Lᵀ                                   |
//! | z_j      | `reports`   | m        | report j                                            |
//! | γ        | `threshold` |          | the gate holds d² ≤ γ                               |
//!
//! 1. W_i once per track, then d²_ij = |W_i (z_j − ẑ_i)|² (`lanes::distances`).
//! 2. Inside a gate: the reports stand in the order of the component in which they spread most, measured in gates. Track i looks
//!    at those with |z_j − ẑ_i| ≤ √(γ S_i) in that component, found by bisection: no other can be inside.
//!
//! Reference: Bar-Shalom, Li (1995), Multitarget-Multisensor Tracking, §1.4.2.

use super::sweep::reach;
use crate::error::{Error, Result, require_finite, require_size};
use crate::lanes::Level;
use crate::lanes::distances::{Whitening, squared_lengths};
use crate::linalg::kernel;

/// What tracks expect of a sensor: means of length m one after the other, and covariances m×m.
#[derive(Debug, Clone, Copy)]
pub struct Expected<'a> {
    /// m.
    pub dims: usize,
    /// T×m.
    pub means: &'a [f64],
    /// T×m×m, symmetric; the lower halves are read.
    pub covs: &'a [f64],
}

/// The pairs inside the gates: track by track, in the order of the reports.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pairs {
    /// Index of the track.
    pub tracks: Vec<usize>,
    /// Index of the report.
    pub reports: Vec<usize>,
    /// d².
    pub distances: Vec<f64>,
}

/// A track and its W.
struct Whitened {
    tracks: usize,
    lower: Vec<f64>,
}

impl Expected<'_> {
    fn whitened(&self, reports: &[f64]) -> Result<Whitened> {
        let m = self.dims;
        if m == 0 {
            return Err(Error::invalid("dims", 0, "must be at least 1"));
        }
        let tracks = self.means.len() / m;
        require_size("means", tracks * m, self.means.len())?;
        require_size("covs", tracks * m * m, self.covs.len())?;
        require_size("reports", reports.len() / m * m, reports.len())?;
        require_finite("means", self.means)?;
        let mut lower = vec![0.0; tracks * m * m];
        let mut factor = vec![0.0; m * m];
        for (track, (out, cov)) in lower
            .chunks_exact_mut(m * m)
            .zip(self.covs.chunks_exact(m * m))
            .enumerate()
        {
            factor.copy_from_slice(cov);
            kernel::cholesky(m, &mut factor).map_err(|pivot| Error::NotPositiveDefinite {
                what: format!("covariance of track {track}"),
                pivot: pivot.index,
                value: pivot.value,
            })?;
            (0..m).for_each(|i| out[i * m + i] = 1.0);
            kernel::solve_lower::<0>(m, m, &factor, out);
        }
        Ok(Whitened { tracks, lower })
    }
}

/// Reports component by component.
fn columns(m: usize, reports: &[f64], order: &[usize]) -> Vec<Vec<f64>> {
    (0..m)
        .map(|k| order.iter().map(|&j| reports[j * m + k]).collect())
        .collect()
}

/// Writes d² of every track and report, T×M; a report with a NaN has NaN.
pub fn squared_distances(expected: &Expected<'_>, reports: &[f64], out: &mut [f64]) -> Result<()> {
    let m = expected.dims;
    let whitened = expected.whitened(reports)?;
    let count = reports.len() / m;
    require_size("distances", whitened.tracks * count, out.len())?;
    let columns = columns(m, reports, &(0..count).collect::<Vec<_>>());
    let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let arch = Level::chosen_arch()?;
    let parts = expected.means.chunks_exact(m).zip(whitened.lower.chunks_exact(m * m));
    for ((center, lower), out) in parts.zip(out.chunks_exact_mut(count.max(1))) {
        squared_lengths(arch, Whitening { center, lower }, &columns, out);
    }
    Ok(())
}

/// The pairs with d² ≤ γ; a report with a NaN is in none.
pub fn pairs_within(expected: &Expected<'_>, reports: &[f64], threshold: f64) -> Result<Pairs> {
    let m = expected.dims;
    let whitened = expected.whitened(reports)?;
    if threshold.is_nan() {
        return Err(Error::invalid("threshold", threshold, "must be a number"));
    }
    let count = reports.len() / m;
    let width = |cov: &[f64], k: usize| (threshold.max(0.0) * cov[k * m + k]).sqrt();
    let sweep = widest(expected, reports, &width);
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_unstable_by(|&a, &b| reports[a * m + sweep].total_cmp(&reports[b * m + sweep]));
    let sorted = columns(m, reports, &order);
    let keys = &sorted[sweep];
    let arch = Level::chosen_arch()?;
    let mut out = Pairs::default();
    let mut found: Vec<(usize, f64)> = Vec::new();
    let mut distances = vec![0.0; count];
    let mut window: Vec<&[f64]> = Vec::with_capacity(m);
    let covs = expected.covs.chunks_exact(m * m);
    let parts = expected.means.chunks_exact(m).zip(whitened.lower.chunks_exact(m * m));
    for (track, ((center, lower), cov)) in parts.zip(covs).enumerate() {
        let (low, high) = reach(center[sweep], width(cov, sweep)).into_inner();
        let from = keys.partition_point(|&key| key < low);
        let to = from + keys[from..].partition_point(|&key| key <= high);
        let distances = &mut distances[..to - from];
        window.clear();
        window.extend(sorted.iter().map(|column| &column[from..to]));
        squared_lengths(arch, Whitening { center, lower }, &window, distances);
        found.clear();
        let inside = distances.iter().zip(&order[from..]).filter(|(d, _)| **d <= threshold);
        found.extend(inside.map(|(&d, &report)| (report, d)));
        found.sort_unstable_by_key(|&(report, _)| report);
        out.tracks.resize(out.tracks.len() + found.len(), track);
        out.reports.extend(found.iter().map(|pair| pair.0));
        out.distances.extend(found.iter().map(|pair| pair.1));
    }
    Ok(out)
}

/// The component in which the reports spread most, measured in gates.
fn widest(expected: &Expected<'_>, reports: &[f64], width: &dyn Fn(&[f64], usize) -> f64) -> usize {
    let m = expected.dims;
    let gates = |k: usize| {
        let values = reports
            .chunks_exact(m)
            .map(|report| report[k])
            .filter(|v| v.is_finite());
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (v.min(low), v.max(high))
        });
        let widths: f64 = expected.covs.chunks_exact(m * m).map(|cov| width(cov, k)).sum();
        (high - low) / widths
    };
    (0..m).max_by(|&a, &b| gates(a).total_cmp(&gates(b))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::cholesky::Cholesky;
    use crate::stats::stream::Stream;
    use nalgebra::{DMatrix, DVector};

    struct Scene {
        means: Vec<f64>,
        covs: Vec<f64>,
        reports: Vec<f64>,
    }

    fn scene(m: usize, tracks: usize, reports: usize, side: f64) -> Scene {
        let mut stream = Stream::new(5, m as u64);
        let mut uniform = |n: usize| -> Vec<f64> { (0..n).map(|_| stream.between(0.0, side)).collect() };
        let (means, reports) = (uniform(tracks * m), uniform(reports * m));
        let mut covs = Vec::new();
        for _ in 0..tracks {
            let a = DMatrix::from_fn(m, m, |_, _| stream.normal());
            covs.extend_from_slice((&a * a.transpose() * 0.3 + DMatrix::identity(m, m)).as_slice());
        }
        Scene { means, covs, reports }
    }

    #[test]
    fn distances_are_those_of_the_definition_and_gates_hold_what_is_near() {
        for m in 1..=5 {
            let Scene {
                means,
                covs,
                mut reports,
            } = scene(m, 30, 90, 12.0);
            reports[7 * m] = f64::NAN;
            reports[8 * m] = f64::INFINITY;
            let expected = Expected {
                dims: m,
                means: &means,
                covs: &covs,
            };
            let mut all = vec![0.0; 30 * 90];
            squared_distances(&expected, &reports, &mut all).unwrap();
            for (i, row) in all.chunks_exact(90).enumerate() {
                let cov = DMatrix::from_column_slice(m, m, &covs[i * m * m..(i + 1) * m * m]);
                let factor = Cholesky::new(&cov, "cov").unwrap();
                for (j, &d) in row.iter().enumerate() {
                    let difference = DVector::from_fn(m, |k, _| reports[j * m + k] - means[i * m + k]);
                    let whitened = factor.whiten(&difference);
                    let direct = whitened.norm_squared();
                    assert!((d - direct).abs() <= 1e-12 * direct || !direct.is_finite() && !d.is_finite());
                }
            }
            for threshold in [0.0, 3.0, 9.0, f64::INFINITY] {
                let pairs = pairs_within(&expected, &reports, threshold).unwrap();
                let near: Vec<usize> = (0..all.len()).filter(|&i| all[i] <= threshold).collect();
                let found: Vec<usize> = pairs
                    .tracks
                    .iter()
                    .zip(&pairs.reports)
                    .map(|(t, r)| t * 90 + r)
                    .collect();
                assert_eq!(found, near);
                assert!(found.iter().zip(&pairs.distances).all(|(&i, d)| all[i] == *d));
            }
        }
    }

    #[test]
    fn nothing_and_nonsense() {
        let expected = |means: &'static [f64], covs: &'static [f64]| Expected { dims: 1, means, covs };
        assert_eq!(pairs_within(&expected(&[], &[]), &[1.0], 9.0), Ok(Pairs::default()));
        assert_eq!(pairs_within(&expected(&[1.0], &[1.0]), &[], 9.0), Ok(Pairs::default()));
        let bad = pairs_within(&expected(&[1.0, 2.0], &[1.0, -1.0]), &[1.0], 9.0).unwrap_err();
        assert!(bad.to_string().contains("covariance of track 1"), "{bad}");
        assert!(pairs_within(&expected(&[f64::NAN], &[1.0]), &[1.0], 9.0).is_err());
        assert!(pairs_within(&expected(&[1.0], &[1.0]), &[1.0], f64::NAN).is_err());
        assert!(squared_distances(&expected(&[1.0], &[1.0]), &[1.0], &mut []).is_err());
    }
}
