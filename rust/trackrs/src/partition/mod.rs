//! Functions of points, and of nothing else: which points are clutter, and how a set of points falls into cells.
//!
//! Everything takes checked [`Points`]. A [`Partitioner`] gives partitions: sets of disjoint cells that cover all points.

pub mod border;
pub mod dbscan;
pub mod density_peaks;
pub mod distance;
pub mod index;
pub mod kmeans;
pub mod lof;
pub mod points;
pub mod poisson_split;
pub mod quantile;
pub mod spanning_tree;
pub mod tree;
pub mod two_level;
pub(crate) mod union;
pub(crate) mod ward;

use std::fmt::Debug;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use dbscan::DbscanPartition;
use density_peaks::DensityPeakPartition;
use distance::DistancePartition;
use kmeans::KMeansPartition;
use lof::LocalOutlierFactor;
pub use points::{Partition, Points};
use tree::TreePartition;
use two_level::TwoLevelPartition;

/// Labels that a call may return in all: partitions times points. More would be gigabytes.
pub const MAX_LABELS: usize = 50_000_000;

/// Something that divides points into cells.
pub trait Partitioner: Debug + Send + Sync {
    /// The partitions of these points; at least one.
    fn partitions(&self, points: &Points) -> Result<Vec<Partition>>;

    /// The label of every point where there is one partition; `None` = clutter.
    fn labels(&self, points: &Points) -> Result<Vec<Option<usize>>>;
}

/// A partitioner held by value, which can be saved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind")]
pub enum PartitionModel {
    /// See [`DistancePartition`].
    Distance(DistancePartition),
    /// See [`KMeansPartition`].
    KMeans(KMeansPartition),
    /// See [`DbscanPartition`].
    Dbscan(DbscanPartition),
    /// See [`DensityPeakPartition`].
    DensityPeaks(DensityPeakPartition),
    /// See [`TwoLevelPartition`].
    TwoLevel(TwoLevelPartition),
    /// See [`TreePartition`].
    Tree(TreePartition),
}

impl PartitionModel {
    /// The partitioner itself.
    pub fn as_partitioner(&self) -> &dyn Partitioner {
        match self {
            Self::Distance(p) => p,
            Self::KMeans(p) => p,
            Self::Dbscan(p) => p,
            Self::DensityPeaks(p) => p,
            Self::TwoLevel(p) => p,
            Self::Tree(p) => p,
        }
    }
}

/// The partitions without the points that `clutter_filter` refuses, each of which becomes a cell of its own.
pub fn partitions(
    partitioner: &dyn Partitioner,
    points: &Points,
    clutter_filter: Option<&LocalOutlierFactor>,
) -> Result<Vec<Partition>> {
    let Some(filter) = clutter_filter else {
        return partitioner.partitions(points);
    };
    let kept = filter.inliers(points)?;
    if kept.len() == points.len() {
        return partitioner.partitions(points);
    }
    let inner = partitioner.partitions(&points.select(&kept))?;
    Ok(inner
        .iter()
        .map(|partition| partition.embedded(&kept, points.len()))
        .collect())
}

/// Labels of one partition as options, none of them clutter.
pub(crate) fn all_labelled(labels: &[usize]) -> Vec<Option<usize>> {
    labels.iter().copied().map(Some).collect()
}

/// `Ok` if this many partitions of this many points fit into [`MAX_LABELS`]; `remedy` says what would make them fewer.
pub(crate) fn require_few(count: usize, points: usize, remedy: &str) -> Result<()> {
    if count.saturating_mul(points) <= MAX_LABELS {
        return Ok(());
    }
    Err(Error::invalid(
        "partitions",
        format_args!("{count} of {points} points"),
        remedy,
    ))
}
