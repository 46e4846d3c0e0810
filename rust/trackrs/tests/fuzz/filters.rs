use nalgebra::{DMatrix, DVector};
use trackrs::filter::batch::{TrackBatch, Wanted};
use trackrs::filter::fusion::{Criterion, covariance_intersection};
use trackrs::filter::lead::Lead;
use trackrs::filter::mixture::{Hypothesis, moment_match};
use trackrs::filter::nis_noise::NisScaledNoise;
use trackrs::filter::noise::{EigenLimits, LimitedMemoryNoise};
use trackrs::filter::paper_start::paper_start;
use trackrs::filter::screen::{ChiSquareScreen, ScreenMode};
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::sigma_points::SigmaPoints;
use trackrs::filter::smoother::{fixed_interval, fixed_lag, limited_memory};
use trackrs::filter::square_root::Form;
use trackrs::filter::start::{TimedFix, start_state};
use trackrs::model::motion::{
    ConstantAcceleration, ConstantVelocity, KinematicNoise, LinearMotion, RandomWalk, Singer,
};
use trackrs::model::sensor::{
    LinearSensor, PositionSensor, RangeArray, RangeArraySettings, RangeBearing, Side, SoundSpeed,
};
use trackrs::model::{Motion, MotionModel, Sensor, SensorModel, StateSpace};
use trackrs::{Error, Gaussian, Result};

use super::Source;
use super::source::finite;

pub(super) fn motion(source: &mut Source<'_>, dims: usize) -> Result<MotionModel> {
    let values = source.positives(dims);
    let noise = if source.coin() {
        KinematicNoise::Psd(values)
    } else {
        KinematicNoise::Std(values)
    };
    Ok(match source.below(5) {
        0 => MotionModel::RandomWalk(RandomWalk::new(noise)?),
        1 => MotionModel::ConstantAcceleration(ConstantAcceleration::new(noise)?),
        2 => {
            let (std, tau, psd) = (source.positives(dims), source.positives(dims), source.positives(dims));
            MotionModel::Singer(Singer::new(std, tau, psd)?)
        }
        3 => {
            let n = dims + source.below(3);
            MotionModel::Linear(LinearMotion::new(source.matrix(n, n), source.covariance(n))?)
        }
        _ => MotionModel::ConstantVelocity(ConstantVelocity::new(noise)?),
    })
}

fn sensor(source: &mut Source<'_>, n: usize, dims: usize) -> Result<SensorModel> {
    Ok(match source.below(4) {
        0 if dims == 2 => {
            let place = [source.number(), source.number()];
            SensorModel::RangeBearing(RangeBearing::new(place, source.positive(), source.positive())?)
        }
        1 => {
            let m = 1 + source.below(3);
            let matrix = source.matrix(m, n);
            SensorModel::Linear(LinearSensor::new(matrix, source.covariance(m), source.vector(m))?)
        }
        _ => SensorModel::Position(PositionSensor::new(source.positives(dims))?),
    })
}

fn filter(source: &mut Source<'_>) -> Result<Filter> {
    let dims = 1 + source.below(3);
    let motion = motion(source, dims)?;
    let sensor = sensor(source, motion.state_dim(), dims)?;
    let made = match source.below(5) {
        0 => Filter::kalman(motion, sensor)?,
        1 => Filter::sigma_points(motion, sensor, SigmaPoints::cubature())?,
        2 => {
            let points = SigmaPoints::scaled(source.positive(), source.number(), source.number())?;
            Filter::sigma_points(motion, sensor, points)?
        }
        3 => Filter::extended(motion, sensor)?.with_iterations(1 + source.below(3))?,
        _ => Filter::extended(motion, sensor)?,
    };
    let made = if source.below(4) == 0 {
        made.with_form(Form::SquareRoot)?
    } else {
        made
    };
    let made = if source.below(4) == 0 {
        made.with_steps(1 + source.below(3))?
    } else {
        made
    };
    Ok(if source.below(4) == 0 {
        let mode = [ScreenMode::Vector, ScreenMode::Component, ScreenMode::Snoop][source.below(3)];
        made.with_screen(ChiSquareScreen::new(source.share(), mode, None)?)
    } else {
        made
    })
}

