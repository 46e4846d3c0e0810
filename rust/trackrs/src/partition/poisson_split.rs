//! From how many targets a cell of n measurements most likely comes.
//!
//! x = argmax_{x ≥ 1} Poisson(n; x γ), ties the smaller: n ln x − x γ is concave in x with its maximum at n/γ, so x is one of the
//! two whole numbers next to that.
//!
//! Reference: Granström, Lundquist, Orguner 2012 (sub-partitions); spec 6.1.

/// x, for cells of `measurements` and `rate` = γ > 0 measurements per target; at most one target per measurement.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "whole, at least 1 and at most `measurements`"
)]
pub fn targets(measurements: usize, rate: f64) -> usize {
    let n = measurements as f64;
    let low = libm::floor(n / rate).clamp(1.0, n.max(1.0));
    let high = (low + 1.0).min(n.max(1.0));
    let gain = n * libm::log(high / low) - (high - low) * rate;
    (if gain > 0.0 { high } else { low }) as usize
}
