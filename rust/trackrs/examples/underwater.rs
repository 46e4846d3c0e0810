//! A manoeuvring vessel heard by hydrophones: the filter starts itself, finds gross errors and estimates its noise.
//!
//! `cargo run --release --example underwater [RUNS]`: draws RUNS runs (default 20) of the underwater scenario for each of
//! its arrays, clean and with 5 % of the ranges wrong by 10 to 100 m, and prints one table.
#![allow(clippy::print_stdout)]

use std::error::Error;
use std::time::Instant;

use trackrs::Gaussian;
use trackrs::filter::noise::{EigenLimits, LimitedMemoryNoise, NoiseMethod};
use trackrs::filter::run::FilterRun;
use trackrs::filter::screen::{ChiSquareScreen, ScreenMode, Verdict};
use trackrs::filter::sequence::{Filter, History};
use trackrs::filter::smoother::{SmoothedRun, fixed_interval};
use trackrs::gaussian::Gaussians;
use trackrs::model::motion::{ConstantAcceleration, KinematicNoise};
use trackrs::model::sensor::{RangeArray, Side};
use trackrs::model::{MotionModel, SensorModel};
use trackrs::sim::course::Course;
use trackrs::sim::underwater::{Recording, Truth, Underwater, UnderwaterSettings, bats_hydrophones, toss_hydrophones};

const SEED: u64 = 1;
/// Errors count from the thirteenth measurement on.
const SETTLED: usize = 12;

fn main() -> Result<(), Box<dyn Error>> {
    let runs: u64 = std::env::args().nth(1).map_or(Ok(20), |text| text.parse())?;
    println!("array  gross  filtered m  smoothed m  worst m   rejected       found  restarts  ms/run");
    let arrays = [
        ("bats", RangeArray::bats(bats_hydrophones(), 1.0, 0.3, None)?),
        ("toss", RangeArray::toss(toss_hydrophones(), 1.0, None, Side::Above)?),
    ];
    for (name, array) in &arrays {
        for gross in [0.0, 0.05] {
            study(name, array, gross, runs)?;
        }
    }
    Ok(())
}

/// One setting for both arrays; the same as in `examples/underwater.py`.
fn filter(array: &RangeArray) -> trackrs::Result<Filter> {
    let motion = ConstantAcceleration::new(KinematicNoise::Std(vec![0.1; 3]))?;
    let adapt = LimitedMemoryNoise {
        window: 20,
        method: NoiseMethod::Em,
        first_epoch: 10,
        q_limits: EigenLimits { min: 1e-6, max: 1e2 },
        r_limits: EigenLimits { min: 1e-2, max: 1e4 },
        ..LimitedMemoryNoise::default()
    };
    let screen = ChiSquareScreen::new(0.01, ScreenMode::Snoop, None)?;
    Filter::extended(
        MotionModel::ConstantAcceleration(motion),
        SensorModel::RangeArray(array.clone()),
    )?
    .with_screen(screen)
    .with_adaptation(adapt)
}

/// What the runs of one line of the table were like.
#[derive(Default)]
struct Scores {
    filtered: Vec<f64>,
    smoothed: Vec<f64>,
    worst: f64,
    rejected: usize,
    tested: usize,
    found: usize,
    gross: usize,
    restarts: usize,
    seconds: f64,
}

impl Scores {
    fn add(&mut self, run: &FilterRun, smoothed: &SmoothedRun, recording: &Recording) {
        let first = SETTLED.max(run.start);
        let error = |row: usize, state: &Gaussian| (&state.mean - recording.truth.state(row)).rows(0, 3).norm();
        let errors = |states: &Gaussians, offset: usize| -> Vec<f64> {
            let rows = first..run.filtered.len();
            rows.map(|row| error(row, &states.at(row - offset))).collect()
        };
        let filtered = errors(&run.filtered, 0);
        self.worst = filtered.iter().copied().fold(self.worst, f64::max);
        self.filtered.push(rms(&filtered));
        self.smoothed.push(rms(&errors(&smoothed.states, run.start)));
        self.restarts += run.restarts.len();
        for row in run.start + 1..run.filtered.len() {
            for (verdict, &gross) in run.screened[row].verdicts.iter().zip(&recording.gross[row]) {
                let rejected = *verdict == Verdict::Rejected;
                self.tested += usize::from(*verdict != Verdict::Missing);
                self.rejected += usize::from(rejected);
                self.gross += usize::from(gross);
                self.found += usize::from(rejected && gross);
            }
        }
    }
}

fn study(name: &str, array: &RangeArray, gross: f64, runs: u64) -> Result<(), Box<dyn Error>> {
    let scenario = Underwater::new(UnderwaterSettings {
        array: array.clone(),
        course: Course::default(),
        truth: Truth::Course,
        dt: 1.0,
        gross,
        missing: 0.0,
    })?;
    let filter = filter(array)?;
    let mut scores = Scores::default();
    for run in 0..runs {
        let recording = scenario.draw(SEED, run)?;
        let begun = Instant::now();
        let run = filter.run(scenario.times(), &recording.values, None, None, History::Full)?;
        scores.seconds += begun.elapsed().as_secs_f64();
        let smoothed = fixed_interval(&run.epochs()?)?;
        scores.add(&run, &smoothed, &recording);
    }
    let found = if gross > 0.0 {
        format!("{}/{}", scores.found, scores.gross)
    } else {
        "-".into()
    };
    println!(
        "{name:5}  {:4.0}%  {:10.3}  {:10.3}  {:7.1}  {:8.2}%  {found:>10}  {:8}  {:6.1}",
        100.0 * gross,
        median(scores.filtered),
        median(scores.smoothed),
        scores.worst,
        100.0 * scores.rejected as f64 / scores.tested as f64,
        scores.restarts,
        1e3 * scores.seconds / runs as f64,
    );
    Ok(())
}

fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    f64::midpoint(values[(values.len() - 1) / 2], values[values.len() / 2])
}
