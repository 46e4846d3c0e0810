"""What a report can show. Every section is a record; `write_report` puts them on the page in the order given."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trackrs._arrays import FloatArray, frozen_array
from trackrs.errors import DimensionError, ParameterError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

    from trackrs.evaluation import Truth
    from trackrs.motion import Motion
    from trackrs.sensor import Sensor
    from trackrs.types import Scan, Tracks


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Tracks on a plane, scan by scan: a player with a time slider, a legend and a table of the tracks.

    Args:
        tracks: the tracks; the first two components of their state are drawn, with 1- and 2-sigma ellipses, and
            their extents where they have some.
        title: heading of the section.
        scans: the S scans that the tracks come from, to show their detections. Those of sensors that do not measure a
            position (`LinearSensor`) are left out, and so are incomplete ones.
        sensors: their sensors by name.
        motion: how targets move, to show gates: the ellipse about the position predicted from the scan before, with the
            sensor's noise if `sensors` has a `PositionSensor` or `RangeBearing` of that name, else without.
        gate: probability that a gate holds its target's report.
        truth: where the targets really were.
        own_ship: (S, 2) path of the platform.
        region: radius of a circle around the platform, metres, drawn where `own_ship` is given.
        labels: of the first and second component of the state, units in parentheses.
        swap_axes: draw the first component upwards and the second to the right, as suits north and east.

    Raises:
        ParameterError: the state has no second coordinate; `scans` are not those of the tracks, or have no `sensors`;
            `gate` is not between 0 and 1; `region` is not positive.
        DimensionError: `own_ship` is not (S, 2).
    """

    tracks: Tracks
    title: str = ""
    scans: Sequence[Scan] = ()
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    motion: Motion | None = None
    gate: float = 0.99
    truth: Sequence[Truth] = ()
    own_ship: ArrayLike | None = None
    region: float | None = None
    labels: Sequence[str] = ("x (m)", "y (m)")
    swap_axes: bool = False

    def __post_init__(self) -> None:
        """Check that the parts belong together."""
        names = self.tracks.labels
        if len(names) < 2 or names[1] == f"v{names[0]}":
            msg = f"the state {' '.join(names)} has no second coordinate: a scene needs a plane"
            raise ParameterError(msg)
        if len(self.labels) != 2:
            msg = f"labels: {len(self.labels)} given, 2 needed"
            raise ParameterError(msg)
        if not 0.0 < self.gate < 1.0:
            msg = f"gate = {self.gate} is invalid: must be between 0 and 1"
            raise ParameterError(msg)
        if self.region is not None and not self.region > 0.0:
            msg = f"region = {self.region} is invalid: must be positive"
            raise ParameterError(msg)
        times = self.tracks.scan_times
        if len(self.scans) > 0 and [scan.time for scan in self.scans] != times.tolist():
            msg = f"scans: {len(self.scans)} given, not the {len(times)} that the tracks come from"
            raise ParameterError(msg)
        unknown = sorted({scan.sensor for scan in self.scans} - set(self.sensors))
        if unknown:
            msg = f"sensors: there is none named {unknown[0]!r}, as the scans have it"
            raise ParameterError(msg)
        if self.own_ship is not None:
            path = frozen_array(self.own_ship, "own_ship", 2)
            if len(path) != len(times) or path.shape[1] < 2:
                msg = f"own_ship has shape {path.shape}, expected ({len(times)}, 2)"
                raise DimensionError(msg)
            object.__setattr__(self, "own_ship", path)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One line of `Curves`.

    Args:
        name: as the legend has it.
        x: (T,) increasing, seconds where the curves are over time.
        y: (T,); NaN leaves a gap.
        low, high: (T,) bounds of a band about it, for example of 95 % intervals.

    Raises:
        DimensionError: the lengths differ.
        ParameterError: one of `low` and `high` without the other.
    """

    name: str
    x: FloatArray
    y: FloatArray
    low: FloatArray | None = None
    high: FloatArray | None = None

    def __init__(
        self, name: str, x: ArrayLike, y: ArrayLike, low: ArrayLike | None = None, high: ArrayLike | None = None
    ) -> None:
        """Copy the arrays."""
        if (low is None) != (high is None):
            msg = f"line {name!r}: low and high go together"
            raise ParameterError(msg)
        object.__setattr__(self, "name", str(name))
        object.__setattr__(self, "x", frozen_array(x, "x", 1))
        object.__setattr__(self, "y", frozen_array(y, "y", 1))
        object.__setattr__(self, "low", None if low is None else frozen_array(low, "low", 1))
        object.__setattr__(self, "high", None if high is None else frozen_array(high, "high", 1))
        lengths = {len(part) for part in (self.x, self.y, self.low, self.high) if part is not None}
        if len(lengths) != 1:
            msg = f"line {self.name!r}: x, y and the band have lengths {sorted(lengths)}"
            raise DimensionError(msg)


@dataclass(frozen=True, slots=True)
class Curves:
    """Lines over time, or over anything else.

    Args:
        lines: at least one.
        title: heading of the section.
        y: what is upwards, with its unit: "GOSPA (m)".
        x: what is to the right, with its unit.
        timed: x is the time of the scene before it (of the first, if there is none before it): the curves then show its
            clock and can set it. Ignored on a page without a scene.
        band: what the bands are, for the legend.

    Raises:
        ParameterError: there is no line.
    """

    lines: Sequence[Line]
    title: str = ""
    y: str = ""
    x: str = "time (s)"
    timed: bool = True
    band: str = "95 % interval"

    def __post_init__(self) -> None:
        """Refuse an empty picture."""
        if not self.lines:
            msg = "lines is empty: pass at least one Line"
            raise ParameterError(msg)


@dataclass(frozen=True, slots=True)
class Interval:
    """A number with the bounds of its 95 % interval; the bounds may be NaN where there is none."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class MethodScore:
    """One method under one metric.

    Args:
        metric: with its unit: "mean OSPA (m)".
        method: name of the method.
        score: its mean over the runs.
        difference: mean of the paired differences to the reference method, same runs, method less reference; None for
            the reference itself.
        p_value: of the hypothesis that the difference is zero.
    """

    metric: str
    method: str
    score: Interval
    difference: Interval | None = None
    p_value: float | None = None


