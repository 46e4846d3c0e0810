//! Random finite sets: filters that carry the intensity of all targets together, as a mixture of Gaussians.

pub(crate) mod cells;
pub mod extended_gm_phd;
pub(crate) mod group;
pub mod mixture;
pub mod prediction;
pub mod rate;
pub(crate) mod sums;
pub(crate) mod view;
