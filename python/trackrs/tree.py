"""Trees over points, whose cuts are partitions. Errors and `noise` are those of `trackrs.partition`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from trackrs import _trackrs
from trackrs.errors import ParameterError
from trackrs.partition import _frozen, _Partitioner, _points

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from trackrs._arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class ClusterTree:
    """A binary tree over points, or a forest.

    Attributes:
        children: the two nodes that each merge joins (m, 2); merge i is node n + i, points are nodes 0 to n - 1.
        heights: height of every merge (m,), ascending; unit of the points.
        roots: the nodes that are no child, ascending.
    """

    children: IntArray
    heights: FloatArray
    roots: IntArray


@dataclass(frozen=True, slots=True)
class TreePartition(_Partitioner):
    """Cuts of binary trees over the points.

    `partitions` gives the cut at every distinct height of every tree; any other cut can be made of `trees`.

    Args:
        linkages: of "single" and "ward".
        max_extent: largest diagonal of the bounding box of a cell, unit of the points; None: 15 effective standard
            deviations of `noise`, no bound without it.

    Raises:
        ParameterError: a linkage is unknown or none is given, `max_extent` is not positive.

    Reference:
        Gower, Ross (1969), Minimum spanning trees and single linkage cluster analysis; Ward (1963), Hierarchical
        grouping to optimize an objective function; spec 8.2.

    Example:
        >>> import trackrs as tr
        >>> tr.TreePartition(["ward"]).trees([[0.0], [1.0], [5.0]])[0].heights
        array([1.        , 5.19615242])
        >>> tr.TreePartition(["ward"]).partitions([[0.0], [1.0], [5.0]]).labels
        array([[0, 1, 2],
               [0, 0, 1],
               [0, 0, 0]])
    """

    linkages: Sequence[str] = ("single", "ward")
    max_extent: float | None = None

    @property
    def _core(self) -> _trackrs.Partitioner:
        if isinstance(self.linkages, str):
            msg = f'linkages = "{self.linkages}" is invalid: must be a list of names'
            raise ParameterError(msg)
        return _trackrs.Partitioner.tree(list(self.linkages), self.max_extent)

    def trees(self, points: ArrayLike, *, noise: ArrayLike | None = None) -> list[ClusterTree]:
        """Return the tree over points (n, d) of every linkage."""
        return [ClusterTree(**_frozen(tree)) for tree in self._core.trees(*_points(points, noise))]
