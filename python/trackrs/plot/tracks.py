"""Tracks from above."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs.errors import ParameterError
from trackrs.plot._figure import COLOURS, TRUTH_COLOUR, draw_ellipses, new_figure, tidy
from trackrs.sensor import PositionSensor, RangeBearing

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from trackrs._arrays import FloatArray, IntArray
    from trackrs.evaluation import Truth
    from trackrs.sensor import Sensor
    from trackrs.types import Scan, Tracks

DETECTION_STYLES = (("o", "#8A8A8A"), ("+", "#B08D57"), ("x", "#7D9AAA"), ("^", "#A58AA8"))
OWN_SHIP_COLOUR = "#5A5A5A"
FILLED = "o^"  # markers with a face
WIDTH = 6.0  # of the picture without its legend, inches
MARGIN = 0.1  # around everything, inches


def detection_positions(scans: Iterable[Scan], sensors: Mapping[str, Sensor]) -> dict[str, FloatArray]:
    """Return where the detections of each sensor lie in the plane, as `plot_tracks` takes them.

    Sensors that do not measure a position (`LinearSensor`) are left out, and so are incomplete detections.

    Args:
        scans: the scans.
        sensors: their sensors by name.
    """
    out: dict[str, list[FloatArray]] = {}
    for scan in scans:
        points = scan_positions(scan, sensors[scan.sensor])
        if points is not None:
            out.setdefault(scan.sensor, []).append(points)
    return {name: np.concatenate(out[name]) for name in sensors if name in out}


def scan_positions(scan: Scan, sensor: Sensor) -> FloatArray | None:
    """Return where the complete detections of one scan lie in the plane (k, 2); None if they tell of no position."""
    if len(scan) == 0 or not isinstance(sensor, PositionSensor | RangeBearing):
        return None
    origin = np.zeros(2) if scan.platform is None else scan.platform[:2]
    if isinstance(sensor, RangeBearing):
        reach, bearing = scan.values.T
        points = np.stack([reach * np.cos(bearing), reach * np.sin(bearing)], axis=1) + np.asarray(sensor.position)
    else:
        points = scan.values[:, :2]
    points = points + origin
    return np.asarray(points[~np.isnan(points).any(axis=1)], dtype=np.float64)


def plot_tracks(
    tracks: Tracks,
    *,
    detections: Mapping[str, ArrayLike] | None = None,
    truth: Sequence[Truth] = (),
    own_ship: ArrayLike | None = None,
    region: float | None = None,
    extents: bool = False,
    title: str = "",
    labels: Sequence[str] = ("x (m)", "y (m)"),
    swap_axes: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw tracks from above: a line and an id for each, and 2-sigma ellipses at some of its scans.

    Args:
        tracks: the tracks; the first two components of the state are drawn.
        detections: per sensor, positions (k, 2); see `detection_positions`.
        truth: where the targets really were.
        own_ship: (S, 2) path of the platform.
        region: radius around the platform, metres: the picture shows what lies within it.
        extents: the ellipses are the targets' extents, which the tracks must have, not the uncertainty of their place.
        title: of the picture.
        labels: of the first and second component of the state.
        swap_axes: draw the first component upwards and the second to the right, as suits north and east.
        ax: draw here instead of in a new figure.

    Returns:
        The axes; `axes.figure.savefig("tracks.png")` keeps the picture.

    Raises:
        ImportError: matplotlib is not installed; the message says how to.
        ParameterError: `extents` of tracks that have none.
    """
    if extents and tracks.extents is None:
        msg = "extents: these tracks have none"
        raise ParameterError(msg)
    shapes = tracks.extents if extents and tracks.extents is not None else tracks.covs
    figure = None
    if ax is None:
        figure = new_figure()
        ax = figure.add_subplot()
    right, up = (1, 0) if swap_axes else (0, 1)
    path = None if own_ship is None else np.asarray(own_ship, dtype=np.float64)

    # The limits come first: how far ellipses must be apart depends on them.
    _set_limits(ax, tracks, detections or {}, truth, path, region, right, up)
    for (marker, colour), (name, points) in zip(cycle(DETECTION_STYLES), (detections or {}).items(), strict=False):
        xy = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        style: dict[str, Any] = {"linewidths": 0.6, "alpha": 0.55, "zorder": 1}
        if marker in FILLED:
            ax.scatter(
                xy[:, right], xy[:, up], 9, marker=marker, facecolors="none", edgecolors=colour, label=name, **style
            )
        else:
            ax.scatter(xy[:, right], xy[:, up], 12, marker=marker, color=colour, label=name, **style)
    for colour, number in zip(cycle(COLOURS), np.unique(tracks.ids), strict=False):
        _draw_track(ax, tracks, shapes, np.flatnonzero(tracks.ids == number), colour, right, up)
    for k, target in enumerate(truth):
        x, y = target.positions[:, right], target.positions[:, up]
        ax.plot(x, y, "--", color=TRUTH_COLOUR, linewidth=1.0, zorder=4, label="" if k else "truth (dot: its start)")
        ax.plot(x[0], y[0], "o", markersize=4, color=TRUTH_COLOUR, zorder=4)
    if path is not None:
        ax.plot(
            path[:, right], path[:, up], color=OWN_SHIP_COLOUR, linewidth=2.4, zorder=2, label="own ship (diamond: end)"
        )
        ax.plot(path[-1, right], path[-1, up], "D", markersize=5, color=OWN_SHIP_COLOUR, zorder=2)
    if path is not None and region is not None:
        _draw_region(ax, path[:, [right, up]], region)
    _decorate(ax)
    ax.set_xlabel(labels[right])
    ax.set_ylabel(labels[up])
    ax.set_title(title, loc="left", fontsize="medium")
    if figure is not None:
        _fit(figure, ax)
    return ax


