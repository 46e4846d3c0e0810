"""Range bias and scale error as extra states: what users see, and statistical consistency."""

from __future__ import annotations

import numpy as np
import pytest

import trackrs as tr
from courses import BATS
from trackrs.config import ConfigError, load_config

PHONES = np.vstack([BATS, [[450.0, 300.0, 100.0], [-300.0, 700.0, 200.0]]])
RADIOS = np.array([[-46.6, 11.0], [11.0, -7.0], [22.1, 23.8], [-17.7, 59.0]])
PLANE = tr.ConstantVelocity(dims=2, accel_psd=0.05)
SPACE = tr.ConstantVelocity(dims=3, accel_psd=0.05)


def drawn(array, motion, start, times, rng):
    """A course, lasting errors and measurements drawn from the model itself."""
    std = np.zeros(len(array.extra_labels))
    walk = np.zeros(len(std))
    if array.bias_std is not None:
        std[: len(array.hydrophones)], walk[: len(array.hydrophones)] = array.bias_std, array.bias_psd
    if array.scale_std is not None:
        std[-1], walk[-1] = array.scale_std, array.scale_psd
    states, errors = [np.asarray(start)], [rng.normal(size=len(std)) * std]
    for dt in np.diff(times):
        noise = rng.multivariate_normal(np.zeros(len(start)), motion.noise(dt))
        states.append(motion.transition(dt) @ states[-1] + noise)
        errors.append(errors[-1] + rng.normal(size=len(std)) * np.sqrt(walk * dt))
    truth = np.hstack([states, errors])
    values = np.array([array.observe(state) for state in truth])
    return truth, values + rng.normal(size=values.shape) * np.sqrt(np.diagonal(array.noise()))


@pytest.mark.parametrize("kind", ["rows", "single", "wandering"])
def test_full_state_is_consistent_from_the_start_on(kind):
    """NEES of position, velocity, biases and scale over 120 self-started runs lies in its 99.9 % band."""
    motion, start, times = PLANE, [0.0, 10.0, 0.8, 0.5], np.arange(0.0, 50.0, 0.25)
    if kind == "single":
        array = tr.RangeArray(RADIOS, 0.5, bias_std=0.3, scale_std=0.05)
    else:
        psd = 0.05 if kind == "wandering" else 0.0
        array = tr.RangeArray(PHONES, 1.0, 0.3, side="above", bias_std=2.0, scale_std=0.01, bias_psd=psd)
        motion, start, times = SPACE, [200.0, -150.0, 60.0, 8.0, 4.0, 0.2], np.arange(40.0)
    ekf, runs, nees = tr.ExtendedKalmanFilter(motion, array), 120, []
    for number in range(runs):
        truth, values = drawn(array, motion, start, times, np.random.default_rng([11, number]))
        if kind == "single":
            heard = np.arange(len(times))[:, None] % 4 == np.arange(4)
            values = np.where(heard, values, np.nan)
        run = ekf.run(times, values)
        rows = [run.start, run.start + 1, run.start + 5, len(times) - 1]
        nees.append(tr.nees(run.means[rows] - truth[rows], run.covs[rows]).statistics)
    dof = runs * truth.shape[1]
    low, high = (tr.Gate(p).threshold(dof) / runs for p in (0.0005, 0.9995))
    mean = np.mean(nees, axis=0)
    assert ((low < mean) & (mean < high)).all(), (low, mean, high)


