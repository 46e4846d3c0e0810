//! Tracking several targets: which tracks there are, from their first report to their end.

pub mod clutter_map;
pub mod config;
mod intake;
mod joint;
pub mod lifecycle;
mod live;
mod look;
pub mod moments;
pub mod multi_target;
pub mod phd;
mod population;
mod sequential;
mod two_point;
mod workspace;
