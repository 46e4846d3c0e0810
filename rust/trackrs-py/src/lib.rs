//! Python bindings of trackrs: conversions and nothing else. What they convert is documented in `python/trackrs`.
// PyO3 extracts arguments by value.
#![allow(clippy::needless_pass_by_value)]

mod array;
mod association;
mod associator;
mod batch;
mod custom;
mod error;
mod filter;
mod fusion;
mod gating;
mod geodesy;
mod given;
mod memory;
mod metric;
mod model;
mod options;
mod partition;
mod phd;
mod phd_update;
mod pose;
mod rotation;
mod run;
mod scans;
mod sim;
mod sim_extended;
mod smoother;
mod stats;
mod study;
mod tracker;

#[global_allocator]
static MEMORY: memory::LargePages = memory::LargePages;

#[pyo3::pymodule]
mod _trackrs {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::association::{assign, assign_sparse, k_best, marginals};
    #[pymodule_export]
    use crate::batch::{TrackBatch, simd_levels};
    #[pymodule_export]
    use crate::error::panic_on_purpose;
    #[pymodule_export]
    use crate::filter::Filter;
    #[pymodule_export]
    use crate::fusion::{covariance_intersection, paper_start, start_state};
    #[pymodule_export]
    use crate::gating::{gate_distances, gate_pairs};
    #[pymodule_export]
    use crate::geodesy::{
        LocalFrame, apply_similarity, ecef_to_geodetic, fit_similarity, geodetic_to_ecef, place_array,
    };
    #[pymodule_export]
    use crate::metric::{cumulative, evaluate, gospa, nees, nis, ospa, whiteness};
    #[pymodule_export]
    use crate::model::{Motion, Sensor};
    #[pymodule_export]
    use crate::partition::{OutlierFilter, Partitioner};
    #[pymodule_export]
    use crate::phd::IntensityTracker;
    #[pymodule_export]
    use crate::phd_update::IntensityUpdate;
    #[pymodule_export]
    use crate::rotation::{
        rotation_angles, rotation_between, rotation_from_angles, rotation_quaternions, rotation_turned,
        rotation_vectors,
    };
    #[pymodule_export]
    use crate::sim::{CloseTargets, Turning, Underwater, reference_course, reference_hydrophones};
    #[pymodule_export]
    use crate::sim_extended::{ExtendedTargets, crossing_targets, parallel_targets};
    #[pymodule_export]
    use crate::smoother::smooth;
    #[pymodule_export]
    use crate::stats::{chi_square_quantile, regularise};
    #[pymodule_export]
    use crate::study::{Study, StudyStop, score_tracks, study_columns};
    #[pymodule_export]
    use crate::tracker::Tracker;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
