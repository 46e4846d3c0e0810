//! From range to travel time: effective sound speed of a straight ray.
//!
//! | symbol | name here       | meaning                                                  |
//! |--------|-----------------|----------------------------------------------------------|
//! | c(z)   | `speeds`        | speed at the `depths`, m/s; linear between, constant beyond |
//! | r      | `range`         | length of the ray, metres                                |
//! | z, ζ   | `target`, `hydrophone` | depths of its ends, metres, positive down         |
//! | s̄      | `slowness`      | mean of 1/c over the ray, s/m                            |
//!
//! T = r s̄, the effective speed is 1/s̄: the harmonic mean of c along the ray.
//! Depth grows evenly along a straight ray, so s̄ = ∫ dz'/c(z') / (ζ − z), from z to ζ.
//! Over a piece of length l on which c goes linearly from a to b:  ∫ = (l/a) ln(1 + q)/q,  q = (b − a)/a.
//! ∂s̄/∂z = (s̄ − 1/c(z)) / (ζ − z);  for z → ζ: s̄ = 1/c, ∂s̄/∂z = −c'/(2c²).
//!
//! The bending of the ray is left out: it is of second order in the gradient.
//! Reference: paper of Xi, Liu, Tao, Lu, S = c T with the effective speed; spec section 5.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_positive, require_size};

/// Below this difference of depth (metres) the limit z → ζ is taken: the difference quotient loses its digits.
const LEVEL: f64 = 1e-2;

/// How fast sound travels to the hydrophones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum SoundSpeed {
    /// One effective speed for all channels, m/s.
    Uniform(f64),
    /// One effective speed per channel, m/s.
    PerChannel(Vec<f64>),
    /// The harmonic mean of a depth profile along the straight ray.
    Profile(SpeedProfile),
}

/// Mean slowness of a ray and how it changes with the depth of the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slowness {
    /// s̄, s/m.
    pub mean: f64,
    /// ∂s̄/∂z, s/m².
    pub slope: f64,
}

impl SoundSpeed {
    /// Whether the speeds fit this many channels in `dims` dimensions.
    pub fn check(&self, channels: usize, dims: usize) -> Result<()> {
        match self {
            Self::Uniform(speed) => require_positive("sound_speed", *speed),
            Self::PerChannel(speeds) => {
                require_size("sound_speed", channels, speeds.len())?;
                speeds.iter().try_for_each(|&c| require_positive("sound_speed", c))
            }
            Self::Profile(_) if dims < 3 => Err(Error::invalid(
                "sound_speed",
                "a depth profile",
                "must be a number or one per channel in 2 dimensions",
            )),
            Self::Profile(_) => Ok(()),
        }
    }

    /// Slowness of the ray from depth `target` to hydrophone `channel` at depth `hydrophone`.
    pub fn slowness(&self, channel: usize, target: f64, hydrophone: f64) -> Slowness {
        match self {
            Self::Uniform(speed) => Slowness {
                mean: 1.0 / speed,
                slope: 0.0,
            },
            Self::PerChannel(speeds) => Slowness {
                mean: 1.0 / speeds[channel],
                slope: 0.0,
            },
            Self::Profile(profile) => profile.slowness(target, hydrophone),
        }
    }

    /// Largest over smallest speed, minus 1: how far off a range is that is made with the wrong depth.
    pub fn spread(&self) -> f64 {
        match self {
            Self::Profile(profile) => {
                let max = profile.speeds.iter().copied().fold(0.0, f64::max);
                let min = profile.speeds.iter().copied().fold(f64::INFINITY, f64::min);
                max / min - 1.0
            }
            _ => 0.0,
        }
    }
}

/// Sound speed over depth: linear between the knots, constant above the first and below the last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpeedProfile {
    depths: Vec<f64>,
    speeds: Vec<f64>,
}

impl SpeedProfile {
    /// The profile through these points; depths in metres, positive down and increasing, speeds in m/s.
    pub fn new(depths: Vec<f64>, speeds: Vec<f64>) -> Result<Self> {
        if depths.is_empty() {
            return Err(Error::invalid("sound_speed", "an empty profile", "must have a depth"));
        }
        require_size("speeds of the profile", depths.len(), speeds.len())?;
        require_finite("depths of the profile", &depths)?;
        if depths.windows(2).any(|pair| pair[1] <= pair[0]) {
            return Err(Error::invalid("depths of the profile", "given", "must increase"));
        }
        speeds.iter().try_for_each(|&c| require_positive("sound_speed", c))?;
        Ok(Self { depths, speeds })
    }

