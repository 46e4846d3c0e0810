//! What of the noise is estimated: the sums of (U17), (U18) written out, for every form of Q and R.

use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector};
use rand_pcg::{Pcg64, rand_core::Rng};
use trackrs::Gaussian;
use trackrs::filter::adaptation::Adaptation;
use trackrs::filter::noise::{LimitedMemoryNoise, NoiseEstimate, NoiseMethod, QForm, RForm};
use trackrs::filter::runner::Runner;
use trackrs::filter::sequence::{Filter, History, InitialState};
use trackrs::filter::smoother::{Epoch, fixed_interval};
use trackrs::model::motion::{ConstantAcceleration, ConstantVelocity, KinematicNoise};
use trackrs::model::sensor::PositionSensor;
use trackrs::model::{Motion, MotionModel, NoiseInput, SensorModel};

/// Constant velocity whose second axis wanders besides: noise that is not estimated.
#[derive(Debug)]
struct Restless(ConstantVelocity);

impl Motion for Restless {
    fn state_dim(&self) -> usize {
        4
    }
    fn position_dims(&self) -> usize {
        2
    }
    fn labels(&self) -> Vec<String> {
        self.0.labels()
    }
    fn propagate(&self, state: &DVector<f64>, dt: f64) -> DVector<f64> {
        self.0.propagate(state, dt)
    }
    fn jacobian(&self, state: &DVector<f64>, dt: f64) -> DMatrix<f64> {
        self.0.jacobian(state, dt)
    }
    fn noise(&self, dt: f64) -> DMatrix<f64> {
        self.0.noise(dt) + rest(dt)
    }
    fn is_linear(&self) -> bool {
        true
    }
    fn noise_input(&self, dt: f64) -> Option<NoiseInput> {
        let input = self.0.noise_input(dt)?;
        Some(NoiseInput {
            rest: Some(rest(dt)),
            ..input
        })
    }
}

fn rest(dt: f64) -> DMatrix<f64> {
    DMatrix::from_diagonal(&DVector::from_vec(vec![0.0, 0.4 * dt, 0.0, 0.0]))
}

fn acceleration(noise: KinematicNoise) -> MotionModel {
    MotionModel::ConstantAcceleration(ConstantAcceleration::new(noise).unwrap())
}

/// The estimate of a run of twelve epochs inside one window, and the same from the smoothed run by the sums as printed.
struct Both {
    ours: NoiseEstimate,
    written_out: NoiseEstimate,
}

