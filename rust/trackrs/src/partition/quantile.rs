//! The distance that a given percentage of all pairs of points do not exceed, in O(n) memory.
//!
//! | symbol | name here | meaning                                                |
//! |--------|-----------|--------------------------------------------------------|
//! | N      | `pairs`   | n (n − 1) / 2 distances, ascending                     |
//! | k      | `position`| ⌊N p/100 + 1/2⌋, within 1 … N                          |
//!
//! 1. The k-th distance; where that is zero, the first that is not. Where all points coincide: 1, as any length serves.
//! 2. It is found between two bounds, by counting the pairs up to a length between them, until the pairs between the bounds
//!    are few enough to be listed. Lengths are halved in the order of floating-point numbers, hence at most 64 times.
//!
//! Reference: Rodriguez, Laio 2014 (the rule of 1 to 2 %); spec 6.5 (a).

use super::index::Index;

/// So many pairs per point may be listed, and so many in any case.
const LISTED: usize = 8;
const LISTED_ANYWAY: usize = 1 << 16;

/// The distance d_c of the percentage rule.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a float-to-integer cast saturates, and the result is clamped"
)]
pub(crate) fn distance(index: &Index<'_>, percent: f64) -> f64 {
    let n = index.points.len();
    let pairs = n * n.saturating_sub(1) / 2;
    let apart = pairs - count(index, 0.0);
    if apart == 0 {
        return 1.0;
    }
    let wanted = libm::floor(pairs as f64 * percent / 100.0 + 0.5) as usize;
    let position = wanted.clamp(1, pairs).max(pairs - apart + 1);
    // Pairs up to `low` are too few, those up to `high` are enough.
    let (mut low, mut below) = (0.0_f64, pairs - apart);
    let (mut high, mut above) = (f64::MAX, pairs);
    while above - below > LISTED_ANYWAY.max(LISTED * n) {
        let middle = f64::from_bits(u64::midpoint(low.to_bits(), high.to_bits()));
        if middle == low || middle == high {
            return libm::sqrt(high);
        }
        let up_to = count(index, middle);
        if up_to < position {
            (low, below) = (middle, up_to);
        } else {
            (high, above) = (middle, up_to);
        }
    }
    let mut between = listed(index, low, high);
    let at = (position - below - 1).min(between.len().saturating_sub(1));
    let (_, &mut found, _) = between.select_nth_unstable_by(at, f64::total_cmp);
    libm::sqrt(found)
}

/// Pairs whose squared distance is at most `bound`.
fn count(index: &Index<'_>, bound: f64) -> usize {
    let n = index.points.len();
    let both: usize = (0..n)
        .map(|i| index.count(index.points.point(i), usize::MAX, |d2| d2 <= bound))
        .sum();
    (both - n) / 2
}

/// The squared distances above `low` up to `high`.
fn listed(index: &Index<'_>, low: f64, high: f64) -> Vec<f64> {
    let mut found = Vec::new();
    for i in 0..index.points.len() {
        let query = index.points.point(i);
        index.descend(query, |node, reach| {
            if reach.nearest > high || reach.farthest <= low {
                return false;
            }
            if index.is_leaf(node) {
                let members = index.members(node, query);
                let wanted = members.filter(|&(at, d2)| index.order[at] < i && d2 > low && d2 <= high);
                found.extend(wanted.map(|(_, d2)| d2));
            }
            true
        });
    }
    found
}
