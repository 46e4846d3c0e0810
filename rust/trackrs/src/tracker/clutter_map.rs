//! A map of echoes that stay in one place.
//!
//! Reports that no confirmed track took are gathered around anchors: a report within `radius` of an anchor moves the
//! anchor to the running mean of its reports, any other becomes a new anchor. An anchor that has gathered at least
//! `min_reports` reports over at least `dwell` seconds is static clutter, and reports within its radius start no track.
//! An anchor without a report for `memory` seconds is forgotten.
//!
//! Time, not the number of scans, decides: sensors of different rates share one map.

use std::collections::HashMap;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_positive};

/// Parameters of a clutter map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ClutterMap {
    /// Reports closer than this belong to one echo, metres.
    pub radius: f64,
    /// An echo seen in one place for so long is static, seconds.
    pub dwell: f64,
    /// And at least so often.
    pub min_reports: u32,
    /// An echo unseen for so long is forgotten, seconds.
    pub memory: f64,
}

impl ClutterMap {
    /// Checks the parameters.
    pub fn check(&self) -> Result<()> {
        require_positive("radius", self.radius)?;
        require_positive("dwell", self.dwell)?;
        require_positive("memory", self.memory)?;
        if self.min_reports < 2 {
            return Err(Error::invalid("min_reports", self.min_reports, "must be at least 2"));
        }
        Ok(())
    }
}

/// Where reports have been gathering.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Anchor {
    position: Vec<f64>,
    first: f64,
    last: f64,
    reports: u32,
}

/// The anchors of a [`ClutterMap`] so far.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ClutterMapState {
    parameters: ClutterMap,
    anchors: Vec<Anchor>,
    #[serde(skip)]
    cells: HashMap<Vec<i64>, Vec<usize>>,
    swept: f64,
}

impl ClutterMapState {
    /// An empty map.
    pub fn new(parameters: ClutterMap) -> Self {
        Self {
            parameters,
            anchors: Vec::new(),
            cells: HashMap::new(),
            swept: f64::NEG_INFINITY,
        }
    }

    /// Whether a report at this position is a known static echo.
    pub fn is_static(&self, position: &DVector<f64>) -> bool {
        let Some(index) = self.nearest(position) else {
            return false;
        };
        let anchor = &self.anchors[index];
        anchor.reports >= self.parameters.min_reports && anchor.last - anchor.first >= self.parameters.dwell
    }

    /// Takes in a report that no confirmed track explains.
    pub fn add(&mut self, position: &DVector<f64>, time: f64) {
        self.forget(time);
        if let Some(index) = self.nearest(position) {
            let before = self.cell(&self.anchors[index].position);
            let anchor = &mut self.anchors[index];
            anchor.reports += 1;
            anchor.last = time;
            let weight = 1.0 / f64::from(anchor.reports);
            for (mean, &value) in anchor.position.iter_mut().zip(position.iter()) {
                *mean += weight * (value - *mean);
            }
            let after = self.cell(&self.anchors[index].position);
            if before != after {
                if let Some(list) = self.cells.get_mut(&before) {
                    list.retain(|&i| i != index);
                }
                self.cells.entry(after).or_default().push(index);
            }
            return;
        }
        let anchor = Anchor {
            position: position.as_slice().to_vec(),
            first: time,
            last: time,
            reports: 1,
        };
        self.cells
            .entry(self.cell(&anchor.position))
            .or_default()
            .push(self.anchors.len());
        self.anchors.push(anchor);
    }

    /// Rebuilds what is not saved; to be called after reading a saved map.
    pub fn restore(&mut self) {
        self.cells.clear();
        for index in 0..self.anchors.len() {
            let cell = self.cell(&self.anchors[index].position);
            self.cells.entry(cell).or_default().push(index);
        }
    }

    /// Drops what has not been seen for long. Sweeping twice per memory span keeps the cost per report constant.
    fn forget(&mut self, time: f64) {
        if time - self.swept < 0.5 * self.parameters.memory {
            return;
        }
        self.swept = time;
        let memory = self.parameters.memory;
        self.anchors.retain(|anchor| time - anchor.last <= memory);
        self.restore();
    }

    fn cell(&self, position: &[f64]) -> Vec<i64> {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "`as` saturates, and far cells may share a bucket"
        )]
        position
            .iter()
            .map(|v| (v / self.parameters.radius).floor() as i64)
            .collect()
    }

    /// The nearest anchor within the radius.
    fn nearest(&self, position: &DVector<f64>) -> Option<usize> {
        let home = self.cell(position.as_slice());
        let mut best: Option<(f64, usize)> = None;
        for corner in 0..3_usize.pow(u32::try_from(home.len()).unwrap_or(0)) {
            let mut code = corner;
            let mut cell = home.clone();
            for index in &mut cell {
                *index = index.saturating_add([-1, 0, 1][code % 3]);
                code /= 3;
            }
            for &index in self.cells.get(&cell).into_iter().flatten() {
                let offsets = self.anchors[index]
                    .position
                    .iter()
                    .zip(position.iter())
                    .map(|(a, b)| a - b);
                let distance = offsets.map(|d| d * d).sum::<f64>().sqrt();
                if distance <= self.parameters.radius && best.is_none_or(|(d, i)| (distance, index) < (d, i)) {
                    best = Some((distance, index));
                }
            }
        }
        best.map(|(_, index)| index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> ClutterMapState {
        ClutterMapState::new(ClutterMap {
            radius: 10.0,
            dwell: 15.0,
            min_reports: 4,
            memory: 40.0,
        })
    }

    fn at(x: f64, y: f64) -> DVector<f64> {
        DVector::from_vec(vec![x, y])
    }

    #[test]
    fn an_echo_that_stays_becomes_static_and_is_forgotten() {
        let mut map = map();
        for k in 0..10 {
            let time = 2.0 * f64::from(k);
            assert_eq!(map.is_static(&at(49.0, -3.0)), time > 16.0, "{time}");
            map.add(&at(50.0 + f64::from(k % 3), -3.0), time);
        }
        assert!(!map.is_static(&at(70.0, -3.0)));
        map.add(&at(500.0, 0.0), 90.0);
        assert!(!map.is_static(&at(50.0, -3.0)));
    }

    #[test]
    fn a_target_that_passes_is_not_static() {
        let mut map = map();
        for k in 0..100 {
            let position = at(3.0 * f64::from(k), 0.0);
            assert!(!map.is_static(&position));
            map.add(&position, f64::from(k));
        }
    }
}
