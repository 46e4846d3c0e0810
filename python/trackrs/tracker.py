"""The multi-target tracker: scans in, confirmed tracks out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from trackrs import _trackrs
from trackrs._arrays import freeze_columns
from trackrs.association import GlobalNearestNeighbour
from trackrs.gating import Gate
from trackrs.late import DropLate, items
from trackrs.types import Event, Ledger, Tracks

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Self

    from trackrs._arrays import FloatArray
    from trackrs.association import Associator
    from trackrs.late import Late
    from trackrs.motion import Motion
    from trackrs.sensor import Sensor
    from trackrs.types import GaussianState, Scan


@dataclass(frozen=True, slots=True)
class MofN:
    """When a track is confirmed: hit in `m` of the last `n` scans of some sensor.

    Args:
        m: hits needed.
        n: scans they must fall in, at most 64.
        max_speed: upper bound on the speed of a target, m/s.
        min_displacement: a track must have moved this far from where it began, metres. 0 confirms targets at rest.
        min_separation: no track is confirmed closer than this to a confirmed one, metres, because one target may give
            several reports.
        pair_within: two-point initiation. A report that no track takes waits for so many seconds (30 in the reference
            rule) for a second one that a target of at most `max_speed` can have made; the most recent of such pairs
            begins the track, with the velocity between the two, and both are hits. The motion must have velocities;
            accelerations begin at 0 with a standard deviation of `max_speed` / 10 s. None: every report begins a track,
            at rest, and `max_speed` is two sigma of its velocity.

    Reference:
        `pair_within`: spec label N14; docs/association.md has the equations.
    """

    m: int
    n: int
    max_speed: float
    min_displacement: float = 0.0
    min_separation: float = 0.0
    pair_within: float | None = None


@dataclass(frozen=True, slots=True)
class Existence:
    """Tracks begin, are confirmed and end by the probability that there is a target; for the associator `JIPDA`.

    A report starts a track with the probability `initial` times that of no track explaining it.

    Args:
        max_speed: upper bound on the speed of a target, m/s.
        initial: probability that a report which no track explains is of a new target: new targets per scan over new
            targets and false reports per scan.
        confirm: a track is confirmed from this existence on.
        drop: below this existence it ends.
        lifetime: how long a target stays on the average, seconds; between scans existence decays with it.
        min_displacement: a track must have moved this far from where it began, metres. 0 confirms targets at rest.
        min_separation: no track begins or is confirmed closer than this to a confirmed one, metres, because one target
            may give several reports.
        pair_within: as in `MofN`; `initial` is then the probability that a pair is of a new target.
    """

    max_speed: float
    initial: float = 0.1
    confirm: float = 0.95
    drop: float = 0.01
    lifetime: float = 300.0
    min_displacement: float = 0.0
    min_separation: float = 0.0
    pair_within: float | None = None


@dataclass(frozen=True, slots=True)
class Deletion:
    """When a confirmed track ends.

    Args:
        max_misses: misses in a row by every sensor that ever hit the track.
        max_time: or seconds without a hit, if given.
    """

    max_misses: int = 5
    max_time: float | None = None


@dataclass(frozen=True, slots=True)
class ClutterMap:
    """A map of echoes that stay in one place; they start no tracks.

    Args:
        radius: reports closer than this belong to one echo, metres.
        dwell: an echo seen in one place for so long is static, seconds.
        min_reports: and at least so often.
        memory: an echo unseen for so long is forgotten, seconds.
    """

    radius: float
    dwell: float
    min_reports: int = 5
    memory: float = 60.0


class Recorder:
    """What trackers with a memory have in common: books, and bytes to go on from."""

    __slots__ = ("_core", "_labels")
    _core: Any
    _labels: tuple[str, ...]
    _kind: ClassVar[Any]

    def step(self, scan: Scan) -> Tracks:
        """Take in one scan and return the confirmed tracks at its time.

        With `late=Reorder(...)` they are those after each of the scans that have had their turn with it, with
        `late=Replay(...)` those at the newest time. A scan that cannot be used leaves the tracks as they were and is
        recorded in `events`.
        """
        return self._tracks(self._core.step(scan))

    def run(self, scans: Iterable[Scan]) -> Tracks:
        """Take in all scans and return the confirmed tracks after each, in the order of time.

        With `late=DropLate()` the scans must be in that order. Otherwise they may come as they like; what is late by
        more than the window is dropped, and nothing waits afterwards.

        Raises:
            TimeError: the times decrease, or begin before the tracker's time, and late scans are dropped.
            UnknownSensorError: a scan names a sensor that the tracker does not have.
        """
        return self._tracks(self._core.run(list(scans)))

    def flush(self) -> Tracks:
        """Take in the scans that wait for earlier ones (`late=Reorder(...)`) and return the tracks after each."""
        return self._tracks(self._core.flush())

    def _tracks(self, found: dict[str, Any]) -> Tracks:
        """The record of what the core gave."""
        raise NotImplementedError

    @property
    def events(self) -> list[Event]:
        """The last 1000 events, oldest first; all are counted in `event_counts`."""
        return [Event(**event) for event in self._core.events()]

    @property
    def event_counts(self) -> dict[str, int]:
        """Number of events so far, by code."""
        counts: dict[str, int] = self._core.event_counts()
        return counts

    @property
    def ledger(self) -> Ledger:
        """Where every row went so far."""
        return Ledger(**self._core.ledger())

    def copy(self) -> Self:
        """Return another tracker that stands where this one does."""
        tracker = type(self).__new__(type(self))
        tracker._core, tracker._labels = self._core.copy(), self._labels
        return tracker

    def to_bytes(self) -> bytes:
        """Save the tracker with everything it knows: versioned, checksummed, data only."""
        data: bytes = self._core.to_bytes()
        return data

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Return a tracker that goes on, bit for bit, where the saved one stood.

        Raises:
            StateError: the bytes are truncated, altered, foreign or of another version.
        """
        tracker = cls.__new__(cls)
        tracker._core = cls._kind.from_bytes(bytes(data))
        tracker._labels = tuple(tracker._core.labels())
        return tracker

    def __reduce__(self) -> tuple[object, tuple[bytes]]:
        """Pickle through `to_bytes`, so that nothing but data is ever loaded."""
        return (type(self).from_bytes, (self.to_bytes(),))


