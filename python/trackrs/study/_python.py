"""Runs in which something is written in Python: a scenario, or a method."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterable
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, frozen
from trackrs.errors import DimensionError, ParameterError, TrackrsError
from trackrs.phd import _IntensityFilter
from trackrs.scenarios import CloseTargets, ExtendedTargets
from trackrs.study._metrics import Identity, item
from trackrs.study._shards import Part
from trackrs.study._study import Draw
from trackrs.tracker import Recorder
from trackrs.types import Scan, Tracks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from trackrs.study._study import Study


def run_python(study: Study, seed: int, first: int, runs: int, stop: _trackrs.StudyStop) -> Part:
    """Run them here, one after the other; fewer if they are stopped."""
    values, seconds = np.full((runs, study._width), np.nan), np.zeros((runs, len(study.methods)))
    failures: list[tuple[int, int, str]] = []
    items = [item(metric) for metric in study.metrics]
    width = study._width // len(study.methods)
    identity = any(isinstance(metric, Identity) for metric in study.metrics)

    def part(done: int) -> Part:
        kept = tuple(failure for failure in failures if failure[0] < first + done)
        return Part(first, frozen(values[:done]), frozen(seconds[:done]), kept)

    done = 0
    while done < runs and not stop.is_set():
        run = first + done
        try:
            draw = drawn(study.scenario, seed, run)
        except Exception as error:
            error.add_note(f"while run {run} of a study with seed {seed} was drawn")
            raise
        if len(draw.scans) != len(study._times):
            msg = f"run {run} has {len(draw.scans)} scans, run 0 {len(study._times)}: all must have as many"
            raise DimensionError(msg)
        for i, method in enumerate(study.methods.values()):
            if stop.is_set():
                return part(done)
            begun = time.perf_counter()
            try:
                found = _tracked(method, draw.scans)
                seconds[done, i] = time.perf_counter() - begun
                rows = _rows(found, draw.truth.shape[2], len(draw.scans), identity=identity)
                scores = _trackrs.score_tracks(items, draw.truth, *rows)
            except Exception as error:  # noqa: BLE001 (whatever it is, the other methods and runs go on)
                seconds[done, i] = time.perf_counter() - begun
                failures.append((run, i, _reason(error)))
                continue
            values[done, i * width : (i + 1) * width] = scores.ravel()
        done += 1
    return part(done)


def _reason(error: Exception) -> str:
    """What happened, and of a mistake in somebody's own code where."""
    if isinstance(error, TrackrsError):
        return str(error)
    places = traceback.extract_tb(error.__traceback__)
    where = f" ({PurePath(places[-1].filename).name}, line {places[-1].lineno})" if places else ""
    return f"{type(error).__name__}: {error}{where}"


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
    raise ParameterError(msg)


def _tracked(method: Any, scans: Sequence[Scan]) -> object:  # noqa: ANN401 (the study has checked it)
    if isinstance(method, Recorder):
        return method.copy().run(scans)
    if isinstance(method, _IntensityFilter):
        return method.run(scans)
    return method(scans)


def _rows(found: object, dims: int, scans: int, *, identity: bool) -> tuple[list[int], Any, FloatArray]:
    """Return offsets, ids and positions."""
    if isinstance(found, Tracks):
        positions = array(found.means[:, :dims], "means", 2)
        return found.offsets.tolist(), np.ascontiguousarray(found.ids, dtype=np.uint64), positions
    if not isinstance(found, Iterable):
        msg = f"it returned {type(found).__name__}: it must return Tracks, or positions (k, d) at every scan"
        raise DimensionError(msg)
    parts = [np.zeros((0, dims)) if np.size(part) == 0 else array(part, "positions", 2) for part in found]
    if len(parts) != scans:
        msg = f"it returned positions at {len(parts)} scans of {scans}"
        raise DimensionError(msg)
    if identity:
        msg = "positions do not say whose they are: for the metric Identity a function must return Tracks"
        raise ParameterError(msg)
    offsets = [0, *np.cumsum([len(part) for part in parts]).tolist()]
    return offsets, np.zeros(offsets[-1], dtype=np.uint64), np.concatenate([np.zeros((0, dims)), *parts])
