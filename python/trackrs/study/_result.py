"""What a study gives."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs._arrays import frozen
from trackrs.errors import ParameterError
from trackrs.study._statistics import bands, difference, summarise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from trackrs._arrays import FloatArray, IntArray
    from trackrs.study._statistics import Difference, Summary


@dataclass(frozen=True, slots=True)
class Column:
    """What is recorded at every step.

    Attributes:
        name: for example "ospa".
        summary: what makes one number of the steps of a run: "mean", "rms" or "last".
    """

    name: str
    summary: str

    def reduced(self, values: FloatArray) -> FloatArray:
        """Return one number per run of (R, S) values; steps that are NaN are left out."""
        known = np.isfinite(values)
        filled = np.where(known, values, 0.0)
        counts = known.sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            if self.summary == "rms":
                return np.asarray(np.sqrt((filled**2).sum(axis=1) / counts))
            if self.summary == "mean":
                return np.asarray(filled.sum(axis=1) / counts)
        return values[:, -1] if values.shape[1] else np.full(len(values), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A mean over runs at every step.

    Attributes:
        times: (S,) seconds.
        mean: (S,) over the runs that have a value.
        half_width: (S,) half of a 95 % interval of this mean (normal approximation).
    """

    times: FloatArray
    mean: FloatArray
    half_width: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MethodResult:
    """One method in all runs.

    Attributes:
        name: of the method.
        times: (S,) seconds, of the steps.
        columns: what is recorded.
        values: (R, C, S) per run, column and step; NaN where there is nothing to score or the method failed.
        seconds: (R,) what each run took, the drawing and the scoring not counted.
    """

    name: str
    times: FloatArray = field(repr=False)
    columns: tuple[Column, ...]
    values: FloatArray = field(repr=False)
    seconds: FloatArray = field(repr=False)

    def series(self, column: str) -> FloatArray:
        """Return one column, (R, S).

        Raises:
            ParameterError: the study has no such column.
        """
        return self.values[:, self._index(column)]

    def per_run(self, column: str) -> FloatArray:
        """Return one number per run, (R,)."""
        index = self._index(column)
        return self.columns[index].reduced(self.values[:, index])

    def summary(self, column: str) -> Summary:
        """Return the mean over the runs with its interval."""
        return summarise(self.per_run(column))

    def over_time(self, column: str) -> Band:
        """Return the mean over the runs at every step."""
        return Band(self.times, *bands(self.series(column)))

    def _index(self, column: str) -> int:
        names = [one.name for one in self.columns]
        if column in names:
            return names.index(column)
        msg = f"column = {column!r} is invalid: there are {', '.join(names)}"
        raise ParameterError(msg)


