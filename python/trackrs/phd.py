"""Trackers by intensity: one mixture of Gaussians for all targets, whose weights add to their expected number.

No report is ever given to a track: what is tracked is where targets are, how many, and which of them are the same as
before. That is what targets need which give many reports in a scan, so that a report is not "the" report of anything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from trackrs import _trackrs
from trackrs._arrays import FloatArray, freeze_columns, frozen
from trackrs.errors import ParameterError
from trackrs.gating import Gate
from trackrs.intensity import AdaptiveBirth, DetectionRate, Mixture, spawned, weighted
from trackrs.late import DropLate, Late, items
from trackrs.partition import (
    DbscanPartition,
    DensityPeakPartition,
    DistancePartition,
    KMeansPartition,
    TwoLevelPartition,
)
from trackrs.tracker import Recorder, by_sensor, tracks
from trackrs.tree import TreePartition

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Self

    from trackrs.intensity import Birth, Extent, Spawn
    from trackrs.lof import LocalOutlierFactor
    from trackrs.motion import Motion
    from trackrs.sensor import Sensor
    from trackrs.types import GaussianState, Scan, Tracks

Partition: TypeAlias = (
    TreePartition | DistancePartition | KMeansPartition | DbscanPartition | DensityPeakPartition | TwoLevelPartition
)


@dataclass(frozen=True, slots=True, eq=False)
class _IntensityFilter:
    """What the filters have in common."""

    motion: Motion
    sensor: Sensor | Mapping[str, Sensor]
    birth: Birth | AdaptiveBirth
    clutter_density: float | Mapping[str, float]
    survival_probability: float = field(default=0.99, kw_only=True)
    detection_probability: float | Mapping[str, float] = field(default=0.99, kw_only=True)
    filter: Literal["extended", "second_order", "unscented"] = field(default="extended", kw_only=True)
    prune: float = field(default=1e-4, kw_only=True)
    merge: float = field(default=4.0, kw_only=True)
    max_components: int = field(default=100, kw_only=True)
    confirm_after: int = field(default=2, kw_only=True)
    end_after: int = field(default=3, kw_only=True)
    strict: bool = field(default=False, kw_only=True)
    late: Late = field(default=DropLate(), kw_only=True)

    def __post_init__(self) -> None:
        """Check everything now rather than at the first scan."""
        self.start()

    def replace(self, **changes: Any) -> Self:  # noqa: ANN401 (whatever the fields are)
        """Return the same filter with other arguments."""
        return replace(self, **changes)

    def start(
        self, initial: Sequence[GaussianState] = (), *, weights: float | Sequence[float] = 1.0
    ) -> IntensityTracker:
        """Return a tracker for scans as they come.

        Args:
            initial: targets that are known to be there, all at one time; none: nothing is known.
            weights: how many targets to expect in each of these states, one for all or one per state.
        """
        return IntensityTracker(self, initial, weights)

    def run(self, scans: Iterable[Scan]) -> Tracks:
        """Return the confirmed tracks after each of these scans, in the order of time.

        The scans are in that order, unless `late` says otherwise. Every run begins anew. A track is reported in the
        scans in which its target is extracted.

        Raises:
            TimeError: the times decrease, and late scans are dropped.
            UnknownSensorError: a scan names a sensor that is not there; a single sensor takes every scan.
        """
        return self.start().run(scans)

    def _settings(self) -> dict[str, Any]:
        """What the core needs beside the models."""
        sensors = self._sensors()
        adaptive, births = None, []
        if isinstance(self.birth, AdaptiveBirth):
            adaptive = asdict(self.birth)
        else:
            births = weighted("birth", self.birth.states, self.birth.weights)
        return {
            "filter": self.filter,
            "survival_probability": self.survival_probability,
            "detection_probability": by_sensor(self.detection_probability, sensors),
            "clutter_density": by_sensor(self.clutter_density, sensors),
            "births": births,
            "adaptive_birth": adaptive,
            "spawns": [],
            "detections_per_target": 1.0,
            "rate_shape": 1.0,
            "prune": self.prune,
            "merge": self.merge,
            "max_components": self.max_components,
            "confirm_after": self.confirm_after,
            "end_after": self.end_after,
            "strict": self.strict,
            "late": items(self.late),
        }

    def _sensors(self) -> Mapping[str, Sensor]:
        return self.sensor if isinstance(self.sensor, Mapping) else {"": self.sensor}

    def _update(self) -> _trackrs.IntensityUpdate:
        """What a scan does to the mixture."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedGMPHD(_IntensityFilter):
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
        sensor: the sensor, or several by name, which are taken one after the other as their scans come. Its noise is
            the spread of one measurement about the target's centre: the sensor's own and the target's extent, unless
            `extent` is given.
        birth: where targets may appear.
        clutter_density: false measurements per scan and unit of the measurement space (1/m² for positions, 1/(m rad)
            for range and bearing), one for all sensors or by sensor.
        detections_per_target: mean number of measurements of a target in a scan in which it is detected, or how it is
            treated. A number is learnt from there with trees and known with other partitions.
        survival_probability: that a target is still there at the next scan, [0, 1].
        detection_probability: that a target gives measurements at all, (0, 1], one for all sensors or by sensor.
        partition: how measurements are divided into cells.
        clutter_filter: what is taken out before they are divided; each becomes a cell of its own.
        superposition: whether targets with common measurements may share them; None: with trees.
        extent: how large targets are, learnt for each; the sensor's noise is then its own alone. The sensors measure
            positions. None: not learnt.
        spawns: what targets give off.
        filter: how nonlinear models are treated, as in `MultiTargetTracker`.
        prune: components of this weight and below go.
        merge: squared Mahalanobis distance up to which components become one.
        max_components: so many are kept.
        confirm_after: extractions that confirm a track. 1 reports every target at once.
        end_after: scans in a row without extraction that end a track.
        strict: the first event (a refused or late report) raises `StrictError`.
        late: what becomes of scans that come late: `DropLate()`, `Reorder(window)` or `Replay(window)`.

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

    detections_per_target: float | DetectionRate
    partition: Partition = field(default=TreePartition(), kw_only=True)
    clutter_filter: LocalOutlierFactor | None = field(default=None, kw_only=True)
    superposition: bool | None = field(default=None, kw_only=True)
    extent: Extent | None = field(default=None, kw_only=True)
    spawns: Sequence[Spawn] = field(default=(), kw_only=True)

    def _settings(self) -> dict[str, Any]:
        # Without arguments super() does not know the class that slots make anew.
        return _IntensityFilter._settings(self) | {
            "spawns": spawned(self.spawns),
            "detections_per_target": self._rate().mean,
            "rate_shape": self._rate().shape,
        }

    def _rate(self) -> DetectionRate:
        rate = self.detections_per_target
        if isinstance(rate, DetectionRate):
            return rate
        return DetectionRate(rate, learnt=isinstance(self.partition, TreePartition))

    def _update(self) -> _trackrs.IntensityUpdate:
        rate, trees = self._rate(), isinstance(self.partition, TreePartition)
        return _trackrs.IntensityUpdate.extended(
            self.partition._core,
            None if self.clutter_filter is None else self.clutter_filter._core,
            trees if self.superposition is None else self.superposition,
            (rate.forgetting, rate.floor) if rate.learnt else None,
            self.prune,
            None if self.extent is None else self.extent._items(),
        )


