"""Sensor models. A sensor knows which of its components are angles; every residual of them wraps by itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, frozen, per_axis
from trackrs.errors import DimensionError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Sensor:
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

    def noise(self) -> FloatArray:
        """Return R, (m, m)."""
        return frozen(self._core.noise())

    def observe(self, state: ArrayLike, platform: ArrayLike | None = None) -> FloatArray:
        """Return the noise-free measurement of a state (n,), taken from a platform (d,) if the sensor moves.

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
