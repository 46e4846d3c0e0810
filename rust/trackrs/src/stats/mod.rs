//! Distributions.

pub mod chi_square;
