//! Time stamps that jitter about a fixed rate: which step of the clock each of them is.
//!
//! | symbol | name here | meaning                                                                   |
//! |--------|-----------|---------------------------------------------------------------------------|
//! | t_i    | `times`   | recorded stamps, s, not decreasing                                        |
//! | T      | `period`  | of the clock, s                                                           |
//! | n_i    | `steps`   | whole numbers, n_0 = 0, n_i > n_{i−1}: a gap is a whole number of steps   |
//! | y_i    | `excess`  | t_i/T − i: constant but for jitter, and up at a gap                       |
//! | o      | `phase`   | circular mean of y: where between two whole numbers the clock stands      |
//!
//! period:  median of the differences, which is off by a percent where the jitter is not symmetric, a whole step after a
//!          hundred; then the frequency f with the largest Σ_blocks |Σ exp(2πi f t)|², in blocks of 64 steps and within 5 %
//!          of the first guess, then in blocks four times as long near the last f, up to all of it. It counts nothing, so
//!          that gaps and late stamps cannot mislead it
//! steps:   m = round(iso(y) − o), n_i = i + m_i − m_0 with iso the least-squares non-decreasing fit, so that a late stamp with
//!          an early one behind it is no gap
//! clock:   t ≈ t̂_0 + n T by least squares, T as well where it is not given; then again until n stays
//!
//! Reference: isotonic regression by pooling adjacent violators: Ayer et al. (1955), Annals of Mathematical Statistics 26(4).

use std::f64::consts::TAU;

use crate::error::{Error, Result, require_finite, require_positive};

const MAX_ITERATIONS: usize = 50;
/// Beyond, neighbouring steps are one number.
const MAX_STEPS: f64 = 1e15;
/// Steps in the shortest blocks in which the period is sought, and how far from the median of the differences.
const FIRST_BLOCK: f64 = 64.0;
const FIRST_REACH: f64 = 0.05;

/// Times on a regular clock.
#[derive(Debug, Clone, PartialEq)]
pub struct RegularTimes {
    /// t̂_0 + n T, seconds.
    pub times: Vec<f64>,
    /// T, seconds.
    pub period: f64,
    /// n.
    pub steps: Vec<i64>,
    /// Root mean square of the recorded times about the regular ones, seconds.
    pub jitter: f64,
}

/// Puts `times` on the steps of a clock, of this `period` if it is given.
pub fn regularise(times: &[f64], period: Option<f64>) -> Result<RegularTimes> {
    require_finite("times", times)?;
    if let Some(pair) = times.windows(2).find(|pair| pair[1] < pair[0]) {
        let (previous, time) = (pair[0], pair[1]);
        return Err(Error::TimeReversed { time, previous });
    }
    if times.len() < 2 {
        return Err(Error::invalid("number of times", times.len(), "must be at least 2"));
    }
    // Differences from the first keep their digits where stamps are seconds since 1970.
    let since: Vec<f64> = times.iter().map(|t| t - times[0]).collect();
    require_finite("differences of times", &since)?;
    let mut clock = Clock {
        start: 0.0,
        period: match period {
            Some(period) => {
                require_positive("period", period)?;
                period
            }
            None => first_period(&since)?,
        },
    };
    require_countable(&since, clock.period)?;
    let mut steps = clock.steps(&since);
    for _ in 0..MAX_ITERATIONS {
        clock.fit(&since, &steps, period.is_none());
        let again = clock.steps(&since);
        if again == steps {
            break;
        }
        steps = again;
    }
    clock.fit(&since, &steps, period.is_none());
    let regular = |&n: &i64| clock.start + n as f64 * clock.period;
    let square: f64 = steps
        .iter()
        .zip(&since)
        .map(|(n, t)| (t - regular(n)) * (t - regular(n)))
        .sum();
    let jitter = (square / times.len() as f64).sqrt();
    if ![clock.start, clock.period, jitter].into_iter().all(f64::is_finite) {
        return Err(Error::Overflow {
            what: "regular clock".into(),
        });
    }
    Ok(RegularTimes {
        times: steps.iter().map(|n| times[0] + regular(n)).collect(),
        period: clock.period,
        jitter,
        steps,
    })
}

