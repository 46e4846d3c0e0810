"""Batches of tracks: against single runs, on any number of threads, at every level of instructions."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

import trackrs as tr
from trackrs.batch import simd_levels

MOTION = tr.ConstantVelocity(dims=2, accel_psd=0.3)
SENSOR = tr.PositionSensor(dims=2, std=[1.0, 2.0])
KF = tr.KalmanFilter(MOTION, SENSOR)
START = tr.GaussianState([1.0, 2.0, 0.5, -0.5], np.diag([4.0, 4.0, 1.0, 1.0]) + 0.1, time=2.0)
TIMES = np.array([2.0, 3.0, 3.5, 5.0, 5.0, 7.0])


def measurements(tracks=11, seed=3):
    rng = np.random.default_rng(seed)
    values = 5.0 * rng.normal(size=(tracks, len(TIMES), 2))
    values[rng.uniform(size=values.shape) < 0.1] = np.nan
    return values


def test_a_batch_is_its_runs():
    values = measurements()
    out = KF.run_batch(TIMES, values, initial=START, covs=True, nis=True)
    for track, rows in enumerate(values):
        run = KF.run(TIMES, rows, initial=START)
        assert np.allclose(out.means[track], run.means, rtol=1e-11, atol=1e-11)
        assert np.allclose(out.covs[track], run.covs, rtol=1e-11, atol=1e-11)
        assert np.allclose(out.nis[track], run.nis, rtol=1e-9, equal_nan=True)
    assert out.labels == KF.labels
    assert np.array_equal(out.times, TIMES)
    assert not out.failures.any()
    assert not out.means.flags.writeable


@pytest.mark.parametrize("components", [1, 2, 3])
def test_a_linear_sensor_is_in_lanes(components):
    """Dense, with an offset and correlations; of some reports parts are missing."""
    rng = np.random.default_rng(components)
    root = np.eye(components) + 0.5 * rng.normal(size=(components, components))
    h, offset = rng.normal(size=(components, 4)), rng.normal(size=components)
    kf = tr.KalmanFilter(MOTION, tr.LinearSensor(h, root @ root.T, offset=offset))
    values = 5.0 * rng.normal(size=(11, len(TIMES), components))
    values[rng.uniform(size=values.shape) < 0.2] = np.nan
    batch = tr.TrackBatch(kf, np.tile(START.mean, (11, 1)), START.cov, START.time)
    assert batch.in_lanes
    out = batch.run(TIMES, values, covs=True, nis=True)
    for track, rows in enumerate(values):
        run = kf.run(TIMES, rows, initial=START)
        assert np.allclose(out.means[track], run.means, rtol=1e-11, atol=1e-11)
        assert np.allclose(out.covs[track], run.covs, rtol=1e-11, atol=1e-11)
        assert np.allclose(out.nis[track], run.nis, rtol=1e-9, equal_nan=True)


def test_only_what_is_asked_for():
    out = KF.run_batch(TIMES, measurements(), initial=START)
    assert out.covs is None
    assert out.nis is None


def test_scan_by_scan_is_the_same_bits():
    values = measurements(1001)
    whole = KF.run_batch(TIMES, values, initial=START, covs=True)
    batch = tr.TrackBatch(KF, np.tile(START.mean, (1001, 1)), START.cov, START.time)
    assert batch.in_lanes
    for k, time in enumerate(TIMES):
        batch.step(time, values[:, k])
        assert np.array_equal(batch.means, whole.means[:, k])
        assert np.array_equal(batch.covs, whole.covs[:, k])
    assert batch.time == TIMES[-1]


def test_starts_of_their_own():
    rng = np.random.default_rng(0)
    means = rng.normal(size=(5, 4))
    roots = rng.normal(size=(5, 4, 4))
    covs = roots @ roots.transpose(0, 2, 1) + np.eye(4)
    covs = 0.5 * (covs + covs.transpose(0, 2, 1))
    values = measurements(5)
    out = tr.TrackBatch(KF, means, covs).run(TIMES, values)
    for track in range(5):
        initial = tr.GaussianState(means[track], covs[track])
        assert np.allclose(out.means[track], KF.run(TIMES, values[track], initial=initial).means, rtol=1e-10)


@pytest.mark.parametrize(
    "other",
    [
        tr.ExtendedKalmanFilter(MOTION, tr.RangeBearing((0, 0), range_std=1.0, bearing_std=0.01)),
        tr.UnscentedKalmanFilter(MOTION, tr.RangeBearing((0, 0), range_std=1.0, bearing_std=0.01)),
        tr.KalmanFilter(MOTION, SENSOR, form="square_root"),
        tr.KalmanFilter(MOTION, SENSOR, screen=tr.ChiSquareScreen()),
        tr.KalmanFilter(tr.Singer(dims=2, accel_std=1.0, time_constant=2.0), SENSOR),
    ],
    ids=["extended", "unscented", "square_root", "screen", "singer"],
)
def test_other_filters_are_their_runs_bit_for_bit(other):
    n = len(other.labels)
    start = tr.GaussianState([30.0, 40.0] + [0.0] * (n - 2), np.eye(n), time=1.0)
    values = np.abs(measurements(3)) + np.array([40.0, 0.5])
    batch = tr.TrackBatch(other, np.tile(start.mean, (3, 1)), start.cov, 1.0, threads=2)
    assert not batch.in_lanes
    out = batch.run(TIMES, values, covs=True, nis=True)
    for track in range(3):
        run = other.run(TIMES, values[track], initial=start, history="filtered")
        assert np.array_equal(out.means[track], run.means)
        assert np.array_equal(out.covs[track], run.covs)
        assert np.array_equal(out.nis[track], run.nis, equal_nan=True)


@pytest.mark.parametrize(
    "rule",
    [
        tr.LimitedMemoryNoise(window=5),
        tr.ResidualNoise(r_limits=(1e-3, 1e3), memory="window", window=5),
        tr.NisScaledNoise(psd_limits=(1e-3, 1e3)),
    ],
    ids=lambda rule: type(rule).__name__,
)
def test_a_filter_that_adapts_does_so_in_a_batch(rule):
    """No estimate of the sensor's noise alone has a size by which the lanes would know it."""
    times = np.arange(2.0, 42.0)
    values = 9.0 * np.random.default_rng(5).normal(size=(3, 40, 2))
    adaptive = tr.KalmanFilter(MOTION, SENSOR, adapt=rule)
    out = adaptive.run_batch(times, values, initial=START)
    for track, rows in enumerate(values):
        assert np.array_equal(out.means[track], adaptive.run(times, rows, initial=START).means)
        assert not np.allclose(out.means[track], KF.run(times, rows, initial=START).means)


