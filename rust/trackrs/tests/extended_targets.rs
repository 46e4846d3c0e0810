//! Extended targets: moments of what is drawn against the textbook ones of each shape, counts, streams, refusals.

use trackrs::error::Error;
use trackrs::sim::extended_targets::{
    Detections, ExtendedTarget, ExtendedTargets, ExtendedTargetsSettings, crossing, parallel,
};
use trackrs::sim::shape::Shape;

const BLOB: Shape = Shape::Blob { spread: 20.0 };

/// One target that stands in no scan where it stood before, flies 30° off the x axis, and nothing else.
fn alone(shape: Shape) -> ExtendedTargetsSettings {
    let target = ExtendedTarget {
        start: [100.0, -50.0, 3.0_f64.sqrt(), 1.0],
        first: 1.0,
        last: f64::INFINITY,
        rate: 20.0,
        shape,
    };
    ExtendedTargetsSettings {
        targets: vec![target],
        scans: 2000,
        clutter: 0.0,
        detection_probability: 1.0,
        ..ExtendedTargetsSettings::default()
    }
}

fn draw(settings: ExtendedTargetsSettings) -> Vec<Detections> {
    ExtendedTargets::new(settings).unwrap().draw(5, 2).unwrap()
}

/// Variance along, across, and covariance of a uniform point, from the definition of each shape.
fn extent(shape: Shape) -> [f64; 3] {
    match shape {
        Shape::Blob { .. } => [0.0; 3],
        // Radius of a disc: ∫ r² dA / A = ½, half of it on each axis.
        Shape::Ellipse { length, width } => [(length / 2.0).powi(2) / 4.0, (width / 2.0).powi(2) / 4.0, 0.0],
        Shape::Rectangle { length, width } => [length.powi(2) / 12.0, width.powi(2) / 12.0, 0.0],
        // An axis: with probability ½ uniform from 0 to the arm, else 0. Never both.
        Shape::L { arm } => {
            let mean = arm / 4.0;
            let variance = arm.powi(2) / 6.0 - mean.powi(2);
            [variance, variance, -mean.powi(2)]
        }
    }
}

#[test]
fn detections_have_the_moments_of_their_shape() {
    for shape in [BLOB].into_iter().chain(Shape::of_the_spec()) {
        let scene = ExtendedTargets::new(alone(shape)).unwrap();
        let mut errors: Vec<[f64; 2]> = Vec::new();
        for detections in scene.draw(5, 2).unwrap() {
            let [x, y, vx, vy] = scene.truth(0, detections.scan.time).unwrap();
            let [c, s] = [vx / 2.0, vy / 2.0];
            for value in &detections.scan.values {
                let [dx, dy] = [value[0] - x, value[1] - y];
                errors.push([c * dx + s * dy, c * dy - s * dx]);
            }
        }
        let [along, across, both] = extent(shape);
        let expected = [0.0, 0.0, along + 400.0, across + 400.0, both];
        let terms = |&[x, y]: &[f64; 2]| [x, y, x * x, y * y, x * y];
        let n = errors.len() as f64;
        for (i, expected) in expected.into_iter().enumerate() {
            let values: Vec<f64> = errors.iter().map(|e| terms(e)[i]).collect();
            let mean = values.iter().sum::<f64>() / n;
            let std = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n / n).sqrt();
            assert!((mean - expected).abs() < 4.0 * std, "{shape:?} {i}: {mean} {expected}");
        }
        let told = scene.sensor_std().powi(2);
        assert!((told - 0.5 * (along + across) - 400.0).abs() < 1e-9, "{told}");
    }
}

/// Mean and variance of counts, with four standard errors of each for a Poisson number.
fn assert_poisson(counts: &[usize], mean: f64) {
    let n = counts.len() as f64;
    let average = counts.iter().sum::<usize>() as f64 / n;
    let variance = counts.iter().map(|&c| (c as f64 - mean).powi(2)).sum::<f64>() / n;
    assert!((average - mean).abs() < 4.0 * (mean / n).sqrt(), "{average} {mean}");
    let error = ((mean + 2.0 * mean * mean) / n).sqrt();
    assert!((variance - mean).abs() < 4.0 * error, "{variance} {mean}");
}

