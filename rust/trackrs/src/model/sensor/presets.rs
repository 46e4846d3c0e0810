//! The two arrays of the underwater paper, BATS and TOSS, as presets of [`RangeArray`].

use nalgebra::{DMatrix, DVector};

use super::closed_form::{COLLINEAR, widest};
use super::fix::Side;
use super::sound_speed::SoundSpeed;
use super::{RangeArray, RangeArraySettings, Sensor};
use crate::error::{Error, Result, require_size};

impl RangeArray {
    /// Three hydrophones and the target's depth.
    pub fn bats(
        hydrophones: DMatrix<f64>,
        range_std: f64,
        depth_std: f64,
        sound_speed: Option<SoundSpeed>,
    ) -> Result<Self> {
        let settings = RangeArraySettings {
            hydrophones,
            range_std: vec![range_std],
            survey_std: Vec::new(),
            depth_std: Some(depth_std),
            sound_speed,
            side: None,
        };
        Self::new(settings)?.require_bats()
    }

    /// Six hydrophones on the sea floor and no depth. They lie almost in one plane: `side` says where the target is.
    pub fn toss(
        hydrophones: DMatrix<f64>,
        range_std: f64,
        sound_speed: Option<SoundSpeed>,
        side: Side,
    ) -> Result<Self> {
        let settings = RangeArraySettings {
            hydrophones,
            range_std: vec![range_std],
            survey_std: Vec::new(),
            depth_std: None,
            sound_speed,
            side: Some(side),
        };
        Self::new(settings)?.require_toss()
    }

    /// The array itself if it is three hydrophones, not collinear in plan, with depth.
    pub fn require_bats(self) -> Result<Self> {
        require_size("hydrophones of a BATS array", 3, self.channels())?;
        require_size("measurement of a BATS array", 4, self.measurement_dim())?;
        self.require_spread(2, "must not be collinear in plan")
    }

    /// The array itself if it is six hydrophones in 3 dimensions, not collinear, without depth.
    pub fn require_toss(self) -> Result<Self> {
        require_size("hydrophones of a TOSS array", 6, self.channels())?;
        require_size("dimensions of hydrophones", 3, self.dims())?;
        require_size("measurement of a TOSS array", 6, self.measurement_dim())?;
        self.require_spread(3, "must not be collinear")
    }

    fn require_spread(self, dims: usize, requirement: &str) -> Result<Self> {
        let points: Vec<DVector<f64>> = (0..self.channels())
            .map(|i| self.hydrophone(i).rows(0, dims).into_owned())
            .collect();
        match widest(&points, COLLINEAR) {
            Some(triple) if triple.third.is_some() => Ok(self),
            _ => Err(Error::invalid("hydrophones", "given", requirement)),
        }
    }
}