fn run(source: &mut Source<'_>, filter: &Filter) -> Result<()> {
    let (n, m) = (filter.motion().state_dim(), filter.sensor().measurement_dim());
    let count = source.below(7);
    let times = source.times(count);
    let values: Vec<DVector<f64>> = (0..count)
        .map(|_| {
            let width = source.about(m);
            source.vector(width)
        })
        .collect();
    let initial = (source.below(8) > 0)
        .then(|| -> Result<InitialState> {
            Ok(InitialState {
                time: 0.0,
                state: source.gaussian(n)?,
            })
        })
        .transpose()?;
    let history = [History::Full, History::Full, History::Filtered, History::Last][source.below(4)];
    let inputs: Option<Vec<_>> = (source.below(8) == 0).then(|| (0..count).map(|_| source.vector(n)).collect());
    let lead = (source.below(8) == 0).then(|| Lead::Seconds(source.positive()));
    let out = filter.run_ahead(
        &times,
        &values,
        initial.as_ref(),
        inputs.as_deref(),
        lead.as_ref(),
        history,
    )?;
    // Rows before the start are NaN and said to be.
    for row in out.start.min(out.filtered.len())..out.filtered.len() {
        let state = out.filtered.view(row);
        finite("estimate", state.mean.iter().chain(state.cov));
        for i in 0..n {
            for j in 0..i {
                assert_eq!(
                    state.cov[i * n + j].to_bits(),
                    state.cov[j * n + i].to_bits(),
                    "symmetric"
                );
            }
        }
    }
    for row in 0..out.leads.len() {
        if row >= out.start {
            finite("lead", out.leads.view(row).mean);
        }
    }
    if history == History::Full {
        let epochs = out.epochs()?;
        let smoothed = match source.below(3) {
            0 => fixed_interval(&epochs),
            1 => fixed_lag(&epochs, 1 + source.below(3)),
            _ => limited_memory(&epochs, 1 + source.below(3)),
        };
        if let Ok(smoothed) = smoothed {
            for row in 0..smoothed.states.len() {
                let state = smoothed.states.view(row);
                finite("smoothed", state.mean.iter().chain(state.cov));
            }
        }
    }
    Ok(())
}

pub(crate) fn run_and_smooth(source: &mut Source<'_>) {
    drop(filter(source).and_then(|filter| run(source, &filter)));
}

pub(crate) fn adaptive_run(source: &mut Source<'_>) {
    let mut made = || -> Result<()> {
        let dims = 1 + source.below(2);
        let motion = motion(source, dims)?;
        let sensor = sensor(source, motion.state_dim(), dims)?;
        let filter = Filter::extended(motion, sensor)?;
        let limits = EigenLimits {
            min: source.positive(),
            max: source.positive() * 1e6,
        };
        let filter = if source.coin() {
            filter.with_adaptation(LimitedMemoryNoise {
                window: source.below(5),
                first_epoch: source.below(3),
                q_limits: limits,
                r_limits: limits,
                ..LimitedMemoryNoise::default()
            })?
        } else {
            filter.with_adaptation(NisScaledNoise {
                psd_limits: [limits.min, limits.max],
                eta: source.share(),
                cap: 1.0 + source.positive(),
            })?
        };
        run(source, &filter)
    };
    drop(made());
}

pub(crate) fn one_step(source: &mut Source<'_>) {
    let Ok(filter) = filter(source) else { return };
    let (n, m) = (
        source.about(filter.motion().state_dim()),
        source.about(filter.sensor().measurement_dim()),
    );
    let Ok(state) = source.gaussian(n) else { return };
    let dt = source.positive();
    if let Ok(ahead) = filter.predict(&state, dt, None) {
        finite("prediction", ahead.mean.iter().chain(ahead.cov.iter()));
    }
    let platform = (source.below(8) == 0).then(|| source.vector(2));
    if let Ok(update) = filter.update(&state, &source.vector(m), platform.as_ref()) {
        finite(
            "posterior",
            update.posterior.mean.iter().chain(update.posterior.cov.iter()),
        );
    }
}

