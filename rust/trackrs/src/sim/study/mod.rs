//! Monte-Carlo studies: one scene, several methods, several metrics, many runs.
//!
//! Run k draws from stream (seed, k) and from nothing else: it is the same in any order, on any number of threads and in
//! any process, so that parts of a study can be computed anywhere and put together. All methods of a run get the same
//! draw. A method that fails in a run leaves NaN and says why; the others go on. Whoever runs a study may stop it within a
//! run ([`Oversight`]).
//!
//! | symbol | name here              | shape     | meaning                                          |
//! |--------|------------------------|-----------|--------------------------------------------------|
//! | k      | `run`                  |           | number of the run                                |
//! | M      | [`Study::methods`]     |           | methods                                          |
//! | C      | [`Study::columns`]     |           | what the metrics record, one after the other     |
//! | S      | [`Study::times`]       |           | steps                                            |
//! | v      | [`Trial::values`]      | M × C × S | what run k gave                                  |

mod scene;
mod score;

use std::ops::Range;
use std::time::Instant;

use nalgebra::DVector;

pub use scene::{Drawn, Scene};
pub use score::{Column, Estimate, StudyMetric, Summary, score_step};

use crate::error::{Error, Result};
use crate::filter::lead::Lead;
use crate::filter::sequence::{Filter, History, InitialState};
use crate::scan::Scan;
use crate::threads::share_out;
use crate::track::Track;
use crate::tracker::multi_target::MultiTargetTracker;
use crate::tracker::phd::PhdTracker;

/// What is tried. Every run begins with a copy.
#[derive(Debug, Clone)]
pub enum Method {
    /// A tracker with tracks.
    Tracker(Box<MultiTargetTracker>),
    /// A tracker with an intensity.
    Intensity(Box<PhdTracker>),
    /// A filter of one target.
    Filter(Box<Filter>),
}

/// A method with its name.
#[derive(Debug, Clone)]
pub struct Named {
    /// What it is called.
    pub name: String,
    /// What it is.
    pub method: Method,
}

/// A study.
#[derive(Debug, Clone)]
pub struct Study {
    scene: Scene,
    methods: Vec<Named>,
    metrics: Vec<StudyMetric>,
    times: Vec<f64>,
}

/// What one run gave.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// M × C × S; NaN where a method failed or there is nothing to score.
    pub values: Vec<f64>,
    /// What each method took. Not part of what is the same everywhere.
    pub seconds: Vec<f64>,
    /// Who failed, and why.
    pub failures: Vec<Failure>,
}

/// A method that could not finish a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// Which.
    pub method: usize,
    /// Why.
    pub reason: String,
}

/// What somebody who runs a study may want to say meanwhile. `()` says nothing.
pub trait Oversight {
    /// Whether to leave off: looked at between scans and between methods.
    fn stopped(&self) -> bool {
        false
    }

    /// What a method's own code has reported outside of [`Error`]; looked at after every method, which then has failed.
    fn fault(&self) -> Option<String> {
        None
    }
}

impl Oversight for () {}

/// Why there are no scores.
enum Without {
    Stopped,
    Failed(Error),
}

