//! A state from position fixes: how a filter begins without being told where.
//!
//! | symbol   | name here    | shape | meaning                                                       |
//! |----------|--------------|-------|---------------------------------------------------------------|
//! | r        | `order`      |       | derivatives in the state: 1 position, 2 velocity, 3 acceleration |
//! | p_i, C_i | `position`   | d, d×d | fixes at t_1 < … < t_r, and their covariances                |
//! | V        | `vandermonde` | r×r  | V_ij = (t_i − t_r)^j / j!                                     |
//! | W_i      | `noise`      | n×n   | covariance of the motion noise from t_i to t_r                |
//!
//! The polynomial through r fixes, at the time of the last (U12): x = (V⁻¹ ⊗ I) [p_1; …; p_r],
//! P = (V⁻¹ ⊗ I) blkdiag(C_1, …, C_r) (V⁻¹ ⊗ I)ᵀ: position, velocity and acceleration are strongly correlated.
//!
//! With a motion model, the noise between the fixes is added: p_i = v_i (x − w_i) + e_i with v_i row i of V ⊗ I, so that
//! E[v_i w_i (v_j w_j)ᵀ] = v_i W_j v_jᵀ for i ≤ j joins the covariance of the fixes. Without one it is U12 as it stands.
//!
//! A run starts at the third of three consecutive measurements whose fixes all pass the test of their redundancy. Where the
//! sensor has lasting errors ([`crate::model::sensor::Nuisance`]), which are common to the three, the state is fitted to all
//! three together ([`super::window`]), so that the covariance of position, velocity and errors is exact to first order.
//!
//! Where single measurements cannot fix a position, as ranges that come one at a time, consecutive ones are gathered until
//! their components together would do; three such groups are fitted together, every measurement at its own time, and the
//! fit is tested by its redundancy. If it fails, the oldest group is dropped. A group holds at most [`GROUP_ROWS`].
//! Reference: paper of Xi, Liu, Tao, Lu, initial values; spec label U12 and first-epoch condition.
//! Deviation: the paper takes the velocity of the first interval and a block-diagonal covariance.

use nalgebra::{DMatrix, DVector};

use super::sequence::InitialState;
use super::window::{Fitted, Row, Window};
use crate::error::{Error, Result, require_finite, require_size};
use crate::gaussian::Gaussian;
use crate::linalg::symmetric::symmetrise;
use crate::model::sensor::{MIRROR_GAP, PositionFix};
use crate::model::{Motion, Sensor};
use crate::stats::chi_square;

/// Fixes in a row that must pass before a run starts.
const CONSECUTIVE: usize = 3;
/// Level of the test of each of them: one good fix in a hundred delays the start.
pub const START_ALPHA: f64 = 0.01;
/// Measurements that are gathered for one group; the oldest make room. It bounds the work per measurement.
pub const GROUP_ROWS: usize = 16;
/// Two fits closer than this share of their standard deviations are one.
const SAME: f64 = 1e-2;

/// A position at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct TimedFix {
    /// Seconds.
    pub time: f64,
    /// Position and covariance.
    pub position: Gaussian,
}

/// The state at the last of `order` fixes: position, velocity and acceleration as far as `order` goes.
///
/// With a `motion` its noise between the fixes counts in the covariance.
pub fn start_state(fixes: &[TimedFix], order: usize, motion: Option<&dyn Motion>) -> Result<InitialState> {
    let d = check(fixes, order, motion)?;
    let times: Vec<f64> = fixes.iter().map(|f| f.time).collect();
    let last = times[order - 1];
    let vandermonde = DMatrix::from_fn(order, order, |i, j| {
        let t = times[i] - last;
        [1.0, t, t * t / 2.0][j]
    });
    let Some(inverse) = vandermonde.clone().try_inverse() else {
        return Err(Error::invalid("times of the fixes", "given", "must lie farther apart"));
    };
    let mut stacked = DVector::zeros(order * d);
    let mut cov = DMatrix::zeros(order * d, order * d);
    for (i, fix) in fixes.iter().enumerate() {
        stacked.rows_mut(i * d, d).copy_from(&fix.position.mean);
        cov.view_mut((i * d, i * d), (d, d)).copy_from(&fix.position.cov);
    }
    let identity = DMatrix::<f64>::identity(d, d);
    if let Some(motion) = motion {
        add_noise(&mut cov, &times, &vandermonde.kronecker(&identity), motion);
    }
    let solve = inverse.kronecker(&identity);
    let mean = &solve * stacked;
    let mut cov = &solve * cov * solve.transpose();
    symmetrise(&mut cov);
    Ok(InitialState {
        time: last,
        state: Gaussian { mean, cov },
    })
}

