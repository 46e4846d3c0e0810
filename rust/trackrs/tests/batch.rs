//! Batches: threads, pieces, neighbours, tracks outside of lanes, escalation, mistakes.

use nalgebra::{DMatrix, DVector};
use trackrs::Gaussian;
use trackrs::filter::batch::{TrackBatch, Wanted};
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::lanes::Level;
use trackrs::model::SensorModel;
use trackrs::model::sensor::RangeBearing;

use crate::batches::{ALL, case, filter, motion, same};

#[test]
fn threads_pieces_and_neighbours_change_nothing() {
    let (tracks, steps) = (1203, 40);
    let case = case(4, 2, tracks, steps, 5);
    let make = || TrackBatch::new(filter(2, 2), 0.0, &case.means, &case.covs).unwrap();
    let whole = make()
        .with_threads(1)
        .unwrap()
        .run(&case.times, &case.values, ALL)
        .unwrap();
    for threads in [2, 3, 7] {
        let run = make()
            .with_threads(threads)
            .unwrap()
            .run(&case.times, &case.values, ALL)
            .unwrap();
        assert!(same(&run.means, &whole.means) && same(&run.covs, &whole.covs) && same(&run.nis, &whole.nis));
    }
    // Scan by scan.
    let mut batch = make();
    for (t, &time) in case.times.iter().enumerate() {
        let scan: Vec<f64> = (0..tracks)
            .flat_map(|b| case.values[(b * steps + t) * 2..][..2].to_vec())
            .collect();
        batch.run(&[time], &scan, Wanted::default()).unwrap();
    }
    let mut at_once = make();
    at_once.run(&case.times, &case.values, Wanted::default()).unwrap();
    assert!(same(&batch.means(), &at_once.means()) && same(&batch.covs(), &at_once.covs()));
    // One track alone.
    let track = 1200;
    let mut alone = TrackBatch::new(
        filter(2, 2),
        0.0,
        &case.means[track * 4..][..4],
        &case.covs[track * 16..][..16],
    )
    .unwrap();
    let run = alone
        .run(&case.times, &case.values[track * steps * 2..][..steps * 2], ALL)
        .unwrap();
    assert!(same(&run.means, &whole.means[track * steps * 4..][..steps * 4]));
}

#[test]
fn other_filters_run_track_by_track() {
    let sensor = SensorModel::RangeBearing(RangeBearing::new([0.0, 0.0], 5.0, 0.01).unwrap());
    let ekf = Filter::extended(motion(2, 2), sensor).unwrap();
    let (tracks, steps) = (13, 6);
    let means: Vec<f64> = (0..tracks).flat_map(|b| [300.0 + b as f64, 400.0, 1.0, -1.0]).collect();
    let cov: Vec<f64> = DMatrix::<f64>::identity(4, 4).as_slice().to_vec();
    let times: Vec<f64> = (1..=steps).map(|k| k as f64).collect();
    let values: Vec<f64> = (0..tracks * steps)
        .flat_map(|k| [500.0 + (k % 3) as f64, 0.92])
        .collect();
    let runs: Vec<_> = [1, 3]
        .into_iter()
        .map(|threads| {
            let batch = TrackBatch::new(ekf.clone(), 0.0, &means, &cov).unwrap();
            assert!(!batch.in_lanes());
            let mut batch = batch.with_threads(threads).unwrap();
            let run = batch.run(&times, &values, ALL).unwrap();
            assert!(same(&batch.means()[..4], &run.means[(steps - 1) * 4..steps * 4]));
            run
        })
        .collect();
    assert_eq!(runs[0], runs[1]);
    let one: Vec<DVector<f64>> = values[..steps * 2]
        .chunks_exact(2)
        .map(DVector::from_row_slice)
        .collect();
    let initial = InitialState {
        time: 0.0,
        state: Gaussian {
            mean: DVector::from_row_slice(&means[..4]),
            cov: DMatrix::identity(4, 4),
        },
    };
    let run = ekf.run(&times, &one, Some(&initial), None, History::Filtered).unwrap();
    for k in 0..steps {
        assert!(same(
            &runs[0].means[k * 4..(k + 1) * 4],
            run.filtered.at(k).mean.as_slice()
        ));
    }
}

#[test]
fn what_is_not_observed_is_predicted_only() {
    let kf = filter(1, 1);
    assert!(TrackBatch::new(kf.clone(), 0.0, &[0.0], &[-5.0]).is_err());
    let mut batch = TrackBatch::new(kf, 0.0, &[0.0, 1.0, 2.0], &[1.0]).unwrap();
    batch
        .run(&[1.0], &[f64::NAN, 1.0, f64::NAN], Wanted::default())
        .unwrap();
    assert_eq!(batch.failures(), [0, 0, 0]);
    assert_eq!(batch.means()[0], 0.0);
    assert_eq!(batch.covs()[0], batch.covs()[2]);
    assert!(batch.covs()[1] < batch.covs()[0]);
}

