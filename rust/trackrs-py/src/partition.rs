//! Partitions of points, and outlier factors.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trackrs::Error;
use trackrs::partition::border::BorderDensity;
use trackrs::partition::dbscan::DbscanPartition;
use trackrs::partition::density_peaks::{DensityPeakPartition, DensityPeaks, Kernel, Peaks, Scale};
use trackrs::partition::distance::{DistancePartition, SubPartitions, Thresholds};
use trackrs::partition::kmeans::KMeansPartition;
use trackrs::partition::lof;
use trackrs::partition::tree::{Linkage, TreePartition};
use trackrs::partition::two_level::TwoLevelPartition;
use trackrs::partition::{self, PartitionModel, Points};

use crate::array;
use crate::error::{compute_long, count, to_python};

type Noise<'py> = Option<PyReadonlyArray2<'py, f64>>;

fn points(values: &PyReadonlyArray2<'_, f64>, noise: &Noise<'_>) -> PyResult<Points> {
    let slice = array::c_slice(values, "points")?;
    let dims = values.shape()[1];
    let made = match noise {
        None => Points::new(slice, dims),
        Some(noise) => Points::whitened(slice, dims, &array::matrix(noise, "noise")?),
    };
    made.map_err(|error| to_python(values.py(), &error))
}

pub(crate) fn integers<'py>(py: Python<'py>, values: &[usize]) -> Bound<'py, PyArray1<i64>> {
    PyArray1::from_iter(py, values.iter().map(|&value| i64::try_from(value).unwrap_or(i64::MAX)))
}

/// −1 where there is none.
fn optional<'py>(py: Python<'py>, values: &[Option<usize>]) -> Bound<'py, PyArray1<i64>> {
    let number = |value: &Option<usize>| value.map_or(-1, |value| i64::try_from(value).unwrap_or(i64::MAX));
    PyArray1::from_iter(py, values.iter().map(number))
}

/// Rows of two.
fn pairs<'py>(py: Python<'py>, values: &[[usize; 2]]) -> PyResult<Bound<'py, PyArray2<i64>>> {
    integers(py, values.as_flattened()).reshape([values.len(), 2])
}

/// What divides points into cells.
#[pyclass(frozen)]
pub(crate) struct Partitioner {
    pub(crate) core: PartitionModel,
}

fn made<T>(py: Python<'_>, result: trackrs::Result<T>) -> PyResult<T> {
    result.map_err(|error| to_python(py, &error))
}

fn unknown(name: &str, value: &str, known: &str) -> Error {
    Error::invalid(name, format_args!("{value:?}"), &format!("must be one of {known}"))
}

/// How many peaks: a count, `"gap"` or `"distance"`.
#[derive(FromPyObject)]
pub(crate) enum PeakRule {
    Count(i64),
    Rule(String),
}

fn density_peaks(
    d_c: Option<f64>,
    percent: Option<f64>,
    kernel: &str,
    peaks: PeakRule,
    peak_distance: f64,
    max_link: Option<f64>,
) -> trackrs::Result<DensityPeakPartition> {
    Ok(DensityPeakPartition {
        scale: match (d_c, percent) {
            (None, None) => Scale::Deviation,
            (Some(d_c), None) => Scale::Length(d_c),
            (None, Some(percent)) => Scale::Percent(percent),
            (Some(_), Some(percent)) => return Err(Error::invalid("percent", percent, "must not be given beside d_c")),
        },
        kernel: match kernel {
            "gaussian" => Kernel::Gaussian,
            "cutoff" => Kernel::Cutoff,
            other => return Err(unknown("kernel", other, "gaussian, cutoff")),
        },
        peaks: match peaks {
            PeakRule::Count(number) => Peaks::Count(count("peaks", number)?),
            PeakRule::Rule(rule) => match rule.as_str() {
                "gap" => Peaks::Gap,
                "distance" => Peaks::Distance(peak_distance),
                other => return Err(unknown("peaks", other, "distance, gap, or a number")),
            },
        },
        max_link,
    })
}

#[pymethods]
impl Partitioner {
    #[staticmethod]
    #[pyo3(signature = (thresholds, probabilities, detections_per_target, seed))]
    fn distance(
        py: Python<'_>,
        thresholds: ThresholdRule,
        probabilities: [f64; 2],
        detections_per_target: Option<f64>,
        seed: u64,
    ) -> PyResult<Self> {
        let thresholds = match thresholds {
            ThresholdRule::Range([lower, upper]) => Ok(Thresholds::Range { lower, upper }),
            ThresholdRule::Rule(rule) => match rule.as_str() {
                "literature" => Ok(Thresholds::Literature),
                "difference" => Ok(Thresholds::Difference),
                other => Err(unknown("thresholds", other, "literature, difference, or two numbers")),
            },
        };
        Ok(Self {
            core: PartitionModel::Distance(DistancePartition {
                thresholds: made(py, thresholds)?,
                probabilities,
                sub_partitions: detections_per_target.map(|detections_per_target| SubPartitions {
                    detections_per_target,
                    seed,
                }),
            }),
        })
    }

