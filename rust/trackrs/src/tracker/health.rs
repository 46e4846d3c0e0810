//! Whether a track is what its covariance says: a test of its last updates and of its last chances to be seen.
//!
//! | symbol | name here   | meaning                                                                             |
//! |--------|-------------|-------------------------------------------------------------------------------------|
//! | W      | [`WINDOW`]  | updates, and scans of a sensor, that are looked at                                  |
//! | ν, m   | `nis`, `dof`| normalised innovation squared of an update, chi-square of m degrees of freedom      |
//! | g, p   | `edge`      | the gate's threshold for m components, and its probability                          |
//! | P_D    | `detection` | probability that the sensor reports a target                                        |
//! | α      | [`ALPHA`]   | bound on the probability of each alarm, if the model is right                       |
//!
//! 1. Σ ν over the last W updates is too large above u, and too small below l. Both are bounds of Chernoff, with the chi-square
//!    distribution cut off at the gate, so they hold whatever the gate and for sensors of different sizes together:
//!    u = min_θ (Σ ln M_m(θ) + ln 1/α) / θ,  l = max_θ −(Σ ln M_m(−θ) + ln 1/α) / θ,  M_m(θ) = E[e^(θν) | ν ≤ g].
//! 2. A sensor misses a track if k or more of its last W scans gave it no report, where P(Bin(W, 1 − P_D p) ≥ k) ≤ α;
//!    1 − P_D p is taken as [`LEAST_MISSED`] at least. One with fewer scans has no say once W scans of all gave no report.
//! 3. A track is *degraded* while Σ ν is too large or too small. It is *lost* once Σ ν has been too large for W further updates, or
//!    while every sensor that ever hit it misses it. Otherwise it is *healthy*.
//!
//! Updates count from confirmation on. By the sum over tests the probability of a false alarm is at most 3 α per scan of a track:
//! 3e-5 in 1,000 scans. Nothing here changes an estimate, and nothing of it is an error in strict mode: the input is not at fault.
//!
//! References: Bar-Shalom, Li, Kirubarajan (2001), Estimation with Applications to Tracking and Navigation, §5.4.2 (NIS over a
//! window); Chernoff (1952), Annals of Mathematical Statistics 23(4).

use serde::{Deserialize, Serialize};

use super::config::TrackerConfig;
use super::live::LiveTrack;
use super::look::Look;
use super::multi_target::MultiTargetTracker;
use crate::error::Result;
use crate::event::EventCode;
use crate::model::Sensor;
use crate::track::Health;

/// Updates, and scans of a sensor, that are looked at.
const WINDOW: usize = SCANS as usize;
const SCANS: u8 = 10;
/// Bound on the probability of each alarm, if the model is right.
const ALPHA: f64 = 1e-8;
/// No sensor misses less often than that.
const LEAST_MISSED: f64 = 0.01;
/// Values of θ that are tried.
const TRIALS: i32 = 16;
/// Intervals of an integral by Simpson's rule.
const INTERVALS: u32 = 96;

/// What a track's last updates were like.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Monitor {
    nis: [f64; WINDOW],
    dof: [u8; WINDOW],
    /// Where the next update goes, and their number up to the window.
    next: u8,
    updates: u8,
    /// Updates in a row with too large a sum.
    above: u32,
    /// Scans of sensors that have hit the track since one of them did.
    since: u32,
    pub(super) health: Health,
    /// Updates in the scan that is being worked on.
    #[serde(skip)]
    new: u32,
}

impl Monitor {
    /// Whether there is nothing to save.
    pub(super) fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Books an update.
    pub(super) fn hit(&mut self, nis: f64, dof: usize) {
        let at = usize::from(self.next) % WINDOW;
        self.nis[at] = nis;
        self.dof[at] = u8::try_from(dof).unwrap_or(u8::MAX);
        self.next = u8::try_from(at + 1).unwrap_or(0);
        self.updates = self.updates.saturating_add(1).min(SCANS);
        self.new = self.new.saturating_add(1);
    }

    /// Books whether a scan of a sensor that has hit the track gave it a report.
    pub(super) fn look(&mut self, hit: bool) {
        self.since = if hit { 0 } else { self.since.saturating_add(1) };
    }

    /// Sum of ν over the window, once it is full.
    fn sum(&self) -> Option<f64> {
        (usize::from(self.updates) >= WINDOW).then(|| self.nis.iter().sum())
    }