def test_labels_and_lengths():
    array = tr.RangeArray(RADIOS, 0.5, bias_std=[0.1, 0.2, 0.3, 0.4], scale_std=0.05)
    assert array.extra_labels == ("bias0", "bias1", "bias2", "bias3", "scale")
    assert (array.bias_std, array.scale_std, array.bias_psd, array.scale_psd) == ((0.1, 0.2, 0.3, 0.4), 0.05, 0.0, 0.0)
    ekf = tr.ExtendedKalmanFilter(PLANE, array)
    assert ekf.labels == ("x", "y", "vx", "vy", *array.extra_labels)
    np.testing.assert_allclose(
        array.observe([0, 10, 1, 1, 0.3, 0, 0, -0.2, 0.01]),
        1.01 * array.observe([0.0, 10.0]) + [0.3, 0.0, 0.0, -0.2],
    )
    times, values = np.arange(20.0), np.tile(array.observe([0.0, 10.0]), (20, 1))
    short = tr.GaussianState([0.0, 10.0, 0.0, 0.0], np.eye(4), time=0.0)
    inputs = np.zeros((20, 4))
    run = ekf.run(times, values, initial=short, inputs=inputs)
    assert run.labels == ekf.labels
    assert run.means.shape == (20, 9)
    assert run.smooth().labels == ekf.labels
    full = tr.GaussianState([0.0, 10.0, *np.zeros(7)], np.diag([1, 1, 1, 1, 0.01, 0.04, 0.09, 0.16, 0.0025]), time=0.0)
    same = ekf.run(times, values, initial=full, inputs=np.zeros((20, 9)))
    assert np.array_equal(same.means, run.means)
    # One step as well.
    state = ekf.predict(run[-1], 20.0, input=np.zeros(4))
    assert np.array_equal(state.mean, ekf.predict(run[-1], 20.0).mean)
    assert ekf.update(state, values[0]).posterior.mean.shape == (9,)
    with pytest.raises(tr.DimensionError, match="initial state has size 6, expected 9"):
        ekf.run(times, values, initial=tr.GaussianState(np.zeros(6), np.eye(6)))
    with pytest.raises(tr.DimensionError, match="input has size 5, expected 9"):
        ekf.run(times, values, initial=short, inputs=np.zeros((20, 5)))


def test_scale_is_found_and_its_covariance_shrinks():
    rng = np.random.default_rng(5)
    array = tr.RangeArray(RADIOS, 0.5, scale_std=0.1)
    path = np.stack([-30.0 + 0.5 * np.arange(100), 10.0 + 20.0 * np.sin(0.1 * np.arange(100))], axis=1)
    values = np.array([1.065 * array.observe(p) for p in path]) + rng.normal(size=(100, 4)) * 0.5
    run = tr.ExtendedKalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.5), array).run(np.arange(100.0), values)
    scale = run.labels.index("scale")
    sigma = np.sqrt(run.covs[:, scale, scale])
    assert abs(run.means[-1, scale] - 0.065) < 3.0 * sigma[-1] < 0.01
    assert (np.diff(sigma[run.start :]) < 1e-12).all()


def test_noise_is_still_estimated_with_errors_that_stay():
    rng = np.random.default_rng(6)
    array = tr.RangeArray(PHONES, 3.0, 0.3, bias_std=2.0)
    times = np.arange(150.0)
    path = np.stack([-200.0 + 8.0 * times, 300.0 * np.sin(0.03 * times), np.full(150, 60.0)], axis=1)
    clean = np.array([array.observe(p) for p in path]) + np.array([1.0, -2.0, 0.5, 0.0, 1.5, 0.0])
    values = clean + rng.normal(size=clean.shape) * np.array([1.0] * 5 + [0.3])
    motion = tr.ConstantVelocity(dims=3, accel_std=0.3)
    run = tr.ExtendedKalmanFilter(motion, array, adapt=tr.LimitedMemoryNoise(window=40)).run(times, values)
    np.testing.assert_allclose(np.sqrt(np.diagonal(run.r_hat[-1]))[:5].mean(), 1.0, rtol=0.2)
    assert run.q_hat.shape[1:] == (3, 3)


def test_second_order_is_for_range_arrays():
    tr.ExtendedKalmanFilter(PLANE, tr.RangeArray(RADIOS, 0.5), second_order=True)
    with pytest.raises(tr.ParameterError, match="second_order"):
        tr.ExtendedKalmanFilter(PLANE, tr.PositionSensor(2, std=1.0), second_order=True)


