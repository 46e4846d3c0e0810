"""What an intensity is made of: where targets appear, what they give off, how many measurements they give, how large.

The filters that carry it are in `trackrs.phd`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs._arrays import FloatArray, array
from trackrs.errors import DimensionError, ParameterError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from trackrs.types import GaussianState


@dataclass(frozen=True, slots=True, eq=False)
class Birth:
    """Where targets may appear: a mixture that is added at every scan.

    Args:
        states: the places, with the uncertainty of a newborn target; their times do not matter.
        weights: expected number of new targets per scan at each place, one for all or one per place.
    """

    states: Sequence[GaussianState]
    weights: float | Sequence[float] = 0.1


@dataclass(frozen=True, slots=True)
class AdaptiveBirth:
    """Targets may appear wherever there are measurements that no target explains.

    Such measurements, linked up to the distance that holds 80 % of the pairs of one target, leave a birth for the next
    scan in the middle of every set of `min_measurements` and more: at rest, with the speed bound as uncertainty.
    Sensors that do not measure where something is leave none.

    Args:
        weight: expected number of new targets at each such place.
        max_speed: upper bound on the speed of a target, m/s; two standard deviations of its velocity.
        min_measurements: fewer measurements than that are clutter.

    Reference:
        Ristic, Clark, Vo, Vo (2012), Adaptive target birth intensity for PHD and CPHD filters, IEEE TAES 48(2).
    """

    weight: float
    max_speed: float
    min_measurements: int = 2


@dataclass(frozen=True, slots=True, eq=False)
class Spawn:
    """Targets that a target gives off.

    Args:
        weight: expected number per target and scan.
        offset: what is added to the target's state (n,).
        cov: covariance that is added, in place of the motion's noise (n, n).
    """

    weight: float
    offset: ArrayLike
    cov: ArrayLike


@dataclass(frozen=True, slots=True)
class DetectionRate:
    """How many measurements a target gives in a scan: Poisson, with a mean that is known or learnt for every target.

    Args:
        mean: mean number of measurements of a new target.
        learnt: whether every target has its own rate, gamma distributed and learnt from its cells.
        shape: of a new target's gamma distribution; its mean is known to 1/sqrt(shape). Below 4 ghosts survive.
        forgetting: by which factor its variance grows from scan to scan, at least 1.
        floor: least mean rate after a detection.

    Reference:
        Granström, Orguner (2012), IEEE TSP 60(11); spec 8.1.
    """

    mean: float
    learnt: bool = True
    shape: float = 10.0
    forgetting: float = 1.05
    floor: float = 3.0


@dataclass(frozen=True, slots=True)
class Extent:
    """How large targets are: an ellipse for every target, learnt from the scatter of its measurements.

    The ellipse stands for the covariance of the points that give measurements: its whole axes are four standard
    deviations, which for a uniformly filled ellipse in the plane are its own. It may have any orientation, and keeps
    its own between scans.

    Args:
        axes: whole axes expected of a new target along the measured coordinates, metres, two or three. Rather too large
            than too small: small and certain, one large target is taken for several.
        certainty: how sure that is: worth so many measurements without noise. In the literature's terms the inverse
            Wishart distribution has 2 d + 2 + `certainty` degrees of freedom.
        time_constant: time in which what was learnt loses all but 1/e of its weight, seconds.

    Reference:
        Granström, Natale, Braca, Ludeno, Serafino (2015), IEEE TGRS 53(12); Feldmann, Fränken, Koch (2011), IEEE TSP
        59(4); docs/intensity_filters.md, which says how sensor noise is treated.
    """

    axes: Sequence[float]
    certainty: float = 5.0
    time_constant: float = 60.0

    def _items(self) -> tuple[FloatArray, float, float]:
        axes = array(self.axes, "extent axes", 1)
        if not (axes > 0.0).all():
            msg = f"extent axes: must be positive, found {axes.tolist()}"
            raise ParameterError(msg)
        return np.diag((axes / 4.0) ** 2), self.certainty, self.time_constant


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """An intensity.

    Attributes:
        weights: expected number of targets in every component (J,).
        means, covs: (J, n) and (J, n, n).
        detection_rates: mean number of measurements of every component (J,).
        extents: expected extents (J, d, d), as those of `Tracks`; None where they are not learnt.
    """

    weights: FloatArray
    means: FloatArray
    covs: FloatArray
    detection_rates: FloatArray
    extents: FloatArray | None = None

    def __len__(self) -> int:
        """Return the number of components."""
        return len(self.weights)


def spawned(spawns: Sequence[Spawn]) -> list[dict[str, Any]]:
    """Return spawns as the core takes them."""
    return [
        {"weight": spawn.weight, "mean": array(spawn.offset, "offset", 1), "cov": array(spawn.cov, "cov", 2)}
        for spawn in spawns
    ]


def weighted(what: str, states: Sequence[GaussianState], weights: float | Sequence[float]) -> list[dict[str, Any]]:
    """Return states with one weight for all or one per state, as the core takes them; `what` names them in errors."""
    count = len(states)
    weights = list(weights) if isinstance(weights, Sequence | np.ndarray) else [weights] * count
    if len(weights) != count:
        msg = f"{what} weights: expected {count}, one per state, found {len(weights)}"
        raise DimensionError(msg)
    return [
        {"weight": weight, "mean": state.mean, "cov": state.cov} for weight, state in zip(weights, states, strict=True)
    ]
