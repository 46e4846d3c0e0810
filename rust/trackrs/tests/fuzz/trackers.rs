use std::collections::BTreeMap;

use nalgebra::DVector;
use trackrs::association::associator::Associator;
use trackrs::association::nearest::Nearness;
use trackrs::association::npda::Npda;
use trackrs::gating::mahalanobis::Gate;
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::{PositionSensor, RangeBearing};
use trackrs::model::{MotionModel, SensorModel};
use trackrs::rfs::cphd::CphdUpdate;
use trackrs::rfs::gm_phd::PointUpdate;
use trackrs::rfs::prediction::Birth;
use trackrs::tracker::clutter_map::ClutterMap;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::lifecycle::{Deletion, Existence, Initiator};
use trackrs::tracker::multi_target::MultiTargetTracker;
use trackrs::tracker::phd::PhdTracker;
use trackrs::tracker::phd::config::{AdaptiveBirth, IntensityUpdate, PhdConfig};
use trackrs::{Result, Scan, Track};

use super::Source;
use super::source::finite;

fn models(source: &mut Source<'_>) -> Result<(MotionModel, BTreeMap<String, SensorModel>)> {
    let motion = MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(source.positives(2)))?);
    let radar = RangeBearing::new([source.number(), source.number()], source.positive(), source.positive())?;
    let sensors = BTreeMap::from([
        (
            "lidar".to_string(),
            SensorModel::Position(PositionSensor::new(source.positives(2))?),
        ),
        ("radar".to_string(), SensorModel::RangeBearing(radar)),
    ]);
    Ok((motion, sensors))
}

pub(super) fn config(source: &mut Source<'_>) -> Result<TrackerConfig> {
    let (motion, sensors) = models(source)?;
    let mut config = TrackerConfig::new(motion, sensors, source.positive())?;
    config.associator = match source.below(7) {
        0 => Associator::NearestNeighbour(Nearness::default()),
        1 => Associator::Pda,
        2 => Associator::Jpda {
            coalescence_free: source.coin(),
        },
        3 => Associator::Jipda {
            coalescence_free: source.coin(),
        },
        4 => Associator::Npda(Npda::default()),
        _ => Associator::GlobalNearestNeighbour,
    };
    for sensor in ["lidar", "radar"] {
        config.clutter_density.insert(sensor.into(), source.positive());
        config.detection_probability.insert(sensor.into(), source.share());
    }
    if let Associator::Jipda { .. } = config.associator {
        config.initiator = Initiator::Existence(Existence {
            max_speed: source.positive(),
            initial: 0.3,
            confirm: 0.9,
            drop: 0.05,
            lifetime: source.positive(),
            min_displacement: 0.0,
            min_separation: 0.0,
            pair_within: None,
        });
    } else if let Initiator::MofN(rule) = &mut config.initiator {
        (rule.m, rule.n) = ([1, 2, 3][source.below(3)], 3);
        rule.pair_within = source.coin().then(|| source.positive());
        config.deletion = source.coin().then(|| Deletion {
            max_misses: [1, 2, 3, 4][source.below(4)],
            max_time: None,
        });
    }
    config.clutter_map = (source.below(4) == 0).then_some(ClutterMap {
        radius: 5.0,
        dwell: 1.0,
        min_reports: 2,
        memory: 3.0,
    });
    config.max_gap = source.coin().then(|| source.positive());
    config.max_tracks = 1 + source.below(10);
    Ok(config)
}

pub(super) fn scan(source: &mut Source<'_>, time: f64) -> Scan {
    let sensor = ["lidar", "lidar", "lidar", "radar", "sonar"][source.below(5)];
    let mut values: Vec<DVector<f64>> = Vec::new();
    for _ in 0..source.below(6) {
        let width = source.about(2);
        values.push(source.vector(width));
    }
    let scan = Scan::new(time, sensor, values);
    match source.below(8) {
        0 => scan.from_platform(&[source.number(), source.number()]),
        1 => {
            let times: Vec<f64> = (0..scan.values.len()).map(|_| time - source.share()).collect();
            scan.at_times(&times)
        }
        _ => scan,
    }
}

fn sound(tracks: &[Track]) {
    for track in tracks {
        finite("track", track.state.mean.iter().chain(track.state.cov.iter()));
    }
}

pub(crate) fn multi_target(source: &mut Source<'_>) {
    let Ok(mut tracker) = config(source).and_then(MultiTargetTracker::new) else {
        return;
    };
    let count = 2 + source.below(6);
    for time in source.times(count) {
        let scan = scan(source, time);
        sound(
            &tracker
                .step(&scan)
                .expect("a scan is refused by an event, not by an error"),
        );
        tracker.ledger().check().expect("no row is lost");
    }
}

pub(super) fn intensity_tracker(source: &mut Source<'_>) -> Result<PhdTracker> {
    let (motion, mut sensors) = models(source)?;
    let sensor = sensors.remove(if source.coin() { "lidar" } else { "radar" });
    let mut births = Vec::new();
    for _ in 0..source.below(3) {
        births.push(Birth {
            weight: source.share(),
            state: source.gaussian(4)?,
        });
    }
    let sensor = sensor.unwrap_or(SensorModel::Position(PositionSensor::new(vec![1.0; 2])?));
    let mut config = PhdConfig::new(motion, sensor, births, source.positive(), source.positive());
    let point = PointUpdate {
        gate: Gate::new(source.share())?,
        prune: 1e-5,
    };
    config.update = match source.below(3) {
        0 => IntensityUpdate::Point(point),
        1 => IntensityUpdate::Cardinalised(CphdUpdate {
            point,
            max_targets: source.below(12),
        }),
        _ => config.update,
    };
    config.adaptive_birth = source.coin().then_some(AdaptiveBirth {
        weight: 0.1,
        max_speed: 10.0,
        min_measurements: 1,
    });
    config.reduction.max_components = 1 + source.below(20);
    PhdTracker::new(config)
}

pub(crate) fn intensity(source: &mut Source<'_>) {
    let Ok(mut tracker) = intensity_tracker(source) else {
        return;
    };
    let count = 2 + source.below(3);
    for time in source.times(count) {
        let scan = scan(source, time);
        sound(
            &tracker
                .step(&scan)
                .expect("a scan is refused by an event, not by an error"),
        );
        tracker.ledger().check().expect("no row is lost");
        for component in tracker.mixture() {
            finite("weight", [&component.weight]);
            finite(
                "component",
                component.state.mean.iter().chain(component.state.cov.iter()),
            );
        }
    }
}
