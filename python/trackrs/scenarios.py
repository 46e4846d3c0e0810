"""Scenarios: truth, and what the sensors would have reported of it, drawn from seeded streams.

Run k with seed s has the same bits on every machine, whatever runs were drawn before: its random numbers come from the
bits of NumPy's `PCG64(SeedSequence(s, spawn_key=(k,)))`.
"""

from __future__ import annotations

import operator
from dataclasses import asdict, astuple, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, frozen
from trackrs.errors import ParameterError
from trackrs.sensor import RangeArray, RangeBearing
from trackrs.types import GaussianState, Scan, freeze_columns

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "CloseReports",
    "CloseTargets",
    "Course",
    "Leg",
    "Recording",
    "Underwater",
    "close_targets",
    "underwater",
]


@dataclass(frozen=True, slots=True)
class Leg:
    """A part of a course.

    Its rates rise from 0 in the first seconds of the leg and fall to 0 in the last ones (`Course.ramp`).

    Args:
        duration: seconds.
        turn_rate: from x towards y, rad/s.
        sink_rate: downwards, m/s.
    """

    duration: float
    turn_rate: float = 0.0
    sink_rate: float = 0.0


@dataclass(frozen=True, slots=True)
class Course:
    """Where a vessel goes, at constant speed.

    Args:
        start: where it begins (3,), metres, z positive down.
        heading: in which direction, from x towards y, radians.
        speed: in total, m/s; horizontally what the sink rate leaves of it.
        ramp: time in which the rates of a leg rise, and in which they fall, seconds.
        legs: one after the other.

    Example:
        >>> from dataclasses import replace
        >>> from trackrs.scenarios import Course, Leg
        >>> course = Course.reference()
        >>> [leg.duration for leg in course.legs]
        [40.0, 40.0, 20.0, 30.0, 30.0]
        >>> straight = replace(course, legs=(Leg(60.0),))
    """

    start: tuple[float, float, float]
    heading: float
    speed: float
    ramp: float
    legs: tuple[Leg, ...]

    @classmethod
    def reference(cls) -> Course:
        """Return the course of the underwater paper's reference scenario: straight, turn, straight, dive, turn back.

        160 s at 15 m/s: a turn of 3°/s from 40 to 80 s, a dive of 3 m/s from 100 to 130 s, then a turn of -4°/s.
        """
        items = _trackrs.reference_course()
        legs = tuple(Leg(*leg) for leg in items.pop("legs"))
        return cls(**(items | {"start": tuple(items["start"]), "legs": legs}))


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What one run recorded.

    Attributes:
        times: (T,) seconds.
        values: (T, m) measurements; NaN = not observed.
        gross: (T, m) which of them have a gross error.
        truth: (T, 9) position, velocity and acceleration, metres and seconds.
    """

    times: FloatArray
    values: FloatArray
    gross: NDArray[np.bool_]
    truth: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Underwater:
    """A vessel heard by hydrophones; see `underwater`, which makes it.

    Attributes:
        array: the sensor.
        times: (T,) seconds, of the measurements.
        truth: (T, 9) position, velocity and acceleration, metres and seconds; no rows where every run has its own.
    """

    array: RangeArray
    times: FloatArray
    truth: FloatArray
    _core: _trackrs.Underwater = field(repr=False)

    def draw(self, seed: int, run: int = 0) -> Recording:
        """Return run number `run` of a study with this seed, both from 0 to 2⁶⁴ - 1.

        Raises:
            ParameterError: `seed` or `run` is no such number.
            UnobservableError: the target stands on a hydrophone.
        """
        out: dict[str, Any] = self._core.draw(_number("seed", seed), _number("run", run))
        return Recording(times=self.times, **freeze_columns(out))


def underwater(
    array: Literal["bats", "toss"] | RangeArray = "bats",
    *,
    gross: float = 0.0,
    missing: float = 0.0,
    range_std: float = 1.0,
    depth_std: float = 0.3,
    dt: float = 1.0,
    course: Course | None = None,
    jerk_std: float | None = None,
) -> Underwater:
    """Return the reference scenario of the underwater paper: a manoeuvring vessel heard by hydrophones.

    The first three epochs are complete and without gross errors, so that a run can start itself. The same run has the
    same noise whatever `gross` and `missing` are.

    Args:
        array: "bats" (three hydrophones and the depth), "toss" (six hydrophones), or another array in 3 dimensions.
        gross: probability that a range has 10 to 100 m added or taken away.
        missing: probability that a component is not observed.
        range_std: standard deviation of the ranges of the two named arrays, metres.
        depth_std: of the depth of the BATS array, metres.
        dt: seconds between measurements.
        course: of the vessel; None: `Course.reference()`.
        jerk_std: the target does not keep the course but moves as `ConstantAcceleration` has it with this jerk (m/s³),
            from where the course begins and for as long, in every run another way: the truth that a filter assumes.

    Raises:
        ParameterError: a probability is not within 0 and 1, a duration not positive, a leg shorter than its ramps, or a
            sink rate not below the speed.
        DimensionError: the array is not in 3 dimensions.

    Reference:
        Xi, Liu, Tao, Lu, "Tracking submarine moving target with the adaptive estimation methodology"; arrays, course
        and gross errors are those of section 6 of its spec, since the paper shows no numbers. The ramps lie inside the
        legs: the reading that gives the spec's tables for both arrays.

    Example:
        >>> import trackrs as tr
        >>> scene = tr.scenarios.underwater("toss", gross=0.05)
        >>> recording = scene.draw(seed=7, run=3)
        >>> recording.values.shape, scene.truth.shape
        ((161, 6), (161, 9))
    """
    if isinstance(array, str):
        places = _trackrs.reference_hydrophones()
        if array not in places:
            msg = f'array = "{array}" is invalid: must be "bats", "toss" or a RangeArray'
            raise ParameterError(msg)
        bats = array == "bats"
        array = (
            RangeArray.bats(places[array], range_std, depth_std) if bats else RangeArray.toss(places[array], range_std)
        )
    course = Course.reference() if course is None else course
    items = asdict(course) | {"legs": [astuple(leg) for leg in course.legs]}
    core = _trackrs.Underwater.make(array._core, items, dt, gross, missing, jerk_std)
    return Underwater(array, frozen(core.times()), frozen(core.truth()), core)


@dataclass(frozen=True, slots=True, eq=False)
class CloseReports:
    """What one run of `CloseTargets` reported.

    Attributes:
        times: (T,) seconds.
        values: (T, 2) range and bearing, metres and radians.
        origins: (T,) the target each report is of; -1 = false.
    """

    times: FloatArray
    values: FloatArray
    origins: IntArray

    def scans(self, size: int = 1) -> list[Scan]:
        """Return the reports as scans of `size` reports each, which keep their own times; sensor "radar"."""
        return [
            Scan(times[-1], self.values[k : k + size], "radar", times=times if size > 1 else None)
            for k in range(0, len(self.times), size)
            if len(times := self.times[k : k + size])
        ]


@dataclass(frozen=True, slots=True, eq=False)
class CloseTargets:
    """Targets side by side, reported one at a time; see `close_targets`, which makes it.

    Attributes:
        radar: the sensor, in the origin.
        times: (T,) seconds, of the reports.
        truth: (T, N, 4) positions and velocities of all targets at these times, metres and seconds.
        initial: what a filter is told of each target at time 0.
        clutter_area: area that false reports are spread over, square metres, centred on the targets at all times. Their
            density at range r is r / area per metre and radian.
    """

    radar: RangeBearing
    times: FloatArray
    truth: FloatArray
    initial: tuple[GaussianState, ...]
    clutter_area: float
    _core: _trackrs.CloseTargets = field(repr=False)

    def draw(self, seed: int, run: int = 0) -> CloseReports:
        """Return run number `run` of a study with this seed, both from 0 to 2⁶⁴ - 1.

        Raises:
            ParameterError: `seed` or `run` is no such number.
        """
        out: dict[str, Any] = self._core.draw(_number("seed", seed), _number("run", run))
        return CloseReports(times=self.times, **freeze_columns(out))


def close_targets(
    targets: int = 3,
    separation: float = 300.0,
    *,
    reports: int = 60,
    interval: float = 3.0,
    order: Literal["cyclic", "boustrophedon", "random"] = "cyclic",
    clutter: float = 0.0,
) -> CloseTargets:
    """Return the scenario of the NPDA paper: targets side by side at 100 m/s, reported one at a time by a radar.

    The paper leaves open the order of the reports, their number and the time of the first one. The same run has the
    same noise whatever `order` and `clutter` are.

    Args:
        targets: how many.
        separation: of neighbours, metres.
        reports: how many, of all targets together.
        interval: seconds between reports, and before the first one.
        order: whose turn it is: 0 1 2 0 1 2, or 0 1 2 2 1 0, or any.
        clutter: probability that a report is false, whoever's turn it is; false reports are uniform over an area that
            goes with the targets, 1000 m ahead and behind, 500 m beyond the outer ones.

    Raises:
        ParameterError: a parameter is outside its domain.

    Reference:
        Liu, Xie, Huang (2009), section 5, and section 4 of its spec.

    Example:
        >>> import trackrs as tr
        >>> scene = tr.scenarios.close_targets(separation=150.0)
        >>> tracker = tr.MultiTargetTracker(
        ...     tr.ConstantVelocity(dims=2, accel_std=2.0),
        ...     sensors={"radar": scene.radar},
        ...     initiator=tr.MofN(3, 5, max_speed=150.0),
        ...     associator=tr.NPDA(),
        ...     gate=tr.Gate(1.0),
        ...     deletion=tr.Deletion(max_misses=100),
        ...     initial=scene.initial,
        ... )
        >>> tracks = tracker.run(scene.draw(seed=7).scans())
        >>> tracks.means[tracks.offsets[-2] :].shape, scene.truth.shape
        ((3, 4), (60, 3, 4))
    """
    core = _trackrs.CloseTargets.make(targets, separation, reports, interval, order, clutter)
    range_std, bearing_std = core.noise()
    return CloseTargets(
        radar=RangeBearing((0.0, 0.0), range_std, bearing_std),
        times=frozen(core.times()),
        truth=frozen(core.truth().reshape(reports, targets, 4)),
        initial=tuple(GaussianState(mean, np.diag(variances)) for mean, variances in core.initial()),
        clutter_area=core.clutter_area(),
        _core=core,
    )


def _number(name: str, value: int) -> int:
    """Return the number of a stream."""
    number = operator.index(value)
    if 0 <= number < 2**64:
        return number
    msg = f"{name} = {value} is invalid: must be a whole number from 0 to 2**64 - 1"
    raise ParameterError(msg)
