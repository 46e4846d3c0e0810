//! The course of a vessel that keeps its speed: legs with a turn rate and a sink rate each.
//!
//! | symbol | name here   | meaning                                                                  |
//! |--------|-------------|--------------------------------------------------------------------------|
//! | ψ      | `heading`   | angle from x towards y, rad                                              |
//! | s      | `speed`     | in total, m/s                                                            |
//! | ω, w   | `turn_rate`, `sink_rate` | of a leg, rad/s and m/s, z positive down                    |
//! | ρ      | `ramp`      | time in which a leg's rates rise from 0, and in which they fall to 0 again, s |
//!
//! A leg from t₀ to t₁ has the rates g ω and g w with g(t) = min(1, (t − t₀)/ρ, (t₁ − t)/ρ): the ramps lie inside it.
//! ψ' = g ω,  z' = g w,  (x', y') = √(s² − z'²) (cos ψ, sin ψ).
//! ψ and z are the integrals in closed form; x and y by Gauss-Legendre quadrature with five points on pieces of at most a
//! quarter of a second that end where a rate has a kink: right to the rounding of their sum, whatever the sampling.
//! After the last leg the vessel goes straight on.
//!
//! Reference: the reference scenario of the underwater paper's spec, section 6. It leaves open where the ramps lie; inside
//! the legs is the reading that gives its tables for both arrays.

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result, require_finite, require_non_negative, require_positive};

/// Longest piece of the quadrature, seconds.
const PIECE: f64 = 0.25;
/// Abscissae in (0, 1) and weights of Gauss-Legendre quadrature (Abramowitz, Stegun, table 25.4).
const QUADRATURE: [(f64, f64); 5] = [
    (0.046_910_077_030_668, 0.118_463_442_528_094_54),
    (0.230_765_344_947_158_45, 0.239_314_335_249_683_23),
    (0.5, 0.284_444_444_444_444_44),
    (0.769_234_655_052_841_5, 0.239_314_335_249_683_23),
    (0.953_089_922_969_332, 0.118_463_442_528_094_54),
];

/// A part of a course.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leg {
    /// Seconds.
    pub duration: f64,
    /// From x towards y, rad/s.
    pub turn_rate: f64,
    /// Downwards, m/s.
    pub sink_rate: f64,
}

/// Where a vessel goes.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    /// Where it begins, metres, z positive down.
    pub start: [f64; 3],
    /// In which direction, from x towards y, rad.
    pub heading: f64,
    /// In total, m/s.
    pub speed: f64,
    /// Time in which the rates of a leg rise, and in which they fall, seconds.
    pub ramp: f64,
    /// One after the other.
    pub legs: Vec<Leg>,
}

/// Where and how fast a target was.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// T times, seconds.
    pub times: Vec<f64>,
    /// T×9 states: position, velocity, acceleration.
    pub states: DMatrix<f64>,
}

impl Trajectory {
    /// The state at time k.
    pub fn state(&self, k: usize) -> DVector<f64> {
        self.states.row(k).transpose()
    }
}

impl Default for Course {
    /// Straight, turn, straight, dive, turn back: 160 s at 15 m/s.
    fn default() -> Self {
        let leg = |duration, turn: f64, sink_rate| Leg {
            duration,
            turn_rate: turn.to_radians(),
            sink_rate,
        };
        Self {
            start: [-300.0, -250.0, 50.0],
            heading: 20_f64.to_radians(),
            speed: 15.0,
            ramp: 2.0,
            legs: vec![
                leg(40.0, 0.0, 0.0),
                leg(40.0, 3.0, 0.0),
                leg(20.0, 0.0, 0.0),
                leg(30.0, 0.0, 3.0),
                leg(30.0, -4.0, 0.0),
            ],
        }
    }
}

impl Course {
    /// Seconds from the first leg's begin to the last one's end.
    pub fn duration(&self) -> f64 {
        self.legs.iter().map(|leg| leg.duration).sum()
    }

    /// The truth every `dt` seconds from 0 to the end of the last leg.
    pub fn sample(&self, dt: f64) -> Result<Trajectory> {
        self.check()?;
        let samples = sample_count(self.duration(), dt)?;
        let times: Vec<f64> = (0..samples).map(|k| k as f64 * dt).collect();
        let kinks = self.kinks();
        let mut plan = [self.start[0], self.start[1]];
        let mut states = DMatrix::zeros(samples, 9);
        let mut now = 0.0;
        for (k, &time) in times.iter().enumerate() {
            let inside = kinks.iter().copied().filter(|&kink| now < kink && kink < time);
            for end in inside.chain([time]).collect::<Vec<_>>() {
                self.advance(&mut plan, now, end);
                now = end;
            }
            let here = self.at(time);
            let [x, y] = plan;
            let row = [
                &[x, y, here.depth],
                here.velocity.as_slice(),
                here.acceleration.as_slice(),
            ]
            .concat();
            states.row_mut(k).copy_from_slice(&row);
        }
        Ok(Trajectory { times, states })
    }

