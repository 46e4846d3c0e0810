//! Looking for a start: how a filter begins without being told where.
//!
//! A run starts at the third of three consecutive measurements whose fixes, where they have redundancy, pass its test; how the state
//! comes of them is in `found.rs`. Where the
//! sensor has lasting errors ([`crate::model::sensor::Nuisance`]), which are common to the three, the state is fitted to all
//! three together (`filter::window`), so that the covariance of position, velocity and errors is exact to first order. A
//! test that lasting errors of an unlikely size fail, they fail again and again: with such the level is α², so that it is
//! not one run in a hundred that never starts.
//!
//! Where single measurements cannot fix a position, as ranges that come one at a time, consecutive ones are gathered until
//! their components together would do; three such groups are fitted together, every measurement at its own time, and the
//! fit is tested by its redundancy. If it fails, the oldest group is dropped. A group holds at most [`GROUP_ROWS`].
//! Reference: paper of Xi, Liu, Tao, Lu; spec label U12 and first-epoch condition.

use nalgebra::DVector;

use super::fit::Row;
use super::found::kinematic_order;
use super::sequence::InitialState;
use super::start::TimedFix;
use crate::error::{Error, Result};
use crate::gaussian::Gaussian;
use crate::model::sensor::PositionFix;
use crate::model::{Motion, Sensor};

/// Fixes in a row that must pass before a run starts.
const CONSECUTIVE: usize = 3;
/// Level of the test of each of them: one good fix in a hundred delays the start.
pub const START_ALPHA: f64 = 0.01;
/// Measurements that are gathered for one group; the oldest make room. It bounds the work per measurement.
pub const GROUP_ROWS: usize = 16;

/// Where a run starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Row of the measurement at whose time the state holds, counted in what was last searched.
    pub row: usize,
    /// The state, with that measurement in it.
    pub initial: InitialState,
    /// How many measurements it is made of.
    pub rows: usize,
}

/// Looks through measurements for the first from which a run can start.
#[derive(Clone)]
pub struct Starter<'a> {
    pub(super) motion: &'a dyn Motion,
    /// The motion of coordinates that add.
    pub(super) base: &'a dyn Motion,
    pub(super) sensor: &'a dyn Sensor,
    pub(super) fixer: &'a dyn PositionFix,
    pub(super) order: usize,
    pub(super) alpha: f64,
    /// Whether fixes that nothing can contradict must agree with one another.
    pub(super) agreement: bool,
    /// What is known of the lasting errors, where the sensor has such.
    pub(super) prior: Option<Gaussian>,
    /// Either all of one measurement with a fix, or all gathered; only the last may be unfinished.
    pub(super) groups: Vec<Group>,
    /// The known input of measurements without any component since the last row.
    carried: Option<Carried>,
    refused: Option<Error>,
}

/// Known inputs gathered until a time.
#[derive(Debug, Clone)]
struct Carried {
    time: f64,
    input: DVector<f64>,
}

/// Measurements that together can fix a position.
#[derive(Debug, Clone, Default)]
pub(super) struct Group {
    pub(super) rows: Vec<Row>,
    /// The fix of a single one, tested.
    fix: Option<Gaussian>,
    complete: bool,
}

impl Group {
    /// The mean of every component over the measurements that have it.
    pub(super) fn gathered(&self, components: usize) -> DVector<f64> {
        DVector::from_fn(components, |i, _| {
            let heard: Vec<f64> = self
                .rows
                .iter()
                .map(|row| row.measurement[i])
                .filter(|v| !v.is_nan())
                .collect();
            heard.iter().sum::<f64>() / heard.len() as f64
        })
    }
}

impl<'a> Starter<'a> {
    /// A search with fixes tested at level `alpha`; an error if these models cannot start a state.
    pub fn new(motion: &'a dyn Motion, sensor: &'a dyn Sensor, alpha: f64) -> Result<Self> {
        let missing = |why: &str| Err(Error::invalid("initial", "missing", why));
        let Some(fixer) = sensor.position_fix() else {
            return missing("must be given: the sensor alone cannot start a state");
        };
        let nuisance = sensor.nuisance();
        let base = motion.base().unwrap_or(motion);
        let Some(order) = kinematic_order(base, nuisance.as_ref().map_or(&[], |n| n.labels.as_slice())) else {
            return missing("must be given: only a state of position, velocity and acceleration starts by itself");
        };
        crate::error::require_probability("alpha", alpha)?;
        let alpha = if nuisance.is_some() { alpha * alpha } else { alpha };
        Ok(Self {
            motion,
            base,
            sensor,
            fixer,
            order,
            alpha,
            agreement: false,
            prior: nuisance.map(|n| n.prior()),
            groups: Vec::new(),
            carried: None,
            refused: None,
        })
    }

