"""The multi-target tracker: scans in, confirmed tracks out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import array
from trackrs.association import GlobalNearestNeighbour, NearestNeighbour
from trackrs.gating import Gate
from trackrs.types import Event, Ledger, Scan, Tracks, freeze_columns

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from trackrs.motion import Motion
    from trackrs.sensor import Sensor
    from trackrs.types import GaussianState


@dataclass(frozen=True, slots=True)
class MofN:
    """When a track is confirmed: hit in `m` of the last `n` scans of some sensor.

    Args:
        m: hits needed.
        n: scans they must fall in, at most 64.
        max_speed: upper bound on the speed of a target, m/s; also the uncertainty of a new track's velocity (2 sigma).
        min_displacement: a track must have moved this far from where it began, metres. 0 confirms targets at rest.
        min_separation: no track is confirmed closer than this to a confirmed one, metres, because one target may give
            several reports.
    """

    m: int
    n: int
    max_speed: float
    min_displacement: float = 0.0
    min_separation: float = 0.0


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


class MultiTargetTracker:
    """Tracks several targets from the scans of one or more sensors.

    The tracker has a memory: `step` and `run` go on from where it stands.

    Args:
        motion: how targets move.
        sensors: the sensors by name; they may have different models and rates.
        initiator: when a track is confirmed.
        associator: how reports are given to tracks.
        gate: which reports a track may get.
        deletion: when a confirmed track ends.
        clutter_map: keep static echoes from starting tracks.
        max_gap: end all tracks when no scan came for so many seconds.
        max_tracks: no more than so many tracks, tentative ones included.
        strict: the first event (a refused or late report) raises `StrictError`.
        initial: states of tracks that are there from the beginning.

    Raises:
        ParameterError: a parameter is outside its domain.
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

    __slots__ = ("_core", "_labels")

    def __init__(
        self,
        motion: Motion,
        sensors: Mapping[str, Sensor],
        initiator: MofN,
        *,
        associator: NearestNeighbour | GlobalNearestNeighbour = GlobalNearestNeighbour(),  # noqa: B008 (frozen)
        gate: Gate = Gate(),  # noqa: B008 (frozen)
        deletion: Deletion = Deletion(),
        clutter_map: ClutterMap | None = None,
        max_gap: float | None = None,
        max_tracks: int = 10_000,
        strict: bool = False,
        initial: Sequence[GaussianState] = (),
    ) -> None:
        """Build the tracker."""
        settings = {
            "associator": associator.name,
            "gate_probability": gate.probability,
            "m": initiator.m,
            "n": initiator.n,
            "max_speed": initiator.max_speed,
            "min_displacement": initiator.min_displacement,
            "min_separation": initiator.min_separation,
            "max_misses": deletion.max_misses,
            "max_time": deletion.max_time,
            "clutter_map": clutter_map
            and (clutter_map.radius, clutter_map.dwell, clutter_map.min_reports, clutter_map.memory),
            "max_gap": max_gap,
            "max_tracks": max_tracks,
            "strict": strict,
        }
        cores = {name: sensor._core for name, sensor in sensors.items()}
        starts = [(state.time, state.mean, state.cov) for state in initial]
        self._core = _trackrs.Tracker(motion._core, cores, settings, starts)
        self._labels = tuple(self._core.labels())

    def step(self, scan: Scan) -> Tracks:
        """Take in one scan and return the confirmed tracks at its time.

        A scan that cannot be used leaves the tracks as they were and is recorded in `events`.
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

    def _tracks(self, columns: dict[str, Any], scans: list[Scan]) -> Tracks:
        columns["offsets"] = np.array(columns["offsets"], dtype=np.int64)
        return Tracks(
            scan_times=array([scan.time for scan in scans], "times", 1),
            sensors=tuple(scan.sensor for scan in scans),
            labels=self._labels,
            **freeze_columns(columns),
        )

    @property
    def events(self) -> list[Event]:
        """The last 1000 events, oldest first; all are counted in `event_counts`."""
        return [Event(**event) for event in self._core.events()]

    @property
    def event_counts(self) -> dict[str, int]:
        """Number of events so far, by code."""
        return self._core.event_counts()

    @property
    def ledger(self) -> Ledger:
        """Where every row went so far."""
        return Ledger(**self._core.ledger())

    def to_bytes(self) -> bytes:
        """Save the tracker with everything it knows: versioned, checksummed, data only."""
        return self._core.to_bytes()

    @classmethod
    def from_bytes(cls, data: bytes) -> MultiTargetTracker:
        """Return a tracker that goes on, bit for bit, where the saved one stood.

        Raises:
            StateError: the bytes are truncated, altered, foreign or of another version.
        """
        tracker = cls.__new__(cls)
        tracker._core = _trackrs.Tracker.from_bytes(bytes(data))
        tracker._labels = tuple(tracker._core.labels())
        return tracker

    def __reduce__(self) -> tuple[object, tuple[bytes]]:
        """Pickle through `to_bytes`, so that nothing but data is ever loaded."""
        return (MultiTargetTracker.from_bytes, (self.to_bytes(),))
