//! Scores: distances between sets of targets, consistency of covariances, and tracks against truth.

pub mod consistency;
pub mod evaluate;
pub mod gospa;
pub mod innovation;
mod near;
pub mod ospa;
pub mod whiteness;
