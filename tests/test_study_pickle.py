"""What goes into a study pickles, and its digest tells one from another."""

from __future__ import annotations

import functools
import pickle
import subprocess
import sys
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import trackrs as tr
from studies import close_study, phd, tracker
from trackrs._value import digest
from trackrs.scenarios import Course, Ellipse, ExtendedTarget, Leg


def turn(states, dt):
    return states + dt


def measure(states):
    return states[:, :1]


HYDROPHONES = np.array([[0.0, 0.0, 100.0], [1000.0, 0.0, 100.0], [0.0, 1000.0, 100.0]])
MOTIONS = {
    "velocity": tr.ConstantVelocity(dims=2, accel_psd=[0.3, 0.2]),
    "acceleration": tr.ConstantAcceleration(dims=1, jerk_std=0.5),
    "walk": tr.RandomWalk(dims=2, velocity_std=1.0),
    "singer": tr.Singer(dims=2, accel_std=1.0, time_constant=[3.0, 4.0]),
    "linear": tr.LinearMotion([[1.0, 0.1], [0.0, 1.0]], 0.01 * np.eye(2)),
    "custom": tr.CustomMotion(turn, 0.1 * np.eye(2), labels=("a", "b")),
}
SENSORS = {
    "position": tr.PositionSensor(dims=2, std=[1.0, 2.0]),
    "polar": tr.RangeBearing((1.0, 2.0), 20.0, 1e-3),
    "array": tr.RangeArray(HYDROPHONES, 1.5, 0.5, bias_std=2.0),
    "pose": tr.PoseSensor(position_std=1e-3, angle_std=2e-3, attitude="euler"),
    "camera": tr.CameraSensor(np.eye(3), [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]], 0.5),
    "linear": tr.LinearSensor([[1.0, 0.0]], [[0.1]], offset=[3.0]),
    "custom": tr.CustomSensor(measure, [[0.2]], angles=(0,)),
}
ANGLE = (tr.ConstantAcceleration(dims=1, jerk_psd=1.0), tr.PositionSensor(dims=1, std=0.07))
FILTERS = {
    "kalman": tr.KalmanFilter(*ANGLE, tr.LimitedMemoryNoise(window=10), tr.ChiSquareScreen(alpha=0.02)),
    "extended": tr.ExtendedKalmanFilter(*ANGLE, tr.NisScaledNoise((1e-3, 1e3)), iterations=2),
    "unscented": tr.UnscentedKalmanFilter(*ANGLE, tr.ResidualNoise((1e-9, 1.0)), kappa=1.0, steps=2),
    "printed": tr.UnscentedKalmanFilter.as_printed(*ANGLE, r_limits=(1e-12, 1e4)),
    "cubature": tr.CubatureKalmanFilter(*ANGLE, form="square_root", horizon=2.0),
}
PLANE = (MOTIONS["velocity"], tr.PositionSensor(dims=2, std=20.0))
START = tr.GaussianState([0.0, 0, 0, 0], np.diag([50.0, 50, 25, 25]) ** 2)
PHDS = {
    "gm": tr.GMPHD(*PLANE, tr.AdaptiveBirth(0.1, 30.0), 1e-6, spawns=[tr.Spawn(0.1, np.zeros(4), np.eye(4))]),
    "cphd": tr.CPHD(*PLANE, tr.Birth([START]), 1e-6, max_targets=20),
    "extended": tr.ExtendedGMPHD(
        *PLANE, tr.Birth([START], [0.2]), 1e-6, tr.DetectionRate(8.0), extent=tr.Extent([40.0, 20.0])
    ),
}
SCENES = {
    "close": tr.scenarios.close_targets(4, clutter=0.2, order="random", scan_size=2),
    "crossing": tr.scenarios.crossing(Ellipse(), rates=12.0),
    "parallel": tr.scenarios.parallel(70.0, clutter=3.0),
    "extended": tr.scenarios.extended_targets([ExtendedTarget((0, 0, 5, 0))], births=[[0.0, 10.0]], scans=20),
    "underwater": tr.scenarios.underwater("toss", gross=0.1, missing=0.1),
    "course": tr.scenarios.underwater(
        tr.RangeArray(HYDROPHONES, 1.0, 0.3), course=replace(Course.reference(), legs=(Leg(30.0, 0.01),)), jerk_std=0.1
    ),
    "table": tr.scenarios.turntable(5.0, samples=20),
    "head": tr.scenarios.moving_head([(3.0, 0.2)], samples=30),
}


