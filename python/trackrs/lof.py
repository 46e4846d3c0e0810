"""The local outlier factor: which points are clutter. Errors and `noise` are those of `trackrs.partition`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, frozen
from trackrs.partition import _frozen, _points

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True, eq=False)
class OutlierFactors:
    """Every step of the local outlier factor.

    Attributes:
        k_distance: distance of every point to its k-th nearest other one (n,).
        reachability_density: local reachability density (n,); inf where more than k points coincide.
        factors: local outlier factor (n,).
    """

    k_distance: FloatArray
    reachability_density: FloatArray
    factors: FloatArray


@dataclass(frozen=True, slots=True)
class LocalOutlierFactor:
    """How much sparser it is at a point than at its neighbours.

    Args:
        n_neighbors: k, at most n - 1 counts. It must be smaller than the smallest target has measurements, or whole
            targets are taken for clutter.
        threshold: points with a larger factor are clutter.
        include_ties: all points at the k-th distance are neighbours, not only k of them.

    Raises:
        ParameterError: `n_neighbors` is below 1 or `threshold` is not positive.

    More than k coincident points have factor 1, and isolated neighbours of theirs an infinite one.

    Reference:
        Breunig, Kriegel, Ng, Sander (2000), LOF: identifying density-based local outliers; spec 6.4.

    Example:
        >>> import trackrs as tr
        >>> tr.LocalOutlierFactor(2).fit_predict([[0, 0], [0, 1], [1, 0], [1, 1], [9, 9]])
        array([ 1,  1,  1,  1, -1])
    """

    n_neighbors: int = 4
    threshold: float = 2.0
    include_ties: bool = True

    @property
    def _core(self) -> _trackrs.OutlierFilter:
        return _trackrs.OutlierFilter(self.n_neighbors, self.threshold, self.include_ties)

    def explain(self, points: ArrayLike, *, noise: ArrayLike | None = None) -> OutlierFactors:
        """Return every step for points (n, d)."""
        return OutlierFactors(**_frozen(self._core.explain(*_points(points, noise))))

    def scores(self, points: ArrayLike, *, noise: ArrayLike | None = None) -> FloatArray:
        """Return the factor of every point (n,); about 1 inside a cluster."""
        return self.explain(points, noise=noise).factors

    def fit_predict(self, points: ArrayLike, *, noise: ArrayLike | None = None) -> IntArray:
        """Return 1 for every point, -1 for clutter (n,)."""
        return frozen(np.where(self.scores(points, noise=noise) > self.threshold, -1, 1))
