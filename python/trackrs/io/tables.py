"""Tables of detections, scans, truth and tracks, as CSV or Parquet.

Every error is one sentence that names the file, the line (of a Parquet file: the row), the column and the remedy. Cells
of a CSV file are read as text first and turned into numbers column by column, so that a bad cell can be found; empty
cells and `nan` mean "not observed" in a measurement and are errors elsewhere; lines without any value are skipped.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs._arrays import FloatArray, IntArray, frozen
from trackrs.config import InputConfig, TruthConfig
from trackrs.evaluation import Truth
from trackrs.io._files import Table, TableError, replacing, table_suffix, write_table
from trackrs.types import Health, Scan, Tracks

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class ScanTable:
    """When each sensor looked, in the order of the times.

    Attributes:
        times: (S,) seconds.
        sensors: (S,) names.
        platforms: (S, d) position of the platform, if the table has it.
        ignored: rows left out on request, by sensor.
    """

    times: FloatArray
    sensors: tuple[str, ...]
    platforms: FloatArray | None
    ignored: Mapping[str, int]

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.sensors)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Detections, scan by scan.

    Attributes:
        scans: in the order of their times; empty scans too, where a table of scans told of them.
        platforms: (S, d) position of the platform at every scan, if known.
        ignored: detections left out on request, by sensor.
    """

    scans: tuple[Scan, ...]
    platforms: FloatArray | None
    ignored: Mapping[str, int]

    @property
    def rows(self) -> int:
        """Number of detections in all scans."""
        return sum(len(scan) for scan in self.scans)


# --- reading ---------------------------------------------------------------------------------------------------------


def read_scans(
    detections: str | Path,
    scans: str | Path | None,
    columns: Mapping[str, Sequence[str]],
    layout: InputConfig = InputConfig(),  # noqa: B008 (frozen)
) -> Recording:
    """Read detections into scans.

    Args:
        detections: one row per detection.
        scans: one row per scan, empty ones included. Without it every time at which a sensor has detections is a scan,
            and scans without detections are unknown.
        columns: per sensor, the columns of its measurement in `detections`.
        layout: names of the other columns.

    Raises:
        TableError: a table is missing, empty or no table; a column is missing; a cell is no number; times of one sensor
            decrease or repeat; a sensor is unknown; a detection belongs to no scan.
    """
    table = Table.read(Path(detections))
    found = _Rows.of(table, columns, layout)
    if scans is None:
        if layout.platform:
            named = ", ".join(f'"{name}"' for name in layout.platform)
            raise TableError(
                f"{detections}: the platform's position ({named}) stands in the table of scans, and none is given: "
                "pass it with --scans, or remove platform from [input]"
            )
        if len(found.rows) == 0:
            table.fail("has no detections, and without a table of scans there is nothing to track")
        found.check_order(layout, repeats=True)
        keys = sorted(dict.fromkeys(found.keys), key=lambda key: key[0])
        index = {key: k for k, key in enumerate(keys)}
        scan_of_row = np.array([index[key] for key in found.keys], dtype=np.int64)
        looks = ScanTable(np.array([time for time, _ in keys]), tuple(sensor for _, sensor in keys), None, {})
    else:
        timetable = _Timetable.read(Path(scans), columns, layout)
        looks = timetable.looks
        scan_of_row = timetable.scan_of(found, layout)
    order = np.argsort(scan_of_row, kind="stable")
    bounds = np.searchsorted(scan_of_row[order], np.arange(len(looks) + 1))
    values, place = found.measurements(columns), found.places()
    out = []
    for k, (time, sensor) in enumerate(zip(looks.times.tolist(), looks.sensors, strict=True)):
        rows = place[order[bounds[k] : bounds[k + 1]]]
        out.append(Scan(time, values[sensor][rows], sensor, None if looks.platforms is None else looks.platforms[k]))
    return Recording(tuple(out), looks.platforms, found.ignored)


def read_scan_table(
    scans: str | Path,
    sensors: Sequence[str] | Mapping[str, object],
    layout: InputConfig = InputConfig(),  # noqa: B008 (frozen)
) -> ScanTable:
    """Read the table of scans alone.

    Args:
        scans: one row per scan.
        sensors: names of the known sensors.
        layout: names of the columns.

    Raises:
        TableError: as in `read_scans`.
    """
    return _Timetable.read(Path(scans), sensors, layout).looks


def read_truth(path: str | Path, layout: TruthConfig) -> list[Truth]:
    """Read where targets really were; rows may come in any order, and twice if they say the same.

    Args:
        path: one row per target and time.
        layout: names of the columns.

    Raises:
        TableError: the table is missing or empty, a column is missing, a cell is no number, or a target is at two
            places at one time.
    """
    table = Table.read(Path(path))
    targets = np.array(table.text(layout.target), dtype=np.str_)
    times = table.numbers(layout.time)
    positions = np.stack([table.numbers(column) for column in layout.columns], axis=1)
    if len(times) == 0:
        table.fail("has no rows")
    truth = []
    for target in dict.fromkeys(targets.tolist()):
        rows = np.flatnonzero(targets == target)
        rows = rows[np.argsort(times[rows], kind="stable")]
        again = np.flatnonzero(np.diff(times[rows]) == 0)
        for first, second in zip(rows[again], rows[again + 1], strict=True):
            if not np.array_equal(positions[first], positions[second]):
                other = f"target {target} is elsewhere at {times[first]} s ({table.line(first)}); remove one of the two"
                table.fail_at(second, layout.columns[0], other)
        rows = np.delete(rows, again + 1)
        truth.append(Truth(target, times[rows], positions[rows]))
    return truth