def _draw_track(ax: Axes, tracks: Tracks, shapes: FloatArray, rows: IntArray, colour: str, right: int, up: int) -> None:
    """Line, ellipses that do not overlap, and the id where the track ends."""
    from matplotlib.patheffects import withStroke  # noqa: PLC0415

    xy = tracks.means[rows][:, [right, up]]
    covs = shapes[rows][:, [right, up]][:, :, [right, up]]
    ax.plot(xy[:, 0], xy[:, 1], color=colour, linewidth=1.6, zorder=5)
    draw_ellipses(ax, xy, covs, colour, spacing=0.035 * float(np.ptp(ax.get_xlim())))
    heading = xy[-1] - xy[max(len(xy) - 5, 0)]
    length = float(np.hypot(*heading))
    offset = 9.0 * heading / length if length > 0 else np.array([7.0, 7.0])
    ax.annotate(
        str(tracks.ids[rows[0]]),
        (xy[-1, 0], xy[-1, 1]),
        xytext=(offset[0], offset[1]),
        textcoords="offset points",
        ha="center",
        va="center",
        color=colour,
        fontsize=9,
        fontweight="bold",
        zorder=7,
        clip_on=True,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )


def _set_limits(
    ax: Axes,
    tracks: Tracks,
    detections: Mapping[str, ArrayLike],
    truth: Sequence[Truth],
    path: FloatArray | None,
    region: float | None,
    right: int,
    up: int,
) -> None:
    """Show tracks and truth, those in the region if there is one; detections only where there is nothing else."""
    parts = [tracks.means[:, :2], *(target.positions[:, :2] for target in truth)]
    if path is not None and region is not None:
        parts = [part[_within(path[:, :2], region, part)] for part in parts]
    parts += [] if path is None else [path[:, :2]]
    if not any(len(part) for part in parts):
        parts = [np.asarray(points, dtype=np.float64).reshape(-1, 2) for points in detections.values()]
    points = np.concatenate([*parts, np.zeros((0, 2))])
    if len(points) == 0:
        points = np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.07 * max(float((high - low).max()), 1.0)
    low, high = low - margin, high + margin
    ax.set_xlim(low[right], high[right])
    ax.set_ylim(low[up], high[up])
    ax.set_aspect("equal", adjustable="box")


def _within(path: FloatArray, region: float, points: FloatArray) -> NDArray[np.bool_]:
    """Which points were ever within the region."""
    near = np.zeros(len(points), dtype=np.bool_)
    for own in path[:: max(len(path) // 100, 1)]:
        near |= np.hypot(*(points - own).T) <= region
    return near


def _draw_region(ax: Axes, path: FloatArray, region: float) -> None:
    """The outline of all points that were ever within the region."""
    x, y = np.linspace(*ax.get_xlim(), 200), np.linspace(*ax.get_ylim(), 200)
    grid = np.stack([np.tile(x, len(y)), np.repeat(y, len(x))], axis=1)
    inside = np.min([np.hypot(*(grid - own).T) for own in path[:: max(len(path) // 100, 1)]], axis=0).reshape(200, 200)
    if inside.min() < region < inside.max():
        style: dict[str, Any] = {"colors": OWN_SHIP_COLOUR, "linewidths": 0.9, "linestyles": "dotted"}
        ax.contour(x, y, inside, levels=[region], zorder=2, **style)
        ax.plot([], [], ":", color=OWN_SHIP_COLOUR, linewidth=0.9, label=f"region ({region:g} m)")


def _decorate(ax: Axes) -> None:
    """Grid, and a legend beside the picture."""
    from matplotlib.lines import Line2D  # noqa: PLC0415

    colour = COLOURS[0]
    handles, names = ax.get_legend_handles_labels()
    handles += [
        Line2D([], [], color=colour, linewidth=1.6),
        Line2D([], [], color=colour, linestyle="", marker="o", markersize=9, markerfacecolor=(colour, 0.18)),
    ]
    names += ["track and its id", "2 sigma"]
    ax.legend(
        handles,
        names,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        borderaxespad=0.0,
        frameon=False,
        fontsize=8,
        markerscale=1.4,
    )
    tidy(ax)


def _fit(figure: Figure, ax: Axes) -> None:
    """Give the figure the shape of what it shows, with just the room that labels and legend need."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    ratio = (top - bottom) / (right - left)
    width, height = (WIDTH, WIDTH * ratio) if ratio < 1.3 else (1.3 * WIDTH / ratio, 1.3 * WIDTH)
    inner = np.array([width, max(height, 0.35 * WIDTH)])
    figure.set_size_inches(inner[0], inner[1])
    ax.set_position((0.0, 0.0, 1.0, 1.0))
    box: Any = ax.get_tightbbox()
    low, high = box.get_points() / figure.get_dpi()
    low, high = low - MARGIN, high + MARGIN
    whole = high - low
    figure.set_size_inches(whole[0], whole[1])
    ax.set_position((*(-low / whole), *(inner / whole)))
