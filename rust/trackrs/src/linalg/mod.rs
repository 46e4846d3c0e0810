//! Dense linear algebra that names what failed.

pub mod cholesky;
pub mod kernel;
pub mod saved;
pub mod stack;
pub mod symmetric;
