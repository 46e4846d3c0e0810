"""Extended targets: the stream by NumPy's generator, moments of every shape, what a filter is told, mistakes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import trackrs as tr
from deviates import Deviates
from trackrs.scenarios import (
    Blob,
    Ellipse,
    ExtendedTarget,
    LShape,
    Rectangle,
    crossing,
    extended_targets,
    parallel,
)

SHAPES = (Ellipse(), Rectangle(), LShape())


def point(shape, u, v):
    """A uniform point of a shape about its mean, along and across."""
    match shape:
        case Ellipse(a, b):
            return 0.5 * np.sqrt(u) * np.array([a * np.cos(2 * np.pi * v), b * np.sin(2 * np.pi * v)])
        case Rectangle(a, b):
            return np.array([a * (u - 0.5), b * (v - 0.5)])
        case LShape(a):
            return a * (np.array([2 * u, 0.0] if u < 0.5 else [0.0, 2 * u - 1.0]) - 0.25)
    return np.zeros(2)


@pytest.mark.parametrize(("shapes", "clutter", "detected"), [(Blob(15.0), 10.0, 0.99), (SHAPES, 3.0, 0.6)])
def test_detections_are_drawn_from_the_published_generator(shapes, clutter, detected):
    scene = crossing(shapes, clutter=clutter, detection_probability=detected)
    found, deviates = scene.draw(7, 3), Deviates(7, 3)
    values, origins = [[] for _ in range(100)], [[] for _ in range(100)]
    for i, target in enumerate(scene.targets):
        std = target.shape.spread if isinstance(target.shape, Blob) else 20.0
        for k, state in enumerate(scene.states[:, i]):
            if np.isnan(state[0]):
                continue
            seen = deviates.uniform() < detected
            along = state[2:] / np.hypot(*state[2:])
            turn = np.column_stack([along, [-along[1], along[0]]])
            for _ in range(deviates.poisson(target.rate)):
                place = turn @ point(target.shape, deviates.uniform(), deviates.uniform())
                noise = np.array([deviates.normal(), deviates.normal()])
                if seen:
                    values[k].append(state[:2] + place + std * noise)
                    origins[k].append(i)
    for k in range(100):
        for _ in range(deviates.poisson(clutter)):
            values[k].append([2000.0 * deviates.uniform() - 1000.0, 2000.0 * deviates.uniform() - 1000.0])
            origins[k].append(-1)
    for k, scan in enumerate(found.scans):
        assert (scan.time, scan.sensor) == (k + 1.0, "radar")
        assert found.origins[k].tolist() == origins[k]
        np.testing.assert_allclose(scan.values.reshape(-1, 2), np.reshape(values[k], (-1, 2)), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("shape", [Blob(), *SHAPES])
def test_moments_are_those_of_the_shape(shape):
    """Against moments by integration on a grid of the deviates, four standard errors each."""
    target = ExtendedTarget((0.0, 0.0, 3.0, -4.0), rate=40.0, shape=shape)
    scene = extended_targets([target], scans=500, clutter=0.0, detection_probability=1.0)
    detections = scene.draw(seed=11)
    centres = np.repeat(scene.states[:, 0, :2], [len(scan) for scan in detections.scans], axis=0)
    errors = np.concatenate([scan.values for scan in detections.scans]) - centres
    grid = (np.arange(400) + 0.5) / 400
    places = np.array([point(shape, u, v) for u in grid for v in grid]) @ np.array([[0.6, -0.8], [0.8, 0.6]])
    expected = places.T @ places / len(places) + 400.0 * np.eye(2)
    squares = errors[:, :, None] * errors[:, None, :]
    for sample, mean in ((errors, np.zeros(2)), (squares, expected)):
        assert np.all(np.abs(sample.mean(axis=0) - mean) < 4.0 * sample.std(axis=0) / np.sqrt(len(sample)))
    assert scene.sensor.noise()[0, 0] == pytest.approx(np.trace(expected) / 2, rel=1e-4)


def test_crossing_is_that_of_the_spec():
    scene = crossing()
    assert np.array_equal(scene.times, np.arange(1.0, 101.0))
    assert scene.states.shape == (100, 3, 4)
    np.testing.assert_allclose(scene.states[49, :, :2], 0.0, atol=1e-9)
    velocities = [[16.33, 12.24], [18.37, -2.04], [23.33, -23.33]]
    np.testing.assert_allclose(scene.states[49, :, 2:], velocities, atol=0.005)
    assert [(truth.id, truth.times[0], truth.times[-1]) for truth in scene.truth] == [
        ("0", 1.0, 100.0),
        ("1", 1.0, 100.0),
        ("2", 20.0, 90.0),
    ]
    assert [target.rate for target in scene.targets] == [10.0, 20.0, 40.0]
    assert [birth.mean.tolist() for birth in scene.births] == [
        [-800.0, -600.0, 0.0, 0.0],
        [-900.0, 100.0, 0.0, 0.0],
        [-700.0, 700.0, 0.0, 0.0],
    ]
    for birth in scene.births:
        assert birth.cov.tolist() == np.diag([2500.0, 2500.0, 625.0, 625.0]).tolist()
    told = (scene.birth_weight, scene.clutter_density, scene.detections_per_target, scene.detection_probability)
    assert told == (0.1, 2.5e-6, 20.0, 0.99)
    unit = np.eye(2)
    assert np.array_equal(scene.sensor.noise(), 400.0 * unit)
    assert np.array_equal(scene.motion.transition(1.0), np.block([[unit, unit], [0.0 * unit, unit]]))
    np.testing.assert_allclose(scene.motion.noise(1.0), 4.0 * np.kron([[0.25, 0.5], [0.5, 1.0]], unit))
    np.testing.assert_allclose(crossing(SHAPES).sensor.noise(), 650.0 * unit)
    np.testing.assert_allclose(crossing(SHAPES[0]).sensor.noise(), 650.0 * unit)
    np.testing.assert_allclose(crossing(Rectangle(24.0, 24.0)).sensor.noise(), 448.0 * unit)


def test_parallel_is_that_of_the_spec():
    for spacing in (80.0, 70.0):
        scene = parallel(spacing)
        assert scene.states[0].tolist() == [[-800.0, 600.0, 16.0, 0.0], [-800.0, 600.0 + spacing, 16.0, 0.0]]
        assert scene.states[99, :, 0].tolist() == [784.0, 784.0]
        assert (scene.detections_per_target, scene.clutter_density) == (10.0, 2.5e-6)
    wide, narrow = parallel().draw(1), parallel(70.0).draw(1)
    for scan, other, origins in zip(wide.scans, narrow.scans, wide.origins, strict=True):
        np.testing.assert_allclose(scan.values - other.values, np.outer(origins == 1, [0.0, 10.0]), atol=1e-9)


def test_runs_differ_only_where_they_should():
    rows = {}
    for clutter, detected in ((10.0, 1.0), (2.0, 1.0), (10.0, 0.5)):
        run = parallel(clutter=clutter, detection_probability=detected).draw(3, 1)
        values, origins = np.concatenate([scan.values for scan in run.scans]), np.concatenate(run.origins)
        rows[clutter, detected] = values[origins >= 0], values[origins < 0]
    plain = rows[10.0, 1.0]
    assert np.array_equal(plain[0], rows[2.0, 1.0][0])
    assert np.array_equal(plain[1], rows[10.0, 0.5][1])
    kept = rows[10.0, 0.5][0]
    assert 0.4 < len(kept) / len(plain[0]) < 0.6
    assert {row.tobytes() for row in kept} < {row.tobytes() for row in plain[0]}
    same, other = parallel().draw(3, 1), parallel().draw(3, 2)
    assert not np.array_equal(same.scans[0].values, other.scans[0].values)


def test_truth_and_scans_go_into_tracker_and_score():
    """A group from one birth region, one of which ends inside it."""
    pair = [ExtendedTarget((-800, 600, 16, 0)), ExtendedTarget((-800, 640, 16, 0), last=50.0)]
    scene = extended_targets(pair, births=[(-800.0, 620.0)], clutter=0.0)
    assert len(scene.births) == 1
    assert np.isnan(scene.states[50:, 1]).all()
    tracker = tr.MultiTargetTracker(
        scene.motion, {"radar": scene.sensor}, initiator=tr.MofN(3, 5, max_speed=50.0), detection_probability=0.9
    )
    centres = [
        tr.Scan(scan.time, [scan.values[origins == i].mean(axis=0) for i in np.unique(origins)], "radar")
        for scan, origins in zip(scene.draw(1).scans, scene.draw(1).origins, strict=True)
    ]
    score = tr.evaluate(scene.truth, tracker.run(centres), [tr.OSPA(c=60.0)])
    assert [target.id for target in score.per_target] == ["0", "1"]
    assert [target.present for target in score.per_target] == [100, 50]
    assert score.targets.tolist() == [2] * 50 + [1] * 50


def test_records_are_frozen_and_scans_may_be_none():
    scene = crossing()
    run = scene.draw(1)
    for values in (scene.times, scene.states, run.scans[0].values, run.origins[0]):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.truth = None
    assert "states" not in repr(scene)
    silent = extended_targets([ExtendedTarget((0, 0, 1, 0))], scans=1, clutter=0.0, detection_probability=0.0)
    assert [len(scan) for scan in silent.draw(1).scans] == [0]
    assert [len(origins) for origins in silent.draw(1).origins] == [0]


ONE = ExtendedTarget((0.0, 0.0, 1.0, 0.0))


@pytest.mark.parametrize(
    ("make", "error", "culprit"),
    [
        (lambda: extended_targets([]), tr.ParameterError, "targets = none"),
        (lambda: extended_targets([ONE], scans=-1), tr.ParameterError, "scans = -1"),
        (lambda: extended_targets([ONE], scans=0), tr.ParameterError, "life of target 0"),
        (lambda: extended_targets([ONE], interval=0.0), tr.ParameterError, "interval = 0"),
        (lambda: extended_targets([ONE], noise_std=-1.0), tr.ParameterError, "noise_std = -1"),
        (lambda: extended_targets([ONE], sensor_std=0.0), tr.ParameterError, "sensor_std = 0"),
        (lambda: extended_targets([ONE], births=[]), tr.DimensionError, "births must have 2 dimensions"),
        (lambda: extended_targets([ONE], births=np.zeros((0, 2))), tr.ParameterError, "births = none"),
        (lambda: extended_targets([ONE], births=[[1.0]]), tr.DimensionError, "births must have 2 columns, got 1"),
        (lambda: extended_targets([ONE], births=[[np.nan, 0.0]]), tr.NonFiniteError, "births"),
        (lambda: ExtendedTarget((0.0, 1.0)), tr.DimensionError, "start must be x, y, vx, vy, got 2"),
        (lambda: extended_targets([ExtendedTarget((0, 0, np.inf, 0))]), tr.NonFiniteError, "start of target 0"),
        (lambda: extended_targets([dataclasses.replace(ONE, last=0.5)]), tr.ParameterError, "life of target 0"),
        (lambda: extended_targets([dataclasses.replace(ONE, shape="disc")]), tr.ParameterError, "shape = 'disc'"),
        (lambda: crossing(clutter=-1.0), tr.ParameterError, "clutter = -1"),
        (lambda: crossing(detection_probability=1.5), tr.ParameterError, "detection_probability = 1.5"),
        (lambda: crossing(rates=(10, 20)), tr.DimensionError, "rates must be a number or 3"),
        (lambda: crossing(rates=0.0), tr.ParameterError, "rate of target 0 = 0"),
        (lambda: crossing(rates=1e9), tr.ParameterError, "mean detections in a scan"),
        (lambda: crossing(SHAPES[:2]), tr.DimensionError, "shapes must be one or 3, got 2"),
        (lambda: parallel(shapes=Blob(0.0)), tr.ParameterError, "spread = 0"),
        (lambda: parallel(shapes=Ellipse(width=-1.0)), tr.ParameterError, "width = -1"),
        (lambda: parallel(shapes=LShape(np.nan)), tr.ParameterError, "arm = NaN"),
        (lambda: parallel(np.nan), tr.NonFiniteError, "start of target 1"),
        (lambda: crossing().draw(-1), tr.ParameterError, "seed = -1"),
    ],
)
def test_every_mistake_is_named(make, error, culprit):
    with pytest.raises(error, match=culprit):
        make()
