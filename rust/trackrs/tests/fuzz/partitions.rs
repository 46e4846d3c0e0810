use trackrs::partition::dbscan::DbscanPartition;
use trackrs::partition::density_peaks::{DensityPeakPartition, Kernel, Peaks, Scale};
use trackrs::partition::distance::{DistancePartition, SubPartitions, Thresholds};
use trackrs::partition::kmeans::KMeansPartition;
use trackrs::partition::lof::LocalOutlierFactor;
use trackrs::partition::spanning_tree::spanning_tree;
use trackrs::partition::tree::TreePartition;
use trackrs::partition::two_level::TwoLevelPartition;
use trackrs::partition::{Partitioner, Points, partitions as partitions_of};

use super::Source;
use super::source::finite;

fn points(source: &mut Source<'_>) -> Option<Points> {
    let (count, dims) = (source.below(20), 1 + source.below(3));
    let mut values = source.numbers(count * dims);
    if source.below(4) == 0 {
        // Points that coincide.
        for at in dims..values.len() {
            if source.coin() {
                values[at] = values[at - dims];
            }
        }
    }
    if source.coin() {
        let noise = source.covariance(dims);
        Points::whitened(&values, dims, &noise).ok()
    } else {
        Points::new(&values, dims).ok()
    }
}

fn density_peaks(source: &mut Source<'_>) -> DensityPeakPartition {
    DensityPeakPartition {
        scale: match source.below(3) {
            0 => Scale::Length(source.positive()),
            1 => Scale::Percent(100.0 * source.share()),
            _ => Scale::Deviation,
        },
        kernel: if source.coin() {
            Kernel::Cutoff
        } else {
            Kernel::Gaussian
        },
        peaks: match source.below(3) {
            0 => Peaks::Count(source.below(6)),
            1 => Peaks::Gap,
            _ => Peaks::Distance(source.positive()),
        },
        max_link: source.coin().then(|| source.positive()),
    }
}

fn partitioner(source: &mut Source<'_>) -> Box<dyn Partitioner> {
    match source.below(6) {
        0 => Box::new(DistancePartition {
            thresholds: match source.below(3) {
                0 => Thresholds::Literature,
                1 => Thresholds::Difference,
                _ => Thresholds::Range {
                    lower: source.positive(),
                    upper: source.positive(),
                },
            },
            probabilities: [source.share(), source.share()],
            sub_partitions: source.coin().then(|| SubPartitions {
                detections_per_target: source.positive(),
                seed: 1,
            }),
        }),
        1 => Box::new(KMeansPartition {
            lower: source.below(5),
            upper: source.below(9),
            seed: 7,
        }),
        2 => Box::new(DbscanPartition {
            eps: source.coin().then(|| source.positive()),
            min_samples: source.below(6),
        }),
        3 => Box::new(density_peaks(source)),
        4 => Box::new(TwoLevelPartition {
            first: density_peaks(source),
            beta: source.positive(),
            ..TwoLevelPartition::default()
        }),
        _ => Box::new(TreePartition {
            max_extent: source.coin().then(|| source.positive()),
            ..TreePartition::default()
        }),
    }
}

pub(crate) fn partitions(source: &mut Source<'_>) {
    let partitioner = partitioner(source);
    let Some(points) = points(source) else { return };
    let filter = source.coin().then(LocalOutlierFactor::default);
    if let Ok(found) = partitions_of(&*partitioner, &points, filter.as_ref()) {
        for partition in &found {
            assert_eq!(partition.labels().len(), points.len());
        }
    }
    if let Ok(labels) = partitioner.labels(&points) {
        assert_eq!(labels.len(), points.len());
    }
}

pub(crate) fn outlier_factors(source: &mut Source<'_>) {
    let filter = LocalOutlierFactor {
        n_neighbors: source.below(40),
        threshold: source.positive(),
        include_ties: source.coin(),
    };
    let Some(points) = points(source) else { return };
    if let Ok(found) = filter.explain(&points) {
        assert!(found.factors.iter().all(|factor| *factor >= 0.0), "{:?}", found.factors);
        finite("k-distance", &found.k_distance);
    }
}

pub(crate) fn spanning_trees(source: &mut Source<'_>) {
    let Some(points) = points(source) else { return };
    let edges = spanning_tree(&points);
    assert_eq!(edges.len(), points.len().saturating_sub(1));
    finite("length", edges.iter().map(|edge| &edge.length_squared));
}
