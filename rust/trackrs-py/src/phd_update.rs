//! What a scan does to the mixture of a tracker by intensity.

use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use trackrs::gating::mahalanobis::Gate;
use trackrs::rfs::cphd::CphdUpdate;
use trackrs::rfs::extended_gm_phd::ExtendedUpdate;
use trackrs::rfs::extent::ExtentModel;
use trackrs::rfs::gm_phd::PointUpdate;
use trackrs::rfs::rate::RateModel;
use trackrs::tracker::phd::config;

use crate::array;
use crate::error::{compute, count};
use crate::partition::{OutlierFilter, Partitioner};

type ExtentItems<'py> = (PyReadonlyArray2<'py, f64>, f64, f64);

/// What a scan does to a mixture.
#[pyclass(frozen)]
pub(crate) struct IntensityUpdate {
    pub(crate) core: config::IntensityUpdate,
}

fn point_update(gate: f64, prune: f64) -> trackrs::Result<PointUpdate> {
    Ok(PointUpdate {
        gate: Gate::new(gate)?,
        prune,
    })
}

#[pymethods]
impl IntensityUpdate {
    /// `learnt`: forgetting and floor of rates. `extent`: prior covariance, its certainty and time constant.
    #[staticmethod]
    fn extended(
        partition: &Partitioner,
        clutter_filter: Option<PyRef<'_, OutlierFilter>>,
        superposition: bool,
        learnt: Option<(f64, f64)>,
        prune: f64,
        extent: Option<ExtentItems<'_>>,
    ) -> PyResult<Self> {
        let model = |(cov, certainty, time_constant): ExtentItems<'_>| {
            let cov = array::matrix(&cov, "extent")?;
            let prior = trackrs::Extent { cov, certainty };
            Ok::<_, PyErr>(ExtentModel { prior, time_constant })
        };
        Ok(Self {
            core: config::IntensityUpdate::Extended(ExtendedUpdate {
                rates: learnt.map_or(RateModel::Known, |(forgetting, floor)| RateModel::Learnt {
                    forgetting,
                    floor,
                }),
                partition: partition.core.clone(),
                clutter_filter: clutter_filter.map(|filter| filter.core.clone()),
                superposition,
                prune,
                extent: extent.map(model).transpose()?,
            }),
        })
    }

    #[staticmethod]
    fn point(py: Python<'_>, gate: f64, prune: f64) -> PyResult<Self> {
        let point = compute(py, || point_update(gate, prune))?;
        Ok(Self {
            core: config::IntensityUpdate::Point(point),
        })
    }

    #[staticmethod]
    fn cardinalised(py: Python<'_>, gate: f64, prune: f64, max_targets: i64) -> PyResult<Self> {
        let update = compute(py, || {
            Ok(CphdUpdate {
                point: point_update(gate, prune)?,
                max_targets: count("max_targets", max_targets)?,
            })
        })?;
        Ok(Self {
            core: config::IntensityUpdate::Cardinalised(update),
        })
    }
}
