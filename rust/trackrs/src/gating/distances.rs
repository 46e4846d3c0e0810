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
//! 2. Inside a gate: the reports stand in the cells of a grid over the two components in which they spread most. Track i looks
//!    at the cells that its box |z_j − ẑ_i| ≤ √(γ S_i) touches there (`grid.rs`): no other report can be inside.
//!
//! Reference: Bar-Shalom, Li (1995), Multitarget-Multisensor Tracking, §1.4.2.

use super::grid::Grid;
use crate::error::{Error, Result, require_finite, require_size};
use crate::lanes::Level;
use crate::lanes::distances::{LANES, Whitening, squared_length, squared_lengths, within};
use crate::linalg::kernel::{self, BadPivot};

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

/// Calls what is compiled for m components, else what serves any number.
macro_rules! of_size {
    ($fixed:ident, $any:ident, $expected:expr $(, $argument:expr)*) => {
        match $expected.dims {
            1 => $fixed::<1>($expected $(, $argument)*),
            2 => $fixed::<2>($expected $(, $argument)*),
            3 => $fixed::<3>($expected $(, $argument)*),
            4 => $fixed::<4>($expected $(, $argument)*),
            6 => $fixed::<6>($expected $(, $argument)*),
            _ => $any($expected $(, $argument)*),
        }
    };
}

/// Writes d² of every track and report, T×M; a report with a NaN has NaN.
pub fn squared_distances(expected: &Expected<'_>, reports: &[f64], out: &mut [f64]) -> Result<()> {
    expected.check(reports)?;
    let tracks = expected.means.len() / expected.dims;
    require_size("distances", tracks * (reports.len() / expected.dims), out.len())?;
    of_size!(all, all_of_any, expected, reports, out)
}

/// The pairs with d² ≤ γ; a report with a NaN is in none.
pub fn pairs_within(expected: &Expected<'_>, reports: &[f64], threshold: f64) -> Result<Pairs> {
    expected.check(reports)?;
    if threshold.is_nan() {
        return Err(Error::invalid("threshold", threshold, "must be a number"));
    }
    of_size!(inside, inside_of_any, expected, reports, threshold)
}

fn all<const M: usize>(expected: &Expected<'_>, reports: &[f64], out: &mut [f64]) -> Result<()> {
    let whitenings = whitenings::<M>(expected)?;
    let reports = reports.as_chunks::<M>().0;
    let mut blocks = vec![[[f64::NAN; LANES]; M]; reports.len().div_ceil(LANES)];
    for (block, reports) in blocks.iter_mut().zip(reports.chunks(LANES)) {
        for (lane, report) in reports.iter().enumerate() {
            for (row, &value) in block.iter_mut().zip(report) {
                row[lane] = value;
            }
        }
    }
    squared_lengths(Level::chosen_arch()?, &whitenings, &blocks, reports.len(), out);
    Ok(())
}

fn all_of_any(expected: &Expected<'_>, reports: &[f64], out: &mut [f64]) -> Result<()> {
    let m = expected.dims;
    let lower = lowers(expected)?;
    let tracks = expected.means.chunks_exact(m).zip(lower.chunks_exact(m * m));
    for ((center, lower), out) in tracks.zip(out.chunks_exact_mut((reports.len() / m).max(1))) {
        for (report, out) in reports.chunks_exact(m).zip(out) {
            *out = squared_length(center, lower, |k| report[k]);
        }
    }
    Ok(())
}

fn inside<const M: usize>(expected: &Expected<'_>, reports: &[f64], threshold: f64) -> Result<Pairs> {
    let whitenings = whitenings::<M>(expected)?;
    let grid = Grid::new(expected, reports, threshold, LANES);
    let columns: [&[f64]; M] = std::array::from_fn(|k| &grid.columns[k][..]);
    let arch = Level::chosen_arch()?;
    Ok(gather(expected, &grid, |track, windows, found| {
        within(
            arch,
            &whitenings[track],
            &columns,
            &grid.order,
            windows,
            threshold,
            found,
        )
    }))
}

fn inside_of_any(expected: &Expected<'_>, reports: &[f64], threshold: f64) -> Result<Pairs> {
    let m = expected.dims;
    let lower = lowers(expected)?;
    let grid = Grid::new(expected, reports, threshold, LANES);
    Ok(gather(expected, &grid, |track, windows, found| {
        let (center, lower) = (&expected.means[track * m..][..m], &lower[track * m * m..][..m * m]);
        let mut count = 0;
        for at in windows.iter().flat_map(|&(from, to)| from..to) {
            let d = squared_length(center, lower, |k| grid.columns[k][at]);
            if d <= threshold {
                found[count] = (grid.order[at], d);
                count += 1;
            }
        }
        count
    }))
}

