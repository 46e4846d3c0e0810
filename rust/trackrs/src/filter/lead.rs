//! Predictions a fixed time ahead of each measurement.
//!
//! After the update of row k the state is predicted by lead_k seconds, with the motion noise then in force and without
//! inputs, which are not known yet: the causal prediction for time t_k + lead_k. The run itself is not touched.
//! [`Lead::Midpoint`] is half the interval to the next measurement, of the last row half the interval before: with white
//! jerk, whose noise does not depend on how an interval is cut, two half steps are one whole, and this is the cycle of the
//! helmet paper.
//!
//! Reference: Sun, Zhang (2015), eqs. (5)–(10); spec labels H1, H5, H6.

use crate::error::{Error, Result, require_finite, require_size};

/// How far ahead of each measurement.
#[derive(Debug, Clone, PartialEq)]
pub enum Lead {
    /// So many seconds.
    Seconds(f64),
    /// So many seconds for each row.
    Each(Vec<f64>),
    /// Half the interval to the next measurement.
    Midpoint,
}

impl Lead {
    /// Seconds for each of these times, none negative or above `horizon`.
    pub fn seconds(&self, times: &[f64], horizon: Option<f64>) -> Result<Vec<f64>> {
        let leads = match self {
            Self::Seconds(lead) => vec![*lead; times.len()],
            Self::Each(leads) => leads.clone(),
            Self::Midpoint => midpoints(times)?,
        };
        require_size("lead", times.len(), leads.len())?;
        require_finite("lead", &leads)?;
        for &lead in &leads {
            if lead < 0.0 {
                return Err(Error::invalid("lead", lead, "must not be negative"));
            }
            if let Some(horizon) = horizon.filter(|&h| lead > h) {
                let requirement = format!("must not exceed the filter's horizon of {horizon} s");
                return Err(Error::invalid("lead", lead, &requirement));
            }
        }
        Ok(leads)
    }
}

fn midpoints(times: &[f64]) -> Result<Vec<f64>> {
    if times.len() < 2 {
        return Err(Error::invalid("lead", "midpoint", "needs at least two times"));
    }
    let mut leads: Vec<f64> = times.windows(2).map(|pair| 0.5 * (pair[1] - pair[0])).collect();
    leads.extend(leads.last().copied());
    Ok(leads)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leads_are_checked_and_midpoints_are_half_the_next_interval() {
        let times = [0.0, 1.0, 3.0];
        assert_eq!(Lead::Midpoint.seconds(&times, None).unwrap(), [0.5, 1.0, 1.0]);
        assert_eq!(Lead::Seconds(0.2).seconds(&times, Some(0.2)).unwrap(), [0.2; 3]);
        for (lead, horizon) in [
            (Lead::Seconds(-0.1), None),
            (Lead::Seconds(f64::NAN), None),
            (Lead::Each(vec![0.0, 0.1]), None),
            (Lead::Midpoint, Some(0.9)),
        ] {
            let error = lead.seconds(&times, horizon).unwrap_err();
            assert!(error.to_string().starts_with("lead"), "{error}");
        }
        assert!(Lead::Midpoint.seconds(&[1.0], None).is_err());
    }
}
