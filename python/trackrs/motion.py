"""Motion models. State order is block order: all positions, then all velocities, then all accelerations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, frozen, per_axis
from trackrs.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Motion:
    """What all motion models share."""

    _core: _trackrs.Motion = field(init=False, repr=False, compare=False)

    @property
    def state_dim(self) -> int:
        """Length n of the state."""
        return self._core.state_dim

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the state's components, for example `("x", "y", "vx", "vy")`."""
        return tuple(self._core.labels)

    def transition(self, dt: float) -> FloatArray:
        """Return F over `dt` seconds, (n, n)."""
        return frozen(self._core.transition(dt))

    def noise(self, dt: float) -> FloatArray:
        """Return Q gathered in `dt` seconds, (n, n)."""
        return frozen(self._core.noise(dt))


def _noise(
    name: str,
    dims: int,
    psd: float | Sequence[float] | None,
    std: float | Sequence[float] | None,
) -> tuple[list[float], bool]:
    if (psd is None) == (std is None):
        msg = f"give exactly one of {name}_psd (spectral density) and {name}_std (constant over a step)"
        raise ParameterError(msg)
    if psd is not None:
        return per_axis(psd, dims, f"{name}_psd"), True
    assert std is not None  # noqa: S101 (for the type checker)
    return per_axis(std, dims, f"{name}_std"), False


@dataclass(frozen=True, slots=True)
class RandomWalk(Motion):
    """Position that wanders; state `x y z`.

    Args:
        dims: number of axes.
        velocity_psd: white-noise density, m²/s: Q = psd dt. A number or one per axis.
        velocity_std: or a velocity constant over each step, m/s: Q = std² dt².

    Raises:
        ParameterError: not exactly one noise given, or a negative one.
    """

    dims: int
    velocity_psd: float | Sequence[float] | None = None
    velocity_std: float | Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Build the model."""
        values, psd = _noise("velocity", self.dims, self.velocity_psd, self.velocity_std)
        object.__setattr__(self, "_core", _trackrs.Motion.random_walk(values, psd=psd))


@dataclass(frozen=True, slots=True)
class ConstantVelocity(Motion):
    """Nearly constant velocity; state `x y z vx vy vz`.

    Args:
        dims: number of axes.
        accel_psd: white-noise density of the acceleration, m²/s³, exact for any time step. A number or one per axis.
        accel_std: or an acceleration constant over each step, m/s².

    Raises:
        ParameterError: not exactly one noise given, or a negative one.

    Reference:
        Bar-Shalom, Li, Kirubarajan (2001), §6.2.2 and §6.3.2.

    Example:
        >>> import trackrs as tr
        >>> tr.ConstantVelocity(dims=1, accel_psd=3.0).noise(2.0)
        array([[8., 6.],
               [6., 6.]])
    """

    dims: int
    accel_psd: float | Sequence[float] | None = None
    accel_std: float | Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Build the model."""
        values, psd = _noise("accel", self.dims, self.accel_psd, self.accel_std)
        object.__setattr__(self, "_core", _trackrs.Motion.constant_velocity(values, psd=psd))


@dataclass(frozen=True, slots=True)
class ConstantAcceleration(Motion):
    """Nearly constant acceleration; state `x y z vx vy vz ax ay az`.

    Args:
        dims: number of axes.
        jerk_psd: white-noise density of the jerk, m²/s⁵, exact for any time step. A number or one per axis.
        jerk_std: or a jerk constant over each step, m/s³.

    Raises:
        ParameterError: not exactly one noise given, or a negative one.

    Reference:
        Bar-Shalom, Li, Kirubarajan (2001), §6.2.3; constant jerk: underwater paper, spec label U2.
    """

    dims: int
    jerk_psd: float | Sequence[float] | None = None
    jerk_std: float | Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Build the model."""
        values, psd = _noise("jerk", self.dims, self.jerk_psd, self.jerk_std)
        object.__setattr__(self, "_core", _trackrs.Motion.constant_acceleration(values, psd=psd))


@dataclass(frozen=True, slots=True, eq=False)
class LinearMotion(Motion):
    """Motion by fixed matrices, x⁺ = F x + w with w ~ N(0, Q), once per positive time step whatever its length.

    Args:
        F: transition (n, n).
        Q: noise covariance (n, n).

    Raises:
        DimensionError: the shapes do not agree.
        ParameterError: Q is not a covariance.
    """

    F: ArrayLike
    Q: ArrayLike

    def __post_init__(self) -> None:
        """Build the model."""
        core = _trackrs.Motion.linear(array(self.F, "F", 2), array(self.Q, "Q", 2))
        object.__setattr__(self, "_core", core)
