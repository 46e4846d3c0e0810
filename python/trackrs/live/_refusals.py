"""Which rows of a scan the tracker dropped. Its ledger has only their number, and its events are the last thousand."""

from __future__ import annotations

from collections import Counter
from math import isnan
from typing import TYPE_CHECKING, NamedTuple

from trackrs.phd import IntensityTracker

if TYPE_CHECKING:
    from collections.abc import Sequence

    from trackrs.live._records import Tracker
    from trackrs.live._scans import OpenScan
    from trackrs.types import Ledger, Tracks

REASONS = {
    "late_scan": "it is older than what the tracker has seen",
    "duplicate": "it was received before",
    "not_observed": "nothing was observed, or not all that this tracker needs",
}


class Refusal(NamedTuple):
    """A row that was dropped.

    Attributes:
        place: line and offset.
        row: its values; None: some rows of the scan, of which only the number is known.
        code: why, as the tracker's events have it.
        reason: why, in words.
    """

    place: tuple[int, int]
    row: Sequence[float] | None
    code: str
    reason: str


def dropped(ledger: Ledger) -> Counter[str]:
    """Return how many rows a tracker dropped, by code."""
    return Counter({**ledger.rejected, "late_scan": ledger.late, "duplicate": ledger.duplicate})


def counted(counts: Counter[str]) -> str:
    """Return counts in words."""
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def refusals(scan: OpenScan, found: Tracks, before: Ledger, after: Ledger, tracker: Tracker) -> list[Refusal]:
    """Return what the tracker dropped when it got a scan, by the books before and after it."""
    lost = dropped(after) - dropped(before)
    place = scan.places[0] if scan.places else (0, 0)
    out = []
    if back := lost.pop("future_scan", 0):
        reason = f"{back} rows of the scan before this one were taken back: their time lay far ahead"
        out.append(Refusal(place, None, "future_scan", reason))
    if not lost:
        return out
    codes: list[str | None] = [*lost] * len(scan.values)
    if lost.total() != len(scan.values) or len(lost) != 1:
        codes = _faults(scan.values, whole=isinstance(tracker, IntensityTracker))
    # Where scans wait or are taken in again, what was dropped may be of others; what is late is always of this one.
    its_own = (found.sensors == (scan.sensor,) and found.scan_times[0] == scan.time) or [*lost] == ["late_scan"]
    if not its_own or Counter(code for code in codes if code) != lost:
        which = "of" if its_own else "with"
        reason = f"{which} the scan that begins here, the tracker refused {counted(lost)}"
        return [*out, Refusal(place, None, "refused", reason)]
    return out + [
        Refusal(place, row, code, REASONS.get(code, f"the tracker refused it: {code}"))
        for place, row, code in zip(scan.places, scan.values, codes, strict=True)
        if code
    ]


def _faults(rows: Sequence[Sequence[float]], *, whole: bool) -> list[str | None]:
    """What a tracker finds wrong with rows of one scan: not observed (`whole`: not wholly observed), or repeated."""
    seen: set[tuple[str, ...]] = set()
    out: list[str | None] = []
    for row in rows:
        missing = [isnan(value) for value in row]
        # -0.0 equals 0.0 but is another report; NaN equals nothing but is no difference.
        key = tuple(repr(value) for value in row)
        fault = "not_observed" if all(missing) or (whole and any(missing)) else "duplicate" if key in seen else None
        seen.add(key)
        out.append(fault)
    return out
