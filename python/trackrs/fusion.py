"""Fusion of estimates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from trackrs import _trackrs
from trackrs._arrays import array
from trackrs.errors import TimeError
from trackrs.types import GaussianState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike


def covariance_intersection(
    states: Sequence[GaussianState],
    weights: ArrayLike | None = None,
    *,
    criterion: Literal["trace", "determinant"] = "trace",
) -> GaussianState:
    """Fuse estimates of one state whose errors may be correlated in any way: P⁻¹ = Σ w Pᵢ⁻¹, x = P Σ w Pᵢ⁻¹ xᵢ.

    For tracks of one target by different arrays, or estimates that have exchanged data. If every covariance is honest,
    so is the result; adding informations with weight 1 each is not, since the tracks share the motion noise. Where the
    raw measurements are at hand, one filter on `RangeArray.stack` is better: 0.66 m rms against 0.68 m, and 1.16 m and
    1.52 m of the single arrays, on the reference course of the underwater paper with 2 % gross errors.

    Args:
        states: estimates of the same components at the same time; predict them to one time first.
        weights: (N,) not negative, with sum 1. None: those that minimise the criterion.
        criterion: "trace" of the covariance, the mean squared error of all components, which should then be comparable
            in size; or its "determinant", the same in any units.

    Raises:
        TimeError: the states hold at different times.
        ParameterError: there is no state, or the weights are no shares.
        DimensionError: the states have different sizes.
        NotPositiveDefiniteError: a covariance is singular; the message says which.

    Reference:
        Julier, Uhlmann (1997), A non-divergent estimation algorithm in the presence of unknown correlations; spec label
        U29.

    Example:
        >>> import trackrs as tr
        >>> north = tr.GaussianState([0.0, 0.0], [[1.0, 0.0], [0.0, 9.0]])
        >>> east = tr.GaussianState([1.0, 1.0], [[9.0, 0.0], [0.0, 1.0]])
        >>> fused = tr.covariance_intersection([north, east])
        >>> fused.mean.round(9), fused.cov.round(9)
        (array([0.1, 0.9]), array([[1.8, 0. ],
               [0. , 1.8]]))
    """
    for state in states[1:]:
        if state.time != states[0].time:
            msg = (
                f"states hold at different times, {states[0].time} s and {state.time} s: "
                "predict them to one time before fusing them"
            )
            raise TimeError(msg)
    shares = None if weights is None else array(weights, "weights", 1)
    mean, cov = _trackrs.covariance_intersection([(s.mean, s.cov) for s in states], criterion, shares)
    return GaussianState(mean, cov, states[0].time)
