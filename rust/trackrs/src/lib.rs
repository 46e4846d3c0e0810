//! Target tracking: from raw sensor reports to tracks with honest covariances.
#![forbid(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod association;
pub mod error;
pub mod event;
pub mod filter;
pub mod gating;
pub mod gaussian;
pub mod geodesy;
pub mod interrupt;
pub mod lanes;
pub mod linalg;
pub mod metric;
pub mod model;
pub mod partition;
pub mod rfs;
pub mod scan;
pub mod sim;
pub mod state;
pub mod stats;
mod threads;
pub mod track;
pub mod tracker;

pub use error::{Error, Result};
pub use gaussian::Gaussian;
pub use scan::Scan;
pub use track::{Extent, Health, Track, TrackRef};
