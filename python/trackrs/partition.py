"""Functions of points: how they fall into cells. What is clutter says `trackrs.lof`, and `trackrs.tree` has the trees.

Every partitioner works on points (n, d) and has `partitions(points)`: one or more divisions of all points into disjoint
cells. Those that give one also have `fit_predict(points)`, with labels as scikit-learn gives them (-1 = clutter).

`noise` is the covariance (d, d) of one measurement about its target's centre. With it distances are Mahalanobis
distances times the effective standard deviation s = sqrt(trace(noise) / d): lengths keep their unit, an isotropic noise
changes none, and lengths that are not given follow from s. `clutter_filter` makes every point that it finds to be
clutter a cell of its own, before the others are divided.

All of it raises `NonFiniteError` for points or a noise that are not finite, `DimensionError` for shapes that do not
fit, `NotPositiveDefiniteError` for a noise that is not positive definite, and `ParameterError` for a parameter outside
its domain or more than 50 million labels in all. No points give one partition without cells. Memory is O(n) beyond what
is returned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from trackrs.lof import LocalOutlierFactor


@dataclass(frozen=True, slots=True, eq=False)
class Partitions:
    """Partitions of the same points.

    Attributes:
        labels: the cell of every point in every partition (P, n); cells are numbered by their first points.
    """

    labels: IntArray

    def __len__(self) -> int:
        return len(self.labels)

    def cells(self, index: int) -> list[IntArray]:
        """Return the cells of one partition, each as the ascending indices of its points."""
        labels = self.labels[index]
        order = np.argsort(labels, kind="stable")
        return [frozen(cell) for cell in np.split(order, np.cumsum(np.bincount(labels))[:-1])] if len(labels) else []


@dataclass(frozen=True, slots=True, eq=False)
class DecisionGraph:
    """Every step of density peaks; the decision graph is `delta` over `rho`.

    Attributes:
        d_c: scale of the density, unit of the points.
        rho: density of every point (n,).
        delta: distance to the nearest denser point (n,); of the densest: to the farthest.
        gamma: rho times delta (n,).
        nearest_denser: index of that point (n,); -1 for the densest.
        order: the points by descending density (n,).
        peaks: the peaks by descending gamma.
        labels: the cell of every point (n,); cell i is that of peak i, cells that a long link has started follow.
    """

    d_c: float
    rho: FloatArray
    delta: FloatArray
    gamma: FloatArray
    nearest_denser: IntArray
    order: IntArray
    peaks: IntArray
    labels: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class TwoLevels:
    """Every step of a two-level partition.

    Attributes:
        graph: the first level, K cells.
        mean_density: mean density of the cells of the first level (K,).
        borders: pairs of cells of the first level that touch (B, 2), the lower first.
        border_density: their border densities (B,).
        labels: the joined cell of every point (n,).
    """

    graph: DecisionGraph
    mean_density: FloatArray
    borders: IntArray
    border_density: FloatArray
    labels: IntArray


def _frozen(record: dict[str, Any]) -> dict[str, Any]:
    return {key: frozen(value) if isinstance(value, np.ndarray) else value for key, value in record.items()}


def _points(points: ArrayLike, noise: ArrayLike | None) -> tuple[FloatArray, FloatArray | None]:
    return array(points, "points", 2), None if noise is None else array(noise, "noise", 2)


class _Partitioner:
    """What all partitioners do."""

    __slots__ = ()

    @property
    def _core(self) -> _trackrs.Partitioner:
        raise NotImplementedError

    def partitions(
        self, points: ArrayLike, *, noise: ArrayLike | None = None, clutter_filter: LocalOutlierFactor | None = None
    ) -> Partitions:
        """Return the partitions of points (n, d); see the module for `noise` and `clutter_filter`."""
        clutter = None if clutter_filter is None else clutter_filter._core
        return Partitions(frozen(self._core.partitions(*_points(points, noise), clutter)))


class _Single(_Partitioner):
    """What those do that give one partition."""

    __slots__ = ()

    def fit_predict(self, points: ArrayLike, *, noise: ArrayLike | None = None) -> IntArray:
        """Return the label of every point (n,); -1 = clutter.

        Raises:
            ParameterError: this partitioner gives several partitions.
        """
        return frozen(self._core.labels(*_points(points, noise)))


@dataclass(frozen=True, slots=True)
class DistancePartition(_Single):
    """All distinct partitions into what hops of at most theta connect, theta in a range.

    Args:
        thresholds: the range of theta, two numbers; or how it follows from the chi-square distribution of d degrees of
            freedom: "literature" takes that of a measurement about its target, "difference" that of the difference of
            two measurements, whose covariance is twice as large. In units of the Mahalanobis distance; without `noise`,
            of the points.
        probabilities: of that distribution, at the two ends of the range.
        threshold: one theta instead of a range: one partition.
        detections_per_target: mean measurements per target. If given, every cell that is more likely to come from
            several targets adds a partition in which k-means splits it.
        seed: of those splits.

    Raises:
        ParameterError: a threshold is negative, the upper below the lower, or a probability outside [0, 1).

    Reference:
        Granström, Lundquist, Orguner (2012), Extended target tracking using a Gaussian-mixture PHD filter; spec 6.1.
        The partitions are read off a minimum spanning tree; "difference" is not in the paper.

    Example:
        >>> import trackrs as tr
        >>> tr.DistancePartition(thresholds=(1.0, 4.0)).partitions([[0.0], [1.0], [3.0]]).labels
        array([[0, 0, 1],
               [0, 0, 0]])
        >>> tr.DistancePartition(threshold=1.0).fit_predict([[0.0], [1.0], [3.0]])
        array([0, 0, 1])
    """

    thresholds: Literal["literature", "difference"] | tuple[float, float] = "literature"
    probabilities: tuple[float, float] = (0.3, 0.8)
    threshold: float | None = None
    detections_per_target: float | None = None
    seed: int = 0

    @property
    def _core(self) -> _trackrs.Partitioner:
        one = self.threshold
        thresholds = self.thresholds if one is None else (one, one)
        return _trackrs.Partitioner.distance(thresholds, self.probabilities, self.detections_per_target, self.seed)


@dataclass(frozen=True, slots=True)
class KMeansPartition(_Single):
    """K-means with k-means++ seeding, one run and one partition per K.

    Args:
        k: clusters, one number or the first and last of a range; more than points are as many as points.
        seed: the run of K draws from stream (seed, K).

    Raises:
        ParameterError: k is below 1, or the range is empty.

    Reference:
        Arthur, Vassilvitskii (2007), k-means++: the advantages of careful seeding; spec 6.2.

    Example:
        >>> import trackrs as tr
        >>> tr.KMeansPartition(k=2).fit_predict([[0.0], [1.0], [9.0]])
        array([0, 0, 1])
    """

    k: int | tuple[int, int] = (1, 20)
    seed: int = 0

    @property
    def _core(self) -> _trackrs.Partitioner:
        lower, upper = self.k if isinstance(self.k, tuple) else (self.k, self.k)
        return _trackrs.Partitioner.kmeans(lower, upper, self.seed)


@dataclass(frozen=True, slots=True)
class DbscanPartition(_Single):
    """Clusters of what can be reached from core points in hops of at most `eps`; noise points are cells of their own.

    Args:
        eps: largest distance of neighbours; None: 1.5 effective standard deviations of `noise`.
        min_samples: a core point has so many neighbours, itself among them.

    Raises:
        ParameterError: `eps` is negative, or neither it nor `noise` is given; `min_samples` is below 1.

    Reference:
        Ester, Kriegel, Sander, Xu (1996), A density-based algorithm for discovering clusters; spec 6.3.

    Example:
        >>> import trackrs as tr
        >>> tr.DbscanPartition(eps=1.0, min_samples=2).fit_predict([[0.0], [1.0], [9.0]])
        array([ 0,  0, -1])
    """

    eps: float | None = None
    min_samples: int = 3

    @property
    def _core(self) -> _trackrs.Partitioner:
        return _trackrs.Partitioner.dbscan(self.eps, self.min_samples)


@dataclass(frozen=True, slots=True)
class DensityPeakPartition(_Single):
    """Cells around density peaks: points that are dense, and far from everything denser.

    Args:
        d_c: scale of the density, unit of the points; None and no `percent`: the effective standard deviation of
            `noise`.
        percent: instead, d_c is the distance that so many percent of all pairs do not exceed; where that is zero, the
            first that is not.
        kernel: a neighbour at distance d adds exp(-(d / d_c)²) to the density ("gaussian"), or one if d < d_c
            ("cutoff").
        peaks: "distance": the points whose delta exceeds `peak_distance` d_c, and the densest; "gap": those before the
            largest ratio of one gamma to the next; or how many, by descending gamma.
        peak_distance: in units of d_c, for the distance rule.
        max_link: a point farther than so many d_c from the nearest denser one starts a cell. None: it joins that one's,
            however far. Useful with the gap rule or a number of peaks; the distance rule makes no longer links.

    Raises:
        ParameterError: a parameter is outside its domain, both `d_c` and `percent` are given, or there is nothing that
            d_c could follow from.

    Reference:
        Rodriguez, Laio (2014), Clustering by fast search and find of density peaks; spec 6.5. The distance rule and
        `max_link` are not in the paper.

    Example:
        >>> import trackrs as tr
        >>> points = [[0.0], [0.5], [1.0], [7.0], [7.4]]
        >>> tr.DensityPeakPartition(d_c=1.0).fit_predict(points)
        array([0, 0, 0, 1, 1])
        >>> tr.DensityPeakPartition(d_c=1.0).explain(points).peaks
        array([1, 3])
    """

    d_c: float | None = None
    percent: float | None = None
    kernel: Literal["gaussian", "cutoff"] = "gaussian"
    peaks: Literal["distance", "gap"] | int = "distance"
    peak_distance: float = 2.0
    max_link: float | None = None

    @property
    def _core(self) -> _trackrs.Partitioner:
        return _trackrs.Partitioner.density_peak(
            self.d_c, self.percent, self.kernel, self.peaks, self.peak_distance, self.max_link
        )

    def explain(self, points: ArrayLike, *, noise: ArrayLike | None = None) -> DecisionGraph:
        """Return every step for points (n, d)."""
        return DecisionGraph(**_frozen(self._core.explain(*_points(points, noise))))


@dataclass(frozen=True, slots=True)
class TwoLevelPartition(_Single):
    """Density peaks, whose cells are joined where their border is as dense as one of them.

    The chain of the paper is this with a `LocalOutlierFactor` as `clutter_filter`.

    Args:
        d_c: see `DensityPeakPartition`.
        percent: the same.
        kernel: the same.
        peaks: the same.
        peak_distance: the same.
        max_link: the same.
        border: density of a border: the largest mean density of two points of different cells nearer than d_c ("max"),
            or the mean density of all such points ("mean").
        beta: two cells are joined if their border reaches this share of the mean density of one of them. With 0.5 cells
            of any shape stay whole, and targets close to each other are joined.

    Raises:
        ParameterError: as `DensityPeakPartition`; `beta` is not positive.

    Reference:
        Spec 6.6. The paper does not say what the density of a border is; "max" is that of Rodriguez and Laio (2014).

    Example:
        >>> import trackrs as tr
        >>> chain = tr.TwoLevelPartition(d_c=1.0)
        >>> clutter = tr.LocalOutlierFactor(2)
        >>> chain.partitions([[0.0], [0.5], [1.0], [1.4], [40.0]], clutter_filter=clutter).cells(0)
        [array([0, 1, 2, 3]), array([4])]
    """

    d_c: float | None = None
    percent: float | None = None
    kernel: Literal["gaussian", "cutoff"] = "gaussian"
    peaks: Literal["distance", "gap"] | int = "distance"
    peak_distance: float = 2.0
    max_link: float | None = None
    border: Literal["max", "mean"] = "max"
    beta: float = 1.0

    @classmethod
    def as_printed(cls) -> TwoLevelPartition:
        """Return the paper's chain: d_c such that 2 % of the distances are shorter, peaks before the largest gap.

        The rule of 2 % presumes thousands of points; with the 75 of a scan it breaks targets apart. The defaults, with
        `noise` given, are the parameters that work.
        """
        return cls(percent=2.0, peaks="gap")

    @property
    def _core(self) -> _trackrs.Partitioner:
        return _trackrs.Partitioner.two_level(
            self.d_c,
            self.percent,
            self.kernel,
            self.peaks,
            self.peak_distance,
            self.max_link,
            self.border,
            self.beta,
        )

    def explain(self, points: ArrayLike, *, noise: ArrayLike | None = None) -> TwoLevels:
        """Return every step for points (n, d)."""
        found = _frozen(self._core.explain(*_points(points, noise)))
        return TwoLevels(**{**found, "graph": DecisionGraph(**_frozen(found["graph"]))})
