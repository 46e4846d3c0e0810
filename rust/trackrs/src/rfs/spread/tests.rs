//! The scatter of cells against integrals over all extents.

use super::*;
use crate::filter::extended::Rule;
use crate::model::sensor::LinearSensor;
use crate::partition::distance::{DistancePartition, Thresholds};
use crate::partition::{self, Partition, PartitionModel, Points};
use crate::rfs::extended_gm_phd::ExtendedUpdate;
use crate::rfs::extent::ExtentModel;
use crate::rfs::rate::{Rate, RateModel};
use crate::stats::stream::Stream;

fn extent(cov: DMatrix<f64>, certainty: f64) -> Extent {
    Extent { cov, certainty }
}

fn line(x: f64) -> DMatrix<f64> {
    DMatrix::from_element(1, 1, x)
}

/// What is known of X in one dimension, by the trapezoidal rule in ln X: of X ~ IW with mean x and certainty κ, seen through
/// noise r by the scatter s of n measurements, n^(−1/2) left out.
struct Exact {
    log_density: f64,
    mean: f64,
    variance: f64,
}

fn exact(x: f64, certainty: f64, r: f64, n: f64, s: f64) -> Exact {
    let (dof, scale) = (certainty + 2.0, certainty * x);
    let log_norm = 0.5 * dof * (0.5 * scale).ln() - libm::lgamma(0.5 * dof);
    let mut sums = [0.0; 3];
    let (steps, low, high) = (40_000, x.ln() - 25.0, x.ln() + 25.0);
    let h = (high - low) / f64::from(steps);
    for i in 0..=steps {
        let u = low + h * f64::from(i);
        let x = u.exp();
        let y = x + r;
        let prior = log_norm - 0.5 * dof * u - 0.5 * scale / x;
        let seen = -0.5 * (n - 1.0) * (std::f64::consts::TAU * y).ln() - 0.5 * s / y;
        for (k, sum) in sums.iter_mut().enumerate() {
            *sum += h * (prior + seen).exp() * x.powi(i32::try_from(k).unwrap());
        }
    }
    let mean = sums[1] / sums[0];
    Exact {
        log_density: sums[0].ln(),
        mean,
        variance: sums[2] / sums[0] - mean * mean,
    }
}

#[test]
fn without_noise_the_scatter_and_the_extent_are_exact() {
    for (x, certainty, n, s) in [(9.0, 6.0, 4.0, 40.0), (9.0, 3.5, 2.0, 0.1), (2.0, 12.0, 3.0, 90.0)] {
        let r = 1e-10;
        let prior = extent(line(x), certainty);
        let spread = Spread::new(&prior, &line(r)).unwrap();
        let truth = exact(x, certainty, r, n, s);
        let found = spread.log_density(n, &[s]);
        assert!(
            (found - truth.log_density).abs() < 1e-8,
            "{found} {}",
            truth.log_density
        );
        let after = spread.updated(&prior, n, &[s]);
        assert!((after.cov[(0, 0)] - truth.mean).abs() < 1e-7 * truth.mean);
        assert!((after.certainty - certainty - n + 1.0).abs() < 1e-7);
    }
}

