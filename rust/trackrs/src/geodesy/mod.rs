//! Positions on the Earth: geodetic, Earth-centred and local coordinates, and the similarity that ties two frames.

pub mod local;
pub mod placement;
pub mod similarity;
pub mod wgs84;
