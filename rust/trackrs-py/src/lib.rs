//! Python bindings of trackrs: conversions and nothing else.

#[pyo3::pymodule(name = "_trackrs")]
mod trackrs_module {}
