//! Distributions and random streams.

pub mod chi_square;
pub mod stream;
