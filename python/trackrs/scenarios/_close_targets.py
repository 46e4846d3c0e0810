"""Targets side by side, reported one at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, freeze_columns, frozen
from trackrs.errors import ParameterError
from trackrs.scenarios._recipe import Recalled, remembered
from trackrs.scenarios._stream import stream_number
from trackrs.sensor import RangeBearing
from trackrs.types import GaussianState, Scan


@dataclass(frozen=True, slots=True, eq=False)
class CloseReports:
    """What one run of `CloseTargets` reported.

    Attributes:
        times: (T,) seconds.
        values: (T, 2) range and bearing, metres and radians.
        origins: (T,) the target each report is of; -1 = false.
        scan_size: reports that are one scan, as the scenario has it.
    """

    times: FloatArray
    values: FloatArray
    origins: IntArray
    scan_size: int = 1

    def scans(self, size: int | None = None) -> list[Scan]:
        """Return the reports as scans of `size` reports each (None: `scan_size`), which keep their own times.

        Their sensor is "radar".
        """
        size = self.scan_size if size is None else size
        return [
            Scan(times[-1], self.values[k : k + size], "radar", times=times if size > 1 else None)
            for k in range(0, len(self.times), size)
            if len(times := self.times[k : k + size])
        ]


@dataclass(frozen=True, slots=True, eq=False)
class CloseTargets(Recalled):
    """Targets side by side, reported one at a time; see `close_targets`, which makes it.

    Attributes:
        radar: the sensor, in the origin.
        times: (T,) seconds, of the reports.
        truth: (T, N, 4) positions and velocities of all targets at these times, metres and seconds.
        initial: what a filter is told of each target at time 0.
        clutter_area: area that false reports are spread over, square metres, centred on the targets at all times. Their
            density at range r is r / area per metre and radian.
        scan_size: reports that are one scan.
    """

    radar: RangeBearing
    times: FloatArray = field(repr=False)
    truth: FloatArray = field(repr=False)
    initial: tuple[GaussianState, ...] = field(repr=False)
    clutter_area: float
    scan_size: int
    _core: _trackrs.CloseTargets = field(repr=False)

    def draw(self, seed: int, run: int = 0) -> CloseReports:
        """Return run number `run` of a study with this seed, both from 0 to 2⁶⁴ - 1.

        Raises:
            ParameterError: `seed` or `run` is no such number.
        """
        out: dict[str, Any] = self._core.draw(stream_number("seed", seed), stream_number("run", run))
        return CloseReports(times=self.times, scan_size=self.scan_size, **freeze_columns(out))


@remembered
def close_targets(
    targets: int = 3,
    separation: float = 300.0,
    *,
    reports: int = 60,
    interval: float = 3.0,
    order: Literal["cyclic", "boustrophedon", "random"] = "cyclic",
    clutter: float = 0.0,
    scan_size: int = 1,
) -> CloseTargets:
    """Return the scenario of the NPDA paper: targets side by side at 100 m/s, reported one at a time by a radar.

    The paper leaves open the order of the reports, their number and the time of the first one. The same run has the
    same noise whatever `order` and `clutter` are.

    Args:
        targets: how many.
        separation: of neighbours, metres.
        reports: how many, of all targets together.
        interval: seconds between reports, and before the first one.
        order: whose turn it is: 0 1 2 0 1 2, or 0 1 2 2 1 0, or any.
        clutter: probability that a report is false, whoever's turn it is; false reports are uniform over an area that
            goes with the targets, 1000 m ahead and behind, 500 m beyond the outer ones.
        scan_size: reports that `scans` and studies take for one scan.

    Raises:
        ParameterError: a parameter is outside its domain.

    Reference:
        Liu, Xie, Huang (2009), section 5, and section 4 of its spec.

    Example:
        >>> import trackrs as tr
        >>> scene = tr.scenarios.close_targets(separation=150.0)
        >>> tracker = tr.MultiTargetTracker(
        ...     tr.ConstantVelocity(dims=2, accel_std=2.0),
        ...     sensors={"radar": scene.radar},
        ...     initiator=tr.MofN(3, 5, max_speed=150.0),
        ...     associator=tr.NPDA(),
        ...     gate=tr.Gate(1.0),
        ...     deletion=tr.Deletion(max_misses=100),
        ...     initial=scene.initial,
        ... )
        >>> tracks = tracker.run(scene.draw(seed=7).scans())
        >>> tracks.means[tracks.offsets[-2] :].shape, scene.truth.shape
        ((3, 4), (60, 3, 4))
    """
    if scan_size < 1:
        msg = f"scan_size = {scan_size} is invalid: must be at least 1"
        raise ParameterError(msg)
    core = _trackrs.CloseTargets.make(targets, separation, reports, interval, order, clutter)
    range_std, bearing_std = core.noise()
    return CloseTargets(
        radar=RangeBearing((0.0, 0.0), range_std, bearing_std),
        times=frozen(core.times()),
        truth=frozen(core.truth().reshape(reports, targets, 4)),
        initial=tuple(GaussianState(mean, np.diag(variances)) for mean, variances in core.initial()),
        clutter_area=core.clutter_area(),
        scan_size=scan_size,
        _core=core,
    )
