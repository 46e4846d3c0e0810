"""What a configuration file may say: the classes by the names they have there, and what their arguments take."""

from __future__ import annotations

import difflib
import inspect
import json
import re
from dataclasses import MISSING, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs._arrays import array
from trackrs.adaptive import ChiSquareScreen, LimitedMemoryNoise, NisScaledNoise, ResidualNoise
from trackrs.association import JIPDA, JPDA, NPDA, PDA, GlobalNearestNeighbour, NearestNeighbour
from trackrs.errors import DimensionError
from trackrs.filter import CubatureKalmanFilter, ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter
from trackrs.intensity import AdaptiveBirth, Birth, DetectionRate, Extent
from trackrs.late import DropLate, Reorder, Replay
from trackrs.lof import LocalOutlierFactor
from trackrs.motion import ConstantAcceleration, ConstantVelocity, LinearMotion, RandomWalk, Singer
from trackrs.partition import (
    DbscanPartition,
    DensityPeakPartition,
    DistancePartition,
    KMeansPartition,
    TwoLevelPartition,
)
from trackrs.phd import CPHD, GMPHD, ExtendedGMPHD
from trackrs.pose import CameraSensor, PoseSensor
from trackrs.range_array import RangeArray
from trackrs.sensor import LinearSensor, PositionSensor, RangeBearing
from trackrs.tracker import ClutterMap, Deletion, Existence, MofN, MultiTargetTracker
from trackrs.tree import TreePartition
from trackrs.types import GaussianState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import ArrayLike

    from trackrs.motion import Motion
    from trackrs.sensor import Sensor


def given_birth(means: ArrayLike, std: Sequence[float], weights: float | Sequence[float] = 0.1) -> Birth:
    """Return the places where targets may appear: their states (B, n), one standard deviation per component."""
    rows = array(means, "means", 2)
    if rows.shape[1] != len(std):
        msg = f"std: expected {rows.shape[1]} values, one per component of the means, found {len(std)}"
        raise DimensionError(msg)
    return Birth([GaussianState(row, np.diag(np.square(std)), 0.0) for row in rows], weights)


