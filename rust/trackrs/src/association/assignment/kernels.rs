//! The inner loops of [`assignment`](super): whole rows of costs, contiguous, written so that they vectorise.

const INFINITY: f64 = f64::INFINITY;

/// Whether every cost is `+inf` or at most `largest` in magnitude.
pub(super) fn all_at_most(largest: f64, costs: &[f64]) -> bool {
    let usable = |c: f64| c == INFINITY || c.abs() <= largest;
    costs
        .chunks(64)
        .all(|block| block.iter().fold(true, |ok, &c| ok & usable(c)))
}

/// The smaller of two numbers that are not NaN.
pub(super) fn lesser(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}
