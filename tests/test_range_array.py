"""RangeArray: the facade, position fixes and runs that start themselves."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr
from courses import BATS, TOSS, heard, jerk, manoeuvre
from trackrs.config import ConfigError, load_config

DATA = Path(__file__).parent / "data"


def test_fix_rmse_of_the_reference_start():
    """BATS least squares at the first epochs: (1.22, 1.60, .31) m in the independent reference, to two digits."""
    rng = np.random.default_rng(1)
    path = np.tile(manoeuvre()[1][:3], (700, 1))
    array = tr.RangeArray.bats(BATS)
    errors = np.array([array.fix(z).position - p for z, p in zip(heard(array, path, rng), path, strict=True)])
    np.testing.assert_allclose(np.sqrt(np.mean(errors**2, axis=0)), [1.22, 1.60, 0.31], rtol=0.06)


def test_toss_fix_error_is_what_its_covariance_says():
    rng = np.random.default_rng(2)
    _, path, _ = manoeuvre()
    array = tr.RangeArray.toss(TOSS)
    fixes = [array.fix(z) for z in heard(array, path, rng)]
    nees = tr.nees([f.position - p for f, p in zip(fixes, path, strict=True)], [f.cov for f in fixes])
    low, high = (tr.Gate(p).threshold(3 * len(path)) / len(path) for p in (0.0005, 0.9995))
    assert low < nees.statistics.mean() < high
    assert {f.dof for f in fixes} == {3}
    assert 0.0 < np.mean([f.p_value < 0.1 for f in fixes]) < 0.2


def test_golden_fix():
    golden = json.loads((DATA / "underwater_bats_kf.json").read_text())
    array = tr.RangeArray.bats(golden["phones"], range_std=1.0, depth_std=0.3)
    for z, position, cov in zip(golden["L"], golden["init"]["fix"], golden["init"]["fix_cov"], strict=False):
        fix = array.fix(z)
        np.testing.assert_allclose(fix.position, position, rtol=1e-9)
        np.testing.assert_allclose(fix.cov, cov, rtol=1e-9, atol=1e-10)
        assert fix.mirror is None
    with pytest.raises(ValueError, match="read-only"):
        fix.position[0] = 0.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        fix.dof = 3


@pytest.mark.parametrize(("make", "phones"), [(tr.RangeArray.bats, BATS), (tr.RangeArray.toss, TOSS)])
def test_run_starts_itself_on_a_manoeuvring_target(make, phones):
    """NEES of the first ten epochs, where an inconsistent start would show, lies in its 99.9 % band."""
    rng = np.random.default_rng(3)
    array = make(phones)
    times, path, velocity = manoeuvre()
    ekf = tr.ExtendedKalmanFilter(jerk(), array)
    nees, rms, dof = [], [], 0
    for _ in range(40):
        run = ekf.run(times, heard(array, path, rng))
        assert 2 <= run.start < 12
        assert np.isnan(run.means[: run.start]).all()
        assert np.isnan(run.predicted_covs[: run.start + 1]).all()
        assert run.means.shape == (161, 9)
        assert np.isfinite(run.nis[run.start + 1 :]).all()
        first = slice(run.start, run.start + 10)
        errors = np.hstack([run.means[first, :3] - path[first], run.means[first, 3:6] - velocity[first]])
        # One epoch each: those of one run are correlated.
        nees += [tr.nees(errors[k : k + 1], run.covs[first][k : k + 1, :6, :6]).statistics[0] for k in (0, 9)]
        dof += 12
        rms.append(np.sqrt(np.mean(np.sum((run.means[13:, :3] - path[13:]) ** 2, axis=1))))
    low, high = (tr.Gate(p).threshold(dof) / dof for p in (0.0005, 0.9995))
    assert low < np.sum(nees) / dof < high
    # Reference: 1.13 and 1.48 m, from epoch 13 on.
    assert np.mean(rms) == pytest.approx(1.13 if len(phones) == 3 else 1.48, rel=0.05)


def test_start_waits_for_three_good_fixes_and_keeps_history():
    rng = np.random.default_rng(4)
    array = tr.RangeArray.toss(TOSS)
    times, path, _ = manoeuvre()
    values = heard(array, path, rng)
    values[1, 2] += 50.0
    values[3] = np.nan
    ekf = tr.ExtendedKalmanFilter(tr.ConstantVelocity(dims=3, accel_psd=0.5), array)
    full = ekf.run(times, values)
    assert full.start >= 6
    last = ekf.run(times, values, history="last")
    assert (len(last), last.start) == (1, full.start)
    assert np.array_equal(last.means[0], full.means[-1])
    given = ekf.run(times[full.start + 1 :], values[full.start + 1 :], initial=full[full.start])
    assert given.start == 0
    assert np.array_equal(given.means, full.means[full.start + 1 :])
    inputs = np.zeros((len(times), 6))
    assert np.array_equal(ekf.run(times, values, inputs=inputs, history="filtered").means, full.means, equal_nan=True)


def test_start_may_lie_beyond_a_chunk():
    rng = np.random.default_rng(5)
    array = tr.RangeArray.bats(BATS)
    steps = 5000
    path = np.tile([100.0, 200.0, 60.0], (steps, 1))
    values = heard(array, path, rng)
    values[:4200] = np.nan
    values[255:257] = array.observe(path[0])  # two good ones across the seam of two chunks are not three
    run = tr.ExtendedKalmanFilter(tr.RandomWalk(dims=3, velocity_psd=0.1), array).run(np.arange(steps), values)
    assert 4202 <= run.start < 4220
    values[257] = values[256]
    assert tr.ExtendedKalmanFilter(tr.RandomWalk(3, velocity_psd=0.1), array).run(np.arange(steps), values).start == 257


def test_travel_times():
    target = np.array([100.0, 200.0, 60.0])
    ranges = tr.RangeArray(BATS, 1.0, 0.3)
    metres = ranges.observe(target)[:3]
    each = [1490.0, 1500.0, 1510.0]
    for speed, expected in ((1500.0, metres / 1500.0), (each, metres / each), ([[0.0, 1500.0]], metres / 1500.0)):
        array = tr.RangeArray(BATS, range_std=1.5, depth_std=0.3, sound_speed=speed)
        seen = array.observe(target)
        np.testing.assert_allclose(seen[:3], expected, rtol=1e-14)
        assert array.labels == ("time0", "time1", "time2", "depth")
        np.testing.assert_allclose(array.fix(seen).position, target, atol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diagonal(array.noise())), [1e-3, 1e-3, 1e-3, 0.3])
    # Harmonic mean over a profile, by a fine sum.
    profile = np.array([[0.0, 1525.0], [70.0, 1490.0], [400.0, 1500.0]])
    seen = tr.RangeArray(BATS, 1.5, 0.3, sound_speed=profile).observe(target)
    for i, hydrophone in enumerate(BATS):
        z = np.linspace(target[2], hydrophone[2], 200_001)
        slowness = np.mean(1.0 / np.interp(0.5 * (z[1:] + z[:-1]), profile[:, 0], profile[:, 1]))
        assert seen[i] == pytest.approx(metres[i] * slowness, rel=1e-9)


def test_run_of_travel_times_equals_that_of_ranges():
    rng = np.random.default_rng(6)
    ranges, timed = tr.RangeArray.bats(BATS), tr.RangeArray.bats(BATS, sound_speed=1500.0)
    times, path, _ = manoeuvre()
    values = heard(ranges, path, rng)
    scaled = values / [1500.0, 1500.0, 1500.0, 1.0]
    a = tr.ExtendedKalmanFilter(jerk(), ranges).run(times, values)
    b = tr.ExtendedKalmanFilter(jerk(), timed).run(times, scaled)
    assert a.start == b.start
    np.testing.assert_allclose(b.means[b.start :], a.means[a.start :], rtol=1e-6, atol=1e-6)


def test_mirror_images():
    flat = BATS.copy()
    flat[:, 2] = 250.0
    array = tr.RangeArray(flat, 1.0)
    z = array.observe([100.0, 200.0, 60.0])
    with pytest.raises(tr.UnobservableError, match=r'ambiguous.*side = "above" or "below"'):
        array.fix(z)
    above, below = array.fix(z, side="above"), array.fix(z, side="below")
    np.testing.assert_allclose(above.position, [100.0, 200.0, 60.0], atol=1e-6)
    np.testing.assert_allclose(below.position, [100.0, 200.0, 440.0], atol=1e-6)
    assert np.array_equal(above.mirror, below.position)
    assert (above.dof, above.p_value) == (0, 1.0)
    times, values = np.arange(10.0), np.tile(z, (10, 1))
    walk = tr.RandomWalk(dims=3, velocity_psd=0.1)
    with pytest.raises(tr.UnobservableError, match="ambiguous"):
        tr.ExtendedKalmanFilter(walk, array).run(times, values)
    sided = tr.RangeArray(flat, 1.0, side="below")
    assert tr.ExtendedKalmanFilter(walk, sided).run(times, values).means[-1, 2] == pytest.approx(440.0, abs=1e-3)
    with pytest.raises(tr.ParameterError, match="side = left"):
        array.fix(z, side="left")


def test_mistakes_are_named():
    with pytest.raises(tr.DimensionError, match="BATS array has size 6, expected 3"):
        tr.RangeArray.bats(TOSS)
    with pytest.raises(tr.DimensionError, match="TOSS array has size 3, expected 6"):
        tr.RangeArray.toss(BATS)
    with pytest.raises(tr.ParameterError, match="collinear in plan"):
        tr.RangeArray.bats(BATS * [1.0, 0.0, 1.0])
    with pytest.raises(tr.DimensionError, match="range_std"):
        tr.RangeArray(BATS, [1.0, 2.0])
    with pytest.raises(tr.ParameterError, match="depth_std"):
        tr.RangeArray(BATS[:, :2], 1.0, depth_std=0.3)
    with pytest.raises(tr.DimensionError, match="sound_speed"):
        tr.RangeArray(BATS, 1.0, sound_speed=[1500.0, 1500.0])
    with pytest.raises(tr.DimensionError, match=r"depth and speed \(n, 2\)"):
        tr.RangeArray(BATS, 1.0, sound_speed=np.ones((2, 3)))
    with pytest.raises(tr.ParameterError, match="must increase"):
        tr.RangeArray(BATS, 1.0, sound_speed=[[10.0, 1500.0], [0.0, 1500.0]])
    array = tr.RangeArray.bats(BATS)
    with pytest.raises(tr.UnobservableError, match="hydrophone of channel 2"):
        array.observe(BATS[2])
    with pytest.raises(tr.ParameterError, match="channel 1 = -5"):
        array.fix([700.0, -5.0, 700.0, 60.0])
    with pytest.raises(tr.ParameterError, match="range of channel 2 = 9000 m"):
        array.fix([700.0, 700.0, 9000.0, 60.0])
    with pytest.raises(tr.NonFiniteError, match="index 0"):
        array.fix([np.inf, 700.0, 700.0, 60.0])
    with pytest.raises(tr.UnobservableError, match="needs 2 ranges, 1 heard"):
        array.fix([np.nan, np.nan, 700.0, 60.0])
    line = tr.RangeArray([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [300.0, 0.0, 0.0]], 1.0)
    with pytest.raises(tr.UnobservableError, match="collinear"):
        line.fix([300.0, 280.0, 320.0])
    with pytest.raises(tr.DimensionError, match="position"):
        tr.ExtendedKalmanFilter(tr.ConstantVelocity(2, accel_std=1.0), array)


def test_configuration_file(tmp_path):
    file = tmp_path / "sonar.toml"
    text = """
