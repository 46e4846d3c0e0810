//! Ranges from several hydrophones, or their travel times, and the depth where the target reports it.
//!
//! | symbol | name here            | shape | meaning                                             |
//! |--------|----------------------|-------|-----------------------------------------------------|
//! | p_i    | `hydrophones`        | k×d   | positions, metres; in 3 dimensions z is depth, positive down |
//! | σ_i    | `range_std`          | k     | standard deviation of a range, metres               |
//! | s_i    | `survey_std`         | k     | of the hydrophone's position along the ray, metres  |
//! | σ_Z    | `depth_std`          |       | standard deviation of the depth, metres             |
//! | s̄_i    | [`SoundSpeed`]       |       | mean slowness of the ray, s/m, for travel times     |
//!
//! ranges (metres):  h_i = |x − p_i|,  ∂h_i/∂x = (x − p_i)ᵀ/h_i;  depth, the last component: h = z, ∂h/∂x = e_zᵀ
//! travel times (seconds), when a sound speed is given:  T_i = h_i s̄_i,  ∂T_i/∂x = s̄_i ∂h_i/∂x + h_i ∂s̄_i/∂z e_zᵀ,
//! with standard deviation σ_i / c, c the effective speed or, of a profile, the speed at the hydrophone.
//!
//! A hydrophone that is out of place by δ shifts the range by −(∂h/∂x) δ. `survey_std` counts that as white noise: σ_i² + s_i²
//! stands for σ_i². It keeps such a range from being taken for a gross error and gives it less weight; but the shift is
//! the same at every epoch and does not average out as white noise would, so that covariances are too small after many.
//!
//! With lasting errors η declared ([`super::nuisance`]) the range is (1 + s) |x − p_i| + b_i in all of this:
//! ∂h_i/∂x = (1 + s) (x − p_i)ᵀ/|x − p_i|,  ∂h_i/∂b_i = 1,  ∂h_i/∂s = |x − p_i|, each times the slowness for a travel time.
//! They are the last components of the state. A state that is a position alone has none of them.
//!
//! NaN = not heard. A target on a hydrophone has no derivative: an error that names the channel.
//! Reference: paper of Xi, Liu, Tao, Lu, measurement equations; spec label U5.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::fix::Side;
use super::heard::ABSURD;
use super::nuisance::{Nuisance, RangeBias, RangeScale};
use super::position_fix::PositionFix;
use super::sound_speed::SoundSpeed;
use super::{Curvature, Motion, Sensor};
use crate::error::{Error, Result, require_finite, require_non_negative, require_size, require_std};
use crate::gaussian::Gaussian;

/// What a [`RangeArray`] is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RangeArraySettings {
    /// Positions of the hydrophones, k×d with d = 2 or 3, metres; z positive down.
    #[serde(with = "crate::linalg::saved::matrix")]
    pub hydrophones: DMatrix<f64>,
    /// Standard deviations of the ranges, metres: one for all, or one per channel.
    pub range_std: Vec<f64>,
    /// Standard deviations of the surveyed positions along the ray, metres: none, one for all, or one per channel.
    #[serde(default)]
    pub survey_std: Vec<f64>,
    /// Standard deviation of the depth that comes last in the measurement, metres, where there is one.
    pub depth_std: Option<f64>,
    /// Measurements are travel times in seconds if this is given, else ranges in metres.
    pub sound_speed: Option<SoundSpeed>,
    /// Which of two mirror images the target is, where a position fix leaves both.
    pub side: Option<Side>,
}

/// Hydrophones (or radio anchors) that measure the range to one target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RangeArray {
    pub(super) settings: RangeArraySettings,
    pub(super) bias: Option<RangeBias>,
    pub(super) scale: Option<RangeScale>,
}

/// One expected component of a measurement and its derivatives.
pub(super) struct Row {
    pub(super) value: f64,
    /// On the position; the first d count.
    pub(super) gradient: [f64; 3],
    /// On the channel's bias and on the scale error.
    pub(super) by_bias: f64,
    pub(super) by_scale: f64,
}

