//! A manoeuvring vessel heard by hydrophones: the reference scenario of the underwater paper, and targets that move exactly
//! as a filter assumes.
//!
//! | symbol | name here  | meaning                                                             |
//! |--------|------------|---------------------------------------------------------------------|
//! | x      | [`Trajectory`] | T×9 position, velocity, acceleration                            |
//! | σ_J    | `jerk_std` | standard deviation of the jerk, constant over a step, m/s³          |
//! | p      | `gross`    | probability of a gross error of a range                             |
//! | q      | `missing`  | probability that a component is not observed                        |
//!
//! Truth: a [`Course`], the same in every run, or of each run its own: x_{k+1} = F x_k + Γ w, w ~ N(0, σ_J² I), from the
//! course's beginning. Measurement: z = h(x) + v, v ~ N(0, R); a range that is hit has ±U(10 m, 100 m) added. The first
//! three epochs are complete and without gross errors, so that a run can start.
//!
//! Every epoch takes the same number of deviates whatever p and q are: runs with and without gross errors have the same
//! noise, and what is hit at 2 % is hit at 5 % as well.
//!
//! Reference: Xi, Liu, Tao, Lu, *Tracking submarine moving target with the adaptive estimation methodology*; arrays,
//! course and gross errors are those of section 6 of its spec (the paper shows no numbers).

use nalgebra::{DMatrix, DVector};

use super::course::{Course, Trajectory, sample_count};
use crate::error::{Result, require_positive, require_probability};
use crate::model::motion::{ConstantAcceleration, KinematicNoise, Motion};
use crate::model::sensor::{RangeArray, Sensor};
use crate::stats::stream::Stream;

/// Epochs at the beginning that are complete and without gross errors.
const CLEAN: usize = 3;
/// Size of a gross error, metres.
const GROSS: (f64, f64) = (10.0, 100.0);

/// Positions of the three hydrophones of the BATS array, 3×3 metres, z positive down.
pub fn bats_hydrophones() -> DMatrix<f64> {
    DMatrix::from_row_slice(3, 3, &[0.0, 0.0, 250.0, 1000.0, 0.0, 252.0, 500.0, 866.0, 248.0])
}

/// Positions of the six hydrophones of the TOSS array, 6×3 metres: on a circle of 1200 m about (700, 500).
pub fn toss_hydrophones() -> DMatrix<f64> {
    let heights = [0.0, 12.0, -8.0, 15.0, -12.0, 5.0];
    DMatrix::from_fn(6, 3, |i, j| {
        let azimuth = (15.0 + 60.0 * i as f64).to_radians();
        match j {
            0 => 700.0 + 1200.0 * libm::cos(azimuth),
            1 => 500.0 + 1200.0 * libm::sin(azimuth),
            _ => 300.0 + heights[i],
        }
    })
}

/// How the target moves.
#[derive(Debug, Clone, PartialEq)]
pub enum Truth {
    /// On its course, in every run the same.
    Course,
    /// As the constant-acceleration model has it, from where the course begins; in every run another way.
    Drawn {
        /// Standard deviation of the jerk, constant over a step, m/s³.
        jerk_std: f64,
    },
}

/// What a scenario is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct UnderwaterSettings {
    /// Who listens, in 3 dimensions.
    pub array: RangeArray,
    /// Where the vessel goes, and for how long.
    pub course: Course,
    /// How it moves.
    pub truth: Truth,
    /// Seconds between two measurements.
    pub dt: f64,
    /// Probability of a gross error, of each range.
    pub gross: f64,
    /// Probability that a component is not observed.
    pub missing: f64,
}

/// A scenario from which recordings can be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Underwater {
    settings: UnderwaterSettings,
    /// The course, sampled. Of a drawn truth only its times and its first row count.
    course: Trajectory,
}

/// What one run recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Times and true states.
    pub truth: Trajectory,
    /// T measurements, NaN where not observed.
    pub values: Vec<DVector<f64>>,
    /// T×m: which of them have a gross error.
    pub gross: Vec<Vec<bool>>,
}

impl Underwater {
    /// The checked scenario.
    pub fn new(settings: UnderwaterSettings) -> Result<Self> {
        require_probability("gross", settings.gross)?;
        require_probability("missing", settings.missing)?;
        sample_count(settings.course.duration(), settings.dt)?;
        if let Truth::Drawn { jerk_std } = settings.truth {
            require_positive("jerk_std", jerk_std)?;
        }
        let course = settings.course.sample(settings.dt)?;
        let scenario = Self { settings, course };
        let motion = ConstantAcceleration::new(KinematicNoise::Std(vec![0.0; 3]))?;
        scenario.settings.array.check(&motion)?;
        Ok(scenario)
    }

    /// Who listens.
    pub fn array(&self) -> &RangeArray {
        &self.settings.array
    }

    /// The times of the measurements.
    pub fn times(&self) -> &[f64] {
        &self.course.times
    }

    /// The truth, where it is the same in every run.
    pub fn truth(&self) -> Option<&Trajectory> {
        (self.settings.truth == Truth::Course).then_some(&self.course)
    }

    /// Run `run` of a study with this seed.
    pub fn draw(&self, seed: u64, run: u64) -> Result<Recording> {
        let mut stream = Stream::new(seed, run);
        let truth = match self.settings.truth {
            Truth::Course => self.course.clone(),
            Truth::Drawn { jerk_std } => self.drawn(jerk_std, &mut stream)?,
        };
        let noise = self.settings.array.noise();
        let mut values = Vec::with_capacity(truth.times.len());
        let mut gross = Vec::with_capacity(truth.times.len());
        for k in 0..truth.times.len() {
            let mut value = self.settings.array.observe(&truth.state(k), None)?;
            let mut hit = vec![false; value.len()];
            for i in 0..value.len() {
                value[i] += libm::sqrt(noise[(i, i)]) * stream.normal();
                let (error, lost) = (self.gross_error(i, &mut stream), stream.uniform());
                if k < CLEAN {
                    continue;
                }
                if let Some(error) = error {
                    value[i] += error;
                    hit[i] = true;
                }
                if lost < self.settings.missing {
                    (value[i], hit[i]) = (f64::NAN, false);
                }
            }
            values.push(value);
            gross.push(hit);
        }
        Ok(Recording { truth, values, gross })
    }

    /// What is added to component i if it is hit, in its own unit. Takes its deviates in any case.
    fn gross_error(&self, i: usize, stream: &mut Stream) -> Option<f64> {
        let (hit, size, sign) = (stream.uniform(), stream.between(GROSS.0, GROSS.1), stream.uniform());
        let metres = if sign < 0.5 { -size } else { size };
        let range = i < self.settings.array.channels();
        (range && hit < self.settings.gross).then(|| metres / self.settings.array.metres_per_unit(i, None))
    }

    fn drawn(&self, jerk_std: f64, stream: &mut Stream) -> Result<Trajectory> {
        let motion = ConstantAcceleration::new(KinematicNoise::Std(vec![jerk_std; 3]))?;
        let mut truth = self.course.clone();
        let mut state = truth.state(0);
        for k in 1..truth.times.len() {
            let dt = truth.times[k] - truth.times[k - 1];
            state = motion.propagate(&state, dt);
            if let Some(noise) = motion.noise_input(dt) {
                let jerk = DVector::from_fn(3, |_, _| jerk_std * stream.normal());
                state += noise.gain * jerk;
            }
            truth.states.row_mut(k).tr_copy_from(&state);
        }
        Ok(truth)
    }
}
