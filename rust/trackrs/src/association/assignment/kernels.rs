//! The inner loops of [`assignment`](super): whole rows of costs, contiguous, written so that they vectorise.

const INFINITY: f64 = f64::INFINITY;

/// Whether every cost is `+inf` or at most `largest` in magnitude.
pub(super) fn all_at_most(largest: f64, costs: &[f64]) -> bool {
    let usable = |c: f64| c == INFINITY || c.abs() <= largest;
    costs
        .chunks(64)
        .all(|block| block.iter().fold(true, |ok, &c| ok & usable(c)))
}

/// The two smallest reduced costs of a row.
pub(super) struct TwoCheapest {
    pub(super) first: f64,
    pub(super) second: f64,
}

/// Eight running pairs, so that the loop vectorises.
pub(super) fn two_cheapest(costs: &[f64], v: &[f64]) -> TwoCheapest {
    let (mut first, mut second) = ([INFINITY; 8], [INFINITY; 8]);
    for (costs, v) in costs.chunks(8).zip(v.chunks(8)) {
        let lanes = first.iter_mut().zip(&mut second);
        for ((cost, v), (first, second)) in costs.iter().zip(v).zip(lanes) {
            let reduced = cost - v;
            let larger = if reduced < *first { *first } else { reduced };
            *first = lesser(*first, reduced);
            *second = lesser(*second, larger);
        }
    }
    let mut best = TwoCheapest {
        first: INFINITY,
        second: INFINITY,
    };
    for value in first.into_iter().chain(second) {
        best.second = lesser(best.second, if value < best.first { best.first } else { value });
        best.first = lesser(best.first, value);
    }
    best
}

/// `d[c] = min(d[c], o + C[r,c] - v[c])` over one block of columns, four at a time. Returns the least `d`.
pub(super) fn relax(
    costs: &[f64],
    open_v: &[f64],
    (row, offset): (usize, f64),
    distance: &mut [f64],
    predecessor: &mut [usize],
) -> f64 {
    let (costs, last_costs) = costs.as_chunks::<4>();
    let (open_v, last_open_v) = open_v.as_chunks::<4>();
    let (distance, last_distance) = distance.as_chunks_mut::<4>();
    let (predecessor, last_predecessor) = predecessor.as_chunks_mut::<4>();
    let mut least = [INFINITY; 4];
    let targets = distance.iter_mut().zip(predecessor);
    for ((costs, v), (distance, predecessor)) in costs.iter().zip(open_v).zip(targets) {
        relax_lanes(costs, v, (row, offset), distance, predecessor);
        for (least, &d) in least.iter_mut().zip(&*distance) {
            *least = lesser(*least, d);
        }
    }
    relax_lanes(last_costs, last_open_v, (row, offset), last_distance, last_predecessor);
    least.iter().chain(&*last_distance).copied().fold(INFINITY, lesser)
}

/// Most visits shorten few paths: one vector test of all lanes decides whether there is anything to write.
#[inline]
fn relax_lanes(
    costs: &[f64],
    open_v: &[f64],
    (row, offset): (usize, f64),
    distance: &mut [f64],
    predecessor: &mut [usize],
) {
    let mut any = false;
    for ((cost, v), d) in costs.iter().zip(open_v).zip(&*distance) {
        any |= offset + (cost - v) < *d;
    }
    if any {
        let targets = distance.iter_mut().zip(predecessor);
        for ((cost, v), (d, predecessor)) in costs.iter().zip(open_v).zip(targets) {
            let through = offset + (cost - v);
            if through < *d {
                *d = through;
                *predecessor = row;
            }
        }
    }
}

/// The smaller of two numbers that are not NaN.
pub(super) fn lesser(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}
