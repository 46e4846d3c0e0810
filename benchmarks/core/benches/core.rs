//! What the core spends its time on, each at several sizes.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{DMatrix, DVector};
use trackrs::association::assignment::assign;
use trackrs::association::marginals::{Domain, Options, Weights, marginals};
use trackrs::filter::batch::{TrackBatch, Wanted};
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::sigma_points::SigmaPoints;
use trackrs::filter::smoother::fixed_interval;
use trackrs::gating::distances::{Expected, pairs_within, squared_distances};
use trackrs::metric::ospa::ospa;
use trackrs::model::sensor::RangeBearing;
use trackrs::model::{Motion, Sensor, SensorModel};
use trackrs::partition::density_peaks::DensityPeakPartition;
use trackrs::partition::lof::LocalOutlierFactor;
use trackrs::partition::{Partitioner, Points};
use trackrs::rfs::prediction::Birth;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::tracker::phd::PhdTracker;
use trackrs::tracker::phd::config::PhdConfig;
use trackrs_benches::{acceleration, numbers, positions, scans, standing, velocity};

fn sequences(c: &mut Criterion) {
    const ROWS: usize = 1_000;
    let radar = SensorModel::RangeBearing(RangeBearing::new([0.0, 0.0], 1.0, 0.01).unwrap());
    let filters = [
        ("kalman 4/2", Filter::kalman(velocity(2), positions(2)).unwrap()),
        ("kalman 9/3", Filter::kalman(acceleration(3), positions(3)).unwrap()),
        ("extended 4/2", Filter::extended(velocity(2), radar.clone()).unwrap()),
        (
            "cubature 4/2",
            Filter::sigma_points(velocity(2), radar, SigmaPoints::cubature()).unwrap(),
        ),
    ];
    let mut group = c.benchmark_group("sequence");
    group.throughput(Throughput::Elements(ROWS as u64));
    for (name, filter) in &filters {
        let mut mean = vec![0.0; filter.motion().state_dim()];
        (mean[0], mean[1]) = (30.0, 40.0);
        let m = filter.sensor().measurement_dim();
        let row = if name.starts_with("kalman") {
            vec![30.0; m]
        } else {
            vec![50.0, 0.92]
        };
        let values = vec![DVector::from_vec(row); ROWS];
        let start = InitialState {
            time: 0.0,
            state: standing(mean),
        };
        let times: Vec<f64> = (1..=ROWS).map(|k| k as f64).collect();
        let run = || filter.run(&times, &values, Some(&start), None, History::Full).unwrap();
        group.bench_function(BenchmarkId::new("filter", name), |b| b.iter(run));
        let done = run();
        group.bench_function(BenchmarkId::new("smoother", name), |b| {
            b.iter(|| fixed_interval(&done.epochs().unwrap()).unwrap());
        });
    }
}

fn batches(c: &mut Criterion) {
    let mut group = c.benchmark_group("batch of 10 steps");
    for tracks in [100, 1_000, 10_000] {
        let filter = Filter::kalman(velocity(2), positions(2)).unwrap();
        let covs = DMatrix::<f64>::identity(4, 4);
        let batch = TrackBatch::new(filter, 0.0, &vec![0.0; tracks * 4], covs.as_slice()).unwrap();
        let mut batch = batch.with_threads(1).unwrap();
        let values = numbers(tracks * 10 * 2, -1.0, 1.0);
        group.throughput(Throughput::Elements(10 * tracks as u64));
        group.bench_function(BenchmarkId::from_parameter(tracks), |b| {
            b.iter(|| {
                let now = batch.time();
                let times: Vec<f64> = (1..=10).map(|k| now + f64::from(k)).collect();
                batch.run(&times, black_box(&values), Wanted::default()).unwrap()
            });
        });
    }
}