pub(crate) fn batch(source: &mut Source<'_>) {
    let Ok(filter) = filter(source) else { return };
    let (n, m, tracks) = (
        filter.motion().state_dim(),
        filter.sensor().measurement_dim(),
        source.below(10),
    );
    let means = source.numbers(tracks * n);
    let covs = source.covariance(n);
    let Ok(mut batch) = TrackBatch::new(filter, 0.0, &means, covs.as_slice()) else {
        return;
    };
    let count = source.below(3);
    let times = source.times(count);
    let size = source.about(tracks * count * m);
    let values = source.numbers(size);
    let wanted = Wanted {
        means: true,
        covs: true,
        nis: true,
    };
    if let Ok(out) = batch.run(&times, &values, wanted) {
        finite("batch", out.means.iter().chain(&out.covs));
    }
}

/// Ranges of hydrophones, by which a run starts itself.
pub(crate) fn ranges(source: &mut Source<'_>) {
    let mut made = || -> Result<()> {
        let dims = 2 + source.below(2);
        let count = 1 + source.below(5);
        let settings = RangeArraySettings {
            hydrophones: source.matrix(count, dims),
            range_std: vec![source.positive()],
            survey_std: Vec::new(),
            depth_std: source.coin().then(|| source.positive()),
            sound_speed: source.coin().then(|| SoundSpeed::Uniform(source.positive())),
            side: source.coin().then_some(Side::Above),
        };
        let sensor = SensorModel::RangeArray(RangeArray::new(settings)?);
        let motion = ConstantVelocity::new(KinematicNoise::Psd(source.positives(dims)))?;
        let filter = Filter::extended(MotionModel::ConstantVelocity(motion), sensor)?;
        let filter = if source.coin() {
            filter.with_second_order()?
        } else {
            filter
        };
        run(source, &filter)
    };
    drop(made());
}

pub(crate) fn fusion(source: &mut Source<'_>) {
    let n = 1 + source.below(4);
    let estimates: Vec<Gaussian> = (0..source.below(4)).filter_map(|_| source.gaussian(n).ok()).collect();
    let weights = (source.below(4) == 0).then(|| source.vector(estimates.len()));
    let criterion = if source.coin() {
        Criterion::Trace
    } else {
        Criterion::Determinant
    };
    if let Ok(fused) = covariance_intersection(&estimates, weights.as_ref(), criterion) {
        assert!(
            fused.state.mean.iter().all(|v| v.is_finite()),
            "{estimates:?} {fused:?}"
        );
        finite("fused", fused.state.mean.iter().chain(fused.state.cov.iter()));
    }
}

pub(crate) fn mixture_moments(source: &mut Source<'_>) {
    let n = 1 + source.below(4);
    let mut hypotheses = Vec::new();
    for _ in 0..source.below(4) {
        let weight = source.share();
        if let (Ok(state), true) = (source.gaussian(n), weight.is_finite()) {
            hypotheses.push(Hypothesis { weight, state });
        }
    }
    drop(moment_match(&StateSpace::euclidean(n), &hypotheses));
}

pub(crate) fn starts(source: &mut Source<'_>) {
    let dims = 1 + source.below(3);
    let times = source.times(3);
    let fixes: Vec<TimedFix> = times
        .iter()
        .filter_map(|&time| {
            let position = source.gaussian(dims).ok()?;
            Some(TimedFix { time, position })
        })
        .collect();
    let found = [
        start_state(&fixes, source.below(5), None),
        paper_start(&fixes, source.positive(), source.positive()),
    ];
    for start in found.iter().flatten() {
        finite("start", start.state.mean.iter().chain(start.state.cov.iter()));
    }
}

pub(crate) fn screen(source: &mut Source<'_>) {
    let (m, n) = (source.below(5), 1 + source.below(4));
    let mode = [ScreenMode::Vector, ScreenMode::Component, ScreenMode::Snoop][source.below(3)];
    let Ok(screen) = ChiSquareScreen::new(source.share(), mode, None) else {
        return;
    };
    let innovation: DVector<f64> = source.vector(m);
    let cov: DMatrix<f64> = source.covariance(m);
    let jacobian = source.matrix(m, n);
    let found: std::result::Result<_, Error> = screen.screen(&innovation, &cov, &jacobian, 2, source.positive());
    if let Ok(found) = found {
        assert_eq!(found.verdicts.len(), m);
        assert!(found.p_value.is_nan() || (0.0..=1.0).contains(&found.p_value));
    }
}
