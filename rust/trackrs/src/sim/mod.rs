//! Scenarios: truth and what the sensors would have reported of it, drawn from seeded streams; and studies of them.

pub mod close_targets;
pub mod course;
pub mod extended_targets;
pub mod shape;
pub mod study;
pub mod turning;
pub mod underwater;
