//! Dense linear algebra that names what failed.

pub mod cholesky;
pub(crate) mod kernel;
pub mod saved;
pub mod stack;
pub mod symmetric;
