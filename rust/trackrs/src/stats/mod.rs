//! Distributions.

pub mod chi_square;
pub mod regular;
