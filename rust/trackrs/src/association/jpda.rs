//! Joint probabilistic data association (JPDA): all tracks of a scan together, no report of two tracks.
//!
//! | symbol | name here     | meaning                                                          |
//! |--------|---------------|------------------------------------------------------------------|
//! | e      |               | joint event: track → 0 or a report, no report twice              |
//! | w(e)   |               | Π_{e(i)=0} (1 − P_D P_G) Π_{e(i)=j} P_D f_ij / λ                 |
//! | β_ij   | `Association` | marginals of the events (N19), summed exactly by [`super::marginals`] |
//!
//! A scan of one report needs no sum: β_i = f_i / (λ/a + Σ f) (N17). The coalescence-free form keeps, of all events with
//! the same tracks and the same reports, only the likeliest (JPDA*).
//! λ = 0 and P_D P_G = 1 are limits; [`super::odds`] says how far they reach.
//!
//! References: Fortmann, Bar-Shalom, Scheffe (1983), IEEE J. Ocean. Eng. 8(3); Blom, Bloem (2000), IEEE Trans. Autom.
//! Control 45(2); N17, N19.

use super::associator::Association;
use super::marginals::{Candidate, Domain, Method, Options, Weights, marginals};
use super::odds::{Odds, shares};
use crate::error::Result;
use crate::gating::mahalanobis::GatedTrack;

/// The probabilities of all tracks over a scan of this number of reports.
pub fn associate(tracks: &[GatedTrack], reports: usize, odds: &Odds, coalescence_free: bool) -> Result<Association> {
    // What the likeliest event is does not matter where no two events have the same tracks and reports.
    if reports == 1 {
        return Ok(of_one_report(tracks, odds));
    }
    let mut weights = Weights::new(reports, Domain::Log);
    for track in tracks {
        weights.push(odds.log_miss(), candidates(track, odds))?;
    }
    let options = Options {
        prune: coalescence_free,
        ..Options::default()
    };
    let found = marginals(&weights, &options)?;
    let mut out = Association {
        approximation: approximation(found.method, found.error_bound),
        ..Association::default()
    };
    for track in 0..tracks.len() {
        out.push(found.missed[track], found.candidates(track).iter().copied());
    }
    Ok(out)
}

/// A track's gated reports with ln(P_D f / λ).
pub fn candidates(track: &GatedTrack, odds: &Odds) -> impl Iterator<Item = Candidate> {
    let log_hit = odds.log_hit();
    track.pairs.iter().map(move |pair| Candidate {
        report: pair.report,
        weight: pair.log_density + log_hit,
    })
}

/// What to say of sums that are not exact.
pub fn approximation(method: Method, error_bound: Option<f64>) -> Option<String> {
    let bound = error_bound.map_or("without a bound".into(), |bound| format!("error at most {bound:.1e}"));
    match method {
        Method::Exact => None,
        Method::MBest => Some(format!("by the likeliest joint events, {bound}")),
        Method::Belief => Some(format!("by belief propagation, {bound}")),
    }
}

fn of_one_report(tracks: &[GatedTrack], odds: &Odds) -> Association {
    let gating = tracks.iter().filter_map(|track| track.pairs.first());
    let log_likelihoods: Vec<f64> = gating.map(|pair| pair.log_density).collect();
    let mut betas = shares(&log_likelihoods, odds.log_clutter()).into_iter();
    let mut out = Association::default();
    for track in tracks {
        let pairs: Vec<f64> = betas.by_ref().take(track.pairs.len()).collect();
        out.push(1.0 - pairs.iter().sum::<f64>(), pairs);
    }
    out
}