def read_tracks(path: str | Path, scans: ScanTable | None = None) -> Tracks:
    """Read tracks as `write_tracks` leaves them.

    Args:
        path: one row per track and scan.
        scans: the scans they come from. A table of tracks knows nothing of scans without tracks; without `scans` the
            result holds only those with one.

    Raises:
        TableError: the table is missing, a column is missing, a cell is no number, a row belongs to no scan, or a track
            stands twice in one scan.
    """
    table = Table.read(Path(path))
    names = set(table.header)
    labels = tuple(name for name in table.header if f"cov_{name}_{name}" in names)
    if not labels:
        table.fail("is no table of tracks: it has no covariances (cov_x_x, ...); `trackrs track` writes them")
    times, sensors = table.numbers("time"), table.text("sensor")
    ids, hits = table.counts("track"), table.counts("hits")
    if scans is None:
        if len(times) == 0:
            table.fail("has no tracks, and only the table of scans knows what was scanned: pass it with --scans")
        keys = sorted(dict.fromkeys(zip(times.tolist(), sensors, strict=True)), key=lambda key: key[0])
        scans = ScanTable(np.array([t for t, _ in keys]), tuple(s for _, s in keys), None, {})
    index = {key: k for k, key in enumerate(zip(scans.times.tolist(), scans.sensors, strict=True))}
    scan_of_row = np.zeros(len(times), dtype=np.int64)
    seen = set()
    for row, (time, sensor, track) in enumerate(zip(times.tolist(), sensors, ids.tolist(), strict=True)):
        if (time, sensor) not in index:
            table.fail_at(row, "time", f"{sensor} has no scan at {time} s in the table of scans")
        scan_of_row[row] = index[time, sensor]
        if (time, sensor, track) in seen:
            table.fail_at(row, "track", f"track {track} stands twice at {time} s; remove one of the two")
        seen.add((time, sensor, track))
    order = np.argsort(scan_of_row, kind="stable")
    n = len(labels)
    covs = np.zeros((len(times), n, n))
    for i, a in enumerate(labels):
        for j, b in enumerate(labels[: i + 1]):
            covs[:, i, j] = covs[:, j, i] = table.numbers(f"cov_{a}_{b}")[order]
    size = sum(f"extent_{i}_{i}" in names for i in (1, 2, 3))
    extents = np.zeros((len(times), size, size))
    for i in range(size):
        for j in range(i + 1):
            extents[:, i, j] = extents[:, j, i] = table.numbers(f"extent_{i + 1}_{j + 1}")[order]
    means = np.stack([table.numbers(label) for label in labels], axis=1)[order]
    return Tracks(
        scan_times=scans.times,
        sensors=scans.sensors,
        times=frozen(times[order]),
        ids=frozen(ids[order]),
        means=frozen(means),
        covs=frozen(covs),
        last_hits=frozen(table.numbers("last_hit")[order]),
        hits=frozen(hits[order]),
        labels=labels,
        offsets=frozen(np.searchsorted(scan_of_row[order], np.arange(len(scans) + 1)).astype(np.int64)),
        existences=frozen(table.numbers("existence")[order]) if "existence" in names else None,
        extents=frozen(extents) if size else None,
        healths=frozen(_healths(table)[order]) if "health" in names else None,
    )


def _healths(table: Table) -> NDArray[np.int8]:
    """The column of healths, by number."""
    numbers = {health.name.lower(): health.value for health in Health}
    words = table.text("health")
    for row, word in enumerate(words):
        if word not in numbers:
            table.fail_at(row, "health", f'"{word}" is none of {", ".join(numbers)}; correct it')
    return np.array([numbers[word] for word in words], dtype=np.int8)


# --- writing ---------------------------------------------------------------------------------------------------------


def write_tracks(tracks: Tracks, path: str | Path) -> None:
    """Write tracks as CSV or Parquet, by suffix: all of it, or nothing.

    Raises:
        TableError: the suffix is neither, or the file cannot be written.
    """
    path = Path(path)
    suffix = table_suffix(path)
    with replacing(path) as file:
        write_table(tracks.to_table(), file, suffix)


