"""Means over runs and what they are worth: the bootstrap.

The runs are drawn again, with replacement, B times; the quantiles of the means are the interval. Deviations from the
mean are widened by √(n/(n - 1)) t/z, because n runs vary less about their own mean than about the true one, and because
their spread is not known but estimated: t and z are the 97.5 % quantiles of Student's distribution of n - 1 degrees of
freedom and of the normal one. Of two methods the differences run by run are drawn, so that what both have in common
counts for nothing; the p-value is twice the share of means on the other side of zero, but not below 2^(1 - n): that n
differences have one sign happens so often by chance. The draws are the same for the same number of runs.

Reference: Efron, Tibshirani (1993), An introduction to the bootstrap; the widening: Hesterberg (2015), What teachers
should know about the bootstrap, The American Statistician 69(4), 5.3; t from z: Abramowitz, Stegun, 26.7.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from trackrs._arrays import FloatArray, IntArray

RESAMPLES = 10_000
BATCH = 250  # resamples at once, which bounds the memory
KEPT = 500  # of so many runs at most the resamples are kept for the next column: 40 MB


@dataclass(frozen=True, slots=True)
class Summary:
    """A mean over runs, with its 95 % interval.

    Attributes:
        mean: over the runs that have a value; NaN if none has.
        low, high: bounds of the interval; NaN of fewer than two runs.
        runs: how many have a value.
    """

    mean: float
    low: float
    high: float
    runs: int

    @property
    def half_width(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


@dataclass(frozen=True, slots=True)
class Difference:
    """One method minus another, run by run.

    Attributes:
        mean: of the differences.
        low, high: bounds of its 95 % interval; NaN of fewer than two runs.
        p_value: two-sided, of the hypothesis that the mean is zero; at least 2 / 10,001 and 2^(1 - runs).
        runs: how many have a value of both.
        below: of these, the share in which the first is below the second.
    """

    mean: float
    low: float
    high: float
    p_value: float
    runs: int
    below: float


def summarise(values: FloatArray) -> Summary:
    """Return the mean of these and its interval; NaN are left out."""
    kept = values[np.isfinite(values)]
    if len(kept) == 0:
        return Summary(np.nan, np.nan, np.nan, 0)
    low, high = interval(resampled_means(kept))
    return Summary(float(kept.mean()), low, high, len(kept))


def difference(first: FloatArray, second: FloatArray) -> Difference:
    """Return what the first has more than the second."""
    gaps = first - second
    gaps = gaps[np.isfinite(gaps)]
    if len(gaps) == 0:
        return Difference(np.nan, np.nan, np.nan, np.nan, 0, np.nan)
    means = resampled_means(gaps)
    low, high = interval(means)
    beyond = min(int(np.sum(means <= 0.0)), int(np.sum(means >= 0.0)))
    p_value = min(1.0, max(2.0 * (beyond + 1) / (RESAMPLES + 1), 2.0 ** (1 - len(gaps))))
    return Difference(float(gaps.mean()), low, high, p_value, len(gaps), float(np.mean(gaps < 0.0)))


def interval(means: FloatArray) -> tuple[float, float]:
    """Return the bounds between which 95 % of these lie."""
    if len(means) == 0:
        return np.nan, np.nan
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def resampled_means(values: FloatArray) -> FloatArray:
    """Return the means of as many resamples as usual; none of a single value, which tells nothing of its spread."""
    count = len(values)
    if count == 1:
        return np.zeros(0)
    if np.all(values == values[0]):
        return np.full(RESAMPLES, values[0])
    if count <= KEPT:
        means = shares(count) @ values
    else:
        means = np.concatenate([values[pick].mean(axis=1) for pick in picks(count)])
    middle = values.mean()
    return np.asarray(middle + (means - middle) * widening(count))


def picks(count: int) -> Iterator[IntArray]:
    """Give the numbers of the runs in every resample, some resamples at a time."""
    rng = np.random.default_rng(count)
    return (rng.integers(count, size=(BATCH, count)) for _ in range(RESAMPLES // BATCH))


@lru_cache(maxsize=4)
def shares(count: int) -> FloatArray:
    """Return the share of every run in every resample: the same for all columns and methods of a study."""
    rows = count * np.arange(BATCH)[:, np.newaxis]
    counts = [np.bincount((pick + rows).ravel(), minlength=BATCH * count) for pick in picks(count)]
    return np.concatenate(counts).reshape(RESAMPLES, count) / count


def widening(count: int) -> float:
    """Return √(n/(n - 1)) t/z."""
    z, free = 1.959963984540054, count - 1.0
    if free == 1.0:
        t = 12.706204736174698
    elif free == 2.0:
        t = 4.302652729749462
    else:
        terms = (
            z,
            (z**3 + z) / 4.0,
            (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
            (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
            (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 92160.0,
        )
        t = sum(term / free**power for power, term in enumerate(terms))
    return float(np.sqrt(count / free) * t / z)


def bands(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and half the width of a 95 % interval per column, of the values that are not NaN; for drawing."""
    known = np.isfinite(values)
    counts = known.sum(axis=0)
    filled = np.where(known, values, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = filled.sum(axis=0) / counts
        squares = np.where(known, (values - means) ** 2, 0.0).sum(axis=0)
        halves = 1.96 * np.sqrt(squares / (counts - 1.0) / counts)
    return np.where(counts > 0, means, np.nan), np.where(counts > 1, halves, np.nan)
