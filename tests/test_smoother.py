"""Smoothing against the results of other programs, and what the facade promises about it."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr

DATA = Path(__file__).parent / "data"


def track(steps=30, seed=3, **options):
    """A run over a constant-velocity track in two dimensions."""
    rng = np.random.default_rng(seed)
    motion, sensor = tr.ConstantVelocity(dims=2, accel_psd=0.3), tr.PositionSensor(dims=2, std=2.0)
    times = np.cumsum(rng.uniform(0.2, 2.0, steps))
    values = np.outer(times, [5.0, -3.0]) + rng.normal(0.0, 2.0, (steps, 2))
    start = tr.GaussianState(np.zeros(4), np.diag([100.0, 100.0, 25.0, 25.0]))
    return tr.KalmanFilter(motion, sensor).run(times, values, initial=start, **options)


def first(run, count):
    """The run as it was after `count` measurements."""
    sequences = [field.name for field in dataclasses.fields(run) if isinstance(getattr(run, field.name), np.ndarray)]
    return dataclasses.replace(run, **{name: getattr(run, name)[:count] for name in sequences})


def test_nile_local_level_equals_statsmodels():
    """`tests/data/golden_nile`, made with statsmodels 0.15.0."""
    folder = DATA / "golden_nile"
    volume = [float(row["volume"]) for row in csv.DictReader((folder / "nile.csv").read_text().splitlines())]
    expected = list(csv.DictReader((folder / "local_level_known_init.csv").read_text().splitlines()))
    reference = json.loads((folder / "reference.json").read_text())
    level = tr.RandomWalk(dims=1, velocity_psd=reference["sigma2_eta"])
    kf = tr.KalmanFilter(level, tr.PositionSensor(dims=1, std=reference["sigma2_eps"] ** 0.5))
    known = reference["known_init"]
    start = tr.GaussianState([known["a0"]], [[known["P0"]]], time=1871.0)
    smoothed = kf.run(np.arange(1871.0, 1971.0), np.array(volume)[:, None], initial=start).smooth()
    np.testing.assert_allclose(smoothed.means[:, 0], [float(r["smoothed_level"]) for r in expected], rtol=1e-9)
    np.testing.assert_allclose(smoothed.covs[:, 0, 0], [float(r["smoothed_var"]) for r in expected], rtol=1e-9)


def test_robot_equals_matlab():
    """`tests/data/golden_pykalman_robot`, made with a MATLAB program; known inputs enter between the states."""
    robot = np.load(DATA / "golden_pykalman_robot" / "robot.npz")
    motion = tr.LinearMotion(robot["A"], robot["Q"])
    sensor = tr.LinearSensor(robot["C"], robot["R"], offset=robot["d"].ravel())
    start = tr.GaussianState(robot["x0"].ravel(), robot["V_0"], time=0.0)
    times = np.arange(1.0, robot["y"].shape[1] + 1)
    run = tr.KalmanFilter(motion, sensor).run(times, robot["y"].T, initial=start, inputs=robot["b"].T)
    smoothed = run.smooth()
    expected = robot["xsmooth"].T[1:]
    np.testing.assert_allclose(smoothed.means, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    expected = robot["Vsmooth"][1:]
    np.testing.assert_allclose(smoothed.covs, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_shapes_and_what_smoothing_gains():
    run = track()
    smoothed = run.smooth()
    assert (smoothed.means.shape, smoothed.covs.shape) == ((30, 4), (30, 4, 4))
    assert smoothed.lag_one_covs.shape == (29, 4, 4)
    assert (len(smoothed), smoothed.labels, smoothed.lag) == (30, ("x", "y", "vx", "vy"), None)
    assert np.array_equal(smoothed.times, run.times)
    assert np.array_equal(smoothed[-1].mean, run[-1].mean)
    assert np.array_equal(smoothed[-1].cov, run[-1].cov)
    assert smoothed[3].time == run.times[3]
    assert np.array_equal(smoothed.covs, smoothed.covs.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(run.covs - smoothed.covs).min() > -1e-9
    assert run.transitions.shape == run.motion_noises.shape == (30, 4, 4)
    assert run.transitions[5, 0, 2] == pytest.approx(run.times[5] - run.times[4])


def test_lag_one_covariances_have_later_states_in_rows():
    run = track()
    smoothed = run.smooth()
    for i in range(len(run) - 1):
        gain = run.covs[i] @ run.transitions[i + 1].T @ np.linalg.inv(run.predicted_covs[i + 1])
        np.testing.assert_allclose(smoothed.lag_one_covs[i], smoothed.covs[i + 1] @ gain.T, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("lag", [1, 4, 29, 30, 10**30])
def test_fixed_lag_equals_smoothing_the_data_so_far(lag):
    run, lagged = track(), track().smooth(lag=lag)
    assert lagged.lag == lag
    assert lagged.lag_one_covs.shape == (29, 4, 4)
    for i in range(len(run)):
        so_far = first(run, min(i + lag, 29) + 1).smooth()
        assert np.array_equal(lagged.means[i], so_far.means[i])
        assert np.array_equal(lagged.covs[i], so_far.covs[i])
        assert np.array_equal(lagged.lag_one_covs[i : i + 1], so_far.lag_one_covs[i : i + 1])


def test_repeated_times_and_missing_measurements():
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_std=1.0), tr.PositionSensor(dims=1, std=1.0))
    start = tr.GaussianState([0.0, 1.0], [[4.0, 1.0], [1.0, 2.0]])
    values = [[1.2], [0.7], [np.nan], [2.9]]
    smoothed = kf.run([1.0, 1.0, 2.0, 3.0], values, initial=start).smooth()
    assert np.array_equal(smoothed.covs[0], smoothed.covs[1])
    np.testing.assert_allclose(smoothed.means[0], smoothed.means[1], rtol=1e-13)
    both = tr.LinearSensor([[1.0, 0.0], [1.0, 0.0]], np.eye(2))
    rows = [[1.2, 0.7], [np.nan, np.nan], [2.9, np.nan]]
    motion = tr.ConstantVelocity(dims=1, accel_std=1.0)
    once = tr.KalmanFilter(motion, both).run([1.0, 2.0, 3.0], rows, initial=start).smooth()
    np.testing.assert_allclose(smoothed.means[1:], once.means, rtol=1e-12)
    np.testing.assert_allclose(smoothed.covs[1:], once.covs, rtol=1e-11)


def test_long_runs_do_not_show_their_pieces():
    """Piece boundaries lie 4096 steps from the end; the recursion in NumPy knows none."""
    run = track(steps=9000)
    smoothed = run.smooth()
    assert (len(smoothed.means), len(smoothed.lag_one_covs)) == (9000, 8999)
    means, covs, lag_one = run.means.copy(), run.covs.copy(), np.empty((8999, 4, 4))
    gains = np.linalg.solve(run.predicted_covs[1:], run.transitions[1:] @ run.covs[:-1]).transpose(0, 2, 1)
    for i in range(8998, -1, -1):
        lag_one[i] = covs[i + 1] @ gains[i].T
        means[i] += gains[i] @ (means[i + 1] - run.predicted_means[i + 1])
        covs[i] += gains[i] @ (covs[i + 1] - run.predicted_covs[i + 1]) @ gains[i].T
    np.testing.assert_allclose(smoothed.means, means, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(smoothed.covs, covs, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(smoothed.lag_one_covs, lag_one, rtol=1e-8, atol=1e-9)
    assert np.array_equal(run.smooth(lag=9000).means, smoothed.means)


def test_short_runs():
    empty = track(steps=0).smooth()
    assert (empty.means.shape, empty.covs.shape, empty.lag_one_covs.shape) == ((0, 4), (0, 4, 4), (0, 4, 4))
    for lag in (None, 1):
        single = track(steps=1)
        smoothed = single.smooth(lag)
        assert np.array_equal(smoothed.covs, single.covs)
        assert smoothed.lag_one_covs.shape == (0, 4, 4)


def test_consistency_on_the_models_own_truth():
    """The smoothed NEES of the middle state lies in the 99.9 % band of its chi-square average."""
    rng = np.random.default_rng(12)
    motion, sensor = tr.ConstantVelocity(dims=1, accel_psd=0.5), tr.PositionSensor(dims=1, std=3.0)
    kf, runs, F, Q = tr.KalmanFilter(motion, sensor), 200, motion.transition(1.0), motion.noise(1.0)
    errors, covs, P0 = [], [], np.diag([100.0, 25.0])
    for _ in range(runs):
        path = [rng.multivariate_normal(np.zeros(2), P0)]
        for _ in range(20):
            path.append(rng.multivariate_normal(F @ path[-1], Q))
        truth = np.array(path[1:])
        values = truth[:, :1] + rng.normal(0.0, 3.0, (20, 1))
        smoothed = kf.run(np.arange(1.0, 21.0), values, initial=tr.GaussianState(np.zeros(2), P0)).smooth()
        errors.append(truth[10] - smoothed.means[10])
        covs.append(smoothed.covs[10])
    low, high = (tr.Gate(p).threshold(2 * runs) / runs for p in (0.0005, 0.9995))
    assert low < tr.nees(errors, covs).statistics.mean() < high


def test_extended_filter_smooths_its_linearised_model():
    rng = np.random.default_rng(4)
    times = np.arange(1.0, 60.0)
    path = np.stack([300.0 + 5.0 * times, 200.0 - 8.0 * times], axis=1)
    polar = np.stack([np.hypot(*path.T), np.arctan2(path[:, 1], path[:, 0])], axis=1)
    polar += rng.normal(size=polar.shape) * [5.0, 0.01]
    ekf = tr.ExtendedKalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.1), tr.RangeBearing((0.0, 0.0), 5.0, 0.01))
    start = tr.GaussianState([*path[0], 0.0, 0.0], np.diag([100.0, 100.0, 100.0, 100.0]), 1.0)
    run = ekf.run(times, polar, initial=start)
    assert tr.rmse(run.smooth().means[:, :2] - path) < 0.8 * tr.rmse(run.means[:, :2] - path)


@pytest.mark.parametrize("history", ["filtered", "last"])
def test_smoothing_needs_the_full_history(history):
    with pytest.raises(tr.ParameterError, match=r'smoothing needs a run with history="full"'):
        track(history=history).smooth()


@pytest.mark.parametrize("lag", [0, -3, 2.5, "two"])
def test_lag_is_a_whole_number(lag):
    with pytest.raises(tr.ParameterError, match=r"lag = .* is invalid: must be a whole number of measurements"):
        track().smooth(lag=lag)


def test_singular_prediction_is_named():
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_std=0.3), tr.PositionSensor(dims=1, std=1.0))
    run = kf.run([0.0, 0.7, 1.4], np.zeros((3, 1)), initial=tr.GaussianState([0.0, 0.0], np.zeros((2, 2))))
    for lag in (None, 1):
        with pytest.raises(tr.NotPositiveDefiniteError, match=r"predicted covariance at step 1 .* pivot 1"):
            run.smooth(lag)


def test_results_are_read_only_and_the_run_untouched():
    run = track()
    before = run.means.copy()
    smoothed = run.smooth()
    for name in ("times", "means", "covs", "lag_one_covs"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(smoothed, name)[0] = 1.0
    for name in ("transitions", "motion_noises"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(run, name)[0] = 1.0
    with pytest.raises(AttributeError):
        smoothed.lag = 3
    assert np.array_equal(run.means, before)


def test_a_run_that_starts_itself_is_smoothed_from_its_start():
    """Rows before the start stay NaN; the rest is what smoothing the run begun there gives."""
    rng = np.random.default_rng(6)
    phones = [[0.0, 0.0, 250.0], [1000.0, 0.0, 252.0], [500.0, 866.0, 248.0]]
    array = tr.RangeArray.bats(phones, range_std=1.0, depth_std=0.3)
    times = np.arange(40.0)
    path = np.stack([300.0 + 8.0 * times, 200.0 + 5.0 * times, 50.0 + 0.5 * times], axis=1)
    values = np.array([array.observe([*p, *np.zeros(6)]) for p in path]) + rng.normal(size=(40, 4)) * [1, 1, 1, 0.3]
    ekf = tr.ExtendedKalmanFilter(tr.ConstantAcceleration(dims=3, jerk_std=0.05), array)
    run = ekf.run(times, values)
    smoothed = run.smooth()
    assert run.start >= 2
    assert len(smoothed) == 40
    assert np.isnan(smoothed.means[: run.start]).all()
    again = ekf.run(times[run.start + 1 :], values[run.start + 1 :], initial=run[run.start]).smooth()
    np.testing.assert_array_equal(smoothed.means[run.start + 1 :], again.means)
    errors = smoothed.means[run.start :, :3] - path[run.start :]
    assert tr.rmse(errors) < tr.rmse(run.means[run.start :, :3] - path[run.start :])