def snake_case(name: str) -> str:
    """Return the name of a class as it stands in a configuration file."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


MOTIONS: dict[str, Callable[..., Motion]] = {
    snake_case(model.__name__): model
    for model in (ConstantVelocity, ConstantAcceleration, RandomWalk, Singer, LinearMotion)
}
SENSORS: dict[str, Callable[..., Sensor]] = {
    snake_case(model.__name__).removesuffix("_sensor"): model
    for model in (PositionSensor, RangeBearing, RangeArray, PoseSensor, CameraSensor, LinearSensor)
}
ASSOCIATORS: dict[str, Callable[..., Any]] = {
    snake_case(kind.__name__): kind for kind in (GlobalNearestNeighbour, NearestNeighbour, PDA, JPDA, JIPDA, NPDA)
}
ADAPTATIONS: dict[str, Callable[..., Any]] = {
    snake_case(kind.__name__): kind for kind in (LimitedMemoryNoise, ResidualNoise, NisScaledNoise)
}
INITIATORS: dict[str, Callable[..., Any]] = {snake_case(kind.__name__): kind for kind in (MofN, Existence)}
LATE: dict[str, Callable[..., Any]] = {snake_case(kind.__name__): kind for kind in (DropLate, Reorder, Replay)}
BIRTHS: dict[str, Callable[..., Any]] = {"given": given_birth, "adaptive": AdaptiveBirth}
PARTITIONS: dict[str, Callable[..., Any]] = {
    name.removesuffix("_partition").replace("kmeans", "k_means"): kind
    for name, kind in (
        (snake_case(kind.__name__), kind)
        for kind in (
            TreePartition,
            DistancePartition,
            KMeansPartition,
            DbscanPartition,
            DensityPeakPartition,
            TwoLevelPartition,
        )
    )
}
FILTERS: dict[str, Callable[..., Any]] = {
    snake_case(kind.__name__): kind
    for kind in (KalmanFilter, ExtendedKalmanFilter, UnscentedKalmanFilter, CubatureKalmanFilter)
} | {"unscented_kalman_filter_as_printed": UnscentedKalmanFilter.as_printed}
# The trackers; what they are built of and with is given elsewhere, or no file can hold it.
TRACKERS: dict[str, Callable[..., Any]] = {
    "multi_target": MultiTargetTracker,
    "phd": GMPHD,
    "cphd": CPHD,
    "extended_phd": ExtendedGMPHD,
}
GIVEN_ELSEWHERE = {"self", "motion", "sensors", "sensor", "initial", "spawns"}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**32


def _are(check: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, list) and all(check(item) for item in value)


_NUMBERS = _are(_is_number)
_TEXTS = _are(lambda item: isinstance(item, str))


@dataclass(frozen=True, slots=True)
class Kind:
    """What a value must be: a test, and the same in words."""

    accepts: Callable[[object], bool]
    words: str


# By the annotation of the argument, without ` | None`.
KINDS = {
    "int": Kind(_is_count, "a whole number, not negative"),
    "float": Kind(_is_number, "a number"),
    "Form": Kind(lambda v: v in ("joseph", "square_root"), '"joseph" or "square_root"'),
    "bool": Kind(lambda value: isinstance(value, bool), "true or false"),
    "str": Kind(lambda value: isinstance(value, str), "text in quotes"),
    "tuple[str, ...]": Kind(_TEXTS, "a list of texts"),
    "Sequence[str]": Kind(_TEXTS, "a list of texts"),
    "tuple[float, float]": Kind(lambda v: isinstance(v, list) and _NUMBERS(v) and len(v) == 2, "a list of two numbers"),
    "tuple[int, int]": Kind(
        lambda v: isinstance(v, list) and _are(_is_count)(v) and len(v) == 2, "two whole numbers in a list"
    ),
    "Sequence[float]": Kind(_NUMBERS, "a list of numbers"),
    "float | Sequence[float]": Kind(lambda v: _is_number(v) or _NUMBERS(v), "a number or a list of numbers"),
    "float | Mapping[str, float]": Kind(
        lambda v: _is_number(v) or (isinstance(v, dict) and all(_is_number(item) for item in v.values())),
        "a number, or a table of numbers by sensor",
    ),
    "float | ArrayLike": Kind(
        lambda v: _is_number(v) or _NUMBERS(v) or _are(_NUMBERS)(v),
        "a number, a list of numbers, or of rows of numbers",
    ),
    "ArrayLike": Kind(lambda v: _NUMBERS(v) or _are(_NUMBERS)(v), "a list of numbers, or of rows of numbers"),
}
RECORDS: dict[str, type] = {
    "ChiSquareScreen": ChiSquareScreen,
    "Deletion": Deletion,
    "ClutterMap": ClutterMap,
    "LocalOutlierFactor": LocalOutlierFactor,
    "DetectionRate": DetectionRate,
    "Extent": Extent,
}
# By the name of the argument: records of several kinds, which a table's "type" chooses from.
CHOICES = {
    "adapt": ADAPTATIONS,
    "associator": ASSOCIATORS,
    "birth": BIRTHS,
    "initiator": INITIATORS,
    "late": LATE,
    "partition": PARTITIONS,
}
LITERAL = re.compile(r"Literal\[([^\]]*)\]")
BETWEEN = re.compile(r" \| (?![^\[]*\])")


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of a class or function, as its signature has it."""

    name: str
    annotation: str
    required: bool
    default: object = None

    @property
    def takes_none(self) -> bool:
        """Whether None is a choice that leaving it out does not make."""
        return self.annotation.endswith(" | None") and not self.required and self.default is not None


def arguments_of(target: Callable[..., Any]) -> list[Argument]:
    """The arguments that a table may give to `target`."""
    if isinstance(target, type) and hasattr(target, "__dataclass_fields__"):
        return [
            Argument(
                field.name,
                str(field.type),
                field.default is MISSING and field.default_factory is MISSING,
                field.default,
            )
            for field in fields(target)
            if field.init
        ]
    parameters = inspect.signature(target).parameters.values()
    return [Argument(p.name, str(p.annotation), p.default is inspect.Parameter.empty, p.default) for p in parameters]


def shown(value: object) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."


def closest(wrong: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(wrong, known, n=1)
    return f'; did you mean "{close[0]}"?' if close else ""