/// The dimension d of the fixes.
fn check(fixes: &[TimedFix], order: usize, motion: Option<&dyn Motion>) -> Result<usize> {
    if !(1..=3).contains(&order) {
        return Err(Error::invalid("order", order, "must be 1, 2 or 3"));
    }
    require_size("fixes", order, fixes.len())?;
    let d = fixes[0].position.dim();
    for fix in fixes {
        require_size("position of a fix", d, fix.position.dim())?;
        require_finite("time of a fix", [&fix.time])?;
    }
    if let Some(motion) = motion {
        require_size("state of the motion model", order * d, motion.state_dim())?;
    }
    for pair in fixes.windows(2) {
        let (previous, time) = (pair[0].time, pair[1].time);
        if time < previous {
            return Err(Error::TimeReversed { time, previous });
        }
        if time == previous {
            return Err(Error::invalid("time of a fix", time, "must differ from the one before"));
        }
    }
    Ok(d)
}

fn add_noise(cov: &mut DMatrix<f64>, times: &[f64], rows: &DMatrix<f64>, motion: &dyn Motion) {
    let (order, n) = (times.len(), motion.state_dim());
    let d = n / order;
    let origin = DVector::zeros(n);
    let last = times[order - 1];
    let mut noise = DMatrix::zeros(n, n);
    for j in (0..order.saturating_sub(1)).rev() {
        let f = motion.jacobian(&origin, last - times[j + 1]);
        noise += &f * motion.noise(times[j + 1] - times[j]) * f.transpose();
        let right = &noise * rows.rows(j * d, d).transpose();
        for i in 0..=j {
            let block = rows.rows(i * d, d) * &right;
            let mut upper = cov.view_mut((i * d, j * d), (d, d));
            upper += &block;
            if i < j {
                let mut lower = cov.view_mut((j * d, i * d), (d, d));
                lower += block.transpose();
            }
        }
    }
}

/// Where a run starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Row of the measurement at whose time the state holds, counted in what was last searched.
    pub row: usize,
    /// The state, with that measurement in it.
    pub initial: InitialState,
}

/// Looks through measurements for the first from which a run can start.
#[derive(Clone)]
pub struct Starter<'a> {
    motion: &'a dyn Motion,
    sensor: &'a dyn Sensor,
    fixer: &'a dyn PositionFix,
    order: usize,
    alpha: f64,
    /// What is known of the lasting errors, where the sensor has such.
    prior: Option<Gaussian>,
    /// Either all of one measurement with a fix, or all gathered; only the last may be unfinished.
    groups: Vec<Group>,
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
struct Group {
    rows: Vec<Row>,
    /// The fix of a single one, tested.
    fix: Option<Gaussian>,
    complete: bool,
}

