//! Recorded radar and lidar scans of a harbour become tracks, scored against GNSS truth.
//!
//! `cargo run --release --example harbour [DATA]`: tracks the five scenarios in `DATA` (default: the repository's
//! `examples/data/autoferry`) with one parameter set and prints one table.
#![allow(clippy::print_stdout)]

use std::collections::{BTreeMap, HashMap};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

use nalgebra::DVector;
use trackrs::metric::evaluate::{Evaluation, Frame, Scoring, TruthPath, evaluate};
use trackrs::model::motion::{ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{MotionModel, SensorModel};
use trackrs::scan::Scan;
use trackrs::tracker::clutter_map::ClutterMap;
use trackrs::tracker::config::TrackerConfig;
use trackrs::tracker::lifecycle::{Deletion, Initiator, MofN};
use trackrs::tracker::multi_target::MultiTargetTracker;

type Rows = Vec<HashMap<String, String>>;

fn main() -> Result<(), Box<dyn Error>> {
    let default = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/data/autoferry"));
    let data = std::env::args().nth(1).map_or(default, PathBuf::from);
    println!("scenario    scans  detections  ids  GOSPA  held  false/min  switches  NEES     ms");
    for name in ["scenario02", "scenario03", "scenario05", "scenario13", "scenario16"] {
        let folder = data.join(name);
        let scans = read_scans(&folder)?;
        let truth = read_truth(&folder)?;
        let mut tracker = MultiTargetTracker::new(config()?)?;
        let start = Instant::now();
        let tracks = tracker.run(&scans)?;
        let milliseconds = 1e3 * start.elapsed().as_secs_f64();
        let frame = |(scan, tracks): (&Scan, &Vec<trackrs::Track>)| Frame {
            time: scan.time,
            tracks: tracks.clone(),
            centre: scan.platform.as_ref().map(|p| DVector::from_row_slice(p)),
        };
        let scored = scans
            .iter()
            .zip(&tracks)
            .filter(|(scan, _)| scan.sensor == "radar" && scan.time >= 15.0);
        let frames: Vec<Frame> = scored.map(frame).collect();
        let scoring = Scoring {
            cutoff: 30.0,
            order: 2.0,
            alpha: 2.0,
            region: Some(250.0),
        };
        let score = evaluate(&truth, &frames, &scoring)?;
        let ids = tracks.iter().flatten().map(|t| t.id).max().unwrap_or(0);
        print_row(name, &scans, ids, &score, milliseconds);
    }
    Ok(())
}

/// One parameter set for all scenarios; the same as in `examples/harbour.toml`.
fn config() -> trackrs::Result<TrackerConfig> {
    let motion = MotionModel::ConstantVelocity(ConstantVelocity::new(KinematicNoise::Psd(vec![0.5; 2]))?);
    let radar = SensorModel::Position(PositionSensor::new(vec![8.0; 2])?);
    let lidar = SensorModel::Position(PositionSensor::new(vec![4.0; 2])?);
    let sensors = BTreeMap::from([("radar".into(), radar), ("lidar".into(), lidar)]);
    let mut config = TrackerConfig::new(motion, sensors, 8.0)?;
    config.initiator = Initiator::MofN(MofN {
        m: 5,
        n: 6,
        max_speed: 8.0,
        min_displacement: 15.0,
        min_separation: 30.0,
        pair_within: None,
    });
    config.deletion = Some(Deletion {
        max_misses: 6,
        max_time: None,
    });
    config.clutter_map = Some(ClutterMap {
        radius: 10.0,
        dwell: 25.0,
        min_reports: 5,
        memory: 60.0,
    });
    Ok(config)
}

fn read(path: &Path) -> Result<Rows, Box<dyn Error>> {
    let mut reader = csv::Reader::from_path(path)?;
    Ok(reader.deserialize().collect::<Result<Rows, _>>()?)
}

fn point(row: &HashMap<String, String>, north: &str, east: &str) -> Result<Vec<f64>, Box<dyn Error>> {
    Ok(vec![row[north].parse()?, row[east].parse()?])
}

/// Scans in the order of their times; the recording has them in the order of their arrival.
fn read_scans(folder: &Path) -> Result<Vec<Scan>, Box<dyn Error>> {
    let mut scans = Vec::new();
    let mut index = HashMap::new();
    for row in read(&folder.join("scans.csv"))? {
        if row["sensor"] != "radar" && row["sensor"] != "lidar" {
            continue;
        }
        let platform = point(&row, "ownship_north_m", "ownship_east_m")?;
        index.insert(row["scan"].clone(), scans.len());
        scans.push(Scan::new(row["t_s"].parse()?, &row["sensor"], Vec::new()).from_platform(&platform));
    }
    for row in read(&folder.join("detections.csv"))? {
        if let Some(&scan) = index.get(&row["scan"]) {
            let scan: &mut Scan = &mut scans[scan];
            scan.values
                .push(DVector::from_vec(point(&row, "rel_north_m", "rel_east_m")?));
        }
    }
    scans.sort_by(|a, b| a.time.total_cmp(&b.time));
    Ok(scans)
}

fn read_truth(folder: &Path) -> Result<Vec<TruthPath>, Box<dyn Error>> {
    let mut points: BTreeMap<String, Vec<(f64, DVector<f64>)>> = BTreeMap::new();
    for row in read(&folder.join("truth.csv"))? {
        let position = DVector::from_vec(point(&row, "north_m", "east_m")?);
        points
            .entry(row["target_id"].clone())
            .or_default()
            .push((row["truth_t_s"].parse()?, position));
    }
    let path = |(id, mut points): (String, Vec<(f64, DVector<f64>)>)| {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points.dedup_by(|a, b| a.0 == b.0);
        let (times, positions) = points.into_iter().unzip();
        Ok(TruthPath::new(id, times, positions)?)
    };
    points.into_iter().map(path).collect()
}

fn print_row(name: &str, scans: &[Scan], ids: u64, score: &Evaluation, milliseconds: f64) {
    let detections: usize = scans.iter().map(|s| s.values.len()).sum();
    println!(
        "{name}  {:5}  {detections:10}  {ids:3}  {:5.2}  {:4.2}  {:9.2}  {:8}  {:4.2}  {milliseconds:5.1}",
        scans.len(),
        score.gospa,
        score.all_held,
        score.false_per_minute,
        score.switches,
        score.nees
    );
}
