"""Filters over the measurements of one target."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import array, for_each, freeze_columns, frozen
from trackrs._value import Value
from trackrs.adaptive import ResidualNoise
from trackrs.errors import ParameterError, TimeError
from trackrs.runs import FilterRun
from trackrs.types import Event, GaussianState, Ledger, Update

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from trackrs.adaptive import ChiSquareScreen, LimitedMemoryNoise, NisScaledNoise
    from trackrs.batch import BatchRun
    from trackrs.motion import Motion
    from trackrs.sensor import Sensor

History = Literal["full", "filtered", "last"]
Form = Literal["joseph", "square_root"]
Lead: TypeAlias = "float | ArrayLike | Literal['midpoint'] | None"


@dataclass(frozen=True, slots=True)
class _SequenceFilter(Value):
    """One motion, one sensor, one target."""

    motion: Motion
    sensor: Sensor
    adapt: LimitedMemoryNoise | ResidualNoise | NisScaledNoise | None = None
    screen: ChiSquareScreen | None = None
    form: Form = field(default="joseph", kw_only=True)
    steps: int = field(default=1, kw_only=True)
    horizon: float | None = field(default=None, kw_only=True)
    strict: bool = field(default=False, kw_only=True)
    _core: _trackrs.Filter = field(init=False, repr=False, compare=False)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the state's components: those of the motion, then those that the sensor adds.

        With a sensor that needs an attitude they are those of a rigid body: `x y z rx ry rz vx vy vz wx wy wz ...`, a
        rotation vector and its rates in body axes, or `rx ry rz wx wy wz ...`.
        """
        return tuple(self._core.labels)

    def _keep(self, core: _trackrs.Filter) -> None:
        if self.screen is not None:
            core = core.with_screen(self.screen.alpha, self.screen.mode, self.screen.restart, self.screen.allowance)
        if self.adapt is not None:
            core = self.adapt._apply(core)
        if self.form != "joseph":
            core = core.with_form(self.form)
        if self.steps != 1:
            core = core.with_steps(self.steps)
        if self.horizon is not None:
            core = core.with_horizon(self.horizon)
        if self.strict:
            core = core.with_strict()
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

        Of a `PoseSensor` with quaternions the report (7,) or (4,); innovations hold turns in body axes.

        Raises:
            ParameterError: a quaternion is zero or far from norm 1.
            NotPositiveDefiniteError: the innovation covariance is singular.
            NonFiniteError: the measurement is infinite.
        """
        where = None if platform is None else array(platform, "platform", 1)
        measured = self.sensor.measurements(array(value, "value", 1)[np.newaxis])[0]
        out: dict[str, Any] = freeze_columns(self._core.update(state.mean, state.cov, measured, where))
        posterior = GaussianState(out.pop("mean"), out.pop("cov"), state.time)
        return Update(posterior=posterior, **out)

    def run(
        self,
        times: ArrayLike,
        values: ArrayLike,
        *,
        initial: GaussianState | None = None,
        inputs: ArrayLike | None = None,
        lead: Lead = None,
        history: History = "full",
    ) -> FilterRun:
        """Filter T measurements.

        Args:
            times: (T,) seconds, not decreasing.
            values: (T, m); NaN = component not observed, a row of NaN = no measurement. Of a `PoseSensor` with
                quaternions the reports, (T, 7) or (T, 4).
            initial: the estimate to begin with; it is predicted from its own time to the first of `times`. An attitude
                in the state is a rotation vector (`trackrs.rotation`), and its covariance that of a small turn in body
                axes.
                With a `RangeArray`, `PositionSensor`, `PoseSensor` or `CameraSensor` and a motion of positions,
                velocities and accelerations it may be left out: the run then starts at the third of three consecutive
                measurements that each give a position or pose, and rows before that are NaN. Where a fix has
                redundancy it must pass the test of that (alpha = 0.01, or its square where the sensor adds components:
                they fail again what they fail once); an image that two attitudes fit is none.
                Where single measurements cannot fix a position, as ranges that come one at a time, they are gathered
                until they can, and the state is fitted to three such groups, each measurement at its own time.
                Components that the sensor adds may be left out.
            inputs: (T, n) known inputs, each added to the state predicted to its time; components that the sensor adds
                may be left out. Of an attitude, turns in body axes.
            lead: predict ahead of every measurement, by so many seconds: a number, (T,) numbers, or "midpoint" for half
                the interval to the next measurement (of the last one half the interval before), which is the cycle of
                the helmet paper. The predictions, `lead_means` and `lead_covs` for `lead_times`, know no measurement
                after their own, and no `inputs`.
            history: keep predicted and filtered estimates ("full"; smoothing needs it), filtered ones, or the last one.

        Raises:
            ParameterError: no initial state given, and the models cannot start one; `lead` is negative or beyond the
                filter's `horizon`; or a quaternion is zero or far from norm 1 (the message names its row).
            UnobservableError: no three consecutive measurements could start the run; the message says why.
            TimeError: times decrease.
            DimensionError: shapes do not agree.
            NotPositiveDefiniteError: an innovation covariance is singular.
            StrictError: with `strict`, at the first event.
        """
        if initial is None and not self._core.starts:
            msg = (
                f"initial is missing: {type(self.sensor).__name__} alone cannot start the state "
                f"{' '.join(self.motion.labels)}; pass initial=GaussianState(mean, cov, time)"
            )
            raise ParameterError(msg)
        t, z = array(times, "times", 1), self.sensor.measurements(values)
        u = None if inputs is None else array(inputs, "inputs", 2)
        given = None if initial is None else (initial.time, initial.mean, initial.cov)
        out = self._core.run(t, z, given, history, u, _lead(lead))
        out["restarts"] = tuple(out["restarts"])
        out["events"] = tuple(Event(**event) for event in out["events"])
        out["ledger"] = Ledger(**out["ledger"])
        kept = t[-1:] if history == "last" else t
        if history == "full":
            out |= {name: for_each(out[name], len(kept)) for name in ("transitions", "motion_noises")}
        return FilterRun(times=frozen(kept.copy()), labels=self.labels, **freeze_columns(out))

    def run_batch(
        self,
        times: ArrayLike,
        measurements: ArrayLike,
        *,
        initial: GaussianState,
        covs: bool = False,
        nis: bool = False,
        threads: int | None = None,
    ) -> BatchRun:
        """Filter many sequences that begin with the same estimate; `TrackBatch` is for those that do not.

        Args:
            times: (T,) seconds, not decreasing, the same for all sequences.
            measurements: (B, T, m); NaN = component not observed.
            initial: the estimate to begin with; it is predicted from its own time to the first of `times`.
            covs: return the covariances (B, T, n, n) too.
            nis: return the normalised innovations squared (B, T) too.
            threads: at most so many; None for all processors. The bits are the same on any number.

        Raises:
            TimeError: times decrease, or begin before `initial`.
            DimensionError: shapes do not agree.
            NonFiniteError: a time is not finite, or a measurement infinite.

        Example:
            >>> import numpy as np, trackrs as tr
            >>> kf = tr.KalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.1), tr.PositionSensor(dims=2, std=1.0))
            >>> start = tr.GaussianState(np.zeros(4), 100.0 * np.eye(4))
            >>> kf.run_batch(np.arange(1.0, 51.0), np.zeros((200, 50, 2)), initial=start).means.shape
            (200, 50, 4)
        """
        from trackrs.batch import TrackBatch  # noqa: PLC0415 (which knows the filters)

        z = array(measurements, "measurements", 3)
        means = np.tile(initial.mean, (len(z), 1))
        return TrackBatch(self, means, initial.cov, initial.time, threads=threads).run(times, z, covs=covs, nis=nis)

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
        form: "joseph" carries covariances as they are, which keeps them definite up to a condition of 1e14; where one
            comes close to being singular the run goes on as with "square_root", with the event `escalated`.
            "square_root" carries factors from the start, by orthogonal transformations: up to 1e24. `covs` are products
            of the factors; screening, noise estimation and smoothing work on these products, in their plain form.
        steps: predict in so many equal steps. Of consequence with sigma points and adapted noise.
        horizon: longest `lead`, seconds.
        strict: the first event of a run (a rejected component, a restart, an escalation) raises `StrictError`.

    Raises:
        ParameterError: a model is not linear, as poses with quaternions are not.
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
        form: "joseph" carries covariances as they are, which keeps them definite up to a condition of 1e14; where one
            comes close to being singular the run goes on as with "square_root", with the event `escalated`.
            "square_root" carries factors from the start, by orthogonal transformations: up to 1e24. `covs` are products
            of the factors; screening, noise estimation and smoothing work on these products, in their plain form.
        steps: predict in so many equal steps. Of consequence with sigma points and adapted noise.
        horizon: longest `lead`, seconds.
        strict: the first event of a run (a rejected component, a restart, an escalation) raises `StrictError`.
        iterations: most linearisations of the sensor per measurement. Above 1 it is the iterated filter: each is at the
            posterior of the one before (Gauss-Newton), until no component of the state moves by more than 1e-9 of its
            standard deviation. Innovation, NIS and screening are those of the first.
        second_order: let the curvature of the sensor count in the expected measurement and its variance, as matters
            where the position is uncertain by a good part of the range: after gaps. For a `RangeArray`; not together
            with `iterations`.

    Raises:
        DimensionError: the sensor does not fit the motion.
        ParameterError: `iterations` is below 1 or given with `second_order`, or the sensor does not give its curvature.

    Reference:
        Bar-Shalom, Li, Kirubarajan (2001), §10.3; second order §10.3.2; iterated §10.5.2, and Bell, Cathey (1993), IEEE
        Trans. AC 38(2).
    """

    iterations: int = 1
    second_order: bool = False

    def __post_init__(self) -> None:
        """Build the filter."""
        if self.second_order and self.iterations != 1:
            msg = f"iterations = {self.iterations} cannot go with second_order: choose one"
            raise ParameterError(msg)
        core = _trackrs.Filter.extended(self.motion._core, self.sensor._core, self.iterations)
        self._keep(core.with_second_order() if self.second_order else core)


