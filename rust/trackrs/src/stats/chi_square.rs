//! The chi-square distribution: both tails and both quantiles, accurate far out on either side.
//!
//! | symbol | name here | shape | meaning |
//! |--------|-----------|-------|---------|
//! | ν      | `dof`     | count | degrees of freedom |
//! | a      | `a`       | scalar | ν / 2 |
//! | t      | `t`       | scalar | x / 2 |
//! | P, Q   | `Tails::lower`, `Tails::upper` | scalar | regularised incomplete gamma functions of (a, t) |
//! | D      | `leading_term` | scalar | `t^a e^-t / Γ(a + 1)` |
//! | δ      | `stirling_error` | scalar | `log Γ(a + 1) - log(√(2πa) (a/e)^a)` |
//!
//! Equations, in the order of the code:
//!
//! 1. `t < a + 1`: `P = D Σ_{k≥0} t^k / ((a+1)(a+2)…(a+k))`, all terms positive; `Q = 1 - P`.
//! 2. Otherwise `Q = a D / (b_0 + c_1/(b_1 + c_2/(b_2 + …)))` with `b_k = t - a + 1 + 2k` and
//!    `c_k = k (a - k)`, by the modified Lentz recursion; `P = 1 - Q`.
//! 3. `D = exp(-a φ - δ) / √(2πa)` for `a ≥ 16`, with `a φ = a log(a/t) + t - a`. Near `t = a` the
//!    three terms cancel; with `w = (t-a)/(t+a)` the same number is
//!    `(t-a) w - 2 a Σ_{k≥1} w^(2k+1) / (2k+1)`, which does not.
//! 4. Quantiles by Newton steps from Wilson and Hilferty's cube or from the bound `P < t^a / Γ(a + 1)` inverted,
//!    whichever is larger: lower half on `log P` as a function of `log x`, upper half on `log Q` as a function of
//!    `x`. Both are nearly straight lines far out. A step that leaves the known bracket is replaced by its
//!    geometric mean.
//!
//! References: M. Abramowitz, I. Stegun, *Handbook of Mathematical Functions*, 6.5.29, 6.5.31, 26.2.23,
//! 26.4.17. C. Loader, *Fast and accurate computation of binomial probabilities*, 2000, for (3).

use crate::error::{Error, Result, require_probability};
use std::f64::consts::{LN_2, PI};

/// From this shape parameter on, `Γ` is taken from Stirling's series.
const STIRLING_FROM: f64 = 16.0;

/// Both tails at one point, and `dP / d log x`.
struct Tails {
    lower: f64,
    upper: f64,
    slope: f64,
}

/// Which tail a quantile is sought in.
#[derive(Clone, Copy, PartialEq)]
enum Side {
    Lower,
    Upper,
}

/// The probability that a chi-square variable of `dof` degrees of freedom is at most `x`.
///
/// `dof = 0` is the constant 0. NaN gives NaN.
pub fn cdf(x: f64, dof: usize) -> f64 {
    tails(x, dof).lower
}

/// The probability that a chi-square variable of `dof` degrees of freedom exceeds `x`.
///
/// Small values keep their relative accuracy, unlike `1 - cdf(x, dof)`.
pub fn survival(x: f64, dof: usize) -> f64 {
    tails(x, dof).upper
}

/// The `x` with `cdf(x, dof) = probability`: 0 at probability 0, infinity at 1.
///
/// For probabilities close to 1, [`upper_quantile`] of the complement says more digits of it.
pub fn quantile(probability: f64, dof: usize) -> Result<f64> {
    require_probability("probability", probability)?;
    require_dof(dof)?;
    if probability <= 0.5 {
        return Ok(solve(Side::Lower, probability, dof));
    }
    Ok(solve(Side::Upper, 1.0 - probability, dof))
}

/// The `x` with `survival(x, dof) = alpha`: infinity at alpha 0, 0 at 1.
pub fn upper_quantile(alpha: f64, dof: usize) -> Result<f64> {
    require_probability("alpha", alpha)?;
    require_dof(dof)?;
    if alpha <= 0.5 {
        return Ok(solve(Side::Upper, alpha, dof));
    }
    Ok(solve(Side::Lower, 1.0 - alpha, dof))
}

fn require_dof(dof: usize) -> Result<()> {
    if dof >= 1 {
        return Ok(());
    }
    Err(Error::invalid("dof", dof, "must be at least 1"))
}