[motion]
type = "constant_velocity"
dims = 3
accel_psd = 0.3

[sensors.array]
type = "range_array"
hydrophones = [[0, 0, 250], [1000, 0, 252], [500, 866, 248]]
range_std = 1.5
depth_std = 0.5
sound_speed = [[0, 1520], [100, 1490]]
side = "above"
columns = ["a", "b", "c", "depth"]

[tracker]
max_gap = 30.0
initiator = {m = 2, n = 3, max_speed = 12}

[input]
time = "t"
"""
    file.write_text(text)
    sensor = load_config(file).sensors["array"]
    assert sensor.labels == ("time0", "time1", "time2", "depth")
    assert sensor.side == "above"
    file.write_text(text.replace('"above"', '"left"'))
    with pytest.raises(ConfigError, match=r'side = "left" is unknown \(there are: above, below\)'):
        load_config(file)


def test_runs_that_cannot_start_say_why():
    array = tr.RangeArray.bats(BATS)
    ekf = tr.ExtendedKalmanFilter(jerk(), array)
    with pytest.raises(tr.UnobservableError, match="needs 3 ranges, 0 heard"):
        ekf.run(np.arange(5.0), np.full((5, 4), np.nan))
    with pytest.raises(tr.TimeError):
        ekf.run([1.0, 0.0], np.full((2, 4), np.nan))
    with pytest.raises(tr.NonFiniteError):
        ekf.run([1.0, 2.0], np.full((2, 4), np.inf))
    with pytest.raises(tr.ParameterError, match="pass initial=GaussianState"):
        tr.ExtendedKalmanFilter(jerk(), tr.LinearSensor(np.eye(3, 9), np.eye(3))).run([0.0], [[1.0, 1.0, 1.0]])


def test_negative_ranges_are_refused_by_row_or_rejected_by_a_screen():
    array = tr.RangeArray.bats(BATS)
    times, path, _ = manoeuvre()
    values = heard(array, path, np.random.default_rng(6))
    values[50, 1] = -20.0
    with pytest.raises(tr.ParameterError, match=r"measurement of channel 1 at row 50 = -20 .* must not be negative"):
        tr.ExtendedKalmanFilter(jerk(), array).run(times, values)
    run = tr.ExtendedKalmanFilter(jerk(), array, screen=tr.ChiSquareScreen()).run(times, values)
    assert run.verdicts[50, 1] == tr.Verdict.REJECTED
    assert tr.rmse(run.means[50:, :3] - path[50:]) < 2.0
    state = run[run.start]
    with pytest.raises(tr.ParameterError, match="channel 1 = -20"):
        tr.ExtendedKalmanFilter(jerk(), array).update(state, values[50])
    # A target on a hydrophone may be reported a little below zero.
    near = tr.RangeArray([[0.0, 0.0], [50.0, 0.0]], range_std=1.0)
    ekf = tr.ExtendedKalmanFilter(tr.RandomWalk(dims=2, velocity_psd=1.0), near)
    assert np.isfinite(ekf.update(tr.GaussianState([0.5, 0.5], np.eye(2)), [-0.4, 49.0]).posterior.mean).all()
