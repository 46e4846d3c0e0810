"""Records that go in and come out: states, scans, updates, runs, tracks. All are frozen; their arrays are read-only."""

from __future__ import annotations

import operator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, frozen, frozen_array, without_repeats
from trackrs.errors import DimensionError, ParameterError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import ArrayLike, NDArray


class Verdict(IntEnum):
    """What became of one component of a measurement."""

    MISSING = 0
    USED = 1
    REJECTED = 2


@dataclass(frozen=True, slots=True, eq=False)
class GaussianState:
    """A Gaussian estimate of a state at one time.

    Args:
        mean: state vector (n,), block order: positions, velocities, accelerations; SI units.
        cov: its covariance (n, n).
        time: when it holds, seconds.

    Raises:
        DimensionError: the shapes do not agree.

    Example:
        >>> import trackrs as tr
        >>> tr.GaussianState([0.0, 1.0], [[4.0, 0.0], [0.0, 1.0]]).std
        array([2., 1.])
    """

    mean: FloatArray
    cov: FloatArray
    time: float = 0.0

    def __init__(self, mean: ArrayLike, cov: ArrayLike, time: float = 0.0) -> None:
        """Check the shapes and copy the arrays."""
        object.__setattr__(self, "mean", frozen_array(mean, "mean", 1))
        object.__setattr__(self, "cov", frozen_array(cov, "cov", 2))
        object.__setattr__(self, "time", float(time))
        n = self.mean.shape[0]
        if self.cov.shape != (n, n):
            msg = f"cov has shape {self.cov.shape}, the mean of length {n} needs ({n}, {n})"
            raise DimensionError(msg)

    @property
    def std(self) -> FloatArray:
        """Standard deviation of every component (n,)."""
        return np.sqrt(np.diagonal(self.cov))


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Everything one sensor reports in one look.

    Args:
        time: seconds; where reports have times of their own, that of the last or later.
        values: reports (k, m); k = 0 is an empty scan: the sensor looked and saw nothing. NaN = component not observed.
        sensor: name of the sensor, as the tracker knows it.
        platform: position of the moving body that carries the sensor (d,), if it moves.
        times: when each report was taken (k,), where that differs; none later than `time`. Tracks are updated at these
            times. A report before the tracker's time, or after `time`, is dropped with an event.

    Raises:
        DimensionError: `values` is not two-dimensional, or `times` not of its length.

    Example:
        >>> import trackrs as tr
        >>> len(tr.Scan(9.0, [[1e3, 0.2], [2e3, 0.1]], sensor="radar", times=[3.0, 6.0]))
        2
    """

    time: float
    values: FloatArray
    sensor: str
    platform: FloatArray | None = None
    times: FloatArray | None = None

    def __init__(
        self,
        time: float,
        values: ArrayLike,
        sensor: str,
        platform: ArrayLike | None = None,
        times: ArrayLike | None = None,
    ) -> None:
        """Copy the arrays."""
        rows = np.zeros((0, 0)) if np.size(values) == 0 else values
        object.__setattr__(self, "time", float(time))
        object.__setattr__(self, "values", frozen_array(rows, "values", 2))
        object.__setattr__(self, "sensor", str(sensor))
        object.__setattr__(self, "platform", None if platform is None else frozen_array(platform, "platform", 1))
        object.__setattr__(self, "times", None if times is None else frozen_array(times, "times", 1))
        if self.times is not None and len(self.times) != len(self.values):
            msg = f"times has length {len(self.times)}, values has {len(self.values)} rows"
            raise DimensionError(msg)

    def __len__(self) -> int:
        """Return the number of reports."""
        return len(self.values)


@dataclass(frozen=True, slots=True, eq=False)
class Update:
    """Result of one measurement update.

    Attributes:
        posterior: the estimate after the measurement.
        innovation: measured minus predicted (m,), angles wrapped; NaN where not observed.
        innovation_cov: its covariance S (m, m).
        whitened: L⁻¹ × innovation with S = L Lᵀ over the observed components (m,).
        nis: normalised innovation squared; chi-square with `dof` degrees of freedom if the model is right.
        dof: number of observed components.
        log_likelihood: ln N(innovation; 0, S).
    """

    posterior: GaussianState
    innovation: FloatArray
    innovation_cov: FloatArray
    whitened: FloatArray
    nis: float
    dof: int
    log_likelihood: float


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """A position from one measurement of a `RangeArray`.

    Attributes:
        position: (d,) metres.
        cov: its covariance (d, d).
        statistic: sum of squared residuals over their variances; chi-square with `dof` degrees of freedom.
        dof: observed components beyond the d that a position needs.
        p_value: probability of a larger statistic; 1 with `dof = 0`, where nothing can contradict.
        mirror: the other position (d,) that fits as well, where `side` had to choose; else None.
    """

    position: FloatArray
    cov: FloatArray
    statistic: float
    dof: int
    p_value: float
    mirror: FloatArray | None


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


class Health(IntEnum):
    """Whether a track is what its covariance says.

    The NIS of its last 10 updates is compared with bounds that a healthy track passes with a probability below 1e-8 per
    scan, the gate considered.

    Attributes:
        HEALTHY: nothing speaks against it.
        DEGRADED: its NIS is too large (a manoeuvre beyond the motion's noise, a bias, noise too small), or too small
            (noise too large).
        LOST: its NIS has been too large for more than 10 further updates; or more of the last 10 scans of every sensor
            that ever hit it gave no report than detection probability and gate allow.
    """

    HEALTHY = 0
    DEGRADED = 1
    LOST = 2


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A confirmed track at one time.

    Attributes:
        id: identity, unique within its tracker.
        state: the estimate.
        last_hit: time of the last report given to the track, seconds.
        hits: reports given to it so far.
        existence: probability that there is a target, where the tracker keeps it (`JIPDA`), else None.
        extent: covariance of the target's points about its centre (d, d), where the tracker learns it, else None.
        health: whether it is what its covariance says, where the tracker tests that, else None.
    """

    id: int
    state: GaussianState
    last_hit: float
    hits: int
    existence: float | None = None
    extent: FloatArray | None = None
    health: Health | None = None

    @property
    def coasting(self) -> bool:
        """Whether the estimate is a prediction only."""
        return self.last_hit < self.state.time


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Confirmed tracks over the scans of a run: one row per track and scan, in the order of the scans.

    Attributes:
        scan_times: (S,) time of every scan, also of those without a track.
        sensors: (S,) their sensors.
        times, ids: (N,) time and identity of every row.
        means, covs: (N, n) and (N, n, n).
        last_hits: (N,) time of the last report given to the track.
        hits: (N,) reports given to it so far.
        labels: names of the state's components.
        existences: (N,) probability that there is a target, where the tracker keeps it, else None.
        extents: (N, d, d) covariance of the target's points about its centre in the measured coordinates, where the
            tracker learns it, else None. A filled ellipse has whole axes of four times the roots of its eigenvalues.
        expected_targets: (S,) expected number of targets after every scan, where the tracker keeps it, else None: the
            sum of the weights of an intensity, confirmed or not.
        healths: (N,) numbers of `Health`, where the tracker tests that, else None.
    """

    scan_times: FloatArray
    sensors: tuple[str, ...]
    times: FloatArray
    ids: NDArray[np.uint64]
    means: FloatArray
    covs: FloatArray
    last_hits: FloatArray
    hits: NDArray[np.uint64]
    labels: tuple[str, ...]
    offsets: IntArray = field(repr=False)
    existences: FloatArray | None = None
    extents: FloatArray | None = None
    expected_targets: FloatArray | None = None
    healths: NDArray[np.int8] | None = None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.times)

    def __iter__(self) -> Iterator[Track]:
        """Iterate over the rows as `Track` records."""
        return (self._track(i) for i in range(len(self)))

    def _track(self, row: int) -> Track:
        state = GaussianState(self.means[row], self.covs[row], self.times[row])
        existence = None if self.existences is None else float(self.existences[row])
        extent = None if self.extents is None else self.extents[row]
        health = None if self.healths is None else Health(int(self.healths[row]))
        hits = int(self.hits[row])
        return Track(int(self.ids[row]), state, float(self.last_hits[row]), hits, existence, extent, health)

    def at(self, time: float) -> list[Track]:
        """Return the tracks after the last scan at or before `time`; none before the first scan."""
        scan = int(np.searchsorted(self.scan_times, time, side="right")) - 1
        return [] if scan < 0 else self.of_scan(scan)

    def of_scan(self, scan: int) -> list[Track]:
        """Return the tracks after scan number `scan`."""
        return [self._track(row) for row in range(int(self.offsets[scan]), int(self.offsets[scan + 1]))]

    @property
    def history(self) -> dict[int, list[Track]]:
        """Every track's estimates in the order of time, by id."""
        return {
            int(i): [self._track(row) for row in np.flatnonzero(self.ids == i).tolist()] for i in np.unique(self.ids)
        }

    def to_table(self) -> dict[str, NDArray[Any]]:
        """Return a tidy table as a dictionary of columns, one row per track and scan.

        Columns: `time`, `sensor`, `track`, one per state component, `last_hit`, `hits`, `existence` and `health` (in
        words) where they are kept, one `cov_a_b` per element of the covariance's lower triangle, and `extent_1_1`,
        `extent_2_1`, ... likewise where extents are kept. `pandas.DataFrame(table)`, `polars.DataFrame(table)` and
        `pyarrow.table(table)` take it.
        """
        rows_per_scan = np.diff(self.offsets)
        table: dict[str, NDArray[Any]] = {
            "time": self.times,
            "sensor": np.repeat(np.array(self.sensors, dtype=np.str_), rows_per_scan),
            "track": self.ids,
        }
        table |= {label: self.means[:, i] for i, label in enumerate(self.labels)}
        table |= {"last_hit": self.last_hits, "hits": self.hits}
        if self.existences is not None:
            table["existence"] = self.existences
        if self.healths is not None:
            table["health"] = np.array([health.name.lower() for health in Health])[self.healths]
        for i, a in enumerate(self.labels):
            for j, b in enumerate(self.labels[: i + 1]):
                table[f"cov_{a}_{b}"] = self.covs[:, i, j]
        if self.extents is not None:
            for i in range(self.extents.shape[1]):
                for j in range(i + 1):
                    table[f"extent_{i + 1}_{j + 1}"] = self.extents[:, i, j]
        return table


@dataclass(frozen=True, slots=True)
class Event:
    """Something a tracker or a filter refused, repaired or received late.

    Attributes:
        code: what happened, for example `late_scan`, `non_finite`, `duplicate`, `track_skipped`.
        time: time of the scan or row, seconds.
        sensor: its sensor; empty in the run of a filter.
        row: row of the scan or run, where the event is about one row.
        reason: in words.
    """

    code: str
    time: float
    sensor: str
    row: int | None
    reason: str


@dataclass(frozen=True, slots=True)
class Ledger:
    """Where every row went: `rows_in == used + late + duplicate + waiting + sum(rejected.values())`, always.

    Attributes:
        rows_in: rows received.
        used: rows that took part in tracking.
        late: rows older than the tracker's time, or of scans that are.
        duplicate: rows received before.
        rejected: rows dropped for another reason, by event code.
        waiting: rows of scans that wait for earlier ones, with `late=Reorder(...)`.
    """

    rows_in: int
    used: int
    late: int
    duplicate: int
    rejected: Mapping[str, int]
    waiting: int = 0


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


def freeze_columns(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Make every array of a result read-only."""
    return {key: frozen(value) if isinstance(value, np.ndarray) else value for key, value in columns.items()}