impl From<Error> for Without {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

impl Study {
    /// The checked study.
    pub fn new(scene: Scene, methods: Vec<Named>, metrics: Vec<StudyMetric>) -> Result<Self> {
        scene.check()?;
        let targets = scene.targets();
        for metric in &metrics {
            metric.check()?;
            if metric.of_scans() != targets.is_some() {
                let name = metric.columns().first().map_or("", |column| column.name);
                let requirement = if targets.is_some() {
                    "must be of several targets, as OSPA is, in a scenario of scans"
                } else {
                    "must be of one target, as PositionError is, in a scenario of one target"
                };
                return Err(Error::invalid("metric", name, requirement));
            }
            if matches!(metric, StudyMetric::Lead { .. }) && scene.between(0.0).is_none() {
                let requirement = "needs a scenario that knows the truth between measurements, as turntable does";
                return Err(Error::invalid("metric", "lead_error", requirement));
            }
            if let StudyMetric::Lead { lead, .. } = metric {
                lead.seconds(&scene.times(), None)?;
            }
        }
        for Named { name, method } in &methods {
            let fits = match method {
                Method::Tracker(_) | Method::Intensity(_) => targets.is_some(),
                Method::Filter(_) => targets.is_none(),
            };
            if !fits {
                let requirement = if targets.is_some() {
                    "must be a tracker: the scenario gives scans"
                } else {
                    "must be a filter: the scenario gives the measurements of one target"
                };
                return Err(Error::invalid("method", name, requirement));
            }
            let known = match method {
                Method::Tracker(tracker) => tracker.config().initial.len(),
                _ => 0,
            };
            let identity = metrics
                .iter()
                .any(|metric| matches!(metric, StudyMetric::Identity { .. }));
            if let Some(expected) = targets.filter(|&expected| identity && expected != known) {
                let requirement = format!("must begin with all {expected} targets for the metric of identities");
                return Err(Error::invalid("method", name, &requirement));
            }
        }
        let times = scene.times();
        Ok(Self {
            scene,
            methods,
            metrics,
            times,
        })
    }

    /// What runs are drawn from.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What is tried.
    pub fn methods(&self) -> &[Named] {
        &self.methods
    }

    /// What is recorded at every step.
    pub fn columns(&self) -> Vec<Column> {
        self.metrics.iter().flat_map(StudyMetric::columns).copied().collect()
    }

    /// The times of the steps, seconds.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Run `run` of the study with this seed. An error is one of the scene; those of methods are in the result.
    pub fn run(&self, seed: u64, run: u64) -> Result<Trial> {
        let trial = self.run_under(&(), seed, run)?;
        Ok(trial.unwrap_or_else(|| self.blank()))
    }

    /// The same; `None` if it was stopped.
    pub fn run_under(&self, oversight: &dyn Oversight, seed: u64, run: u64) -> Result<Option<Trial>> {
        let drawn = self.scene.draw(seed, run)?;
        let mut trial = self.blank();
        let width = self.columns().len() * self.times.len();
        for (i, named) in self.methods.iter().enumerate() {
            let (scored, seconds) = self.try_method(&named.method, &drawn, oversight);
            trial.seconds[i] = seconds;
            let failed = match (scored, oversight.fault()) {
                (Err(Without::Stopped), _) => return Ok(None),
                (_, Some(reason)) => reason,
                (Err(Without::Failed(error)), None) => error.to_string(),
                (Ok(values), None) => {
                    trial.values[i * width..(i + 1) * width].copy_from_slice(&values);
                    continue;
                }
            };
            trial.failures.push(Failure {
                method: i,
                reason: failed,
            });
        }
        Ok(Some(trial))
    }

    /// Nothing known yet.
    fn blank(&self) -> Trial {
        let width = self.columns().len() * self.times.len();
        Trial {
            values: vec![f64::NAN; self.methods.len() * width],
            seconds: vec![0.0; self.methods.len()],
            failures: Vec::new(),
        }
    }

    /// All runs of a range, on so many threads, in their order.
    pub fn run_all(&self, seed: u64, runs: Range<u64>, threads: usize) -> Result<Vec<Trial>> {
        let mut trials: Vec<Option<Trial>> = runs.clone().map(|_| None).collect();
        share_out(runs.zip(&mut trials), threads, |(run, trial)| {
            *trial = Some(self.run(seed, run)?);
            Ok::<_, Error>(())
        })?;
        Ok(trials.into_iter().flatten().collect())
    }

