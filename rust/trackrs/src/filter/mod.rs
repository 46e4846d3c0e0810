//! Recursive estimation of one target's state.

pub mod adaptation;
mod correction;
pub mod extended;
pub mod kalman;
pub mod lead;
mod link;
mod look;
mod measured_root;
pub mod nis_noise;
pub mod noise;
pub mod prediction;
pub mod residual_noise;
pub mod run;
pub mod runner;
pub mod screen;
pub mod sequence;
pub mod sigma_points;
pub mod smoother;
pub mod square_root;
pub mod start;
mod window;
