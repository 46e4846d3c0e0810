"""Records that go in and come out: states, scans, updates, tracks, events. All are frozen, their arrays read-only."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs._arrays import FloatArray, IntArray, frozen_array
from trackrs.errors import DimensionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import ArrayLike, NDArray


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
