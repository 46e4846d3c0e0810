"""What runs of filters give: estimates of every row, smoothed ones, and tests of them. All frozen, arrays read-only."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, freeze_columns, frozen, without_repeats
from trackrs.errors import DimensionError, ParameterError
from trackrs.types import GaussianState

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from trackrs.types import Event, Ledger


class Verdict(IntEnum):
    """What became of one component of a measurement."""

    MISSING = 0
    USED = 1
    REJECTED = 2


@dataclass(frozen=True, slots=True, eq=False)
class ChiSquareTests:
    """Chi-square tests, one per row. Without a degree of freedom statistic and p-value are NaN.

    Attributes:
        statistics: (T,) chi-square with `dof` degrees of freedom if the model is right; mean `dof`.
        dof: (T,) degrees of freedom.
        p_values: (T,) probability of a statistic at least as large.
    """

    statistics: FloatArray
    dof: IntArray
    p_values: FloatArray

    def __len__(self) -> int:
        """Return the number of tests."""
        return len(self.statistics)


@dataclass(frozen=True, slots=True, eq=False)
class Whiteness:
    """Correlations of innovations over time, and the test that all are zero.

    Attributes:
        autocorrelations: (lags, m) correlation of every component with itself k = 1, 2, ... measurements before; NaN
            where no two that far apart were observed.
        bands: (lags, m) half width of the band about zero that holds each of them with probability 0.95 if the
            innovations are white.
        statistic: portmanteau statistic over all lags and all pairs of components.
        dof: its degrees of freedom, lags · m² where all components were observed.
        p_value: probability of a larger statistic if the innovations are white; NaN without data.
    """

    autocorrelations: FloatArray
    bands: FloatArray
    statistic: float
    dof: int
    p_value: float


class _Estimates:
    """What estimates of a state give, one with an attitude or without."""

    __slots__ = ()

    means: FloatArray
    labels: tuple[str, ...]
    attitude: int | None

    @property
    def attitudes(self) -> FloatArray:
        """Unit quaternions w, x, y, z of the estimated attitudes (T, 4), w not negative.

        Raises:
            ParameterError: the state has no attitude.
        """
        if self.attitude is None:
            msg = f"the state {' '.join(self.labels)} has no attitude"
            raise ParameterError(msg)
        vectors = self.means[:, self.attitude : self.attitude + 3]
        return frozen(_trackrs.rotation_quaternions(array(vectors, "means", 2)))

    def errors(self, truth: ArrayLike) -> FloatArray:
        """Return estimates less truth (T, n), of attitudes the turns from truth to estimate: what `covs` are of.

        Args:
            truth: (T, n), attitudes as rotation vectors.

        Raises:
            DimensionError: the truth has another shape.
        """
        true = array(truth, "truth", 2)
        if true.shape != self.means.shape:
            msg = f"truth has shape {true.shape}, expected {self.means.shape}"
            raise DimensionError(msg)
        out = self.means - true
        if self.attitude is not None:
            at = slice(self.attitude, self.attitude + 3)
            out[:, at] = _trackrs.rotation_between(np.hstack([true[:, at], self.means[:, at]]))
        return frozen(out)


@dataclass(frozen=True, slots=True, eq=False)
class FilterRun(_Estimates):
    """Result of a filter over T measurements. With `history="last"` the sequences have length 1.

    Attributes:
        times: (T,) seconds.
        means, covs: estimates after each measurement, (T, n) and (T, n, n).
        predicted_means, predicted_covs: estimates before it; empty unless `history="full"`.
        transitions, motion_noises: F and Q of the step that leads to each time, (T, n, n) each, the first from the
            initial state; empty unless `history="full"`. Where all are the same they are views of one.
        innovations, innovation_covs: (T, m) and (T, m, m); NaN where not observed.
        nis: (T,), NaN where nothing was observed.
        dof: (T,) observed components.
        verdicts: (T, m) of `Verdict` numbers; empty without a screen.
        statistics, p_values: (T,) the chi-square test of each measurement before anything was rejected, with as many
            degrees of freedom as it has observed components; empty without a screen.
        q_hat, r_hat: (T, d, d) and (T, m, m) noise in force after each measurement; empty without `adapt`.
        restarts: rows at which the filter started anew, after a lock-out or a long gap.
        events: what happened on the way, the last 1000, oldest first: `screened` (components rejected), `restarted`,
            `held` (measurements wait, because the prediction is too vague to use them by), `not_started` (rows before
            the start gave none), `escalated` (a covariance came close to being singular and is carried as its square
            root from that row on).
        event_counts: how many there were, by code.
        ledger: where every row went. A row without any component is booked as rejected, `not_observed`, and is no
            event; one whose components were all rejected as `screened`; rows held to the end as waiting.
        lead_times, lead_means, lead_covs: (T,) seconds, (T, n) and (T, n, n): the predictions ahead made after each
            measurement; empty without `lead`.
        log_likelihood: sum over all measurements.
        labels: names of the state's components.
        start: first row of the run with an estimate, counted in the times given to `run`: 0 where an initial state was
            given. Rows before it are NaN; row `start` holds the starting state, without innovation.
        attitude: index of the rotation vector in the state; None where it has none.
    """

    times: FloatArray
    means: FloatArray
    covs: FloatArray
    predicted_means: FloatArray
    predicted_covs: FloatArray
    transitions: FloatArray
    motion_noises: FloatArray
    innovations: FloatArray
    innovation_covs: FloatArray
    nis: FloatArray
    dof: IntArray
    verdicts: NDArray[np.int8]
    statistics: FloatArray
    p_values: FloatArray
    q_hat: FloatArray
    r_hat: FloatArray
    lead_times: FloatArray
    lead_means: FloatArray
    lead_covs: FloatArray
    restarts: tuple[int, ...]
    events: tuple[Event, ...]
    event_counts: Mapping[str, int]
    ledger: Ledger
    log_likelihood: float
    labels: tuple[str, ...]
    start: int = 0
    attitude: int | None = None

    def __len__(self) -> int:
        """Return the number of times kept."""
        return len(self.times)

    def __getitem__(self, index: int) -> GaussianState:
        """Return the estimate after measurement `index`."""
        return GaussianState(self.means[index], self.covs[index], self.times[index])

    def cumulative_test(self, window: int | None = 10) -> ChiSquareTests:
        """Test the sum of the NIS of the last `window` measurements at every time: the alarm that the model is wrong.

        Use both tests for what each can do. The single one (`screen=ChiSquareScreen()`) finds an isolated gross error,
        which a sum dilutes: a spike of 5 sigma in one range of a BATS array is found with 0.84 at once, with 0.48 in a
            sum of 10.
        The sum finds what adds up, a bias or a manoeuvre: a persistent bias of 3 sigma with 0.29 at once, with 0.79 in
            a
        sum of 10 (alpha = 0.01). Components that a screen rejected are not in it.

        Args:
            window: measurements with data in a sum, at least 1. None: all so far, as in the paper, which is slow to
                notice anything late in a run.

        Returns:
            The sums (T,), fewer terms at the beginning and after a restart; a row without data repeats the one before.

        Raises:
            ParameterError: `window` is not a whole number of at least 1.

        Reference:
            Xi, Liu, Tao, Lu, eq. (15); spec label U23.

        Example:
            >>> import trackrs as tr
            >>> kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_psd=0.1), tr.PositionSensor(dims=1, std=1.0))
            >>> start = tr.GaussianState([0.0, 0.0], [[1.0, 0.0], [0.0, 4.0]])
            >>> run = kf.run([1.0, 2.0, 3.0, 4.0], [[1.1], [1.9], [3.2], [90.0]], initial=start)
            >>> run.cumulative_test(window=3).p_values < 1e-3
            array([False, False, False,  True])
        """
        out = _trackrs.cumulative(self.nis, self.dof, self.restarts, _whole(window, "window", "or None for all"))
        return ChiSquareTests(**freeze_columns(out))

    def whiteness(self, lags: int = 10) -> Whiteness:
        """Test whether the innovations are uncorrelated over time, as they are where model and noise are right.

        See `trackrs.whiteness`. The measurements before and at the start take no part, nor those at restarts, nor
        components that a screen rejected.

        Args:
            lags: largest distance of two measurements, at least 1, below their number.

        Raises:
            ParameterError: `lags` is out of range.
        """
        innovations = self.innovations.copy()
        innovations[list(self.restarts)] = np.nan
        out = _trackrs.whiteness(
            array(innovations[self.start :], "innovations", 2),
            array(self.innovation_covs[self.start :], "covs", 3),
            _whole(lags, "lags") or 0,
        )
        return Whiteness(**freeze_columns(out))

    def smooth(self, lag: int | None = None) -> SmoothedRun:
        """Estimate every state from the measurements after it as well (Rauch-Tung-Striebel).

        Exact for linear models. After an extended filter it smooths the model as it was linearised there.

        Args:
            lag: number of measurements. Each estimate uses the measurements up to that many after its own, as it would
                where results may be late by `lag` measurements but no more. None: all of the run.

        Raises:
            ParameterError: the run was made without `history="full"`, or `lag` is not a whole number of at least 1.
            NotPositiveDefiniteError: a predicted covariance is singular, so that the smoother gain is not defined.
                Where nothing moves and no noise enters, as between two measurements at one time, it does not matter.

        Reference:
            Rauch, Tung, Striebel (1965), AIAA Journal 3(8); equations U14 to U16 of the underwater paper by Xi, Liu,
            Tao, Lu.

        Example:
            >>> import trackrs as tr
            >>> kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_psd=0.1), tr.PositionSensor(dims=1, std=1.0))
            >>> start = tr.GaussianState([0.0, 0.0], [[1.0, 0.0], [0.0, 4.0]])
            >>> run = kf.run([1.0, 2.0, 3.0], [[1.1], [1.9], [3.2]], initial=start)
            >>> smoothed = run.smooth()
            >>> bool((smoothed[0].std < run[0].std).all())
            True
        """
        if len(self.predicted_means) != len(self.means):
            msg = (
                'smoothing needs a run with history="full": this one kept only filtered estimates; '
                'run the filter with history="full"'
            )
            raise ParameterError(msg)
        try:
            steps = None if lag is None else operator.index(lag)
        except TypeError:
            steps = 0
        if steps is not None and steps < 1:
            msg = f"lag = {lag!r} is invalid: must be a whole number of measurements, at least 1, or None for all"
            raise ParameterError(msg)
        # A run that starts itself is smoothed from its first state on, which has no prediction: it stands for its own.
        begin = self.start
        predicted_means, predicted_covs = self.predicted_means[begin:], self.predicted_covs[begin:]
        if begin > 0:
            predicted_means = np.concatenate([self.means[begin : begin + 1], predicted_means[1:]])
            predicted_covs = np.concatenate([self.covs[begin : begin + 1], predicted_covs[1:]])
        # More than the run has is all of it; the bound keeps the number within the core's integers.
        steps = None if steps is None else min(steps, max(len(self), 1))
        out = _trackrs.smooth(
            array(self.means[begin:], "means", 2),
            array(self.covs[begin:], "covs", 3),
            array(predicted_means, "predicted_means", 2),
            array(predicted_covs, "predicted_covs", 3),
            array(without_repeats(self.transitions[begin:]), "transitions", 3),
            array(without_repeats(self.motion_noises[begin:]), "motion_noises", 3),
            steps,
            self.attitude,
        )
        out = {name: np.concatenate([np.full((begin, *part.shape[1:]), np.nan), part]) for name, part in out.items()}
        names: dict[str, Any] = {"labels": self.labels, "attitude": self.attitude}
        return SmoothedRun(times=self.times, lag=lag, **names, **freeze_columns(out))


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedRun(_Estimates):
    """Estimates of T states given measurements before and after them.

    Attributes:
        times: (T,) seconds.
        means, covs: the estimates, (T, n) and (T, n, n), in the units of the state; NaN before the start of the run.
        lag_one_covs: (T-1, n, n); element i is the covariance of state i+1 (rows) with state i (columns), given the
            measurements that estimate i uses.
        lag: how many measurements after its own each estimate uses; None: all.
        labels: names of the state's components.
        attitude: index of the rotation vector in the state; None where it has none.
    """

    times: FloatArray
    means: FloatArray
    covs: FloatArray
    lag_one_covs: FloatArray
    lag: int | None
    labels: tuple[str, ...]
    attitude: int | None = None

    def __len__(self) -> int:
        """Return the number of times."""
        return len(self.times)

    def __getitem__(self, index: int) -> GaussianState:
        """Return the estimate at time `index`."""
        return GaussianState(self.means[index], self.covs[index], self.times[index])


def _whole(value: int | None, name: str, otherwise: str = "") -> int | None:
    """Return a count for the core."""
    try:
        number = None if value is None else operator.index(value)
    except TypeError:
        number = 0
    if number is not None and number < 1:
        msg = f"{name} = {value!r} is invalid: must be a whole number of at least 1 {otherwise}".rstrip()
        raise ParameterError(msg)
    # More than a run can have is all of it; the bound keeps the number within the core's integers.
    return None if number is None else min(number, 2**62)
