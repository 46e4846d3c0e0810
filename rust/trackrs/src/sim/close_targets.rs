//! Targets side by side, reported one at a time: the scenario of the NPDA paper.
//!
//! | symbol | name here    | meaning                                                            |
//! |--------|--------------|--------------------------------------------------------------------|
//! | N, d   | `targets`, `separation` | how many, and metres between neighbours                 |
//! | K      | `reports`    | one every `interval` seconds, the first after one interval         |
//! | P_c    | `clutter`    | probability that a report is of no target                          |
//!
//! Truth: target i begins at (500, 1000 + d i) m and keeps v = (100, 0) m/s. The radar stands in the origin: range with
//! 20 m, bearing with 1 mrad. Report k is of the target whose turn it is; with probability P_c it is false instead, uniform
//! over ±1000 m × ±(½ (N − 1) d + 500) m about the middle of the targets, the same area A as 4000 (d + 500) m² for N = 3.
//!
//! Every report takes the same number of deviates whatever order and P_c are: runs that differ in these have the same noise.
//!
//! Reference: Liu, Xie, Huang (2009), §5, and section 4 of its spec: the paper leaves open order, number of reports and the
//! time of the first one.

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result, require_positive, require_probability};
use crate::gaussian::Gaussian;
use crate::model::sensor::{RangeBearing, Sensor};
use crate::stats::stream::Stream;

const START: [f64; 2] = [500.0, 1000.0];
const SPEED: f64 = 100.0;
const RANGE_STD: f64 = 20.0;
const BEARING_STD: f64 = 1e-3;
/// Half the clutter's area along the way, and beyond the outer targets, metres.
const MARGINS: [f64; 2] = [1000.0, 500.0];
/// What a filter is told of the start: variances of position and velocity.
const VARIANCES: [f64; 2] = [100.0, 9.0];

/// Whose turn it is to be reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// 0 1 2 0 1 2 …
    Cyclic,
    /// 0 1 2 2 1 0 …
    Boustrophedon,
    /// Any, each as likely as any other.
    Random,
}

/// What the scenario is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloseTargetsSettings {
    /// How many.
    pub targets: usize,
    /// Metres between neighbours.
    pub separation: f64,
    /// How many.
    pub reports: usize,
    /// Seconds between reports.
    pub interval: f64,
    /// Whose turn it is.
    pub order: Order,
    /// Probability that a report is false, below 1.
    pub clutter: f64,
}

impl Default for CloseTargetsSettings {
    fn default() -> Self {
        Self {
            targets: 3,
            separation: 300.0,
            reports: 60,
            interval: 3.0,
            order: Order::Cyclic,
            clutter: 0.0,
        }
    }
}

/// The scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct CloseTargets {
    settings: CloseTargetsSettings,
    radar: RangeBearing,
}

/// What one run reports.
#[derive(Debug, Clone, PartialEq)]
pub struct Reports {
    /// Range and bearing.
    pub values: Vec<DVector<f64>>,
    /// Whose they are; `None` where they are false.
    pub origins: Vec<Option<usize>>,
}

impl CloseTargets {
    /// The checked scenario.
    pub fn new(settings: CloseTargetsSettings) -> Result<Self> {
        if settings.targets == 0 {
            return Err(Error::invalid("targets", 0, "must be at least 1"));
        }
        require_positive("separation", settings.separation)?;
        require_positive("interval", settings.interval)?;
        require_probability("clutter", settings.clutter)?;
        let radar = RangeBearing::new([0.0, 0.0], RANGE_STD, BEARING_STD)?;
        Ok(Self { settings, radar })
    }

    /// What it is made of.
    pub fn settings(&self) -> &CloseTargetsSettings {
        &self.settings
    }

    /// Who reports.
    pub fn radar(&self) -> &RangeBearing {
        &self.radar
    }

    /// The time of report k, seconds.
    pub fn time(&self, k: usize) -> f64 {
        (k + 1) as f64 * self.settings.interval
    }

    /// Where target i is at a time: position and velocity, length 4.
    pub fn truth(&self, target: usize, time: f64) -> DVector<f64> {
        let y = START[1] + self.settings.separation * target as f64;
        DVector::from_vec(vec![START[0] + SPEED * time, y, SPEED, 0.0])
    }

    /// What a filter is told of target i at time 0.
    pub fn initial(&self, target: usize) -> Gaussian {
        let [position, velocity] = VARIANCES;
        Gaussian {
            mean: self.truth(target, 0.0),
            cov: DMatrix::from_diagonal(&DVector::from_vec(vec![position, position, velocity, velocity])),
        }
    }