    /// The speed at a depth, m/s.
    pub fn speed(&self, depth: f64) -> f64 {
        let above = self.depths.partition_point(|&d| d <= depth);
        match (above.checked_sub(1), self.depths.get(above)) {
            (None, _) => self.speeds[0],
            (Some(i), None) => self.speeds[i],
            (Some(i), Some(below)) => {
                let share = (depth - self.depths[i]) / (below - self.depths[i]);
                self.speeds[i] + share * (self.speeds[above] - self.speeds[i])
            }
        }
    }

    fn gradient(&self, depth: f64) -> f64 {
        let above = self.depths.partition_point(|&d| d <= depth);
        match (above.checked_sub(1), self.depths.get(above)) {
            (Some(i), Some(below)) => (self.speeds[above] - self.speeds[i]) / (below - self.depths[i]),
            _ => 0.0,
        }
    }

    fn slowness(&self, target: f64, hydrophone: f64) -> Slowness {
        let (top, bottom) = (target.min(hydrophone), target.max(hydrophone));
        if bottom - top < LEVEL {
            let middle = 0.5 * (top + bottom);
            let c = self.speed(middle);
            return Slowness {
                mean: 1.0 / c,
                slope: -self.gradient(middle) / (2.0 * c * c),
            };
        }
        let mut time = 0.0;
        let mut from = top;
        for &knot in self.depths.iter().filter(|&&d| d > top && d < bottom) {
            time += self.piece(from, knot);
            from = knot;
        }
        time += self.piece(from, bottom);
        let mean = time / (bottom - top);
        Slowness {
            mean,
            slope: (mean - 1.0 / self.speed(target)) / (hydrophone - target),
        }
    }

    /// ∫ dz/c between two depths with no knot between them.
    fn piece(&self, from: f64, to: f64) -> f64 {
        let (a, b) = (self.speed(from), self.speed(to));
        let q = (b - a) / a;
        let factor = if q.abs() < 1e-6 {
            1.0 - q / 2.0 + q * q / 3.0
        } else {
            libm::log1p(q) / q
        };
        (to - from) / a * factor
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn profile() -> SpeedProfile {
        SpeedProfile::new(vec![0.0, 50.0, 60.0, 300.0], vec![1520.0, 1518.0, 1490.0, 1495.0]).unwrap()
    }

    #[test]
    fn mean_slowness_is_the_integral() {
        let p = profile();
        for (z, zeta) in [
            (10.0, 250.0),
            (250.0, 10.0),
            (-20.0, 400.0),
            (52.0, 58.0),
            (100.0, 100.5),
        ] {
            let steps = 200_000;
            let sum: f64 = (0..steps)
                .map(|i| 1.0 / p.speed(z + (zeta - z) * (f64::from(i) + 0.5) / f64::from(steps)))
                .sum();
            assert_relative_eq!(p.slowness(z, zeta).mean, sum / f64::from(steps), max_relative = 1e-10);
        }
    }

    #[test]
    fn slope_is_the_derivative() {
        let p = profile();
        for (z, zeta) in [(10.0, 250.0), (250.0, 10.0), (55.0, 200.0), (120.0, 120.001)] {
            let ahead = p.slowness(z + 0.05, zeta).mean;
            let behind = p.slowness(z - 0.05, zeta).mean;
            assert_relative_eq!(p.slowness(z, zeta).slope, (ahead - behind) / 0.1, max_relative = 1e-3);
        }
    }

    #[test]
    fn bad_profiles_are_refused() {
        assert!(SpeedProfile::new(vec![], vec![]).is_err());
        assert!(SpeedProfile::new(vec![1.0, 1.0], vec![1500.0, 1500.0]).is_err());
        assert!(SpeedProfile::new(vec![0.0, 1.0], vec![1500.0, 0.0]).is_err());
        assert!(SoundSpeed::Profile(profile()).check(3, 2).is_err());
        assert!(SoundSpeed::PerChannel(vec![1500.0]).check(3, 3).is_err());
    }
}
