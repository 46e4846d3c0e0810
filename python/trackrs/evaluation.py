"""Tracks against truth: every metric at the times of the scans, and what became of every target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, freeze_columns, frozen, frozen_array
from trackrs.errors import DimensionError, ParameterError
from trackrs.metric import GOSPA

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from trackrs.metric import OSPA
    from trackrs.types import Tracks


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Where one target really was.

    Args:
        id: its name.
        times: (T,) seconds, increasing.
        positions: (T, d) metres.
    """

    id: str
    times: FloatArray
    positions: FloatArray

    def __init__(self, id: str, times: ArrayLike, positions: ArrayLike) -> None:  # noqa: A002
        """Copy the arrays."""
        object.__setattr__(self, "id", str(id))
        object.__setattr__(self, "times", frozen_array(times, "times", 1))
        object.__setattr__(self, "positions", frozen_array(positions, "positions", 2))
        if len(self.times) != len(self.positions):
            msg = f"truth {self.id} has {len(self.times)} times and {len(self.positions)} positions"
            raise DimensionError(msg)


@dataclass(frozen=True, slots=True)
class TargetScore:
    """What became of one target.

    Attributes:
        id: its name.
        present: scored times with the target inside the region.
        held: of these, times with a track paired with it.
        fragments: tracks that held it one after the other.
        switches: changes from one track to another.
        longest: the longest time one track held it, as a share of `present`.
    """

    id: str
    present: int
    held: int
    fragments: int
    switches: int
    longest: float


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Tracks against truth.

    Attributes:
        times: (S,) scored times.
        targets, tracks: (S,) targets inside the region and tracks that count.
        series: per metric, its value at every scored time (S,).
        mean: per metric, the mean over the scored times.
        localisation, missed, false_tracks: mean p-th powers of the parts of GOSPA.
        all_held: of the times with every target inside the region, the share with every target held.
        switches: changes of track, all targets together.
        false_ids: tracks that were counted but never paired.
        false_per_minute: their number per minute.
        rmse: of the paired positions, metres.
        nees: mean position NEES of the pairs; the number of coordinates if covariances are honest.
        per_target: one record per target.
    """

    times: FloatArray
    targets: IntArray
    tracks: IntArray
    series: dict[OSPA | GOSPA, FloatArray]
    mean: dict[OSPA | GOSPA, float]
    localisation: float
    missed: float
    false_tracks: float
    all_held: float
    switches: int
    false_ids: tuple[int, ...]
    false_per_minute: float
    rmse: float
    nees: float
    per_target: tuple[TargetScore, ...]


def evaluate(
    truth: Sequence[Truth],
    tracks: Tracks,
    metrics: Sequence[OSPA | GOSPA],
    *,
    sensor: str | None = None,
    start: float | None = None,
    region: float | None = None,
    centres: ArrayLike | None = None,
) -> Evaluation:
    """Score tracks against truth at the times of their scans.

    The truth is interpolated linearly. Targets and tracks are paired by GOSPA with the cutoff and order of the first
    metric. A track whose nearest target is outside the region and closer than the cutoff does not count.

    Args:
        truth: the targets.
        tracks: as a tracker's `run` gives them.
        metrics: at least one of `OSPA` and `GOSPA`.
        sensor: score at the scans of this sensor only.
        start: score from this time on, seconds.
        region: radius around `centres`, metres; what is outside does not count.
        centres: (S, d) centre of the region at every scan of `tracks`, or one centre (d,) for all.

    Raises:
        ParameterError: no metric, no scored time, or one of `region` and `centres` without the other.
    """
    if not metrics:
        msg = "metrics is empty: pass at least one, for example [GOSPA(c=30.0)]"
        raise ParameterError(msg)
    if (region is None) != (centres is None):
        msg = "region and centres go together: a radius and where it is centred"
        raise ParameterError(msg)
    chosen = [
        k
        for k, time in enumerate(tracks.scan_times)
        if (sensor is None or tracks.sensors[k] == sensor) and (start is None or time >= start)
    ]
    if not chosen:
        which = "" if sensor is None else f" of sensor {sensor!r}"
        since = "" if start is None else f" from {start} s on"
        msg = f"there is no scan{which}{since}: nothing to score"
        raise ParameterError(msg)
    rows = [np.arange(tracks.offsets[k], tracks.offsets[k + 1]) for k in chosen]
    picked = np.concatenate(rows)
    middle = None
    if centres is not None:
        every = np.broadcast_to(np.asarray(centres, dtype=np.float64), (len(tracks.scan_times), np.shape(centres)[-1]))
        middle = array(every[chosen], "centres", 2)
    outs: list[tuple[OSPA | GOSPA, dict[str, Any]]] = []
    for metric in metrics:
        out = _trackrs.evaluate(
            [(path.id, path.times, path.positions) for path in truth],
            array(tracks.scan_times[chosen], "times", 1),
            [0, *np.cumsum([len(part) for part in rows]).tolist()],
            tracks.ids[picked].tolist(),
            array(tracks.means[picked], "means", 2),
            array(tracks.covs[picked], "covs", 3),
            metric.c,
            metric.p,
            metric.alpha if isinstance(metric, GOSPA) else 2.0,
            middle,
            region,
        )
        outs.append((metric, freeze_columns(out)))
    first = outs[0][1]
    series = {metric: out["gospa" if isinstance(metric, GOSPA) else "ospa"] for metric, out in outs}
    return Evaluation(
        times=frozen(tracks.scan_times[chosen].copy()),
        targets=first["targets"],
        tracks=first["tracks"],
        series=series,
        mean={metric: float(values.mean()) for metric, values in series.items()},
        localisation=float(first["localisation"].mean()),
        missed=float(first["missed"].mean()),
        false_tracks=float(first["false_tracks"].mean()),
        all_held=first["all_held"],
        switches=first["switches"],
        false_ids=tuple(first["false_ids"]),
        false_per_minute=first["false_per_minute"],
        rmse=first["rmse"],
        nees=first["nees"],
        per_target=tuple(TargetScore(**target) for target in first["per_target"]),
    )