def same(first, second):
    assert type(first) is type(second)
    if isinstance(first, np.ndarray):
        assert first.tobytes() == second.tobytes()
    elif isinstance(first, tuple | list):
        assert len(first) == len(second)
        for one, other in zip(first, second, strict=True):
            same(one, other)
    elif hasattr(first, "__dataclass_fields__"):
        for field in fields(first):
            if not field.name.startswith("_"):
                same(getattr(first, field.name), getattr(second, field.name))
    else:
        assert first == second


def again(value):
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize("name", MOTIONS)
def test_motions(name):
    motion = MOTIONS[name]
    assert again(motion).labels == motion.labels
    assert digest(again(motion)) == digest(motion)
    if name != "custom":
        assert_array_equal(again(motion).noise(0.7), motion.noise(0.7))
        assert_array_equal(again(motion).transition(0.7), motion.transition(0.7))


@pytest.mark.parametrize("name", SENSORS)
def test_sensors(name):
    sensor = SENSORS[name]
    assert again(sensor).labels == sensor.labels
    assert digest(again(sensor)) == digest(sensor)
    same(again(sensor), sensor)


@pytest.mark.parametrize("name", FILTERS)
def test_filters_run_bit_equal(name):
    angles = tr.scenarios.turntable().draw(7)
    first, second = (
        one.run(angles.times, angles.values, initial=angles.initial) for one in (FILTERS[name], again(FILTERS[name]))
    )
    assert first.means.tobytes() == second.means.tobytes()
    assert first.covs.tobytes() == second.covs.tobytes()
    assert digest(again(FILTERS[name])) == digest(FILTERS[name])


@pytest.mark.parametrize("name", PHDS)
def test_intensity_filters_run_bit_equal(name):
    scans = tr.scenarios.crossing().draw(7).scans[:20]
    first, second = (one.run(scans) for one in (PHDS[name], again(PHDS[name])))
    assert first.means.tobytes() == second.means.tobytes()
    assert digest(again(PHDS[name])) == digest(PHDS[name])


@pytest.mark.parametrize("name", SCENES)
def test_scenarios_draw_bit_equal(name):
    scene, other = SCENES[name], again(SCENES[name])
    same(scene.draw(7, 3), other.draw(7, 3))
    same(scene, other)
    assert digest(other) == digest(scene)


def test_a_study_and_its_chunks():
    study = close_study()
    assert again(study).digest() == study.digest()
    assert again(study.chunk(7, 3, 2)).run().values.tobytes() == study.chunk(7, 3, 2).run().values.tobytes()
    result = study.run(3, 7)
    assert again(result).to_bytes() == result.to_bytes()


# --- the digest ------------------------------------------------------------------------------------------------------


def everything():
    yield close_study()
    scene = SCENES["crossing"]
    yield tr.Study(scene, {"phd": phd(scene), "function": Own(3.0)}, [tr.GOSPA(c=60.0)])
    yield tr.Study(SCENES["table"], FILTERS, [tr.study.PositionError(first=3), tr.study.LeadError(0.1)])


@dataclass(frozen=True)
class Own:
    offset: float

    def __call__(self, scans):
        return [np.full((1, 2), self.offset) for _ in scans]


def digests():
    return [study.digest() for study in everything()]


