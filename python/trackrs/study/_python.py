"""Runs in which something is written in Python: a scenario, or a method."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, frozen
from trackrs.errors import DimensionError, TrackrsError
from trackrs.phd import _IntensityFilter
from trackrs.scenarios import CloseTargets, ExtendedTargets
from trackrs.study._metrics import item
from trackrs.study._shards import Part
from trackrs.study._study import Draw
from trackrs.tracker import Recorder
from trackrs.types import Scan, Tracks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from trackrs.study._study import Found, Method, Study


def run_python(study: Study, seed: int, first: int, runs: int) -> Part:
    """Run them here, one after the other."""
    values, seconds = np.full((runs, study._width), np.nan), np.zeros((runs, len(study.methods)))
    failures = []
    items = [item(metric) for metric in study.metrics]
    width = study._width // len(study.methods)
    for row in range(runs):
        draw = drawn(study.scenario, seed, first + row)
        if len(draw.scans) != len(study._times):
            msg = f"run {first + row} has {len(draw.scans)} scans, run 0 {len(study._times)}: all must have as many"
            raise DimensionError(msg)
        for i, method in enumerate(study.methods.values()):
            begun = time.perf_counter()
            try:
                found = _tracked(method, draw.scans)
                seconds[row, i] = time.perf_counter() - begun
                scores = _trackrs.score_tracks(items, draw.truth, *_rows(found, draw.truth.shape[2], len(draw.scans)))
            except TrackrsError as error:
                failures.append((first + row, i, str(error)))
                continue
            values[row, i * width : (i + 1) * width] = scores.ravel()
    return Part(first, frozen(values), frozen(seconds), tuple(failures))


def drawn(scenario: Any, seed: int, run: int) -> Draw:  # noqa: ANN401 (any scenario of scans)
    """Return scans and truth of a run."""
    if isinstance(scenario, CloseTargets):
        reports = scenario.draw(seed, run)
        size, count = scenario.scan_size, len(scenario.times)
        ends = [min(first + size, count) - 1 for first in range(0, count, size)]
        return Draw(reports.scans(), scenario.truth[ends, :, :2])
    if isinstance(scenario, ExtendedTargets):
        return Draw(scenario.draw(seed, run).scans, scenario.states[:, :, :2])
    out = scenario.draw(seed, run)
    if isinstance(out, Draw):
        return out
    msg = f"scenario.draw returned {type(out).__name__}: it must return trackrs.study.Draw(scans, truth)"
    raise TypeError(msg)


def _tracked(method: Method, scans: Sequence[Scan]) -> Found:
    if isinstance(method, Recorder):
        return type(method).from_bytes(method.to_bytes()).run(scans)
    if isinstance(method, _IntensityFilter):
        return method.run(scans)
    return method(scans)  # type: ignore[operator, no-any-return] # the study has checked it


def _rows(found: Found, dims: int, scans: int) -> tuple[list[int], Any, FloatArray]:
    """Return offsets, ids and positions."""
    if isinstance(found, Tracks):
        positions = array(found.means[:, :dims], "means", 2)
        return found.offsets.tolist(), np.ascontiguousarray(found.ids, dtype=np.uint64), positions
    parts = [np.zeros((0, dims)) if np.size(part) == 0 else array(part, "positions", 2) for part in found]
    if len(parts) != scans:
        msg = f"a method returned positions at {len(parts)} scans of {scans}"
        raise DimensionError(msg)
    offsets = [0, *np.cumsum([len(part) for part in parts]).tolist()]
    return offsets, np.zeros(offsets[-1], dtype=np.uint64), np.concatenate([np.zeros((0, dims)), *parts])