fn require_countable(since: &[f64], period: f64) -> Result<()> {
    if since.last().is_some_and(|last| last / period > MAX_STEPS) {
        let requirement = "must not be so short against the times that steps cannot be counted";
        return Err(Error::invalid("period", period, requirement));
    }
    Ok(())
}

fn first_period(since: &[f64]) -> Result<f64> {
    let mut differences: Vec<f64> = since.windows(2).map(|pair| pair[1] - pair[0]).collect();
    differences.sort_by(f64::total_cmp);
    let period = differences[differences.len() / 2];
    // The frequency of a subnormal period would be infinite.
    if period < f64::MIN_POSITIVE {
        let requirement = "must be given: at least half of the times equal the one before";
        return Err(Error::invalid("period", "missing", requirement));
    }
    require_countable(since, period)?;
    let (mut frequency, mut block, mut reach) = (1.0 / period, FIRST_BLOCK, FIRST_REACH);
    loop {
        let spacing = 1.0 / (8.0 * block);
        let span = block * period;
        let side = (reach / spacing).ceil();
        let (centre, mut best, mut offset) = (frequency, 0.0, -side);
        while offset <= side {
            let candidate = centre * (1.0 + offset * spacing);
            let score = coherence(since, candidate, span);
            if score > best {
                (best, frequency) = (score, candidate);
            }
            offset += 1.0;
        }
        if since.last().is_none_or(|&last| span >= last) {
            return Ok(1.0 / frequency);
        }
        reach = 1.0 / (2.0 * block);
        block *= 4.0;
    }
}

/// Σ |Σ exp(2πi f t)|² over blocks of this many seconds.
fn coherence(since: &[f64], frequency: f64, block: f64) -> f64 {
    let (mut total, mut sine, mut cosine, mut end) = (0.0, 0.0, 0.0, block);
    for &t in since {
        if t > end {
            total += sine * sine + cosine * cosine;
            (sine, cosine) = (0.0, 0.0);
            end = t + block;
        }
        let cycles = frequency * t;
        let (s, c) = libm::sincos(TAU * (cycles - cycles.floor()));
        sine += s;
        cosine += c;
    }
    total + sine * sine + cosine * cosine
}

struct Clock {
    start: f64,
    period: f64,
}

impl Clock {
    fn steps(&self, since: &[f64]) -> Vec<i64> {
        let excess: Vec<f64> = since
            .iter()
            .enumerate()
            .map(|(i, t)| t / self.period - i as f64)
            .collect();
        let (mut sine, mut cosine) = (0.0, 0.0);
        for y in &excess {
            let (s, c) = libm::sincos(TAU * (y - y.floor()));
            sine += s;
            cosine += c;
        }
        let phase = libm::atan2(sine, cosine) / TAU;
        let whole: Vec<f64> = isotonic(&excess).iter().map(|y| (y - phase).round()).collect();
        let steps = whole.iter().enumerate().map(|(i, m)| i as f64 + (m - whole[0]));
        // Whole numbers below 2^53, as was checked.
        #[allow(clippy::cast_possible_truncation)]
        steps.map(|n| n as i64).collect()
    }

    fn fit(&mut self, since: &[f64], steps: &[i64], period: bool) {
        let count = since.len() as f64;
        let mean_time = since.iter().sum::<f64>() / count;
        let mean_step = steps.iter().map(|&n| n as f64).sum::<f64>() / count;
        if period {
            let (mut across, mut along) = (0.0, 0.0);
            for (&n, t) in steps.iter().zip(since) {
                let offset = n as f64 - mean_step;
                across += offset * (t - mean_time);
                along += offset * offset;
            }
            self.period = across / along;
        }
        self.start = mean_time - self.period * mean_step;
    }
}