@dataclass(frozen=True, slots=True)
class Comparison:
    """Methods side by side: for every metric a scale with the interval of each method, and paired differences.

    Args:
        scores: metrics and methods appear in the order in which they are first named.
        title: heading of the section.
        reference: the method that the differences are to.
    """

    scores: Sequence[MethodScore]
    title: str = ""
    reference: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Rows and columns.

    Args:
        columns: names.
        rows: one value per column; numbers are shown with four digits, None as a dash.
        title: heading of the section.
        verdict: name of the column whose values are shown as badges: "holds" and "does not hold", "agrees" and
            "differs" have colours, any other value has none.

    Raises:
        ParameterError: a row is too short or long; `verdict` is no column.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    title: str = ""
    verdict: str | None = None

    def __post_init__(self) -> None:
        """Check the shape."""
        for number, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                msg = f"rows[{number}] has {len(row)} values, there are {len(self.columns)} columns"
                raise ParameterError(msg)
        if self.verdict is not None and self.verdict not in self.columns:
            msg = f"verdict = {self.verdict!r} is no column (there are: {', '.join(self.columns)})"
            raise ParameterError(msg)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture that is drawn already.

    Args:
        source: PNG or SVG, its bytes or its file.
        alt: what it shows, in words, for those who cannot see it.
        title: heading of the section.

    Raises:
        ParameterError: it is neither PNG nor SVG, or `alt` is empty.
        OSError: the file cannot be read.
    """

    source: bytes | str | Path
    alt: str
    title: str = ""

    def __post_init__(self) -> None:
        """Read the file."""
        if not self.alt.strip():
            msg = "alt is empty: say in words what the picture shows"
            raise ParameterError(msg)
        if not isinstance(self.source, bytes):
            object.__setattr__(self, "source", Path(self.source).read_bytes())
        if self.kind is None:
            msg = "source is neither PNG nor SVG"
            raise ParameterError(msg)

    @property
    def kind(self) -> str | None:
        """Media type of the bytes."""
        data = self.source if isinstance(self.source, bytes) else b""
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            return "image/png"
        return "image/svg+xml" if b"<svg" in data[:4096] else None


@dataclass(frozen=True, slots=True)
class Prose:
    """Text; a blank line begins a new paragraph."""

    text: str
    title: str = ""


Section = Scene | Curves | Comparison | Table | Picture | Prose


def finite(values: ArrayLike) -> FloatArray:
    """Return the values with NaN for what is infinite: nothing on a page can be that far away."""
    out = np.array(values, dtype=np.float64)
    out[~np.isfinite(out)] = np.nan
    return out