fn both(motion: &MotionModel, times: &[f64], rule: LimitedMemoryNoise) -> Both {
    let mut random = Pcg64::new(7, 7);
    let mut uniform = || (random.next_u64() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0;
    let (n, m) = (motion.state_dim(), 2);
    let mut values: Vec<DVector<f64>> = times
        .iter()
        .map(|_| DVector::from_fn(m, |_, _| 3.0 * uniform()))
        .collect();
    values[4][1] = f64::NAN;
    let root = DMatrix::from_fn(n, n, |_, _| uniform());
    let state = Gaussian {
        mean: DVector::from_fn(n, |_, _| uniform()),
        cov: &root * root.transpose() + DMatrix::identity(n, n),
    };
    let initial = InitialState { time: 0.0, state };
    let sensor = SensorModel::Position(PositionSensor::new(vec![0.7, 0.9]).unwrap());
    // The models' own noise stays in force, so that the run can be smoothed as a whole.
    let rule = LimitedMemoryNoise {
        window: 50,
        first_epoch: 1000,
        ..rule
    };
    let filter = Filter::kalman(motion.clone(), sensor).unwrap();
    let adaptive = filter.clone().with_adaptation(rule).unwrap();
    let mut runner = Runner::new(&adaptive, &initial).unwrap();
    for (&time, value) in times.iter().zip(&values) {
        runner.step(time, value.as_slice(), None).unwrap();
    }
    let run = filter.run(times, &values, Some(&initial), None, History::Full).unwrap();
    let (identity, nothing) = (DMatrix::<f64>::identity(n, n), vec![0.0; n * n]);
    let mut epochs = vec![Epoch {
        step: 0,
        space: run.space,
        filtered: (&initial.state).into(),
        predicted: (&initial.state).into(),
        transition: identity.as_slice(),
        noise: &nothing,
    }];
    epochs.extend(run.epochs().unwrap());
    let smoothed = fixed_interval(&epochs).unwrap();
    let (mut q, mut steps) = (Vec::new(), 0.0);
    let (mut r, mut uses) = (DMatrix::zeros(m, m), DMatrix::<f64>::zeros(m, m));
    let em = rule.method == NoiseMethod::Em;
    for i in 1..epochs.len() {
        let dt = times[i - 1] - if i == 1 { 0.0 } else { times[i - 2] };
        let (before, after) = (smoothed.states.at(i - 1), smoothed.states.at(i));
        let f = DMatrix::from_row_slice(n, n, epochs[i].transition);
        let w = &after.mean - &f * &before.mean;
        let mut sum = &w * w.transpose();
        if em {
            let cross = smoothed.lag_one.matrix(i - 1) * f.transpose();
            sum += &after.cov + &f * &before.cov * f.transpose() - &cross - cross.transpose();
        }
        if dt > 0.0 {
            let (gain, repeat) = match (rule.q_form, motion.noise_input(dt)) {
                (QForm::Input, Some(input)) => (input.gain, input.repeat),
                _ => (DMatrix::identity(n, n), 1),
            };
            let inverse = gain.pseudo_inverse(1e-14).unwrap();
            let seen = &inverse * sum * inverse.transpose();
            let d = seen.nrows() / repeat;
            for block in 0..repeat {
                q.push(seen.view((block * d, block * d), (d, d)) / repeat as f64);
            }
            steps += 1.0;
        }
        let e = &values[i - 1] - after.mean.rows(0, m);
        let spread = after.cov.view((0, 0), (m, m)) * if em { 1.0 } else { 0.0 };
        for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            if !(e[a] * e[b]).is_nan() {
                r[(a, b)] += e[a] * e[b] + spread[(a, b)];
                uses[(a, b)] += 1.0;
            }
        }
    }
    let sum = q[1..].iter().fold(q[0].clone(), |sum, q| sum + q);
    Both {
        ours: match runner.memory() {
            Some(Adaptation::LimitedMemory(memory)) => memory.estimate(),
            other => panic!("{other:?}"),
        },
        written_out: NoiseEstimate {
            q: sum / steps,
            r: r.component_div(&uses),
        },
    }
}

const IRREGULAR: [f64; 12] = [0.5, 1.0, 1.0, 2.3, 3.0, 3.1, 4.9, 4.9, 6.0, 7.5, 7.6, 9.0];

#[test]
fn the_estimates_are_the_sums_of_the_smoothed_states() {
    for method in [NoiseMethod::Em, NoiseMethod::Map] {
        let input = LimitedMemoryNoise {
            method,
            ..LimitedMemoryNoise::default()
        };
        let full = LimitedMemoryNoise {
            q_form: QForm::Full,
            ..input
        };
        let equal: Vec<f64> = (1..=12).map(f64::from).collect();
        let psd = || acceleration(KinematicNoise::Psd(vec![0.5, 0.8]));
        let cases = [
            both(&psd(), &IRREGULAR, input),
            both(&acceleration(KinematicNoise::Std(vec![0.5, 0.8])), &IRREGULAR, input),
            both(&psd(), &equal, full),
        ];
        for Both { ours, written_out } in cases {
            assert_relative_eq!(ours.q, written_out.q, epsilon = 1e-9 * written_out.q.amax());
            assert_relative_eq!(ours.r, written_out.r, epsilon = 1e-9 * written_out.r.amax());
        }
    }
}

