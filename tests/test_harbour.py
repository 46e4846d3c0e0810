"""The recorded harbour, scored: one parameter set for five recordings (examples/harbour.toml)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import trackrs as tr
from trackrs.config import load_config
from trackrs.io import read_scans, read_truth

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
SCENARIOS = ("scenario02", "scenario03", "scenario05", "scenario13", "scenario16")


def scored(name):
    config = load_config(EXAMPLES / name)
    out = []
    for scenario in SCENARIOS:
        folder = EXAMPLES / "data" / "autoferry" / scenario
        recording = read_scans(folder / "detections.csv", folder / "scans.csv", config.columns, config.input)
        tracker = config.make_tracker()
        tracks = tracker.run(recording.scans)
        assert tracker.ledger.rows_in == tracker.ledger.used
        score = tr.evaluate(
            read_truth(folder / "truth.csv", config.truth),
            tracks,
            [tr.GOSPA(c=30.0, p=2.0, alpha=2.0)],
            sensor="radar",
            start=15.0,
            region=250.0,
            centres=recording.platforms,
        )
        out.append(score)
    return out


@pytest.fixture(scope="module")
def scores():
    return scored("harbour.toml")


def test_gospa(scores):
    means = [next(iter(score.mean.values())) for score in scores]
    assert np.mean(means) <= 11.0
    assert max(means) <= 15.0


def test_both_vessels_are_held(scores):
    assert np.mean([score.all_held for score in scores]) >= 0.80


def test_false_tracks_and_switches(scores):
    assert np.mean([score.false_per_minute for score in scores]) <= 0.5
    assert sum(score.switches for score in scores) <= 3


def test_position_nees_is_reported(scores):
    assert all(np.isfinite(score.nees) for score in scores)


def test_with_existence_probabilities():
    scores = scored("harbour_jipda.toml")
    means = [next(iter(score.mean.values())) for score in scores]
    assert np.mean(means) <= 9.5
    assert max(means) <= 13.0
    assert np.mean([score.all_held for score in scores]) >= 0.85
    assert np.mean([score.false_per_minute for score in scores]) <= 0.5
    assert sum(score.switches for score in scores) <= 1
