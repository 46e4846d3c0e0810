"""Which report belongs to which track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal, TypeAlias

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, frozen
from trackrs.errors import DimensionError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class NearestNeighbour:
    """The nearest pair of track and report first, then the nearest of the rest.

    Args:
        by: "likelihood" counts ln det S, as the global one does; "distance" is the normalised distance alone, which
            does not starve a track that has become uncertain (spec label N15).
    """

    by: Literal["likelihood", "distance"] = "likelihood"
    name: ClassVar[str] = "nearest"


@dataclass(frozen=True, slots=True)
class GlobalNearestNeighbour:
    """The set of pairs with the largest product of likelihoods.

    A track without a report counts as one with a report on the edge of its gate.
    """

    name: ClassVar[str] = "global_nearest"


@dataclass(frozen=True, slots=True)
class PDA:
    """Every track for itself: the mean over which of the reports in its gate, if any, is its own.

    It ignores that a report is of one target at most, so that targets which come close coalesce. With no clutter and
    single reports every gated track takes the report for certain, which the NPDA paper calls JPDAF.

    Needs the tracker's `clutter_density`.

    Reference:
        Bar-Shalom, Tse (1975); spec labels N16, N18.
    """

    name: ClassVar[str] = "pda"


@dataclass(frozen=True, slots=True)
class JPDA:
    """All tracks together: the mean over the joint events in which no report is of two tracks.

    Joint probabilities are exact up to a budget; beyond it they are approximated, with an event `approximated`. Reports
    with times of their own update a track at those times. Needs the tracker's `clutter_density`.

    Args:
        coalescence_free: of the joint events with the same tracks and the same reports count only the likeliest
            (JPDA*), so that targets closer than about five sigma do not coalesce.

    Reference:
        Fortmann, Bar-Shalom, Scheffe (1983); Blom, Bloem (2000); spec labels N17, N19.
    """

    coalescence_free: bool = False
    name: ClassVar[str] = "jpda"


@dataclass(frozen=True, slots=True)
class JIPDA:
    """As `JPDA`, with the probability that each track's target exists, which confirms and ends tracks.

    It goes with the initiator `Existence`; tentative and confirmed tracks compete for the reports. Needs the tracker's
    `clutter_density`.

    Args:
        coalescence_free: as in `JPDA`.

    Reference:
        Musicki, Evans (2004), IEEE Trans. Aerosp. Electron. Syst. 40(3).
    """

    coalescence_free: bool = False
    name: ClassVar[str] = "jipda"


@dataclass(frozen=True, slots=True)
class NPDA:
    """One report after the other, each shared out at its own time among the tracks that may have sent it.

    With `clutter_probability=0` and scans of one report this is JPDA. A constant probability counts however far from a
    track a report lies in its gate; in clutter the density is far better.

    Args:
        clutter_probability: that a gated report is of no target, in [0, 1). None: by the tracker's `clutter_density`.
        covariance: of a partial update: "moment" (of the mixture of update and prediction), "paper" (as printed, eq.
            24) or "joseph" (as if the report surely were the track's; over-confident).
        bookkeeping: "each": all tracks are predicted to every report's time. "paper": a track that does not gate a
            report stays where it was last updated and is later predicted in one step, which with `accel_std` noise is
            not the same.

    Reference:
        Liu, Xie, Huang (2009), J. Electronics & Information Technology 31(7); spec labels N9 to N14, N17.
    """

    clutter_probability: float | None = 0.0
    covariance: Literal["moment", "paper", "joseph"] = "moment"
    bookkeeping: Literal["each", "paper"] = "each"
    name: ClassVar[str] = "npda"


Associator: TypeAlias = NearestNeighbour | GlobalNearestNeighbour | PDA | JPDA | JIPDA | NPDA


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """Result of `assign`, and one of those of `k_best`.

    Attributes:
        columns: assigned column of each row (rows,); -1 = none.
        cost: sum of the assigned costs, and of the miss costs of unassigned rows where these have one.
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


def assign_sparse(rows: ArrayLike, columns: ArrayLike, costs: ArrayLike, *, shape: tuple[int, int]) -> Assignment:
    """Assign rows to columns at minimum cost where few pairs are allowed, given as a list.

    The same answer as that of `assign` for the full matrix with `inf` for all other pairs, in the time and memory of
    the list.

    Args:
        rows: (n,) row of each allowed pair.
        columns: (n,) its column.
        costs: (n,) its cost; of a pair that is there twice the cheaper counts.
        shape: number of rows and of columns.

    Raises:
        NonFiniteError: a cost is NaN or minus infinity.
        DimensionError: the lists have different lengths.
        ParameterError: a pair lies outside of the shape.

    Reference:
        Jonker, Volgenant (1987), A shortest augmenting path algorithm for dense and sparse linear assignment problems.

    Example:
        >>> import trackrs as tr
        >>> tr.association.assign_sparse([0, 0, 1], [0, 1, 0], [1.0, 2.0, 1.0], shape=(2, 3)).columns
        array([1, 0])
    """
    found, cost = _trackrs.assign_sparse(
        _indices(rows, "rows"), _indices(columns, "columns"), array(costs, "costs", 1), shape
    )
    return Assignment(frozen(found), cost)


def _indices(value: ArrayLike, name: str) -> IntArray:
    out = np.asarray(value)
    if out.ndim != 1 or (out.size and out.dtype.kind not in "iu"):
        msg = f"{name} must be a list of whole numbers, got {out.dtype} of shape {out.shape}"
        raise DimensionError(msg)
    return out.astype(np.int64, copy=False)


def k_best(costs: ArrayLike, k: int, *, miss_costs: ArrayLike | None = None) -> tuple[Assignment, ...]:
    """Return the k assignments of least cost, the cheapest first; all of them if there are fewer.

    Without `miss_costs` they are those that `assign` chooses from: as many pairs as possible. Assignments of equal cost
    come in an order that depends on the numbers alone.

    Args:
        costs: (rows, columns); `inf` = forbidden pair.
        k: how many.
        miss_costs: (rows,) what it costs to leave a row unassigned; any row may then be.

    Raises:
        NonFiniteError: a cost is NaN or minus infinity, or a miss cost not finite.
        DimensionError: there is not one miss cost for each row.
        ParameterError: `k` is negative.

    Reference:
        Murty (1968), An algorithm for ranking all the assignments in order of increasing cost; Miller, Stone, Cox
        (1997), Optimizing Murty's ranked assignment method.

    Example:
        >>> import trackrs as tr
        >>> [best.cost for best in tr.association.k_best([[1.0, 2.0], [2.0, 4.0]], k=2)]
        [4.0, 5.0]
        >>> [best.columns.tolist() for best in tr.association.k_best([[1.0, 2.0]], k=2, miss_costs=[1.5])]
        [[0], [-1]]
    """
    misses = None if miss_costs is None else array(miss_costs, "miss_costs", 1)
    return tuple(
        Assignment(frozen(columns), cost) for columns, cost in _trackrs.k_best(array(costs, "costs", 2), k, misses)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Marginals:
    """Result of `marginals`.

    Attributes:
        probabilities: (T, 1 + M) probability that a track has no report (column 0) or report j (column 1 + j); rows sum
            to 1.
        method: "exact"; "m_best", from the most likely joint events; "belief", loopy belief propagation. That of the
            cluster that was hardest.
        error_bound: share of the weight of all joint events that was left out, at most: no probability is wrong by
            more. 0 where exact, None where nothing is known.
        log_total: natural logarithm of the sum of the weights of all joint events that were counted; an estimate of it
            by belief propagation.
    """

    probabilities: FloatArray
    method: Literal["exact", "m_best", "belief"]
    error_bound: float | None
    log_total: float


def marginals(weights: ArrayLike, *, log: bool = False, budget: int = 10_000_000, prune: bool = False) -> Marginals:
    """Return with what probability each track has each report, given that no report is of two tracks (JPDA).

    A joint event gives every track one report or none, and no report to two tracks. Its weight is the product of the
    tracks' weights, and the probability of a pair the share of the events that hold it. Tracks that share no reports
    are treated apart. In each such cluster the sum is exact as long as the budget allows, whatever the weights; beyond
    it the result says what was done instead.

    Args:
        weights: (T, 1 + M). Column 0: the track is missed, 1 - P_D P_G. Column 1 + j: report j against clutter,
            P_D f / λ with the predicted density f of the report and the density λ of clutter there. 0 = impossible, as
            for a pair outside the gate.
        log: `weights` are natural logarithms, -inf = impossible.
        budget: transitions between subsets that the exact sum of one cluster may take, each a few nanoseconds and at
            most 16 bytes. 16 tracks and 16 reports, all gated, need 8 million.
        prune: of the events that give the same reports to the same tracks count only the most likely (JPDA*), so that
            close tracks do not coalesce. Beyond the budget the most likely events are enumerated, and `error_bound` may
            be large.

    Raises:
        NonFiniteError: a weight is NaN or infinite.
        ParameterError: a weight is negative, a track can neither be missed nor have a report, or no joint event is
            possible.
        DimensionError: not a matrix.

    Reference:
        Fortmann, Bar-Shalom, Scheffe (1983), Sonar tracking of multiple targets using joint probabilistic data
        association; Williams, Lau (2014) for belief propagation; Blom, Bloem (2000) for pruning. docs/association.md
        has the equations and measured errors.

    Example:
        >>> import trackrs as tr
        >>> found = tr.association.marginals([[0.1, 4.0, 1.0], [0.1, 2.0, 0.0]])
        >>> found.probabilities.round(3)
        array([[0.077, 0.148, 0.775],
               [0.188, 0.812, 0.   ]])
        >>> found.method, found.error_bound
        ('exact', 0.0)
    """
    probabilities, method, error_bound, log_total = _trackrs.marginals(array(weights, "weights", 2), log, budget, prune)
    return Marginals(frozen(probabilities), method, error_bound, log_total)