    #[staticmethod]
    fn kmeans(py: Python<'_>, lower: i64, upper: i64, seed: u64) -> PyResult<Self> {
        let (lower, upper) = (made(py, count("k", lower))?, made(py, count("k", upper))?);
        Ok(Self {
            core: PartitionModel::KMeans(KMeansPartition { lower, upper, seed }),
        })
    }

    #[staticmethod]
    fn dbscan(py: Python<'_>, eps: Option<f64>, min_samples: i64) -> PyResult<Self> {
        let min_samples = made(py, count("min_samples", min_samples))?;
        Ok(Self {
            core: PartitionModel::Dbscan(DbscanPartition { eps, min_samples }),
        })
    }

    #[staticmethod]
    fn density_peak(
        py: Python<'_>,
        d_c: Option<f64>,
        percent: Option<f64>,
        kernel: &str,
        peaks: PeakRule,
        peak_distance: f64,
        max_link: Option<f64>,
    ) -> PyResult<Self> {
        let core = made(py, density_peaks(d_c, percent, kernel, peaks, peak_distance, max_link))?;
        Ok(Self {
            core: PartitionModel::DensityPeaks(core),
        })
    }

    #[staticmethod]
    #[expect(clippy::too_many_arguments, reason = "two levels, each with its parameters")]
    fn two_level(
        py: Python<'_>,
        d_c: Option<f64>,
        percent: Option<f64>,
        kernel: &str,
        peaks: PeakRule,
        peak_distance: f64,
        max_link: Option<f64>,
        border: &str,
        beta: f64,
    ) -> PyResult<Self> {
        let first = made(py, density_peaks(d_c, percent, kernel, peaks, peak_distance, max_link))?;
        let border = match border {
            "max" => BorderDensity::Maximum,
            "mean" => BorderDensity::Mean,
            other => return made(py, Err(unknown("border", other, "max, mean"))),
        };
        Ok(Self {
            core: PartitionModel::TwoLevel(TwoLevelPartition { first, border, beta }),
        })
    }

    #[staticmethod]
    fn tree(py: Python<'_>, linkages: Vec<String>, max_extent: Option<f64>) -> PyResult<Self> {
        let linkage = |name: &String| match name.as_str() {
            "single" => Ok(Linkage::Single),
            "ward" => Ok(Linkage::Ward),
            other => Err(unknown("linkages", other, "single, ward")),
        };
        let linkages = made(py, linkages.iter().map(linkage).collect())?;
        Ok(Self {
            core: PartitionModel::Tree(TreePartition { linkages, max_extent }),
        })
    }

    /// The label of every point in every partition (P, n).
    #[pyo3(signature = (values, noise=None, clutter_filter=None))]
    fn partitions<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray2<'py, f64>,
        noise: Noise<'py>,
        clutter_filter: Option<PyRef<'py, OutlierFilter>>,
    ) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let points = points(&values, &noise)?;
        let filter = clutter_filter.as_ref().map(|filter| &filter.core);
        let (labels, shape) = compute_long(py, || {
            let found = partition::partitions(self.core.as_partitioner(), &points, filter)?;
            let labels = found.iter().flat_map(partition::Partition::labels);
            let labels: Vec<i64> = labels.map(|&l| i64::try_from(l).unwrap_or(i64::MAX)).collect();
            Ok((labels, [found.len(), points.len()]))
        })?;
        PyArray1::from_vec(py, labels).reshape(shape)
    }

    /// The label of every point of the one partition.
    #[pyo3(signature = (values, noise=None))]
    fn labels<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray2<'py, f64>,
        noise: Noise<'py>,
    ) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let points = points(&values, &noise)?;
        let labels = compute_long(py, || self.core.as_partitioner().labels(&points))?;
        Ok(optional(py, &labels))
    }

    /// The decision graph of density peaks, or both levels of a two-level partition.
    #[pyo3(signature = (values, noise=None))]
    fn explain<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray2<'py, f64>,
        noise: Noise<'py>,
    ) -> PyResult<Explained<'py>> {
        let points = points(&values, &noise)?;
        match &self.core {
            PartitionModel::DensityPeaks(core) => {
                let found = compute_long(py, || core.explain(&points))?;
                Ok(Explained::Graph(DecisionGraph::new(py, found)))
            }
            PartitionModel::TwoLevel(core) => {
                let found = compute_long(py, || core.explain(&points))?;
                let ends: Vec<[usize; 2]> = found.borders.iter().map(|border| border.cells).collect();
                Ok(Explained::Levels(TwoLevels {
                    mean_density: PyArray1::from_vec(py, found.mean_density),
                    borders: pairs(py, &ends)?,
                    border_density: PyArray1::from_iter(py, found.borders.iter().map(|border| border.density)),
                    labels: integers(py, &found.labels),
                    graph: DecisionGraph::new(py, found.first),
                }))
            }
            _ => made(
                py,
                Err(Error::invalid("partitioner", "this one", "has no decision graph")),
            ),
        }
    }

    /// The trees of a tree partition.
    #[pyo3(signature = (values, noise=None))]
    fn trees<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray2<'py, f64>,
        noise: Noise<'py>,
    ) -> PyResult<Vec<Tree<'py>>> {
        let points = points(&values, &noise)?;
        let PartitionModel::Tree(core) = &self.core else {
            return made(py, Err(Error::invalid("partitioner", "this one", "has no trees")));
        };
        let trees = compute_long(py, || core.trees(&points))?;
        let out = trees.into_iter().map(|tree| {
            Ok(Tree {
                children: pairs(py, &tree.children)?,
                heights: PyArray1::from_vec(py, tree.heights),
                roots: integers(py, &tree.roots),
            })
        });
        out.collect()
    }
}

