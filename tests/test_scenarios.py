"""Scenarios: the streams by NumPy's generator, the course by another integration, the reference tables."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr
from courses import jerk
from deviates import Deviates
from trackrs.scenarios import Course, Leg, close_targets, underwater

DATA = Path(__file__).parent / "data"


@pytest.mark.parametrize(("seed", "run"), [(0, 0), (7, 3), (2**64 - 1, 2**40)])
def test_recording_is_drawn_from_the_published_generator(seed, run):
    scene = underwater("bats", gross=0.1, missing=0.1)
    recording = scene.draw(seed, run)
    deviates, std = Deviates(seed, run), np.sqrt(np.diagonal(scene.array.noise()))
    for k, state in enumerate(scene.truth):
        expected = scene.array.observe(state).copy()
        for i in range(4):
            expected[i] += std[i] * deviates.normal()
            hit, size, sign, lost = (deviates.uniform() for _ in range(4))
            if k >= 3 and i < 3 and hit < 0.1:
                expected[i] += (-1.0 if sign < 0.5 else 1.0) * (10.0 + 90.0 * size)
            if k >= 3 and lost < 0.1:
                expected[i] = np.nan
        # libm and the system's sine may differ in the last digit.
        np.testing.assert_allclose(recording.values[k], expected, rtol=1e-14)


def test_golden_streams_are_numpy_s():
    golden = json.loads((DATA / "streams.json").read_text())
    for case in golden["streams"]:
        seed = np.random.SeedSequence(int(case["seed"]), spawn_key=(int(case["run"]),))
        assert [str(b) for b in np.random.PCG64(seed).random_raw(4)] == case["bits"]


def test_course_is_the_integral_of_its_rates():
    """Straight, 3°/s, straight, 3 m/s down, -4°/s; the rates rise and fall in 2 s inside their legs."""
    scene = underwater()
    assert np.array_equal(scene.times, np.arange(161.0))
    fine = 500
    t = (np.arange(160 * fine) + 0.5) / fine  # midpoints

    def leg(begin, end):
        return np.clip(np.minimum(t - begin, end - t) / 2.0, 0.0, 1.0)

    rate = np.radians(3.0 * leg(40.0, 80.0) - 4.0 * leg(130.0, 160.0))
    heading = np.radians(20.0) + (np.cumsum(rate) - rate / 2.0) / fine
    sink = 3.0 * leg(100.0, 130.0)
    level = np.sqrt(225.0 - sink**2)
    velocity = np.stack([level * np.cos(heading), level * np.sin(heading), sink], axis=1)
    path = np.array([-300.0, -250.0, 50.0]) + np.vstack([np.zeros(3), np.cumsum(velocity, axis=0) / fine])
    np.testing.assert_allclose(scene.truth[:, :3], path[::fine], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(scene.truth[:, 3:6], axis=1), 15.0, rtol=1e-14)


def test_arrays_are_those_of_the_spec():
    bats, toss = underwater("bats").array, underwater("toss").array
    assert bats.hydrophones.tolist() == [[0.0, 0.0, 250.0], [1000.0, 0.0, 252.0], [500.0, 866.0, 248.0]]
    azimuth = np.radians(15.0 + 60.0 * np.arange(6))
    rows = [
        700.0 + 1200.0 * np.cos(azimuth),
        500.0 + 1200.0 * np.sin(azimuth),
        [300.0, 312.0, 292.0, 315.0, 288.0, 305.0],
    ]
    np.testing.assert_allclose(toss.hydrophones, np.transpose(rows), rtol=1e-14)
    assert np.sqrt(np.diagonal(bats.noise())).tolist() == [1.0, 1.0, 1.0, 0.3]
    assert np.diagonal(underwater("toss", range_std=2.0).array.noise()).tolist() == [4.0] * 6


@pytest.mark.parametrize(("array", "mean", "error"), [("bats", 1.127, 0.03), ("toss", 1.483, 0.045)])
def test_reference_table(array, mean, error):
    """Reference: 1.127 ± .010 and 1.483 ± .016 m over 200 runs; three standard errors of the difference to 60 here."""
    scene = underwater(array)
    ekf = tr.ExtendedKalmanFilter(jerk(0.1), scene.array)
    runs = [ekf.run(scene.times, scene.draw(seed=2, run=k).values) for k in range(60)]
    rms = [tr.rmse(run.means[12:, :3] - scene.truth[12:, :3]) for run in runs]
    assert np.mean(rms) == pytest.approx(mean, abs=error)


def test_truth_drawn_from_the_model():
    course = replace(Course.reference(), legs=(Leg(40.0),))
    scene = underwater("toss", course=course, jerk_std=0.05)
    assert scene.truth.shape == (0, 9)
    a, b = scene.draw(1, 0), scene.draw(1, 1)
    assert a.truth.shape == (41, 9)
    assert np.array_equal(a.truth[0], b.truth[0])
    assert not np.array_equal(a.truth[1], b.truth[1])
    jerks = np.concatenate([np.diff(scene.draw(1, k).truth[:, 6:], axis=0) for k in range(50)]).ravel()
    assert np.std(jerks) == pytest.approx(0.05, rel=0.05)  # 6000 of them: a standard error of 1 %
    step = tr.ConstantAcceleration(dims=3, jerk_std=0.05)
    noise = a.truth[1, 6:] - a.truth[0, 6:]
    gain = np.kron([[1.0 / 6.0], [0.5], [1.0]], np.eye(3))
    np.testing.assert_allclose(a.truth[1], step.transition(1.0) @ a.truth[0] + gain @ noise, rtol=1e-12)


def test_own_course_and_array():
    array = tr.RangeArray(underwater("toss").array.hydrophones, 2.0, sound_speed=1500.0, side="above")
    course = Course(start=(0.0, 100.0, 40.0), heading=np.pi / 2, speed=5.0, ramp=1.0, legs=(Leg(10.0), Leg(5.0, 0.1)))
    scene = underwater(array, course=course, dt=0.5, gross=1.0)
    assert scene.times[-1] == 15.0
    np.testing.assert_allclose(scene.truth[20, :3], [0.0, 150.0, 40.0], atol=1e-9)
    recording = scene.draw(seed=1)
    clean = underwater(array, course=course, dt=0.5).draw(seed=1)
    metres = 1500.0 * np.abs(recording.values - clean.values)[3:]
    assert recording.gross[3:].all()
    assert ((metres > 9.999) & (metres < 100.001)).all()
    assert underwater(course=Course.reference()).draw(1).values.tolist() == underwater().draw(1).values.tolist()


def test_records_are_frozen_and_mistakes_are_named():
    scene = underwater()
    recording = scene.draw(1)
    for values in (scene.times, scene.truth, recording.values, recording.gross, recording.truth):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.truth = None
    with pytest.raises(tr.ParameterError, match='array = "sonar" is invalid'):
        underwater("sonar")
    with pytest.raises(tr.ParameterError, match=r"gross = 1\.5"):
        underwater(gross=1.5)
    with pytest.raises(tr.ParameterError, match="twice the ramp"):
        underwater(course=replace(Course.reference(), legs=(Leg(3.0, turn_rate=0.1),)))
    with pytest.raises(tr.DimensionError, match="position of the motion"):
        underwater(tr.RangeArray([[0.0, 0.0], [1.0, 0.0]], 1.0))
    with pytest.raises(tr.ParameterError, match="seed = -1"):
        scene.draw(-1)
    with pytest.raises(tr.ParameterError, match="run = 18446744073709551616"):
        scene.draw(1, 2**64)
    with pytest.raises(TypeError):
        scene.draw(1.5)


@pytest.mark.parametrize(("order", "clutter"), [("cyclic", 0.0), ("random", 0.3), ("boustrophedon", 0.3)])
def test_close_targets_are_drawn_from_the_published_generator(order, clutter):
    scene = close_targets(separation=150.0, order=order, clutter=clutter)
    reports, deviates = scene.draw(7, 3), Deviates(7, 3)
    assert scene.clutter_area == 4000.0 * 650.0
    turns = {"cyclic": [0, 1, 2, 0, 1, 2], "boustrophedon": [0, 1, 2, 2, 1, 0]}
    for k, time in enumerate(scene.times):
        assert time == 3.0 * (k + 1)
        target = int(3 * deviates.uniform())
        if order in turns:
            target = turns[order][k % 6]
        state = np.array([500.0 + 100.0 * time, 1000.0 + 150.0 * target, 100.0, 0.0])
        assert np.array_equal(scene.truth[k, target], state)
        expected = scene.radar.observe(state) + np.array([20.0 * deviates.normal(), 1e-3 * deviates.normal()])
        false = deviates.uniform() < clutter
        offset = [2000.0 * deviates.uniform() - 1000.0, 1300.0 * deviates.uniform() - 650.0]
        if false:
            expected = scene.radar.observe([state[0] + offset[0], 1150.0 + offset[1], 0.0, 0.0])
        assert reports.origins[k] == (-1 if false else target)
        assert np.allclose(reports.values[k], expected, rtol=1e-12)
    assert [len(scan) for scan in reports.scans(7)] == [7] * 8 + [4]
    for name, value in [("targets", 0), ("separation", 0.0), ("clutter", 1.5), ("order", "any"), ("interval", -1.0)]:
        with pytest.raises(tr.ParameterError, match=name):
            close_targets(**{name: value})
