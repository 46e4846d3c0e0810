"""A manoeuvring vessel heard by hydrophones."""

from __future__ import annotations

from dataclasses import asdict, astuple, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from trackrs import _trackrs
from trackrs._arrays import FloatArray, freeze_columns, frozen
from trackrs.errors import ParameterError
from trackrs.range_array import RangeArray
from trackrs.scenarios._recipe import Recalled, remembered
from trackrs.scenarios._stream import stream_number

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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
class Underwater(Recalled):
    """A vessel heard by hydrophones; see `underwater`, which makes it.

    Attributes:
        array: the sensor.
        times: (T,) seconds, of the measurements.
        truth: (T, 9) position, velocity and acceleration, metres and seconds; no rows where every run has its own.
    """

    array: RangeArray
    times: FloatArray = field(repr=False)
    truth: FloatArray = field(repr=False)
    _core: _trackrs.Underwater = field(repr=False)

    def draw(self, seed: int, run: int = 0) -> Recording:
        """Return run number `run` of a study with this seed, both from 0 to 2⁶⁴ - 1.

        Raises:
            ParameterError: `seed` or `run` is no such number.
            UnobservableError: the target stands on a hydrophone.
        """
        out: dict[str, Any] = self._core.draw(stream_number("seed", seed), stream_number("run", run))
        return Recording(times=self.times, **freeze_columns(out))


@remembered
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
