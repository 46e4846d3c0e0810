//! Recursive estimation of one target's state.

pub mod adaptation;
mod complete;
mod correction;
pub mod extended;
mod fit;
pub mod fusion;
pub mod kalman;
pub mod lead;
mod link;
mod look;
mod measured_root;
pub mod nis_noise;
pub mod noise;
pub mod paper_start;
pub mod prediction;
mod recovery;
pub mod residual_noise;
pub mod run;
pub mod runner;
pub mod screen;
pub mod search;
pub mod sequence;
pub mod sigma_points;
pub mod smoother;
pub mod square_root;
pub mod start;
mod window;