@dataclass(frozen=True, slots=True)
class UnscentedKalmanFilter(_SequenceFilter):
    """The unscented Kalman filter: moments of nonlinear models from their values at 2n + 1 sigma points.

    The line that fits best through the points, with their misfit as noise, takes the place of the derivative;
    screening, noise estimation and smoothing work on it as they do in the extended filter. Of a linear motion and a
    linear sensor this line is the model itself: then the filter is the Kalman filter, and no points are drawn. Angles
    are compared on the circle.

    Args:
        motion: for example `ConstantVelocity` or `CustomMotion`.
        sensor: for example `RangeBearing` or `CustomSensor`.
        adapt: estimate the noise while `run` goes on.
        screen: reject gross errors in `run`.
        form: "joseph" carries covariances as they are, which keeps them definite up to a condition of 1e14; where one
            comes close to being singular the run goes on as with "square_root", with the event `escalated`.
            "square_root" carries factors from the start, by orthogonal transformations: up to 1e24. `covs` are products
            of the factors; screening, noise estimation and smoothing work on these products, in their plain form.
        steps: predict in so many equal steps. Of consequence with sigma points and adapted noise.
        horizon: longest `lead`, seconds.
        strict: the first event of a run (a rejected component, a restart, an escalation) raises `StrictError`.
        kappa: spread of the points, n + kappa > 0; the centre weighs kappa/(n + kappa).
        alpha: the scaled form, of spread alpha² (n + kappa), where given.
        beta: with alpha: 2 (where not given) is best for Gaussians.
        redraw: draw points again for the measurement. False is the helmet paper as printed: innovation covariance and
            gain then lack the motion noise of the last prediction step, and the filter is less sure than it could be.

    Raises:
        ParameterError: n + kappa is not positive; beta without alpha; or form="square_root" with redraw=False or with
            weights whose covariances are not sums of squares (a negative kappa).
        DimensionError: the sensor does not fit the motion.

    Reference:
        Julier, Uhlmann (2004), Proc. IEEE 92(3); Sun, Zhang (2015), spec labels H3 to H16.

    Example:
        >>> import numpy as np, trackrs as tr
        >>> motion = tr.ConstantVelocity(dims=2, accel_psd=0.1)
        >>> ukf = tr.UnscentedKalmanFilter(motion, tr.RangeBearing((0, 0), range_std=1.0, bearing_std=0.01))
        >>> start = tr.GaussianState([30.0, 40.0, 1.0, 0.0], np.diag([9.0, 9.0, 1.0, 1.0]))
        >>> run = ukf.run([1.0, 2.0], [[51.0, 0.91], [51.5, 0.89]], initial=start, lead=0.5)
        >>> run.lead_times
        array([1.5, 2.5])
    """

    kappa: float = 0.0
    alpha: float | None = None
    beta: float | None = None
    redraw: bool = True

    def __post_init__(self) -> None:
        """Build the filter."""
        if self.alpha is None and self.beta is not None:
            msg = f"beta = {self.beta} is invalid: belongs to the scaled form, give alpha too"
            raise ParameterError(msg)
        beta = 2.0 if self.beta is None else self.beta
        scale = None if self.alpha is None else (self.alpha, beta)
        models = self.motion._core, self.sensor._core
        self._keep(_trackrs.Filter.sigma_points(*models, self.kappa, scale, self.redraw))

    @classmethod
    def as_printed(
        cls,
        motion: Motion,
        sensor: Sensor,
        *,
        r_limits: tuple[float, float],
        q_floor_psd: float = 0.0,
        kappa: float = 0.0,
    ) -> UnscentedKalmanFilter:
        """Return the filter that the helmet paper prints, for comparison: do not use it to predict.

        Two half steps with the whole Q in each, points not drawn again for the measurement, R and Q from all residuals
        by (17) to (20). R has the wrong sign: it falls to its lower limit, about which the paper says nothing, and the
        estimate becomes the measurement.
        """
        rule = ResidualNoise(r_limits=r_limits, r="paper", q="paper", q_floor_psd=q_floor_psd)
        return cls(motion, sensor, adapt=rule, steps=2, kappa=kappa, redraw=False)