impl Group {
    /// The mean of every component over the measurements that have it.
    fn gathered(&self, components: usize) -> DVector<f64> {
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
        let Some(order) = kinematic_order(motion, nuisance.as_ref().map_or(&[], |n| n.labels.as_slice())) else {
            return missing("must be given: only a state of position, velocity and acceleration starts by itself");
        };
        crate::error::require_probability("alpha", alpha)?;
        Ok(Self {
            motion,
            sensor,
            fixer,
            order,
            alpha,
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
                return Ok(Some(Start { row, initial }));
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
        if self.groups.iter().filter(|group| group.complete).count() < CONSECUTIVE {
            return Ok(None);
        }
        let rows = || self.groups.iter().flat_map(|group| &group.rows);
        let pushed = self.prior.is_some() || rows().skip(1).any(|row| row.input.is_some());
        let fixes: Option<Vec<TimedFix>> = self.groups[CONSECUTIVE - self.order..]
            .iter()
            .map(|group| {
                let (time, position) = (group.rows.last()?.time, group.fix.clone()?);
                Some(TimedFix { time, position })
            })
            .collect();
        match fixes {
            Some(fixes) if !pushed => start_state(&fixes, self.order, Some(self.motion)).map(Some),
            _ => match self.fit() {
                Ok(state) => Ok(Some(InitialState { time, state })),
                Err(error) => {
                    self.groups.remove(0);
                    self.refused.get_or_insert(error);
                    Ok(None)
                }
            },
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
        if self.fixer.sufficient(measurement) {
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
        if self.groups.iter().any(|group| group.fix.is_some()) {
            self.groups.clear();
        }
        if measurement.iter().all(|v| v.is_nan()) {
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
            group.complete = self.fixer.sufficient(&group.gathered(measurement.len()));
        }
        Ok(())
    }

    /// The state fitted to all groups, tested.
    fn fit(&self) -> Result<Gaussian> {
        let nothing = Gaussian {
            mean: DVector::zeros(0),
            cov: DMatrix::zeros(0, 0),
        };
        let rows: Vec<&Row> = self.groups.iter().flat_map(|group| &group.rows).collect();
        let latest = self.groups.last().cloned().unwrap_or_default();
        let gathered = latest.gathered(self.sensor.measurement_dim());
        let window = Window::new(rows, self.motion, self.sensor, self.prior.as_ref().unwrap_or(&nothing))?;
        let mut fits: Vec<Fitted> = Vec::new();
        let mut failure = None;
        for position in self.fixer.candidates(&gathered)? {
            match window.fit_from(&position) {
                Ok(new) => {
                    let known = |old: &Fitted| {
                        let difference = &old.state.mean - &new.state.mean;
                        difference.dot(&(&old.information * &difference)) < SAME * SAME
                    };
                    if !fits.iter().any(known) {
                        fits.push(new);
                    }
                }
                Err(error) => failure = Some(error),
            }
        }
        fits.sort_by(|a, b| a.statistic.total_cmp(&b.statistic));
        let mut fits = fits.into_iter();
        let Some(mut chosen) = fits.next() else {
            return Err(failure.unwrap_or_else(|| self.failure()));
        };
        if let Some(rival) = fits.next().filter(|fit| fit.statistic - chosen.statistic < MIRROR_GAP) {
            let d = self.motion.position_dims();
            let (first, second) = (chosen.state.leading(d).mean, rival.state.leading(d).mean);
            if !self.fixer.takes_first(&gathered, &first, &second)? {
                chosen = rival;
            }
        }
        if chosen.dof > 0 {
            self.require_likely(chi_square::survival(chosen.statistic, chosen.dof))?;
        }
        Ok(chosen.state)
    }

    fn require_likely(&self, p_value: f64) -> Result<()> {
        if p_value >= self.alpha {
            return Ok(());
        }
        let requirement = format!("must be at least {} to start from this fix", self.alpha);
        Err(Error::invalid("p_value of the fix", p_value, &requirement))
    }

    /// A fix that passed its test. Where the sensor has redundancy, a fix without any is not good enough.
    fn tested(&self, measurement: &DVector<f64>) -> Result<Gaussian> {
        let fix = self.fixer.fix(measurement)?;
        if fix.dof == 0 && self.fixer.redundancy() > 0 {
            let reason = "too few components to test the fix";
            return Err(Error::invalid("measurement", "incomplete", reason));
        }
        self.require_likely(fix.p_value)?;
        Ok(fix.position)
    }

    /// The error of a search that found nothing.
    pub fn failure(&self) -> Error {
        let first = self
            .refused
            .as_ref()
            .map_or(String::new(), |e| format!("; first refusal: {e}"));
        Error::Unobservable {
            sensor: "the array".into(),
            reason: format!(
                "no {CONSECUTIVE} consecutive measurements, or groups of them, gave position fixes that pass their test (alpha = {}){first}",
                self.alpha
            ),
        }
    }
}

/// How many derivatives a state of blocks `x y z vx vy vz ax ay az` holds, with these labels behind it; None for another
/// kind of state.
fn kinematic_order(motion: &dyn Motion, behind: &[String]) -> Option<usize> {
    let d = motion.position_dims();
    let labels = motion.labels();
    let labels = labels.strip_suffix(behind)?;
    let order = labels.len().checked_div(d)?;
    let fits = |(i, label): (usize, &String)| *label == format!("{}{}", ["", "v", "a"][i / d], labels[i % d]);
    let kinematic = (1..=3).contains(&order) && labels.len() == order * d && labels.iter().enumerate().all(fits);
    kinematic.then_some(order)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise};
    use approx::assert_relative_eq;

    fn fix(time: f64, x: f64, variance: f64) -> TimedFix {
        TimedFix {
            time,
            position: Gaussian {
                mean: DVector::from_vec(vec![x]),
                cov: DMatrix::from_element(1, 1, variance),
            },
        }
    }

    #[test]
    fn equal_steps_are_the_difference_formulas() {
        let (dt, p) = (0.5, [1.0, 2.0, 4.5]);
        let fixes = [fix(0.0, p[0], 1.0), fix(dt, p[1], 2.0), fix(2.0 * dt, p[2], 3.0)];
        let start = start_state(&fixes, 3, None).unwrap();
        let v = (3.0 * p[2] - 4.0 * p[1] + p[0]) / (2.0 * dt);
        let a = (p[2] - 2.0 * p[1] + p[0]) / (dt * dt);
        assert_relative_eq!(start.state.mean, DVector::from_vec(vec![p[2], v, a]), epsilon = 1e-12);
        assert_relative_eq!(start.state.cov[(2, 2)], (1.0 + 8.0 + 3.0) / dt.powi(4), epsilon = 1e-9);
        let two = start_state(&fixes[1..], 2, None).unwrap();
        assert_relative_eq!(two.state.mean[1], (p[2] - p[1]) / dt, epsilon = 1e-12);
        assert_eq!(two.time, 1.0);
        assert_eq!(start_state(&fixes[2..], 1, None).unwrap().state, fixes[2].position);
    }

    /// The information filter over the same fixes, started from nothing, is the same estimate.
    #[test]
    fn noise_between_fixes_agrees_with_a_filter_from_a_flat_prior() {
        let fixes = [fix(0.0, 1.0, 1.0), fix(0.7, 2.0, 2.0), fix(2.0, 4.5, 3.0)];
        let models: [(&dyn Motion, usize); 2] = [
            (&ConstantAcceleration::new(KinematicNoise::Psd(vec![0.5])).unwrap(), 3),
            (&ConstantVelocity::new(KinematicNoise::Std(vec![0.8])).unwrap(), 2),
        ];
        for (motion, order) in models {
            let used = &fixes[3 - order..];
            let start = start_state(used, order, Some(motion)).unwrap();
            let mut state = Gaussian {
                mean: DVector::zeros(order),
                cov: DMatrix::identity(order, order) * 1e8,
            };
            let mut now = used[0].time;
            for f in used {
                state = super::super::kalman::predict(&state, motion, f.time - now, None);
                now = f.time;
                let h = DMatrix::identity(1, order);
                let r = &f.position.mean - &h * &state.mean;
                let prediction =
                    super::super::kalman::MeasurementPrediction::new(&state, h, f.position.cov.clone()).unwrap();
                state = prediction.posterior(&state, &r);
            }
            assert_relative_eq!(start.state.mean, state.mean, max_relative = 1e-4);
            assert_relative_eq!(start.state.cov, state.cov, max_relative = 1e-4);
        }
    }

    #[test]
    fn times_must_increase_and_counts_agree() {
        let at = |t| fix(t, 1.0, 1.0);
        assert!(matches!(
            start_state(&[at(1.0), at(0.0)], 2, None),
            Err(Error::TimeReversed { .. })
        ));
        assert!(start_state(&[at(1.0), at(1.0)], 2, None).is_err());
        assert!(start_state(&[at(1.0)], 2, None).is_err());
        assert!(start_state(&[], 0, None).is_err());
    }
}
