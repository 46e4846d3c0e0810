"""How far ahead a filter can be trusted, and the motion noise that serves it best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from trackrs._arrays import FloatArray, array, frozen
from trackrs.errors import DimensionError, ParameterError
from trackrs.motion import ConstantAcceleration
from trackrs.rotation import between, turned

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike

    from trackrs.filter import CubatureKalmanFilter, ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter
    from trackrs.types import GaussianState

    AnyFilter: TypeAlias = KalmanFilter | ExtendedKalmanFilter | UnscentedKalmanFilter | CubatureKalmanFilter


@dataclass(frozen=True, slots=True, eq=False)
class LeadCurve:
    """Error of predictions against how far ahead they are.

    Attributes:
        leads: (L,) seconds.
        rms, median, p95: (L, m) of the absolute error of every component of the measurement, in its units.
        counts: (L,) predictions compared.
    """

    leads: FloatArray
    rms: FloatArray
    median: FloatArray
    p95: FloatArray
    counts: FloatArray


def lead_curve(
    filter: AnyFilter,  # noqa: A002
    times: ArrayLike,
    values: ArrayLike,
    leads: Sequence[float],
    *,
    initial: GaussianState | None = None,
    truth: tuple[ArrayLike, ArrayLike] | None = None,
    skip: int = 0,
) -> LeadCurve:
    """Return the error of a filter's predictions for each of `leads`.

    Every prediction, made from the measurements up to its own, is compared with the truth at its time, in components
    of the measurement; of attitudes, in turns about the body's axes.

    Args:
        filter: any filter of one target.
        times: (T,) seconds.
        values: (T, m) measurements, as for `run`.
        leads: seconds.
        initial: as for `run`.
        truth: times (K,) and values (K, m) in place of the recording. Between samples they are joined by straight
            lines, angles and attitudes the shorter way; predictions beyond the last sample do not count.
        skip: leave out the first so many rows.

    Raises:
        ParameterError: a lead is negative or beyond the filter's horizon.
        DimensionError: the truth does not fit the measurements.
    """
    measurements, rotation = filter.sensor.measurements, filter.sensor._core.rotation
    t, z = array(times, "times", 1), measurements(values)
    when, what = (t, z) if truth is None else (array(truth[0], "truth times", 1), measurements(truth[1]))
    if what.shape != (len(when), z.shape[1]):
        msg = f"truth has shape {what.shape}, expected ({len(when)}, {z.shape[1]})"
        raise DimensionError(msg)
    circular = list(filter.sensor.angles)
    columns = [_joined(when, what[:, i], turning=i in circular) for i in range(z.shape[1])]
    turns = slice(0, 0) if rotation is None else slice(rotation, rotation + 3)
    rows = []
    for lead in leads:
        run = filter.run(t, values, initial=initial, lead=float(lead), history="filtered")
        usable = (run.lead_times >= when[0]) & (run.lead_times <= when[-1]) & (np.arange(len(t)) >= skip)
        expected = np.array([filter.sensor.observe(mean) for mean in run.lead_means[usable]]).reshape(-1, z.shape[1])
        error = expected - np.stack([column(run.lead_times[usable]) for column in columns], axis=1)
        error[:, circular] = np.angle(np.exp(1j * error[:, circular]))
        if rotation is not None:
            there = _joined_attitudes(when, what[:, turns], run.lead_times[usable])
            error[:, turns] = between(there, expected[:, turns])
        rows.append(np.abs(error[~np.isnan(error).all(axis=1)]))
    empty = np.full((1, z.shape[1]), np.nan)
    filled = [row if len(row) else empty for row in rows]
    return LeadCurve(
        leads=frozen(np.array(leads, dtype=np.float64)),
        rms=frozen(np.array([np.sqrt(np.nanmean(row**2, axis=0)) for row in filled])),
        median=frozen(np.array([np.nanmedian(row, axis=0) for row in filled])),
        p95=frozen(np.array([np.nanpercentile(row, 95, axis=0) for row in filled])),
        counts=frozen(np.array([len(row) for row in rows])),
    )


def _joined_attitudes(times: FloatArray, vectors: FloatArray, at: FloatArray) -> FloatArray:
    known = ~np.isnan(vectors).any(axis=1)
    when, what = times[known], vectors[known]
    left = np.clip(np.searchsorted(when, at, side="right") - 1, 0, max(len(when) - 2, 0))
    right = np.minimum(left + 1, len(when) - 1)
    span = when[right] - when[left]
    share = np.divide(at - when[left], span, out=np.zeros_like(span), where=span > 0)
    return turned(what[left], between(what[left], what[right]) * share[:, np.newaxis])


def _joined(times: FloatArray, values: FloatArray, *, turning: bool) -> Callable[[FloatArray], FloatArray]:
    known = ~np.isnan(values)
    line = np.unwrap(values[known]) if turning else values[known]
    return lambda at: np.interp(at, times[known], line)


@dataclass(frozen=True, slots=True)
class JerkChoice:
    """A density of white jerk and what to expect of it.

    Attributes:
        psd: the density, for `jerk_psd=`.
        prediction_rms: error of the prediction for the motion that it was chosen for, in the units of the amplitude.
    """

    psd: float
    prediction_rms: float


def choose_jerk_psd(
    *, amplitude: float, frequency: float, period: float, std: float, lead: float | None = None
) -> JerkChoice:
    """Return the density of white jerk that predicts a sinusoid with the least error.

    The fastest motion to be followed decides: slower ones are then followed with less error. The error is that of the
    filter in its steady state: how far its response at `frequency` is from a shift by `lead`, and the noise it passes.

    Args:
        amplitude: of the fastest motion, metres or radians.
        frequency: hertz.
        period: time between measurements, seconds.
        std: standard deviation of the measurement.
        lead: how far ahead, seconds. None: half a period.

    Raises:
        ParameterError: an argument is not positive, or `frequency` is above half the rate of the measurements.

    Example:
        >>> import trackrs as tr
        >>> choice = tr.choose_jerk_psd(amplitude=5.0, frequency=1.3, period=0.05, std=0.0724)
        >>> 1e5 < choice.psd < 1e6, choice.prediction_rms < 0.2
        (True, True)
    """
    ahead = 0.5 * period if lead is None else lead
    given = {"amplitude": amplitude, "frequency": frequency, "period": period, "std": std}
    for name, value in given.items():
        if not (value > 0.0 and np.isfinite(value)):
            msg = f"{name} = {value} is invalid: must be finite and positive"
            raise ParameterError(msg)
    if not ahead >= 0.0:
        msg = f"lead = {ahead} is invalid: must not be negative"
        raise ParameterError(msg)
    if frequency * period >= 0.5:
        msg = f"frequency = {frequency} is invalid: must be below half the rate of {1.0 / period} Hz"
        raise ParameterError(msg)

    def loss(log_psd: float) -> float:
        return _sinusoid_error(np.exp(log_psd), amplitude, frequency, period, std, ahead)

    # From noise that moves a prediction by a thousandth of the measurement's to a filter that follows everything.
    scale = np.log(20.0 * (std**2) / period**5)
    best = _least(loss, scale - 25.0, scale + 25.0)
    return JerkChoice(psd=float(np.exp(best)), prediction_rms=loss(best))


def _sinusoid_error(psd: float, amplitude: float, frequency: float, period: float, std: float, lead: float) -> float:
    motion = ConstantAcceleration(dims=1, jerk_psd=psd)
    f, q, r = motion.transition(period), motion.noise(period), std**2
    # The steady state by doubling: each pass stands for twice as many steps.
    a, g, h = f.T, np.diag([1.0 / r, 0.0, 0.0]), q.copy()
    for _ in range(60):
        turned = np.linalg.solve(np.eye(3) + g @ h, np.column_stack([a, g]))
        step = a.T @ h @ turned[:, :3]
        g = g + a @ turned[:, 3:] @ a.T
        a = a @ turned[:, :3]
        h = h + step
        if np.abs(step).max() <= 1e-14 * np.abs(h).max():
            break
    gain = h[:, :1] / (h[0, 0] + r)
    closed = f - gain @ f[:1]
    row = motion.transition(lead)[:1]
    turn = np.exp(2j * np.pi * frequency * period)
    response = (row @ np.linalg.solve(np.eye(3) - closed / turn, gain))[0, 0]
    miss = np.exp(2j * np.pi * frequency * lead) - response
    passed, power = gain @ gain.T * r, closed
    for _ in range(60):
        step = power @ passed @ power.T
        passed, power = passed + step, power @ power
        if np.abs(step).max() <= 1e-14 * np.abs(passed).max():
            break
    noise = (row @ passed @ row.T)[0, 0]
    return float(np.sqrt(0.5 * amplitude**2 * np.abs(miss) ** 2 + noise))


def _least(loss: Callable[[float], float], low: float, high: float, count: int = 41) -> float:
    """Return where `loss` is least: the best of a grid, then golden section around it."""
    grid = np.linspace(low, high, count)
    best = int(np.nanargmin([loss(float(x)) for x in grid]))
    low, high = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, count - 1)])
    ratio = 0.5 * (np.sqrt(5.0) - 1.0)
    left, right = high - ratio * (high - low), low + ratio * (high - low)
    at_left, at_right = loss(left), loss(right)
    while high - low > 1e-4:
        if at_left < at_right:
            high, right, at_right = right, left, at_left
            left = high - ratio * (high - low)
            at_left = loss(left)
        else:
            low, left, at_left = left, right, at_right
            right = low + ratio * (high - low)
            at_right = loss(right)
    return 0.5 * (low + high)


@dataclass(frozen=True, slots=True)
class PsdFit:
    """The motion noise of most likelihood.

    Attributes:
        psd: density of the noisiest axis.
        interval: its 95 % interval, from the curvature of the log-likelihood in ln psd; infinite where that is flat.
        log_likelihood: of the recording, at `psd`.
        filter: the filter with this density.
    """

    psd: float
    interval: tuple[float, float]
    log_likelihood: float
    filter: Any


def fit_psd(
    filter: AnyFilter,  # noqa: A002
    times: ArrayLike,
    values: ArrayLike,
    *,
    initial: GaussianState | None = None,
    span: float = 1e6,
) -> PsdFit:
    """Return the density of the motion's noise that makes a recording most likely.

    A search over one number, the logarithm of the density; the axes keep their proportions. One run per trial.

    Args:
        filter: with a motion given by `velocity_psd=`, `accel_psd=` or `jerk_psd=`, and without `adapt`.
        times: (T,) seconds.
        values: (T, m).
        initial: as for `run`.
        span: the density is sought from the filter's own divided by this to it times this.

    Raises:
        ParameterError: the motion has no such density, it is zero, the filter adapts its noise, or the best density is
            at an end of the span.
    """
    names = [
        name for name in ("velocity_psd", "accel_psd", "jerk_psd") if getattr(filter.motion, name, None) is not None
    ]
    if not names or filter.adapt is not None:
        msg = "fit_psd needs a motion given by velocity_psd=, accel_psd= or jerk_psd=, and a filter without adapt"
        raise ParameterError(msg)
    own = np.asarray(getattr(filter.motion, names[0]), dtype=np.float64)
    largest = float(own.max())
    if largest <= 0.0 or not span > 1.0:
        msg = f"{names[0]} = {largest} with span = {span} is invalid: must be positive, and span above 1"
        raise ParameterError(msg)

    def scaled(log_ratio: float) -> AnyFilter:
        density = own * np.exp(log_ratio)
        given = float(density) if density.ndim == 0 else tuple(density.tolist())
        motion: Any = filter.motion
        changed: AnyFilter = filter.replace(motion=replace(motion, **{names[0]: given}))
        return changed

    def loss(log_ratio: float) -> float:
        return -scaled(log_ratio).run(times, values, initial=initial, history="last").log_likelihood

    end = float(np.log(span))
    best = _least(loss, -end, end)
    if abs(best) > end - 0.01:
        msg = f"{names[0]} = {largest * np.exp(best):.3g} is at an end of the span: begin nearer, or widen span"
        raise ParameterError(msg)
    # A parabola through three points a good part of a standard deviation apart.
    step = 0.2
    least = loss(best)
    curvature = (loss(best + step) - 2.0 * least + loss(best - step)) / step**2
    half = 1.96 / np.sqrt(curvature) if curvature > 0.0 else np.inf
    psd = largest * float(np.exp(best))
    return PsdFit(
        psd=psd,
        interval=(psd * float(np.exp(-half)), psd * float(np.exp(half))),
        log_likelihood=-least,
        filter=scaled(best),
    )
