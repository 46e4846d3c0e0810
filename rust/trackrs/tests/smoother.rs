//! Smoothing against the joint posterior of all states, least squares and the textbook recursion.

use approx::assert_relative_eq;
use nalgebra::{DMatrix, DVector};
use rand_pcg::{Pcg64, rand_core::Rng};
use trackrs::Gaussian;
use trackrs::filter::run::FilterRun;
use trackrs::filter::runner::Runner;
use trackrs::filter::sequence::{Filter, History, InitialState, Sequence};
use trackrs::filter::smoother::{
    Backward, Epoch, FixedLagSmoother, SmoothedRun, fixed_interval, fixed_lag, limited_memory,
};
use trackrs::linalg::symmetric::eigen_range;
use trackrs::model::motion::{ConstantAcceleration, KinematicNoise, LinearMotion};
use trackrs::model::sensor::LinearSensor;
use trackrs::model::{Motion, MotionModel, SensorModel};

/// A uniform number in [-1, 1).
fn uniform(random: &mut Pcg64) -> f64 {
    (random.next_u64() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

fn matrix(rows: usize, columns: usize, random: &mut Pcg64) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| uniform(random))
}

fn spd(n: usize, random: &mut Pcg64) -> DMatrix<f64> {
    let root = matrix(n, n, random);
    &root * root.transpose() + DMatrix::identity(n, n) * 0.2
}

/// A filter and what it is run on; the sensor is z = H x + noise(R).
struct Problem {
    motion: MotionModel,
    h: DMatrix<f64>,
    r: DMatrix<f64>,
    times: Vec<f64>,
    values: Vec<DVector<f64>>,
    initial: InitialState,
}

impl Problem {
    fn new(motion: MotionModel, m: usize, times: Vec<f64>, random: &mut Pcg64) -> Self {
        let n = motion.state_dim();
        let (h, r) = (matrix(m, n, random), spd(m, random));
        let mean = DVector::from_fn(n, |_, _| uniform(random));
        let state = Gaussian {
            mean,
            cov: spd(n, random),
        };
        let mut value = || DVector::from_fn(m, |_, _| 3.0 * uniform(random));
        Self {
            values: times.iter().map(|_| value()).collect(),
            initial: InitialState { time: 0.0, state },
            motion,
            h,
            r,
            times,
        }
    }

    /// Unequal steps, some of length 0, rows without some or all components.
    fn irregular(seed: u64) -> Self {
        let mut random = Pcg64::new(seed.into(), 1);
        let times = vec![0.5, 1.0, 1.0, 1.0, 2.7, 3.0, 4.9, 4.9, 6.0];
        let noise = KinematicNoise::Psd(vec![0.7]);
        let motion = MotionModel::ConstantAcceleration(ConstantAcceleration::new(noise).unwrap());
        let mut problem = Self::new(motion, 2, times, &mut random);
        problem.values[3].fill(f64::NAN);
        problem.values[4][1] = f64::NAN;
        problem.values[8].fill(f64::NAN);
        problem
    }

    fn run(&self) -> FilterRun {
        let sensor = LinearSensor::new(self.h.clone(), self.r.clone(), DVector::zeros(self.h.nrows())).unwrap();
        Filter::kalman(self.motion.clone(), SensorModel::Linear(sensor))
            .unwrap()
            .run(&self.times, &self.values, Some(&self.initial), None, History::Full)
            .unwrap()
    }

    /// F and Q of the step to time k.
    fn step(&self, k: usize) -> (DMatrix<f64>, DMatrix<f64>) {
        let dt = self.times[k] - if k == 0 { self.initial.time } else { self.times[k - 1] };
        (
            self.motion.jacobian(&self.initial.state.mean, dt),
            self.motion.noise(dt),
        )
    }