class MultiTargetTracker(Recorder):
    """Tracks several targets from the scans of one or more sensors.

    The tracker has a memory: `step` and `run` go on from where it stands.

    Clocks may jump. A scan more than `max_gap` (600 s where that is None) ahead of all before is taken in, but taken
    back, with the event `future_scan` and its rows booked as rejected, if the next one would be late by it and goes on
    from the time before. After 5 scans in a row more than that behind, each within it of the one before, the sensor of
    the newest scan among them, the clock was set back: all tracks end with the event `clock_set_back`, and the last of
    the five is the first of the new time. 50 in a row do that without that sensor.

    Args:
        motion: how targets move.
        sensors: the sensors by name; they may have different models and rates.
        initiator: when a track is confirmed: `MofN`, or `Existence` with the associator `JIPDA`.
        filter: of every track: "extended", "second_order" (with the curvature of ranges) or "unscented" (sigma points
            of equal weight, the cubature filter). For linear models all of them are the Kalman filter.
        associator: how reports are given to tracks.
        gate: which reports a track may get. Probabilistic associators reckon with its probability: what is detected
            inside it is P_D P_G.
        deletion: when a confirmed track ends; None: `Deletion()`, or with `Existence` never but by that.
        detection_probability: that a sensor reports a target in a scan, one for all or by sensor, in (0, 1]. For the
            probabilistic associators, as is the next.
        clutter_density: false reports per scan and unit of the sensor's measurement space (1/m² for positions, 1/(m
            rad) for range and bearing), one for all sensors or by sensor. 0: there are none.
        clutter_map: keep static echoes from starting tracks.
        max_gap: end all tracks when no scan came for so many seconds.
        max_tracks: no more than so many tracks, tentative ones and reports that wait for a second one included.
        strict: the first event (a refused or late report) raises `StrictError`.
        late: what becomes of scans that come late: `DropLate()`, `Reorder(window)` or `Replay(window)`.
        initial: states of tracks that are there from the beginning.

    Raises:
        ParameterError: a parameter is outside its domain, or missing for this associator.
        UnknownSensorError: a probability or density names a sensor that is not there.
        DimensionError: a sensor does not fit the motion.

    Example:
        >>> import trackrs as tr
        >>> tracker = tr.MultiTargetTracker(
        ...     tr.ConstantVelocity(dims=2, accel_psd=0.1),
        ...     sensors={"radar": tr.PositionSensor(dims=2, std=1.0)},
        ...     initiator=tr.MofN(2, 3, max_speed=20.0),
        ... )
        >>> scans = [tr.Scan(t, [[5.0 * t, 0.0], [100.0, 3.0 * t]], sensor="radar") for t in range(5)]
        >>> tracks = tracker.run(scans)
        >>> [track.id for track in tracks.at(4.0)]
        [1, 2]
    """

    __slots__ = ()
    _kind = _trackrs.Tracker

    def __init__(
        self,
        motion: Motion,
        sensors: Mapping[str, Sensor],
        initiator: MofN | Existence,
        *,
        filter: Literal["extended", "second_order", "unscented"] = "extended",  # noqa: A002
        associator: Associator = GlobalNearestNeighbour(),  # noqa: B008 (frozen)
        gate: Gate = Gate(),  # noqa: B008 (frozen)
        detection_probability: float | Mapping[str, float] = 0.9,
        clutter_density: float | Mapping[str, float] | None = None,
        deletion: Deletion | None = None,
        clutter_map: ClutterMap | None = None,
        max_gap: float | None = None,
        max_tracks: int = 10_000,
        strict: bool = False,
        late: Late = DropLate(),  # noqa: B008 (frozen)
        initial: Sequence[GaussianState] = (),
    ) -> None:
        """Build the tracker."""
        settings = {
            "filter": filter,
            "associator": {"name": associator.name} | asdict(associator),
            "initiator": asdict(initiator),
            "detection_probability": by_sensor(detection_probability, sensors),
            "clutter_density": {} if clutter_density is None else by_sensor(clutter_density, sensors),
            "gate_probability": gate.probability,
            "deletion": deletion and (deletion.max_misses, deletion.max_time),
            "clutter_map": clutter_map
            and (clutter_map.radius, clutter_map.dwell, clutter_map.min_reports, clutter_map.memory),
            "max_gap": max_gap,
            "max_tracks": max_tracks,
            "strict": strict,
            "late": items(late),
        }
        cores = {name: sensor._core for name, sensor in sensors.items()}
        starts = [(state.time, state.mean, state.cov) for state in initial]
        self._core = _trackrs.Tracker(motion._core, cores, settings, starts)
        self._labels = tuple(self._core.labels())

    def _tracks(self, found: dict[str, Any]) -> Tracks:
        return tracks(found, self._labels)


def tracks(columns: dict[str, Any], labels: tuple[str, ...], **more: FloatArray) -> Tracks:
    """Return the record of what the core gave."""
    return Tracks(labels=labels, **columns, **freeze_columns(more))


def by_sensor(value: float | Mapping[str, float], sensors: Iterable[str]) -> dict[str, float]:
    """A parameter for every sensor, or for those that have it."""
    return dict(value) if isinstance(value, Mapping) else dict.fromkeys(sensors, value)
