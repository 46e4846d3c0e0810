"""What a study records at every step, beside `OSPA` and `GOSPA`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from trackrs.errors import ParameterError
from trackrs.metric import GOSPA, OSPA


@dataclass(frozen=True, slots=True)
class Cardinality:
    """Number of tracks: columns `tracks` and `cardinality_error`, estimated minus true."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Which track is whose, of targets that a tracker was told of at the beginning.

    Columns: `track_error`, root mean square over the targets, metres; `right`, 1 where each track's nearest target is
    its own and no two tracks are closer than `separation`; `coalesced`, 1 where two are; `swapped`, 1 where tracks have
    exchanged their targets. The last three are summarised by the last step.

    Args:
        separation: tracks closer than this have become one, metres; half that of the targets is usual.
    """

    separation: float


@dataclass(frozen=True, slots=True)
class PositionError:
    """The estimated position of one target.

    Columns: `error`, of one coordinate with its sign, of several its length; `nees`, its normalised square; `nis`, that
    of the innovation. NaN before the filter has started.

    Args:
        first: steps before this one are not scored.
    """

    first: int = 0


@dataclass(frozen=True, slots=True)
class LeadError:
    """The predicted position of one target: column `lead_error`.

    Args:
        lead: seconds ahead of every measurement, or "midpoint", as in `run`.
        first: steps before this one are not scored.
    """

    lead: float | Literal["midpoint"] = "midpoint"
    first: int = 0


Item: TypeAlias = tuple[str, list[float], int]
Metric: TypeAlias = OSPA | GOSPA | Cardinality | Identity | PositionError | LeadError


def item(metric: object) -> Item:
    """Return kind, numbers and first step, as the core takes them."""
    match metric:
        case OSPA(c, p):
            return "ospa", [c, p], 0
        case GOSPA(c, p, alpha):
            return "gospa", [c, p, alpha], 0
        case Cardinality():
            return "cardinality", [], 0
        case Identity(separation):
            return "identity", [separation], 0
        case PositionError(first):
            return "position", [], first
        case LeadError("midpoint", first):
            return "lead", [], first
        case LeadError(int() | float() as lead, first):
            return "lead", [float(lead)], first
        case LeadError(lead):
            msg = f'lead = {lead!r} is invalid: must be seconds or "midpoint"'
            raise ParameterError(msg)
    msg = f"metric = {metric!r} is invalid: must be OSPA, GOSPA or one of trackrs.study"
    raise ParameterError(msg)
