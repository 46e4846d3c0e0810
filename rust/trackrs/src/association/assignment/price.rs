//! What a path costs in [`sparse`](super::sparse): a number, or a count of exits and a number.

use std::fmt::Debug;
use std::ops::{Add, Sub};

/// A cost that can be compared, added and taken away.
pub(super) trait Price: Copy + Debug + PartialOrd + Add<Output = Self> + Sub<Output = Self> {
    const ZERO: Self;
    const INFINITY: Self;
    /// Below every price.
    const PASSED: Self;
    /// Of a row that stays alone and has no miss cost; none where no row may.
    const EXIT: Option<Self>;

    /// The price of a pair.
    fn of(cost: f64) -> Self;

    /// As one number, where the first component is worth `unit`.
    fn with_unit(self, unit: f64) -> f64;

    /// The least unit for which a price that is not negative is no negative number.
    fn least_unit(self) -> f64;
}

impl Price for f64 {
    const ZERO: Self = 0.0;
    const INFINITY: Self = Self::INFINITY;
    const PASSED: Self = Self::NEG_INFINITY;
    const EXIT: Option<Self> = None;

    #[inline]
    fn of(cost: f64) -> Self {
        cost
    }

    fn with_unit(self, _unit: f64) -> f64 {
        self
    }

    fn least_unit(self) -> f64 {
        0.0
    }
}

/// Exits first, then costs.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub(super) struct Graded {
    exits: f64,
    cost: f64,
}

impl Add for Graded {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        Self {
            exits: self.exits + other.exits,
            cost: self.cost + other.cost,
        }
    }
}

impl Sub for Graded {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        Self {
            exits: self.exits - other.exits,
            cost: self.cost - other.cost,
        }
    }
}

impl Price for Graded {
    const ZERO: Self = Self { exits: 0.0, cost: 0.0 };
    const INFINITY: Self = Self {
        exits: f64::INFINITY,
        cost: 0.0,
    };
    const PASSED: Self = Self {
        exits: f64::NEG_INFINITY,
        cost: 0.0,
    };
    const EXIT: Option<Self> = Some(Self { exits: 1.0, cost: 0.0 });

    #[inline]
    fn of(cost: f64) -> Self {
        if cost == f64::INFINITY {
            return Self::INFINITY;
        }
        Self { exits: 0.0, cost }
    }

    fn with_unit(self, unit: f64) -> f64 {
        self.cost + self.exits * unit
    }

    fn least_unit(self) -> f64 {
        if self.exits > 0.0 { -self.cost / self.exits } else { 0.0 }
    }
}
