//! What a study records of every method at every step.
//!
//! | metric                    | columns                                                                       |
//! |---------------------------|-------------------------------------------------------------------------------|
//! | [`StudyMetric::Ospa`]     | the distance, and what places and number contribute to it                      |
//! | [`StudyMetric::Gospa`]    | the distance, and the p-th powers of its parts                                 |
//! | [`StudyMetric::Cardinality`] | number of tracks, and by how much it is wrong                               |
//! | [`StudyMetric::Identity`] | of targets known from the beginning: the root mean square of their errors; 1 where each track's nearest target is its own and no two are closer than the least separation; 1 where two are; 1 where targets were exchanged |
//! | [`StudyMetric::Position`] | the error (of one coordinate with its sign, of several its length), its normalised square, and that of the innovation |
//! | [`StudyMetric::Lead`]     | the error of the prediction ahead                                              |
//!
//! NaN where there is nothing to score: before a run has started, or where a track has ended.

use nalgebra::{DMatrix, DVector};

use super::scene::Scene;
use crate::error::Result;
use crate::filter::lead::Lead;
use crate::filter::run::FilterRun;
use crate::gaussian::{Gaussian, Gaussians};
use crate::linalg::cholesky::Cholesky;
use crate::metric::gospa::gospa;
use crate::metric::ospa::ospa;

/// What is recorded.
#[derive(Debug, Clone, PartialEq)]
pub enum StudyMetric {
    /// Optimal sub-pattern assignment.
    Ospa {
        /// c, metres.
        cutoff: f64,
        /// p.
        order: f64,
    },
    /// Generalised optimal sub-pattern assignment.
    Gospa {
        /// c, metres.
        cutoff: f64,
        /// p.
        order: f64,
        /// α.
        alpha: f64,
    },
    /// How many tracks there are.
    Cardinality,
    /// Which track is whose.
    Identity {
        /// Tracks closer than this have become one, metres.
        separation: f64,
    },
    /// The estimated position of one target.
    Position {
        /// Steps before this one are not scored.
        first: usize,
    },
    /// The predicted position of one target.
    Lead {
        /// How far ahead.
        lead: Lead,
        /// Steps before this one are not scored.
        first: usize,
    },
}

/// How the steps of a run become one number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Summary {
    /// Their mean.
    Mean,
    /// The root of their mean square.
    Rms,
    /// The last of them.
    Last,
}

/// One number per step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// Its name.
    pub name: &'static str,
    /// What a run is summarised by.
    pub summary: Summary,
}

impl StudyMetric {
    /// What it records.
    pub fn columns(&self) -> &'static [Column] {
        const fn column(name: &'static str, summary: Summary) -> Column {
            Column { name, summary }
        }
        use Summary::{Last, Mean, Rms};
        match self {
            Self::Ospa { .. } => {
                const {
                    &[
                        column("ospa", Mean),
                        column("ospa_localisation", Mean),
                        column("ospa_cardinality", Mean),
                    ]
                }
            }
            Self::Gospa { .. } => {
                const {
                    &[
                        column("gospa", Mean),
                        column("gospa_localisation", Mean),
                        column("gospa_missed", Mean),
                        column("gospa_false", Mean),
                    ]
                }
            }
            Self::Cardinality => const { &[column("tracks", Mean), column("cardinality_error", Mean)] },
            Self::Identity { .. } => {
                const {
                    &[
                        column("track_error", Rms),
                        column("right", Last),
                        column("coalesced", Last),
                        column("swapped", Last),
                    ]
                }
            }
            Self::Position { .. } => const { &[column("error", Rms), column("nees", Mean), column("nis", Mean)] },
            Self::Lead { .. } => const { &[column("lead_error", Rms)] },
        }
    }

    /// Whether it is of scans with several targets, or of one target's sequence.
    pub(super) fn of_scans(&self) -> bool {
        !matches!(self, Self::Position { .. } | Self::Lead { .. })
    }

    /// `Ok` if its parameters are in their domains.
    pub(super) fn check(&self) -> Result<()> {
        let none = DMatrix::zeros(0, 0);
        match self {
            Self::Ospa { cutoff, order } => ospa(&none, &none, *cutoff, *order).map(|_| ()),
            Self::Gospa { cutoff, order, alpha } => gospa(&none, &none, *cutoff, *order, *alpha).map(|_| ()),
            Self::Identity { separation } => crate::error::require_positive("separation", *separation),
            Self::Cardinality | Self::Position { .. } | Self::Lead { .. } => Ok(()),
        }
    }
}

/// The tracks of one step: whose, and where.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// As the tracker names it; targets known from the beginning are 1, 2, and so on.
    pub id: u64,
    /// Its position.
    pub position: DVector<f64>,
}

