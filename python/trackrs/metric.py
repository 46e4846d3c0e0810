"""Scores: distances between sets of targets, consistency of covariances, and tracks against truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from struct import Struct
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, freeze_columns, frozen, frozen_array
from trackrs.errors import DimensionError, ParameterError
from trackrs.runs import ChiSquareTests, Whiteness

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from trackrs.types import Tracks


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


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Where one target really was.

    Args:
        id: its name.
        times: (T,) seconds, increasing.
        positions: (T, d) metres.
    """

    id: str
    times: FloatArray
    positions: FloatArray

    def __init__(self, id: str, times: ArrayLike, positions: ArrayLike) -> None:  # noqa: A002
        """Copy the arrays."""
        object.__setattr__(self, "id", str(id))
        object.__setattr__(self, "times", frozen_array(times, "times", 1))
        object.__setattr__(self, "positions", frozen_array(positions, "positions", 2))
        if len(self.times) != len(self.positions):
            msg = f"truth {self.id} has {len(self.times)} times and {len(self.positions)} positions"
            raise DimensionError(msg)


@dataclass(frozen=True, slots=True)
class TargetScore:
    """What became of one target.

    Attributes:
        id: its name.
        present: scored times with the target inside the region.
        held: of these, times with a track paired with it.
        fragments: tracks that held it one after the other.
        switches: changes from one track to another.
        longest: the longest time one track held it, as a share of `present`.
    """

    id: str
    present: int
    held: int
    fragments: int
    switches: int
    longest: float


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Tracks against truth.

    Attributes:
        times: (S,) scored times.
        targets, tracks: (S,) targets inside the region and tracks that count.
        series: per metric, its value at every scored time (S,).
        mean: per metric, the mean over the scored times.
        localisation, missed, false_tracks: mean p-th powers of the parts of GOSPA.
        all_held: of the times with every target inside the region, the share with every target held.
        switches: changes of track, all targets together.
        false_ids: tracks that were counted but never paired.
        false_per_minute: their number per minute.
        rmse: of the paired positions, metres.
        nees: mean position NEES of the pairs; the number of coordinates if covariances are honest.
        per_target: one record per target.
    """

    times: FloatArray
    targets: IntArray
    tracks: IntArray
    series: dict[OSPA | GOSPA, FloatArray]
    mean: dict[OSPA | GOSPA, float]
    localisation: float
    missed: float
    false_tracks: float
    all_held: float
    switches: int
    false_ids: tuple[int, ...]
    false_per_minute: float
    rmse: float
    nees: float
    per_target: tuple[TargetScore, ...]


def evaluate(
    truth: Sequence[Truth],
    tracks: Tracks,
    metrics: Sequence[OSPA | GOSPA],
    *,
    sensor: str | None = None,
    start: float | None = None,
    region: float | None = None,
    centres: ArrayLike | None = None,
) -> Evaluation:
    """Score tracks against truth at the times of their scans.

    The truth is interpolated linearly. Targets and tracks are paired by GOSPA with the cutoff and order of the first
    metric. A track whose nearest target is outside the region and closer than the cutoff does not count.

    Args:
        truth: the targets.
        tracks: as a tracker's `run` gives them.
        metrics: at least one of `OSPA` and `GOSPA`.
        sensor: score at the scans of this sensor only.
        start: score from this time on, seconds.
        region: radius around `centres`, metres; what is outside does not count.
        centres: (S, d) centre of the region at every scan of `tracks`, or one centre (d,) for all.

    Raises:
        ParameterError: no metric, no scored time, or one of `region` and `centres` without the other.
    """
    if not metrics:
        msg = "metrics is empty: pass at least one, for example [GOSPA(c=30.0)]"
        raise ParameterError(msg)
    if (region is None) != (centres is None):
        msg = "region and centres go together: a radius and where it is centred"
        raise ParameterError(msg)
    chosen = [
        k
        for k, time in enumerate(tracks.scan_times)
        if (sensor is None or tracks.sensors[k] == sensor) and (start is None or time >= start)
    ]
    if not chosen:
        which = "" if sensor is None else f" of sensor {sensor!r}"
        since = "" if start is None else f" from {start} s on"
        msg = f"there is no scan{which}{since}: nothing to score"
        raise ParameterError(msg)
    rows = [np.arange(tracks.offsets[k], tracks.offsets[k + 1]) for k in chosen]
    picked = np.concatenate(rows)
    middle = None
    if centres is not None:
        every = np.broadcast_to(np.asarray(centres, dtype=np.float64), (len(tracks.scan_times), np.shape(centres)[-1]))
        middle = array(every[chosen], "centres", 2)
    outs: list[tuple[OSPA | GOSPA, dict[str, Any]]] = []
    for metric in metrics:
        out = _trackrs.evaluate(
            [(path.id, path.times, path.positions) for path in truth],
            array(tracks.scan_times[chosen], "times", 1),
            [0, *np.cumsum([len(part) for part in rows]).tolist()],
            tracks.ids[picked].tolist(),
            array(tracks.means[picked], "means", 2),
            array(tracks.covs[picked], "covs", 3),
            metric.c,
            metric.p,
            metric.alpha if isinstance(metric, GOSPA) else 2.0,
            middle,
            region,
        )
        outs.append((metric, freeze_columns(out)))
    first = outs[0][1]
    series = {metric: out["gospa" if isinstance(metric, GOSPA) else "ospa"] for metric, out in outs}
    return Evaluation(
        times=frozen(tracks.scan_times[chosen].copy()),
        targets=first["targets"],
        tracks=first["tracks"],
        series=series,
        mean={metric: float(values.mean()) for metric, values in series.items()},
        localisation=float(first["localisation"].mean()),
        missed=float(first["missed"].mean()),
        false_tracks=float(first["false_tracks"].mean()),
        all_held=first["all_held"],
        switches=first["switches"],
        false_ids=tuple(first["false_ids"]),
        false_per_minute=first["false_per_minute"],
        rmse=first["rmse"],
        nees=first["nees"],
        per_target=tuple(TargetScore(**target) for target in first["per_target"]),
    )
