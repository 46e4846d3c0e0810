//! Border densities: how dense it is where two cells touch.
//!
//! | symbol    | name here     | meaning                                                              |
//! |-----------|---------------|----------------------------------------------------------------------|
//! | ρ_bord    | `Border::density` | border density of two cells                                      |
//! | B         | `borders`     | pairs p ∈ C_i, q ∈ C_j with d_pq < d_c                               |
//!
//! ρ_bord = max over B of (ρ_p + ρ_q)/2, or the mean of ρ over the distinct points in B. Cells without B do not touch.
//!
//! Reference: spec 6.6; the maximum is the border density of Rodriguez and Laio 2014, per pair of cells.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use super::density_peaks::DensityPeaks;
use super::index::{Index, square_of_bound};
use crate::error::{Error, Result};

/// Borders that may be kept, per point.
const MAX_BORDERS: usize = 1000;

/// What the density of a border is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum BorderDensity {
    /// The largest mean of the two densities of a pair.
    Maximum,
    /// The mean density of the points in pairs.
    Mean,
}

/// Where two cells touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Border {
    /// The two cells, the lower first.
    pub cells: [usize; 2],
    /// Its density.
    pub density: f64,
}

/// All borders, in the order of their cells.
pub(crate) fn borders(index: &Index<'_>, found: &DensityPeaks, kind: BorderDensity) -> Result<Vec<Border>> {
    let n = index.points.len();
    let radius = square_of_bound(found.d_c);
    // Per pair of cells: largest sum of two densities, or sum of densities and their number.
    let mut sums: BTreeMap<[usize; 2], [f64; 2]> = BTreeMap::new();
    let mut around: Vec<[usize; 2]> = Vec::new();
    for p in 0..n {
        let own = found.labels[p];
        around.clear();
        index.within(index.points.point(p), radius, |q, d2| {
            if d2 < radius && found.labels[q] != own {
                around.push([found.labels[q], q]);
            }
        });
        around.sort_unstable();
        for touching in around.chunk_by(|a, b| a[0] == b[0]) {
            let other = touching[0][0];
            let sum = sums.entry([own.min(other), own.max(other)]).or_default();
            match kind {
                BorderDensity::Mean => *sum = [sum[0] + found.rho[p], sum[1] + 1.0],
                BorderDensity::Maximum => {
                    for &[_, q] in touching {
                        *sum = [sum[0].max(found.rho[p] + found.rho[q]), 2.0];
                    }
                }
            }
        }
        if sums.len() > MAX_BORDERS.saturating_mul(n) {
            return Err(Error::invalid(
                "d_c",
                found.d_c,
                "must be so small, or the peaks so few, that few of the cells touch",
            ));
        }
    }
    let borders = sums.into_iter().map(|(cells, [sum, count])| Border {
        cells,
        density: sum / count,
    });
    Ok(borders.collect())
}
