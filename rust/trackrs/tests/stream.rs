//! Streams: the published bits, the moments of every distribution, and no correlation between runs.

use serde_json::Value;
use trackrs::stats::stream::Stream;

const DRAWS: usize = 100_000;

#[test]
fn bits_are_those_of_an_independent_implementation() {
    let text = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/streams.json"));
    let file: Value = serde_json::from_str(text).unwrap();
    let number = |value: &Value| value.as_str().unwrap().parse::<u64>().unwrap();
    for case in file["streams"].as_array().unwrap() {
        let mut stream = Stream::new(number(&case["seed"]), number(&case["run"]));
        for bits in case["bits"].as_array().unwrap() {
            assert_eq!(stream.bits(), number(bits), "{case}");
        }
    }
}

/// Mean, variance and fourth central moment.
fn moments(values: &[f64]) -> [f64; 3] {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let central = |power| values.iter().map(|v| (v - mean).powi(power)).sum::<f64>() / n;
    [mean, central(2), central(4)]
}

/// Five standard errors of the mean, of the variance and, roughly, of the fourth moment.
fn assert_moments(values: &[f64], mean: f64, variance: f64, fourth: f64) {
    let n = values.len() as f64;
    let found = moments(values);
    assert!((found[0] - mean).abs() < 5.0 * (variance / n).sqrt(), "{found:?}");
    let spread = ((fourth - variance * variance) / n).sqrt();
    assert!((found[1] - variance).abs() < 5.0 * spread, "{found:?}");
    assert!((found[2] / fourth - 1.0).abs() < 0.1, "{found:?}");
}

#[test]
fn moments_are_right() {
    let mut stream = Stream::new(1, 0);
    let uniform: Vec<f64> = (0..DRAWS).map(|_| stream.uniform()).collect();
    assert!(uniform.iter().all(|u| (0.0..1.0).contains(u)));
    assert_moments(&uniform, 0.5, 1.0 / 12.0, 1.0 / 80.0);
    let between: Vec<f64> = (0..DRAWS).map(|_| stream.between(10.0, 100.0)).collect();
    assert_moments(&between, 55.0, 8100.0 / 12.0, 90_f64.powi(4) / 80.0);
    let normal: Vec<f64> = (0..DRAWS).map(|_| stream.normal()).collect();
    assert_moments(&normal, 0.0, 1.0, 3.0);
    let pairs: f64 = normal.chunks_exact(2).map(|pair| pair[0] * pair[1]).sum();
    assert!(
        pairs.abs() < 5.0 * (DRAWS as f64 / 2.0).sqrt(),
        "the two of a pair are independent"
    );
    for mean in [0.3, 4.0, 60.0] {
        let counts: Vec<f64> = (0..DRAWS).map(|_| stream.poisson(mean).unwrap() as f64).collect();
        assert_moments(&counts, mean, mean, mean * (1.0 + 3.0 * mean));
        let none = counts.iter().filter(|&&c| c == 0.0).count() as f64 / DRAWS as f64;
        assert!((none - (-mean).exp()).abs() < 0.01);
    }
}

#[test]
fn runs_and_seeds_are_independent_of_one_another() {
    let draw = |seed, run| {
        let mut stream = Stream::new(seed, run);
        (0..2000).map(|_| stream.normal()).collect::<Vec<f64>>()
    };
    let near: Vec<Vec<f64>> = [(0, 0), (0, 1), (1, 0), (1, 1), (1 << 32, 0), (0, 1 << 32)]
        .map(|(seed, run)| draw(seed, run))
        .into();
    for (i, a) in near.iter().enumerate() {
        for b in &near[..i] {
            let product: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
            assert!(product.abs() < 4.5 * 2000_f64.sqrt(), "stream {i}: {product}");
        }
    }
    assert_eq!(near[1], draw(0, 1));
}