impl RangeArray {
    /// The checked array.
    pub fn new(mut settings: RangeArraySettings) -> Result<Self> {
        let (channels, dims) = settings.hydrophones.shape();
        if !(2..=3).contains(&dims) {
            return Err(Error::invalid("dimensions of hydrophones", dims, "must be 2 or 3"));
        }
        if channels == 0 {
            return Err(Error::invalid(
                "hydrophones",
                "an empty array",
                "must have at least one",
            ));
        }
        require_finite("hydrophones", settings.hydrophones.transpose().iter())?;
        if settings.range_std.len() == 1 {
            settings.range_std = vec![settings.range_std[0]; channels];
        }
        require_size("range_std", channels, settings.range_std.len())?;
        for &std in &settings.range_std {
            require_std("range_std", std)?;
        }
        if settings.survey_std.len() == 1 {
            settings.survey_std = vec![settings.survey_std[0]; channels];
        }
        if !settings.survey_std.is_empty() {
            require_size("survey_std", channels, settings.survey_std.len())?;
        }
        for &std in &settings.survey_std {
            require_non_negative("survey_std", std)?;
        }
        if let Some(std) = settings.depth_std {
            require_std("depth_std", std)?;
            if dims < 3 {
                let requirement = "needs hydrophones in 3 dimensions";
                return Err(Error::invalid("depth_std", std, requirement));
            }
        }
        if let Some(speed) = &settings.sound_speed {
            speed.check(channels, dims)?;
        }
        Ok(Self {
            settings,
            bias: None,
            scale: None,
        })
    }

    /// What it is made of: standard deviations one per channel.
    pub fn settings(&self) -> &RangeArraySettings {
        &self.settings
    }

    /// Number k of hydrophones.
    pub fn channels(&self) -> usize {
        self.settings.hydrophones.nrows()
    }

    /// Number d of coordinates.
    pub fn dims(&self) -> usize {
        self.settings.hydrophones.ncols()
    }

    /// Position of hydrophone i, length d.
    pub(super) fn hydrophone(&self, i: usize) -> DVector<f64> {
        self.settings.hydrophones.row(i).transpose()
    }

    /// Component `channel` of the measurement (a hydrophone, or the depth) expected of a target at this position, with
    /// these lasting errors (all of them, or none).
    #[inline]
    pub(super) fn row(&self, channel: usize, position: &[f64], nuisance: &[f64]) -> Result<Row> {
        let dims = self.dims();
        let mut gradient = [0.0; 3];
        if channel == self.channels() {
            gradient[dims - 1] = 1.0;
            return Ok(Row {
                value: position[dims - 1],
                gradient,
                by_bias: 0.0,
                by_scale: 0.0,
            });
        }
        let mut square = 0.0;
        for i in 0..dims {
            gradient[i] = position[i] - self.settings.hydrophones[(channel, i)];
            square += gradient[i] * gradient[i];
        }
        let distance = square.sqrt();
        if distance == 0.0 {
            return Err(Error::Unobservable {
                sensor: "RangeArray".into(),
                reason: format!("the target stands on the hydrophone of channel {channel}"),
            });
        }
        let error = self.error_of(channel, nuisance);
        let range = (1.0 + error.scale) * distance + error.bias;
        for slope in &mut gradient {
            *slope *= (1.0 + error.scale) / distance;
        }
        let mut row = Row {
            value: range,
            gradient,
            by_bias: 1.0,
            by_scale: distance,
        };
        if let Some(speed) = &self.settings.sound_speed {
            let own = self.settings.hydrophones[(channel, dims - 1)];
            let slowness = speed.slowness(channel, position[dims - 1], own);
            row.value *= slowness.mean;
            row.gradient.iter_mut().for_each(|slope| *slope *= slowness.mean);
            row.gradient[dims - 1] += range * slowness.slope;
            row.by_bias = slowness.mean;
            row.by_scale *= slowness.mean;
        }
        Ok(row)
    }