    /// Half the sides of the area of false reports, metres.
    fn half_sides(&self) -> [f64; 2] {
        let spread = 0.5 * (self.settings.targets - 1) as f64 * self.settings.separation;
        [MARGINS[0], MARGINS[1] + spread]
    }

    /// The area that false reports are spread over, m².
    pub fn clutter_area(&self) -> f64 {
        let [a, b] = self.half_sides();
        4.0 * a * b
    }

    /// Run `run` of a study with this seed.
    pub fn draw(&self, seed: u64, run: u64) -> Result<Reports> {
        let mut stream = Stream::new(seed, run);
        let CloseTargetsSettings { targets, reports, .. } = self.settings;
        let all: Vec<usize> = (0..targets).collect();
        let mut out = Reports {
            values: Vec::with_capacity(reports),
            origins: Vec::with_capacity(reports),
        };
        for k in 0..reports {
            let time = self.time(k);
            let drawn = stream.choice(&all).copied().unwrap_or(0);
            let target = match self.settings.order {
                Order::Cyclic => k % targets,
                Order::Boustrophedon if (k / targets) % 2 == 0 => k % targets,
                Order::Boustrophedon => targets - 1 - k % targets,
                Order::Random => drawn,
            };
            let mut value = self.radar.observe(&self.truth(target, time), None)?;
            value[0] += RANGE_STD * stream.normal();
            value[1] += BEARING_STD * stream.normal();
            let ([a, b], false_report) = (self.half_sides(), stream.uniform());
            let offset = [stream.between(-a, a), stream.between(-b, b)];
            let mut origin = Some(target);
            if false_report < self.settings.clutter {
                let middle = 0.5 * (self.truth(0, time) + self.truth(targets - 1, time));
                let place = DVector::from_vec(vec![middle[0] + offset[0], middle[1] + offset[1], 0.0, 0.0]);
                value = self.radar.observe(&place, None)?;
                origin = None;
            }
            out.values.push(value);
            out.origins.push(origin);
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(order: Order, clutter: f64) -> Reports {
        let settings = CloseTargetsSettings {
            order,
            clutter,
            ..CloseTargetsSettings::default()
        };
        CloseTargets::new(settings).unwrap().draw(7, 3).unwrap()
    }

    #[test]
    fn orders_are_as_they_are_called() {
        let of = |order| -> Vec<usize> { draw(order, 0.0).origins[..7].iter().flatten().copied().collect() };
        assert_eq!(of(Order::Cyclic), [0, 1, 2, 0, 1, 2, 0]);
        assert_eq!(of(Order::Boustrophedon), [0, 1, 2, 2, 1, 0, 0]);
        assert!(draw(Order::Random, 0.0).origins.iter().all(Option::is_some));
    }

    #[test]
    fn clutter_changes_only_what_it_hits() {
        let (clean, hit) = (draw(Order::Cyclic, 0.0), draw(Order::Cyclic, 0.3));
        let false_reports = hit.origins.iter().filter(|origin| origin.is_none()).count();
        assert!((8..30).contains(&false_reports), "{false_reports}");
        for k in 0..60 {
            assert_eq!(hit.origins[k].is_some(), hit.values[k] == clean.values[k]);
        }
    }

    #[test]
    fn the_noise_is_the_radars() {
        let scene = CloseTargets::new(CloseTargetsSettings {
            reports: 4000,
            interval: 1e-3,
            ..CloseTargetsSettings::default()
        })
        .unwrap();
        let reports = scene.draw(1, 0).unwrap();
        let mut squares = [0.0; 2];
        for (k, (value, origin)) in reports.values.iter().zip(&reports.origins).enumerate() {
            let expected = scene
                .radar()
                .observe(&scene.truth(origin.unwrap(), scene.time(k)), None)
                .unwrap();
            squares[0] += ((value[0] - expected[0]) / 20.0).powi(2) / 4000.0;
            squares[1] += ((value[1] - expected[1]) / 1e-3).powi(2) / 4000.0;
        }
        // Four standard deviations of a mean of squares.
        assert!(
            squares
                .iter()
                .all(|mean| (mean - 1.0).abs() < 4.0 * (2.0_f64 / 4000.0).sqrt()),
            "{squares:?}"
        );
        assert_eq!(scene.clutter_area(), 4000.0 * 800.0);
    }
}
