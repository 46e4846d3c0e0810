//! A track as it is reported: one estimate of one target at one time.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::error::{Result, require_positive, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::cholesky::Cholesky;

/// Whether a track is what its covariance says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub enum Health {
    /// Nothing speaks against it.
    #[default]
    Healthy,
    /// Its innovations are larger or smaller than its covariance says.
    Degraded,
    /// They have been too large for long, or its reports stay away.
    Lost,
}

/// A confirmed track at one time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Track {
    /// Identity, unique within its tracker, counted from 1 in the order of confirmation.
    pub id: u64,
    /// Time of the estimate, seconds.
    pub time: f64,
    /// The estimate.
    pub state: Gaussian,
    /// Time of the last report given to the track, seconds; earlier than `time` while it coasts.
    pub last_hit: f64,
    /// Reports given to the track so far.
    pub hits: u64,
    /// Probability that there is a target, where the tracker keeps it.
    #[serde(default)]
    pub existence: Option<f64>,
    /// How large the target is, where the tracker learns it.
    #[serde(default)]
    pub extent: Option<Extent>,
    /// Whether it is what its covariance says, where the tracker tests that.
    #[serde(default)]
    pub health: Option<Health>,
}

/// A track where it stands, without a copy of its estimate. The fields are those of [`Track`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub struct TrackRef<'a> {
    pub id: u64,
    pub time: f64,
    pub state: &'a Gaussian,
    pub last_hit: f64,
    pub hits: u64,
    pub existence: Option<f64>,
    pub extent: Option<&'a Extent>,
    pub health: Option<Health>,
}

impl TrackRef<'_> {
    /// The track by value.
    pub fn to_owned(&self) -> Track {
        Track {
            id: self.id,
            time: self.time,
            state: self.state.clone(),
            last_hit: self.last_hit,
            hits: self.hits,
            existence: self.existence,
            extent: self.extent.cloned(),
            health: self.health,
        }
    }
}

impl<'a> From<&'a Track> for TrackRef<'a> {
    fn from(track: &'a Track) -> Self {
        Self {
            id: track.id,
            time: track.time,
            state: &track.state,
            last_hit: track.last_hit,
            hits: track.hits,
            existence: track.existence,
            extent: track.extent.as_ref(),
            health: track.health,
        }
    }
}

/// An ellipse, more or less certain: X ~ IW(v, V) with v = κ + 2 d + 2, V = κ X̂.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Extent {
    /// X̂, d×d; the ellipse of a filled target in the plane has whole axes 4 √λ, with the eigenvalues λ.
    #[serde(with = "crate::linalg::saved::matrix")]
    pub cov: DMatrix<f64>,
    /// κ = v − 2 d − 2: worth so many measurements without noise.
    pub certainty: f64,
}

impl Extent {
    /// `Ok` if it is one, in d dimensions.
    pub(crate) fn check(&self, d: usize) -> Result<()> {
        require_positive("extent certainty", self.certainty)?;
        require_size("extent", d, self.cov.nrows())?;
        Cholesky::new(&self.cov, "extent").map(|_| ())
    }
}