/// The pairs that `look` finds in the windows of each track.
#[inline(always)]
fn gather(
    expected: &Expected<'_>,
    grid: &Grid,
    mut look: impl FnMut(usize, &[(usize, usize)], &mut [(usize, f64)]) -> usize,
) -> Pairs {
    let mut out = Pairs::default();
    let mut found = vec![(0, 0.0); grid.order.len()];
    let mut windows = Vec::new();
    for (track, patch) in grid.patches(expected).iter().enumerate() {
        grid.windows(patch, &mut windows);
        let count = look(track, &windows, &mut found);
        let inside = &mut found[..count];
        inside.sort_unstable_by_key(|&(report, _)| report);
        out.tracks.resize(out.tracks.len() + count, track);
        out.reports.extend(inside.iter().map(|pair| pair.0));
        out.distances.extend(inside.iter().map(|pair| pair.1));
    }
    out
}

impl Expected<'_> {
    fn check(&self, reports: &[f64]) -> Result<()> {
        let m = self.dims;
        if m == 0 {
            return Err(Error::invalid("dims", 0, "must be at least 1"));
        }
        let tracks = self.means.len() / m;
        require_size("means", tracks * m, self.means.len())?;
        require_size("covs", tracks * m * m, self.covs.len())?;
        require_size("reports", reports.len() / m * m, reports.len())?;
        require_finite("means", self.means)
    }
}

fn whitenings<const M: usize>(expected: &Expected<'_>) -> Result<Vec<Whitening<M>>> {
    let means = expected.means.as_chunks::<M>().0;
    let mut out = Vec::with_capacity(means.len());
    for (&center, cov) in means.iter().zip(expected.covs.as_chunks::<M>().0.as_chunks::<M>().0) {
        let (mut factor, mut lower) = (*cov, [[0.0; M]; M]);
        whiten::<M>(M, factor.as_flattened_mut(), lower.as_flattened_mut())
            .map_err(|pivot| refusal(out.len(), pivot))?;
        out.push(Whitening { center, lower });
    }
    Ok(out)
}

/// W of every track, T×m×m.
fn lowers(expected: &Expected<'_>) -> Result<Vec<f64>> {
    let m = expected.dims;
    let (mut out, mut factor) = (vec![0.0; expected.covs.len()], vec![0.0; m * m]);
    let tracks = out.chunks_exact_mut(m * m).zip(expected.covs.chunks_exact(m * m));
    for (track, (lower, cov)) in tracks.enumerate() {
        factor.copy_from_slice(cov);
        whiten::<0>(m, &mut factor, lower).map_err(|pivot| refusal(track, pivot))?;
    }
    Ok(out)
}

/// W from zeros; the covariance becomes its factor. M is m where that is a constant, else 0.
#[inline(always)]
fn whiten<const M: usize>(m: usize, cov: &mut [f64], lower: &mut [f64]) -> std::result::Result<(), BadPivot> {
    kernel::cholesky(m, cov)?;
    for i in 0..m {
        lower[i * m + i] = 1.0;
    }
    kernel::solve_lower::<M>(m, m, cov, lower);
    Ok(())
}

#[cold]
fn refusal(track: usize, pivot: BadPivot) -> Error {
    Error::NotPositiveDefinite {
        what: format!("covariance of track {track}"),
        pivot: pivot.index,
        value: pivot.value,
    }
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
        for m in 1..=7 {
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
    fn heaps_far_from_one_another_and_strays_lose_no_pair() {
        for m in [1, 2, 3, 5] {
            let Scene {
                mut means,
                covs,
                mut reports,
            } = scene(m, 60, 600, 20.0);
            let move_some = |values: &mut [f64]| {
                for (i, value) in values.chunks_exact_mut(m).enumerate() {
                    let far = [0.0, 3e6, -7e9][i % 3];
                    for value in value {
                        *value += far;
                    }
                }
            };
            move_some(&mut means);
            move_some(&mut reports);
            reports[5 * m..6 * m].fill(1e300);
            reports[11 * m..12 * m].fill(f64::NEG_INFINITY);
            reports[17 * m] = f64::NAN;
            let expected = Expected {
                dims: m,
                means: &means,
                covs: &covs,
            };
            let mut all = vec![0.0; 60 * 600];
            squared_distances(&expected, &reports, &mut all).unwrap();
            let pairs = pairs_within(&expected, &reports, 9.0).unwrap();
            let near: Vec<usize> = (0..all.len()).filter(|&i| all[i] <= 9.0).collect();
            let found = pairs.tracks.iter().zip(&pairs.reports);
            assert_eq!(found.map(|(t, r)| t * 600 + r).collect::<Vec<_>>(), near);
            assert!(!near.is_empty());
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
