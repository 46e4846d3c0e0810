//! Many filters at once: one register holds the same entry of several tracks.
//!
//! The only place with SIMD instructions. Tracks stand in blocks of eight, entry by entry ([`block::Lane`] is a cache
//! line), and every lane runs the same scalar algorithm: no shuffles, no sums across lanes, no fused multiply-add. So the
//! results are the same bits at every [`Level`], and those of one track do not depend on its neighbours.

pub mod block;
pub mod kinematic;
pub mod level;
pub(crate) mod tracks;

pub use level::Level;
