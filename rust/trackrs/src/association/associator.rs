//! The associations a tracker can choose from, behind one interface: for every track the probability of each gated report.

use serde::{Deserialize, Serialize};

use super::nearest::{self, Nearness};
use super::npda::Npda;
use super::odds::Odds;
use super::{jpda, pda};
use crate::error::Result;
use crate::gating::mahalanobis::GatedTrack;

/// How reports are given to tracks.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Associator {
    /// The cheapest pair first ([`nearest`]).
    NearestNeighbour(Nearness),
    /// The cheapest set of pairs ([`nearest`]).
    #[default]
    GlobalNearestNeighbour,
    /// Every track for itself ([`pda`]).
    Pda,
    /// Jointly, no report of two tracks ([`jpda`]).
    Jpda {
        /// Whether of the joint events of the same tracks and reports only the likeliest counts (JPDA*).
        coalescence_free: bool,
    },
    /// Jointly, with the tracks' existence ([`super::existence`]).
    Jipda {
        /// As in `Jpda`.
        coalescence_free: bool,
    },
    /// One report after the other ([`super::npda`]).
    Npda(Npda),
}

/// All tracks' probabilities.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Association {
    /// Track by track: none of the reports is its own.
    pub missed: Vec<f64>,
    /// Each gated pair, those of one track after those of another.
    pub pairs: Vec<f64>,
    /// How the sums were approximated, where they were.
    pub approximation: Option<String>,
}

impl Association {
    /// Adds a track.
    pub fn push(&mut self, missed: f64, pairs: impl IntoIterator<Item = f64>) {
        self.missed.push(missed);
        self.pairs.extend(pairs);
    }
}

impl Associator {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        match self {
            Self::Npda(npda) => npda.check(),
            _ => Ok(()),
        }
    }

    /// Whether it needs the sensor's density of false reports.
    pub fn needs_density(&self) -> bool {
        match self {
            Self::NearestNeighbour(_) | Self::GlobalNearestNeighbour => false,
            Self::Pda | Self::Jpda { .. } | Self::Jipda { .. } => true,
            Self::Npda(npda) => npda.clutter_probability.is_none(),
        }
    }

    /// The probabilities of all tracks over a scan of this number of reports. The associations that take reports one by
    /// one, or know of existence, have their own functions: here they are JPDA.
    pub fn associate(&self, tracks: &[GatedTrack], reports: usize, odds: &Odds) -> Result<Association> {
        match *self {
            Self::NearestNeighbour(by) => Ok(certain(tracks, &nearest::nearest(tracks, reports, by))),
            Self::GlobalNearestNeighbour => Ok(certain(tracks, &nearest::global(tracks, reports)?)),
            Self::Pda => Ok(pda::associate(tracks, odds)),
            Self::Jpda { coalescence_free } | Self::Jipda { coalescence_free } => {
                jpda::associate(tracks, reports, odds, coalescence_free)
            }
            Self::Npda(_) => jpda::associate(tracks, reports, odds, false),
        }
    }
}

/// An assignment as probabilities.
fn certain(tracks: &[GatedTrack], chosen: &[Option<usize>]) -> Association {
    let pairs = tracks.iter().map(|track| track.pairs.len()).sum();
    let mut out = Association {
        missed: Vec::with_capacity(tracks.len()),
        pairs: Vec::with_capacity(pairs),
        approximation: None,
    };
    let sure = |yes: bool| if yes { 1.0 } else { 0.0 };
    for (track, &chosen) in tracks.iter().zip(chosen) {
        let pairs = (0..track.pairs.len()).map(|slot| sure(chosen == Some(slot)));
        out.push(sure(chosen.is_none()), pairs);
    }
    out
}
