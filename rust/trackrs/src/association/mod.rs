//! Which report belongs to which track.

pub mod assignment;
pub mod associator;
pub mod existence;
pub mod jpda;
pub mod k_best;
pub mod marginals;
pub mod nearest;
pub mod npda;
pub mod odds;
pub mod pda;
