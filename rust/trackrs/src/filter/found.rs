//! What a start is made of: the state through the last fixes, or fitted to all measurements of the groups. Each is tested.
//!
//! Fixes of their own are joined by [`super::start`], in coordinates counted from the last of them; groups are fitted by
//! [`super::fit`]. Fixes that nothing contradicts are tested against one another where the search asks for it: those beyond the
//! first few by the sum of their normalised innovations squared.

use nalgebra::{DMatrix, DVector};

use super::fit::{Fitted, Row, Window};
use super::kalman::{self, MeasurementPrediction};
use super::search::Starter;
use super::sequence::InitialState;
use super::start::{TimedFix, local_fixes, start_state};
use crate::error::{Error, Result};
use crate::gaussian::Gaussian;
use crate::model::Motion;
use crate::model::sensor::MIRROR_GAP;
use crate::stats::chi_square;

/// Two fits closer than this share of their standard deviations are one.
const SAME: f64 = 1e-2;

impl Starter<'_> {
    /// The state at the last of these fixes.
    pub(super) fn through(&self, fixes: &[TimedFix]) -> Result<InitialState> {
        let attitude = self.motion.space().attitude;
        let local = local_fixes(fixes, self.fixer.angles(), attitude);
        if self.agreement {
            self.require_agreement(&local)?;
        }
        let mut start = start_state(&local[local.len() - self.order..], self.order, Some(self.base))?;
        if let (Some(at), Some(last)) = (attitude, fixes.last()) {
            // The turn from the last fix is zero there.
            let turn = last.position.mean.fixed_rows::<3>(at);
            start.state.mean.fixed_rows_mut::<3>(at).copy_from(&turn);
        }
        Ok(start)
    }

    /// Whether the fixes beyond the first few lie where these say, by the test of their innovations.
    fn require_agreement(&self, fixes: &[TimedFix]) -> Result<()> {
        let (first, rest) = fixes.split_at(self.order);
        let InitialState { mut time, mut state } = start_state(first, self.order, Some(self.base))?;
        let (mut statistic, mut dof) = (0.0, 0);
        for fix in rest {
            state = kalman::predict(&state, self.base, fix.time - time, None)?;
            time = fix.time;
            let d = fix.position.dim();
            let position = DMatrix::identity(d, state.dim());
            let expected = MeasurementPrediction::new(&state, &position, &fix.position.cov)?;
            let update = expected.update(&state, &(&fix.position.mean - &position * &state.mean))?;
            statistic += update.nis;
            dof += d;
            state = update.posterior;
        }
        self.require_likely(chi_square::survival(statistic, dof))
    }

    /// The state fitted to all groups, tested.
    pub(super) fn fit(&self) -> Result<Gaussian> {
        if self.motion.space().attitude.is_some() {
            let requirement = "must be given where known inputs move a state with an attitude";
            return Err(Error::invalid("initial", "missing", requirement));
        }
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
    pub(super) fn tested(&self, measurement: &DVector<f64>) -> Result<Gaussian> {
        let fix = self.fixer.fix(measurement)?;
        if fix.dof == 0 && self.fixer.redundancy() > 0 {
            let reason = "too few components to test the fix";
            return Err(Error::invalid("measurement", "incomplete", reason));
        }
        self.require_likely(fix.p_value)?;
        Ok(fix.position)
    }
}

/// How many derivatives a state of blocks `x y z vx vy vz ax ay az` holds, with these labels behind it; None for another
/// kind of state.
pub(super) fn kinematic_order(motion: &dyn Motion, behind: &[String]) -> Option<usize> {
    let d = motion.position_dims();
    let labels = motion.labels();
    let labels = labels.strip_suffix(behind)?;
    let order = labels.len().checked_div(d)?;
    let fits = |(i, label): (usize, &String)| *label == format!("{}{}", ["", "v", "a"][i / d], labels[i % d]);
    let kinematic = (1..=3).contains(&order) && labels.len() == order * d && labels.iter().enumerate().all(fits);
    kinematic.then_some(order)
}
