//! OSPA and GOSPA: golden values, metric axioms, and enumeration of all partial assignments.

use approx::assert_relative_eq;
use nalgebra::DMatrix;
use proptest::prelude::*;
use rand_pcg::{Pcg64, rand_core::Rng};
use serde_json::Value;
use trackrs::metric::gospa::{Gospa, gospa};
use trackrs::metric::ospa::ospa;

fn matrix(rows: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(rows.clone()).unwrap();
    let columns = rows.first().map_or(0, Vec::len);
    DMatrix::from_row_slice(rows.len(), columns, &rows.concat())
}

#[test]
fn ospa_matches_the_golden_file() {
    let text = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/et_ospa.json"));
    let file: Value = serde_json::from_str(text).unwrap();
    let cases = file["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 14);
    for case in cases {
        let number = |key: &str| case[key].as_f64().unwrap();
        let found = ospa(&matrix(&case["X"]), &matrix(&case["Y"]), number("c"), number("p")).unwrap();
        assert_relative_eq!(found.total, number("total"), max_relative = 1e-12);
        assert_relative_eq!(found.localisation, number("localisation"), max_relative = 1e-12);
        assert_relative_eq!(found.cardinality, number("cardinality"), max_relative = 1e-12);
    }
}

/// A uniform number in [0, 1).
fn uniform(random: &mut Pcg64) -> f64 {
    (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// Zero to four points in a square twice as wide as the cutoff used below, some of them on a coarse grid so
/// that sets share points and distances tie.
fn random_set(random: &mut Pcg64) -> DMatrix<f64> {
    let count = usize::try_from(random.next_u64() % 5).unwrap();
    let coarse = uniform(random) < 0.3;
    DMatrix::from_fn(count, 2, |_, _| {
        let value = 20.0 * uniform(random);
        if coarse { (value / 5.0).round() * 5.0 } else { value }
    })
}

/// Identity, symmetry and triangle inequality of `distance` on random triples of sets.
fn assert_metric(seed: u64, distance: impl Fn(&DMatrix<f64>, &DMatrix<f64>, f64) -> f64) {
    let mut random = Pcg64::new(seed.into(), 1);
    for trial in 0..100_000 {
        let order = [1.0, 2.0, 3.5][trial % 3];
        let [x, y, z] = std::array::from_fn(|_| random_set(&mut random));
        let (xy, yz, xz) = (
            distance(&x, &y, order),
            distance(&y, &z, order),
            distance(&x, &z, order),
        );
        assert!(xz <= xy + yz + 1e-12, "triangle: {xz} > {xy} + {yz} for {x}{y}{z}");
        assert!((distance(&y, &x, order) - xy).abs() < 1e-12, "symmetry for {x}{y}");
        assert!(distance(&x, &x, order) == 0.0, "identity for {x}");
        let same = x.nrows() == y.nrows() && x.row_iter().all(|a| y.row_iter().any(|b| a == b));
        assert!(xy > 0.0 || same, "two sets at distance 0: {x}{y}");
    }
}

#[test]
fn ospa_is_a_metric() {
    assert_metric(1, |x, y, p| ospa(x, y, 10.0, p).unwrap().total);
}

#[test]
fn gospa_is_a_metric() {
    assert_metric(2, |x, y, p| gospa(x, y, 10.0, p, 2.0).unwrap().total);
}

#[test]
fn gospa_is_a_metric_for_other_alphas() {
    assert_metric(3, |x, y, p| gospa(x, y, 10.0, p, 0.7).unwrap().total);
}

/// Every way to pair rows of `x` with rows of `y`, each used at most once.
fn partial_assignments(m: usize, n: usize) -> Vec<Vec<(usize, usize)>> {
    let mut out = vec![Vec::new()];
    for i in 0..m {
        for index in 0..out.len() {
            for j in 0..n {
                if out[index].iter().all(|&(_, used)| used != j) {
                    let mut longer = out[index].clone();
                    longer.push((i, j));
                    out.push(longer);
                }
            }
        }
    }
    out
}

fn distance(x: &DMatrix<f64>, y: &DMatrix<f64>, (i, j): (usize, usize)) -> f64 {
    (x.row(i) - y.row(j)).norm()
}

/// What the pairs that were found say the parts should be, for alpha = 2.
fn assert_parts(score: &Gospa, x: &DMatrix<f64>, y: &DMatrix<f64>, c: f64, p: f64) {
    let half = c.powf(p) / 2.0;
    let mut localisation = 0.0;
    for (index, pair) in score.pairs.iter().enumerate() {
        assert!(pair.distance < c);
        assert_relative_eq!(
            pair.distance,
            distance(x, y, (pair.truth, pair.estimate)),
            max_relative = 1e-14
        );
        let others = &score.pairs[..index];
        assert!(
            others
                .iter()
                .all(|o| o.truth < pair.truth && o.estimate != pair.estimate)
        );
        localisation += pair.distance.powf(p);
    }
    let (missed, extra) = (x.nrows() - score.pairs.len(), y.nrows() - score.pairs.len());
    assert_eq!((score.n_missed, score.n_false), (missed, extra));
    assert_relative_eq!(score.localisation, localisation, max_relative = 1e-12);
    assert_relative_eq!(score.missed, half * missed as f64, max_relative = 1e-12);
    assert_relative_eq!(score.false_tracks, half * extra as f64, max_relative = 1e-12);
}

fn points(most: usize) -> impl Strategy<Value = DMatrix<f64>> {
    (0..=most).prop_flat_map(|count| {
        let values = prop::collection::vec(-10.0..10.0_f64, 2 * count);
        values.prop_map(move |values| DMatrix::from_row_slice(count, 2, &values))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn gospa_is_the_best_partial_assignment(x in points(5), y in points(5), c in 1.0..15.0_f64, p in 1.0..3.0_f64) {
        let score = gospa(&x, &y, c, p, 2.0).unwrap();
        let cost = |pairs: &Vec<(usize, usize)>| {
            let apart = (x.nrows() + y.nrows() - 2 * pairs.len()) as f64;
            pairs.iter().map(|&pair| distance(&x, &y, pair).powf(p)).sum::<f64>() + apart * c.powf(p) / 2.0
        };
        let best = partial_assignments(x.nrows(), y.nrows()).iter().map(cost).fold(f64::INFINITY, f64::min);
        prop_assert!((score.total.powf(p) - best).abs() <= 1e-11 * best);
        prop_assert!((score.localisation + score.missed + score.false_tracks - best).abs() <= 1e-11 * best);
        assert_parts(&score, &x, &y, c, p);
    }

    #[test]
    fn both_metrics_follow_their_definitions(
        x in points(5), y in points(5), c in 1.0..15.0_f64, p in 1.0..3.0_f64, alpha in 0.1..2.0_f64,
    ) {
        let few = x.nrows().min(y.nrows());
        let apart = x.nrows().abs_diff(y.nrows()) as f64;
        let most = x.nrows().max(y.nrows()) as f64;
        let cost = |pairs: &Vec<(usize, usize)>| -> f64 {
            pairs.iter().map(|&pair| distance(&x, &y, pair).min(c).powf(p)).sum()
        };
        let complete = partial_assignments(x.nrows(), y.nrows()).into_iter().filter(|pairs| pairs.len() == few);
        let best = complete.map(|pairs| cost(&pairs)).fold(f64::INFINITY, f64::min);

        let score = gospa(&x, &y, c, p, alpha).unwrap();
        let expected = best + apart * c.powf(p) / alpha;
        prop_assert!((score.total.powf(p) - expected).abs() <= 1e-11 * expected);
        prop_assert!((score.localisation + score.missed + score.false_tracks - expected).abs() <= 1e-11 * expected);

        let score = ospa(&x, &y, c, p).unwrap();
        if most > 0.0 {
            let close = |found: f64, expected: f64| (found.powf(p) - expected).abs() <= 1e-11 * c.powf(p);
            prop_assert!(close(score.total, (best + apart * c.powf(p)) / most));
            prop_assert!(close(score.localisation, best / most));
            prop_assert!(close(score.cardinality, apart * c.powf(p) / most));
        }
    }
}
