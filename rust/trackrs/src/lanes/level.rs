//! Which instructions the kernels use: found at run time, so that one build serves every processor.

use pulp::Arch;

use crate::error::{Error, Result};

/// The variable of the environment that sets a level, for tests and bug reports.
pub const VARIABLE: &str = "TRACKRS_SIMD";

/// A set of instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// One track at a time.
    Scalar,
    /// Four: AVX2.
    V3,
    /// Eight: AVX-512.
    V4,
}

impl Level {
    const ALL: [Self; 3] = [Self::V4, Self::V3, Self::Scalar];

    /// Its name, as the variable of the environment has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::V3 => "v3",
            Self::V4 => "v4",
        }
    }

    /// The levels of this machine, the best one first.
    pub fn available() -> Vec<Self> {
        Self::ALL.into_iter().filter(|level| level.arch().is_some()).collect()
    }

    /// The one that the variable of the environment names, else the best one.
    pub fn chosen() -> Result<Self> {
        match std::env::var(VARIABLE) {
            Ok(name) if !name.is_empty() => Self::named(&name),
            _ => Ok(Self::available().first().copied().unwrap_or(Self::Scalar)),
        }
    }

    /// The level of this name; an error if there is none, or this machine does not have it.
    pub fn named(name: &str) -> Result<Self> {
        let available = Self::available();
        available
            .iter()
            .copied()
            .find(|level| level.name() == name)
            .ok_or_else(|| {
                let names: Vec<&str> = available.iter().map(|level| level.name()).collect();
                let requirement = format!("must be one of this machine: {}", names.join(", "));
                Error::invalid(VARIABLE, name, &requirement)
            })
    }

    /// How to dispatch by the chosen one.
    pub(crate) fn chosen_arch() -> Result<Arch> {
        Ok(Self::chosen()?.arch().unwrap_or_default())
    }

    /// How to dispatch; `None` where the machine lacks it.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn arch(self) -> Option<Arch> {
        match self {
            Self::Scalar => Some(Arch::Scalar),
            Self::V3 => pulp::x86::V3::try_new().map(Arch::V3),
            Self::V4 => pulp::x86::V4::try_new().map(Arch::V4),
        }
    }

    /// How to dispatch; `None` where the machine lacks it.
    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn arch(self) -> Option<Arch> {
        matches!(self, Self::Scalar).then(Arch::new)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_always_the_scalar_one() {
        let levels = Level::available();
        assert_eq!(levels.last(), Some(&Level::Scalar));
        for level in levels {
            assert_eq!(Level::named(level.name()), Ok(level));
        }
        assert!(Level::named("v9").unwrap_err().to_string().contains("scalar"));
    }
}