/// What a metric of scans gives at one step, in the order of its columns.
pub fn score_step(metric: &StudyMetric, truth: &[Option<DVector<f64>>], found: &[Estimate]) -> Result<Vec<f64>> {
    let present: Vec<&DVector<f64>> = truth.iter().flatten().collect();
    let places: Vec<&DVector<f64>> = found.iter().map(|estimate| &estimate.position).collect();
    match metric {
        StudyMetric::Ospa { cutoff, order } => {
            let out = ospa(&stacked(&present), &stacked(&places), *cutoff, *order)?;
            Ok(vec![out.total, out.localisation, out.cardinality])
        }
        StudyMetric::Gospa { cutoff, order, alpha } => {
            let out = gospa(&stacked(&present), &stacked(&places), *cutoff, *order, *alpha)?;
            Ok(vec![out.total, out.localisation, out.missed, out.false_tracks])
        }
        StudyMetric::Cardinality => Ok(vec![found.len() as f64, found.len() as f64 - present.len() as f64]),
        StudyMetric::Identity { separation } => Ok(identity(truth, found, *separation)),
        StudyMetric::Position { .. } | StudyMetric::Lead { .. } => Ok(Vec::new()),
    }
}

fn stacked(points: &[&DVector<f64>]) -> DMatrix<f64> {
    let dims = points.first().map_or(0, |point| point.len());
    DMatrix::from_fn(points.len(), dims, |i, j| points[i][j])
}

fn identity(truth: &[Option<DVector<f64>>], found: &[Estimate], separation: f64) -> Vec<f64> {
    let track = |i: usize| found.iter().find(|estimate| estimate.id == i as u64 + 1);
    let pairs: Option<Vec<(&DVector<f64>, &DVector<f64>)>> = truth
        .iter()
        .enumerate()
        .map(|(i, place)| Some((place.as_ref()?, &track(i)?.position)))
        .collect();
    let Some(pairs) = pairs.filter(|pairs| !pairs.is_empty()) else {
        return vec![f64::NAN, 0.0, 0.0, 0.0];
    };
    let squares: f64 = pairs
        .iter()
        .map(|(place, track)| (*track - *place).norm_squared())
        .sum();
    let nearest = |track: &DVector<f64>| {
        let apart = |i: &usize| (pairs[*i].0 - track).norm();
        (0..pairs.len()).min_by(|a, b| apart(a).total_cmp(&apart(b)))
    };
    let owners: Vec<Option<usize>> = pairs.iter().map(|(_, track)| nearest(track)).collect();
    let own = owners.iter().enumerate().all(|(i, owner)| *owner == Some(i));
    let mut distinct = owners.clone();
    distinct.sort_unstable();
    distinct.dedup();
    let together = pairs
        .iter()
        .enumerate()
        .any(|(i, (_, a))| pairs[..i].iter().any(|(_, b)| (*a - *b).norm() < separation));
    let flag = f64::from;
    vec![
        (squares / pairs.len() as f64).sqrt(),
        flag(own && !together),
        flag(together),
        flag(!own && distinct.len() == owners.len()),
    ]
}

/// What a metric of a sequence gives, column after column.
pub(super) fn score_run(metric: &StudyMetric, scene: &Scene, truth: &[DVector<f64>], run: &FilterRun) -> Vec<f64> {
    let columns = metric.columns().len();
    let steps = truth.len();
    let mut out = vec![f64::NAN; columns * steps];
    let dims = scene.dims();
    match metric {
        StudyMetric::Position { first } => {
            for k in (*first).max(run.start)..steps.min(run.filtered.len()) {
                let (error, nees) = position_error(&run.filtered, k, &truth[k], dims);
                out[k] = error;
                out[steps + k] = nees;
                out[2 * steps + k] = run.nis.get(k).copied().unwrap_or(f64::NAN);
            }
        }
        StudyMetric::Lead { first, .. } => {
            let rows = steps.min(run.leads.len());
            for (k, (error, &time)) in out.iter_mut().zip(&run.lead_times).enumerate().take(rows) {
                if let Some(place) = scene.between(time).filter(|_| k >= (*first).max(run.start)) {
                    *error = position_error(&run.leads, k, &place, dims).0;
                }
            }
        }
        _ => {}
    }
    out
}

/// The error of a position and its normalised square.
fn position_error(states: &Gaussians, k: usize, truth: &DVector<f64>, dims: usize) -> (f64, f64) {
    let Gaussian { mean, cov } = states.at(k).leading(dims);
    let error = mean - truth;
    let nees = Cholesky::new(&cov, "position").map_or(f64::NAN, |factor| factor.whiten(&error).norm_squared());
    (if dims == 1 { error[0] } else { error.norm() }, nees)
}
