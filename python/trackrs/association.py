"""Which report belongs to which track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from trackrs import _trackrs
from trackrs._arrays import IntArray, array, frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class NearestNeighbour:
    """The most likely pair of track and report first, then the most likely of the rest."""

    name: ClassVar[str] = "nearest"


@dataclass(frozen=True, slots=True)
class GlobalNearestNeighbour:
    """The set of pairs with the largest product of likelihoods.

    A track without a report counts as one with a report on the edge of its gate.
    """

    name: ClassVar[str] = "global_nearest"


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """Result of `assign`.

    Attributes:
        columns: assigned column of each row (rows,); -1 = none.
        cost: sum of the assigned costs.
    """

    columns: IntArray
    cost: float


def assign(costs: ArrayLike) -> Assignment:
    """Assign rows to columns at minimum cost.

    As many pairs as possible are assigned, and among these assignments the one with the smallest sum.

    Args:
        costs: (rows, columns); `inf` = forbidden pair.

    Raises:
        NonFiniteError: a cost is NaN or minus infinity.

    Reference:
        Crouse (2016), On implementing 2D rectangular assignment algorithms.

    Example:
        >>> import numpy as np, trackrs as tr
        >>> tr.assign([[1.0, 2.0, np.inf], [1.0, np.inf, np.inf]]).columns
        array([1, 0])
    """
    columns, cost = _trackrs.assign(array(costs, "costs", 2))
    return Assignment(frozen(columns), cost)
