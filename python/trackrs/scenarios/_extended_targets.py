"""Targets that give many detections in a scan, in clutter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, frozen, per_axis
from trackrs.errors import DimensionError, ParameterError
from trackrs.evaluation import Truth
from trackrs.motion import ConstantVelocity
from trackrs.scenarios._recipe import Recalled, remembered
from trackrs.scenarios._stream import stream_number
from trackrs.sensor import PositionSensor
from trackrs.types import GaussianState, Scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

SENSOR = "radar"
ACCEL_STD = 2.0  # what a filter is told of the motion, m/s²
BIRTH_WEIGHT = 0.1


@dataclass(frozen=True, slots=True)
class Blob:
    """A point; detections are normal about it.

    Args:
        spread: standard deviation of the detections, metres, sensor noise included.
    """

    spread: float = 20.0


@dataclass(frozen=True, slots=True)
class Ellipse:
    """A filled ellipse.

    Args:
        length: whole axis along the velocity, metres.
        width: whole axis across, metres.
    """

    length: float = 80.0
    width: float = 30.0


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A filled rectangle.

    Args:
        length: side along the velocity, metres.
        width: side across, metres.
    """

    length: float = 70.0
    width: float = 40.0


@dataclass(frozen=True, slots=True)
class LShape:
    """Two lines from one corner, one along the velocity and one to its left.

    Args:
        arm: length of each, metres.
    """

    arm: float = 60.0


Shape: TypeAlias = Blob | Ellipse | Rectangle | LShape


