//! Arguments of filters: names and numbers as the user gives them, made into the core's.

use pyo3::prelude::*;
use trackrs::filter::lead;
use trackrs::filter::noise::{EigenLimits, LimitedMemoryNoise, NoiseMethod, QForm, RForm};
use trackrs::filter::residual_noise::{Memory, QFrom, RFrom, ResidualNoise};
use trackrs::{Error, Result};

use crate::error::count;

/// How far ahead, as the user says it.
#[derive(FromPyObject)]
pub(crate) enum Lead {
    Name(String),
    Seconds(f64),
    Each(Vec<f64>),
}

impl Lead {
    pub(crate) fn seconds(self, times: &[f64], horizon: Option<f64>) -> trackrs::Result<Vec<f64>> {
        let lead = match self {
            Self::Name(name) if name == "midpoint" => lead::Lead::Midpoint,
            Self::Name(other) => {
                let requirement = "must be midpoint, seconds, or seconds for every time";
                return Err(trackrs::Error::invalid("lead", other, requirement));
            }
            Self::Seconds(lead) => lead::Lead::Seconds(lead),
            Self::Each(leads) => lead::Lead::Each(leads),
        };
        lead.seconds(times, horizon)
    }
}

/// What one of these names stands for.
fn named<T: Copy>(argument: &str, name: &str, choices: &[(&str, T)]) -> Result<T> {
    let found = choices.iter().find(|(known, _)| *known == name);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let known: Vec<_> = choices.iter().map(|(known, _)| *known).collect();
        Error::invalid(argument, name, &format!("must be {}", known.join(" or ")))
    })
}

fn limits((min, max): (f64, f64)) -> EigenLimits {
    EigenLimits { min, max }
}

/// A memory of so many measurements; `forms` of Q and R, then their limits.
pub(crate) fn limited_memory(
    window: i64,
    r_window: Option<i64>,
    method: &str,
    forms: &(String, String),
    first_epoch: i64,
    [q_limits, r_limits]: [(f64, f64); 2],
) -> Result<LimitedMemoryNoise> {
    Ok(LimitedMemoryNoise {
        window: count("window", window)?,
        r_window: r_window.map(|window| count("r_window", window)).transpose()?,
        method: named("method", method, &[("em", NoiseMethod::Em), ("map", NoiseMethod::Map)])?,
        q_form: named("q_form", &forms.0, &[("input", QForm::Input), ("full", QForm::Full)])?,
        r_form: named(
            "r_form",
            &forms.1,
            &[("diagonal", RForm::Diagonal), ("full", RForm::Full)],
        )?,
        first_epoch: count("first_epoch", first_epoch)?,
        q_limits: limits(q_limits),
        r_limits: limits(r_limits),
    })
}

/// `memory` is its name, its window and its factor.
pub(crate) fn residual_noise(
    (memory, window, fading): &(String, i64, f64),
    r: &str,
    q: Option<&str>,
    r_limits: (f64, f64),
    q_floor: f64,
    diagonal: bool,
    first_epoch: i64,
) -> Result<ResidualNoise> {
    let memories = [
        ("cumulative", Memory::Cumulative),
        ("window", Memory::Window(count("window", *window)?)),
        ("fading", Memory::Fading(*fading)),
    ];
    let q = q.map(|name| named("q", name, &[("paper", QFrom::Paper), ("innovation", QFrom::Innovation)]));
    Ok(ResidualNoise {
        memory: named("memory", memory, &memories)?,
        r: named(
            "r",
            r,
            &[
                ("paper", RFrom::Paper),
                ("resid", RFrom::Resid),
                ("innov", RFrom::Innov),
            ],
        )?,
        q: q.transpose()?,
        r_limits: limits(r_limits),
        q_floor,
        diagonal,
        first_epoch: count("first_epoch", first_epoch)?,
    })
}
