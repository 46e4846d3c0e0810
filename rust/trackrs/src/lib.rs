//! Target tracking: from raw sensor reports to tracks with honest covariances.
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)
)]

pub mod association;
pub mod error;
pub mod metric;
pub mod stats;

pub use error::{Error, Result};