    /// All T states as one vector of length T n given the data to epoch `last`: the joint prior conditioned on the
    /// stacked measurements. It needs no inverse of Q or of any state covariance.
    fn joint_posterior(&self, last: usize) -> Gaussian {
        let (n, count) = (self.motion.state_dim(), self.times.len());
        let mut mean = DVector::zeros(n * count);
        let mut cov = DMatrix::zeros(n * count, n * count);
        let mut state = self.initial.state.clone();
        for k in 0..count {
            let (f, q) = self.step(k);
            state = Gaussian {
                mean: &f * &state.mean,
                cov: &f * &state.cov * f.transpose() + q,
            };
            mean.rows_mut(k * n, n).copy_from(&state.mean);
            cov.view_mut((k * n, k * n), (n, n)).copy_from(&state.cov);
            if k > 0 {
                let cross = &f * cov.view(((k - 1) * n, 0), (n, k * n));
                cov.view_mut((k * n, 0), (n, k * n)).copy_from(&cross);
                cov.view_mut((0, k * n), (k * n, n)).copy_from(&cross.transpose());
            }
        }
        let m = self.h.nrows();
        let seen: Vec<(usize, usize)> = (0..=last)
            .flat_map(|k| (0..m).map(move |c| (k, c)))
            .filter(|&(k, c)| !self.values[k][c].is_nan())
            .collect();
        let h = DMatrix::from_fn(seen.len(), n * count, |row, column| {
            let (k, c) = seen[row];
            if column / n == k { self.h[(c, column % n)] } else { 0.0 }
        });
        let r = DMatrix::from_fn(seen.len(), seen.len(), |i, j| {
            let ((ki, ci), (kj, cj)) = (seen[i], seen[j]);
            if ki == kj { self.r[(ci, cj)] } else { 0.0 }
        });
        let z = DVector::from_iterator(seen.len(), seen.iter().map(|&(k, c)| self.values[k][c]));
        let s = &h * &cov * h.transpose() + r;
        let gain = &cov * h.transpose() * s.try_inverse().unwrap();
        Gaussian {
            mean: &mean + &gain * (z - &h * &mean),
            cov: &cov - &gain * &h * &cov,
        }
    }
}

#[track_caller]
fn assert_block(found: &DMatrix<f64>, joint: &DMatrix<f64>, i: usize, j: usize) {
    let n = found.nrows();
    let expected = joint.view((i * n, j * n), (n, n)).into_owned();
    assert_relative_eq!(*found, expected, epsilon = 1e-9 * joint.amax());
}

#[track_caller]
fn assert_state(found: &Gaussian, joint: &Gaussian, i: usize) {
    let n = found.dim();
    let expected = joint.mean.rows(i * n, n).into_owned();
    assert_relative_eq!(found.mean, expected, epsilon = 1e-9 * joint.mean.amax());
    assert_block(&found.cov, &joint.cov, i, i);
}

#[test]
fn fixed_interval_is_the_joint_posterior_with_missing_data_and_repeated_times() {
    for seed in 0..20 {
        let problem = Problem::irregular(seed);
        let run = problem.run();
        let smoothed = fixed_interval(&run.epochs().unwrap()).unwrap();
        let joint = problem.joint_posterior(problem.times.len() - 1);
        assert_eq!((smoothed.states.len(), smoothed.lag_one.len()), (9, 8));
        for (i, state) in smoothed.states.iter().enumerate() {
            assert_state(&state, &joint, i);
            assert_eq!(state.cov, state.cov.transpose());
            let gained = run.filtered.at(i).cov - &state.cov;
            assert!(eigen_range(&gained).unwrap().min > -1e-12 * run.filtered.at(i).cov.amax());
        }
        for i in 0..smoothed.lag_one.len() {
            assert_block(&smoothed.lag_one.matrix(i), &joint.cov, i + 1, i);
        }
        assert_eq!(smoothed.states.last(), run.filtered.last());
        // Epochs 1 to 3 are at one time and so are one state.
        assert_eq!(smoothed.states.at(1).cov, smoothed.states.at(3).cov);
        assert_relative_eq!(smoothed.states.at(1).mean, smoothed.states.at(3).mean, epsilon = 1e-13);
    }
}