def test_another_process_gives_the_same_digest():
    script = "import sys; sys.path.insert(0, sys.argv[1]); import test_study_pickle as t; print(*t.digests())"
    # The module has this name here too, because of functions and classes that count with theirs.
    for seed in ("0", "12345"):
        out = subprocess.run(
            [sys.executable, "-c", script, str(Path(__file__).parent)],
            env={**__import__("os").environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        )
        here = out.stdout.split()
        if seed == "0":
            expected = here
        assert here == expected
    assert expected[0] == close_study().digest()
    assert len(set(expected)) == 3


def test_every_argument_changes_it():
    known = tracker()
    base = {"scenario": SCENES["close"], "methods": {"a": tracker(SCENES["close"])}, "metrics": [tr.OSPA(c=60.0)]}
    values = [
        tr.Study(**base),
        tr.Study(**base | {"scenario": tr.scenarios.close_targets(4, clutter=0.2, order="random")}),
        tr.Study(**base | {"methods": {"b": tracker(SCENES["close"])}}),
        tr.Study(**base | {"methods": {"a": known}}),
        tr.Study(**base | {"metrics": [tr.OSPA(c=60.0, p=1.0)]}),
        tr.Study(**base | {"metrics": [tr.GOSPA(c=60.0)]}),
    ]
    changed = (
        {"gate": tr.Gate(0.9)},
        {"associator": tr.NPDA(clutter_probability=0.2)},
        {"max_gap": 9.0},
        {"filter": "unscented"},
        {"initial": SCENES["close"].initial[:2]},
    )
    values += [tr.Study(**base | {"methods": {"a": tracker(SCENES["close"], **changes)}}) for changes in changed]
    found = [value.digest() for value in values]
    assert len(set(found)) == len(found)


CHANGES = {
    "motion": tr.ConstantVelocity(dims=2, accel_psd=[0.3, 0.3]),
    "sensor": tr.PositionSensor(dims=2, std=21.0),
    "birth": tr.Birth([START], 0.11),
    "clutter_density": 1.1e-6,
    "detections_per_target": 8.0,
    "survival_probability": 0.98,
    "detection_probability": 0.9,
    "filter": "unscented",
    "prune": 1e-5,
    "merge": 5.0,
    "max_components": 90,
    "confirm_after": 1,
    "end_after": 4,
    "strict": True,
    "late": tr.Replay(5.0),
    "partition": tr.DistancePartition(),
    "clutter_filter": tr.LocalOutlierFactor(),
    "superposition": False,
    "extent": tr.Extent([40.0, 30.0]),
    "spawns": (tr.Spawn(0.1, np.zeros(4), np.eye(4)),),
}


def test_every_argument_of_a_filter_changes_it():
    base = PHDS["extended"]
    assert {field.name for field in fields(base) if field.init} == set(CHANGES)
    found = {digest(base)} | {digest(replace(base, **{name: value})) for name, value in CHANGES.items()}
    assert len(found) == len(CHANGES) + 1


def test_the_same_call_is_the_same_however_it_was_written():
    assert digest(tr.scenarios.close_targets()) == digest(tr.scenarios.close_targets(3, separation=300.0))
    assert digest(tr.scenarios.crossing(clutter=10.0)) == digest(tr.scenarios.crossing())
    places = [[0.0, 10.0]]
    scene = tr.scenarios.extended_targets([ExtendedTarget((0, 0, 5, 0))], births=places)
    before = digest(scene)
    places[0][0] = 99.0
    assert digest(scene) == before


def test_functions_count_with_their_code():
    def made(k):
        return lambda scans: [k] * len(scans)

    values = [made(1), made(2), lambda scans, k=1: [k] * len(scans), functools.partial(turn, dt=1.0), turn]
    values += [functools.partial(turn, dt=2.0), Own(1.0), Own(2.0), Own(1.0).__call__, Own, np.sin, np.cos]
    values += [Loose(1), Loose(2), {1, 2}, {1, 3}, 1 + 2j]
    found = [digest(value) for value in values]
    assert len(set(found)) == len(found)
    assert digest(made(1)) == digest(made(1))
    for value in (np.random.default_rng(1), iter([1])):
        with pytest.raises(tr.ParameterError, match="cannot be told"):
            digest(value)


class Loose:
    def __init__(self, k):
        self.k = k