fn tails(x: f64, dof: usize) -> Tails {
    let flat = |lower, upper| Tails {
        lower,
        upper,
        slope: 0.0,
    };
    if x.is_nan() {
        return flat(f64::NAN, f64::NAN);
    }
    if dof == 0 {
        return if x < 0.0 { flat(0.0, 1.0) } else { flat(1.0, 0.0) };
    }
    if x <= 0.0 {
        return flat(0.0, 1.0);
    }
    if x == f64::INFINITY {
        return flat(1.0, 0.0);
    }
    let a = 0.5 * dof as f64;
    let t = 0.5 * x;
    let d = leading_term(a, t);
    let slope = a * d;
    if t < a + 1.0 {
        let lower = (d * power_series(a, t)).min(1.0);
        Tails {
            lower,
            upper: 1.0 - lower,
            slope,
        }
    } else {
        let upper = (slope * continued_fraction(a, t)).min(1.0);
        Tails {
            lower: 1.0 - upper,
            upper,
            slope,
        }
    }
}

/// Equation 1 without its factor `D`.
fn power_series(a: f64, t: f64) -> f64 {
    let (mut sum, mut term, mut denominator) = (1.0, 1.0, a);
    loop {
        denominator += 1.0;
        term *= t / denominator;
        sum += term;
        if term <= 1e-17 * sum {
            return sum;
        }
    }
}

/// Equation 2 without its factor `a D`.
fn continued_fraction(a: f64, t: f64) -> f64 {
    let mut b = t - a + 1.0;
    let mut c = f64::INFINITY;
    let mut d = 1.0 / b;
    let mut value = d;
    let mut k = 0.0;
    loop {
        k += 1.0;
        b += 2.0;
        let numerator = k * (a - k);
        d = 1.0 / away_from_zero(b + numerator * d);
        c = away_from_zero(b + numerator / c);
        value *= c * d;
        // The factor's own rounding is 3 half-ulps: a tighter bound might never be met.
        if (c * d - 1.0).abs() <= 4.0 * f64::EPSILON {
            return value;
        }
    }
}

fn away_from_zero(value: f64) -> f64 {
    if value.abs() < 1e-300 { 1e-300 } else { value }
}

/// `t^a e^-t / Γ(a + 1)`, the probability mass `Poisson(a; t)` for real `a`.
fn leading_term(a: f64, t: f64) -> f64 {
    if a < STIRLING_FROM {
        if t > 1e4 {
            return 0.0; // below the smallest double, while t^a may overflow
        }
        // e^-t in two halves: their product with t^a is representable where e^-t alone is not.
        let half = libm::exp(-0.5 * t);
        return half * (libm::pow(t, a) / libm::tgamma(a + 1.0)) * half;
    }
    libm::exp(-deviance(a, t) - stirling_error(a)) / (2.0 * PI * a).sqrt()
}

/// `a log(a/t) + t - a` without cancellation (equation 3).
fn deviance(a: f64, t: f64) -> f64 {
    let difference = t - a;
    let w = difference / (t + a);
    if w.abs() > 0.5 {
        return a * libm::log(a / t) + difference;
    }
    let square = w * w;
    let (mut power, mut sum, mut odd) = (w, 0.0, 1.0);
    loop {
        power *= square;
        odd += 2.0;
        let term = power / odd;
        sum += term;
        if term.abs() <= 1e-18 * sum.abs() {
            return difference * w - 2.0 * a * sum;
        }
    }
}

/// Stirling's series, for `a ≥ 16`.
fn stirling_error(a: f64) -> f64 {
    let s = 1.0 / (a * a);
    (1.0 / 12.0 - s * (1.0 / 360.0 - s * (1.0 / 1260.0 - s * (1.0 / 1680.0 - s * (1.0 / 1188.0))))) / a
}

