//! Probabilistic data association (PDA): every track for itself shares its existence out among the reports of its gate.
//!
//! β_j = L_j / (λ (1 − P_D P_G) + Σ L), L_j = P_D f_j (N18, over all reports of the gate); β_0 is the rest.
//! Two tracks may have the same report: targets that come close coalesce. With λ = 0 and single reports this is what the
//! NPDA paper calls JPDAF, every gated target having the report for certain (N16).
//!
//! Reference: Bar-Shalom, Tse (1975), Tracking in a cluttered environment with probabilistic data association; N16, N18.

use super::associator::Association;
use super::odds::{Odds, shares};
use crate::gating::mahalanobis::GatedTrack;

/// The probabilities of all tracks.
pub fn associate(tracks: &[GatedTrack], odds: &Odds) -> Association {
    let log_rest = odds.log_clutter();
    let mut out = Association::default();
    let mut log_likelihoods = Vec::new();
    for track in tracks {
        log_likelihoods.clear();
        log_likelihoods.extend(track.pairs.iter().map(|pair| pair.log_density));
        let pairs = shares(&log_likelihoods, log_rest);
        out.push(f64::max(1.0 - pairs.iter().sum::<f64>(), 0.0), pairs);
    }
    out
}