# --- a table and its rows --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """The rows of the sensors that take part: which they are, when, and whose."""

    table: Table
    rows: IntArray
    times: FloatArray
    sensors: NDArray[np.str_]
    ignored: Mapping[str, int]

    @classmethod
    def of(cls, table: Table, known: Sequence[str] | Mapping[str, object], layout: InputConfig) -> _Rows:
        every = table.text(layout.sensor)
        keep = []
        for row, sensor in enumerate(every):
            if sensor in known:
                keep.append(row)
            elif sensor not in layout.ignore_sensors:
                models = ", ".join(f'"{name}"' for name in known)
                remedy = f"models exist for {models}; add [sensors.{sensor}], or list it in [input] ignore_sensors"
                table.fail_at(row, layout.sensor, f'unknown sensor "{sensor}": {remedy}')
        rows = np.array(keep, dtype=np.int64)
        ignored = Counter(sensor for sensor in every if sensor not in known)
        sensors = np.array([every[row] for row in keep], dtype=np.str_)
        return cls(table, rows, table.numbers(layout.time, rows), sensors, dict(ignored))

    @property
    def keys(self) -> list[tuple[float, str]]:
        """Time and sensor of every row."""
        return list(zip(self.times.tolist(), self.sensors.tolist(), strict=True))

    def check_order(self, layout: InputConfig, *, repeats: bool) -> None:
        """Refuse times of one sensor that decrease or, unless allowed, repeat."""
        for sensor in np.unique(self.sensors).tolist():
            rows = np.flatnonzero(self.sensors == sensor)
            if layout.unsorted == "sort":
                rows = rows[np.argsort(self.times[rows], kind="stable")]
            steps = np.diff(self.times[rows])
            wrong = np.flatnonzero(steps < 0 if repeats else steps <= 0)
            if len(wrong) == 0:
                continue
            before, row = rows[wrong[0]], rows[wrong[0] + 1]
            now, then = self.times[row], self.times[before]
            earlier = self.table.line(self.rows[before])
            if now == then:
                what = f"{sensor} already has a scan at {now} s ({earlier}); remove one of the two"
            else:
                what = (
                    f'{sensor} goes back from {then} s ({earlier}) to {now} s; sort the table, or set unsorted = "sort"'
                )
                what += " in [input]"
            self.table.fail_at(self.rows[row], layout.time, what)

    def measurements(self, columns: Mapping[str, Sequence[str]]) -> dict[str, FloatArray]:
        """The measurements of every sensor, in the order of its rows."""
        out = {}
        for sensor, names in columns.items():
            mine = self.rows[self.sensors == sensor]
            out[sensor] = np.stack([self.table.numbers(name, mine, missing=True) for name in names], axis=1)
        return out

    def places(self) -> IntArray:
        """For every row, how many rows of its sensor stand before it."""
        out = np.zeros(len(self.rows), dtype=np.int64)
        for sensor in np.unique(self.sensors):
            mine = self.sensors == sensor
            out[mine] = np.arange(np.count_nonzero(mine))
        return out


@dataclass(frozen=True, slots=True, eq=False)
class _Timetable:
    """The table of scans, sorted by time, and the ids of its scans if it has any."""

    path: Path
    looks: ScanTable
    ids: dict[str, int]

    @classmethod
    def read(cls, path: Path, known: Sequence[str] | Mapping[str, object], layout: InputConfig) -> _Timetable:
        table = Table.read(path)
        found = _Rows.of(table, known, layout)
        platform = [table.numbers(name, found.rows) for name in layout.platform]
        if len(found.rows) == 0:
            table.fail("has no scans")
        found.check_order(layout, repeats=False)
        # A scan is sorted by its time alone: the sensors' rows may follow one another in any order.
        order = np.argsort(found.times, kind="stable")
        ids: dict[str, int] = {}
        if layout.scan is not None:
            rows = found.rows[order]
            for k, name in enumerate(table.text(layout.scan, rows)):
                if name in ids:
                    table.fail_at(rows[k], layout.scan, f"scan {name} stands twice; give each scan an id of its own")
                ids[name] = k
        looks = ScanTable(
            frozen(found.times[order]),
            tuple(found.sensors[order].tolist()),
            frozen(np.stack(platform, axis=1)[order]) if platform else None,
            found.ignored,
        )
        return cls(path, looks, ids)

    def scan_of(self, found: _Rows, layout: InputConfig) -> IntArray:
        """The scan that each detection belongs to, by id if there are ids, else by time and sensor."""
        looks, table = self.looks, found.table
        keys = list(zip(looks.times.tolist(), looks.sensors, strict=True))
        names: Sequence[Any] = found.keys
        index: Mapping[Any, int] = {key: k for k, key in enumerate(keys)}
        if layout.scan is not None:
            names, index = table.text(layout.scan, found.rows), self.ids
        out = np.zeros(len(found.rows), dtype=np.int64)
        for place, ((time, sensor), name) in enumerate(zip(found.keys, names, strict=True)):
            row = found.rows[place]
            if name not in index:
                what = f"{sensor} has no scan at {time} s" if layout.scan is None else f"there is no scan {name}"
                remedy = f"in {self.path}; add it there or remove the detection"
                table.fail_at(row, layout.scan or layout.time, f"{what} {remedy}")
            out[place] = index[name]
            at, whose = keys[out[place]]
            if whose != sensor:
                table.fail_at(row, layout.sensor, f"scan {name} is of {whose}, not of {sensor}, in {self.path}")
            if at != time:
                table.fail_at(
                    row, layout.time, f"{time} s, but scan {name} is at {at} s in {self.path}; make them equal"
                )
        return out
