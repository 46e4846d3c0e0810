"""Trackers by intensity: one mixture of Gaussians for all targets, whose weights add to their expected number.

No report is ever given to a track: what is tracked is where targets are, how many, and which of them are the same as
before. That is what targets need which give many reports in a scan, so that a report is not "the" report of anything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array
from trackrs.errors import DimensionError
from trackrs.partition import (
    DbscanPartition,
    DensityPeakPartition,
    DistancePartition,
    KMeansPartition,
    LocalOutlierFactor,
    TreePartition,
    TwoLevelPartition,
)
from trackrs.tracker import Recorder, by_sensor, tracks
from trackrs.types import GaussianState, Tracks, freeze_columns

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Self

    from numpy.typing import ArrayLike

    from trackrs.motion import Motion
    from trackrs.sensor import Sensor
    from trackrs.types import Scan

Partition: TypeAlias = (
    TreePartition | DistancePartition | KMeansPartition | DbscanPartition | DensityPeakPartition | TwoLevelPartition
)


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


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """An intensity.

    Attributes:
        weights: expected number of targets in every component (J,).
        means, covs: (J, n) and (J, n, n).
        detection_rates: mean number of measurements of every component (J,).
    """

    weights: FloatArray
    means: FloatArray
    covs: FloatArray
    detection_rates: FloatArray

    def __len__(self) -> int:
        """Return the number of components."""
        return len(self.weights)


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedGMPHD:
    """Gaussian-mixture PHD filter for extended targets: such as give many measurements in a scan.

    The default sums over all cuts of two trees over the measurements instead of trusting one partition, learns how many
    measurements every target gives, and lets targets that come close share measurements. With any other `partition` it
    is the filter of the literature: rates known, targets apart; so the paper's chain and its rivals are one argument
    away:

        phd.replace(partition=TwoLevelPartition(), clutter_filter=LocalOutlierFactor(4))    # the paper, as it works
        phd.replace(partition=TwoLevelPartition.as_printed(), clutter_filter=LocalOutlierFactor(10))   # as printed
        phd.replace(partition=DistancePartition())       # or DbscanPartition(), KMeansPartition()

    Args:
        motion: how targets move; every state must add (no attitudes).
        sensor: the sensor, or several by name. Its noise is the spread of one measurement about the target's centre:
            the sensor's own and the target's extent.
        birth: where targets may appear.
        detections_per_target: mean number of measurements of a target in a scan in which it is detected, or how it is
            treated. A number is learnt from there with trees and known with other partitions.
        clutter_density: false measurements per scan and unit of the measurement space (1/m² for positions), one for all
            sensors or by sensor.
        survival_probability: that a target is still there at the next scan, [0, 1].
        detection_probability: that a target gives measurements at all, (0, 1], one for all sensors or by sensor.
        partition: how measurements are divided into cells.
        clutter_filter: what is taken out before they are divided; each becomes a cell of its own.
        superposition: whether targets with common measurements may share them; None: with trees.
        spawns: what targets give off.
        filter: how nonlinear models are treated, as in `MultiTargetTracker`.
        prune: components of this weight and below go.
        merge: squared Mahalanobis distance up to which components become one.
        max_components: so many are kept.
        confirm_after: extractions that confirm a track. 1 reports every target at once.
        end_after: scans in a row without extraction that end a track.
        strict: the first event (a refused or late report) raises `StrictError`.

    Raises:
        ParameterError: a parameter is outside its domain, or missing for a sensor.
        DimensionError: a sensor, a birth or a spawn does not fit the motion.

    Reference:
        Granström, Lundquist, Orguner (2012), IEEE TAES 48(4); the defaults and the labels: spec 8 and 10.

    Example:
        >>> import numpy as np, trackrs as tr
        >>> start = tr.GaussianState([0, 0, 0, 0], np.diag([50.0, 50.0, 25.0, 25.0]) ** 2, time=0.0)
        >>> phd = tr.ExtendedGMPHD(
        ...     tr.ConstantVelocity(dims=2, accel_std=2.0),
        ...     tr.PositionSensor(dims=2, std=20.0),
        ...     birth=tr.Birth([start], weights=0.1),
        ...     detections_per_target=10,
        ...     clutter_density=2.5e-6,
        ... )
        >>> rng = np.random.default_rng(1)
        >>> scans = [
        ...     tr.Scan(t, [15.0 * t, 0.0] + 20.0 * rng.standard_normal((10, 2)), sensor="radar") for t in range(9)
        ... ]
        >>> tracks = phd.run(scans)
        >>> [track.id for track in tracks.at(8.0)], [round(n) for n in tracks.expected_targets[-3:]]
        ([1], [1, 1, 1])
    """

    motion: Motion
    sensor: Sensor | Mapping[str, Sensor]
    birth: Birth | AdaptiveBirth
    detections_per_target: float | DetectionRate
    clutter_density: float | Mapping[str, float]
    survival_probability: float = 0.99
    detection_probability: float | Mapping[str, float] = 0.99
    partition: Partition = TreePartition()  # noqa: RUF009 (frozen)
    clutter_filter: LocalOutlierFactor | None = None
    superposition: bool | None = None
    spawns: Sequence[Spawn] = ()
    filter: Literal["extended", "second_order", "unscented"] = "extended"
    prune: float = 1e-4
    merge: float = 4.0
    max_components: int = 100
    confirm_after: int = 2
    end_after: int = 3
    strict: bool = False

    def __post_init__(self) -> None:
        """Check everything now rather than at the first scan."""
        self.start()

    def replace(self, **changes: Any) -> Self:  # noqa: ANN401 (whatever the fields are)
        """Return the same filter with other arguments."""
        return replace(self, **changes)

    def start(self) -> IntensityTracker:
        """Return a tracker that has seen nothing yet, for scans as they come."""
        return IntensityTracker(self)

    def run(self, scans: Iterable[Scan]) -> Tracks:
        """Return the confirmed tracks after each of these scans, which are in the order of their times.

        Every run begins anew. A track is reported in the scans in which its target is extracted.

        Raises:
            TimeError: the times decrease.
            UnknownSensorError: a scan names a sensor that is not there; a single sensor takes every scan.
        """
        return self.start().run(scans)


class IntensityTracker(Recorder):
    """A filter at work; it goes on from where it stands.

    Args:
        phd: what defines it.
    """

    __slots__ = ()
    _kind = _trackrs.IntensityTracker

    def __init__(self, phd: ExtendedGMPHD) -> None:
        """Build the tracker."""
        sensors = phd.sensor if isinstance(phd.sensor, Mapping) else {"": phd.sensor}
        trees = isinstance(phd.partition, TreePartition)
        rate = phd.detections_per_target
        if not isinstance(rate, DetectionRate):
            rate = DetectionRate(rate, learnt=trees)
        adaptive = phd.birth if isinstance(phd.birth, AdaptiveBirth) else None
        settings = {
            "filter": phd.filter,
            "survival_probability": phd.survival_probability,
            "detection_probability": by_sensor(phd.detection_probability, sensors),
            "clutter_density": by_sensor(phd.clutter_density, sensors),
            "births": [] if isinstance(phd.birth, AdaptiveBirth) else _births(phd.birth),
            "adaptive_birth": None if adaptive is None else _items(adaptive),
            "spawns": [
                {"weight": spawn.weight, "mean": array(spawn.offset, "offset", 1), "cov": array(spawn.cov, "cov", 2)}
                for spawn in phd.spawns
            ],
            "rate": _items(rate),
            "superposition": trees if phd.superposition is None else phd.superposition,
            "prune": phd.prune,
            "merge": phd.merge,
            "max_components": phd.max_components,
            "confirm_after": phd.confirm_after,
            "end_after": phd.end_after,
            "strict": phd.strict,
        }
        cores = {name: sensor._core for name, sensor in sensors.items()}
        clutter = None if phd.clutter_filter is None else phd.clutter_filter._core
        self._core = _trackrs.IntensityTracker(phd.motion._core, cores, phd.partition._core, clutter, settings)
        self._labels = tuple(self._core.labels())

    def step(self, scan: Scan) -> Tracks:
        """Take in one scan and return the confirmed tracks at its time.

        A scan that cannot be used leaves everything as it was and is recorded in `events`.
        """
        return self._tracks(self._core.step(scan), [scan])

    def run(self, scans: Iterable[Scan]) -> Tracks:
        """Take in all scans, in the order of their times, and return the confirmed tracks after each.

        Raises:
            TimeError: the times decrease, or begin before the tracker's time.
            UnknownSensorError: a scan names a sensor that the tracker does not have.
        """
        scans = list(scans)
        return self._tracks(self._core.run(scans), scans)

    def _tracks(self, found: dict[str, Any], scans: list[Scan]) -> Tracks:
        return tracks(found["tracks"], scans, self._labels, expected_targets=found["expected_targets"])

    @property
    def mixture(self) -> Mixture:
        """The intensity after the last scan."""
        return Mixture(**freeze_columns(self._core.mixture()))


def _items(record: AdaptiveBirth | DetectionRate) -> dict[str, Any]:
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


def _births(birth: Birth) -> list[dict[str, Any]]:
    count = len(birth.states)
    weights = list(birth.weights) if isinstance(birth.weights, Sequence) else [birth.weights] * count
    if len(weights) != count:
        msg = f"birth weights: expected {count}, one per state, found {len(weights)}"
        raise DimensionError(msg)
    return [
        {"weight": weight, "mean": state.mean, "cov": state.cov}
        for weight, state in zip(weights, birth.states, strict=True)
    ]