def test_threads_change_nothing():
    values = measurements(20_000)
    one = KF.run_batch(TIMES, values, initial=START, threads=1)
    assert np.array_equal(one.means, KF.run_batch(TIMES, values, initial=START, threads=3).means)


SCRIPT = """
import hashlib, sys
import numpy as np, trackrs as tr
motion, sensor = tr.ConstantAcceleration(dims=3, jerk_psd=0.2), tr.PositionSensor(dims=3, std=2.0)
start = tr.GaussianState(np.zeros(9), 10.0 * np.eye(9))
values = 4.0 * np.random.default_rng(1).normal(size=(21, 30, 3))
out = tr.KalmanFilter(motion, sensor).run_batch(np.arange(1.0, 31.0), values, initial=start, covs=True)
print(hashlib.sha256(out.means.tobytes() + out.covs.tobytes()).hexdigest())
"""


def at_level(name):
    command = [sys.executable, "-c", SCRIPT]
    environment = os.environ | {"TRACKRS_SIMD": name}
    return subprocess.run(command, check=False, env=environment, capture_output=True, text=True)


def test_every_level_gives_the_same_bits():
    levels = simd_levels()
    assert levels[-1] == "scalar"
    found = {at_level(name).stdout for name in [*levels, ""]}
    assert len(found) == 1
    assert len(found.pop()) == 65