def test_second_order_is_right_where_first_order_is_not():
    """A target known to 12 m across a range of 40 m: the range's distribution against a million draws."""
    array = tr.RangeArray([[0.0, 0.0]], 0.5)
    mean, cov = np.array([40.0, 0.0]), np.diag([1.0, 144.0])
    draws = np.hypot(*np.random.default_rng(1).multivariate_normal(mean, cov, size=1_000_000).T)
    state = tr.GaussianState(mean, cov)
    walk = tr.RandomWalk(dims=2, velocity_psd=1.0)
    first = tr.ExtendedKalmanFilter(walk, array).update(state, [40.0])
    second = tr.ExtendedKalmanFilter(walk, array, second_order=True).update(state, [40.0])
    assert (first.innovation[0], first.innovation_cov[0, 0]) == pytest.approx((0.0, 1.25))
    # Exact values of the quadratic, and the truth up to what is of higher order.
    assert 40.0 - second.innovation[0] == pytest.approx(40.0 + 144.0 / 80.0)
    assert second.innovation_cov[0, 0] == pytest.approx(1.25 + 0.5 * (144.0 / 40.0) ** 2)
    assert draws.mean() - 40.0 == pytest.approx(-second.innovation[0], rel=0.1)
    assert draws.var() + 0.25 == pytest.approx(second.innovation_cov[0, 0], rel=0.2)


def test_mistakes_are_named():
    for given, name in (
        ({"bias_std": 0.0}, "bias_std"),
        ({"bias_std": -1.0}, "bias_std"),
        ({"bias_std": np.nan}, "bias_std"),
        ({"scale_std": 0.0}, "scale_std"),
        ({"scale_std": 2.0}, "scale_std = 2 is invalid: must be less than 1"),
        ({"bias_std": 1.0, "bias_psd": -1.0}, "bias_psd"),
        ({"scale_std": 0.1, "scale_psd": np.inf}, "scale_psd"),
        ({"bias_psd": 0.1}, "bias_psd = 0.1 is invalid: needs bias_std"),
        ({"scale_psd": 0.1}, "scale_psd = 0.1 is invalid: needs scale_std"),
    ):
        with pytest.raises(tr.ParameterError, match=name):
            tr.RangeArray(RADIOS, 0.5, **given)
    with pytest.raises(tr.DimensionError, match="bias_std"):
        tr.RangeArray(RADIOS, 0.5, bias_std=[1.0, 2.0])
    array = tr.RangeArray(RADIOS, 0.5, scale_std=0.1)
    with pytest.raises(tr.ParameterError, match=r'sensor "radio".*extra states scale.*must have none'):
        tr.MultiTargetTracker(PLANE, sensors={"radio": array}, initiator=tr.MofN(2, 3, max_speed=3.0))
    with pytest.raises(tr.ParameterError, match=r"array 1 .*lasting errors"):
        tr.RangeArray.stack([tr.RangeArray(RADIOS, 0.5), array])
    with pytest.raises(tr.UnobservableError, match="hydrophone of channel 1"):
        array.observe([11.0, -7.0, 0.0, 0.0, 0.01])
    ekf = tr.ExtendedKalmanFilter(PLANE, array)
    with pytest.raises(tr.UnobservableError, match=r"or groups of them.*needs 2 ranges, 0 heard"):
        ekf.run(np.arange(9.0), np.full((9, 4), np.nan))
    state = tr.GaussianState([11.0, -7.0, 0.0, 0.0, 0.0], np.eye(5))
    with pytest.raises(tr.UnobservableError, match="channel 1"):
        ekf.update(state, [1.0, 1.0, 1.0, 1.0])
    assert state.mean[0] == 11.0


def test_configuration_file_takes_the_arguments(tmp_path):
    """They are known there; the tracker then says why it cannot use such a sensor."""
    file = tmp_path / "radio.toml"
    file.write_text("""
[motion]
type = "constant_velocity"
dims = 2
accel_psd = 0.3

[sensors.radio]
type = "range_array"
hydrophones = [[0, 0], [90, 0], [50, 60]]
range_std = 0.5
bias_std = [0.1, 0.1, 0.2]
bias_psd = 1e-6
scale_std = 0.1
columns = ["a", "b", "c"]

[tracker]
initiator = {m = 2, n = 3, max_speed = 12}

[input]
time = "t"
""")
    with pytest.raises(ConfigError, match="extra states bias0 bias1 bias2 scale"):
        load_config(file)
