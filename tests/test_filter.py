"""Kalman and extended Kalman filters against independent results."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr

DATA = Path(__file__).parent / "data"


def textbook(F, Q, H, R, x, P, z):
    """One step of the Kalman filter as the textbook has it, with the inverse written out."""
    x, P = F @ x, F @ P @ F.T + Q
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return x + K @ (z - H @ x), (np.eye(len(x)) - K @ H) @ P


def test_nile_local_level_equals_statsmodels():
    """The filter with known initialisation of `tests/data/golden_nile`, made with statsmodels 0.15.0."""
    folder = DATA / "golden_nile"
    volume = [float(row["volume"]) for row in csv.DictReader((folder / "nile.csv").read_text().splitlines())]
    expected = list(csv.DictReader((folder / "local_level_known_init.csv").read_text().splitlines()))
    reference = json.loads((folder / "reference.json").read_text())
    level = tr.RandomWalk(dims=1, velocity_psd=reference["sigma2_eta"])
    kf = tr.KalmanFilter(level, tr.PositionSensor(dims=1, std=reference["sigma2_eps"] ** 0.5))
    years = np.arange(1871.0, 1971.0)
    known = reference["known_init"]
    start = tr.GaussianState([known["a0"]], [[known["P0"]]], time=1871.0)
    run = kf.run(years, np.array(volume)[:, None], initial=start)
    np.testing.assert_allclose(run.means[:, 0], [float(r["filtered_level"]) for r in expected], rtol=1e-9)
    np.testing.assert_allclose(run.covs[:, 0, 0], [float(r["filtered_var"]) for r in expected], rtol=1e-9)
    # statsmodels leaves the first observation, which mostly measures the prior, out of the sum.
    first = kf.update(start, volume[:1]).log_likelihood
    assert run.log_likelihood - first == pytest.approx(known["loglike"], rel=1e-9)


def test_robot_equals_matlab():
    """Five states, two measurements, known inputs: `tests/data/golden_pykalman_robot`, made with a MATLAB program."""
    robot = np.load(DATA / "golden_pykalman_robot" / "robot.npz")
    steps = robot["y"].shape[1]
    motion = tr.LinearMotion(robot["A"], robot["Q"])
    sensor = tr.LinearSensor(robot["C"], robot["R"], offset=robot["d"].ravel())
    start = tr.GaussianState(robot["x0"].ravel(), robot["V_0"], time=0.0)
    times = np.arange(1.0, steps + 1)
    run = tr.KalmanFilter(motion, sensor).run(times, robot["y"].T, initial=start, inputs=robot["b"].T)
    np.testing.assert_allclose(run.means, robot["xfilt"].T[1:], rtol=1e-9, atol=1e-9 * np.abs(robot["xfilt"]).max())
    expected = robot["Vfilt"][1:]
    np.testing.assert_allclose(run.covs, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(20))
def test_run_equals_the_textbook(seed):
    rng = np.random.default_rng(seed)
    dims = int(rng.integers(1, 4))
    motion = tr.ConstantAcceleration(dims=dims, jerk_psd=0.3)
    sensor = tr.PositionSensor(dims=dims, std=2.0)
    n, steps = 3 * dims, 40
    times = np.cumsum(rng.uniform(0.1, 2.0, steps))
    values = rng.normal(0.0, 50.0, (steps, dims))
    x, P = rng.normal(size=n), np.diag(rng.uniform(1.0, 100.0, n))
    run = tr.KalmanFilter(motion, sensor).run(times, values, initial=tr.GaussianState(x, P))
    H = np.eye(dims, n)
    before = 0.0
    for k, time in enumerate(times):
        dt = time - before
        x, P = textbook(motion.transition(dt), motion.noise(dt), H, sensor.noise(), x, P, values[k])
        before = time
        np.testing.assert_allclose(run.means[k], x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(run.covs[k], P, rtol=1e-8, atol=1e-9)
        assert np.array_equal(run.covs[k], run.covs[k].T)


def test_missing_components_equal_a_smaller_sensor():
    both = tr.KalmanFilter(tr.RandomWalk(dims=2, velocity_psd=1.0), tr.PositionSensor(dims=2, std=[1.0, 3.0]))
    state = tr.GaussianState([1.0, 2.0], [[4.0, 1.0], [1.0, 5.0]])
    update = both.update(state, [np.nan, 7.0])
    H, R = np.array([[0.0, 1.0]]), np.array([[9.0]])
    x, P = textbook(np.eye(2), np.zeros((2, 2)), H, R, state.mean, state.cov, np.array([7.0]))
    np.testing.assert_allclose(update.posterior.mean, x)
    np.testing.assert_allclose(update.posterior.cov, P)
    assert update.dof == 1
    assert np.isnan(update.innovation[0])
    assert np.isnan(update.whitened[0])
    nothing = both.update(state, [np.nan, np.nan])
    assert np.array_equal(nothing.posterior.cov, state.cov)
    assert nothing.dof == 0


def test_several_measurements_at_one_time_equal_a_stacked_one():
    motion, sensor = tr.ConstantVelocity(dims=1, accel_psd=1.0), tr.PositionSensor(dims=1, std=1.0)
    state = tr.GaussianState([0.0, 1.0], [[4.0, 1.0], [1.0, 2.0]])
    run = tr.KalmanFilter(motion, sensor).run([1.0, 1.0], [[1.2], [0.7]], initial=state)
    stacked = tr.LinearSensor([[1.0, 0.0], [1.0, 0.0]], np.eye(2))
    once = tr.KalmanFilter(motion, stacked).run([1.0], [[1.2, 0.7]], initial=state)
    np.testing.assert_allclose(run.means[-1], once.means[-1], rtol=1e-12)
    np.testing.assert_allclose(run.covs[-1], once.covs[-1], rtol=1e-12)


def test_bearing_innovation_wraps():
    ekf = tr.ExtendedKalmanFilter(
        tr.ConstantVelocity(dims=2, accel_psd=1.0), tr.RangeBearing((0.0, 0.0), range_std=1.0, bearing_std=0.01)
    )
    state = tr.GaussianState([-100.0, 0.5, 0.0, 0.0], np.diag([4.0, 4.0, 1.0, 1.0]))
    update = ekf.update(state, [100.0, -np.pi + 0.005])
    assert abs(update.innovation[1]) < 0.02
    assert update.posterior.mean[1] < 0.5


def test_turning_the_scene_turns_the_result():
    """Fault 8: with angles on a circle the error does not depend on the direction of north."""
    rng = np.random.default_rng(5)
    times = np.arange(1.0, 30.0)
    path = np.stack([300.0 + 5.0 * times, 200.0 - 8.0 * times], axis=1)
    noise = rng.normal(size=(len(times), 2)) * [5.0, 0.01]
    ekf = tr.ExtendedKalmanFilter(
        tr.ConstantVelocity(dims=2, accel_psd=0.1), tr.RangeBearing((0.0, 0.0), range_std=5.0, bearing_std=0.01)
    )
    spread = []
    for turn in np.linspace(0.0, 2 * np.pi, 200):
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        turned = path @ R.T
        polar = np.stack([np.hypot(*turned.T), np.arctan2(turned[:, 1], turned[:, 0])], axis=1) + noise
        start = tr.GaussianState([*(R @ path[0]), *(R @ [5.0, -8.0])], np.diag([25.0, 25.0, 9.0, 9.0]), 1.0)
        run = ekf.run(times, polar, initial=start)
        spread.append(tr.rmse(run.means[:, :2] - turned))
    assert np.ptp(spread) <= 1e-9


def test_history_keeps_what_it_says_and_chunks_do_not_show():
    rng = np.random.default_rng(0)
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_psd=1.0), tr.PositionSensor(dims=1, std=1.0))
    start = tr.GaussianState([0.0, 0.0], np.eye(2))
    times, values = np.arange(10_000.0), rng.normal(size=(10_000, 1))
    full = kf.run(times, values, initial=start)
    last = kf.run(times, values, initial=start, history="last")
    halves = kf.run(times[:5000], values[:5000], initial=start, history="last")
    rest = kf.run(times[5000:], values[5000:], initial=halves[-1], history="filtered")
    assert full.predicted_means.shape == (10_000, 2)
    assert rest.predicted_means.shape == (0, 2)
    assert len(last) == 1
    assert np.array_equal(last.means[0], full.means[-1])
    assert np.array_equal(rest.means, full.means[5000:])
    assert last.log_likelihood == pytest.approx(full.log_likelihood, rel=1e-12)


def test_consistency_on_the_models_own_truth():
    """NIS and NEES lie in the 99.9 % band of their chi-square averages."""
    rng = np.random.default_rng(11)
    motion, sensor = tr.ConstantVelocity(dims=2, accel_psd=0.5), tr.PositionSensor(dims=2, std=3.0)
    kf, runs, steps = tr.KalmanFilter(motion, sensor), 50, 40
    F, Q = motion.transition(1.0), motion.noise(1.0)
    P0 = np.diag([100.0, 100.0, 25.0, 25.0])
    errors, covs, nis, dof = [], [], 0.0, 0
    for _ in range(runs):
        x = rng.multivariate_normal(np.zeros(4), P0)
        truth, values = [], []
        for _ in range(steps):
            x = rng.multivariate_normal(F @ x, Q)
            truth.append(x)
            values.append(x[:2] + rng.normal(0.0, 3.0, 2))
        run = kf.run(np.arange(1.0, steps + 1), values, initial=tr.GaussianState(np.zeros(4), P0))
        nis, dof = nis + run.nis.sum(), dof + int(run.dof.sum())
        errors.append(truth[-1] - run.means[-1])
        covs.append(run.covs[-1])
    low, high = (tr.Gate(p).threshold(dof) / dof for p in (0.0005, 0.9995))
    assert low < nis / dof < high
    low, high = (tr.Gate(p).threshold(4 * runs) / runs for p in (0.0005, 0.9995))
    assert low < tr.nees(errors, covs).statistics.mean() < high


def test_mistakes_are_named():
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_psd=0.1), tr.PositionSensor(dims=1, std=1.0))
    start = tr.GaussianState([0.0, 0.0], np.eye(2))
    with pytest.raises(tr.ParameterError, match=r"pass initial=GaussianState"):
        tr.KalmanFilter(kf.motion, tr.LinearSensor([[1.0, 0.0]], [[1.0]])).run([0.0], [[1.0]])
    with pytest.raises(tr.UnobservableError, match="no 3 consecutive"):
        kf.run([0.0], [[1.0]])
    with pytest.raises(tr.TimeError, match="1 s is before 2 s"):
        kf.run([2.0, 1.0], [[1.0], [1.0]], initial=start)
    with pytest.raises(tr.TimeError):
        kf.run([-1.0], [[1.0]], initial=start)
    with pytest.raises(tr.NonFiniteError, match="times is not finite at index 1"):
        kf.run([0.0, np.nan], [[1.0], [1.0]], initial=start)
    with pytest.raises(tr.NonFiniteError, match="measurement"):
        kf.update(start, [np.inf])
    with pytest.raises(tr.DimensionError, match="size 2, expected 1"):
        kf.update(start, [1.0, 2.0])
    with pytest.raises(tr.DimensionError, match="values must have 2 dimensions"):
        kf.run([0.0], [1.0], initial=start)
    with pytest.raises(tr.ParameterError, match="accel_std = -1"):
        tr.ConstantVelocity(dims=2, accel_std=-1.0)
    with pytest.raises(tr.ParameterError, match="exactly one of jerk_psd"):
        tr.ConstantAcceleration(dims=2)
    with pytest.raises(tr.ParameterError, match="must be linear"):
        tr.KalmanFilter(tr.ConstantVelocity(2, accel_std=1.0), tr.RangeBearing((0, 0), 1.0, 1.0))
    with pytest.raises(tr.DimensionError, match="position"):
        tr.ExtendedKalmanFilter(tr.ConstantVelocity(3, accel_std=1.0), tr.RangeBearing((0, 0), 1.0, 1.0))
    with pytest.raises(tr.ParameterError, match="symmetric"):
        kf.update(tr.GaussianState([0.0, 0.0], [[1.0, 0.5], [0.0, 1.0]]), [1.0])
    with pytest.raises(tr.UnobservableError, match="on the sensor"):
        tr.RangeBearing((3.0, 4.0), 1.0, 0.1).observe([3.0, 4.0])
    singular = tr.KalmanFilter(tr.RandomWalk(1, velocity_psd=1.0), tr.LinearSensor([[1.0], [1.0]], np.zeros((2, 2))))
    with pytest.raises(tr.NotPositiveDefiniteError, match=r"innovation covariance.*pivot 1"):
        singular.update(tr.GaussianState([0.0], [[1.0]]), [0.0, 0.0])


def test_results_are_read_only_and_inputs_untouched():
    mean, cov = np.zeros(2), np.eye(2)
    state = tr.GaussianState(mean, cov)
    mean[0] = 9.0
    assert state.mean[0] == 0.0
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_psd=0.1), tr.PositionSensor(dims=1, std=1.0))
    run = kf.run([0.0], np.array([[1.0]], order="F"), initial=state)
    with pytest.raises(ValueError, match="read-only"):
        run.means[0, 0] = 1.0
    square = tr.GaussianState([0.0, 0.0], np.asfortranarray([[2.0, 1.0], [1.0, 3.0]])[::1])
    assert kf.predict(square, 1.0).cov[0, 0] == pytest.approx(2 + 2 + 3 + 0.1 / 3)


def test_iterating_helps_where_the_sensor_bends():
    """A range known to 1 cm, a prior known to 3 m: only the iterated posterior agrees with the report."""
    motion = tr.ConstantVelocity(dims=2, accel_psd=0.1)
    radar = tr.RangeBearing(position=(0.0, 0.0), range_std=0.01, bearing_std=1.0)
    state = tr.GaussianState([4.0, 3.0, 0.0, 0.0], np.diag([9.0, 9.0, 1.0, 1.0]))
    misfit = []
    for iterations in (1, 10):
        ekf = tr.ExtendedKalmanFilter(motion, radar, iterations=iterations)
        mean = ekf.update(state, [5.0, 1.8]).posterior.mean
        misfit.append(abs(np.hypot(*mean[:2]) - 5.0))
        run = ekf.run([0.0], [[5.0, 1.8]], initial=state)
        np.testing.assert_array_equal(run.means[0], mean)
    assert misfit[1] < 1e-3 < misfit[0]
    with pytest.raises(tr.ParameterError, match="iterations = 0"):
        tr.ExtendedKalmanFilter(motion, radar, iterations=0)
