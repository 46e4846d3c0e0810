//! Recursive estimation of one target's state.

pub mod extended;
pub mod kalman;
pub mod sequence;
pub mod start;
