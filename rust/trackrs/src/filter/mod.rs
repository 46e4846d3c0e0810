//! Recursive estimation of one target's state.

mod complete;
mod correction;
pub mod extended;
mod fit;
pub mod fusion;
pub mod kalman;
mod link;
pub mod noise;
pub mod paper_start;
pub mod prediction;
mod recovery;
pub mod run;
pub mod runner;
pub mod screen;
pub mod search;
pub mod sequence;
pub mod smoother;
pub mod start;
mod window;