@dataclass(frozen=True, slots=True)
class ExtendedTarget:
    """A target of a scenario, at constant velocity.

    Args:
        start: x, y, vx, vy at `first`, metres and seconds.
        first: when its life begins, seconds.
        last: when it ends, seconds; infinite: with the scenario.
        rate: mean detections in a scan in which it is detected.
        shape: what they come from; its centre, the mean of its points, is the target's position.

    Raises:
        DimensionError: `start` is not four numbers.
    """

    start: tuple[float, float, float, float]
    first: float = 1.0
    last: float = np.inf
    rate: float = 10.0
    shape: Shape = Blob()

    def __post_init__(self) -> None:
        """Make the start a tuple."""
        start = array(self.start, "start", 1)
        if len(start) != 4:
            msg = f"start must be x, y, vx, vy, got {len(start)} numbers"
            raise DimensionError(msg)
        object.__setattr__(self, "start", tuple(start.tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedDetections:
    """What one run of `ExtendedTargets` detects.

    Attributes:
        scans: T scans of positions, target after target, clutter last; sensor "radar".
        origins: for every scan the target of each detection (k,); -1 = clutter.
    """

    scans: tuple[Scan, ...]
    origins: tuple[IntArray, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedTargets(Recalled):
    """Extended targets in clutter; see `extended_targets`, which makes it, and `crossing` and `parallel`.

    Attributes:
        targets: the N targets.
        motion: what a filter is told of their motion: `ConstantVelocity` with 2 m/s².
        sensor: and of a detection about its target's centre.
        births: and of where targets may begin, (x, y, 0, 0) with standard deviations of 50 m and 25 m/s.
        birth_weight: expected births at each of these in a scan.
        detections_per_target: one rate for all targets, the median of theirs.
        detection_probability: that a living target is detected at all.
        clutter_density: false detections per square metre and scan.
        times: (T,) seconds, of the scans.
        states: (T, N, 4) positions and velocities at these times; NaN where a target does not live.
        truth: the same for `evaluate`; the id of a target is its number.
    """

    targets: tuple[ExtendedTarget, ...]
    motion: ConstantVelocity
    sensor: PositionSensor
    births: tuple[GaussianState, ...] = field(repr=False)
    birth_weight: float
    detections_per_target: float
    detection_probability: float
    clutter_density: float
    times: FloatArray = field(repr=False)
    states: FloatArray = field(repr=False)
    truth: tuple[Truth, ...] = field(repr=False)
    _core: _trackrs.ExtendedTargets = field(repr=False)

    def draw(self, seed: int, run: int = 0) -> ExtendedDetections:
        """Return run number `run` of a study with this seed, both from 0 to 2⁶⁴ - 1.

        Raises:
            ParameterError: `seed` or `run` is no such number.
        """
        out: dict[str, Any] = self._core.draw(stream_number("seed", seed), stream_number("run", run))
        inner = out["offsets"][1:-1]
        values, origins = np.split(out["values"], inner), np.split(out["origins"], inner)
        pairs = zip(self.times, values, strict=False)  # without scans there is one empty part
        return ExtendedDetections(
            scans=tuple(Scan(time, rows, SENSOR) for time, rows in pairs),
            origins=tuple(frozen(part) for part in origins),
        )


@remembered
def extended_targets(
    targets: Sequence[ExtendedTarget],
    *,
    births: ArrayLike | None = None,
    scans: int = 100,
    interval: float = 1.0,
    clutter: float = 10.0,
    detection_probability: float = 0.99,
    noise_std: float = 20.0,
    sensor_std: float | None = None,
) -> ExtendedTargets:
    """Return a scenario of targets that give many detections in a scan, on 2 km by 2 km around the origin.

    In each scan a living target is detected with `detection_probability`; then it gives a Poisson number of detections,
    each a uniform point of its shape plus noise. The same run has the same deviates whatever probability, clutter,
    noise, shapes and paths are; other rates, lives or numbers of targets give other ones.

    Args:
        targets: at least one.
        births: (B, 2) where a filter is told that targets may begin, metres; None: where they do.
        scans: how many.
        interval: seconds between scans, and before the first one.
        clutter: mean false detections in a scan.
        detection_probability: that a living target is detected at all.
        noise_std: of a detection about the point of the shape that it comes from, metres; a `Blob` has its own.
        sensor_std: what a filter is told of a detection about its target's centre, metres; None: as it is on average
            over axes and targets.

    Raises:
        ParameterError: a parameter is outside its domain, no scan falls into the life of a target, or there are more
            than ten million detections in a run.
        NonFiniteError: a start or a birth is not finite.
        DimensionError: `births` is not (B, 2).

    Reference:
        Sections 2 and 7 of the spec of the extended-target paper.

    Example:
        Two targets begin 40 m apart in one birth region, and one of them ends while they are close:

        >>> from trackrs.scenarios import ExtendedTarget, extended_targets
        >>> pair = [ExtendedTarget((-800, 600, 16, 0)), ExtendedTarget((-800, 640, 16, 0), last=50)]
        >>> scene = extended_targets(pair, births=[(-800, 620)])
        >>> len(scene.births), len(scene.truth[1].times), len(scene.draw(seed=7).scans)
        (1, 50, 100)
    """
    targets = tuple(targets)
    regions = np.zeros((0, 2)) if births is None else array(births, "births", 2)
    if regions.shape[1] != 2:
        msg = f"births must have 2 columns, got {regions.shape[1]}"
        raise DimensionError(msg)
    if births is not None and len(regions) == 0:
        msg = "births = none is invalid: must be at least one, or None for where the targets begin"
        raise ParameterError(msg)
    core = _trackrs.ExtendedTargets.make(
        [(target.start, target.first, target.last, target.rate) for target in targets],
        [_items(target.shape) for target in targets],
        regions.tolist(),
        scans,
        interval,
        clutter,
        detection_probability,
        noise_std,
        sensor_std,
    )
    times = frozen(core.times())
    states = core.truth().reshape(scans, len(targets), 4)
    lives = ~np.isnan(states[:, :, 0])
    return ExtendedTargets(
        targets=targets,
        motion=ConstantVelocity(dims=2, accel_std=ACCEL_STD),
        sensor=PositionSensor(dims=2, std=core.sensor_std()),
        births=tuple(GaussianState(mean, np.diag(variances)) for mean, variances in core.births()),
        birth_weight=BIRTH_WEIGHT,
        detections_per_target=core.detections_per_target(),
        detection_probability=float(detection_probability),
        clutter_density=core.clutter_density(),
        times=times,
        states=frozen(states),
        truth=tuple(Truth(str(i), times[life], states[life, i, :2]) for i, life in enumerate(lives.T)),
        _core=core,
    )


@remembered
def crossing(
    shapes: Shape | Sequence[Shape] = Blob(),
    *,
    rates: float | Sequence[float] = (10.0, 20.0, 40.0),
    clutter: float = 10.0,
    detection_probability: float = 0.99,
) -> ExtendedTargets:
    """Return the crossing scenario of the extended-target paper: three targets meet in the origin at 50 s.

    They begin in (-800, -600), (-900, 100) and (-700, 700); the third lives from 20 to 90 s. The paper prints
    velocities of zero, with which nothing can cross: here each has the one that brings it to the origin.

    Args:
        shapes: of all targets, or one for each.
        rates: mean detections of every target, or one for each.
        clutter: mean false detections in a scan.
        detection_probability: that a living target is detected at all.

    Returns:
        The scenario; of a detection a filter is told what it is on average, but R = 650 m² where all shapes are
        `Ellipse()`, `Rectangle()` and `LShape()`, as the spec has it (628, 671 and 775 m²).

    Raises:
        ParameterError: a parameter is outside its domain.
        DimensionError: there are not as many shapes or rates as targets.

    Reference:
        Section 7 of the spec of the extended-target paper.

    Example:
        >>> from trackrs.scenarios import Ellipse, LShape, Rectangle, crossing
        >>> scene = crossing([Ellipse(), Rectangle(), LShape()])
        >>> detections = scene.draw(seed=7, run=3)
        >>> scene.states[49, :, :2].round(9).tolist(), detections.scans[49].values.shape
        ([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]], (78, 2))
    """
    kinds = _each(shapes, 3)
    out = _trackrs.crossing_targets([_items(shape) for shape in kinds], per_axis(rates, 3, "rates"))
    return _reference(out, kinds, clutter, detection_probability)


@remembered
def parallel(
    spacing: float = 80.0,
    shapes: Shape | Sequence[Shape] = Blob(),
    *,
    rates: float | Sequence[float] = 10.0,
    clutter: float = 10.0,
    detection_probability: float = 0.99,
) -> ExtendedTargets:
    """Return the parallel scenario of the extended-target paper: two targets side by side at 16 m/s.

    They begin in (-800, 600) and (-800, 600 + spacing).

    Args:
        spacing: metres; the paper's text says 80, its printed states 70.
        shapes: of both targets, or one for each.
        rates: mean detections of both, or one for each.
        clutter: mean false detections in a scan.
        detection_probability: that a living target is detected at all.

    Returns:
        The scenario; what a filter is told as in `crossing`.

    Raises:
        ParameterError: a parameter is outside its domain.
        NonFiniteError: `spacing` is not finite.
        DimensionError: there are not as many shapes or rates as targets.

    Reference:
        Section 7 of the spec of the extended-target paper.

    Example:
        >>> import trackrs as tr
        >>> scene = tr.scenarios.parallel(70.0)
        >>> scene.states[0, :, 1], scene.detections_per_target
        (array([600., 670.]), 10.0)
    """
    kinds = _each(shapes, 2)
    out = _trackrs.parallel_targets([_items(shape) for shape in kinds], per_axis(rates, 2, "rates"), spacing)
    return _reference(out, kinds, clutter, detection_probability)


def _reference(
    out: dict[str, Any], shapes: Sequence[Shape], clutter: float, detection_probability: float
) -> ExtendedTargets:
    targets = [
        ExtendedTarget(tuple(start), first, last, rate, shape)
        for (start, first, last, rate), shape in zip(out["lives"], shapes, strict=True)
    ]
    return extended_targets(
        targets, clutter=clutter, detection_probability=detection_probability, sensor_std=out["sensor_std"]
    )


def _each(shapes: Shape | Sequence[Shape], targets: int) -> tuple[Shape, ...]:
    """Return one shape per target."""
    kinds = tuple(shapes) if isinstance(shapes, Sequence) else (shapes,) * targets
    if len(kinds) == targets:
        return kinds
    msg = f"shapes must be one or {targets}, got {len(kinds)}"
    raise DimensionError(msg)


def _items(shape: object) -> tuple[str, list[float]]:
    """Return kind and sizes."""
    match shape:
        case Blob(spread):
            return "blob", [spread]
        case Ellipse(length, width):
            return "ellipse", [length, width]
        case Rectangle(length, width):
            return "rectangle", [length, width]
        case LShape(arm):
            return "l", [arm]
    msg = f"shape = {shape!r} is invalid: must be a Blob, Ellipse, Rectangle or LShape"
    raise ParameterError(msg)