/// The same in the plane: X = L Lᵀ, the integral over ln L₁₁, ln L₂₂ and L₂₁ / (L₁₁ L₂₂) with the Jacobian 4 L₁₁² L₂₂ of X, times that of
/// the logarithms and of the ratio.
#[test]
fn in_the_plane_the_scatter_is_the_integral_over_all_ellipses() {
    let (certainty, k) = (7.0, 3.0);
    let prior = extent(DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 2.0]), certainty);
    let s = DMatrix::from_row_slice(2, 2, &[9.0, -2.0, -2.0, 3.0]);
    let (v, nu) = (&prior.cov * certainty, certainty + 3.0);
    let log_gamma = |a: f64| 0.5 * LN_PI + libm::lgamma(a) + libm::lgamma(a - 0.5);
    let log_norm = 0.5 * nu * (v.determinant().ln() - 2.0 * 2.0_f64.ln()) - log_gamma(0.5 * nu);
    let both = &v + &s;
    let (steps, h, step) = (100, 0.08, 0.04);
    let mut sum = 0.0;
    for i in -steps..=steps {
        for j in -steps..=steps {
            let (a, b) = ((h * f64::from(i)).exp(), (h * f64::from(j)).exp());
            for l in -steps..=steps {
                let c = a * b * step * f64::from(l);
                // tr((V + S) X⁻¹) through L⁻¹.
                let inverse = DMatrix::from_row_slice(2, 2, &[1.0 / a, 0.0, -c / (a * b), 1.0 / b]);
                let trace = (&inverse * &both * inverse.transpose()).trace();
                let log_x = 2.0 * (a * b).ln();
                let log = log_norm
                    - 0.5 * (nu + 3.0) * log_x
                    - 0.5 * trace
                    - 0.5 * k * (2.0 * crate::filter::kalman::LN_TAU + log_x);
                sum += log.exp() * 4.0 * a * a * b * (a * b) * (a * b) * h * h * step;
            }
        }
    }
    let spread = Spread::new(&prior, &(DMatrix::identity(2, 2) * 1e-11)).unwrap();
    let found = spread.log_density(k + 1.0, s.as_slice());
    assert!((found - sum.ln()).abs() < 1e-6, "{found} {}", sum.ln());
    let after = spread.updated(&prior, k + 1.0, s.as_slice());
    assert!((after.cov - &both / (certainty + k)).amax() < 1e-9);
}

/// E3 is an approximation. Against the integral it is the better one: compared with n measurements counting in full with a
/// scatter shrunk by X̂ / Ŷ, as the literature has it.
#[test]
fn through_noise_the_extent_is_close_to_the_integral() {
    let (mut own, mut others) = ([0.0; 2], [0.0; 2]);
    let mut stream = Stream::new(5, 0);
    let cases = 60;
    for _ in 0..cases {
        let (x, certainty, r) = (stream.between(20.0, 400.0), stream.between(5.0, 40.0), 400.0);
        let sizes: Vec<u32> = (2..40).collect();
        let size = *stream.choice(&sizes).unwrap();
        let n = f64::from(size);
        let s: f64 = (1..size).map(|_| (x + r) * stream.normal().powi(2)).sum();
        let truth = exact(x, certainty, r, n, s);
        let prior = extent(line(x), certainty);
        let spread = Spread::new(&prior, &line(r)).unwrap();
        let after = spread.updated(&prior, n, &[s]);
        own[0] += (spread.log_density(n, &[s]) - truth.log_density).abs();
        own[1] += (after.cov[(0, 0)] - truth.mean).abs() / truth.variance.sqrt();
        // Their filter: V + shrunk S, v + n − 1.
        let shrink = x / (x + r);
        let plain = Spread::new(&prior, &line(1e-12)).unwrap();
        let density = plain.log_density(n, &[s * shrink]) + 0.5 * (n - 1.0) * shrink.ln();
        others[0] += (density - truth.log_density).abs();
        let mean = (certainty * x + shrink * s) / (certainty + n - 1.0);
        others[1] += (mean - truth.mean).abs() / truth.variance.sqrt();
    }
    let mean = |sums: [f64; 2]| sums.map(|sum| sum / f64::from(cases));
    let (own, others) = (mean(own), mean(others));
    assert!(own[0] < 0.02 && own[1] < 0.08, "{own:?} {others:?}");
    assert!(own[0] < others[0] && own[1] < others[1], "{own:?} {others:?}");
}

#[test]
fn the_table_is_the_function() {
    for d in 1..=3 {
        let spread = Spread::new(&extent(DMatrix::identity(d, d) * 3.0, 4.2), &DMatrix::identity(d, d)).unwrap();
        for (k, found) in spread.log_volumes(60).into_iter().enumerate() {
            let expected = spread.log_volume(k as f64);
            assert!((found - expected).abs() < 1e-11 * expected.abs().max(1.0), "{d} {k}");
        }
        assert_eq!(spread.log_volumes(0), [0.0]);
    }
}