    /// Decides after a scan.
    fn judge(&mut self, limits: &mut Limits, missed: bool) {
        let new = std::mem::take(&mut self.new);
        let mut degraded = false;
        if let Some(sum) = self.sum() {
            let bounds = limits.of(&self.dof);
            let above = sum > bounds.upper;
            self.above = if above { self.above.saturating_add(new) } else { 0 };
            degraded = above || sum < bounds.lower;
        }
        self.health = if missed || self.above as usize > WINDOW {
            Health::Lost
        } else if degraded {
            Health::Degraded
        } else {
            Health::Healthy
        };
    }
}

/// Between which Σ ν lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    lower: f64,
    upper: f64,
}

/// θ, and by degrees of freedom ln M(θ).
#[derive(Debug, Clone)]
struct Trial {
    theta: f64,
    log_moments: Vec<f64>,
}

/// The bounds of a tracker, found when they are asked for.
#[derive(Debug, Clone, Default)]
pub(super) struct Limits {
    upper: Vec<Trial>,
    lower: Vec<Trial>,
    /// Where all updates have so many degrees of freedom.
    alike: Vec<Bounds>,
    /// The last others.
    mixed: Option<([u8; WINDOW], Bounds)>,
    /// By the sensor's place in the configuration: how many misses are too many.
    most_missed: Vec<u32>,
}

impl Limits {
    fn new(config: &TrackerConfig) -> Result<Self> {
        let most = config.sensors.values().map(Sensor::measurement_dim).max().unwrap_or(0);
        let p = config.gate.probability();
        let edges = config.gate.thresholds(most)?;
        let trials = |theta: &dyn Fn(i32) -> f64| -> Vec<Trial> {
            let moments = |theta: f64| {
                (1..)
                    .zip(&edges[1..])
                    .map(move |(dof, &edge)| log_moment(theta, dof, edge))
            };
            let trial = |k: i32| Trial {
                theta: theta(k).abs(),
                log_moments: std::iter::once(0.0).chain(moments(theta(k))).collect(),
            };
            (0..TRIALS).map(trial).collect()
        };
        // The best θ lies below one half, where moments end without a gate, or within some multiples of 1/g.
        let widest = edges.last().map_or(0.45, |edge| (16.0 / edge).max(0.45));
        let mut limits = Self {
            upper: trials(&|k| widest * libm::pow(1.2, f64::from(k + 1 - TRIALS))),
            lower: trials(&|k| -0.3 * libm::pow(1.35, f64::from(k))),
            most_missed: config
                .sensors
                .keys()
                .map(|name| most_missed(1.0 - config.odds(name).detection * p))
                .collect(),
            ..Self::default()
        };
        for dof in 0..=most {
            let window = [u8::try_from(dof).unwrap_or(u8::MAX); WINDOW];
            let bounds = limits.bounds(&window);
            limits.alike.push(bounds);
        }
        Ok(limits)
    }

    /// The bounds for updates of these degrees of freedom.
    fn of(&mut self, dof: &[u8; WINDOW]) -> Bounds {
        if let Some(&bounds) = self
            .alike
            .get(usize::from(dof[0]))
            .filter(|_| dof.iter().all(|d| *d == dof[0]))
        {
            return bounds;
        }
        let mut key = *dof;
        key.sort_unstable();
        match self.mixed {
            Some((known, bounds)) if known == key => bounds,
            _ => {
                let bounds = self.bounds(&key);
                self.mixed = Some((key, bounds));
                bounds
            }
        }
    }