#[test]
fn counts_are_poisson_and_misses_binomial() {
    let scans = draw(ExtendedTargetsSettings {
        clutter: 7.0,
        detection_probability: 0.8,
        ..alone(BLOB)
    });
    let own = |d: &Detections| d.origins.iter().flatten().count();
    let clutter: Vec<usize> = scans.iter().map(|d| d.origins.len() - own(d)).collect();
    assert_poisson(&clutter, 7.0);
    // Poisson(20) is 0 once in 5e8.
    let seen: Vec<usize> = scans.iter().map(own).filter(|&n| n > 0).collect();
    assert_poisson(&seen, 20.0);
    assert!((seen.len() as f64 - 1600.0).abs() < 4.0 * (2000.0_f64 * 0.16).sqrt());
    let places = || scans.iter().flat_map(|d| d.scan.values.iter().zip(&d.origins));
    let false_ones: Vec<_> = places().filter(|(_, origin)| origin.is_none()).collect();
    let n = false_ones.len() as f64;
    for axis in 0..2 {
        let values = || false_ones.iter().map(|(value, _)| value[axis]);
        assert!(values().all(|v| (-1000.0..1000.0).contains(&v)));
        let (mean, square) = (values().sum::<f64>() / n, values().map(|v| v * v).sum::<f64>() / n);
        assert!(mean.abs() < 4.0 * (1e6 / 3.0 / n).sqrt(), "{mean}");
        // The fourth moment of a uniform number is a⁴ / 5: variance of a square (1/5 - 1/9) a⁴.
        assert!(
            (square - 1e6 / 3.0).abs() < 4.0 * 1e6 * (4.0 / 45.0 / n).sqrt(),
            "{square}"
        );
    }
}

#[test]
fn targets_meet_or_stay_apart() {
    let scene = ExtendedTargets::new(crossing([BLOB; 3], [10.0, 20.0, 40.0])).unwrap();
    for i in 0..3 {
        let [x, y, ..] = scene.truth(i, 50.0).unwrap();
        assert!(x.abs().max(y.abs()) < 1e-9);
    }
    let lives = |i: usize| -> Vec<f64> {
        let times = (0..100).map(|k| scene.time(k));
        times.filter(|&t| scene.truth(i, t).is_some()).collect()
    };
    assert_eq!([lives(0).len(), lives(1).len()], [100, 100]);
    assert_eq!([lives(2)[0], lives(2)[70]], [20.0, 90.0]);
    assert_eq!(lives(2).len(), 71);
    assert_eq!(scene.truth(3, 50.0), None);
    let births: Vec<_> = scene
        .births()
        .iter()
        .map(|b| [b.mean[0], b.mean[1], b.mean[2]])
        .collect();
    assert_eq!(
        births,
        [[-800.0, -600.0, 0.0], [-900.0, 100.0, 0.0], [-700.0, 700.0, 0.0]]
    );
    assert_eq!(
        scene.births()[0].cov.diagonal().as_slice(),
        [2500.0, 2500.0, 625.0, 625.0]
    );
    assert_eq!([scene.clutter_density(), scene.detections_per_target()], [2.5e-6, 20.0]);
    assert_eq!(scene.sensor_std(), 20.0);
    let [ellipse, rectangle, l] = Shape::of_the_spec();
    let shapes = ExtendedTargets::new(crossing([ellipse, rectangle, l], [10.0; 3])).unwrap();
    assert!((shapes.sensor_std().powi(2) - 650.0).abs() < 1e-9);
    let parallel = ExtendedTargets::new(parallel([BLOB, ellipse], [10.0; 2], 70.0)).unwrap();
    assert_eq!(parallel.truth(0, 51.0), Some([0.0, 600.0, 16.0, 0.0]));
    assert_eq!(parallel.truth(1, 100.0), Some([784.0, 670.0, 16.0, 0.0]));
    assert!((parallel.sensor_std().powi(2) - 514.0625).abs() < 1e-9);
}