/// Normal equations of the weighted residuals of prior, motion and measurements, for a problem without zero steps.
#[test]
fn fixed_interval_is_the_least_squares_solution() {
    for seed in 0..10 {
        let mut random = Pcg64::new(seed, 2);
        let (n, m, count) = (3, 2, 7);
        let motion = LinearMotion::new(matrix(n, n, &mut random), spd(n, &mut random)).unwrap();
        let times = (1..=count).map(|k| k as f64).collect();
        let problem = Problem::new(MotionModel::Linear(motion), m, times, &mut random);
        let mut normal = DMatrix::zeros(n * count, n * count);
        let mut right = DVector::zeros(n * count);
        let mut add = |a: DMatrix<f64>, b: DVector<f64>, cov: DMatrix<f64>| {
            let weighted = a.transpose() * cov.try_inverse().unwrap();
            normal += &weighted * a;
            right += weighted * b;
        };
        for k in 0..count {
            let (f, q) = problem.step(k);
            let mut a = DMatrix::zeros(n, n * count);
            a.view_mut((0, k * n), (n, n)).fill_with_identity();
            if k == 0 {
                let cov = &f * &problem.initial.state.cov * f.transpose() + q;
                add(a, f * &problem.initial.state.mean, cov);
            } else {
                a.view_mut((0, (k - 1) * n), (n, n)).copy_from(&-f);
                add(a, DVector::zeros(n), q);
            }
            let mut a = DMatrix::zeros(m, n * count);
            a.view_mut((0, k * n), (m, n)).copy_from(&problem.h);
            add(a, problem.values[k].clone(), problem.r.clone());
        }
        let cov = normal.try_inverse().unwrap();
        let joint = Gaussian {
            mean: &cov * right,
            cov,
        };
        let run = problem.run();
        let smoothed = fixed_interval(&run.epochs().unwrap()).unwrap();
        for (i, state) in smoothed.states.iter().enumerate() {
            assert_state(&state, &joint, i);
        }
        for i in 0..smoothed.lag_one.len() {
            assert_block(&smoothed.lag_one.matrix(i), &joint.cov, i + 1, i);
        }
    }
}

