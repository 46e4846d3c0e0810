"""Configuration: a TOML file becomes models, a tracker, and the layout of the tables.

The tables of the file mirror the classes: `[motion]`, `[sensors.NAME]` and `[tracker]` hold the arguments of a motion
model, a sensor and `MultiTargetTracker`, or of the filter by intensity that `type` in `[tracker]` names; `[input]`,
`[truth]`, `[score]` and `[plot]` those of the classes below.
`type = "constant_velocity"` names a class in snake case. TOML has no None: leave a key out where that is the default,
and write "none" where it is not, as in `associator = {type = "npda", clutter_probability = "none"}`, which goes by
`clutter_density`. `examples/harbour.toml` shows all of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from trackrs._kinds import TRACKERS
from trackrs.errors import TrackrsError
from trackrs.metric import GOSPA, OSPA
from trackrs.tracker import MultiTargetTracker

if TYPE_CHECKING:
    from collections.abc import Mapping

    from trackrs.motion import Motion
    from trackrs.phd import IntensityTracker
    from trackrs.sensor import Sensor


class ConfigError(TrackrsError, ValueError):
    """A configuration file is wrong; the message names file, table and key."""


@dataclass(frozen=True, slots=True)
class InputConfig:
    """How the tables of detections and scans are read.

    Args:
        time: column of the time, seconds.
        sensor: column of the sensor's name.
        scan: column of an id that joins detections to scans; without one they are joined by time and sensor.
        platform: columns of the moving platform's position, in the table of scans.
        ignore_sensors: rows of these sensors are left out; any other sensor without a model is an error.
        unsorted: what to do when a sensor's times decrease: refuse the table, or sort it.
    """

    time: str = "time"
    sensor: str = "sensor"
    scan: str | None = None
    platform: tuple[str, ...] = ()
    ignore_sensors: tuple[str, ...] = ()
    unsorted: Literal["error", "sort"] = "error"


@dataclass(frozen=True, slots=True)
class TruthConfig:
    """How the table of true positions is read.

    Args:
        columns: columns of the position, in the order of the axes.
        time: column of the time, seconds.
        target: column of the target's name.
    """

    columns: tuple[str, ...]
    time: str = "time"
    target: str = "target_id"


@dataclass(frozen=True, slots=True)
class ScoreConfig:
    """How tracks are scored; see `evaluate`.

    Args:
        c: cutoff, metres.
        metric: which metric.
        p: its order.
        alpha: the alpha of GOSPA.
        sensor: score at the scans of this sensor only.
        start: score from this time on, seconds.
        region: radius around the platform, metres; what is outside does not count.
    """

    c: float
    metric: Literal["gospa", "ospa"] = "gospa"
    p: float = 2.0
    alpha: float = 2.0
    sensor: str | None = None
    start: float | None = None
    region: float | None = None

    def make_metric(self) -> GOSPA | OSPA:
        """Return the metric as an argument of `evaluate`."""
        return GOSPA(self.c, self.p, self.alpha) if self.metric == "gospa" else OSPA(self.c, self.p)


@dataclass(frozen=True, slots=True)
class PlotConfig:
    """How tracks are drawn.

    Args:
        labels: names of the first two axes of the state.
        swap_axes: draw the first axis upwards and the second to the right, as suits north and east.
    """

    labels: tuple[str, ...] = ("x (m)", "y (m)")
    swap_axes: bool = False


@dataclass(frozen=True, slots=True)
class Config:
    """A configuration file.

    Attributes:
        path: the file.
        motion: how targets move.
        sensors: the sensors by name.
        columns: per sensor, the columns of the detections table, one per component of its measurement.
        kind: which tracker: "multi_target", "phd", "cphd" or "extended_phd".
        tracker: its other arguments.
        input: how detections and scans are read.
        truth: how the truth is read, if the file says so.
        score: how tracks are scored, if the file says so.
        plot: how tracks are drawn.
    """

    path: Path
    motion: Motion
    sensors: Mapping[str, Sensor]
    columns: Mapping[str, tuple[str, ...]]
    kind: str
    tracker: Mapping[str, Any]
    input: InputConfig
    truth: TruthConfig | None
    score: ScoreConfig | None
    plot: PlotConfig

    def make_tracker(self) -> MultiTargetTracker | IntensityTracker:
        """Return a tracker that has seen nothing yet."""
        made = TRACKERS[self.kind](self.motion, self.sensors, **self.tracker)
        return made if isinstance(made, MultiTargetTracker) else made.start()


def load_config(path: str | Path) -> Config:
    """Read a configuration file.

    Raises:
        ConfigError: the file is missing or no TOML, a table or key is missing or unknown, a value has the wrong type or
            is outside its domain.
    """
    from trackrs._loader import Loader  # noqa: PLC0415 (which knows the records)

    return Loader(Path(path)).load()
