//! Shapes of extended targets: uniform points on them, and how far these lie from the centre.
//!
//! | symbol | name here     | meaning                                                          |
//! |--------|---------------|------------------------------------------------------------------|
//! | u, v   | `u`, `v`      | uniform deviates in [0, 1)                                       |
//! | a, b   | `length`, `width`, `arm` | whole axes, sides or arms, metres                     |
//!
//! The centre is the mean of the points, so that a filter's position is that of the shape.
//!
//! 1. Points. Ellipse: ½ √u (a cos 2πv, b sin 2πv). Rectangle: (a (u − ½), b (v − ½)). L: (2u, 0) a for u < ½, else
//!    (0, 2u − 1) a, less the mean (¼, ¼) a.
//! 2. Mean variance of an axis. Ellipse: (a² + b²) / 32. Rectangle: (a² + b²) / 24. L: 5 a² / 48. Plus that of the noise.

use std::f64::consts::TAU;

use crate::error::{Result, require_positive};

/// What the detections of a target come from. Its centre is the mean of its points, its x axis lies along the velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A point; detections are normal about it.
    Blob {
        /// Standard deviation of the detections, metres, sensor noise included.
        spread: f64,
    },
    /// An ellipse, filled.
    Ellipse {
        /// Whole axis along the velocity, metres.
        length: f64,
        /// Whole axis across, metres.
        width: f64,
    },
    /// A rectangle, filled.
    Rectangle {
        /// Side along the velocity, metres.
        length: f64,
        /// Side across, metres.
        width: f64,
    },
    /// Two lines from one corner, one along the velocity, one to its left.
    L {
        /// Length of each, metres.
        arm: f64,
    },
}

impl Shape {
    /// Ellipse, rectangle and L of the spec.
    pub fn of_the_spec() -> [Self; 3] {
        let ellipse = Self::Ellipse {
            length: 80.0,
            width: 30.0,
        };
        let rectangle = Self::Rectangle {
            length: 70.0,
            width: 40.0,
        };
        [ellipse, rectangle, Self::L { arm: 60.0 }]
    }

    pub(super) fn require_valid(&self) -> Result<()> {
        match *self {
            Self::Blob { spread } => require_positive("spread", spread),
            Self::L { arm } => require_positive("arm", arm),
            Self::Ellipse { length, width } | Self::Rectangle { length, width } => {
                require_positive("length", length)?;
                require_positive("width", width)
            }
        }
    }

    /// A uniform point of the shape, of two uniform deviates.
    pub(super) fn point(&self, u: f64, v: f64) -> [f64; 2] {
        match *self {
            Self::Blob { .. } => [0.0, 0.0],
            Self::Ellipse { length, width } => {
                let radius = 0.5 * u.sqrt();
                [
                    length * radius * libm::cos(TAU * v),
                    width * radius * libm::sin(TAU * v),
                ]
            }
            Self::Rectangle { length, width } => [length * (u - 0.5), width * (v - 0.5)],
            Self::L { arm } => {
                let along = 2.0 * u;
                let [x, y] = if along < 1.0 { [along, 0.0] } else { [0.0, along - 1.0] };
                [arm * (x - 0.25), arm * (y - 0.25)]
            }
        }
    }

    /// Standard deviation of a detection about its point.
    pub(super) fn noise(&self, noise_std: f64) -> f64 {
        match *self {
            Self::Blob { spread } => spread,
            _ => noise_std,
        }
    }

    /// Mean over the axes of the variance of a detection about the centre.
    pub(super) fn mean_variance(&self, noise_std: f64) -> f64 {
        let extent = match *self {
            Self::Blob { .. } => 0.0,
            Self::Ellipse { length, width } => (length * length + width * width) / 32.0,
            Self::Rectangle { length, width } => (length * length + width * width) / 24.0,
            Self::L { arm } => arm * arm * 5.0 / 48.0,
        };
        let std = self.noise(noise_std);
        extent + std * std
    }
}
