//! Two-level clustering: cells of density peaks, joined where their border is as dense as one of them.
//!
//! | symbol  | name here      | shape | meaning                                             |
//! |---------|----------------|-------|-----------------------------------------------------|
//! | ρ_ave   | `mean_density` | K     | mean density of the points of a cell                |
//! | ρ_bord  | `borders`      |       | density of the border of two cells ([`super::border`]) |
//! | β       | `beta`         |       | share of the mean density that a border must reach  |
//!
//! 1. Cells by density peaks.
//! 2. Two cells are one if ρ_bord ≥ β ρ_ave of either. All tests use densities of the first level, and joining is
//!    transitive, so that the order of the tests does not matter.
//!
//! Reference: the merging criterion of the extended-target paper; spec 6.6. The border density is a reconstruction.

use super::border::{Border, BorderDensity, borders};
use super::density_peaks::{DensityPeakPartition, DensityPeaks, Kernel, Peaks, Scale};
use super::index::Index;
use super::points::{Partition, Points};
use super::union::Union;
use super::{Partitioner, all_labelled};
use crate::error::{Result, require_positive};
use serde::{Deserialize, Serialize};

/// Density peaks and merging.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TwoLevelPartition {
    /// The first level.
    pub first: DensityPeakPartition,
    /// What the density of a border is.
    pub border: BorderDensity,
    /// β.
    pub beta: f64,
}

impl Default for TwoLevelPartition {
    fn default() -> Self {
        Self {
            first: DensityPeakPartition::default(),
            border: BorderDensity::Maximum,
            beta: 1.0,
        }
    }
}

/// Both levels.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoLevel {
    /// The first level.
    pub first: DensityPeaks,
    /// Mean density of every cell of the first level.
    pub mean_density: Vec<f64>,
    /// Where cells of the first level touch.
    pub borders: Vec<Border>,
    /// The joined cell of every point, numbered in the order of the first level.
    pub labels: Vec<usize>,
    /// How many joined cells there are.
    pub cells: usize,
}

impl TwoLevelPartition {
    /// The chain as the paper prints it: d_c by the rule of 2 %, as many peaks as stand before the largest gap.
    #[must_use]
    pub fn as_printed() -> Self {
        Self {
            first: DensityPeakPartition {
                scale: Scale::Percent(2.0),
                kernel: Kernel::Gaussian,
                peaks: Peaks::Gap,
                max_link: None,
            },
            ..Self::default()
        }
    }

    /// Every step of both levels.
    pub fn explain(&self, points: &Points) -> Result<TwoLevel> {
        require_positive("beta", self.beta)?;
        let index = Index::new(points);
        let first = self.first.explain_indexed(&index)?;
        let mean_density = mean_densities(&first);
        let borders = borders(&index, &first, self.border)?;
        let mut cells = Union::new(first.cells);
        for border in &borders {
            let [a, b] = border.cells;
            if border.density >= self.beta * mean_density[a].min(mean_density[b]) {
                cells.join(a, b);
            }
        }
        // A joined cell is named by its first one, so that numbering these names keeps the order of the first level.
        let joined = Partition::from_labels(&cells.names(), first.cells);
        Ok(TwoLevel {
            labels: first.labels.iter().map(|&label| joined.labels()[label]).collect(),
            cells: joined.len(),
            first,
            mean_density,
            borders,
        })
    }
}

impl Partitioner for TwoLevelPartition {
    fn partitions(&self, points: &Points) -> Result<Vec<Partition>> {
        let found = self.explain(points)?;
        Ok(vec![Partition::from_labels(&found.labels, found.cells)])
    }

    fn labels(&self, points: &Points) -> Result<Vec<Option<usize>>> {
        Ok(all_labelled(&self.explain(points)?.labels))
    }
}

fn mean_densities(found: &DensityPeaks) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); found.cells];
    for (&label, &rho) in found.labels.iter().zip(&found.rho) {
        sums[label] = (sums[label].0 + rho, sums[label].1 + 1.0);
    }
    sums.iter().map(|(sum, count)| sum / count).collect()
}
