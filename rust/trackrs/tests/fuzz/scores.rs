use nalgebra::{DMatrix, DVector};
use trackrs::Track;
use trackrs::metric::consistency::{average_band, nees, rmse};
use trackrs::metric::evaluate::{Frame, Scoring, TruthPath, evaluate};
use trackrs::metric::gospa::{Ellipses, gospa, gospa_of_extents};
use trackrs::metric::innovation::{cumulative, nis};
use trackrs::metric::ospa::ospa;
use trackrs::metric::whiteness::whiteness;
use trackrs::stats::chi_square;
use trackrs::stats::regular::regularise;

use super::Source;
use super::source::finite;

fn points(source: &mut Source<'_>, dims: usize) -> DMatrix<f64> {
    let count = source.below(6);
    let dims = source.about(dims);
    source.matrix(count, dims)
}

pub(crate) fn ospa_and_gospa(source: &mut Source<'_>) {
    let dims = 1 + source.below(3);
    let (x, y) = (points(source, dims), points(source, dims));
    let (cutoff, order, alpha) = (source.positive(), source.positive(), source.share() * 2.0);
    if let Ok(found) = ospa(&x, &y, cutoff, order) {
        finite("OSPA", [&found.total, &found.localisation, &found.cardinality]);
        assert!(found.total <= cutoff * (1.0 + 1e-9), "{} {cutoff}", found.total);
    }
    if let Ok(found) = gospa(&x, &y, cutoff, order, alpha) {
        finite(
            "GOSPA",
            [&found.total, &found.localisation, &found.missed, &found.false_tracks],
        );
        assert_eq!(found.pairs.len() + found.n_missed, x.nrows());
        assert_eq!(found.pairs.len() + found.n_false, y.nrows());
    }
}

pub(crate) fn gospa_of_ellipses(source: &mut Source<'_>) {
    let dims = 1 + source.below(3);
    let (x, y) = (points(source, dims), points(source, dims));
    let extents = |source: &mut Source<'_>, count: usize| -> Vec<DMatrix<f64>> {
        let count = source.about(count);
        (0..count).map(|_| source.covariance(dims)).collect()
    };
    let (of_x, of_y) = (extents(source, x.nrows()), extents(source, y.nrows()));
    let truth = Ellipses {
        centres: &x,
        extents: &of_x,
    };
    let estimates = Ellipses {
        centres: &y,
        extents: &of_y,
    };
    if let Ok(found) = gospa_of_extents(
        truth,
        estimates,
        source.positive(),
        source.positive(),
        source.share() * 2.0,
    ) {
        finite("GOSPA", [&found.total, &found.localisation]);
    }
}

pub(crate) fn evaluation(source: &mut Source<'_>) {
    let mut truth = Vec::new();
    for id in 0..source.below(3) {
        let count = source.below(4);
        let times = source.times(count);
        let positions = (0..count).map(|_| source.vector(2)).collect();
        truth.extend(TruthPath::new(id.to_string(), times, positions));
    }
    let mut frames = Vec::new();
    for time in source.times(3) {
        let mut tracks = Vec::new();
        for _ in 0..source.below(3) {
            let Ok(state) = source.gaussian(4) else { continue };
            tracks.push(Track {
                id: source.below(3) as u64,
                time,
                state,
                last_hit: time,
                hits: 1,
                existence: None,
                extent: None,
                health: None,
            });
        }
        let centre = source.coin().then(|| source.vector(2));
        frames.push(Frame { time, tracks, centre });
    }
    let scoring = Scoring {
        cutoff: source.positive(),
        order: 1.0 + source.share(),
        alpha: 2.0,
        region: source.coin().then(|| source.positive()),
    };
    if let Ok(found) = evaluate(&truth, &frames, &scoring) {
        assert_eq!(found.frames.len(), frames.len());
        for score in &found.frames {
            finite("score", [&score.gospa.total, &score.ospa.total]);
        }
        assert!(!found.rmse.is_infinite() && !found.nees.is_infinite());
    }
}

pub(crate) fn consistency(source: &mut Source<'_>) {
    let (rows, n) = (source.below(4), source.below(4));
    let errors = source.matrix(rows, n);
    let count = source.about(rows);
    let covs: Vec<DMatrix<f64>> = (0..count).map(|_| source.covariance(n)).collect();
    if let Ok(tests) = nees(&errors, &covs) {
        assert!(tests.p_values.iter().all(|p| p.is_nan() || (0.0..=1.0).contains(p)));
    }
    if let Ok(value) = rmse(&errors) {
        finite("RMSE", [&value]);
    }
    if let Ok(band) = average_band(source.below(40), source.below(200), source.share()) {
        assert!(band.lower <= band.upper, "{band:?}");
    }
}

pub(crate) fn innovations(source: &mut Source<'_>) {
    let (rows, m) = (source.below(6), 1 + source.below(3));
    let given: Vec<DVector<f64>> = (0..rows).map(|_| source.vector(m)).collect();
    let covs: Vec<DMatrix<f64>> = (0..rows).map(|_| source.covariance(m)).collect();
    if let Ok(tests) = nis(&given, &covs) {
        assert!(tests.p_values.iter().all(|p| p.is_nan() || (0.0..=1.0).contains(p)));
        let restarts = [source.below(8)];
        let window = source.coin().then(|| source.below(4));
        drop(cumulative(&tests.statistics, &tests.dof, &restarts, window));
    }
    if let Ok(tests) = whiteness(&given, &covs, source.below(4)) {
        assert!(tests.p_value.is_nan() || (0.0..=1.0).contains(&tests.p_value));
    }
}

pub(crate) fn chi_squares(source: &mut Source<'_>) {
    let (x, dof) = (source.number(), source.below(256) * source.below(4));
    let both = [chi_square::cdf(x, dof), chi_square::survival(x, dof)];
    assert!(
        both.iter().all(|p| p.is_nan() || (0.0..=1.0).contains(p)),
        "{x} {dof}: {both:?}"
    );
    let probability = source.share();
    if let Ok(value) = chi_square::quantile(probability, dof) {
        assert!(value >= 0.0, "{probability} {dof}: {value}");
    }
    if let Ok(value) = chi_square::upper_quantile(probability, dof) {
        assert!(value >= 0.0, "{probability} {dof}: {value}");
    }
}

pub(crate) fn clocks(source: &mut Source<'_>) {
    let count = source.below(8);
    let times = source.times(count);
    let period = source.coin().then(|| source.positive());
    if let Ok(regular) = regularise(&times, period) {
        finite("times", &regular.times);
        finite("period", [&regular.period, &regular.jitter]);
    }
}
