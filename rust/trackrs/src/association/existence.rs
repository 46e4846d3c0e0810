//! Joint association of tracks that may not exist: existence probabilities beside association probabilities (JIPDA).
//!
//! | symbol | name here | meaning                                                                             |
//! |--------|-----------|-------------------------------------------------------------------------------------|
//! | r_i    | `existence` | probability that the target of track i exists                                     |
//! | d_i    | `detection` | P_D P_G, probability that an existing target has a report in its gate             |
//! | ℓ_ij   | `Candidate::weight` | ln(P_D f_ij / λ)                                                          |
//! | p_S, p_B | `survival`, `birth` | Markov chain one: existing targets stay, absent ones appear, per step      |
//! | β_ij   |           | joint marginals with the weights of (2)                                               |
//!
//! 1. Prediction: r = p_S r + p_B (1 − r)
//! 2. Weights: w_i0 = 1 − r_i d_i, w_ij = r_i e^{ℓ_ij}
//! 3. A track without a report exists with probability r_i (1 − d_i) / (1 − r_i d_i), one with a report surely:
//!    β⁺_i0 = β_i0 r_i (1 − d_i) / (1 − r_i d_i),  r_i⁺ = β⁺_i0 + Σ_j β_ij
//! 4. Association given existence: β⁺_i0 / r_i⁺ and β_ij / r_i⁺
//!
//! Reference: D. Mušicki, R. Evans, Joint integrated probabilistic data association: JIPDA, IEEE Trans. Aerosp. Electron.
//! Syst. 40(3), 2004.

use super::marginals::{Candidate, Domain, Method, Options, Weights, marginals};
use crate::error::{Result, require_probability};

/// Markov chain one: targets that exist or do not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExistenceModel {
    survival: f64,
    birth: f64,
}

impl ExistenceModel {
    /// Probabilities, per step, that an existing target stays and that an absent one appears.
    pub fn new(survival: f64, birth: f64) -> Result<Self> {
        require_probability("survival", survival)?;
        require_probability("birth", birth)?;
        Ok(Self { survival, birth })
    }

    /// Equation 1.
    pub fn predict(&self, existence: f64) -> f64 {
        self.survival * existence + self.birth * (1.0 - existence)
    }
}

/// A track before the scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Prospect {
    /// Predicted probability of existence.
    pub existence: f64,
    /// P_D P_G.
    pub detection: f64,
    /// The reports in its gate, in increasing order, each with ln(P_D f / λ).
    pub candidates: Vec<Candidate>,
}

/// A track after the scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Existing {
    /// Probability of existence.
    pub existence: f64,
    /// Given existence, the probability that no report is its own.
    pub missed: f64,
    /// Given existence, the probability of each candidate.
    pub candidates: Vec<f64>,
}

/// All tracks after the scan.
#[derive(Debug, Clone, PartialEq)]
pub struct JointExistence {
    /// Track by track.
    pub tracks: Vec<Existing>,
    /// As in [`super::marginals::Marginals`].
    pub method: Method,
    /// As in [`super::marginals::Marginals`].
    pub error_bound: Option<f64>,
    /// As in [`super::marginals::Marginals`].
    pub log_total: f64,
}

/// Existence and association of all tracks of a scan with this number of reports.
///
/// Where existence is 0 afterwards, as it is where it was before, association is as for a target without a report.
pub fn joint_existence(prospects: &[Prospect], reports: usize, options: &Options) -> Result<JointExistence> {
    let mut weights = Weights::new(reports, Domain::Log);
    for (track, prospect) in prospects.iter().enumerate() {
        require_probability(&format!("existence[{track}]"), prospect.existence)?;
        require_probability(&format!("detection[{track}]"), prospect.detection)?;
        let log_existence = libm::log(prospect.existence);
        let scaled = |candidate: &Candidate| Candidate {
            report: candidate.report,
            weight: log_existence + candidate.weight,
        };
        let miss = libm::log1p(-prospect.existence * prospect.detection);
        weights.push(miss, prospect.candidates.iter().map(scaled))?;
    }
    let found = marginals(&weights, options)?;
    let mut tracks = Vec::with_capacity(prospects.len());
    for (track, prospect) in prospects.iter().enumerate() {
        tracks.push(posterior(prospect, found.missed[track], found.candidates(track)));
    }
    Ok(JointExistence {
        tracks,
        method: found.method,
        error_bound: found.error_bound,
        log_total: found.log_total,
    })
}

/// Equations 3 and 4.
fn posterior(prospect: &Prospect, missed: f64, candidates: &[f64]) -> Existing {
    let (r, d) = (prospect.existence, prospect.detection);
    let missed_existing = if missed > 0.0 {
        missed * r * (1.0 - d) / (1.0 - r * d)
    } else {
        0.0
    };
    let existence = missed_existing + candidates.iter().sum::<f64>();
    let given = |p: f64| if existence > 0.0 { p / existence } else { 0.0 };
    Existing {
        existence: existence.min(1.0),
        missed: if existence > 0.0 {
            missed_existing / existence
        } else {
            1.0
        },
        candidates: candidates.iter().map(|&p| given(p)).collect(),
    }
}
