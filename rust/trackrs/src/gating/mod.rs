//! Which pairs of track and report are worth considering.

pub mod mahalanobis;
pub(crate) mod sweep;
