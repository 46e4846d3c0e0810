"""Monte-Carlo studies: a scenario, several methods, several metrics, many runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, frozen, frozen_array
from trackrs._value import Value, digest
from trackrs.errors import DimensionError, ParameterError
from trackrs.filter import _SequenceFilter
from trackrs.phd import _IntensityFilter
from trackrs.scenarios import CloseTargets, ExtendedTargets, Turning, Underwater
from trackrs.scenarios._stream import stream_number
from trackrs.study._engines import dask, local, processors
from trackrs.study._metrics import Item, Metric, item
from trackrs.study._result import Column, StudyResult, result_of
from trackrs.study._shards import Part, Shards
from trackrs.tracker import Recorder

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from trackrs.filter import (
        CubatureKalmanFilter,
        ExtendedKalmanFilter,
        KalmanFilter,
        UnscentedKalmanFilter,
    )
    from trackrs.phd import CPHD, GMPHD, ExtendedGMPHD
    from trackrs.types import Scan, Tracks

PIECE = 0.05  # seconds between two looks for Ctrl-C
BUILT_IN = (CloseTargets, ExtendedTargets, Turning, Underwater)


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """One run of a scenario of one's own.

    Args:
        scans: what the sensors report, in the order of their times.
        truth: (S, N, d) where every target is at each scan, metres; NaN where it is not there.
    """

    scans: Sequence[Scan]
    truth: FloatArray

    def __post_init__(self) -> None:
        """Check the truth."""
        truth = frozen_array(self.truth, "truth", 3)
        if len(truth) != len(self.scans):
            msg = f"truth has {len(truth)} rows for {len(self.scans)} scans"
            raise DimensionError(msg)
        object.__setattr__(self, "scans", tuple(self.scans))
        object.__setattr__(self, "truth", truth)


@runtime_checkable
class Scenario(Protocol):
    """A scenario of one's own: every run has as many scans, and run k depends on seed and k alone."""

    def draw(self, seed: int, run: int) -> Draw:
        """Return run number `run`."""
        ...


# What a method of one's own gives: tracks, or the positions (k, d) found at every scan.
Found: TypeAlias = "Tracks | Sequence[ArrayLike]"
Method: TypeAlias = """
    Recorder | ExtendedGMPHD | GMPHD | CPHD | KalmanFilter | ExtendedKalmanFilter | UnscentedKalmanFilter
    | CubatureKalmanFilter | Callable[[Sequence[Scan]], Found]
"""


@dataclass(frozen=True, slots=True)
class Chunk(Value):
    """Some consecutive runs of a study: what is sent to another process or machine. It pickles.

    Attributes:
        study: to which they belong.
        seed: of the study.
        first: number of the first run.
        runs: how many.

    Raises:
        ParameterError: a number is out of range.
    """

    study: Study
    seed: int
    first: int
    runs: int

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("seed", "first", "runs"):
            stream_number(name, getattr(self, name))
        stream_number("first + runs", self.first + self.runs)

    def run(self) -> Part:
        """Run them here, one after the other."""
        return self.study._run(self.seed, self.first, self.runs, _trackrs.StudyStop())


