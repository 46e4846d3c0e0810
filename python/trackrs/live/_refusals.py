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
    from trackrs.types import Ledger

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


def refusals(scan: OpenScan, before: Ledger, after: Ledger, tracker: Tracker) -> list[Refusal]:
    """Return what the tracker dropped of a scan, by the books before and after it."""
    dropped = Counter(after.rejected) - Counter(before.rejected)
    dropped += Counter(late_scan=after.late - before.late, duplicate=after.duplicate - before.duplicate)
    codes: list[str | None] = [*dropped] * len(scan.values)
    if dropped.total() != len(scan.values) or len(dropped) != 1:
        codes = _faults(scan.values, whole=isinstance(tracker, IntensityTracker))
    if Counter(code for code in codes if code) != dropped:
        counts = ", ".join(f"{count} {name}" for name, count in dropped.items())
        reason = f"of the scan that begins here, the tracker refused {counts}"
        return [Refusal(scan.places[0], None, "refused", reason)]
    return [
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
