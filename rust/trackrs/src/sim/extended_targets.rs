//! Targets that give many detections in a scan, in clutter: the scenarios of the extended-target paper, and any other.
//!
//! | symbol   | name here               | meaning                                                                   |
//! |----------|-------------------------|---------------------------------------------------------------------------|
//! | x        | `start`                 | x y vx vy at the beginning of a life                                      |
//! | γ        | `rate`                  | mean detections of a target in a scan in which it is detected             |
//! | p_D      | `detection_probability` | probability that a living target is detected at all                       |
//! | λ_c      | `clutter`               | mean false detections in a scan, uniform on ±1000 m × ±1000 m             |
//! | κ        | `clutter_density`       | λ_c / 2000² m⁻²                                                           |
//! | σ        | `noise_std`             | of a detection about the point of the shape that it comes from            |
//! | R = r² I | `sensor_std` = r        | what a filter is told of a detection about its target's centre            |
//!
//! 1. Scan k = 0 … K − 1 is at t = (k + 1) `interval`. A target lives from `first` to `last`, both included, and keeps its
//!    velocity: x(t) = start + (t − first) v.
//! 2. With probability p_D it gives n ~ Poisson(γ) detections, else none. Each is H x(t) + C p + σ (e₁, e₂), p uniform on the
//!    shape, C the turn of its x axis along the velocity. A blob has no p, and its own spread in place of σ.
//! 3. Clutter: Poisson(λ_c) points.
//! 4. r², unless given, is the mean variance of an axis of C p + σ e, over all targets.
//!
//! The stream draws target after target, scan after scan of its life: whether detected, n, and for each detection two
//! uniform and two normal deviates, needed or not; then the clutter, scan after scan. So runs that differ in p_D, λ_c, σ,
//! in shapes, paths or the told r have the same deviates elsewhere. A scan holds target after target, clutter last.
//!
//! Reference: sections 2 and 7 of the spec of the extended-target paper. [`crossing`]: the paper prints velocities of
//! zero, with which nothing can cross; here they are those that meet in the origin at 50 s. [`parallel`]: the text says
//! 80 m apart, the printed states 70 m. The paper's shapes have no sizes; those of [`Shape::of_the_spec`] are the spec's.

use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result, require_finite, require_non_negative, require_positive, require_probability};
use crate::gaussian::Gaussian;
use crate::scan::Scan;
use crate::sim::shape::Shape;
use crate::stats::stream::Stream;

/// The name of the sensor in every scan.
pub const SENSOR: &str = "radar";
/// Half the sides of the area of clutter, metres.
const HALF_SIDE: f64 = 1000.0;
/// R of a filter for the spec's three shapes, m²; theirs are 628, 671 and 775.
const PRINTED_VARIANCE: f64 = 650.0;
/// What a filter is told of a birth: variances of position and velocity.
const BIRTH_VARIANCES: [f64; 2] = [2500.0, 625.0];
/// Detections of a run that a scenario may have on average.
const MOST_DETECTIONS: f64 = 1e7;
/// A scan so close to the ends of a life belongs to it, in intervals.
const TOLERANCE: f64 = 1e-9;

/// One target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtendedTarget {
    /// Position and velocity at `first`: x y vx vy.
    pub start: [f64; 4],
    /// Begin of its life, seconds.
    pub first: f64,
    /// End of its life, seconds; may be infinite.
    pub last: f64,
    /// Mean detections in a scan.
    pub rate: f64,
    /// What they come from.
    pub shape: Shape,
}

/// What a scenario is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtendedTargetsSettings {
    /// At least one.
    pub targets: Vec<ExtendedTarget>,
    /// Where a filter is told that targets may begin; none: where they do.
    pub births: Vec<[f64; 2]>,
    /// How many.
    pub scans: usize,
    /// Seconds between scans, and before the first one.
    pub interval: f64,
    /// Mean false detections in a scan.
    pub clutter: f64,
    /// That a living target is detected at all.
    pub detection_probability: f64,
    /// Of a detection about the point of the shape that it comes from, metres.
    pub noise_std: f64,
    /// What a filter is told of a detection about its target's centre, metres; `None`: as it is on average.
    pub sensor_std: Option<f64>,
}

impl Default for ExtendedTargetsSettings {
    fn default() -> Self {
        Self {
            targets: Vec::new(),
            births: Vec::new(),
            scans: 100,
            interval: 1.0,
            clutter: 10.0,
            detection_probability: 0.99,
            noise_std: 20.0,
            sensor_std: None,
        }
    }
}

