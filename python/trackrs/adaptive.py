"""What makes a filter robust and adaptive: screening of gross errors and estimation of the noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from trackrs.errors import ParameterError

if TYPE_CHECKING:
    from trackrs import _trackrs


@dataclass(frozen=True, slots=True)
class ChiSquareScreen:
    """Rejects gross errors by a chi-square test of the innovation before they are used.

    After three measurements in a row whose rejections left no more components than the position has coordinates, a
    filter whose sensor can fix positions starts anew from their fixes, if these pass their own test. Where single
    measurements cannot fix a position it does so while at least every second one is rejected.

    After a gap so long that the position is uncertain by more than twice the range across it, ranges are held
    (`MISSING`) until together they give a start; the lasting errors of the sensor enter it as they are known.

    Args:
        alpha: probability of rejecting a measurement that is right, in (0, 1).
        mode: which components a failed test rejects: "snoop" drops the worst one until the rest passes (Baarda),
            "component" tests each by itself, "vector" rejects all (the paper).
        allowance: position variance that a manoeuvre may add, m², in the test only. None: for a `RangeArray` four times
            the mean variance of its ranges; for other sensors 0.
        restart: start anew after a lock-out.

    Reference:
        Xi, Liu, Tao, Lu, "Tracking submarine moving target with the adaptive estimation methodology", eqs. (13), (14);
        spec labels U20 to U28. The allowance and the restart are not in the paper.

    Example:
        >>> import numpy as np, trackrs as tr
        >>> motion = tr.RandomWalk(dims=2, velocity_psd=0.1)
        >>> kf = tr.KalmanFilter(motion, tr.PositionSensor(dims=2, std=1.0), screen=tr.ChiSquareScreen())
        >>> start = tr.GaussianState([0.0, 0.0], np.eye(2))
        >>> run = kf.run([1.0, 2.0], [[0.3, -0.2], [0.1, 50.0]], initial=start)
        >>> [[tr.Verdict(v).name for v in row] for row in run.verdicts]
        [['USED', 'USED'], ['USED', 'REJECTED']]
    """

    alpha: float = 0.01
    mode: Literal["snoop", "component", "vector"] = "snoop"
    allowance: float | None = None
    restart: bool = True

    @classmethod
    def as_printed(cls, alpha: float = 0.01) -> ChiSquareScreen:
        """Return the paper's test: the whole measurement, no allowance, no restart.

        A turn is a gross error to it: at alpha = 0.01 it loses nine in ten runs of a manoeuvring target on three
        hydrophones without any gross error.
        """
        return cls(alpha, mode="vector", allowance=0.0, restart=False)


@dataclass(frozen=True, slots=True)
class LimitedMemoryNoise:
    """Estimates the motion and sensor noise from the smoothed states of the last measurements.

    The models' own noise is what the filter begins with. Rejected measurements take no part, and steps of no time say
    nothing about the motion noise.

    Args:
        window: measurements in the memory, at least 1.
        r_window: the same for the sensor noise; None for as many.
        method: "em" adds the covariances of the smoothed states; "map" is the paper's, which shrinks the motion noise
            to its lower limit and loses a manoeuvring target.
        q_form: "input" estimates what drives the motion, d x d: the covariance of a noise constant over a step
            (`accel_std=`, `jerk_std=`) or the spectral density (`accel_psd=`, `jerk_psd=`); of a `LinearMotion`, Q.
            "full" estimates the whole covariance of a step, n x n, as the paper prints it; the time steps must be
            equal.
        r_form: "diagonal", each variance averaged over the measurements that used its component, or "full", from the
            measurements that used all components, once there are m of them.
        first_epoch: the estimates are used from this measurement on.
        q_limits: lowest and highest eigenvalue of Q: (m/s²)² or (m/s³)² or the density, as the motion's noise.
        r_limits: lowest and highest eigenvalue of R, or variance where R is diagonal.

    Reference:
        Xi, Liu, Tao, Lu, "Tracking submarine moving target with the adaptive estimation methodology", eqs. (8) to (11);
        spec labels U13 to U19.
    """

    window: int = 20
    method: Literal["em", "map"] = "em"
    first_epoch: int = 10
    q_limits: tuple[float, float] = (1e-6, 1e2)
    r_limits: tuple[float, float] = (1e-2, 1e4)
    q_form: Literal["input", "full"] = "input"
    r_form: Literal["diagonal", "full"] = "diagonal"
    r_window: int | None = None

    @classmethod
    def as_printed(cls, window: int) -> LimitedMemoryNoise:
        """Return the estimator that the paper prints: (10), (11) with full Q and R, used from the first measurement on.

        It loses a manoeuvring target, because its optimum is Q = 0. The paper limits each element of Q and R, (8), (9),
        which does not keep them positive semidefinite: here the limits are those of the eigenvalues.
        """
        return cls(window, method="map", first_epoch=1, q_form="full", r_form="full")

    def _apply(self, core: _trackrs.Filter) -> _trackrs.Filter:
        forms = (self.q_form, self.r_form)
        limits = (self.q_limits, self.r_limits)
        return core.with_adaptation(self.window, self.r_window, self.method, forms, self.first_epoch, *limits)


@dataclass(frozen=True, slots=True)
class ResidualNoise:
    """Estimates the noise from the residuals of the measurements so far, as the helmet paper does and as it should.

    For comparison with the paper: a fixed density chosen for the fastest motion (`choose_jerk_psd`, `fit_psd`), or
    `NisScaledNoise`, predicts better.

    Args:
        r_limits: lowest and highest eigenvalue of R.
        memory: "cumulative" (the paper), the last `window` measurements, or "fading" by the factor `fading`.
        window: measurements, with memory="window".
        fading: in (0, 1), with memory="fading".
        r: "resid", the residuals after the update plus the covariance that they lack; "innov", the innovations less
            theirs; "paper", with the wrong sign, so that R falls to its limit.
        q: None keeps the motion's own; "paper" is K C Kᵀ of the residuals, "innovation" of the innovations. Both are
            added once per prediction step whatever its length, and shrink with the gains that they make.
        q_floor_psd: density of white noise added to that Q on every axis.
        diagonal: keep R diagonal; then measurements with missing components count too.
        first_epoch: the estimates are used from this measurement on.

    Raises:
        ParameterError: a parameter out of its domain, when the filter is built.

    Reference:
        Sun, Zhang (2015), eqs. (17) to (20); Mohamed, Schwarz (1999); spec labels H17 to H20.
    """

    r_limits: tuple[float, float]
    memory: Literal["cumulative", "window", "fading"] = "cumulative"
    window: int | None = None
    fading: float | None = None
    r: Literal["paper", "resid", "innov"] = "resid"
    q: Literal["paper", "innovation"] | None = None
    q_floor_psd: float = 0.0
    diagonal: bool = False
    first_epoch: int = 2

    def _apply(self, core: _trackrs.Filter) -> _trackrs.Filter:
        parameters = {"window": self.window, "fading": self.fading}
        for name, value in parameters.items():
            if (value is None) == (self.memory == name):
                needs = "is missing for" if value is None else "does not belong to"
                msg = f'{name} {needs} memory="{self.memory}"'
                raise ParameterError(msg)
        memory = (self.memory, self.window or 0, self.fading or 0.0)
        forms = (self.r, self.q, self.r_limits, self.q_floor_psd)
        return core.with_residual_noise(memory, *forms, self.diagonal, self.first_epoch)


@dataclass(frozen=True, slots=True)
class NisScaledNoise:
    """Scales the motion noise so that the innovations have the size that the filter expects.

    After every measurement ln q <- ln q + eta (min(nis/m, cap) - 1), within its limits. For stationary motion it finds
    the best density. The sensor's noise should be right within a factor of 4; if it is much too large, q falls asleep.

    Args:
        psd_limits: lowest and highest density of the motion's noisiest axis, in its units (m²/s⁵ or rad²/s⁵ for
            `jerk_psd=`); the others keep their proportion. The lowest should follow a start from rest: for heads 0.3
            rad²/s⁵.
        eta: rate; above 0.1 it sinks too far during rest.
        cap: largest nis/m that counts.

    Raises:
        ParameterError: a parameter out of its domain, or a motion without such noise, when the filter is built.

    Reference:
        Spec label H24; not in the paper.
    """

    psd_limits: tuple[float, float]
    eta: float = 0.03
    cap: float = 20.0

    def _apply(self, core: _trackrs.Filter) -> _trackrs.Filter:
        return core.with_nis_noise(self.psd_limits, self.eta, self.cap)
