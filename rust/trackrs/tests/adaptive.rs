//! Screening and noise estimation against the golden vectors of an independent implementation.

use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector};
use serde_json::Value;
use trackrs::filter::extended::linearise;
use trackrs::filter::noise::{EigenLimits, LimitedMemoryNoise, NoiseMemory, NoiseMethod, ProcessedEpoch};
use trackrs::filter::screen::{ChiSquareScreen, ScreenMode, Verdict};
use trackrs::model::motion::{ConstantAcceleration, KinematicNoise};
use trackrs::model::sensor::residual;
use trackrs::model::{Motion, Sensor};
use trackrs::{Gaussian, Result};

/// Three hydrophones and the target's depth.
#[derive(Debug, Clone)]
struct Bats {
    phones: Vec<DVector<f64>>,
    noise: DMatrix<f64>,
}

impl Sensor for Bats {
    fn measurement_dim(&self) -> usize {
        4
    }
    fn labels(&self) -> Vec<String> {
        vec![String::new(); 4]
    }
    fn check(&self, _motion: &dyn Motion) -> Result<()> {
        Ok(())
    }
    fn observe(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DVector<f64>> {
        let position = state.rows(0, 3);
        let mut h: Vec<f64> = self.phones.iter().map(|phone| (position - phone).norm()).collect();
        h.push(state[2]);
        Ok(DVector::from_vec(h))
    }
    fn jacobian(&self, state: &DVector<f64>, _platform: Option<&DVector<f64>>) -> Result<DMatrix<f64>> {
        let mut a = DMatrix::zeros(4, 9);
        for (i, phone) in self.phones.iter().enumerate() {
            let offset = state.rows(0, 3) - phone;
            a.view_mut((i, 0), (1, 3))
                .copy_from(&(&offset / offset.norm()).transpose());
        }
        a[(3, 2)] = 1.0;
        Ok(a)
    }
    fn noise(&self) -> DMatrix<f64> {
        self.noise.clone()
    }
}

fn golden(name: &str) -> Value {
    let path = format!("{}/../../tests/data/{name}.json", env!("CARGO_MANIFEST_DIR"));
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn vector(value: &Value) -> DVector<f64> {
    DVector::from_vec(value.as_array().unwrap().iter().map(number).collect())
}

fn matrix(value: &Value) -> DMatrix<f64> {
    let rows: Vec<DVector<f64>> = value.as_array().unwrap().iter().map(vector).collect();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn close(ours: &DMatrix<f64>, golden: &Value, what: &str) {
    let golden = matrix(golden);
    let error = (ours - &golden).amax();
    assert!(
        error <= 1e-9 * golden.amax().max(1e-6),
        "{what}: {error:e} of {:e}",
        golden.amax()
    );
}

fn close_vector(ours: &DVector<f64>, golden: &Value, what: &str) {
    let golden = vector(golden);
    assert!(
        (ours - &golden).amax() <= 1e-9 * golden.amax(),
        "{what}: {ours} {golden}"
    );
}

struct Case {
    sensor: Bats,
    start: Gaussian,
    times: Vec<f64>,
    measurements: Vec<DVector<f64>>,
}

/// The recording of `underwater_bats_kf`, from the fourth epoch on, with other measurements where given.
fn case(measurements: Option<&Value>) -> Case {
    let kf = golden("underwater_bats_kf");
    let rows = measurements.unwrap_or(&kf["L"]).as_array().unwrap();
    Case {
        sensor: Bats {
            phones: kf["phones"].as_array().unwrap().iter().map(vector).collect(),
            noise: matrix(&kf["R"]),
        },
        start: Gaussian {
            mean: vector(&kf["init"]["x0"]),
            cov: matrix(&kf["init"]["D0"]),
        },
        times: kf["dt"].as_array().unwrap()[3..].iter().map(number).collect(),
        measurements: rows[3..].iter().map(vector).collect(),
    }
}

/// Γ and F of constant acceleration with a jerk constant over the step.
fn jerk_model(dt: f64) -> (DMatrix<f64>, DMatrix<f64>) {
    let motion = ConstantAcceleration::new(KinematicNoise::Std(vec![1.0; 3])).unwrap();
    let gamma = [dt * dt * dt / 6.0, dt * dt / 2.0, dt];
    let gain = DMatrix::from_fn(9, 3, |i, j| if i % 3 == j { gamma[i / 3] } else { 0.0 });
    (motion.jacobian(&DVector::zeros(9), dt), gain)
}

fn predict(state: &Gaussian, f: &DMatrix<f64>, w: &DMatrix<f64>) -> Gaussian {
    Gaussian {
        mean: f * &state.mean,
        cov: f * &state.cov * f.transpose() + w,
    }
}

#[test]
fn screening_rejects_as_the_reference_does() {
    let reject = golden("underwater_bats_reject");
    let q = matrix(&reject["Q"]);
    let modes = [
        ("vector", ScreenMode::Vector, 0.0),
        ("component", ScreenMode::Component, 0.0),
        ("snoop", ScreenMode::Snoop, 0.0),
        ("snoop_ptest25", ScreenMode::Snoop, 25.0),
    ];
    for (name, mode, allowance) in modes {
        let screen = ChiSquareScreen::new(number(&reject["alpha"]), mode, Some(allowance)).unwrap();
        let case = case(Some(&reject["L"]));
        let mut state = case.start.clone();
        let steps = reject["modes"][name].as_array().unwrap();
        for (k, step) in steps.iter().enumerate() {
            let (f, gain) = jerk_model(case.times[k]);
            let predicted = predict(&state, &f, &(&gain * &q * gain.transpose()));
            let linearised = linearise(&predicted, &case.sensor, None).unwrap();
            let innovation = residual(&case.sensor, &case.measurements[k], &linearised.expected);
            let jacobian = case.sensor.jacobian(&predicted.mean, None).unwrap();
            let screened = screen
                .screen(&innovation, linearised.prediction.cov(), &jacobian, 3, allowance)
                .unwrap();
            let used: Vec<bool> = screened.verdicts.iter().map(|&v| v == Verdict::Used).collect();
            let expected: Vec<bool> = step["use"]
                .as_array()
                .unwrap()
                .iter()
                .map(|v| v.as_bool().unwrap())
                .collect();
            assert_eq!(used, expected, "{name}, step {k}");
            let chi2 = number(&step["chi2"]);
            assert!((screened.statistic - chi2).abs() <= 1e-9 * chi2, "{name}, step {k}");
            state = linearised
                .prediction
                .update(&predicted, &screened.keep_used(&innovation))
                .unwrap()
                .posterior;
            close_vector(&state.mean, &step["xf"], name);
            close(&state.cov, &step["Pf"], name);
        }
    }
}

#[test]
fn estimated_noise_is_that_of_the_reference() {
    for (name, method) in [("em", NoiseMethod::Em), ("map", NoiseMethod::Map)] {
        let reference = golden(&format!("underwater_bats_adaptive_{name}"));
        let limits = |key: &str| {
            let pair = vector(&reference[key]);
            EigenLimits {
                min: pair[0],
                max: pair[1],
            }
        };
        let rule = LimitedMemoryNoise {
            window: usize::try_from(reference["N"].as_u64().unwrap()).unwrap(),
            method,
            first_epoch: usize::try_from(reference["k_min"].as_u64().unwrap()).unwrap(),
            q_limits: limits("q_lim"),
            r_limits: limits("r_lim"),
            ..LimitedMemoryNoise::default()
        };
        let mut case = case(None);
        let (q, r) = (matrix(&reference["Q0"]), matrix(&reference["R0"]));
        let mut memory = NoiseMemory::new(rule, (&case.start).into(), q, r).unwrap();
        let motion = ConstantAcceleration::new(KinematicNoise::Std(vec![1.0; 3])).unwrap();
        let mut state = case.start.clone();
        for (k, step) in reference["steps"].as_array().unwrap().iter().enumerate() {
            let (f, gain) = jerk_model(case.times[k]);
            let noise = &gain * memory.q() * gain.transpose();
            let given = memory.step_noise(&motion, &state.mean, case.times[k]).unwrap();
            assert_relative_eq!(DMatrix::from_row_slice(9, 9, given), noise, max_relative = 1e-14);
            let predicted = predict(&state, &f, &noise);
            case.sensor.noise = memory.r().clone();
            let linearised = linearise(&predicted, &case.sensor, None).unwrap();
            let innovation = residual(&case.sensor, &case.measurements[k], &linearised.expected);
            state = linearised.prediction.update(&predicted, &innovation).unwrap().posterior;
            close_vector(&state.mean, &step["xf"], name);
            let rows = f.transpose();
            let epoch = ProcessedEpoch {
                predicted: (&predicted).into(),
                filtered: (&state).into(),
                transition: rows.as_slice(),
                noise: noise.as_slice(),
                measurement: case.measurements[k].as_slice(),
                platform: None,
            };
            memory.push(&epoch, &case.sensor).unwrap();
            let estimate = memory.estimate();
            close(&estimate.q, &step["Q_hat"], &format!("{name} Q_hat, step {k}"));
            close(&estimate.r, &step["R_hat"], &format!("{name} R_hat, step {k}"));
            close(memory.q(), &step["Q"], &format!("{name} Q, step {k}"));
            close(memory.r(), &step["R"], &format!("{name} R, step {k}"));
        }
    }
}