/// The non-decreasing sequence nearest to `values`: neighbours in the wrong order are pooled to their mean.
fn isotonic(values: &[f64]) -> Vec<f64> {
    let mut pools: Vec<(f64, usize)> = Vec::with_capacity(values.len());
    for &value in values {
        let (mut mean, mut count) = (value, 1);
        while let Some(&(left, size)) = pools.last().filter(|pool| pool.0 > mean) {
            mean = (left * size as f64 + mean * count as f64) / (size + count) as f64;
            count += size;
            pools.pop();
        }
        pools.push((mean, count));
    }
    pools
        .iter()
        .flat_map(|&(mean, count)| std::iter::repeat_n(mean, count))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn counted_steps_are_the_true_ones(
            offset in -1e9..1e9_f64, period in 1e-3..10.0_f64,
            gaps in prop::collection::vec((1_i64..40, 0.0..1.0_f64), 30..120),
            jitter in prop::collection::vec(-0.3..0.3_f64, 120),
        ) {
            let mut steps = vec![0_i64];
            for (gap, chance) in &gaps {
                let last = steps[steps.len() - 1];
                steps.push(last + if *chance < 0.1 { *gap } else { 1 });
            }
            let times: Vec<f64> = steps.iter().zip(&jitter).map(|(&n, j)| offset + (n as f64 + j) * period).collect();
            let found = regularise(&times, Some(period)).unwrap();
            prop_assert_eq!(&found.steps, &steps);
            prop_assert_eq!(found.period, period);
            prop_assert!(found.jitter < 0.31 * period);
        }

        #[test]
        fn the_isotonic_fit_is_the_minimum_over_means(values in prop::collection::vec(-5.0..5.0_f64, 1..30)) {
            // Robertson, Wright, Dykstra (1988), theorem 1.4.4: the fit is the greatest lower mean.
            let fit = isotonic(&values);
            for (i, &value) in fit.iter().enumerate() {
                let mean = |a: usize, b: usize| values[a..=b].iter().sum::<f64>() / (b + 1 - a) as f64;
                let lower = (0..=i)
                    .map(|a| (i..values.len()).map(|b| mean(a, b)).fold(f64::INFINITY, f64::min))
                    .fold(f64::NEG_INFINITY, f64::max);
                assert_relative_eq!(value, lower, epsilon = 1e-12);
            }
        }
    }

    /// Skewed jitter as of a headset: the median of the differences is a percent below the period, and rounded differences
    /// count too many steps.
    #[test]
    fn the_period_is_found_where_the_median_is_off() {
        let period = 1.0 / 60.0;
        let mut steps = Vec::new();
        let mut n = 0;
        for i in 0..4000 {
            steps.push(n);
            n += if i % 500 == 499 { 4 } else { 1 };
        }
        // A stamp late by a step and more draws those behind it with it: 2.0, 0.5, 0.5 steps in place of three of one.
        let late = |i: usize| match i % 400 {
            200 => 1.0,
            201 => 0.5,
            _ if i.is_multiple_of(10) => 0.18,
            _ => 0.002 * ((i * 7919) % 10) as f64 - 0.018 * (i % 10) as f64,
        };
        let times: Vec<f64> = steps
            .iter()
            .enumerate()
            .map(|(i, &n)| (n as f64 + late(i)) * period)
            .collect();
        let found = regularise(&times, None).unwrap();
        assert_eq!(found.steps, steps);
        assert_relative_eq!(found.period, period, max_relative = 1e-5);
        assert_relative_eq!(
            found.times[3000] - found.times[2999],
            4.0 * found.period,
            epsilon = 1e-12
        );
    }

    #[test]
    fn a_late_stamp_is_no_gap() {
        let found = regularise(&[0.0, 1.0, 2.6, 3.0, 4.0, 5.0], None).unwrap();
        assert_eq!(found.steps, [0, 1, 2, 3, 4, 5]);
        let gap = regularise(&[0.0, 1.0, 3.1, 4.0, 5.0, 6.0], Some(1.0)).unwrap();
        assert_eq!(gap.steps, [0, 1, 3, 4, 5, 6]);
    }

    #[test]
    fn bad_times_are_refused() {
        assert!(matches!(
            regularise(&[0.0, 1.0, 0.5], None),
            Err(Error::TimeReversed { time: 0.5, .. })
        ));
        assert!(matches!(
            regularise(&[0.0, f64::NAN], None),
            Err(Error::NonFinite { index: 1, .. })
        ));
        for (times, period) in [
            (&[0.0][..], None),
            (&[0.0, 1.0], Some(0.0)),
            (&[0.0, 1.0], Some(1e-300)),
            (&[1.0, 1.0, 1.0], None),
        ] {
            assert!(matches!(regularise(times, period), Err(Error::InvalidParameter { .. })));
        }
    }
}