    /// The scores of one method, C × S, and the seconds it took without the scoring.
    fn try_method(
        &self,
        method: &Method,
        drawn: &Drawn,
        oversight: &dyn Oversight,
    ) -> (std::result::Result<Vec<f64>, Without>, f64) {
        let begun = Instant::now();
        match (method, drawn) {
            (Method::Tracker(tracker), Drawn::Scans { scans, truth }) => {
                let mut tracker = tracker.as_ref().clone();
                let checked = tracker.check_run(scans);
                let found = follow(checked, scans, oversight, |scan| tracker.step(scan));
                let seconds = begun.elapsed().as_secs_f64();
                (found.and_then(|tracks| Ok(self.score_tracks(&tracks, truth)?)), seconds)
            }
            (Method::Intensity(tracker), Drawn::Scans { scans, truth }) => {
                let mut tracker = tracker.as_ref().clone();
                let checked = tracker.check_run(scans);
                let found = follow(checked, scans, oversight, |scan| tracker.step(scan));
                let seconds = begun.elapsed().as_secs_f64();
                (found.and_then(|tracks| Ok(self.score_tracks(&tracks, truth)?)), seconds)
            }
            (Method::Filter(_), _) if oversight.stopped() => (Err(Without::Stopped), 0.0),
            (Method::Filter(filter), Drawn::Sequence { values, truth, initial }) => {
                let mut seconds = 0.0;
                let scored = self.score_filter(filter, values, truth, initial.as_ref(), &mut seconds);
                (scored.map_err(Without::from), seconds)
            }
            // `new` lets no such pair through.
            _ => (Err(Error::invalid("method", "?", "must fit the scenario").into()), 0.0),
        }
    }

    fn score_tracks(&self, tracks: &[Vec<Track>], truth: &[Vec<Option<DVector<f64>>>]) -> Result<Vec<f64>> {
        let dims = self.scene.dims();
        let place = |track: &Track| Estimate {
            id: track.id,
            position: track.state.mean.rows(0, dims.min(track.state.dim())).into_owned(),
        };
        let steps: Vec<Vec<Estimate>> = tracks.iter().map(|found| found.iter().map(place).collect()).collect();
        score_tracks(&self.metrics, truth, &steps)
    }

    fn score_filter(
        &self,
        filter: &Filter,
        values: &[DVector<f64>],
        truth: &[DVector<f64>],
        initial: Option<&InitialState>,
        seconds: &mut f64,
    ) -> Result<Vec<f64>> {
        let begun = Instant::now();
        let ahead = |lead: Option<&Lead>| filter.run_ahead(&self.times, values, initial, None, lead, History::Filtered);
        let plain = ahead(None);
        *seconds = begun.elapsed().as_secs_f64();
        let plain = plain?;
        let mut out = Vec::new();
        for metric in &self.metrics {
            let looked = match metric {
                StudyMetric::Lead { lead, .. } => Some(ahead(Some(lead))?),
                _ => None,
            };
            out.extend(score::score_run(
                metric,
                &self.scene,
                truth,
                looked.as_ref().unwrap_or(&plain),
            ));
        }
        Ok(out)
    }
}

/// What a tracker finds at every scan, as its `run` does, with a look at the oversight before each.
fn follow(
    checked: Result<()>,
    scans: &[Scan],
    oversight: &dyn Oversight,
    mut step: impl FnMut(&Scan) -> Result<Vec<Track>>,
) -> std::result::Result<Vec<Vec<Track>>, Without> {
    checked?;
    let mut found = Vec::with_capacity(scans.len());
    for scan in scans {
        if oversight.stopped() {
            return Err(Without::Stopped);
        }
        found.push(step(scan)?);
    }
    Ok(found)
}

/// The scores of what was found at every step, C × S.
pub fn score_tracks(
    metrics: &[StudyMetric],
    truth: &[Vec<Option<DVector<f64>>>],
    found: &[Vec<Estimate>],
) -> Result<Vec<f64>> {
    crate::error::require_size("steps", truth.len(), found.len())?;
    let steps = truth.len();
    let columns: usize = metrics.iter().map(|metric| metric.columns().len()).sum();
    let mut out = vec![f64::NAN; columns * steps];
    for (k, (places, tracks)) in truth.iter().zip(found).enumerate() {
        let mut column = 0;
        for metric in metrics {
            for value in score_step(metric, places, tracks)? {
                out[column * steps + k] = value;
                column += 1;
            }
        }
    }
    Ok(out)
}
