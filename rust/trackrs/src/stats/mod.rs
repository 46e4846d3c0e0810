//! Distributions, random streams, and times on a regular clock.

pub mod chi_square;
pub mod regular;
pub mod stream;