#[test]
fn mistakes_are_named() {
    let make = || TrackBatch::new(filter(2, 2), 3.0, &[0.0; 8], DMatrix::<f64>::identity(4, 4).as_slice()).unwrap();
    let message = |result: trackrs::Result<trackrs::filter::batch::BatchRun>| result.unwrap_err().to_string();
    assert!(message(make().run(&[2.0], &[0.0; 4], ALL)).contains('2'));
    assert!(message(make().run(&[4.0], &[0.0; 3], ALL)).contains("measurements"));
    assert!(message(make().run(&[4.0], &[0.0, 0.0, f64::INFINITY, 0.0], ALL)).contains("measurement"));
    assert!(message(make().run(&[f64::NAN], &[0.0; 4], ALL)).contains("times"));
    assert!(make().with_threads(0).is_err());
    assert!(TrackBatch::new(filter(2, 2), 0.0, &[0.0; 7], &[1.0; 16]).is_err());
    let lopsided = DMatrix::from_fn(4, 4, |i, j| if i == j { 2.0 } else { 0.1 * (i as f64) });
    let error = TrackBatch::new(filter(2, 2), 0.0, &[0.0; 4], lopsided.as_slice()).unwrap_err();
    assert!(error.to_string().contains("symmetric"), "{error}");
    assert!(make().run(&[], &[], ALL).unwrap().means.is_empty());
}

/// A track that begins close to singular leaves the lanes: it has the bits of the filter of one sequence, in one call or in
/// many, and the others have those of a batch without it.
#[test]
fn a_track_that_escalates_is_that_of_a_run() {
    let (dims, order, tracks, steps) = (2, 2, 19, 40);
    let (filter, n) = (filter(dims, order), 4);
    let mut case = case(n, dims, tracks, steps, 5);
    case.times.iter_mut().for_each(|time| *time -= 1.0);
    let odd = [3, 17];
    for track in odd {
        let cov = &mut case.covs[track * n * n..(track + 1) * n * n];
        cov.copy_from_slice(DMatrix::<f64>::identity(n, n).as_slice());
        (cov[2], cov[2 * n]) = (1.0 - 1e-15, 1.0 - 1e-15);
    }
    let batch = |level| {
        let batch = TrackBatch::new(filter.clone(), 0.0, &case.means, &case.covs).unwrap();
        batch.at_level(level)
    };
    let mut healthy = case.covs.clone();
    for track in odd {
        healthy[track * n * n..(track + 1) * n * n].copy_from_slice(DMatrix::<f64>::identity(n, n).as_slice());
    }
    let mut others = TrackBatch::new(filter.clone(), 0.0, &case.means, &healthy).unwrap();
    let others = others.run(&case.times, &case.values, ALL).unwrap();
    for level in Level::available() {
        for threads in [1, 2] {
            let mut whole = batch(level).with_threads(threads).unwrap();
            let run = whole.run(&case.times, &case.values, ALL).unwrap();
            assert_eq!(
                (0..tracks)
                    .filter(|&track| whole.escalated()[track])
                    .collect::<Vec<_>>(),
                odd
            );
            let mut parts = batch(level).with_threads(threads).unwrap();
            for step in 0..steps {
                let values: Vec<f64> = (0..tracks)
                    .flat_map(|track| case.values[(track * steps + step) * dims..][..dims].to_vec())
                    .collect();
                parts.run(&case.times[step..=step], &values, Wanted::default()).unwrap();
            }
            assert_eq!((parts.means(), parts.covs()), (whole.means(), whole.covs()));
            assert!(whole.failures().iter().all(|&failures| failures == 0));
            for track in 0..tracks {
                let part = |all: &[f64], width: usize| {
                    let part = &all[track * steps * width..(track + 1) * steps * width];
                    part.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
                };
                if odd.contains(&track) {
                    let values: Vec<DVector<f64>> = case.values[track * steps * dims..(track + 1) * steps * dims]
                        .chunks_exact(dims)
                        .map(DVector::from_row_slice)
                        .collect();
                    let state = Gaussian {
                        mean: DVector::from_row_slice(&case.means[track * n..(track + 1) * n]),
                        cov: DMatrix::from_row_slice(n, n, &case.covs[track * n * n..(track + 1) * n * n]),
                    };
                    let initial = InitialState { time: 0.0, state };
                    let one = filter
                        .run(&case.times, &values, Some(&initial), None, History::Filtered)
                        .unwrap();
                    assert_eq!(one.books.events.counts().len(), 1);
                    let bits = |all: &[f64]| all.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                    assert_eq!(part(&run.means, n), bits(one.filtered.means.values()));
                    assert_eq!(part(&run.covs, n * n), bits(one.filtered.covs.values()));
                    assert_eq!(part(&run.nis, 1), bits(&one.nis));
                } else {
                    assert_eq!(part(&run.means, n), part(&others.means, n));
                    assert_eq!(part(&run.covs, n * n), part(&others.covs, n * n));
                }
            }
        }
    }
    let mut strict = TrackBatch::new(filter.with_strict(), 0.0, &case.means, &case.covs).unwrap();
    assert!(strict.run(&case.times, &case.values, ALL).is_err());
    assert_eq!(
        (strict.means(), strict.covs(), strict.time()),
        (case.means.clone(), case.covs.clone(), 0.0)
    );
}