@dataclass(frozen=True, slots=True, eq=False)
class GMPHD(_IntensityFilter):
    """Gaussian-mixture PHD filter for point targets: such as give at most one measurement in a scan.

    Args:
        motion: how targets move; every state must add (no attitudes).
        sensor: the sensor, or several by name, which are taken one after the other as their scans come.
        birth: where targets may appear.
        clutter_density: false measurements per scan and unit of the measurement space (1/m² for positions, 1/(m rad)
            for range and bearing), one for all sensors or by sensor.
        survival_probability: that a target is still there at the next scan, [0, 1].
        detection_probability: that a target is reported, (0, 1], one for all sensors or by sensor.
        gate: measurements outside a component's gate count as impossible; what it loses is not put back.
        spawns: what targets give off.
        filter: how nonlinear models are treated, as in `MultiTargetTracker`.
        prune: components of this weight and below go.
        merge: squared Mahalanobis distance up to which components become one.
        max_components: so many are kept.
        confirm_after: extractions that confirm a track. 1 reports every target at once.
        end_after: scans in a row without extraction that end a track.
        strict: the first event (a refused or late report) raises `StrictError`.
        late: what becomes of scans that come late: `DropLate()`, `Reorder(window)` or `Replay(window)`.

    Raises:
        ParameterError: a parameter is outside its domain, or missing for a sensor.
        DimensionError: a sensor, a birth or a spawn does not fit the motion.

    Reference:
        Vo, Ma (2006), The Gaussian mixture probability hypothesis density filter, IEEE TSP 54(11).

    Example:
        >>> import numpy as np, trackrs as tr
        >>> start = tr.GaussianState([0, 0, 0, 0], np.diag([50.0, 50.0, 10.0, 10.0]) ** 2, time=0.0)
        >>> phd = tr.GMPHD(
        ...     tr.ConstantVelocity(dims=2, accel_psd=0.1),
        ...     tr.PositionSensor(dims=2, std=5.0),
        ...     birth=tr.Birth([start], weights=0.1),
        ...     clutter_density=1e-6,
        ... )
        >>> tracks = phd.run(tr.Scan(t, [[8.0 * t, -3.0 * t]], sensor="radar") for t in range(9))
        >>> [track.id for track in tracks.at(8.0)]
        [1]
    """

    gate: Gate = field(default=Gate(0.999), kw_only=True)
    spawns: Sequence[Spawn] = field(default=(), kw_only=True)

    def _settings(self) -> dict[str, Any]:
        return _IntensityFilter._settings(self) | {"spawns": spawned(self.spawns)}

    def _update(self) -> _trackrs.IntensityUpdate:
        return _trackrs.IntensityUpdate.point(self.gate.probability, self.prune)


