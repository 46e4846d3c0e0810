"""Recorded heads. Only a minute of them is part of the project: the rest is tested where `TRACKRS_DATA` says it is."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr
from trackrs import rotation

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "benchmarks")]
import recorded_heads  # noqa: E402

HERE = "TRACKRS_DATA" in os.environ and (Path(os.environ["TRACKRS_DATA"]) / "hololens_head_6dof").is_dir()
WHY = "TRACKRS_DATA does not say where the recorded heads are"


@pytest.fixture(scope="module")
def minute():
    table = np.genfromtxt(ROOT / "examples" / "data" / "hmd360" / "user2.csv", delimiter=",", skip_header=1)
    vectors = rotation.vectors_from_quaternions(table[:, 1:])
    return recorded_heads.Trace("minute", table[:, 0], None, table[:, 1:], vectors)


def test_a_minute_of_a_head(minute):
    """No worse than the best extrapolation of this minute; the sign of quaternions means nothing."""
    result = recorded_heads.predict(minute, recorded_heads.HMD)
    assert result.angle.median <= 1.03
    assert result.angle.p95 <= 1.0
    signs = np.where(np.arange(len(minute.times)) % 3 == 0, -1.0, 1.0)[:, None]
    flipped = recorded_heads.Trace("flipped", minute.times, None, signs * minute.quaternions, minute.vectors)
    assert recorded_heads.predict(flipped, recorded_heads.HMD) == recorded_heads.Result(
        "flipped", None, result.angle, result.restarts
    )


def test_a_jump_of_the_recording_starts_the_filter_anew(minute):
    """A recentred headset: every attitude turned by 120 degrees from some time on."""
    vectors, jump = minute.vectors[:1200:2], 300
    turned = vectors.copy()
    # R exp(v) by two turns one after the other: between(-r, v) = log(exp(r) exp(v)).
    turned[jump:] = rotation.between(np.tile([0.0, 0.0, -2.1], (len(vectors) - jump, 1)), vectors[jump:])
    times, values = minute.times[:1200:2], rotation.quaternions_from_vectors(turned)
    run = recorded_heads.HMD.filter().run(times, values, lead=0.017)
    (again,) = run.restarts
    assert jump + 2 <= again <= jump + 4
    errors = np.linalg.norm(rotation.between(run.lead_means[again:-1, :3], turned[again + 1 :]), axis=1)
    assert errors.max() < 0.1


@pytest.mark.skipif(not HERE, reason=WHY)
def test_walking_people():
    results = [
        recorded_heads.predict(trace, recorded_heads.HOLOLENS)
        for trace in recorded_heads.recordings("hololens_head_6dof")
    ]
    position, angle = ([getattr(result, part).median for result in results] for part in ("position", "angle"))
    assert np.mean(position) <= 0.85
    assert max(position) <= 0.92
    assert np.mean(angle) <= 0.98
    assert max(angle) <= 1.01


@pytest.mark.skipif(not HERE, reason=WHY)
def test_seated_viewers():
    for trace in recorded_heads.recordings("hmd360_orientation"):
        result = recorded_heads.predict(trace, recorded_heads.HMD)
        assert result.angle.median <= 1.03
        assert result.angle.p95 <= 1.0


def test_steps_are_counted_where_stamps_jitter():
    """The same motion, stamped unevenly about a fixed rate: counted, it is predicted as with true times."""
    rng = np.random.default_rng(3)
    true = recorded_heads.HOLOLENS_PERIOD * np.arange(4000)
    stamps = np.maximum.accumulate(true + rng.uniform(-0.4, 0.4, len(true)) * recorded_heads.HOLOLENS_PERIOD)
    np.testing.assert_allclose(
        np.diff(tr.regularise(stamps, recorded_heads.HOLOLENS_PERIOD).times), recorded_heads.HOLOLENS_PERIOD
    )