/// The `x` whose tail on `side` is `target`, for `target` in [0, 1/2].
fn solve(side: Side, target: f64, dof: usize) -> f64 {
    if target == 0.0 {
        return match side {
            Side::Lower => 0.0,
            Side::Upper => f64::INFINITY,
        };
    }
    let mut x = start(side, target, dof);
    if x == 0.0 {
        return 0.0; // the quantile itself is below the smallest double
    }
    let (mut below, mut above) = (0.0, f64::INFINITY); // the quantile lies between
    // 3 to 8 steps from this start; the bound only ends a cycle of rounding.
    for _ in 0..200 {
        let here = tails(x, dof);
        let (tail, too_far) = match side {
            Side::Lower => (here.lower, here.lower > target),
            Side::Upper => (here.upper, here.upper < target),
        };
        if too_far {
            above = x;
        } else {
            below = x;
        }
        let step = log_ratio(tail, target) * (tail / here.slope);
        let newton = match side {
            Side::Lower => x * libm::exp(-step),
            Side::Upper => x * (1.0 + step),
        };
        // Convergence is quadratic: the next step would be below the last bit.
        if (newton - x).abs() < 1e-10 * x {
            return newton;
        }
        // False also where the tail underflows and the step is NaN.
        x = if below < newton && newton < above {
            newton
        } else {
            between(below, above)
        };
    }
    x
}

/// A point inside the interval, which has at least one end other than 0 and infinity.
fn between(below: f64, above: f64) -> f64 {
    if below == 0.0 {
        0.5 * above
    } else if above == f64::INFINITY {
        2.0 * below
    } else {
        below.sqrt() * above.sqrt()
    }
}

/// `log(tail / target)`, exact to the last bits where the two are close.
fn log_ratio(tail: f64, target: f64) -> f64 {
    if (tail - target).abs() < 0.5 * target {
        return libm::log1p((tail - target) / target);
    }
    libm::log(tail) - libm::log(target)
}

fn start(side: Side, target: f64, dof: usize) -> f64 {
    let nu = dof as f64;
    let spread = 2.0 / (9.0 * nu);
    let z = match side {
        Side::Lower => -normal_upper_quantile(target),
        Side::Upper => normal_upper_quantile(target),
    };
    let root = (1.0 - spread + z * spread.sqrt()).max(0.0);
    let cube = nu * root * root * root;
    if side == Side::Upper {
        return cube;
    }
    // P < t^a / Γ(a + 1) gives a lower bound of the quantile.
    let a = 0.5 * nu;
    cube.max(libm::exp(LN_2 + (libm::log(target) + libm::lgamma(a + 1.0)) / a))
}

/// Standard normal quantile of the upper tail, to 5e-4 (Abramowitz and Stegun 26.2.23).
fn normal_upper_quantile(tail: f64) -> f64 {
    let r = (-2.0 * libm::log(tail)).sqrt();
    let numerator = 2.515_517 + r * (0.802_853 + r * 0.010_328);
    let denominator = 1.0 + r * (1.432_788 + r * (0.189_269 + r * 0.001_308));
    r - numerator / denominator
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn two_degrees_of_freedom_are_exponential() {
        for x in [1e-12, 0.3, 2.0, 40.0, 1300.0] {
            assert_relative_eq!(survival(x, 2), libm::exp(-0.5 * x), max_relative = 1e-14);
            assert_relative_eq!(cdf(x, 2), -libm::expm1(-0.5 * x), max_relative = 1e-14);
        }
    }

    #[test]
    fn one_degree_of_freedom_is_a_squared_normal() {
        for x in [1e-9, 0.5, 3.0, 50.0, 700.0_f64] {
            assert_relative_eq!(survival(x, 1), libm::erfc((0.5 * x).sqrt()), max_relative = 1e-13);
        }
    }

    #[test]
    fn ends_of_the_range() {
        assert_eq!((cdf(-1.0, 3), survival(0.0, 3)), (0.0, 1.0));
        assert_eq!((cdf(f64::INFINITY, 3), survival(f64::MAX, 3)), (1.0, 0.0));
        assert_eq!((cdf(0.0, 0), survival(0.0, 0)), (1.0, 0.0));
        assert!(cdf(f64::NAN, 3).is_nan());
        assert_eq!(quantile(0.0, 3), Ok(0.0));
        assert_eq!(quantile(1.0, 3), Ok(f64::INFINITY));
        assert_eq!(upper_quantile(1.0, 3), Ok(0.0));
        assert_eq!(quantile(1e-300, 1), Ok(0.0)); // about 1e-600
        assert!(upper_quantile(5e-324, 7).is_ok_and(|x| x > 1450.0 && x < 1600.0));
    }

    #[test]
    fn refuses_what_is_no_probability() {
        for p in [-1e-9, 1.1, f64::NAN] {
            assert!(matches!(quantile(p, 2), Err(Error::InvalidParameter { .. })));
        }
        assert!(upper_quantile(0.5, 0).is_err());
    }
}
