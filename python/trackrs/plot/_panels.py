"""The panels of a run's picture: the plan, and over time depth, error and verdicts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs.plot._figure import COLOURS, TRUTH_COLOUR, draw_ellipses, semi_axes, tidy
from trackrs.range_array import RangeArray
from trackrs.runs import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from trackrs._arrays import FloatArray
    from trackrs.runs import FilterRun, SmoothedRun
    from trackrs.sensor import Sensor

FILTERED_COLOUR, REJECTED_COLOUR, SMOOTHED_COLOUR, RESTART_COLOUR = COLOURS[:4]
USED_COLOUR = "#D6E4EE"
SENSOR_COLOUR = "#5A5A5A"
MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
CLOCK = 8.0  # about so many points of the track have their time written beside them


def panels(figure: Figure, rows: list[str], title: str) -> list[Axes]:
    """The plan and, beside it, the panels over time with one axis of time."""
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    if not rows:
        return [figure.add_subplot()]
    heights = {"depth": 1.0, "error": 1.3, "verdicts": 1.0}
    grid = figure.add_gridspec(len(rows), 2, width_ratios=[1.0, 1.0], height_ratios=[heights[name] for name in rows])
    plan = figure.add_subplot(grid[:, 0])
    strips: list[Axes] = []
    for i in range(len(rows)):
        strips.append(figure.add_subplot(grid[i, 1], sharex=strips[0] if strips else None))
        if i < len(rows) - 1:
            strips[i].tick_params(labelbottom=False)
    strips[-1].set_xlabel("time (s)", fontsize=8)
    return [plan, *strips]


def draw_plan(
    ax: Axes, run: FilterRun, sensor: Sensor | None, truth: FloatArray | None, smoothed: SmoothedRun | None
) -> None:
    """The run from above, with hydrophones, truth and ellipses."""
    known = np.isfinite(run.means[:, :2]).all(axis=1)
    xy, covs = run.means[known][:, :2], run.covs[known][:, :2, :2]
    parts = [xy] if truth is None else [xy, truth[:, :2]]
    if isinstance(sensor, RangeArray):
        places = np.asarray(sensor.hydrophones, dtype=np.float64)[:, :2]
        parts.append(places)
        ax.plot(*places.T, "^", color=SENSOR_COLOUR, markersize=7, label="hydrophone", zorder=2)
        for name, place in zip(sensor.labels, places, strict=False):
            style: dict[str, Any] = {"xytext": (0, -11), "textcoords": "offset points", "ha": "center", "fontsize": 7}
            ax.annotate(name, (place[0], place[1]), color=SENSOR_COLOUR, zorder=8, path_effects=_halo(), **style)
    if truth is not None:
        ax.plot(*truth[:, :2].T, "--", color=TRUTH_COLOUR, linewidth=1.0, zorder=6, label="truth")
    if smoothed is not None:
        path = _broken(smoothed.means[:, :2], run)
        ax.plot(*path.T, color=SMOOTHED_COLOUR, linewidth=1.2, zorder=4, label="smoothed")
    ax.plot(*_broken(run.means[:, :2], run).T, color=FILTERED_COLOUR, linewidth=1.6, zorder=5, label="filtered")
    hit = (run.verdicts[known] == Verdict.REJECTED).any(axis=1) if len(run.verdicts) else np.zeros(len(xy), np.bool_)
    if hit.any():
        style = {"color": REJECTED_COLOUR, "markersize": 5, "markeredgewidth": 1.1}
        ax.plot(*xy[hit].T, "x", zorder=7, label="a channel rejected", **style)
    if run.restarts:
        style = {"markerfacecolor": "white", "markeredgecolor": RESTART_COLOUR, "markersize": 7, "markeredgewidth": 1.6}
        ax.plot(*run.means[list(run.restarts), :2].T, "D", zorder=8, label="restart", **style)
    span = max(float(np.ptp(np.concatenate(parts), axis=0).max()), 1e-9)
    # Half of the ellipses shall be at least a sixtieth of the picture long.
    wanted = span / 120.0 / max(float(np.median(semi_axes(covs)[:, 1])), 1e-12) if len(covs) else 1.0
    scale = next((m for m in MAGNIFICATIONS if m >= wanted), MAGNIFICATIONS[-1])
    draw_ellipses(ax, xy, covs, FILTERED_COLOUR, spacing=0.045 * span, scale=scale)
    label = "2 sigma" if scale == 1 else f"2 sigma, {scale} times"
    style = {"markerfacecolor": (FILTERED_COLOUR, 0.18), "markeredgecolor": FILTERED_COLOUR}
    ax.plot([], [], "o", markersize=9, label=label, **style)
    _draw_clock(ax, run.times[known], xy)
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.08)
    tidy(ax)
    ax.set_xlabel("x (m)", fontsize=8)
    ax.set_ylabel("y (m)", fontsize=8)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3, frameon=False, fontsize=8)


def _draw_clock(ax: Axes, times: FloatArray, xy: FloatArray) -> None:
    """Dots on the track at round times, with the time beside them."""
    if len(times) < 2 or times[-1] == times[0]:
        return
    rough = (times[-1] - times[0]) / CLOCK
    step = min((k * 10.0 ** np.floor(np.log10(rough)) for k in (1, 2, 5, 10)), key=lambda s: abs(s - rough))
    for time in np.arange(np.ceil(times[0] / step) * step, times[-1] + 1e-9 * step, step):
        at = int(np.argmin(np.abs(times - time)))
        along = xy[min(at + 2, len(xy) - 1)] - xy[max(at - 2, 0)]
        length = float(np.hypot(*along))
        across = np.array([along[1], -along[0]]) / length if length > 0 else np.array([1.0, 0.0])
        ax.plot(*xy[at], "o", color=TRUTH_COLOUR, markersize=2.8, zorder=7)
        style: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "center", "fontsize": 7}
        where = (17 * across[0], 12 * across[1])
        ax.annotate(f"{time:g} s", (xy[at, 0], xy[at, 1]), xytext=where, zorder=8, path_effects=_halo(), **style)


def _halo() -> list[Any]:
    """What keeps text readable on top of lines."""
    from matplotlib.patheffects import withStroke  # noqa: PLC0415

    return [withStroke(linewidth=2.0, foreground="white")]


def draw_depth(ax: Axes, run: FilterRun, truth: FloatArray | None, smoothed: SmoothedRun | None) -> None:
    """Depth in its 2-sigma band."""
    std = 2.0 * np.sqrt(run.covs[:, 2, 2])
    times, middle, reach = _broken(np.stack([run.times, run.means[:, 2], std], axis=1), run).T
    ax.fill_between(times, middle - reach, middle + reach, color=FILTERED_COLOUR, alpha=0.25, linewidth=0)
    if smoothed is not None:
        ax.plot(times, _broken(smoothed.means[:, 2:3], run)[:, 0], color=SMOOTHED_COLOUR, linewidth=1.0)
    ax.plot(times, middle, color=FILTERED_COLOUR, linewidth=1.2)
    if truth is not None:
        ax.plot(run.times, truth[:, 2], "--", color=TRUTH_COLOUR, linewidth=0.9)
    ax.invert_yaxis()
    ax.set_ylabel("depth (m), 2 sigma", fontsize=8)
    tidy(ax)


def _broken(rows: FloatArray, run: FilterRun) -> FloatArray:
    """The rows with a gap before every restart, so that no line is drawn across it."""
    return np.insert(rows, list(run.restarts), np.nan, axis=0)


def draw_error(ax: Axes, run: FilterRun, truth: FloatArray, smoothed: SmoothedRun | None, dims: int) -> None:
    """Distance from the truth, and the rms that the covariance promises."""
    promised = np.sqrt(np.trace(run.covs[:, :dims, :dims], axis1=1, axis2=2))
    errors = np.linalg.norm(run.means[:, :dims] - truth, axis=1)
    ax.plot(run.times, errors, color=FILTERED_COLOUR, linewidth=1.0)
    ax.plot(run.times, promised, ":", color=FILTERED_COLOUR, linewidth=1.4, label="rms that the covariance promises")
    if smoothed is not None:
        ax.plot(
            run.times,
            np.linalg.norm(smoothed.means[:, :dims] - truth, axis=1),
            color=SMOOTHED_COLOUR,
            linewidth=1.0,
        )
    known = errors[np.isfinite(errors)]
    if len(known) and known.max() > 30.0 * np.median(known) > 0.0:  # a track once lost would hide everything else
        ax.set_yscale("log")
    else:
        ax.set_ylim(bottom=0.0)
    ax.set_ylabel("error (m)", fontsize=8)
    tidy(ax)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.96), fontsize=7, frameon=False)


def draw_verdicts(ax: Axes, run: FilterRun, channels: list[str]) -> None:
    """A strip per channel: used, rejected or, left white, missing."""
    from matplotlib.colors import ListedColormap  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    shade = np.select([run.verdicts.T == Verdict.USED, run.verdicts.T == Verdict.REJECTED], [1, 2], 0)
    # A measurement's cell ends half way to its neighbours; a single one is a second long.
    gaps = np.diff(run.times) if len(run) > 1 else np.ones(1)
    edges = np.concatenate([run.times - np.append(gaps[0], gaps)[: len(run)] / 2.0, run.times[-1:] + gaps[-1] / 2.0])
    colours = ListedColormap(["white", USED_COLOUR, REJECTED_COLOUR])
    ax.pcolormesh(edges, np.arange(len(channels) + 1) - 0.5, shade, cmap=colours, vmin=0, vmax=2)
    ax.set_yticks(range(len(channels)), channels)
    ax.set_ylim(len(channels) - 0.5, -0.5)
    for line in np.arange(1, len(channels)) - 0.5:
        ax.axhline(line, color="white", linewidth=2.0)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(labelsize=8)
    ax.tick_params(axis="y", length=0)
    for row in run.restarts:
        ax.axvline(run.times[row], color=RESTART_COLOUR, linewidth=1.4)
    handles: list[Any] = [
        Patch(color=USED_COLOUR, label="used"),
        Patch(color=REJECTED_COLOUR, label="rejected"),
        Patch(facecolor="white", edgecolor="#999999", label="missing"),
    ]
    ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.34), ncols=3, frameon=False, fontsize=8)


def draw_restarts(ax: Axes, run: FilterRun) -> None:
    """A vertical line at every restart."""
    for row in run.restarts:
        ax.axvline(run.times[row], color=RESTART_COLOUR, linewidth=1.0, zorder=1)
