//! A scan: everything one sensor reports in one look, empty scans included.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::linalg::same_bits;

/// The reports of one sensor at one time.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Scan {
    /// Seconds.
    pub time: f64,
    /// Name of the sensor, as the tracker knows it.
    pub sensor: String,
    /// Reports, length m each; NaN where a component was not observed. May be empty: then nothing was detected.
    #[serde(with = "rows")]
    pub values: Vec<DVector<f64>>,
    /// Position of the moving body that carries the sensor, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub platform: Option<Vec<f64>>,
    /// When each report was taken, where that differs; none is later than `time`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<Vec<f64>>,
}

impl Scan {
    /// A scan of a sensor at rest.
    pub fn new(time: f64, sensor: &str, values: Vec<DVector<f64>>) -> Self {
        Self {
            time,
            sensor: sensor.into(),
            values,
            platform: None,
            times: None,
        }
    }

    /// The same scan, taken from a platform at this position.
    #[must_use]
    pub fn from_platform(mut self, position: &[f64]) -> Self {
        self.platform = Some(position.to_vec());
        self
    }

    /// The same scan with the time of each report.
    #[must_use]
    pub fn at_times(mut self, times: &[f64]) -> Self {
        self.times = Some(times.to_vec());
        self
    }

    /// Takes over another, in the memory that is there.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.time = other.time;
        self.sensor.clone_from(&other.sensor);
        self.platform.clone_from(&other.platform);
        self.times.clone_from(&other.times);
        self.values.truncate(other.values.len());
        let kept = self.values.len();
        for (row, value) in self.values.iter_mut().zip(&other.values) {
            if row.len() == value.len() {
                row.as_mut_slice().copy_from_slice(value.as_slice());
            } else {
                row.clone_from(value);
            }
        }
        self.values.extend_from_slice(&other.values[kept..]);
    }

    /// Whether both hold the same sensor, times, platform and reports, bit for bit.
    pub fn same_content(&self, other: &Self) -> bool {
        let given = |x: &Option<Vec<f64>>, y: &Option<Vec<f64>>| {
            same_bits(x.as_deref().unwrap_or_default(), y.as_deref().unwrap_or_default())
        };
        let mut rows = self.values.iter().zip(&other.values);
        self.sensor == other.sensor
            && self.time.to_bits() == other.time.to_bits()
            && self.values.len() == other.values.len()
            && rows.all(|(a, b)| same_bits(a.as_slice(), b.as_slice()))
            && given(&self.platform, &other.platform)
            && given(&self.times, &other.times)
    }
}

mod rows {
    use nalgebra::DVector;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<S: Serializer>(rows: &[DVector<f64>], serializer: S) -> Result<S::Ok, S::Error> {
        let rows: Vec<&[f64]> = rows.iter().map(DVector::as_slice).collect();
        rows.serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<DVector<f64>>, D::Error> {
        let rows = Vec::<Vec<f64>>::deserialize(deserializer)?;
        Ok(rows.into_iter().map(DVector::from_vec).collect())
    }
}