/// Three targets that meet in the origin at 50 s; the third lives from 20 to 90 s.
pub fn crossing(shapes: [Shape; 3], rates: [f64; 3]) -> ExtendedTargetsSettings {
    const MEETING: f64 = 50.0;
    let lives = [
        [-800.0, -600.0, 1.0, 100.0],
        [-900.0, 100.0, 1.0, 100.0],
        [-700.0, 700.0, 20.0, 90.0],
    ];
    let targets = lives.into_iter().zip(shapes).zip(rates);
    printed(targets.map(|(([x, y, first, last], shape), rate)| ExtendedTarget {
        start: [x, y, -x / (MEETING - first), -y / (MEETING - first)],
        first,
        last,
        rate,
        shape,
    }))
}

/// Two targets side by side at 16 m/s, `spacing` metres apart.
pub fn parallel(shapes: [Shape; 2], rates: [f64; 2], spacing: f64) -> ExtendedTargetsSettings {
    let targets = [600.0, 600.0 + spacing].into_iter().zip(shapes).zip(rates);
    printed(targets.map(|((y, shape), rate)| ExtendedTarget {
        start: [-800.0, y, 16.0, 0.0],
        first: 1.0,
        last: 100.0,
        rate,
        shape,
    }))
}

/// With the spec's shapes a filter is told what the spec tells it.
fn printed(targets: impl Iterator<Item = ExtendedTarget>) -> ExtendedTargetsSettings {
    let targets: Vec<_> = targets.collect();
    let shapes = Shape::of_the_spec();
    let all = targets.iter().all(|target| shapes.contains(&target.shape));
    ExtendedTargetsSettings {
        targets,
        sensor_std: all.then(|| PRINTED_VARIANCE.sqrt()),
        ..ExtendedTargetsSettings::default()
    }
}

/// A checked scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtendedTargets {
    settings: ExtendedTargetsSettings,
}

/// What one scan detects.
#[derive(Debug, Clone, PartialEq)]
pub struct Detections {
    /// Positions, of the sensor [`SENSOR`].
    pub scan: Scan,
    /// Whose they are; `None` where they are clutter.
    pub origins: Vec<Option<usize>>,
}

impl ExtendedTargets {
    /// The checked scenario.
    pub fn new(settings: ExtendedTargetsSettings) -> Result<Self> {
        require_positive("interval", settings.interval)?;
        require_non_negative("clutter", settings.clutter)?;
        require_probability("detection_probability", settings.detection_probability)?;
        require_non_negative("noise_std", settings.noise_std)?;
        settings
            .sensor_std
            .map_or(Ok(()), |std| require_positive("sensor_std", std))?;
        if settings.targets.is_empty() {
            return Err(Error::invalid("targets", "none", "must be at least one"));
        }
        require_finite("births", settings.births.as_flattened())?;
        let mut detections = settings.clutter;
        for (i, target) in settings.targets.iter().enumerate() {
            require_finite(&format!("start of target {i}"), &target.start)?;
            require_finite(&format!("first of target {i}"), [&target.first])?;
            require_positive(&format!("rate of target {i}"), target.rate)?;
            target.shape.require_valid()?;
            detections += target.rate + 1.0;
        }
        let expected = detections * settings.scans as f64;
        if expected > MOST_DETECTIONS {
            let requirement = format!("must give at most {MOST_DETECTIONS:.0e} in a run, not {expected:.1e}");
            return Err(Error::invalid("mean detections in a scan", detections, &requirement));
        }
        let scene = Self { settings };
        for (i, target) in scene.settings.targets.iter().enumerate() {
            if !(0..scene.settings.scans).any(|k| scene.lives(target, scene.time(k))) {
                let life = format!("{} to {} s", target.first, target.last);
                let requirement = "must hold the time of a scan";
                return Err(Error::invalid(&format!("life of target {i}"), life, requirement));
            }
        }
        Ok(scene)
    }

    /// What it is made of.
    pub fn settings(&self) -> &ExtendedTargetsSettings {
        &self.settings
    }

    /// The time of scan k, seconds.
    pub fn time(&self, k: usize) -> f64 {
        (k + 1) as f64 * self.settings.interval
    }

    fn lives(&self, target: &ExtendedTarget, time: f64) -> bool {
        let tolerance = TOLERANCE * self.settings.interval;
        time >= target.first - tolerance && time <= target.last + tolerance
    }

