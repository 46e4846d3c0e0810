//! The one error type of the library. Every variant names the culprit.

use thiserror::Error;

/// Result of every fallible function of the library.
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong, and where.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Error {
    /// A matrix that must be positive definite is not: the Cholesky factorisation stopped.
    #[error("{what} is not positive definite: pivot {pivot} is {value:e}")]
    NotPositiveDefinite {
        /// Which matrix, for example "innovation covariance".
        what: String,
        /// Index of the failing pivot, counted from 0.
        pivot: usize,
        /// Its value.
        value: f64,
    },
    /// Two shapes that must agree do not.
    #[error("{what} has size {found}, expected {expected}")]
    DimensionMismatch {
        /// Which quantity.
        what: String,
        /// The size it must have.
        expected: usize,
        /// The size it has.
        found: usize,
    },
    /// An array has another shape than it must have.
    #[error("{what} has shape {found:?}, expected {expected:?}")]
    Shape {
        /// Which array.
        what: String,
        /// The shape it must have.
        expected: Vec<usize>,
        /// The shape it has.
        found: Vec<usize>,
    },
    /// A number that must be finite is NaN or infinite.
    #[error("{what} is not finite at index {index}")]
    NonFinite {
        /// Which quantity.
        what: String,
        /// Flat index of the first offender, row-major.
        index: usize,
    },
    /// A parameter is outside its domain.
    #[error("{name} = {value} is invalid: {requirement}")]
    InvalidParameter {
        /// The parameter, as the user writes it.
        name: String,
        /// Its value.
        value: String,
        /// What it must satisfy.
        requirement: String,
    },
    /// Time went backwards.
    #[error("time {time} s is before {previous} s: times must not decrease")]
    TimeReversed {
        /// The offending time, seconds.
        time: f64,
        /// The time it had to follow, seconds.
        previous: f64,
    },
    /// A scan names a sensor that the tracker does not have.
    #[error("unknown sensor \"{sensor}\": this tracker has {known}")]
    UnknownSensor {
        /// The sensor named.
        sensor: String,
        /// The sensors there are.
        known: String,
    },
    /// A measurement function has no value or no derivative at this state.
    #[error("{sensor} cannot observe this state: {reason}")]
    Unobservable {
        /// The kind of sensor.
        sensor: String,
        /// Why.
        reason: String,
    },
    /// Saved bytes cannot be read back.
    #[error("saved state cannot be read: {reason}")]
    CorruptState {
        /// Why.
        reason: String,
    },
    /// A function from outside the library failed.
    #[error("{name} failed: {reason}")]
    Callable {
        /// Which function.
        name: String,
        /// What it says.
        reason: String,
    },
    /// A value cannot be saved, because it holds a model from outside the library.
    #[error("state cannot be saved: {reason}")]
    CannotSave {
        /// Why.
        reason: String,
    },
    /// The caller did not want to go on.
    #[error("interrupted")]
    Interrupted,
    /// The library broke one of its own laws: a fault of trackrs, not of the input.
    #[error("internal error, please report it: {reason}")]
    Internal {
        /// Which law.
        reason: String,
    },
    /// A result is too large for a number, or is none because numbers on the way were.
    #[error("{what} is not finite: numbers of this size cannot be computed with")]
    Overflow {
        /// Which result.
        what: String,
    },
    /// Strict mode turned an event into an error.
    #[error("strict mode: {event}")]
    Strict {
        /// The event's text.
        event: String,
    },
}

impl Error {
    /// An [`Error::InvalidParameter`].
    pub fn invalid(name: &str, value: impl std::fmt::Display, requirement: &str) -> Self {
        Self::InvalidParameter {
            name: name.into(),
            value: value.to_string(),
            requirement: requirement.into(),
        }
    }

    /// An [`Error::DimensionMismatch`].
    pub fn dimension(what: &str, expected: usize, found: usize) -> Self {
        Self::DimensionMismatch {
            what: what.into(),
            expected,
            found,
        }
    }
}

/// `Ok` if the value is finite and positive, else an error that names the parameter.
pub fn require_positive(name: &str, value: f64) -> Result<()> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(Error::invalid(name, value, "must be finite and positive"))
}

/// `Ok` if the value is a standard deviation whose variance can be told, else an error that names the parameter.
pub(crate) fn require_std(name: &str, value: f64) -> Result<()> {
    require_positive(name, value)?;
    if (value * value).is_normal() {
        return Ok(());
    }
    Err(Error::invalid(
        name,
        value,
        "must have a square that is neither 0 nor infinite",
    ))
}

/// `Ok` if the value is finite and not negative, else an error that names the parameter.
pub fn require_non_negative(name: &str, value: f64) -> Result<()> {
    if value.is_finite() && value >= 0.0 {
        return Ok(());
    }
    Err(Error::invalid(name, value, "must be finite and not negative"))
}

/// `Ok` if the value lies in [0, 1], else an error that names the parameter.
pub fn require_probability(name: &str, value: f64) -> Result<()> {
    if (0.0..=1.0).contains(&value) {
        return Ok(());
    }
    Err(Error::invalid(name, value, "must lie between 0 and 1"))
}

/// `Ok` if every element is finite, else an error with the index of the first that is not.
pub fn require_finite<'a>(what: &str, values: impl IntoIterator<Item = &'a f64>) -> Result<()> {
    match values.into_iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(index) => Err(Error::NonFinite {
            what: what.into(),
            index,
        }),
    }
}

/// Whether all are finite; without a branch for each, since results are long.
pub(crate) fn all_finite(values: &[f64]) -> bool {
    const EXPONENT: u64 = 0x7ff0_0000_0000_0000;
    let mut carry = 0;
    for value in values {
        // Of exponents only that of infinities and NaN carries.
        carry |= (value.to_bits() & EXPONENT).wrapping_add(1 << 52);
    }
    carry >> 63 == 0
}

/// `Ok` if a tracker can have counted so far, and can go on: ten for every nanosecond of a decade, else an error that names
/// what was never counted.
pub(crate) fn require_count(what: &str, count: u64) -> Result<()> {
    if count < 1 << 62 {
        return Ok(());
    }
    Err(Error::invalid(what, count, "is more than can have been counted"))
}

/// `Ok` if the two sizes agree, else an error that names what has the wrong one.
pub fn require_size(what: &str, expected: usize, found: usize) -> Result<()> {
    if expected == found {
        return Ok(());
    }
    Err(Error::dimension(what, expected, found))
}