    fn bounds(&self, dof: &[u8]) -> Bounds {
        let cost = -libm::log(ALPHA);
        let bound = |trial: &Trial| {
            let moments = dof.iter().map(|&d| trial.log_moments.get(usize::from(d)).copied());
            let sum = moments.map(|moment| moment.unwrap_or(f64::INFINITY)).sum::<f64>();
            (sum + cost) / trial.theta
        };
        Bounds {
            upper: self.upper.iter().map(bound).fold(f64::INFINITY, f64::min),
            lower: self
                .lower
                .iter()
                .map(|trial| -bound(trial))
                .fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

/// ln E[e^(θν) | ν ≤ g], ν chi-square.
fn log_moment(theta: f64, dof: usize, edge: f64) -> f64 {
    let half = 0.5 * dof as f64;
    if !edge.is_finite() {
        let base = 1.0 - 2.0 * theta;
        return if base > 0.0 {
            -half * libm::log(base)
        } else {
            f64::INFINITY
        };
    }
    // ν = u²: the density of u is in proportion to u^(m−1) e^(−u²/2), without a pole.
    let step = edge.sqrt() / f64::from(INTERVALS);
    let power = i32::try_from(dof).unwrap_or(i32::MAX) - 1;
    let (mut with, mut without) = (0.0, 0.0);
    for k in 0..=INTERVALS {
        let u = step * f64::from(k);
        let weight = if k == 0 || k == INTERVALS {
            1.0
        } else {
            2.0 + 2.0 * f64::from(k % 2)
        };
        let density = weight * powi(u, power) * libm::exp(-0.5 * u * u);
        with += density * libm::exp(theta * u * u);
        without += density;
    }
    libm::log(with / without)
}

/// u to a whole power, not negative.
fn powi(u: f64, power: i32) -> f64 {
    (0..power).fold(1.0, |product, _| product * u)
}

/// The least k with P(Bin(W, q) ≥ k) ≤ α; more than W if there is none.
fn most_missed(q: f64) -> u32 {
    let q = q.max(LEAST_MISSED);
    let mut tail = 0.0;
    let mut choose = 1.0;
    let window = u32::from(SCANS);
    for k in (0..=window).rev() {
        tail += choose * libm::pow(q, f64::from(k)) * libm::pow(1.0 - q, f64::from(window - k));
        if tail > ALPHA {
            return k + 1;
        }
        choose *= f64::from(k) / f64::from(window - k + 1);
    }
    0
}

impl LiveTrack {
    /// Whether every sensor that ever hit it misses it.
    fn is_missed(&self, most_missed: &[u32]) -> bool {
        let window = u32::from(SCANS);
        let mut any = false;
        for (seen, most) in self.windows.iter().zip(most_missed).filter(|(seen, _)| seen.seen()) {
            match seen.misses_of(window) {
                Some(misses) if misses >= *most => any = true,
                None if self.monitor.since >= window => {}
                _ => return false,
            }
        }
        any
    }
}

impl MultiTargetTracker {
    /// Judges the confirmed tracks after a scan, and tells which have become worse.
    pub(super) fn check_health(&mut self, look: &Look) -> Result<()> {
        let mut limits = match self.work.limits.take() {
            Some(limits) => limits,
            None => Limits::new(&self.config)?,
        };
        for track in self.tracks.iter_mut().filter(|track| track.id.is_some()) {
            let before = track.monitor.health;
            let missed = track.is_missed(&limits.most_missed);
            track.monitor.judge(&mut limits, missed);
            if track.monitor.health <= before {
                continue;
            }
            let code = match track.monitor.health {
                Health::Lost => EventCode::TrackLost,
                Health::Healthy | Health::Degraded => EventCode::TrackDegraded,
            };
            let id = track.id.unwrap_or_default();
            let reason = match (missed, track.monitor.sum()) {
                (false, Some(sum)) => {
                    let Bounds { lower, upper } = limits.of(&track.monitor.dof);
                    format!(
                        "track {id}: the NIS of its last {WINDOW} updates is {sum:.3}, expected {lower:.3} to {upper:.3}"
                    )
                }
                _ => format!("track {id}: too many of the last {WINDOW} scans without a report"),
            };
            self.intake.note(look.scan, code, &reason);
        }
        self.work.limits = Some(limits);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without a gate the moments are known: (1 − 2θ)^(−m/2). A wide gate is almost none.
    #[test]
    fn moments_inside_a_wide_gate_are_those_of_the_distribution() {
        for dof in 1..=6 {
            for theta in [-5.0, -1.0, -0.3, 0.1, 0.25] {
                let closed = log_moment(theta, dof, f64::INFINITY);
                let inside = log_moment(theta, dof, 60.0);
                assert!((closed - inside).abs() < 2e-3, "{dof} {theta}: {closed} {inside}");
            }
        }
    }

    /// P(at least k of 10) by the definition.
    #[test]
    fn misses_that_are_too_many() {
        let tail = |q: f64, least: u32| -> f64 {
            (0..1_u32 << WINDOW)
                .filter(|outcome| outcome.count_ones() >= least)
                .map(|outcome| {
                    let k = i32::try_from(outcome.count_ones()).unwrap();
                    q.powi(k) * (1.0 - q).powi(i32::from(SCANS) - k)
                })
                .sum()
        };
        for q in [0.01, 0.05, 0.109, 0.3, 0.9] {
            let k = most_missed(q);
            assert!(k > u32::from(SCANS) || tail(q, k) <= ALPHA, "{q}: {k}");
            assert!(tail(q, k - 1) > ALPHA, "{q}: {k}");
        }
        assert_eq!(most_missed(0.0), most_missed(LEAST_MISSED));
        assert_eq!(most_missed(1.0), u32::from(SCANS) + 1);
    }
}
