//! Tracking several targets: which tracks there are, from their first report to their end.

mod clock;
pub mod clutter_map;
pub mod config;
pub mod engine;
mod health;
pub mod in_order;
mod intake;
mod joint;
mod journal;
pub mod lifecycle;
mod live;
mod look;
pub mod moments;
pub mod multi_target;
pub mod phd;
mod population;
pub mod rewind;
mod sequential;
mod two_point;
pub mod window;
mod workspace;
