//! Dense linear algebra that names what failed.

pub mod cholesky;
pub mod saved;
pub mod symmetric;