@dataclass(frozen=True, slots=True, eq=False)
class Study(Value):
    """A Monte-Carlo study: methods that get the same draws of a scenario, run by run.

    Args:
        scenario: one of `trackrs.scenarios`, or an object with `draw(seed, run) -> Draw`.
        methods: what is tried, by name. In scenarios of scans trackers and intensity filters, as they stand, and
            functions that take the scans of a run and return `Tracks` or the positions (k, d) at every scan; in those
            of one target filters. What is written in Python takes part at Python's speed.
        metrics: what is recorded: `OSPA`, `GOSPA`, `Cardinality` and `Identity` of scans, `PositionError` and
            `LeadError` of one target.

    Raises:
        ParameterError: methods, metrics and scenario do not go together.

    Example:
        >>> import trackrs as tr
        >>> scene = tr.scenarios.turntable()
        >>> motion, sensor = tr.ConstantAcceleration(dims=1, jerk_psd=1.0), tr.PositionSensor(dims=1, std=scene.std)
        >>> filters = {
        ...     "default": tr.UnscentedKalmanFilter(motion, sensor),
        ...     "printed": tr.UnscentedKalmanFilter.as_printed(motion, sensor, r_limits=(1e-12, 1e4)),
        ... }
        >>> result = tr.Study(scene, filters, [tr.study.LeadError(first=20)]).run(runs=20, seed=7)
        >>> gap = result.compare("default", "printed", "lead_error")
        >>> gap.high < 0.0, gap.p_value < 0.001
        (True, True)
    """

    scenario: Scenario | CloseTargets | ExtendedTargets | Turning | Underwater
    methods: Mapping[str, Method]
    metrics: Sequence[Metric]
    _core: _trackrs.Study | None = field(init=False, repr=False)
    _columns: tuple[Column, ...] = field(init=False, repr=False)
    _times: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check that all goes together."""
        methods = {name: _snapshot(name, method) for name, method in _named(self.methods).items()}
        metrics: object = self.metrics
        if not isinstance(metrics, Sequence) or not metrics:
            msg = "metrics must be a list of at least one, such as [tr.OSPA(c=60.0)]"
            raise ParameterError(msg)
        items = [item(metric) for metric in self.metrics]
        columns = tuple(Column(*column) for column in _trackrs.study_columns(items))
        names = [column.name for column in columns]
        if len(set(names)) < len(names):
            msg = "metrics record the same column twice; use two studies with the same seed"
            raise ParameterError(msg)
        compiled = {name: _core(method) for name, method in methods.items()}
        core = None
        if isinstance(self.scenario, BUILT_IN):
            scans = isinstance(self.scenario, CloseTargets | ExtendedTargets)
            given = [(name, one) for name, one in compiled.items() if one is not None]
            if len(given) < len(methods) and not scans:
                msg = "methods: in scenarios of one target they must be filters of trackrs"
                raise ParameterError(msg)
            size = self.scenario.scan_size if isinstance(self.scenario, CloseTargets) else 1
            core = _trackrs.Study(self.scenario._core, size, given, items)
            times = core.times()
        elif callable(getattr(self.scenario, "draw", None)) and not isinstance(self.scenario, type):
            times = _own_times(self.scenario, methods, items)
        else:
            msg = f"scenario = {self.scenario!r} is invalid: must be one of trackrs.scenarios or have draw(seed, run)"
            raise ParameterError(msg)
        values = {
            "methods": methods,
            "metrics": tuple(self.metrics),
            "_core": None if None in compiled.values() else core,
            "_columns": columns,
            "_times": frozen(times),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def run(
        self,
        runs: int = 200,
        seed: int = 0,
        *,
        folder: str | Path | None = None,
        engine: Literal["local", "dask"] = "local",
        workers: int | None = None,
        client: object = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> StudyResult:
        """Run the study: runs 0 to `runs` - 1, the same whatever runs them.

        Args:
            runs: how many.
            seed: from 0 to 2⁶⁴ - 1.
            folder: keep finished runs there and go on from those that are there: a study that is killed, or stopped by
                Ctrl-C, loses at most the runs in flight.
            engine: "local" for threads of this process; "dask" for a Dask cluster, whose lost workers' runs are run
                again (`pip install "trackrs[dask]"`).
            workers: how many, None for all processors of this process.
            client: of an existing Dask cluster; None starts a local one of so many workers.
            progress: called with the numbers of finished and of all runs, at the beginning too.

        Raises:
            ParameterError: a number is out of range, or the folder cannot be made.
            StateError: `folder` belongs to another study or seed, or holds something else.
        """
        seed, runs = stream_number("seed", seed), stream_number("runs", runs)
        self._check_memory(runs)
        count = processors() if workers is None else stream_number("workers", workers)
        if count < 1:
            msg = f"workers = {workers} is invalid: must be at least 1"
            raise ParameterError(msg)
        if client is not None and engine != "dask":
            msg = 'client: only engine="dask" has one'
            raise ParameterError(msg)
        if engine not in {"local", "dask"}:
            msg = f'engine = {engine!r} is invalid: must be "local" or "dask"'
            raise ParameterError(msg)
        with ExitStack() as stack:
            shards = None
            parts: list[Part] = []
            if folder is not None:
                shards = stack.enter_context(Shards(folder, self.digest(), seed, self._width, len(self.methods)))
                parts = shards.parts()
            missing = np.ones(runs, dtype=bool)
            for part in parts:
                missing[part.first : part.first + len(part.values)] = False
            todo, done = _stretches(missing), runs - int(missing.sum())
            if progress is not None:
                progress(done, runs)
            pieces = local(self, seed, todo, count) if engine == "local" else dask(self, seed, todo, count, client)
            for part in stack.enter_context(closing(pieces)):
                parts.append(part)
                if shards is not None:
                    shards.append(part)
                done += len(part.values)
                if progress is not None:
                    progress(done, runs)
        return self.merge(parts, seed, runs)

    def chunk(self, seed: int, first: int, runs: int) -> Chunk:
        """Return the runs `first` to `first + runs - 1`, to be run anywhere."""
        return Chunk(self, seed, first, runs)

    def chunks(self, runs: int, seed: int, size: int) -> list[Chunk]:
        """Return runs 0 to `runs` - 1 in chunks of `size` runs, of which the last may have fewer.

        Raises:
            ParameterError: a number is out of range.
        """
        if stream_number("size", size) < 1:
            msg = f"size = {size} is invalid: must be at least 1"
            raise ParameterError(msg)
        return [self.chunk(seed, first, min(size, runs - first)) for first in range(0, runs, size)]

    def merge(self, parts: Iterable[Part], seed: int, runs: int) -> StudyResult:
        """Return the result of parts in any order; of runs that are there twice the first counts.

        Raises:
            ParameterError: a run is missing, or a part is of another study.
        """
        self._check_memory(runs)
        values, seconds = np.full((runs, self._width), np.nan), np.full((runs, len(self.methods)), np.nan)
        missing = np.ones(runs, dtype=bool)
        failures = []
        for part in parts:
            shape = (part.values.shape[1], part.seconds.shape[1])
            if shape != (self._width, len(self.methods)):
                msg = f"a part is of another study: it has {shape[0]} numbers a run, this one {self._width}"
                raise ParameterError(msg)
            rows = np.flatnonzero(missing[part.first : part.first + len(part.values)])
            new = rows + part.first
            values[new], seconds[new] = part.values[rows], part.seconds[rows]
            missing[new] = False
            fresh = set(new.tolist()) if part.failures else set()
            failures += [failure for failure in part.failures if failure[0] in fresh]
        if missing.any():
            msg = f"run {int(np.argmax(missing))} of {runs} is missing"
            raise ParameterError(msg)
        methods = [(name, self._times, self._columns) for name in self.methods]
        return result_of(seed, methods, np.arange(runs), values, seconds, failures)

    def digest(self) -> str:
        """Return a number for what the study is: scenario, methods, metrics and version; of functions their code.

        Raises:
            ParameterError: the content of a scenario or method cannot be told.
            StateError: a tracker has models written in Python.
        """
        from trackrs import __version__  # noqa: PLC0415 (the package imports this module)

        return digest([__version__, self.scenario, self.methods, self.metrics])

    @property
    def _width(self) -> int:
        """Numbers per run."""
        return len(self.methods) * len(self._columns) * len(self._times)

    def _check_memory(self, runs: int) -> None:
        try:
            np.empty((runs, max(self._width, 1)))
        except (MemoryError, ValueError):
            size = 8e-9 * runs * self._width
            msg = f"runs = {runs} is invalid: {size:.0f} GB of results are too much for this machine"
            raise ParameterError(msg) from None

    def _run(self, seed: int, first: int, runs: int, stop: _trackrs.StudyStop) -> Part:
        """Run them one after the other; fewer if they are stopped."""
        if self._core is not None:
            return _in_pieces(self._core, seed, first, runs, stop)
        from trackrs.study._python import run_python  # noqa: PLC0415 (only those who need it)

        return run_python(self, seed, first, runs, stop)


def _in_pieces(core: _trackrs.Study, seed: int, first: int, runs: int, stop: _trackrs.StudyStop) -> Part:
    """Run some at a time: between two calls Python looks for Ctrl-C."""
    pieces: list[dict[str, Any]] = []
    done, size = 0, 1
    while True:
        begun = time.perf_counter()
        pieces.append(core.run(seed, first + done, min(size, runs - done), stop))
        done += len(pieces[-1]["values"])
        if done == runs or stop.is_set():
            break
        size = max(1, int(PIECE * size / max(time.perf_counter() - begun, 1e-6)))
    values, seconds = (frozen(np.concatenate([piece[name] for piece in pieces])) for name in ("values", "seconds"))
    return Part(first, values, seconds, tuple(failure for piece in pieces for failure in piece["failures"]))


def _named(methods: object) -> Mapping[str, Method]:
    """The methods, if that is what they are."""
    if not isinstance(methods, Mapping) or not methods:
        msg = 'methods must be a dictionary of at least one, by name, such as {"default": tracker}'
        raise ParameterError(msg)
    for name in methods:
        if not isinstance(name, str) or not name:
            msg = f"method = {name!r} is invalid: names must be text"
            raise ParameterError(msg)
    return methods


def _snapshot(name: str, method: Any) -> Any:  # noqa: ANN401 (what the user gave)
    """A method as it stands now."""
    if isinstance(method, Recorder):
        return method.copy()
    if isinstance(method, _SequenceFilter | _IntensityFilter) or callable(method):
        return method
    msg = f"method = {name} is invalid: must be a tracker, a filter, or a function of scans, not {method!r}"
    raise ParameterError(msg)


def _core(method: Method) -> Any:  # noqa: ANN401 (one of three compiled types)
    """The compiled method; None of one written in Python."""
    if isinstance(method, _IntensityFilter):
        return method.start()._core
    return method._core if isinstance(method, Recorder | _SequenceFilter) else None


def _own_times(scenario: Scenario, methods: Mapping[str, Method], items: Sequence[Item]) -> FloatArray:
    """Check what goes with a scenario of one's own, and return the times of its scans."""
    for name, method in methods.items():
        if isinstance(method, _SequenceFilter):
            msg = f"method = {name} is invalid: must be a tracker: the scenario gives scans"
            raise ParameterError(msg)
    if any(kind in {"position", "lead"} for kind, _, _ in items):
        msg = "metrics: PositionError and LeadError go with the scenarios of trackrs of one target"
        raise ParameterError(msg)
    # One step without targets and tracks: the parameters of the metrics are checked.
    _trackrs.score_tracks(items, np.zeros((1, 0, 1)), [0, 0], np.zeros(0, dtype=np.uint64), np.zeros((0, 1)))
    draw: object = scenario.draw(0, 0)
    if not isinstance(draw, Draw):
        msg = f"scenario.draw returned {type(draw).__name__}: it must return trackrs.study.Draw(scans, truth)"
        raise ParameterError(msg)
    return np.array([scan.time for scan in draw.scans], dtype=np.float64)


def _stretches(missing: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and number of every stretch of consecutive runs."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
    return [(int(first), int(last - first)) for first, last in edges.reshape(-1, 2)]
