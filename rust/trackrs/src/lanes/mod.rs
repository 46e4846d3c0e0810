//! Many filters at once: one register holds the same entry of several tracks.
//!
//! The only place with SIMD instructions. Tracks stand in blocks of eight, entry by entry ([`block::Lane`] is a cache
//! line), and every lane runs the same scalar algorithm: no shuffles, no sums across lanes, no fused multiply-add. So the
//! results are the same bits at every [`Level`], and those of one track do not depend on its neighbours.

// Entries of small matrices are named by their indices, as the equations have them.
#![allow(clippy::needless_range_loop, clippy::inline_always)]

pub mod block;
mod condition;
pub(crate) mod distances;
pub mod kinematic;
pub mod level;
pub(crate) mod linear;
pub(crate) mod rows;
pub(crate) mod tracks;
mod transport;
pub mod work;

pub use level::Level;
