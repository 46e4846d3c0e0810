"""Scores: distances between sets of targets, and consistency of covariances."""

from __future__ import annotations

from dataclasses import dataclass, field
from struct import Struct
from typing import TYPE_CHECKING

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, freeze_columns
from trackrs.runs import ChiSquareTests, Whiteness

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class OspaDistance:
    """OSPA with its parts, metres; `total**p == localisation**p + cardinality**p`."""

    total: float
    localisation: float
    cardinality: float


@dataclass(frozen=True, slots=True)
class Pair:
    """A target and an estimate that belong together: their indices and their distance in metres."""

    truth: int
    estimate: int
    distance: float


_PAIR = Struct("<qqd")  # two indices and a distance


@dataclass(frozen=True, slots=True)
class GospaDistance:
    """GOSPA with its parts.

    Attributes:
        total: metres.
        localisation, missed, false_tracks: p-th powers; `total**p` is their sum.
        pairs: targets and estimates that belong together; made when they are asked for.
    """

    total: float
    localisation: float
    missed: float
    false_tracks: float
    _packed: bytes = field(repr=False)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Targets and estimates that belong together, in the order of the targets."""
        return tuple(Pair(*pair) for pair in _PAIR.iter_unpack(self._packed))


@dataclass(frozen=True, slots=True)
class OSPA:
    """The OSPA metric as an argument of `evaluate`.

    Args:
        c: cutoff, metres.
        p: order, at least 1.
    """

    c: float
    p: float = 2.0


@dataclass(frozen=True, slots=True)
class GOSPA:
    """The GOSPA metric as an argument of `evaluate`.

    Args:
        c: cutoff, metres: targets and tracks farther apart do not match.
        p: order, at least 1.
        alpha: in (0, 2]; 2 splits the metric into localisation, missed and false.
    """

    c: float
    p: float = 2.0
    alpha: float = 2.0


def _points(points: ArrayLike, name: str) -> FloatArray:
    size = points.size if type(points) is np.ndarray else np.size(points)
    return array(points, name, 2) if size else np.zeros((0, 0))


def _extents(extents: ArrayLike) -> FloatArray:
    return np.zeros((0, 0, 0)) if np.size(extents) == 0 else array(extents, "extents", 3)


def ospa(x: ArrayLike, y: ArrayLike, c: float, p: float = 2.0) -> OspaDistance:
    """Return the OSPA distance of two sets of points.

    Args:
        x: points (k, d), may be empty.
        y: points (l, d), may be empty.
        c: cutoff, metres.
        p: order, at least 1.

    Raises:
        ParameterError: c is not positive or p below 1.
        DimensionError: the points have different numbers of coordinates.

    Reference:
        Schuhmacher, Vo, Vo (2008), A consistent metric for performance evaluation of multi-object filters.

    Example:
        >>> import trackrs as tr
        >>> tr.ospa([[0.0, 0.0]], [[3.0, 4.0]], c=10.0).total
        5.0
    """
    return OspaDistance(*_trackrs.ospa(_points(x, "x"), _points(y, "y"), c, p))


def gospa(
    truth: ArrayLike,
    estimates: ArrayLike,
    c: float,
    p: float = 2.0,
    alpha: float = 2.0,
    *,
    extents: tuple[ArrayLike, ArrayLike] | None = None,
) -> GospaDistance:
    """Return the GOSPA distance of estimates from the truth.

    Args:
        truth: points (k, d), may be empty.
        estimates: points (l, d), may be empty.
        c: cutoff, metres.
        p: order, at least 1.
        alpha: in (0, 2].
        extents: of truth (k, d, d) and estimates (l, d, d), positive definite covariances as those of `Tracks`: the
            distance of two targets is then the Gaussian-Wasserstein distance, of their centres and of their extents.

    Raises:
        ParameterError: a parameter is outside its domain.
        DimensionError: the points have different numbers of coordinates.

    Reference:
        Rahmathullah, Garcia-Fernandez, Svensson (2017), Generalized optimal sub-pattern assignment metric; Yang, Baum,
        Granström (2016), Metrics for performance evaluation of elliptic extended object tracking methods.

    Example:
        >>> import trackrs as tr
        >>> tr.gospa([[0.0], [50.0]], [[3.0]], c=10.0).missed
        50.0
    """
    covs = None if extents is None else (_extents(extents[0]), _extents(extents[1]))
    return GospaDistance(*_trackrs.gospa(_points(truth, "truth"), _points(estimates, "estimates"), c, p, alpha, covs))


def nees(errors: ArrayLike, covs: ArrayLike) -> ChiSquareTests:
    """Test estimation errors against their covariances: the normalised error squared of every row, eᵀ P⁻¹ e.

    Args:
        errors: (T, n).
        covs: (T, n, n), positive definite.

    Returns:
        `statistics` (T,), with mean n if the covariances are honest, `dof` and `p_values`.

    Raises:
        DimensionError: the shapes do not agree.
        NonFiniteError: an error is NaN or infinite.
        NotPositiveDefiniteError: a covariance is singular.

    Reference:
        Bar-Shalom, Li, Kirubarajan (2001), §5.4.

    Example:
        >>> import trackrs as tr
        >>> tr.nees([[3.0, 4.0]], [[[9.0, 0.0], [0.0, 16.0]]]).statistics
        array([2.])
    """
    return ChiSquareTests(**freeze_columns(_trackrs.nees(array(errors, "errors", 2), array(covs, "covs", 3))))


def nis(innovations: ArrayLike, covs: ArrayLike) -> ChiSquareTests:
    """Test innovations against their covariances: the normalised innovation squared of every row, rᵀ D⁺ r.

    Covariances may be singular, as where R was estimated from fewer measurements than components: directions whose
    eigenvalue is at most 1e-12 of the largest are dropped, and the rank is the number of degrees of freedom. An
    innovation along a dropped direction, more than ten standard deviations of such an eigenvalue, contradicts its
    covariance: its statistic is infinite and its p-value 0.

    Args:
        innovations: (T, m), for example those of a `FilterRun`; NaN = component not observed, left out.
        covs: (T, m, m).

    Returns:
        `statistics`, `dof` and `p_values` (T,); NaN where nothing was observed.

    Raises:
        DimensionError: the shapes do not agree.
        NonFiniteError: an innovation is infinite, or a covariance of observed components not finite.
        ParameterError: a covariance is not symmetric or not positive semidefinite.

    Reference:
        Xi, Liu, Tao, Lu, eq. (13); spec labels U20, U21.

    Example:
        >>> import trackrs as tr
        >>> tests = tr.nis([[2.0, 2.0]], [[[1.0, 1.0], [1.0, 1.0]]])
        >>> tests.statistics.round(9), tests.dof
        (array([4.]), array([1]))
    """
    return ChiSquareTests(**freeze_columns(_trackrs.nis(array(innovations, "innovations", 2), array(covs, "covs", 3))))


def whiteness(innovations: ArrayLike, covs: ArrayLike, lags: int = 10) -> Whiteness:
    """Test whether innovations are uncorrelated over time, as those of a filter with the right model are.

    Motion noise assumed too small gives positive correlations: the filter lags behind, one way for several
    measurements. Too large gives negative ones. The test sees nothing of their size, which is for `nis`.

    Args:
        innovations: (T, m) in the order of time, for example those of a `FilterRun`; NaN = component not observed.
        covs: (T, m, m) their covariances, positive definite.
        lags: largest distance of two measurements, at least 1, below T.

    Returns:
        The correlation of every component of the whitened innovations with itself, lag by lag, with its band; and the
        portmanteau statistic over all lags and pairs of components with degrees of freedom and p-value.

    Raises:
        ParameterError: `lags` is out of range.
        DimensionError: the shapes do not agree.
        NonFiniteError: an innovation is infinite.
        NotPositiveDefiniteError: a covariance is singular.

    Reference:
        Ljung, Box (1978), On a measure of lack of fit in time series models; Hosking (1980), The multivariate
        portmanteau statistic; Stoffer, Toloi (1992) for gaps.

    Example:
        >>> import numpy as np, trackrs as tr
        >>> noise = np.random.default_rng(0).normal(size=(200, 2))
        >>> tests = tr.whiteness(noise, np.tile(np.eye(2), (200, 1, 1)), lags=5)
        >>> tests.dof, tests.p_value > 0.01
        (20, True)
    """
    z, s = array(innovations, "innovations", 2), array(covs, "covs", 3)
    return Whiteness(**freeze_columns(_trackrs.whiteness(z, s, lags)))


def rmse(errors: ArrayLike) -> float:
    """Return the root mean square length of the rows of `errors` (T, d)."""
    return float(np.sqrt(np.mean(np.sum(array(errors, "errors", 2) ** 2, axis=1))))