#[test]
fn what_is_left_alone_keeps_its_noise() {
    let base = crossing([BLOB; 3], [10.0, 20.0, 40.0]);
    let with = |change: fn(&mut ExtendedTargetsSettings)| {
        let mut settings = base.clone();
        change(&mut settings);
        draw(settings)
    };
    let of = |scans: &[Detections], own: bool| -> Vec<Vec<f64>> {
        let all = scans.iter().flat_map(|d| d.scan.values.iter().zip(&d.origins));
        let kept = all.filter(|(_, origin)| origin.is_some() == own);
        kept.map(|(value, _)| value.as_slice().to_vec()).collect()
    };
    let plain = draw(base.clone());
    assert_eq!(plain, draw(base.clone()));
    assert_ne!(plain, ExtendedTargets::new(base.clone()).unwrap().draw(5, 3).unwrap());
    assert_eq!(of(&plain, true), of(&with(|s| s.clutter = 3.0), true));
    let missed = with(|s| s.detection_probability = 0.5);
    assert_eq!(of(&plain, false), of(&missed, false));
    assert!(of(&missed, true).iter().all(|row| of(&plain, true).contains(row)));
    let reshaped = with(|s| s.targets[0].shape = Shape::L { arm: 60.0 });
    assert_eq!(of(&plain, false), of(&reshaped, false));
    assert_eq!(of(&plain, true).len(), of(&reshaped, true).len());
}

#[test]
fn a_group_from_one_region_loses_one_inside() {
    let target = |y: f64, last: f64| ExtendedTarget {
        start: [-800.0, y, 16.0, 0.0],
        first: 1.0,
        last,
        rate: 10.0,
        shape: BLOB,
    };
    let settings = ExtendedTargetsSettings {
        targets: vec![target(600.0, f64::INFINITY), target(640.0, 50.0)],
        births: vec![[-800.0, 620.0]],
        scans: 150,
        interval: 0.1,
        ..ExtendedTargetsSettings::default()
    };
    let scene = ExtendedTargets::new(ExtendedTargetsSettings {
        interval: 1.0,
        ..settings.clone()
    })
    .unwrap();
    assert_eq!(scene.births().len(), 1);
    let of_second = |d: &Detections| d.origins.contains(&Some(1));
    let scans = scene.draw(1, 0).unwrap();
    assert!(scans[..50].iter().filter(|d| of_second(d)).count() > 45);
    assert!(!scans[50..].iter().any(of_second));
    // Times that are sums of tenths: the first scan of a life belongs to it.
    let tenths = ExtendedTargets::new(settings).unwrap();
    assert!(tenths.truth(0, tenths.time(9)).is_some() && tenths.truth(0, tenths.time(8)).is_none());
}

/// What makes settings wrong.
type Mistake = fn(&mut ExtendedTargetsSettings);

#[test]
fn mistakes_are_named() {
    let refused = |change: Mistake| -> String {
        let mut settings = crossing([BLOB; 3], [10.0; 3]);
        change(&mut settings);
        ExtendedTargets::new(settings).unwrap_err().to_string()
    };
    let cases: [(&str, Mistake); 16] = [
        ("targets = none", |s| s.targets.clear()),
        ("interval = 0", |s| s.interval = 0.0),
        ("clutter = -1", |s| s.clutter = -1.0),
        ("detection_probability = 1.5", |s| s.detection_probability = 1.5),
        ("noise_std = NaN", |s| s.noise_std = f64::NAN),
        ("sensor_std = 0", |s| s.sensor_std = Some(0.0)),
        ("births", |s| s.births = vec![[f64::NAN, 0.0]]),
        ("start of target 1", |s| s.targets[1].start[2] = f64::INFINITY),
        ("first of target 1", |s| s.targets[1].first = f64::NAN),
        ("life of target 2", |s| s.targets[2].last = 0.0),
        ("life of target 2", |s| s.targets[2].last = f64::NAN),
        ("life of target 0", |s| s.scans = 0),
        ("rate of target 0 = 0", |s| s.targets[0].rate = 0.0),
        ("mean detections in a scan", |s| s.targets[0].rate = 1e300),
        ("spread = 0", |s| s.targets[0].shape = Shape::Blob { spread: 0.0 }),
        ("arm = -1", |s| s.targets[0].shape = Shape::L { arm: -1.0 }),
    ];
    for (culprit, change) in cases {
        let text = refused(change);
        assert!(text.contains(culprit), "{culprit}: {text}");
    }
    let shape = Shape::Ellipse {
        length: 80.0,
        width: f64::NAN,
    };
    let error = ExtendedTargets::new(alone(shape)).unwrap_err();
    assert!(matches!(error, Error::InvalidParameter { name, .. } if name == "width"));
}