/// Bounds of the thresholds: two numbers, or how they are found.
#[derive(FromPyObject)]
pub(crate) enum ThresholdRule {
    Rule(String),
    Range([f64; 2]),
}

/// Density peaks, step by step.
#[derive(IntoPyObject)]
pub(crate) struct DecisionGraph<'py> {
    d_c: f64,
    rho: Bound<'py, PyArray1<f64>>,
    delta: Bound<'py, PyArray1<f64>>,
    gamma: Bound<'py, PyArray1<f64>>,
    nearest_denser: Bound<'py, PyArray1<i64>>,
    order: Bound<'py, PyArray1<i64>>,
    peaks: Bound<'py, PyArray1<i64>>,
    labels: Bound<'py, PyArray1<i64>>,
}

impl<'py> DecisionGraph<'py> {
    fn new(py: Python<'py>, found: DensityPeaks) -> Self {
        Self {
            d_c: found.d_c,
            rho: PyArray1::from_vec(py, found.rho),
            delta: PyArray1::from_vec(py, found.delta),
            gamma: PyArray1::from_vec(py, found.gamma),
            nearest_denser: optional(py, &found.nearest_denser),
            order: integers(py, &found.order),
            peaks: integers(py, &found.peaks),
            labels: integers(py, &found.labels),
        }
    }
}

/// Two levels, step by step.
#[derive(IntoPyObject)]
pub(crate) struct TwoLevels<'py> {
    graph: DecisionGraph<'py>,
    mean_density: Bound<'py, PyArray1<f64>>,
    borders: Bound<'py, PyArray2<i64>>,
    border_density: Bound<'py, PyArray1<f64>>,
    labels: Bound<'py, PyArray1<i64>>,
}

/// What `explain` gives.
#[derive(IntoPyObject)]
pub(crate) enum Explained<'py> {
    Graph(DecisionGraph<'py>),
    Levels(TwoLevels<'py>),
}

/// A tree over points.
#[derive(IntoPyObject)]
pub(crate) struct Tree<'py> {
    children: Bound<'py, PyArray2<i64>>,
    heights: Bound<'py, PyArray1<f64>>,
    roots: Bound<'py, PyArray1<i64>>,
}

/// The local outlier factor.
#[pyclass(frozen)]
pub(crate) struct OutlierFilter {
    pub(crate) core: lof::LocalOutlierFactor,
}

/// The outlier factor, step by step.
#[derive(IntoPyObject)]
pub(crate) struct OutlierFactors<'py> {
    k_distance: Bound<'py, PyArray1<f64>>,
    reachability_density: Bound<'py, PyArray1<f64>>,
    factors: Bound<'py, PyArray1<f64>>,
}

#[pymethods]
impl OutlierFilter {
    #[new]
    fn new(py: Python<'_>, n_neighbors: i64, threshold: f64, include_ties: bool) -> PyResult<Self> {
        Ok(Self {
            core: lof::LocalOutlierFactor {
                n_neighbors: made(py, count("n_neighbors", n_neighbors))?,
                threshold,
                include_ties,
            },
        })
    }

    #[pyo3(signature = (values, noise=None))]
    fn explain<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray2<'py, f64>,
        noise: Noise<'py>,
    ) -> PyResult<OutlierFactors<'py>> {
        let points = points(&values, &noise)?;
        let found = compute_long(py, || self.core.explain(&points))?;
        Ok(OutlierFactors {
            k_distance: PyArray1::from_vec(py, found.k_distance),
            reachability_density: PyArray1::from_vec(py, found.reachability_density),
            factors: PyArray1::from_vec(py, found.factors),
        })
    }
}