def test_a_level_that_is_not_there_is_named():
    failed = at_level("v9")
    assert failed.returncode == 1
    assert "TRACKRS_SIMD" in failed.stderr
    assert "must be one of this machine" in failed.stderr


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: KF.run_batch(TIMES, measurements()[:, :5], initial=START), tr.DimensionError, "times"),
        (lambda: KF.run_batch(TIMES, measurements()[:, :, :1], initial=START), tr.DimensionError, "measurement"),
        (lambda: KF.run_batch(TIMES - 9.0, measurements(), initial=START), tr.TimeError, "-7"),
        (lambda: KF.run_batch(TIMES, measurements() + np.inf, initial=START), tr.NonFiniteError, "measurement"),
        (lambda: KF.run_batch(TIMES, measurements(), initial=START, threads=0), tr.ParameterError, "threads"),
        (lambda: tr.TrackBatch(KF, np.zeros((3, 5)), np.eye(4)), tr.DimensionError, r"means must be \(B, 4\)"),
        (lambda: tr.TrackBatch(KF, np.zeros((3, 4)), np.zeros((2, 4, 4))), tr.DimensionError, "covs must be"),
        (lambda: tr.TrackBatch(KF, np.zeros((3, 4)), -np.eye(4)), tr.NotPositiveDefiniteError, "cov"),
    ],
)
def test_mistakes_are_named(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_a_mistake_leaves_the_tracks_as_they_were():
    batch = tr.TrackBatch(KF, np.zeros((3, 4)), np.eye(4))
    before = batch.means
    with pytest.raises(tr.DimensionError):
        batch.step(1.0, np.zeros((2, 2)))
    with pytest.raises(tr.TimeError):
        batch.step(-1.0, np.zeros((3, 2)))
    assert np.array_equal(batch.means, before)
    assert batch.time == 0.0


def test_no_tracks_and_no_times():
    assert KF.run_batch(TIMES, np.zeros((0, len(TIMES), 2)), initial=START).means.shape == (0, len(TIMES), 4)
    assert KF.run_batch([], np.zeros((3, 0, 2)), initial=START).means.shape == (3, 0, 4)


def test_an_interrupt_leaves_the_tracks_as_they_were():
    def interrupt(_number, _frame):
        raise KeyboardInterrupt

    sensor = tr.RangeBearing((0, 0), range_std=1.0, bearing_std=0.01)
    batch = tr.TrackBatch(
        tr.ExtendedKalmanFilter(MOTION, sensor), np.tile([30.0, 40.0, 0.0, 0.0], (4000, 1)), np.eye(4)
    )
    before, times = batch.means, np.arange(1.0, 1001.0)
    values = np.tile([50.0, 0.9], (4000, 1000, 1))
    old = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        with pytest.raises(KeyboardInterrupt):
            batch.run(times, values)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)
    # Had it not looked, the exception would come at the end and the tracks would have moved.
    assert np.array_equal(batch.means, before)
    assert batch.time == 0.0


def test_states_without_positions():
    kf = tr.KalmanFilter(tr.LinearMotion([[1.0]], [[0.5]]), tr.LinearSensor([[1.0]], [[1.0]]))
    start = tr.GaussianState([0.0], [[1.0]])
    values = np.arange(6.0).reshape(3, 2, 1)
    out = kf.run_batch([1.0, 2.0], values, initial=start)
    for track in range(3):
        assert np.array_equal(out.means[track], kf.run([1.0, 2.0], values[track], initial=start).means)


@pytest.mark.parametrize("threads", [1, 3])
def test_what_a_model_raises_is_raised(threads):
    def broken(_states, _dt):
        raise ValueError("mine")

    motion = tr.CustomMotion(broken, [[1.0]], labels=["x"])
    ekf = tr.ExtendedKalmanFilter(motion, tr.LinearSensor([[1.0]], [[1.0]]))
    with pytest.raises(ValueError, match="mine"):
        ekf.run_batch([1.0], np.zeros((30, 1, 1)), initial=tr.GaussianState([0.0], [[1.0]]), threads=threads)
