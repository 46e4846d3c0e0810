"""Gates: which reports a track may get."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import array, frozen
from trackrs.errors import DimensionError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from trackrs._arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class GatedPairs:
    """The pairs of track and report inside the gates: track by track, in the order of the reports.

    Attributes:
        tracks, reports: (K,) indices of both.
        distances: (K,) squared Mahalanobis distances.
    """

    tracks: IntArray
    reports: IntArray
    distances: FloatArray

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.tracks)


@dataclass(frozen=True, slots=True)
class Gate:
    """An ellipsoidal gate that holds a target's own report with this probability.

    Args:
        probability: in [0, 1]; 1 lets everything through.

    Example:
        >>> import trackrs as tr
        >>> round(tr.Gate(0.99).threshold(2), 4)
        9.2103
    """

    probability: float = 0.99

    def threshold(self, dof: int) -> float:
        """Return the bound on the squared Mahalanobis distance for `dof` observed components.

        Raises:
            ParameterError: the probability is outside [0, 1] or `dof` is 0.
        """
        return _trackrs.chi_square_quantile(self.probability, dof)

    def pairs(self, means: ArrayLike, covs: ArrayLike, reports: ArrayLike) -> GatedPairs:
        """Return the pairs inside the gates of many tracks, for measurements whose components add (no angles).

        The cost grows with the number of tracks, reports and pairs near one another, not with tracks times reports
        (Bar-Shalom, Li 1995, section 1.4.2).

        Args:
            means: (T, m) what each track expects to be measured.
            covs: (T, m, m) the covariance of each.
            reports: (M, m); one with a NaN is in no gate.

        Raises:
            DimensionError: the shapes do not fit.
            NonFiniteError: a mean is not finite.
            NotPositiveDefiniteError: a covariance is not positive definite.

        Example:
            >>> import trackrs as tr
            >>> pairs = tr.Gate(0.99).pairs([[0.0, 0.0]], [[[4.0, 0.0], [0.0, 1.0]]], [[4.0, 1.0], [0.0, 9.0]])
            >>> pairs.reports, pairs.distances
            (array([0]), array([5.]))
        """
        centres, spreads, values = array(means, "means", 2), array(covs, "covs", 3), array(reports, "reports", 2)
        found = _trackrs.gate_pairs(centres, spreads, values, self.threshold(centres.shape[1]))
        return GatedPairs(**{name: frozen(column) for name, column in found.items()})


def squared_distances(
    means: ArrayLike, covs: ArrayLike, reports: ArrayLike, *, out: FloatArray | None = None
) -> FloatArray:
    """Return the squared Mahalanobis distance of every track and report, (T, M), for measurements whose components add.

    Args:
        means: (T, m) what each track expects to be measured.
        covs: (T, m, m) the covariance of each.
        reports: (M, m); one with a NaN is NaN from everything.
        out: (T, M) array to write to, C-contiguous float64; it is returned. Saves its memory where calls are many.

    Raises:
        DimensionError: the shapes do not fit.
        NonFiniteError: a mean is not finite.
        NotPositiveDefiniteError: a covariance is not positive definite.
    """
    centres, spreads, values = array(means, "means", 2), array(covs, "covs", 3), array(reports, "reports", 2)
    shape = (len(centres), len(values))
    if out is None:
        out = np.empty(shape)
    elif out.dtype != np.float64 or out.shape != shape or not out.flags.c_contiguous or not out.flags.writeable:
        msg = (
            f"out must be a writeable C-contiguous float64 array of shape {shape}, got {out.dtype} of shape {out.shape}"
        )
        raise DimensionError(msg)
    _trackrs.gate_distances(centres, spreads, values, out)
    return out