#[test]
fn the_determinant_is_that_of_the_ratio() {
    let mut stream = Stream::new(3, 0);
    for d in 1..=3 {
        let mut draw = |n: usize| DMatrix::from_fn(d, n, |_, _| stream.normal());
        let (half, points) = (draw(d), draw(5));
        let (v, s) = (
            &half * half.transpose() + DMatrix::identity(d, d),
            &points * points.transpose(),
        );
        let factor = Cholesky::new(&v, "V").unwrap();
        let found = log_determinant_with(factor.lower(), s.as_slice());
        let expected = ((&v + &s).determinant() / v.determinant()).ln();
        assert!((found - expected).abs() < 1e-12, "{d}: {found} {expected}");
        let small = log_determinant_with(factor.lower(), (&s * 1e-20).as_slice());
        assert!((small - factor.solve(&s).trace() * 1e-20).abs() < 1e-32);
    }
}

#[test]
fn extents_at_the_limits_stay_extents() {
    let noise = DMatrix::identity(2, 2) * 400.0;
    let prior = extent(DMatrix::identity(2, 2) * 100.0, 5.0);
    let spread = Spread::new(&prior, &noise).unwrap();
    // One measurement says nothing, and a share of less than one neither.
    for count in [0.3, 1.0] {
        assert_eq!(spread.updated(&prior, count, &[0.0; 4]), prior);
    }
    assert_eq!(spread.log_density(1.0, &[0.0; 4]), 0.0);
    // As expected: the extent stays and gets more certain.
    let expected: Vec<f64> = (&spread.cov * 9.0).as_slice().to_vec();
    let same = spread.updated(&prior, 10.0, &expected);
    assert!((&same.cov - &prior.cov).amax() < 1e-10 && same.certainty > prior.certainty);
    // Less certain than from as many measurements without noise.
    assert!(same.certainty < prior.certainty + 9.0 * 0.05);
    // No scatter at all, again and again: a small extent, never none, and still one that can grow.
    let mut small = prior.clone();
    for _ in 0..2000 {
        small = Spread::new(&small, &noise).unwrap().updated(&small, 40.0, &[0.0; 4]);
        assert!(small.check(2).is_ok());
    }
    assert!((small.cov[(0, 0)] - 0.4).abs() < 1e-9);
    let grown = Spread::new(&small, &noise)
        .unwrap()
        .updated(&small, 1e7, &[5e9, 0.0, 0.0, 5e9]);
    assert!(grown.check(2).is_ok() && grown.cov[(0, 0)] > 50.0);
    // Far more noise than extent, and the other way round.
    for scale in [1e-12, 1e12] {
        let prior = extent(DMatrix::identity(2, 2) * scale, 5.0);
        let spread = Spread::new(&prior, &noise).unwrap();
        let after = spread.updated(&prior, 12.0, &[4400.0, 0.0, 0.0, 4400.0]);
        assert!(after.check(2).is_ok() && spread.log_density(12.0, &[4400.0, 0.0, 0.0, 4400.0]).is_finite());
    }
}

const FOUR: [f64; 4] = [0.0, 1.5, 6.0, 7.0];
const NEXT_TO_NOTHING: f64 = 1e-10;

/// A cell as it is written by hand.
struct Term {
    size: f64,
    mean: f64,
    scatter: f64,
    likelihoods: Vec<f64>,
    weight: f64,
}

/// Two components on a line, and how four measurements are divided.
struct Line {
    mixture: [Component; 2],
    update: ExtendedUpdate,
    partitions: Vec<Partition>,
}

impl Line {
    fn new() -> Self {
        let component = |weight: f64, place: f64, x: f64, certainty: f64, label: u64| Component {
            weight,
            state: Gaussian::new(DVector::from_vec(vec![place, 0.0]), DMatrix::identity(2, 2) * 2.0).unwrap(),
            rate: Rate::with_mean(2.0, 8.0),
            extent: Some(extent(line(x), certainty)),
            label,
            rooted: false,
        };
        let rule = DistancePartition {
            thresholds: Thresholds::Range {
                lower: 0.1,
                upper: 100.0,
            },
            ..DistancePartition::default()
        };
        let points = Points::whitened(&FOUR, 1, &line(1.0 + NEXT_TO_NOTHING)).unwrap();
        Self {
            mixture: [component(0.8, 1.0, 1.0, 6.0, 1), component(0.4, 5.0, 3.0, 4.0, 2)],
            partitions: partition::partitions(&rule, &points, None).unwrap(),
            update: ExtendedUpdate {
                rates: RateModel::Known,
                partition: PartitionModel::Distance(rule),
                clutter_filter: None,
                superposition: false,
                prune: 0.0,
                extent: Some(ExtentModel {
                    prior: extent(line(1.0), 5.0),
                    time_constant: 30.0,
                }),
            },
        }
    }
}

