//! Reports in the order of one of their components, so that a gate looks only at those its box can hold.
//!
//! The component is the one in which the reports spread most, counted in standard deviations of the sensor's noise. Angles
//! have a seam and rotations no order: they are passed over. Reports without the component are looked at by every gate, and
//! so are all of them where there is no component to go by.

use std::ops::RangeInclusive;

use crate::model::Sensor;

/// Rounding of a difference of two numbers, generously.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// From where to where numbers can be that are no farther than `width`, whatever the rounding.
pub(super) fn reach(at: f64, width: f64) -> RangeInclusive<f64> {
    let margin = width + ROUNDING * (at.abs() + width);
    at - margin..=at + margin
}

/// The order of the reports of one scan. Its memory serves one scan after another.
#[derive(Debug, Default)]
pub(crate) struct Sweep {
    component: Option<usize>,
    /// The component and the report.
    order: Vec<(f64, usize)>,
    /// Reports that every gate looks at.
    anywhere: Vec<usize>,
}

impl Sweep {
    /// Takes in reports by their numbers.
    pub(crate) fn set<'a>(&mut self, sensor: &dyn Sensor, reports: impl Iterator<Item = (usize, &'a [f64])> + Clone) {
        self.component = widest(sensor, &reports.clone().map(|(_, value)| value));
        self.order.clear();
        self.anywhere.clear();
        for (report, value) in reports {
            match self.component.map(|component| value[component]) {
                Some(key) if !key.is_nan() => self.order.push((key, report)),
                _ => self.anywhere.push(report),
            }
        }
        self.order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    }

    /// The reports that a box of these half widths may hold, and perhaps others.
    pub(crate) fn near<'s>(&'s self, center: &[f64], half_widths: &[f64]) -> impl Iterator<Item = usize> + use<'s> {
        let mut inside = &self.order[..];
        if let Some(component) = self.component {
            let (low, high) = reach(center[component], half_widths[component]).into_inner();
            let from = inside.partition_point(|&(key, _)| key < low);
            inside = &inside[from..];
            // A NaN keeps everything.
            let to = inside.partition_point(|&(key, _)| key <= high || high.is_nan());
            inside = &inside[..to];
        }
        inside
            .iter()
            .map(|&(_, report)| report)
            .chain(self.anywhere.iter().copied())
    }
}

fn widest<'a>(sensor: &dyn Sensor, reports: &(impl Iterator<Item = &'a [f64]> + Clone)) -> Option<usize> {
    let (m, angles, rotation) = (sensor.measurement_dim(), sensor.angles(), sensor.rotation());
    let ordered = |i: usize| !angles.contains(&i) && !rotation.is_some_and(|at| (at..at + 3).contains(&i));
    let components = (0..m).filter(|&i| ordered(i));
    if components.clone().nth(1).is_none() {
        return components.clone().next();
    }
    let noise = sensor.noise();
    let spread = |component: usize| {
        let values = reports.clone().map(|value| value[component]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        (high - low) / noise[(component, component)].sqrt()
    };
    components
        .map(|component| (spread(component), component))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, component)| component)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sensor::{PositionSensor, RangeBearing};

    fn near(sensor: &dyn Sensor, reports: &[[f64; 2]], center: [f64; 2], widths: [f64; 2]) -> Vec<usize> {
        let mut sweep = Sweep::default();
        sweep.set(sensor, reports.iter().map(|value| &value[..]).enumerate());
        let mut found: Vec<usize> = sweep.near(&center, &widths).collect();
        found.sort_unstable();
        found
    }

    #[test]
    fn all_that_the_box_holds_are_near_and_few_others() {
        let sensor = PositionSensor::new(vec![1.0, 1.0]).unwrap();
        let mut reports: Vec<[f64; 2]> = (0..40).map(|i| [f64::from(i % 7), f64::from(i * 13 % 40)]).collect();
        reports.push([f64::NAN, 11.0]);
        reports.push([3.0, f64::NAN]);
        let found = near(&sensor, &reports, [3.0, 20.0], [9.0, 2.0]);
        let expected: Vec<usize> = (0..42)
            .filter(|&i| reports[i][1].is_nan() || (reports[i][1] - 20.0).abs() <= 2.0)
            .collect();
        assert_eq!(found, expected);
        assert_eq!(near(&sensor, &reports, [3.0, 20.0], [9.0, f64::INFINITY]).len(), 42);
        assert_eq!(near(&sensor, &reports, [3.0, f64::NAN], [9.0, 1.0]).len(), 42);
        assert_eq!(near(&sensor, &[], [3.0, 20.0], [9.0, 2.0]), [0; 0]);
    }

    #[test]
    fn an_edge_is_inside_whatever_the_rounding() {
        let sensor = PositionSensor::new(vec![1.0, 1.0]).unwrap();
        for (at, width) in [(0.1, 0.2), (1e8, 0.3), (-7.3, 1e-9), (1e-12, 3.3)] {
            let reports = [[at + width, 0.0], [at - width, 0.0], [at + 9.0, 0.0], [at - 9.0, 0.0]];
            let found = near(&sensor, &reports, [at, 0.0], [width, 1.0]);
            let inside = (0..4).filter(|&i: &usize| (reports[i][0] - at).abs() <= width);
            assert!(inside.into_iter().all(|i| found.contains(&i)));
        }
    }

    #[test]
    fn angles_are_not_swept() {
        let sensor = RangeBearing::new([0.0, 0.0], 10.0, 1e-9).unwrap();
        let reports = [[100.0, 3.1], [100.0, -3.1], [900.0, 3.1]];
        assert_eq!(near(&sensor, &reports, [110.0, 3.1], [20.0, 0.1]), [0, 1]);
    }
}