    fn check(&self) -> Result<()> {
        require_finite("start", &self.start)?;
        require_finite("heading", [&self.heading])?;
        require_positive("speed", self.speed)?;
        require_non_negative("ramp", self.ramp)?;
        for leg in &self.legs {
            require_positive("duration of a leg", leg.duration)?;
            require_finite("turn_rate", [&leg.turn_rate])?;
            require_finite("sink_rate", [&leg.sink_rate])?;
            let ramped = leg.turn_rate != 0.0 || leg.sink_rate != 0.0;
            if ramped && leg.duration < 2.0 * self.ramp {
                let requirement = "must be at least twice the ramp, which the rates rise and fall in";
                return Err(Error::invalid("duration of a leg", leg.duration, requirement));
            }
            if leg.sink_rate.abs() >= self.speed {
                return Err(Error::invalid("sink_rate", leg.sink_rate, "must be below the speed"));
            }
        }
        Ok(())
    }

    /// Where a rate has a kink or a step, in the order of time.
    fn kinks(&self) -> Vec<f64> {
        let mut out = Vec::with_capacity(3 * self.legs.len());
        let mut begin = 0.0;
        for leg in &self.legs {
            let end = begin + leg.duration;
            out.extend([begin + self.ramp, end - self.ramp, end]);
            begin = end;
        }
        out.sort_by(f64::total_cmp);
        out
    }

    /// Adds the way in the plane from one time to another without a kink between them.
    fn advance(&self, plan: &mut [f64; 2], from: f64, to: f64) {
        let pieces = libm::ceil((to - from) / PIECE);
        let step = (to - from) / pieces.max(1.0);
        for piece in 0..count(pieces) {
            let begin = from + piece as f64 * step;
            for (at, weight) in QUADRATURE {
                let velocity = self.at(begin + at * step).velocity;
                plan[0] += weight * step * velocity[0];
                plan[1] += weight * step * velocity[1];
            }
        }
    }

    /// Everything at a time that has a closed form.
    fn at(&self, time: f64) -> Motion {
        let (mut heading, mut depth) = (self.heading, self.start[2]);
        let mut now = Ramp::default();
        let mut rates = (0.0, 0.0);
        let mut begin = 0.0;
        for leg in &self.legs {
            let ramp = Ramp::at(time - begin, leg.duration, self.ramp);
            heading += leg.turn_rate * ramp.integral;
            depth += leg.sink_rate * ramp.integral;
            if time >= begin {
                (now, rates) = (ramp, (leg.turn_rate, leg.sink_rate));
            }
            begin += leg.duration;
        }
        let (turn, sink, sink_slope) = (rates.0 * now.value, rates.1 * now.value, rates.1 * now.slope);
        let level = libm::sqrt(self.speed * self.speed - sink * sink);
        let level_slope = -sink * sink_slope / level;
        let (cos, sin) = (libm::cos(heading), libm::sin(heading));
        Motion {
            depth,
            velocity: [level * cos, level * sin, sink],
            acceleration: [
                level_slope * cos - level * turn * sin,
                level_slope * sin + level * turn * cos,
                sink_slope,
            ],
        }
    }
}

struct Motion {
    depth: f64,
    velocity: [f64; 3],
    acceleration: [f64; 3],
}

/// g of a leg, its slope and its integral from the leg's begin.
#[derive(Default)]
struct Ramp {
    value: f64,
    slope: f64,
    integral: f64,
}

impl Ramp {
    /// `time` seconds after the leg's begin.
    fn at(time: f64, duration: f64, ramp: f64) -> Self {
        let time = time.clamp(0.0, duration);
        let left = duration - time;
        let whole = duration - ramp;
        if time < ramp {
            Self {
                value: time / ramp,
                slope: 1.0 / ramp,
                integral: time * time / (2.0 * ramp),
            }
        } else if left < ramp || left == 0.0 {
            let value = if ramp > 0.0 { left / ramp } else { 0.0 };
            Self {
                value,
                slope: if left > 0.0 { -1.0 / ramp } else { 0.0 },
                integral: whole - left * value / 2.0,
            }
        } else {
            Self {
                value: 1.0,
                slope: 0.0,
                integral: time - ramp / 2.0,
            }
        }
    }
}

/// A number that is whole, not negative and far below 2^32.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn count(whole: f64) -> usize {
    whole as usize
}

/// How many samples `dt` seconds apart fit into this many seconds, the first at 0.
pub(super) fn sample_count(duration: f64, dt: f64) -> Result<usize> {
    const MOST: f64 = 1e7;
    require_positive("dt", dt)?;
    // A duration that is a multiple of dt keeps its last sample in spite of rounding.
    let steps = libm::floor(duration / dt + 1e-9);
    if steps < MOST {
        return Ok(count(steps) + 1);
    }
    Err(Error::invalid("dt", dt, "gives more than ten million samples"))
}