    /// The same search where the lasting errors, the last components of `state`, are known as well as there.
    #[must_use]
    pub fn with_errors_of(mut self, state: &Gaussian) -> Self {
        if let Some(prior) = &mut self.prior {
            let (q, n) = (prior.dim(), state.dim());
            prior.mean.copy_from(&state.mean.rows(n - q, q));
            prior.cov.copy_from(&state.cov.view((n - q, n - q), (q, q)));
        }
        self
    }

    /// The same search where fixes without redundancy of their own must agree with one another, one more of them than the
    /// state has derivatives: what a filter that has lost its target may not start from is three gross errors.
    #[must_use]
    pub(super) fn with_agreement(mut self) -> Self {
        self.agreement = self.fixer.redundancy() == 0;
        self
    }

    /// How many groups make a start.
    fn needed(&self) -> usize {
        if self.agreement {
            CONSECUTIVE.max(self.order + 1)
        } else {
            CONSECUTIVE
        }
    }

    /// The first start in these measurements, which follow those searched before. `inputs`, where given, are one vector
    /// per measurement, added to the state predicted to its time.
    pub fn search(
        &mut self,
        times: &[f64],
        measurements: &[DVector<f64>],
        inputs: Option<&[DVector<f64>]>,
    ) -> Result<Option<Start>> {
        for (row, (&time, measurement)) in times.iter().zip(measurements).enumerate() {
            let input = inputs.and_then(|inputs| inputs.get(row));
            if let Some(initial) = self.push(time, measurement, input)? {
                let rows = self.groups.iter().map(|group| group.rows.len()).sum();
                return Ok(Some(Start { row, initial, rows }));
            }
        }
        Ok(None)
    }

    /// The start that this measurement, which follows those searched before, makes possible.
    pub fn push(
        &mut self,
        time: f64,
        measurement: &DVector<f64>,
        input: Option<&DVector<f64>>,
    ) -> Result<Option<InitialState>> {
        let input = self.carry(time, input);
        match self.take(time, measurement, input) {
            Ok(()) => {}
            // An infinite number is a fault of the caller, not of the sea.
            Err(error @ (Error::NonFinite { .. } | Error::DimensionMismatch { .. })) => return Err(error),
            Err(error) => {
                self.groups.clear();
                self.refused.get_or_insert(error);
            }
        }
        let needed = self.needed();
        if self.groups.iter().filter(|group| group.complete).count() < needed {
            return Ok(None);
        }
        let rows = || self.groups.iter().flat_map(|group| &group.rows);
        let pushed = self.prior.is_some() || rows().skip(1).any(Row::is_pushed);
        let fixes: Option<Vec<TimedFix>> = self
            .groups
            .iter()
            .map(|group| {
                let (time, position) = (group.rows.last()?.time, group.fix.clone()?);
                Some(TimedFix { time, position })
            })
            .collect();
        let found = match fixes {
            Some(fixes) if !pushed => self.through(&fixes),
            _ => self.fit().map(|state| InitialState { time, state }),
        };
        match found {
            Ok(initial) => Ok(Some(initial)),
            Err(error) => {
                self.groups.remove(0);
                self.refused.get_or_insert(error);
                Ok(None)
            }
        }
    }

    /// The known input since the last row with components.
    fn carry(&mut self, time: f64, input: Option<&DVector<f64>>) -> Option<DVector<f64>> {
        let before = self.carried.take();
        let input = input?;
        // Lasting errors have no input.
        let missing = self.motion.state_dim().saturating_sub(input.len());
        let input = input.clone().insert_rows(input.len(), missing, 0.0);
        Some(match before {
            Some(Carried { time: then, input: sum }) => self.motion.jacobian(&sum, time - then) * &sum + input,
            None => input,
        })
    }