@dataclass(frozen=True, slots=True)
class Failure:
    """A method that could not finish a run."""

    run: int
    method: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class StudyResult:
    """All runs of all methods.

    Attributes:
        seed: of the study.
        runs: (R,) numbers of the runs.
        methods: one result per method, in the order of the study.
        failures: methods that could not finish a run; their values are NaN.
    """

    seed: int
    runs: IntArray = field(repr=False)
    methods: tuple[MethodResult, ...]
    failures: tuple[Failure, ...]

    def __getitem__(self, method: str) -> MethodResult:
        """Return the result of one method.

        Raises:
            ParameterError: the study has no such method.
        """
        for one in self.methods:
            if one.name == method:
                return one
        names = ", ".join(repr(one.name) for one in self.methods)
        msg = f"method = {method!r} is invalid: there are {names}"
        raise ParameterError(msg)

    def __or__(self, other: StudyResult) -> StudyResult:
        """Return the methods of both, which must be of the same seed and runs; names must differ."""
        if self.seed != other.seed or not np.array_equal(self.runs, other.runs):
            msg = "results of other seeds or runs share no random numbers and cannot be put together"
            raise ParameterError(msg)
        shared = {one.name for one in self.methods} & {one.name for one in other.methods}
        if shared:
            msg = f"both results have a method {min(shared)!r}"
            raise ParameterError(msg)
        return StudyResult(self.seed, self.runs, self.methods + other.methods, self.failures + other.failures)

    def compare(self, first: str, second: str, column: str) -> Difference:
        """Return `first` minus `second`, run by run: both had the same random numbers."""
        return difference(self[first].per_run(column), self[second].per_run(column))

    def table(self, columns: Sequence[str] | None = None, baseline: str | None = None) -> str:
        """Return a text: of every method the mean of each column with half its 95 % interval, and the differences.

        Args:
            columns: which, None for all that every method has.
            baseline: the method that the others are compared with in the first column, None for the first one.

        Raises:
            ParameterError: there is no such column or method.
        """
        if columns is None:
            first, *others = [[column.name for column in one.columns] for one in self.methods]
            columns = [name for name in first if all(name in names for names in others)]
        if not columns:
            msg = "columns: there is none that all methods have; name some of one result alone"
            raise ParameterError(msg)
        base, lead = self.methods[0].name if baseline is None else baseline, columns[0]
        failed = Counter(failure.method for failure in self.failures)
        head = ["method", *columns, *([] if len(self.methods) == 1 else [f"{lead}: minus {base}", "p"]), "ms/run"]
        head += ["failed"] if failed else []
        rows = []
        for one in self.methods:
            summaries = [one.summary(column) for column in columns]
            cells = [one.name, *(_number(found.mean, found.half_width) for found in summaries)]
            if one.name == base:
                cells += [] if len(self.methods) == 1 else ["", ""]
            else:
                gap = self.compare(one.name, base, lead)
                cells += [_gap(gap), "" if np.isnan(gap.p_value) else f"{gap.p_value:.2g}"]
            cells.append(f"{1e3 * np.median(one.seconds):.3g}" if len(one.seconds) else "")
            rows.append(cells + ([str(failed[one.name])] if failed else []))
        widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in [head, *rows]]
        count = len(self.runs)
        notes = [f"{count} run{'s' * (count != 1)}, seed {self.seed}; ± is half a 95 % interval (bootstrap)"]
        if self.failures:
            first_one = self.failures[0]
            notes.append(f"failed runs count for nothing; the first is run {first_one.run}: {first_one.reason}")
        return "\n".join(line.rstrip() for line in [*lines, *notes])

    def to_table(self) -> dict[str, NDArray[Any]]:
        """Return a tidy table as a dictionary of columns: `run`, `method`, `column`, `value`, one row for each run.

        Besides the recorded columns there is `seconds`.
        """
        runs, methods, columns, values = [], [], [], []
        for one in self.methods:
            parts = {column.name: one.per_run(column.name) for column in one.columns} | {"seconds": one.seconds}
            for name, part in parts.items():
                runs.append(self.runs)
                methods.append(np.full(len(part), one.name))
                columns.append(np.full(len(part), name))
                values.append(part)
        if not values:
            return {name: np.zeros(0) for name in ("run", "method", "column", "value")}
        lists = {"run": runs, "method": methods, "column": columns, "value": values}
        return {name: np.concatenate(parts) for name, parts in lists.items()}

    def to_frame(self) -> Any:  # noqa: ANN401 (polars is not imported for its type)
        """Return `to_table` as a Polars data frame; needs polars."""
        try:
            import polars as pl  # noqa: PLC0415 (only who asks for it needs it)
        except ImportError:
            msg = 'to_frame needs polars: pip install "trackrs[cli]"'
            raise ImportError(msg) from None
        return pl.DataFrame(self.to_table())

    def to_arrow(self) -> Any:  # noqa: ANN401 (pyarrow is not imported for its type)
        """Return `to_table` as an Arrow table; needs pyarrow."""
        try:
            import pyarrow as pa  # noqa: PLC0415 (only who asks for it needs it)
        except ImportError:
            msg = "to_arrow needs pyarrow: pip install pyarrow"
            raise ImportError(msg) from None
        return pa.table(self.to_table())

    def to_bytes(self) -> bytes:
        """Return everything but the times it took: the same bytes on any number of threads, processes and machines."""
        parts = [struct.pack("<QQ", self.seed, len(self.runs)), self.runs.tobytes()]
        for one in self.methods:
            names = "\0".join([one.name, *(f"{column.name} {column.summary}" for column in one.columns)]).encode()
            shape = struct.pack("<QQQ", len(names), *one.values.shape[1:])
            parts += [shape, names, one.times.tobytes(), np.ascontiguousarray(one.values).tobytes()]
        parts += [f"{failure!r}".encode() for failure in self.failures]
        body = b"".join(parts)
        return body + struct.pack("<I", zlib.crc32(body))


def _number(mean: float, half_width: float) -> str:
    if np.isnan(mean):
        return "-"
    return f"{mean:.4g}" if np.isnan(half_width) else f"{mean:.4g} ±{half_width:.2g}"


def _gap(gap: Difference) -> str:
    if np.isnan(gap.mean):
        return "-"
    return f"{gap.mean:+.4g}" if np.isnan(gap.low) else f"{gap.mean:+.4g} [{gap.low:+.3g}, {gap.high:+.3g}]"


def result_of(
    seed: int,
    methods: Sequence[tuple[str, FloatArray, tuple[Column, ...]]],
    runs: IntArray,
    values: FloatArray,
    seconds: FloatArray,
    failures: Sequence[tuple[int, int, str]],
) -> StudyResult:
    """Return the record of flat rows (R, M C S) in the order of their runs."""
    order = np.argsort(runs, kind="stable")
    runs, values, seconds = runs[order], values[order], seconds[order]
    found, at = [], 0
    for i, (name, times, columns) in enumerate(methods):
        width = len(columns) * len(times)
        part = np.ascontiguousarray(values[:, at : at + width]).reshape(len(runs), len(columns), len(times))
        found.append(MethodResult(name, times, columns, frozen(part), frozen(seconds[:, i].copy())))
        at += width
    named = tuple(Failure(run, methods[i][0], reason) for run, i, reason in sorted(failures))
    return StudyResult(seed, frozen(runs.astype(np.int64)), tuple(found), named)