    /// Where target i is at a time: position and velocity; `None` where it does not live, or is none.
    pub fn truth(&self, target: usize, time: f64) -> Option<[f64; 4]> {
        let target = self.settings.targets.get(target)?;
        let [x, y, vx, vy] = target.start;
        let age = time - target.first;
        self.lives(target, time).then_some([x + age * vx, y + age * vy, vx, vy])
    }

    /// What a filter is told of where targets may begin.
    pub fn births(&self) -> Vec<Gaussian> {
        let [position, velocity] = BIRTH_VARIANCES;
        let cov = DMatrix::from_diagonal(&DVector::from_vec(vec![position, position, velocity, velocity]));
        let birth = |x: f64, y: f64| Gaussian {
            mean: DVector::from_vec(vec![x, y, 0.0, 0.0]),
            cov: cov.clone(),
        };
        if self.settings.births.is_empty() {
            let starts = self.settings.targets.iter().map(|target| target.start);
            return starts.map(|[x, y, ..]| birth(x, y)).collect();
        }
        self.settings.births.iter().map(|&[x, y]| birth(x, y)).collect()
    }

    /// False detections per m² and scan.
    pub fn clutter_density(&self) -> f64 {
        self.settings.clutter / (4.0 * HALF_SIDE * HALF_SIDE)
    }

    /// What a filter with one rate for all is told: the median of the targets' rates.
    pub fn detections_per_target(&self) -> f64 {
        let mut rates: Vec<f64> = self.settings.targets.iter().map(|target| target.rate).collect();
        rates.sort_by(f64::total_cmp);
        let middle = |k: usize| rates.get(k).copied().unwrap_or(0.0);
        0.5 * (middle((rates.len() - 1) / 2) + middle(rates.len() / 2))
    }

    /// Standard deviation of a detection about its target's centre, as a filter is told.
    pub fn sensor_std(&self) -> f64 {
        let targets = &self.settings.targets;
        let variance = |target: &ExtendedTarget| target.shape.mean_variance(self.settings.noise_std);
        let mean = targets.iter().map(variance).sum::<f64>() / targets.len() as f64;
        self.settings.sensor_std.unwrap_or(mean.sqrt())
    }

    /// Run `run` of a study with this seed.
    pub fn draw(&self, seed: u64, run: u64) -> Result<Vec<Detections>> {
        let mut stream = Stream::new(seed, run);
        let empty = |k| Detections {
            scan: Scan::new(self.time(k), SENSOR, Vec::new()),
            origins: Vec::new(),
        };
        let mut scans: Vec<Detections> = (0..self.settings.scans).map(empty).collect();
        for (i, target) in self.settings.targets.iter().enumerate() {
            for detections in &mut scans {
                if let Some(state) = self.truth(i, detections.scan.time) {
                    self.detect(&mut stream, target, state, i, detections)?;
                }
            }
        }
        for detections in &mut scans {
            for _ in 0..stream.poisson(self.settings.clutter)? {
                let place = [(); 2].map(|()| stream.between(-HALF_SIDE, HALF_SIDE));
                detections.push(place, None);
            }
        }
        Ok(scans)
    }

    /// The detections of a target in a scan.
    fn detect(
        &self,
        stream: &mut Stream,
        target: &ExtendedTarget,
        [x, y, vx, vy]: [f64; 4],
        origin: usize,
        out: &mut Detections,
    ) -> Result<()> {
        let detected = stream.uniform() < self.settings.detection_probability;
        let speed = libm::hypot(vx, vy);
        let [c, s] = if speed > 0.0 {
            [vx / speed, vy / speed]
        } else {
            [1.0, 0.0]
        };
        let std = target.shape.noise(self.settings.noise_std);
        for _ in 0..stream.poisson(target.rate)? {
            let [u, v] = [(); 2].map(|()| stream.uniform());
            let [px, py] = target.shape.point(u, v);
            let [e1, e2] = [(); 2].map(|()| stream.normal());
            if detected {
                let place = [x + (c * px - s * py) + std * e1, y + (s * px + c * py) + std * e2];
                out.push(place, Some(origin));
            }
        }
        Ok(())
    }
}

impl Detections {
    fn push(&mut self, place: [f64; 2], origin: Option<usize>) {
        self.scan.values.push(DVector::from_row_slice(&place));
        self.origins.push(origin);
    }
}
