"""Filters over the measurements of one target."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from trackrs import _trackrs
from trackrs._arrays import array, frozen
from trackrs.errors import ParameterError, TimeError
from trackrs.types import FilterRun, GaussianState, Update, freeze_columns

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from trackrs.adaptive import ChiSquareScreen, LimitedMemoryNoise
    from trackrs.motion import Motion
    from trackrs.sensor import Sensor

History = Literal["full", "filtered", "last"]


@dataclass(frozen=True, slots=True)
class _SequenceFilter:
    """One motion, one sensor, one target."""

    motion: Motion
    sensor: Sensor
    adapt: LimitedMemoryNoise | None = None
    screen: ChiSquareScreen | None = None
    _core: _trackrs.Filter = field(init=False, repr=False, compare=False)

    def _keep(self, core: _trackrs.Filter) -> None:
        if self.screen is not None:
            core = core.with_screen(self.screen.alpha, self.screen.mode, self.screen.allowance)
        if self.adapt is not None:
            rule = self.adapt
            core = core.with_adaptation(
                rule.window,
                rule.r_window,
                rule.method,
                (rule.q_form, rule.r_form),
                rule.first_epoch,
                rule.q_limits,
                rule.r_limits,
            )
        object.__setattr__(self, "_core", core)

    def predict(self, state: GaussianState, time: float, input: ArrayLike | None = None) -> GaussianState:  # noqa: A002
        """Return the estimate at `time`; `input` (n,) is added to the predicted state.

        Raises:
            TimeError: `time` is before the state's.
        """
        if time < state.time:
            msg = f"time {time} s is before {state.time} s: times must not decrease"
            raise TimeError(msg)
        known = None if input is None else array(input, "input", 1)
        mean, cov = self._core.predict(state.mean, state.cov, time - state.time, known)
        return GaussianState(mean, cov, time)

    def update(self, state: GaussianState, value: ArrayLike, platform: ArrayLike | None = None) -> Update:
        """Return the update of `state` by one measurement (m,); NaN = component not observed.

        Raises:
            NotPositiveDefiniteError: the innovation covariance is singular.
            NonFiniteError: the measurement is infinite.
        """
        where = None if platform is None else array(platform, "platform", 1)
        out: dict[str, Any] = freeze_columns(self._core.update(state.mean, state.cov, array(value, "value", 1), where))
        posterior = GaussianState(out.pop("mean"), out.pop("cov"), state.time)
        return Update(posterior=posterior, **out)

    def run(
        self,
        times: ArrayLike,
        values: ArrayLike,
        *,
        initial: GaussianState | None = None,
        inputs: ArrayLike | None = None,
        history: History = "full",
    ) -> FilterRun:
        """Filter T measurements.

        Args:
            times: (T,) seconds, not decreasing.
            values: (T, m); NaN = component not observed, a row of NaN = no measurement.
            initial: the estimate to begin with; it is predicted from its own time to the first of `times`. With a
                `RangeArray` it may be left out: the run then starts at the third of three consecutive measurements
                whose position fixes pass the test of their redundancy (alpha = 0.01), and rows before that are NaN.
            inputs: (T, n) known inputs, each added to the state predicted to its time.
            history: keep predicted and filtered estimates ("full"; smoothing needs it), filtered ones, or the last one.

        Raises:
            ParameterError: no initial state given, and the models cannot start one.
            UnobservableError: no three consecutive measurements could start the run; the message says why.
            TimeError: times decrease.
            DimensionError: shapes do not agree.
            NotPositiveDefiniteError: an innovation covariance is singular.
        """
        if initial is None and not self._core.starts:
            msg = (
                f"initial is missing: {type(self.sensor).__name__} alone cannot start the state "
                f"{' '.join(self.motion.labels)}; pass initial=GaussianState(mean, cov, time)"
            )
            raise ParameterError(msg)
        t, z = array(times, "times", 1), array(values, "values", 2)
        u = None if inputs is None else array(inputs, "inputs", 2)
        given = None if initial is None else (initial.time, initial.mean, initial.cov)
        out = self._core.run(t, z, given, history, u)
        out["restarts"] = tuple(out["restarts"])
        kept = t[-1:] if history == "last" else t
        return FilterRun(times=frozen(kept.copy()), labels=self.motion.labels, **freeze_columns(out))

    def replace(self, **changes: Any) -> Any:  # noqa: ANN401 (the type is the caller's)
        """Return the same filter with some arguments changed."""
        return replace(self, **changes)


@dataclass(frozen=True, slots=True)
class KalmanFilter(_SequenceFilter):
    """The Kalman filter of a linear motion and a linear sensor, updates in Joseph form.

    Args:
        motion: for example `ConstantVelocity` or `LinearMotion`.
        sensor: for example `PositionSensor` or `LinearSensor`.
        adapt: estimate the noise while `run` goes on.
        screen: reject gross errors in `run`.

    Raises:
        ParameterError: a model is not linear.
        DimensionError: the sensor does not fit the motion.

    Reference:
        Bar-Shalom, Li, Kirubarajan (2001), §5.2.

    Example:
        >>> import trackrs as tr
        >>> kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_psd=0.1), tr.PositionSensor(dims=1, std=1.0))
        >>> start = tr.GaussianState([0.0, 0.0], [[1.0, 0.0], [0.0, 4.0]])
        >>> run = kf.run([1.0, 2.0, 3.0], [[1.1], [1.9], [3.2]], initial=start)
        >>> run.means.shape
        (3, 2)
    """

    def __post_init__(self) -> None:
        """Build the filter."""
        self._keep(_trackrs.Filter.kalman(self.motion._core, self.sensor._core))


@dataclass(frozen=True, slots=True)
class ExtendedKalmanFilter(_SequenceFilter):
    """The extended Kalman filter: a nonlinear sensor is linearised at the predicted state; angles wrap by themselves.

    Args:
        motion: for example `ConstantVelocity`.
        sensor: for example `RangeBearing`.
        adapt: estimate the noise while `run` goes on.
        screen: reject gross errors in `run`.
        iterations: most linearisations of the sensor per measurement. Above 1 it is the iterated filter: each is at the
            posterior of the one before (Gauss-Newton), until no component of the state moves by more than 1e-9 of its
            standard deviation. Innovation, NIS and screening are those of the first.

    Raises:
        DimensionError: the sensor does not fit the motion.
        ParameterError: `iterations` is below 1.

    Reference:
        Bar-Shalom, Li, Kirubarajan (2001), §10.3; iterated: §10.5.2, and Bell, Cathey (1993), IEEE Trans. AC 38(2).
    """

    iterations: int = 1

    def __post_init__(self) -> None:
        """Build the filter."""
        self._keep(_trackrs.Filter.extended(self.motion._core, self.sensor._core, self.iterations))