    /// Adds a measurement to the groups; an error breaks the sequence.
    fn take(&mut self, time: f64, measurement: &DVector<f64>, input: Option<DVector<f64>>) -> Result<()> {
        self.fixer.check_values(measurement)?;
        if measurement.iter().all(|v| v.is_nan()) {
            self.carried = input.clone().map(|input| Carried { time, input });
        }
        let row = Row {
            time,
            measurement: measurement.clone(),
            input,
        };
        if self.fixer.sufficient(measurement.as_slice()) {
            let fix = Some(self.tested(measurement)?);
            let repeated = |group: &Group| group.fix.is_none() || group.rows.last().is_some_and(|row| row.time == time);
            if self.groups.last().is_some_and(repeated) {
                self.groups.clear();
            }
            self.groups.push(Group {
                rows: vec![row],
                fix,
                complete: true,
            });
            return Ok(());
        }
        // Too little for a fix of its own: why is worth saying if nothing starts.
        if let Err(error) = self.tested(measurement) {
            self.refused.get_or_insert(error);
        }
        if self.groups.iter().any(|group| group.fix.is_some()) || !self.fixer.gathers() {
            self.groups.clear();
        }
        if !self.fixer.gathers() || measurement.iter().all(|v| v.is_nan()) {
            return Ok(());
        }
        if self.groups.last().is_none_or(|group| group.complete) {
            self.groups.push(Group::default());
        }
        if let Some(group) = self.groups.last_mut() {
            if group.rows.len() == GROUP_ROWS {
                group.rows.remove(0);
            }
            group.rows.push(row);
            group.complete = self.fixer.sufficient(group.gathered(measurement.len()).as_slice());
        }
        Ok(())
    }

    /// The error of a search that found nothing.
    pub fn failure(&self) -> Error {
        let first = self
            .refused
            .as_ref()
            .map_or(String::new(), |e| format!("; first refusal: {e}"));
        Error::Unobservable {
            sensor: self.fixer.name().into(),
            reason: format!(
                "no {CONSECUTIVE} consecutive measurements, or groups of them, gave position fixes that pass their test (alpha = {}){first}",
                self.alpha
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::start::start_state;
    use crate::model::motion::{ConstantAcceleration, KinematicNoise};
    use crate::model::sensor::{RangeArray, RangeArraySettings};
    use approx::assert_relative_eq;
    use nalgebra::DMatrix;

    fn array() -> RangeArray {
        RangeArray::new(RangeArraySettings {
            hydrophones: DMatrix::from_row_slice(3, 3, &[0.0, 0.0, 250.0, 1000.0, 0.0, 252.0, 500.0, 866.0, 248.0]),
            range_std: vec![1.0],
            survey_std: Vec::new(),
            depth_std: Some(0.3),
            sound_speed: None,
            side: None,
        })
        .unwrap()
    }

    /// Without lasting errors and motion noise, three complete rows and nine unknowns, the fit is U12 itself.
    #[test]
    fn fit_to_three_complete_rows_is_the_polynomial_through_their_fixes() {
        let (array, motion) = (
            array(),
            ConstantAcceleration::new(KinematicNoise::Std(vec![0.0; 3])).unwrap(),
        );
        let mut starter = Starter::new(&motion, &array, 1e-9).unwrap();
        let positions = [[-300.0, -250.0, 50.0], [-270.0, -238.0, 51.0], [-200.0, -205.0, 52.5]];
        let mut fixes = Vec::new();
        for (time, p) in [0.0, 2.0, 5.0].into_iter().zip(positions) {
            let mut z = array.observe(&DVector::from_row_slice(&p), None).unwrap();
            z[0] += 0.8;
            z[2] -= 0.5 * time;
            starter.take(time, &z, None).unwrap();
            let position = array.fix(&z).unwrap().position;
            fixes.push(TimedFix { time, position });
        }
        let polynomial = start_state(&fixes, 3, Some(&motion)).unwrap().state;
        let fitted = starter.fit().unwrap();
        assert_relative_eq!(fitted.mean, polynomial.mean, epsilon = 1e-5, max_relative = 1e-5);
        assert_relative_eq!(fitted.cov, polynomial.cov, epsilon = 1e-6, max_relative = 1e-4);
    }

    #[test]
    fn a_group_that_never_completes_stays_bounded() {
        let (array, motion) = (
            array(),
            ConstantAcceleration::new(KinematicNoise::Std(vec![0.1; 3])).unwrap(),
        );
        let mut starter = Starter::new(&motion, &array, START_ALPHA).unwrap();
        let z = DVector::from_vec(vec![300.0, f64::NAN, f64::NAN, f64::NAN]);
        for k in 0..100 {
            assert_eq!(starter.push(f64::from(k), &z, None).unwrap(), None);
        }
        assert_eq!((starter.groups.len(), starter.groups[0].rows.len()), (1, GROUP_ROWS));
        assert!(starter.failure().to_string().contains("needs 3 ranges, 1 heard"));
    }
}
