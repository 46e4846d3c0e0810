//! Which report belongs to which track.

pub mod assignment;
pub mod marginals;
pub mod nearest;