@dataclass(frozen=True, slots=True, eq=False)
class CPHD(_IntensityFilter):
    """Cardinalised PHD filter: beside the intensity it carries the distribution of the number of targets.

    So the number varies less from scan to scan than that of `GMPHD`. The likeliest number of targets is extracted.

    Args:
        motion: how targets move; every state must add (no attitudes).
        sensor: the sensor, or several by name, which are taken one after the other as their scans come.
        birth: where targets may appear.
        clutter_density: false measurements per scan and unit of the measurement space (1/m² for positions, 1/(m rad)
            for range and bearing), one for all sensors or by sensor.
        survival_probability: that a target is still there at the next scan, [0, 1].
        detection_probability: that a target is reported, (0, 1], one for all sensors or by sensor.
        gate: measurements outside a component's gate count as impossible; what it loses is not put back.
        max_targets: more targets than that there never are.
        filter: how nonlinear models are treated, as in `MultiTargetTracker`.
        prune: components of this weight and below go.
        merge: squared Mahalanobis distance up to which components become one.
        max_components: so many are kept.
        confirm_after: extractions that confirm a track. 1 reports every target at once.
        end_after: scans in a row without extraction that end a track.
        strict: the first event (a refused or late report) raises `StrictError`.
        late: what becomes of scans that come late: `DropLate()`, `Reorder(window)` or `Replay(window)`.

    Raises:
        ParameterError: a parameter is outside its domain, or missing for a sensor.
        DimensionError: a sensor, a birth or a spawn does not fit the motion.

    Reference:
        Vo, Vo, Cantoni (2007), Analytic implementations of the cardinalized probability hypothesis density filter,
        IEEE TSP 55(7).
    """

    gate: Gate = field(default=Gate(0.999), kw_only=True)
    max_targets: int = field(default=100, kw_only=True)

    def _update(self) -> _trackrs.IntensityUpdate:
        return _trackrs.IntensityUpdate.cardinalised(self.gate.probability, self.prune, self.max_targets)


class IntensityTracker(Recorder):
    """A filter at work; it goes on from where it stands.

    Args:
        phd: what defines it.
        initial: targets that are known to be there, all at one time.
        weights: how many targets to expect in each of these states.

    Raises:
        ParameterError: the initial states have different times, or a weight is negative.
    """

    __slots__ = ()
    _kind = _trackrs.IntensityTracker

    def __init__(
        self, phd: _IntensityFilter, initial: Sequence[GaussianState] = (), weights: float | Sequence[float] = 1.0
    ) -> None:
        """Build the tracker."""
        times = {state.time for state in initial}
        if len(times) > 1:
            msg = f"initial: the states are of {len(times)} different times; bring them to one"
            raise ParameterError(msg)
        cores = {name: sensor._core for name, sensor in phd._sensors().items()}
        known = weighted("initial", initial, weights)
        models = (phd.motion._core, cores, phd._update())
        self._core = _trackrs.IntensityTracker(*models, phd._settings(), known, *times)
        self._labels = tuple(self._core.labels())

    def _tracks(self, found: dict[str, Any]) -> Tracks:
        return tracks(found["tracks"], self._labels, expected_targets=found["expected_targets"])

    @property
    def mixture(self) -> Mixture:
        """The intensity after the last scan."""
        return Mixture(**freeze_columns(self._core.mixture()))

    @property
    def cardinality(self) -> FloatArray | None:
        """Probability of 0, 1, ... targets after the last scan, where the filter carries it (`CPHD`), else None."""
        found = self._core.cardinality()
        return None if found is None else frozen(found)
