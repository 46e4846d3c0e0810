//! Two reports begin a track: two-point differencing (N14).
//!
//! | symbol     | name here      | meaning                                                                  |
//! |------------|----------------|--------------------------------------------------------------------------|
//! | p_0, C_0   | `Waiting`      | where an earlier report lies that began no track, with its covariance    |
//! | p, C       | `reports`      | the same of a report of this scan                                        |
//! | d          | `dt`           | time between the two, seconds                                            |
//! | v_max      | `max_speed`    | upper bound on the speed of a target, m/s                                |
//! | t_max      | `within`       | a report waits no longer, seconds                                        |
//!
//! 1. p and p_0 may be a pair if 0 < d ≤ t_max and |p − p_0| ≤ v_max d + 3 √tr(C + C_0).
//! 2. A report takes the most recent p_0 that it may pair with, and p_0 waits no more. Reports come in the order of their
//!    times; of several at one time, and of several p_0 of one time, the nearest pair goes first, so that the order of the
//!    rows says nothing.
//! 3. The pair begins a track: x = [p, (p − p_0)/d], P_pp = C, P_pv = C/d, P_vv = (C + C_0)/d², which is the line through the
//!    two ([`crate::filter::start`]). Further derivatives are as in a start from one report.
//! 4. A report without a partner waits itself.
//!
//! Reference: spec label N14; Bar-Shalom, Li, Kirubarajan (2001), §5.5 (two-point differencing).
//! Deviation: both reports of a pair are never of one scan, because a target gives a scan at most one report.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_probability, require_size};
use crate::filter::start::{TimedFix, start_state};
use crate::gaussian::Gaussian;

/// A report that belongs to no track, and may begin one.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Waiting {
    pub(super) time: f64,
    pub(super) position: Gaussian,
    /// Index of its sensor.
    pub(super) sensor: usize,
    /// Probability that it is of no track.
    pub(super) unexplained: f64,
}

impl Waiting {
    /// Checks what was read back, for positions of so many coordinates and so many sensors.
    pub(super) fn check_restored(&self, dims: usize, sensors: usize) -> Result<()> {
        require_finite("time of a waiting report", [&self.time])?;
        require_size("waiting report", dims, self.position.dim())?;
        if self.sensor >= sensors {
            let requirement = "must be one of the tracker's";
            return Err(Error::invalid("sensor of a waiting report", self.sensor, requirement));
        }
        require_probability("waiting report", self.unexplained)
    }

    /// Position and velocity by the line through an earlier report and this one, at the time of this one.
    pub(super) fn line_from(&self, earlier: &Self) -> Result<Gaussian> {
        let fix = |report: &Self| TimedFix {
            time: report.time,
            position: report.position.clone(),
        };
        Ok(start_state(&[fix(earlier), fix(self)], 2, None)?.state)
    }

    /// How far it is from an earlier one, if a target of this speed can have made both.
    fn reach(&self, earlier: &Self, max_speed: f64) -> Option<f64> {
        let distance = (&self.position.mean - &earlier.position.mean).norm();
        let spread = (self.position.cov.trace() + earlier.position.cov.trace()).sqrt();
        (distance <= max_speed * (self.time - earlier.time) + 3.0 * spread).then_some(distance)
    }
}

/// For each of these reports the index of the waiting one that it pairs with. Both come in the order of their times.
pub(super) fn pair_up(waiting: &[Waiting], reports: &[Waiting], max_speed: f64, within: f64) -> Vec<Option<usize>> {
    let mut partners = vec![None; reports.len()];
    let mut taken = vec![false; waiting.len()];
    for now in runs_of_one_time(reports) {
        let time = reports[now.start].time;
        for then in runs_of_one_time(waiting).into_iter().rev() {
            let dt = time - waiting[then.start].time;
            if dt <= 0.0 {
                continue;
            }
            if dt > within || now.clone().all(|report| partners[report].is_some()) {
                break;
            }
            let mut pairs = Vec::new();
            for report in now.clone().filter(|&report| partners[report].is_none()) {
                for earlier in then.clone().filter(|&earlier| !taken[earlier]) {
                    let distance = reports[report].reach(&waiting[earlier], max_speed);
                    pairs.extend(distance.map(|distance| (distance, report, earlier)));
                }
            }
            pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (_, report, earlier) in pairs {
                if partners[report].is_none() && !taken[earlier] {
                    partners[report] = Some(earlier);
                    taken[earlier] = true;
                }
            }
        }
    }
    partners
}

fn runs_of_one_time(reports: &[Waiting]) -> Vec<Range<usize>> {
    let mut start = 0;
    let runs = reports.chunk_by(|a, b| a.time == b.time).map(|run| {
        let range = start..start + run.len();
        start = range.end;
        range
    });
    runs.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    fn report(time: f64, x: f64) -> Waiting {
        Waiting {
            time,
            position: Gaussian {
                mean: DVector::from_vec(vec![x, 0.0]),
                cov: DMatrix::identity(2, 2) * 0.5,
            },
            sensor: 0,
            unexplained: 1.0,
        }
    }

    /// v_max = 10 m/s, t_max = 5 s; the noise allows 3 √2 m.
    fn partners(waiting: &[Waiting], reports: &[Waiting]) -> Vec<Option<usize>> {
        pair_up(waiting, reports, 10.0, 5.0)
    }

    #[test]
    fn the_most_recent_within_reach_is_taken() {
        let waiting = [report(0.0, 0.0), report(1.0, 5.0), report(2.0, 100.0)];
        assert_eq!(partners(&waiting, &[report(3.0, 8.0)]), [Some(1)]);
        assert_eq!(partners(&waiting, &[report(3.0, 100.0)]), [Some(2)]);
        assert_eq!(partners(&waiting, &[report(3.0, 60.0)]), [None]);
    }

    #[test]
    fn speed_bound_and_noise_limit_the_distance() {
        let edge = 20.0 + 3.0 * 2.0_f64.sqrt();
        assert_eq!(partners(&[report(0.0, 0.0)], &[report(2.0, edge - 1e-9)]), [Some(0)]);
        assert_eq!(partners(&[report(0.0, 0.0)], &[report(2.0, edge + 1e-9)]), [None]);
    }

    #[test]
    fn a_report_waits_so_long_and_pairs_with_none_of_its_own_time() {
        assert_eq!(partners(&[report(0.0, 0.0)], &[report(5.0, 0.0)]), [Some(0)]);
        assert_eq!(partners(&[report(0.0, 0.0)], &[report(5.0 + 1e-9, 0.0)]), [None]);
        let waiting = [report(0.0, 0.0), report(2.0, 0.0)];
        assert_eq!(partners(&waiting, &[report(2.0, 0.0)]), [Some(0)]);
        assert_eq!(partners(&waiting[1..], &[report(2.0, 0.0)]), [None]);
    }

    #[test]
    fn of_one_time_the_nearest_pair_goes_first_and_each_report_pairs_once() {
        let waiting = [report(0.0, 2.0), report(1.0, 0.0), report(1.0, 8.0)];
        let reports = [report(2.0, 2.0), report(2.0, 1.0), report(2.0, 7.0)];
        assert_eq!(partners(&waiting, &reports), [Some(0), Some(1), Some(2)]);
        // The earlier report of a scan chooses first, even where the later one is nearer.
        let reports = [report(2.0, 3.0), report(2.5, 0.0)];
        assert_eq!(partners(&waiting[1..2], &reports), [Some(0), None]);
    }
}
