"""What becomes of scans that come late: they are dropped, wait for one another, or are gone back for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class DropLate:
    """A scan older than the last one is dropped, with an event. `run` refuses scans that are not in order."""


@dataclass(frozen=True, slots=True)
class Reorder:
    """Scans wait for one another, and are taken in in the order of their times.

    A scan waits until the newest time is more than `window` later; then none that is accepted can belong before it. So
    `step` returns the tracks after the scans that have had their turn with it: none, one or several. `flush` takes in
    what still waits, and `run` does that at its end. The tracks come late by the window; for the same without delay,
    and more work for late scans, there is `Replay`.

    Args:
        window: how far behind the newest time a scan may come, seconds. What is older is dropped as late.
    """

    window: float


@dataclass(frozen=True, slots=True)
class Replay:
    """Scans are taken in at once; for a late one the tracker goes back to before it, and takes in the later ones again.

    After every `step` the tracker stands, bit for bit, where it would if the scans so far had come in order; only an
    identity may be given to another track than a `step` before said. `step` returns the tracks at the newest time, and
    `run` those after every scan in the order of time. Scans inside the window are kept, and the tracker's state at
    every eighth of them.

    Args:
        window: how far behind the newest time a scan may come, seconds. What is older is dropped as late.
    """

    window: float


Late: TypeAlias = DropLate | Reorder | Replay


def items(late: Late) -> tuple[str, float]:
    """What the core needs: kind and window."""
    if isinstance(late, DropLate):
        return "drop_late", 0.0
    return ("reorder" if isinstance(late, Reorder) else "replay"), late.window
