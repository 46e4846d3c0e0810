//! An angle that is measured at equal intervals: the turntable of the helmet paper, and a head that shakes and nods.
//!
//! | symbol     | name here | meaning                                              |
//! |------------|-----------|------------------------------------------------------|
//! | ω          | `rate`    | steady turning, units per second                     |
//! | A_i, f_i   | `swings`  | amplitude and frequency (Hz) of what swings on top   |
//! | T          | `period`  | seconds between measurements, the first one at 0     |
//! | σ          | `std`     | standard deviation of a measurement                  |
//!
//! 1. α(t) = ω t + Σ A_i sin 2π f_i t
//! 2. z_k = α(k T) + σ n_k, n_k ~ N(0, 1)
//!
//! The first measurement is where a filter begins: mean (z_0, 0, 0), variances (σ², 10³, 10⁴). The paper gives none; these
//! are the reference values of its spec, in degrees.
//!
//! Reference: Sun, Zhang (2015), section 4, and section 4 of its spec.

use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

use crate::error::{Error, Result, require_finite, require_positive};
use crate::filter::sequence::InitialState;
use crate::gaussian::Gaussian;
use crate::stats::stream::Stream;

/// Variances of rate and acceleration that a filter begins with.
const UNKNOWN: [f64; 2] = [1e3, 1e4];

/// What the scenario is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct TurningSettings {
    /// Units per second.
    pub rate: f64,
    /// Amplitudes and frequencies, Hz.
    pub swings: Vec<[f64; 2]>,
    /// Seconds between measurements.
    pub period: f64,
    /// How many measurements, at least 2.
    pub samples: usize,
    /// Standard deviation of each.
    pub std: f64,
}

impl TurningSettings {
    /// The paper's turntable: 10 degrees a second, 20 frames a second, 9 s.
    pub fn turntable() -> Self {
        Self {
            rate: 10.0,
            swings: Vec::new(),
            period: 0.05,
            samples: 181,
            std: 0.0724,
        }
    }

    /// A head for a minute: 30 degrees at half a hertz, 5 degrees at 1.3 Hz.
    pub fn moving_head() -> Self {
        Self {
            rate: 0.0,
            swings: vec![[30.0, 0.5], [5.0, 1.3]],
            samples: 1200,
            ..Self::turntable()
        }
    }
}

/// The scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Turning {
    settings: TurningSettings,
}

/// One run: where a filter begins, and what it is fed.
#[derive(Debug, Clone, PartialEq)]
pub struct Angles {
    /// From the first measurement.
    pub initial: InitialState,
    /// The measurements after it.
    pub values: Vec<f64>,
}

impl Turning {
    /// The checked scenario.
    pub fn new(settings: TurningSettings) -> Result<Self> {
        require_finite("rate", [&settings.rate])?;
        require_finite("swings", settings.swings.as_flattened())?;
        require_positive("period", settings.period)?;
        require_positive("std", settings.std)?;
        if settings.samples < 2 {
            return Err(Error::invalid("samples", settings.samples, "must be at least 2"));
        }
        Ok(Self { settings })
    }

    /// What it is made of.
    pub fn settings(&self) -> &TurningSettings {
        &self.settings
    }

    /// The times of the measurements that a filter is fed, seconds.
    pub fn times(&self) -> Vec<f64> {
        (1..self.settings.samples).map(|k| self.time(k)).collect()
    }

    fn time(&self, k: usize) -> f64 {
        k as f64 * self.settings.period
    }

    /// The angle at a time.
    pub fn truth(&self, time: f64) -> f64 {
        let swing = |sum: f64, &[amplitude, frequency]: &[f64; 2]| sum + amplitude * libm::sin(TAU * frequency * time);
        self.settings.swings.iter().fold(self.settings.rate * time, swing)
    }

    /// Run `run` of a study with this seed.
    pub fn draw(&self, seed: u64, run: u64) -> Angles {
        let mut stream = Stream::new(seed, run);
        let mut measure = |k| self.truth(self.time(k)) + self.settings.std * stream.normal();
        let first = measure(0);
        let [rate, acceleration] = UNKNOWN;
        let variances = vec![self.settings.std * self.settings.std, rate, acceleration];
        let state = Gaussian {
            mean: DVector::from_vec(vec![first, 0.0, 0.0]),
            cov: DMatrix::from_diagonal(&DVector::from_vec(variances)),
        };
        Angles {
            initial: InitialState { time: 0.0, state },
            values: (1..self.settings.samples).map(measure).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_turns_and_the_noise_is_white() {
        let settings = TurningSettings {
            samples: 4001,
            ..TurningSettings::turntable()
        };
        let scene = Turning::new(settings).unwrap();
        let angles = scene.draw(3, 1);
        assert_eq!(scene.truth(0.9), 9.0);
        let noise: Vec<f64> = scene
            .times()
            .iter()
            .zip(&angles.values)
            .map(|(&t, z)| z - scene.truth(t))
            .collect();
        let of = |lag: usize| -> f64 {
            let products = noise.iter().zip(&noise[lag..]).map(|(a, b)| a * b);
            products.sum::<f64>() / 4000.0 / 0.0724_f64.powi(2)
        };
        // Four standard deviations.
        assert!((of(0) - 1.0).abs() < 4.0 * (2.0_f64 / 4000.0).sqrt(), "{}", of(0));
        assert!(of(1).abs() < 4.0 / 4000.0_f64.sqrt(), "{}", of(1));
        assert_eq!(scene.draw(3, 1), angles);
        assert_ne!(scene.draw(3, 2).values, angles.values);
    }

    #[test]
    fn a_head_swings_about_zero() {
        let scene = Turning::new(TurningSettings::moving_head()).unwrap();
        let expected = 30.0 * (TAU * 0.15).sin() + 5.0 * (TAU * 0.39).sin();
        assert!((scene.truth(0.3) - expected).abs() < 1e-12);
        assert!(scene.times().iter().all(|&t| scene.truth(t).abs() < 35.0 + 1e-12));
    }
}