@dataclass(frozen=True, slots=True)
class CubatureKalmanFilter(_SequenceFilter):
    """The cubature Kalman filter: `UnscentedKalmanFilter` with kappa = 0, 2n points of equal weight.

    Args:
        motion: for example `ConstantVelocity` or `CustomMotion`.
        sensor: for example `RangeBearing` or `CustomSensor`.
        adapt: estimate the noise while `run` goes on.
        screen: reject gross errors in `run`.
        form: "joseph" carries covariances as they are, which keeps them definite up to a condition of 1e14; where one
            comes close to being singular the run goes on as with "square_root", with the event `escalated`.
            "square_root" carries factors from the start, by orthogonal transformations: up to 1e24. `covs` are products
            of the factors; screening, noise estimation and smoothing work on these products, in their plain form.
        steps: predict in so many equal steps. Of consequence with sigma points and adapted noise.
        horizon: longest `lead`, seconds.
        strict: the first event of a run (a rejected component, a restart, an escalation) raises `StrictError`.

    Raises:
        DimensionError: the sensor does not fit the motion.

    Reference:
        Arasaratnam, Haykin (2009), IEEE Trans. AC 54(6).
    """

    def __post_init__(self) -> None:
        """Build the filter."""
        self._keep(_trackrs.Filter.sigma_points(self.motion._core, self.sensor._core, 0.0, None, redraw=True))


def _lead(lead: Lead) -> float | list[float] | str | None:
    if lead is None or isinstance(lead, str):
        return lead
    if np.ndim(lead) == 0:
        return float(lead)  # type: ignore[arg-type]
    return [float(seconds) for seconds in array(lead, "lead", 1)]
