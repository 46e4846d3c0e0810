"""Motion models. State order is block order: all positions, then all velocities, then all accelerations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, frozen, frozen_array, per_axis
from trackrs._value import Value
from trackrs.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Motion(Value):
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


@dataclass(frozen=True, slots=True)
class Singer(Motion):
    """Acceleration that forgets itself, with velocity jumps if wanted; state `x y z vx vy vz ax ay az`.

    The acceleration is a first-order Markov process: correlation `accel_std² exp(-s / time_constant)`. F and Q are
    exact for any time step. Moving heads and hands, and vehicles that manoeuvre for a while, move about so.

    Args:
        dims: number of axes.
        accel_std: stationary standard deviation of the acceleration, m/s² (rad/s² for an axis that is an angle). A
            number or one per axis.
        time_constant: correlation time, seconds. A number or one per axis.
        accel_psd: density of a white acceleration besides, which makes the velocity jump, m²/s³. A number or one per
            axis.

    Raises:
        ParameterError: a negative noise, or a time constant that is not positive.

    Reference:
        Singer (1970), IEEE Transactions on Aerospace and Electronic Systems 6(4); Bar-Shalom, Li, Kirubarajan (2001),
        §8.2.3.

    Example:
        >>> import trackrs as tr
        >>> tr.Singer(dims=1, accel_std=2.0, time_constant=0.5).transition(0.5).round(4)
        array([[1.    , 0.5   , 0.092 ],
               [0.    , 1.    , 0.3161],
               [0.    , 0.    , 0.3679]])
    """

    dims: int
    accel_std: float | Sequence[float]
    time_constant: float | Sequence[float]
    accel_psd: float | Sequence[float] = 0.0

    def __post_init__(self) -> None:
        """Build the model."""
        core = _trackrs.Motion.singer(
            per_axis(self.accel_std, self.dims, "accel_std"),
            per_axis(self.time_constant, self.dims, "time_constant"),
            per_axis(self.accel_psd, self.dims, "accel_psd"),
        )
        object.__setattr__(self, "_core", core)


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


@dataclass(frozen=True, slots=True, eq=False, init=False)
class CustomMotion(Motion):
    """A motion by Python functions of many states at once, for filters over one target.

    Args:
        f: called as `f(states, dt)` with states (k, n), returns them `dt` seconds later (k, n). It is not called for
            dt = 0, which moves nothing.
        noise: Q (n, n), added once per positive time step whatever its length, or a function `noise(dt)` that returns
            it.
        labels: names of the state's n components. None: x0, x1, ... as many as `noise` has, if it is a matrix.
        jacobian: called as `jacobian(states, dt)`, returns the derivatives (k, n, n). None: by central differences.
            Sigma points do not need it.

    Raises:
        DimensionError: `noise` does not fit `labels`; in use, when a function returns another shape than it should.
        NonFiniteError: in use, when a function returns a number that is not finite. Exceptions of the functions come
            out as they are.

    Example:
        >>> import numpy as np, trackrs as tr
        >>> def swing(states, dt):
        ...     angle, rate = states.T
        ...     rate = rate - dt * 9.81 * np.sin(angle)
        ...     return np.stack([angle + dt * rate, rate], axis=1)
        >>> motion = tr.CustomMotion(swing, 1e-4 * np.eye(2), labels=("angle", "rate"))
        >>> sensor = tr.CustomSensor(lambda states: np.sin(states[:, :1]), [[0.01]])
        >>> ukf = tr.UnscentedKalmanFilter(motion, sensor)
        >>> ukf.predict(tr.GaussianState([0.1, 0.0], 0.01 * np.eye(2)), 0.01).mean.round(4)
        array([ 0.0999, -0.0097])
    """

    f: Callable[[FloatArray, float], ArrayLike]
    jacobian: Callable[[FloatArray, float], ArrayLike] | None
    _given: FloatArray | Callable[[float], ArrayLike] = field(init=False, repr=False)

    def __init__(
        self,
        f: Callable[[FloatArray, float], ArrayLike],
        noise: ArrayLike | Callable[[float], ArrayLike],
        *,
        labels: Sequence[str] | None = None,
        jacobian: Callable[[FloatArray, float], ArrayLike] | None = None,
    ) -> None:
        """Build the model."""
        given = noise if callable(noise) else frozen_array(noise, "noise", 2)
        if labels is None:
            if callable(given):
                msg = "labels is missing: with noise as a function nothing else says how long the state is"
                raise ParameterError(msg)
            labels = [f"x{i}" for i in range(len(given))]
        object.__setattr__(self, "f", f)
        object.__setattr__(self, "jacobian", jacobian)
        object.__setattr__(self, "_given", given)
        object.__setattr__(self, "_core", _trackrs.Motion.custom(f, given, list(labels), jacobian))

    def _more(self) -> dict[str, object]:
        return {"noise": self._given, "labels": self.labels}