    /// Standard deviation of a component, in the unit of the measurement.
    pub(super) fn std(&self, channel: usize) -> f64 {
        if channel < self.channels() {
            self.range_std(channel) / self.metres_per_unit(channel, None)
        } else {
            self.settings.depth_std.unwrap_or(f64::NAN)
        }
    }

    /// √(σ_i² + s_i²), metres.
    pub(super) fn range_std(&self, channel: usize) -> f64 {
        let std = self.settings.range_std[channel];
        match self.survey_std(channel) {
            0.0 => std,
            survey => libm::hypot(std, survey),
        }
    }

    /// s_i, metres; zero where none is given.
    pub(super) fn survey_std(&self, channel: usize) -> f64 {
        self.settings.survey_std.get(channel).copied().unwrap_or(0.0)
    }

    /// How many metres of range one unit of the measurement is: 1, or the effective speed for this depth of the target
    /// (that at the hydrophone where it is not known).
    pub(crate) fn metres_per_unit(&self, channel: usize, depth: Option<f64>) -> f64 {
        let Some(speed) = &self.settings.sound_speed else {
            return 1.0;
        };
        let own = self.settings.hydrophones[(channel, self.dims() - 1)];
        1.0 / speed.slowness(channel, depth.unwrap_or(own), own).mean
    }
}

impl Sensor for RangeArray {
    fn measurement_dim(&self) -> usize {
        self.channels() + usize::from(self.settings.depth_std.is_some())
    }
    fn labels(&self) -> Vec<String> {
        let kind = if self.settings.sound_speed.is_some() {
            "time"
        } else {
            "range"
        };
        let mut labels: Vec<String> = (0..self.channels()).map(|i| format!("{kind}{i}")).collect();
        if self.settings.depth_std.is_some() {
            labels.push("depth".into());
        }
        labels
    }
    fn check(&self, motion: &dyn Motion) -> Result<()> {
        require_size("position of the motion model", self.dims(), motion.position_dims())
    }
    fn observe(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        let state = self.parts(state)?;
        let mut out = DVector::zeros(self.measurement_dim());
        for i in 0..out.len() {
            out[i] = self.row(i, state.position, state.nuisance)?.value;
        }
        Ok(out)
    }
    fn jacobian(&self, state: &DVector<f64>, platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        let (m, n) = (self.measurement_dim(), state.len());
        let (mut expected, mut jacobian) = (vec![0.0; m], vec![0.0; m * n]);
        self.linearise_into(state, platform, &mut expected, &mut jacobian)?;
        Ok(DMatrix::from_row_slice(m, n, &jacobian))
    }
    fn linearise_into(
        &self,
        state: &DVector<f64>,
        _platform: Option<&DVector<f64>>,
        expected: &mut [f64],
        jacobian: &mut [f64],
    ) -> Result<()> {
        let n = state.len();
        let state = self.parts(state)?;
        let first = n - state.nuisance.len();
        jacobian.fill(0.0);
        for (i, out) in jacobian.chunks_exact_mut(n).enumerate() {
            let row = self.row(i, state.position, state.nuisance)?;
            expected[i] = row.value;
            out[..self.dims()].copy_from_slice(&row.gradient[..self.dims()]);
            if state.nuisance.is_empty() || i == self.channels() {
                continue;
            }
            if self.bias.is_some() {
                out[first + i] = row.by_bias;
            }
            if let Some(index) = self.scale_index() {
                out[first + index] = row.by_scale;
            }
        }
        Ok(())
    }
    fn noise(&self) -> DMatrix<f64> {
        let std = DVector::from_fn(self.measurement_dim(), |i, _| self.std(i));
        DMatrix::from_diagonal(&std.component_mul(&std))
    }
    fn locate(&self, measurement: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Option<Gaussian> {
        self.fix_on(measurement, self.settings.side)
            .ok()
            .map(|fix| fix.position)
    }
    fn impossible(&self, measurements: &[f64]) -> Option<usize> {
        let m = self.measurement_dim();
        let bias = |i: usize| self.bias.as_ref().map_or(0.0, |bias| bias.std[i]);
        let least = |i: usize| -ABSURD * libm::hypot(self.range_std(i), bias(i));
        let below = |i: usize, range: f64| range * self.metres_per_unit(i, None) < least(i);
        // Nearly all are positive: those need no more than this.
        let absurd = |k: &usize| measurements[*k] < 0.0 && below(k % m, measurements[*k]);
        (0..measurements.len()).filter(|k| k % m < self.channels()).find(absurd)
    }
    fn position_fix(&self) -> Option<&dyn PositionFix> {
        Some(self)
    }
    fn nuisance(&self) -> Option<Nuisance> {
        self.declared()
    }
    fn curvature(&self, prior: &Gaussian) -> Option<Result<Curvature>> {
        Some(self.curved(prior))
    }
}

/// The parts of a state that a range depends on.
pub(super) struct Parts<'a> {
    pub(super) position: &'a [f64],
    /// All lasting errors, or none.
    pub(super) nuisance: &'a [f64],
}