fn gates(c: &mut Criterion) {
    let mut group = c.benchmark_group("gates");
    for (count, dims) in [(100, 2), (1_000, 2), (1_000, 3)] {
        let (means, reports) = (numbers(count * dims, 0.0, 1e3), numbers(count * dims, 0.0, 1e3));
        let covs = DMatrix::<f64>::identity(dims, dims).as_slice().repeat(count);
        let expected = Expected {
            dims,
            means: &means,
            covs: &covs,
        };
        let name = format!("{count} squared, {dims} components");
        let mut all = vec![0.0; count * count];
        group.bench_function(BenchmarkId::new("full", &name), |b| {
            b.iter(|| squared_distances(&expected, black_box(&reports), &mut all).unwrap());
        });
        group.bench_function(BenchmarkId::new("pairs", &name), |b| {
            b.iter(|| pairs_within(&expected, black_box(&reports), 9.2).unwrap());
        });
    }
}

fn associations(c: &mut Criterion) {
    let mut group = c.benchmark_group("association");
    for n in [4, 8, 12] {
        let weights = Weights::from_dense(&numbers(n * (n + 1), 0.1, 1.0), n, n + 1, Domain::Linear).unwrap();
        group.bench_function(BenchmarkId::new("joint marginals", n), |b| {
            b.iter(|| marginals(black_box(&weights), &Options::default()).unwrap());
        });
    }
    for n in [10, 100, 500] {
        let costs = numbers(n * n, 0.0, 1.0);
        group.bench_function(BenchmarkId::new("assignment", n), |b| {
            b.iter(|| assign(black_box(&costs), n, n).unwrap());
        });
        let points = DMatrix::from_vec(n, 2, numbers(2 * n, 0.0, 1e3));
        let others = &points + DMatrix::from_vec(n, 2, numbers(2 * n, -3.0, 3.0));
        group.bench_function(BenchmarkId::new("OSPA", n), |b| {
            b.iter(|| ospa(black_box(&points), &others, 50.0, 2.0).unwrap());
        });
    }
}

fn partitions(c: &mut Criterion) {
    let mut group = c.benchmark_group("partition");
    for n in [300, 2_000, 10_000] {
        let points = Points::whitened(&numbers(2 * n, 0.0, 1e3), 2, &DMatrix::identity(2, 2)).unwrap();
        group.bench_function(BenchmarkId::new("density peaks", n), |b| {
            b.iter(|| DensityPeakPartition::default().labels(black_box(&points)).unwrap());
        });
        group.bench_function(BenchmarkId::new("local outlier factor", n), |b| {
            b.iter(|| LocalOutlierFactor::default().explain(black_box(&points)).unwrap());
        });
    }
}

fn trackers(c: &mut Criterion) {
    let mut group = c.benchmark_group("tracker, 10 scans");
    group.sample_size(20);
    for (targets, clutter) in [(10, 5), (100, 50), (1_000, 500)] {
        let sensors = [("radar".to_string(), positions(2))].into();
        let config = TrackerConfig::new(velocity(2), sensors, 20.0).unwrap();
        let mut tracker = MultiTargetTracker::new(config).unwrap();
        let given = scans(targets, clutter);
        tracker.run(&given[..10]).unwrap();
        let name = format!("{targets} targets, {clutter} clutter");
        group.bench_function(BenchmarkId::new("global nearest neighbour", &name), |b| {
            b.iter(|| {
                let mut tracker = tracker.clone();
                given[10..].iter().for_each(|scan| tracker.update(scan).unwrap());
            });
        });
    }
    let places = numbers(20, 0.0, 1e3);
    let births = places.chunks_exact(2).map(|place| Birth {
        weight: 0.1,
        state: standing(vec![place[0], place[1], 0.0, 0.0]),
    });
    let mixture = PhdTracker::new(PhdConfig::new(velocity(2), positions(2), births.collect(), 5.0, 1e-6)).unwrap();
    let given = scans(10, 50);
    group.bench_function("extended GM-PHD, 10 births, 60 reports", |b| {
        b.iter(|| {
            let mut tracker = mixture.clone();
            given[..10].iter().for_each(|scan| drop(tracker.step(scan).unwrap()));
        });
    });
}

criterion_group!(core, sequences, batches, gates, associations, partitions, trackers);
criterion_main!(core);