/// (U14) and (U15) as they stand, with an inverse.
fn textbook(epochs: &[Epoch<'_>]) -> Vec<Gaussian> {
    let mut states = vec![epochs[epochs.len() - 1].filtered.to_owned()];
    for pair in epochs.windows(2).rev() {
        let (now, next) = (pair[0].filtered.to_owned(), pair[1].predicted.to_owned());
        let (n, later) = (now.dim(), &states[states.len() - 1]);
        let f = DMatrix::from_row_slice(n, n, pair[1].transition);
        let c = &now.cov * f.transpose() * next.cov.clone().try_inverse().unwrap();
        states.push(Gaussian {
            mean: &now.mean + &c * (&later.mean - &next.mean),
            cov: &now.cov + &c * (&later.cov - &next.cov) * c.transpose(),
        });
    }
    states.reverse();
    states
}

#[test]
fn fixed_interval_is_the_textbook_recursion() {
    let mut random = Pcg64::new(3, 3);
    let motion = LinearMotion::new(matrix(4, 4, &mut random), spd(4, &mut random)).unwrap();
    let times = (1..=50).map(f64::from).collect();
    let problem = Problem::new(MotionModel::Linear(motion), 2, times, &mut random);
    let run = problem.run();
    let epochs = run.epochs().unwrap();
    let smoothed = fixed_interval(&epochs).unwrap();
    for (state, expected) in smoothed.states.iter().zip(textbook(&epochs)) {
        assert_relative_eq!(state.mean, expected.mean, epsilon = 1e-11);
        assert_relative_eq!(state.cov, expected.cov, epsilon = 1e-11);
    }
}

#[test]
fn fixed_lag_is_the_joint_posterior_of_the_data_so_far() {
    for lag in [1, 2, 5, 20] {
        let problem = Problem::irregular(100 + lag as u64);
        let run = problem.run();
        let epochs = run.epochs().unwrap();
        let whole = fixed_lag(&epochs, lag).unwrap();
        assert_eq!((whole.states.len(), whole.lag_one.len()), (9, 8));
        for i in 0..9 {
            let last = (i + lag).min(8);
            let truncated = fixed_interval(&epochs[..=last]).unwrap();
            assert_eq!(whole.states.at(i), truncated.states.at(i));
            let joint = problem.joint_posterior(last);
            assert_state(&whole.states.at(i), &joint, i);
            if i < 8 {
                assert_eq!(whole.lag_one.at(i), truncated.lag_one.at(i));
                assert_block(&whole.lag_one.matrix(i), &joint.cov, i + 1, i);
            }
        }
        if lag == 20 {
            assert_eq!(whole, fixed_interval(&epochs).unwrap());
        }
    }
}

/// Whether `part` is `whole` from epoch `from` on, bit for bit.
fn is_end(part: &SmoothedRun, whole: &SmoothedRun, from: usize) -> bool {
    part.states.iter().eq(whole.states.iter().skip(from)) && part.lag_one.iter().eq(whole.lag_one.iter().skip(from))
}

#[test]
fn fixed_lag_epoch_by_epoch_gives_each_estimate_when_it_is_due() {
    let run = Problem::irregular(7).run();
    let epochs = run.epochs().unwrap();
    let whole = fixed_lag(&epochs, 3).unwrap();
    let mut smoother = FixedLagSmoother::new(3).unwrap();
    assert_eq!(smoother.tail(), SmoothedRun::default());
    for (k, epoch) in epochs.iter().enumerate() {
        let lagged = smoother.push(epoch).unwrap();
        assert_eq!(lagged.is_some(), k >= 3);
        if let Some(lagged) = lagged {
            assert_eq!(
                (lagged.state, lagged.lag_one),
                (whole.states.at(k - 3), whole.lag_one.matrix(k - 3))
            );
        }
        let tail = smoother.tail();
        assert_eq!(tail.states.len(), (k + 1).min(3));
        assert_eq!(tail.states.last(), Some(run.filtered.at(k)));
    }
    assert!(is_end(&smoother.tail(), &whole, 6));
}

#[test]
fn pieces_from_the_end_are_the_whole() {
    let run = Problem::irregular(8).run();
    let epochs = run.epochs().unwrap();
    let whole = fixed_interval(&epochs).unwrap();
    let mut back = Backward::from(epochs[8].filtered);
    back.through(&epochs[4..]).unwrap();
    back.through(&epochs[..=4]).unwrap();
    assert_eq!(whole, back.finish());
    assert_eq!(fixed_interval(&[]).unwrap(), SmoothedRun::default());
    assert_eq!(
        fixed_interval(&epochs[..1]).unwrap().states.last(),
        Some(run.filtered.at(0))
    );
}

#[test]
fn limited_memory_is_the_end_of_the_run() {
    let run = Problem::irregular(9).run();
    let epochs = run.epochs().unwrap();
    let (whole, window) = (fixed_interval(&epochs).unwrap(), limited_memory(&epochs, 3).unwrap());
    assert!(is_end(&window, &whole, 5));
    for more in [8, 50, usize::MAX] {
        assert_eq!(limited_memory(&epochs, more).unwrap(), whole);
    }
}

#[test]
fn a_run_in_two_parts_is_the_whole_run() {
    let problem = Problem::irregular(10);
    let sensor = LinearSensor::new(problem.h.clone(), problem.r.clone(), DVector::zeros(2)).unwrap();
    let filter = Filter::kalman(problem.motion.clone(), SensorModel::Linear(sensor)).unwrap();
    let flat: Vec<f64> = problem.values.iter().flat_map(|row| row.iter().copied()).collect();
    let data = Sequence {
        times: &problem.times,
        measurements: &flat,
        inputs: None,
        leads: None,
        first_row: 0,
    };
    let mut runner = Runner::new(&filter, &problem.initial).unwrap();
    let mut parts = FilterRun::of(&filter);
    runner.advance(&data, 0..5, History::Full, &mut parts).unwrap();
    runner.advance(&data, 5..9, History::Full, &mut parts).unwrap();
    let whole = problem.run();
    // Field by field: the NIS of a missing measurement is NaN, which equals nothing.
    assert_eq!(
        (&parts.filtered, &parts.predicted, &parts.dof),
        (&whole.filtered, &whole.predicted, &whole.dof)
    );
    assert_eq!(parts.log_likelihood, whole.log_likelihood);
    assert_eq!(
        fixed_interval(&parts.epochs().unwrap()),
        fixed_interval(&whole.epochs().unwrap())
    );
}