impl RangeArray {
    pub(super) fn parts<'a>(&self, state: &'a DVector<f64>) -> Result<Parts<'a>> {
        let (d, q) = (self.dims(), self.nuisance_dim());
        let all = state.as_slice();
        if all.len() != d && all.len() < d + q {
            return Err(Error::dimension("state", d + q, all.len()));
        }
        let errors = if all.len() == d { 0 } else { q };
        Ok(Parts {
            position: &all[..d],
            nuisance: &all[all.len() - errors..],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> RangeArraySettings {
        RangeArraySettings {
            hydrophones: DMatrix::from_row_slice(3, 3, &[0.0, 0.0, 250.0, 1000.0, 0.0, 252.0, 500.0, 866.0, 248.0]),
            range_std: vec![1.0],
            survey_std: Vec::new(),
            depth_std: Some(0.3),
            sound_speed: None,
            side: None,
        }
    }

    #[test]
    fn target_on_a_hydrophone_names_the_channel() {
        let array = RangeArray::new(settings()).unwrap();
        let state = DVector::from_vec(vec![1000.0, 0.0, 252.0, 1.0, 1.0, 1.0]);
        for error in [
            array.observe(&state, None).unwrap_err(),
            array.jacobian(&state, None).unwrap_err(),
        ] {
            assert!(matches!(&error, Error::Unobservable { .. }));
            assert!(error.to_string().contains("channel 1"), "{error}");
        }
    }

    #[test]
    fn bad_settings_are_refused_by_name() {
        type Change = fn(&mut RangeArraySettings);
        let changes: [(&str, Change); 8] = [
            ("survey_std", |s| s.survey_std = vec![1.0, 2.0]),
            ("survey_std", |s| s.survey_std = vec![-1.0]),
            ("range_std", |s| s.range_std = vec![1.0, 2.0]),
            ("range_std", |s| s.range_std = vec![0.0]),
            ("depth_std", |s| s.depth_std = Some(-1.0)),
            ("depth_std", |s| s.hydrophones = DMatrix::identity(3, 2)),
            ("hydrophones", |s| s.hydrophones[(0, 0)] = f64::NAN),
            ("hydrophones", |s| s.hydrophones = DMatrix::zeros(0, 3)),
        ];
        for (name, change) in changes {
            let mut bad = settings();
            change(&mut bad);
            let error = RangeArray::new(bad).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }

    #[test]
    fn presets_check_their_geometry() {
        let good = settings().hydrophones;
        assert!(RangeArray::bats(good.clone(), 1.0, 0.3, None).is_ok());
        assert!(RangeArray::toss(good.clone(), 1.0, None, Side::Above).is_err());
        let mut line = good;
        line.set_column(1, &DVector::zeros(3));
        assert!(RangeArray::bats(line, 1.0, 0.3, None).is_err());
        let ladder = DMatrix::from_fn(6, 3, |i, j| (i * (j + 1)) as f64);
        assert!(RangeArray::toss(ladder, 1.0, None, Side::Above).is_err());
    }
}
