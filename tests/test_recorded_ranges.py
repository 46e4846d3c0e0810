"""Recorded radio ranges. The walk is not part of the project: its tests run where `TRACKRS_DATA` says it is."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "benchmarks"), str(ROOT / "examples")]
import radio_ranges  # noqa: E402
import recorded_ranges  # noqa: E402

FOLDER = recorded_ranges.walk_folder()


def test_robot_by_ranges_alone():
    """The bounds outside the gap of 97 s; found again within ten seconds, from where on every estimate counts."""
    recording = radio_ranges.Recording()
    run = radio_ranges.ranges_only(recording)
    assert recording.times[run.start] < 10.0
    gap = int(np.argmax(np.diff(recording.times)))
    (again,) = run.restarts
    assert 0.0 < recording.times[again] - recording.times[gap + 1] < 10.0
    rows = radio_ranges.located(run)
    assert np.array_equal(np.flatnonzero(~rows), [*range(run.start), *range(gap + 1, again)])
    assert radio_ranges.rms(run.means, recording.truth, rows) <= 1.0
    smoothed = run.smooth().means
    assert radio_ranges.rms(smoothed, recording.truth, np.arange(len(run)) >= run.start) <= 0.42
    # A prediction over the gap knows how little it knows.
    lost = run[gap + 1]
    error = lost.mean[:2] - recording.truth[gap + 1]
    assert error @ np.linalg.solve(lost.cov[:2, :2], error) < tr.Gate(0.99).threshold(2)
    assert run.means[-1, run.labels.index("scale")] == pytest.approx(0.070, abs=0.001)


def test_robot_with_odometry():
    """Its recorded headings equal those of the truth, so this bound is an easy one."""
    recording = radio_ranges.Recording()
    run = radio_ranges.with_odometry(recording)
    assert run.restarts == ()
    assert recorded_ranges.scores(run, recording.truth)[0] <= 0.4


@pytest.mark.skipif(FOLDER is None, reason="TRACKRS_DATA does not say where isas_walk_uwb_3d is")
@pytest.mark.parametrize(("known", "bounds"), [(False, (0.40, 0.14)), (True, (0.19, 0.15))])
def test_walk(known, bounds):
    walk = recorded_ranges.Walk(FOLDER)
    run = recorded_ranges.walked(walk, known=known)
    assert run.start < 10
    assert run.restarts == ()
    used = (run.verdicts[run.start + 1 :] == tr.Verdict.USED).sum(axis=1)
    assert used.min() >= 3
    assert (recorded_ranges.scores(run, walk.truth) <= np.array(bounds)).all()
