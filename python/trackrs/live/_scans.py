"""Rows into scans, as they come.

A scan is what one sensor reports at one time, as in a table of detections. Scans of one time stay open together, so
that the rows of several sensors may alternate; a row of a later time completes them. A row of an earlier time opens a
scan that will be late: what becomes of it, the tracker says. A row whose scan the tracker has seen is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isnan, nan
from typing import TYPE_CHECKING, Any

from trackrs.live._rows import Refused

if TYPE_CHECKING:
    from collections.abc import Mapping

    from trackrs.live._rows import Row

OPEN_SCANS = 64  # more are open only in a stream without order; the earliest is completed then


@dataclass(slots=True)
class OpenScan:
    """A scan that may still get rows.

    Attributes:
        time, sensor: which scan.
        platform: position of the platform, if known.
        values: its rows so far.
        places: line and offset of each.
    """

    time: float
    sensor: str
    platform: list[float] | None = None
    values: list[list[float]] = field(default_factory=list)
    places: list[tuple[int, int]] = field(default_factory=list)


class Assembler:
    """The scans that are open.

    Args:
        limit: most rows that wait in them.
        moving: whether every scan needs the platform's position.
    """

    def __init__(self, limit: int, *, moving: bool) -> None:
        self._limit, self._moving = limit, moving
        self._open: dict[tuple[float, str], OpenScan] = {}
        self._last: OpenScan | None = None
        self._done: tuple[float, set[str]] = (nan, set())  # sensors whose scan of the last time is complete
        self.waiting = 0  # rows

    @property
    def empty(self) -> bool:
        """Whether no scan is open."""
        return not self._open

    def before(self, time: float) -> list[OpenScan]:
        """Close and return the scans that a row of this time completes, in the order of their times."""
        if self._last is not None and self._last.time == time:
            return []
        done = [scan for scan in self._open.values() if scan.time < time]
        if not done and len(self._open) >= OPEN_SCANS:
            done = [min(self._open.values(), key=lambda scan: scan.time)]
        return self._close(done)

    def all(self) -> list[OpenScan]:
        """Close and return all scans, in the order of their times."""
        return self._close(list(self._open.values()))

    def put(self, row: Row, number: int, offset: int) -> None:
        """Add a row to its scan.

        Raises:
            Refused: the scan is complete, too many rows wait, or the position of the platform is unknown.
        """
        scan = self._last
        if scan is None or scan.time != row.time or scan.sensor != row.sensor:
            if row.time == self._done[0] and row.sensor in self._done[1]:
                raise Refused("late_row", f"the scan of {row.sensor} at {row.time} s was complete before")
            scan = self._open.get((row.time, row.sensor)) or OpenScan(row.time, row.sensor)
        platform = row.platform
        if platform is not None and scan.platform is not None and platform != scan.platform:
            raise Refused("two_platforms", f"the platform was at {scan.platform} in this scan before")
        if self._moving and platform is None and scan.platform is None:
            raise Refused("no_platform", "the position of the platform is in no line of this scan so far")
        if row.values is not None:
            if self.waiting >= self._limit:
                raise Refused("scan_full", f"{self.waiting} rows wait in unfinished scans, {self._limit} are allowed")
            scan.values.append(row.values)
            scan.places.append((number, offset))
            self.waiting += 1
        scan.platform = scan.platform or platform
        self._open[row.time, row.sensor] = self._last = scan

    def _close(self, scans: list[OpenScan]) -> list[OpenScan]:
        scans.sort(key=lambda scan: scan.time)
        for scan in scans:
            del self._open[scan.time, scan.sensor]
            self.waiting -= len(scan.values)
            # `not >=` for the first scan, before which there is no time
            if not self._done[0] >= scan.time:
                self._done = (scan.time, {scan.sensor})
            elif self._done[0] == scan.time:
                self._done[1].add(scan.sensor)
        if scans:
            self._last = None
        return scans

    # --- what a checkpoint keeps of it ---

    def to_json(self) -> dict[str, Any]:
        """Return it as data; NaN is None."""
        return {
            "done": [None if isnan(self._done[0]) else self._done[0], sorted(self._done[1])],
            "open": [
                [
                    scan.time,
                    scan.sensor,
                    scan.platform,
                    [[None if isnan(value) else value for value in row] for row in scan.values],
                    scan.places,
                ]
                for scan in self._open.values()
            ],
        }

    def restore(self, data: Mapping[str, Any]) -> None:
        """Go on where the data stand."""
        time, sensors = data["done"]
        self._done = (nan if time is None else float(time), set(sensors))
        for time, sensor, platform, values, places in data["open"]:
            rows = [[nan if value is None else float(value) for value in row] for row in values]
            scan = OpenScan(time, sensor, platform, rows, [(line, offset) for line, offset in places])
            self._open[scan.time, scan.sensor] = scan
            self.waiting += len(rows)
