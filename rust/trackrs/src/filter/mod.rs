//! Recursive estimation of one target's state.

mod correction;
pub mod extended;
pub mod fusion;
pub mod kalman;
mod link;
pub mod noise;
pub mod paper_start;
pub mod prediction;
pub mod run;
pub mod runner;
pub mod screen;
pub mod sequence;
pub mod smoother;
pub mod start;
mod window;
