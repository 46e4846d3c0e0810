"""What a live run is told and what it has done."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Mapping

    from trackrs.phd import IntensityTracker
    from trackrs.tracker import MultiTargetTracker
    from trackrs.types import Ledger

    Tracker: TypeAlias = MultiTargetTracker | IntensityTracker


@dataclass(frozen=True, slots=True)
class Limits:
    """What a live run takes in at most; what is beyond is refused and counted.

    Args:
        line_bytes: length of a line.
        depth: how deep brackets may stand in one another.
        waiting_rows: rows in scans that are not complete.
    """

    line_bytes: int = 1 << 20
    depth: int = 64
    waiting_rows: int = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class LiveRun:
    """What a live run has done since its very beginning, all its restarts included.

    `rows_in == used + sum(rejected) + late + duplicate + ledger.waiting + sum(bad_lines) + waiting`, always; all but
    the last two stand in the `ledger`.

    Attributes:
        tracker: the tracker after the last scan.
        ended: whether the input ended; else the run was stopped.
        offset: bytes of the input that are done with.
        rows_in: detections, and lines that cannot be read.
        ledger: where the rows went that the tracker got.
        bad_lines: lines that became no row, by reason.
        waiting: rows in unfinished scans; they are in the checkpoint.
        looks: lines that only say that a sensor looked.
        ignored: detections left out on request, by sensor.
        scans: scans that the tracker was given.
        track_rows: rows of tracks that were written.
    """

    tracker: Tracker
    ended: bool
    offset: int
    rows_in: int
    ledger: Ledger
    bad_lines: Mapping[str, int]
    waiting: int
    looks: int
    ignored: Mapping[str, int]
    scans: int
    track_rows: int
