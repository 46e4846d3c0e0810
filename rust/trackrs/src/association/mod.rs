//! Which report belongs to which track.

pub mod assignment;
pub mod existence;
pub mod k_best;
pub mod marginals;
pub mod nearest;
