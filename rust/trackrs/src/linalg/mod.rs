//! Dense linear algebra that names what failed.

pub mod cholesky;
pub(crate) mod fixed;
pub(crate) mod kernel;
pub mod saved;
pub(crate) mod sparse;
pub mod stack;
pub mod symmetric;
