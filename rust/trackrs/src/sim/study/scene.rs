//! What runs are drawn from: scans of several targets, or the measurements of one.

use nalgebra::DVector;

use crate::error::{Error, Result};
use crate::filter::sequence::InitialState;
use crate::scan::Scan;
use crate::sim::close_targets::CloseTargets;
use crate::sim::extended_targets::ExtendedTargets;
use crate::sim::turning::Turning;
use crate::sim::underwater::Underwater;

/// The sensor of [`CloseTargets`].
const RADAR: &str = "radar";

/// A scenario of the library.
#[derive(Debug, Clone)]
pub enum Scene {
    /// Targets side by side, so many reports to a scan.
    CloseTargets {
        /// The scenario.
        scene: CloseTargets,
        /// Reports that are one scan; they keep their own times.
        scan_size: usize,
    },
    /// Targets that give many detections.
    ExtendedTargets(ExtendedTargets),
    /// A vessel heard by hydrophones.
    Underwater(Box<Underwater>),
    /// An angle.
    Turning(Turning),
}

/// One run of a scene.
#[derive(Debug, Clone, PartialEq)]
pub enum Drawn {
    /// For trackers.
    Scans {
        /// One per step.
        scans: Vec<Scan>,
        /// Where every target is at each; `None` where it is not there.
        truth: Vec<Vec<Option<DVector<f64>>>>,
    },
    /// For filters.
    Sequence {
        /// One per step.
        values: Vec<DVector<f64>>,
        /// Where the target is at each.
        truth: Vec<DVector<f64>>,
        /// Where a filter begins; `None` where it starts itself.
        initial: Option<InitialState>,
    },
}

impl Scene {
    /// The time of every step, seconds.
    pub fn times(&self) -> Vec<f64> {
        match self {
            Self::CloseTargets { scene, scan_size } => {
                let reports = scene.settings().reports;
                let ends = (0..reports)
                    .step_by(*scan_size)
                    .map(|k| (k + scan_size).min(reports) - 1);
                ends.map(|k| scene.time(k)).collect()
            }
            Self::ExtendedTargets(scene) => (0..scene.settings().scans).map(|k| scene.time(k)).collect(),
            Self::Underwater(scene) => scene.times().to_vec(),
            Self::Turning(scene) => scene.times(),
        }
    }

    /// Coordinates of a position.
    pub fn dims(&self) -> usize {
        match self {
            Self::CloseTargets { .. } | Self::ExtendedTargets(_) => 2,
            Self::Underwater(_) => 3,
            Self::Turning(_) => 1,
        }
    }

    /// How many targets there are, where they are seen in scans; `None` where one is measured in sequence.
    pub fn targets(&self) -> Option<usize> {
        match self {
            Self::CloseTargets { scene, .. } => Some(scene.settings().targets),
            Self::ExtendedTargets(scene) => Some(scene.settings().targets.len()),
            Self::Underwater(_) | Self::Turning(_) => None,
        }
    }

    /// Where the target is between the steps, if that is known; where it is measured in sequence.
    pub fn between(&self, time: f64) -> Option<DVector<f64>> {
        match self {
            Self::Turning(scene) => Some(DVector::from_element(1, scene.truth(time))),
            _ => None,
        }
    }

    /// `Ok` if runs can be drawn.
    pub(super) fn check(&self) -> Result<()> {
        match self {
            Self::CloseTargets { scan_size: 0, .. } => Err(Error::invalid("scan_size", 0, "must be at least 1")),
            _ => Ok(()),
        }
    }

    /// Run `run` of a study with this seed.
    pub fn draw(&self, seed: u64, run: u64) -> Result<Drawn> {
        match self {
            Self::CloseTargets { scene, scan_size } => {
                let values = scene.draw(seed, run)?.values;
                let (mut scans, mut truth) = (Vec::new(), Vec::new());
                for (first, part) in values.chunks((*scan_size).max(1)).enumerate() {
                    let from = first * scan_size;
                    let times: Vec<f64> = (from..from + part.len()).map(|k| scene.time(k)).collect();
                    let now = times.last().copied().unwrap_or(0.0);
                    let scan = Scan::new(now, RADAR, part.to_vec());
                    scans.push(if *scan_size > 1 { scan.at_times(&times) } else { scan });
                    let place = |i| Some(scene.truth(i, now).rows(0, 2).into_owned());
                    truth.push((0..scene.settings().targets).map(place).collect());
                }
                Ok(Drawn::Scans { scans, truth })
            }
            Self::ExtendedTargets(scene) => {
                let scans: Vec<Scan> = scene.draw(seed, run)?.into_iter().map(|d| d.scan).collect();
                let targets = 0..scene.settings().targets.len();
                let place = |i: usize, time: f64| scene.truth(i, time).map(|[x, y, ..]| DVector::from_vec(vec![x, y]));
                let at = |scan: &Scan| targets.clone().map(|i| place(i, scan.time)).collect();
                Ok(Drawn::Scans {
                    truth: scans.iter().map(at).collect(),
                    scans,
                })
            }
            Self::Underwater(scene) => {
                let recording = scene.draw(seed, run)?;
                let states = &recording.truth.states;
                let place = |k| DVector::from_iterator(3, states.row(k).iter().take(3).copied());
                Ok(Drawn::Sequence {
                    truth: (0..states.nrows()).map(place).collect(),
                    values: recording.values,
                    initial: None,
                })
            }
            Self::Turning(scene) => {
                let angles = scene.draw(seed, run);
                let one = |value: f64| DVector::from_element(1, value);
                Ok(Drawn::Sequence {
                    values: angles.values.into_iter().map(one).collect(),
                    truth: scene.times().iter().map(|&time| one(scene.truth(time))).collect(),
                    initial: Some(angles.initial),
                })
            }
        }
    }
}
