//! Which pairs of track and report are worth considering.

pub mod distances;
mod grid;
pub mod mahalanobis;
pub(crate) mod sweep;
