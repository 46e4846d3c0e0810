"""Sensor models. A sensor knows which of its components are angles; every residual of them wraps by itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, frozen, frozen_array, per_axis
from trackrs._value import Value
from trackrs.errors import DimensionError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Sensor(Value):
    """What all sensors share."""

    _core: _trackrs.Sensor = field(init=False, repr=False, compare=False)

    @property
    def measurement_dim(self) -> int:
        """Length m of a measurement."""
        return self._core.measurement_dim

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the measurement's components."""
        return tuple(self._core.labels)

    @property
    def extra_labels(self) -> tuple[str, ...]:
        """Names of the components that the sensor adds to the end of a filter's state; most sensors add none."""
        return tuple(self._core.extra_labels)

    @property
    def angles(self) -> tuple[int, ...]:
        """Which components are angles, in radians: their differences wrap."""
        return tuple(self._core.angles)

    def noise(self) -> FloatArray:
        """Return R, (m, m)."""
        return frozen(self._core.noise())

    def measurements(self, values: ArrayLike) -> FloatArray:
        """Return rows of reports as the measurements (T, m) that a filter takes: the same, but for quaternions.

        Raises:
            DimensionError: `values` is not two-dimensional.
        """
        return array(values, "values", 2)

    def observe(self, state: ArrayLike, platform: ArrayLike | None = None) -> FloatArray:
        """Return the noise-free measurement of a state (n,), taken from a platform (d,) if the sensor moves.

        The last components of the state are those of `extra_labels`; a position alone (d,) has none of them.

        Raises:
            UnobservableError: the sensor has no value there, for example range-bearing at its own position.
        """
        where = None if platform is None else array(platform, "platform", 1)
        return frozen(self._core.observe(array(state, "state", 1), where))


@dataclass(frozen=True, slots=True)
class PositionSensor(Sensor):
    """A sensor that reports positions, relative to the platform where a scan carries one.

    Args:
        dims: number of axes.
        std: standard deviation, metres; a number or one per axis.

    Raises:
        ParameterError: `std` is not positive.
    """

    dims: int
    std: float | Sequence[float]

    def __post_init__(self) -> None:
        """Build the model."""
        object.__setattr__(self, "_core", _trackrs.Sensor.position(per_axis(self.std, self.dims, "std")))


@dataclass(frozen=True, slots=True)
class RangeBearing(Sensor):
    """Range and bearing in the plane: measurement `[range, bearing]`, bearing = atan2(dy, dx), wrapped.

    With x north and y east the bearing is the compass bearing.

    Args:
        position: of the sensor (2,), metres; an offset from the platform where a scan carries one.
        range_std: metres.
        bearing_std: radians.

    Raises:
        ParameterError: a standard deviation is not positive.

    Reference:
        Liu, Xie, Huang (2009), eq. (16); spec labels N4 to N6.

    Example:
        >>> import trackrs as tr
        >>> tr.RangeBearing(position=(0, 0), range_std=20.0, bearing_std=1e-3).observe([3.0, 4.0, 0.0, 0.0])
        array([5.        , 0.92729522])
    """

    position: Sequence[float]
    range_std: float
    bearing_std: float

    def __post_init__(self) -> None:
        """Build the model."""
        position = array(self.position, "position", 1)
        if position.shape != (2,):
            msg = f"position must have 2 coordinates, got {position.shape[0]}"
            raise DimensionError(msg)
        x, y = (float(v) for v in position)
        core = _trackrs.Sensor.range_bearing((x, y), float(self.range_std), float(self.bearing_std))
        object.__setattr__(self, "_core", core)


@dataclass(frozen=True, slots=True, eq=False)
class LinearSensor(Sensor):
    """A sensor by fixed matrices, z = H x + d + v with v ~ N(0, R).

    Args:
        H: matrix (m, n).
        R: noise covariance (m, m).
        offset: d (m,), zero if not given.

    Raises:
        DimensionError: the shapes do not agree.
        ParameterError: R is not a covariance.
    """

    H: ArrayLike
    R: ArrayLike
    offset: ArrayLike | None = None

    def __post_init__(self) -> None:
        """Build the model."""
        h, r = array(self.H, "H", 2), array(self.R, "R", 2)
        d = np.zeros(h.shape[0]) if self.offset is None else array(self.offset, "offset", 1)
        object.__setattr__(self, "_core", _trackrs.Sensor.linear(h, r, d))


@dataclass(frozen=True, slots=True, eq=False, init=False)
class CustomSensor(Sensor):
    """A sensor by Python functions of many states at once, for filters over one target.

    Args:
        h: called as `h(states)` with states (k, n), returns what is expected of them (k, m).
        noise: R (m, m).
        angles: which components are angles, in radians; their differences and means wrap by themselves.
        jacobian: called as `jacobian(states)`, returns the derivatives (k, m, n). None: by central differences. Sigma
            points do not need it.

    Raises:
        ParameterError: `noise` is not a covariance, or `angles` names a component that is not there.
        DimensionError, NonFiniteError: in use, when a function returns another shape than it should, or a number that
            is not finite. Exceptions of the functions come out as they are.
    """

    h: Callable[[FloatArray], ArrayLike]
    jacobian: Callable[[FloatArray], ArrayLike] | None
    _given: tuple[FloatArray, tuple[int, ...]] = field(init=False, repr=False)

    def __init__(
        self,
        h: Callable[[FloatArray], ArrayLike],
        noise: ArrayLike,
        *,
        angles: Sequence[int] = (),
        jacobian: Callable[[FloatArray], ArrayLike] | None = None,
    ) -> None:
        """Build the model."""
        object.__setattr__(self, "h", h)
        given = (frozen_array(noise, "noise", 2), tuple(angles))
        object.__setattr__(self, "jacobian", jacobian)
        object.__setattr__(self, "_given", given)
        object.__setattr__(self, "_core", _trackrs.Sensor.custom(h, given[0], list(given[1]), jacobian))

    def _more(self) -> dict[str, object]:
        return {"noise": self._given[0], "angles": self._given[1]}
