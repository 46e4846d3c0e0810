//! Recursive estimation of one target's state.

mod complete;
pub mod extended;
pub mod fusion;
pub mod kalman;
pub mod noise;
pub mod paper_start;
pub mod runner;
pub mod screen;
pub mod search;
pub mod sequence;
pub mod smoother;
pub mod start;
mod window;
