//! Reports in the order of one of their components, so that a gate looks only at those its box can hold.
//!
//! Where a gate's box begins is looked up: the component's range is cut into as many equal bins as there are reports, and of
//! each the first report is known; in a full bin it is found by bisection.
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
    /// Where in this order each bin begins, and the end.
    starts: Vec<usize>,
    /// The component at which the first bin begins, and bins per unit of it.
    first: f64,
    density: f64,
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
        self.cut();
    }

    /// Cuts the range into bins.
    fn cut(&mut self) {
        let count = self.order.len();
        let ends = self.order.first().zip(self.order.last());
        let (first, last) = ends.map_or((0.0, 0.0), |(first, last)| (first.0, last.0));
        let density = count as f64 / (last - first);
        // Reports in one place, or farther apart than numbers reach, are in one bin.
        (self.first, self.density) = (first, if density.is_finite() { density } else { 0.0 });
        self.starts.clear();
        for at in 0..count {
            let bin = self.bin(self.order[at].0);
            self.starts.resize(self.starts.len().max(bin + 1), at);
        }
        self.starts.resize(count + 1, count);
    }

    /// The bin of a number; it does not decrease with the number.
    fn bin(&self, key: f64) -> usize {
        // What is below the first bin is in it, and so is NaN; what is beyond the last one is in that.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let bin = ((key - self.first) * self.density) as usize;
        bin.min(self.order.len().saturating_sub(1))
    }

    /// The reports that a box of these half widths may hold, and perhaps others.
    pub(crate) fn near<'s>(&'s self, center: &[f64], half_widths: &[f64]) -> impl Iterator<Item = usize> + use<'s> {
        let (mut from, mut limit) = (0, f64::NAN);
        if let Some(component) = self.component {
            let (low, high) = reach(center[component], half_widths[component]).into_inner();
            let bin = self.bin(low);
            let (begin, end) = (self.starts[bin], self.starts[(bin + 1).min(self.order.len())]);
            from = begin + self.order[begin..end].partition_point(|&(key, _)| key < low);
            limit = high;
        }
        let inside = self.order[from..].iter();
        inside
            // A NaN keeps everything.
            .take_while(move |&&(key, _)| key <= limit || limit.is_nan())
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