/// With noise of its own the second axis shows more than what is estimated: EM must not lay it to the input's account.
#[test]
fn noise_that_is_not_estimated_is_in_the_prediction_and_not_in_the_estimate() {
    let velocity = ConstantVelocity::new(KinematicNoise::Std(vec![0.3, 0.3])).unwrap();
    let restless = || MotionModel::Custom(std::sync::Arc::new(Restless(velocity.clone())));
    let filter = Filter::kalman(
        restless(),
        SensorModel::Position(PositionSensor::new(vec![0.2, 0.2]).unwrap()),
    );
    let filter = filter.unwrap().with_adaptation(LimitedMemoryNoise {
        window: 400,
        ..LimitedMemoryNoise::default()
    });
    let filter = filter.unwrap();
    let mut random = Pcg64::new(1, 9);
    let mut normal = || {
        let twelve = (0..12).map(|_| (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
        twelve.sum::<f64>() - 6.0
    };
    let initial = InitialState {
        time: 0.0,
        state: Gaussian {
            mean: DVector::zeros(4),
            cov: DMatrix::identity(4, 4),
        },
    };
    let mut state = initial.state.mean.clone();
    let mut runner = Runner::new(&filter, &initial).unwrap();
    let (mut mean, mut count) = (DMatrix::zeros(2, 2), 0.0);
    for k in 1..=4000 {
        let push = DVector::from_fn(2, |_, _| 0.3 * normal());
        state = velocity.propagate(&state, 1.0) + velocity.noise_input(1.0).unwrap().gain * push;
        state[1] += 0.4_f64.sqrt() * normal();
        let seen = [state[0] + 0.2 * normal(), state[1] + 0.2 * normal()];
        runner.step(f64::from(k), &seen, None).unwrap();
        if k > 1000 {
            mean += runner.memory().unwrap().q();
            count += 1.0;
        }
    }
    mean /= count;
    assert_relative_eq!(mean[(0, 0)], 0.09, max_relative = 0.15);
    assert_relative_eq!(mean[(1, 1)], 0.09, max_relative = 0.25);
}

#[test]
fn noise_of_a_spectral_density_enters_through_the_factor() {
    for noise in [KinematicNoise::Psd(vec![0.7, 2.0]), KinematicNoise::Std(vec![0.7, 2.0])] {
        let motion = acceleration(noise);
        for dt in [1e-3, 0.4, 7.0] {
            let input = motion.noise_input(dt).unwrap();
            let cov = DMatrix::<f64>::identity(input.repeat, input.repeat).kronecker(&input.cov);
            let made = &input.gain * cov * input.gain.transpose();
            assert_relative_eq!(made, motion.noise(dt), max_relative = 1e-13);
        }
    }
}

#[test]
fn a_full_q_refuses_steps_that_differ_and_a_full_r_waits_for_enough_epochs() {
    let rule = LimitedMemoryNoise {
        first_epoch: 1,
        q_form: QForm::Full,
        r_form: RForm::Full,
        ..LimitedMemoryNoise::default()
    };
    let sensor = SensorModel::Position(PositionSensor::new(vec![1.0, 1.0]).unwrap());
    let filter = Filter::kalman(acceleration(KinematicNoise::Psd(vec![0.5, 0.8])), sensor).unwrap();
    let filter = filter.with_adaptation(rule).unwrap();
    let initial = InitialState {
        time: 0.0,
        state: Gaussian {
            mean: DVector::zeros(6),
            cov: DMatrix::identity(6, 6),
        },
    };
    let mut runner = Runner::new(&filter, &initial).unwrap();
    runner.step(0.1, &[0.3, f64::NAN], None).unwrap();
    runner.step(0.2, &[0.3, -0.1], None).unwrap();
    assert_eq!(*runner.memory().unwrap().r(), DMatrix::identity(2, 2));
    // Only rounding: 0.1 + 0.2 is not 0.3.
    runner.step(0.3, &[0.1, 0.4], None).unwrap();
    assert!(runner.memory().unwrap().r()[(0, 1)] != 0.0);
    let error = runner.step(0.45, &[0.1, 0.4], None).unwrap_err().to_string();
    assert!(error.contains("equal time steps"), "{error}");
}
