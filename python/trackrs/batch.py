"""Many tracks at once, each with its own filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, frozen
from trackrs.errors import DimensionError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from trackrs.filter import _SequenceFilter


def simd_levels() -> tuple[str, ...]:
    """Return the levels of instructions of this machine, the best one first: what TRACKRS_SIMD may name."""
    return tuple(_trackrs.simd_levels())


@dataclass(frozen=True, slots=True, eq=False)
class BatchRun:
    """What many tracks give at T times.

    Attributes:
        times: (T,) seconds.
        labels: names of the n components of the state.
        means: (B, T, n) estimates after each measurement.
        covs: (B, T, n, n) their covariances, where they were asked for.
        nis: (B, T) normalised innovations squared, where they were asked for; NaN where nothing was observed.
        failures: (B,) measurements left out because an innovation covariance was not positive definite.
        escalated: (B,) whether the track's covariance came close to being singular and is carried as its square root.
    """

    times: FloatArray
    labels: tuple[str, ...]
    means: FloatArray
    covs: FloatArray | None
    nis: FloatArray | None
    failures: IntArray
    escalated: NDArray[np.bool_]


class TrackBatch:
    """Tracks that are filtered side by side and stay where they are computed; all are measured at the same times.

    Kalman filters (and extended ones) of `RandomWalk`, `ConstantVelocity` and `ConstantAcceleration`, up to three axes,
    with a `PositionSensor` or a `LinearSensor` of up to three components, without screen and noise estimation, run
    several tracks to a register of the processor, with the structure of the motion in place of products with its
    matrix: the results agree with `run` to rounding. All other filters, and linear sensors whose components are nearly
    one and the same, are run one track after the other. Either way the bits do not depend on the processor's
    instructions (the variable TRACKRS_SIMD of the environment chooses among `scalar`, `v3` and `v4`), on the number of
    threads, or on the other tracks.

    Args:
        filter: of every track.
        means: (B, n) where they begin.
        covs: (B, n, n) their covariances, or (n, n) one for all.
        time: of these, seconds.
        threads: at most so many; None for all processors.

    Raises:
        DimensionError: the shapes do not fit the filter.
        NotPositiveDefiniteError: a covariance is not positive definite.
        ParameterError: `threads` is below 1, or TRACKRS_SIMD names what this machine does not have.

    Example:
        >>> import numpy as np, trackrs as tr
        >>> kf = tr.KalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.1), tr.PositionSensor(dims=2, std=1.0))
        >>> batch = tr.TrackBatch(kf, means=np.zeros((1000, 4)), covs=100.0 * np.eye(4))
        >>> batch.step(1.0, np.ones((1000, 2)))
        >>> batch.means.shape, batch.time
        ((1000, 4), 1.0)
    """

    __slots__ = ("_core", "labels")

    def __init__(
        self,
        filter: _SequenceFilter,  # noqa: A002
        means: ArrayLike,
        covs: ArrayLike,
        time: float = 0.0,
        *,
        threads: int | None = None,
    ) -> None:
        """Copy the arrays."""
        self.labels = filter.labels
        n = len(self.labels)
        x = array(means, "means", 2)
        if x.shape[1] != n:
            msg = f"means must be (B, {n}), one row per track, got shape {x.shape}"
            raise DimensionError(msg)
        p = array(covs, "covs", np.ndim(covs))
        if p.shape not in {(n, n), (len(x), n, n)}:
            msg = f"covs must be ({n}, {n}) or ({len(x)}, {n}, {n}), got shape {p.shape}"
            raise DimensionError(msg)
        self._core = _trackrs.TrackBatch(filter._core, float(time), x, p.reshape(-1, n, n), threads)

    @property
    def time(self) -> float:
        """Of the tracks, seconds."""
        return self._core.time()

    @property
    def means(self) -> FloatArray:
        """Estimates (B, n)."""
        return frozen(self._core.means())

    @property
    def covs(self) -> FloatArray:
        """Their covariances (B, n, n)."""
        return frozen(self._core.covs())

    @property
    def failures(self) -> IntArray:
        """Measurements left out so far, per track (B,), because an innovation covariance was not positive definite."""
        return frozen(self._core.failures().astype(np.int64))

    @property
    def escalated(self) -> NDArray[np.bool_]:
        """Whether a track's covariance came close to being singular and is carried as its square root since (B,).

        Such a track leaves the register it shared: from the first step of that call on it has the bits of the filter's
        own `run`. With a strict filter it raises `StrictError`, and the tracks are as they were.
        """
        return frozen(self._core.escalated())

    @property
    def in_lanes(self) -> bool:
        """Whether several tracks share a register."""
        return self._core.in_lanes()

    def step(self, time: float, measurements: ArrayLike) -> None:
        """Take in one measurement of every track, (B, m); NaN = component not observed.

        Raises:
            TimeError: `time` is before the tracks'.
            DimensionError: the shape does not fit.
        """
        z = array(measurements, "measurements", 2)[:, np.newaxis]
        self._core.run(np.array([float(time)]), z, means=False, covs=False, nis=False)

    def run(self, times: ArrayLike, measurements: ArrayLike, *, covs: bool = False, nis: bool = False) -> BatchRun:
        """Take in T measurements of every track and return all estimates; the tracks then stand at the last of them.

        Args:
            times: (T,) seconds, not decreasing, the same for all tracks.
            measurements: (B, T, m); NaN = component not observed.
            covs: return the covariances, n²/m times as much memory as the measurements.
            nis: return the normalised innovations squared.

        Raises:
            TimeError: times decrease, or begin before the tracks'.
            DimensionError: the shapes do not agree.
            NonFiniteError: a time is not finite, or a measurement infinite.
        """
        t = array(times, "times", 1)
        out: dict[str, Any] = self._core.run(t, array(measurements, "measurements", 3), means=True, covs=covs, nis=nis)
        means, rest = frozen(out["means"]), {name: out[name] for name in ("covs", "nis")}
        kept = {name: None if value is None else frozen(value) for name, value in rest.items()}
        return BatchRun(frozen(t.copy()), self.labels, means, failures=self.failures, escalated=self.escalated, **kept)