/// The whole update on four measurements on a line, with next to no noise: all partitions one by one, the density of a cell's
/// mean by its formula, that of its scatter by the integral over all extents.
#[test]
fn four_measurements_are_weighed_as_by_hand() {
    let (z, noise, p_d, clutter) = (FOUR, NEXT_TO_NOTHING, 0.9, 0.02);
    let h = DMatrix::from_row_slice(1, 2, &[1.0, 0.0]);
    let sensor = LinearSensor::new(h, line(noise), DVector::zeros(1)).unwrap();
    let Line {
        mixture,
        update,
        partitions,
    } = Line::new();
    assert!(partitions.len() >= 3);
    let sight = Sight {
        sensor: &sensor,
        platform: None,
        rule: Rule::Once,
        detection_probability: p_d,
        clutter_density: clutter,
    };
    let mut found = mixture.to_vec();
    update.update(&mut found, &z, &sight).unwrap();

    // By hand: every partition, every cell in it as often as it stands there.
    let term = |members: &[usize]| {
        let n = members.len() as f64;
        let mean = members.iter().map(|&i| z[i]).sum::<f64>() / n;
        let scatter = members.iter().map(|&i| (z[i] - mean).powi(2)).sum::<f64>();
        let likelihood = |c: &Component| {
            let e = c.extent.as_ref().unwrap();
            let (x, rate) = (e.cov[(0, 0)], c.rate.mean());
            let s = 2.0 + (x + noise) / n;
            let off = mean - c.state.mean[0];
            let density = (-0.5 * off * off / s).exp() / (std::f64::consts::TAU * s).sqrt();
            let shape = exact(x, e.certainty, noise, n, scatter).log_density.exp() / n.sqrt();
            c.weight * p_d * (-rate).exp() * rate.powf(n) * density * shape
        };
        let likelihoods: Vec<f64> = mixture.iter().map(likelihood).collect();
        let alone = if members.len() == 1 { clutter } else { 0.0 };
        Term {
            size: n,
            mean,
            scatter,
            weight: alone + likelihoods.iter().sum::<f64>(),
            likelihoods,
        }
    };
    let all: Vec<Vec<Term>> = partitions
        .iter()
        .map(|p| p.cells().iter().map(|c| term(c)).collect())
        .collect();
    let products: Vec<f64> = all.iter().map(|p| p.iter().map(|t| t.weight).product()).collect();
    let total: f64 = products.iter().sum();
    let mut sums = [0.0; 2];
    for (partition, product) in all.iter().zip(&products) {
        for term in partition {
            for (sum, likelihood) in sums.iter_mut().zip(&term.likelihoods) {
                *sum += product / total * likelihood / term.weight;
            }
        }
    }
    for (j, expected) in sums.iter().enumerate() {
        let weight: f64 = found[2..]
            .iter()
            .filter(|c| c.label == mixture[j].label)
            .map(|c| c.weight)
            .sum();
        assert!((weight - expected).abs() < 1e-7, "{weight} {expected}");
    }
    // Every cell's extent, for the component that is updated by it.
    for term in all.iter().flatten() {
        let prior = mixture[0].extent.as_ref().unwrap();
        let certainty = prior.certainty + term.size - 1.0;
        let x = (prior.certainty * prior.cov[(0, 0)] + term.scatter) / certainty;
        let gain = 2.0 / (2.0 + prior.cov[(0, 0)] / term.size);
        let place = 1.0 + gain * (term.mean - 1.0);
        let same = |c: &&Component| c.label == 1 && (c.state.mean[0] - place).abs() < 1e-6;
        let hit = found[2..].iter().find(same).unwrap().extent.as_ref().unwrap();
        assert!((hit.cov[(0, 0)] - x).abs() < 1e-6 && (hit.certainty - certainty).abs() < 1e-6);
    }
}
