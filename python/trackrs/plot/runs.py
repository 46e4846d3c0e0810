"""The run of a filter over one target: where it went, what was rejected, and whether innovations and noise agree."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs._arrays import array
from trackrs.errors import DimensionError, ParameterError
from trackrs.gating import Gate
from trackrs.plot._figure import COLOURS, TRUTH_COLOUR, draw_ellipses, new_figure, semi_axes, tidy
from trackrs.runs import FilterRun, SmoothedRun, Verdict
from trackrs.sensor import RangeArray, Sensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from trackrs._arrays import FloatArray

FILTERED_COLOUR, REJECTED_COLOUR, SMOOTHED_COLOUR, RESTART_COLOUR = COLOURS[:4]
USED_COLOUR = "#D6E4EE"
SENSOR_COLOUR = "#5A5A5A"
MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
CLOCK = 8.0  # about so many points of the track have their time written beside them


def plot_run(
    run: FilterRun,
    *,
    sensor: Sensor | None = None,
    truth: ArrayLike | None = None,
    smoothed: SmoothedRun | None = None,
    title: str = "",
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw a run: from above, its depth, its error, and the verdict on every channel of every measurement.

    Ellipses are 2 sigma, magnified where they would be too small to see; the legend says how much. Crosses on the track
    mark the measurements of which something was rejected, diamonds and vertical lines the restarts.

    Args:
        run: at least two position components, with `history` other than "last".
        sensor: gives the channels their names, and a `RangeArray` its hydrophones.
        truth: (T, n) where the target really was, positions first.
        smoothed: of the same run.
        title: of the picture.
        axes: draw here instead of in a new figure: from above, then over time one for each of depth (in 3 dimensions),
            error (with `truth`) and verdicts (with a screen).

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed; the message says how to.
        ParameterError: the states have no position in the plane.
        DimensionError: `truth` does not fit the run, or there are not as many `axes` as panels.
    """
    if run.labels[:2] != ("x", "y"):
        msg = f"run is invalid: its states {' '.join(run.labels)} have no position x, y to draw"
        raise ParameterError(msg)
    dims = 3 if run.labels[2:3] == ("z",) else 2
    real = None if truth is None else _positions(truth, run, dims)
    rows = ["depth"] * (dims == 3) + ["error"] * (real is not None) + ["verdicts"] * (len(run.verdicts) > 0)
    if axes is None:
        axes = _panels(new_figure(layout="constrained", figsize=(10.0 if rows else 6.0, 5.4)), rows, title)
    plan, *strips = _require(axes, 1 + len(rows))
    _draw_plan(plan, run, sensor, real, smoothed)
    for name, ax in zip(rows, strips, strict=True):
        if name == "depth":
            _draw_depth(ax, run, real, smoothed)
        elif name == "error" and real is not None:
            _draw_error(ax, run, real, smoothed, dims)
        else:
            _draw_verdicts(ax, run, _channels(run, sensor))
        if name != "verdicts":
            _draw_restarts(ax, run)
    return (plan, *strips)


def plot_innovations(
    run: FilterRun,
    *,
    alpha: float = 0.01,
    sensor: Sensor | None = None,
    values: ArrayLike | None = None,
    title: str = "",
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Draw the innovations of every channel in their 2-sigma band and the chi-square test of every measurement.

    Args:
        run: with `history="full"` if `values` are given.
        alpha: the line in the test's panel is exceeded with this probability if the model is right.
        sensor: gives the channels their names.
        values: (T, m) the measurements of the run; with them and `sensor` rejected channels are drawn as well, at the
            panel's edge where they lie beyond it.
        title: of the picture.
        axes: draw here instead of in a new figure: one for each channel, and one for the test.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed; the message says how to.
        DimensionError: `values` do not fit the run, or there are not as many `axes` as panels.
    """
    channels = _channels(run, sensor)
    if axes is None:
        figure = new_figure(layout="constrained", figsize=(9.0, 1.1 * len(channels) + 2.2))
        axes = figure.subplots(len(channels) + 1, 1, sharex=True, height_ratios=[1.0] * len(channels) + [1.4]).tolist()
        figure.align_ylabels(axes)
    axes = _require(axes, len(channels) + 1)
    stds = np.sqrt(np.diagonal(run.innovation_covs, axis1=1, axis2=2))
    rejected = _rejected_innovations(run, sensor, values)
    for i, (ax, name) in enumerate(zip(axes, channels, strict=False)):
        ax.fill_between(run.times, -2 * stds[:, i], 2 * stds[:, i], color=USED_COLOUR, linewidth=0, label="2 sigma")
        ax.plot(run.times, run.innovations[:, i], ".", color=FILTERED_COLOUR, markersize=3.5, label="innovation")
        reach = 2.4 * float(np.nanmax(stds[:, i], initial=1e-300))
        inside = run.innovations[:, i][np.isfinite(run.innovations[:, i])]
        reach = max(reach, 1.1 * float(np.max(np.abs(inside), initial=0.0)))
        ax.set_ylim(-reach, reach)
        if rejected is not None:
            shown = np.clip(rejected[:, i], -0.9 * reach, 0.9 * reach)
            for marker, where in (
                ("x", shown == rejected[:, i]),
                ("^", shown < rejected[:, i]),
                ("v", shown > rejected[:, i]),
            ):
                label = "rejected (triangle: beyond the panel)" if marker == "^" else None
                style: dict[str, Any] = {"color": REJECTED_COLOUR, "markersize": 4.5}
                ax.plot(run.times[where], shown[where], marker, label=label, **style)
        ax.set_ylabel(_with_unit(name), fontsize=8)
    test = axes[-1]
    tested = len(run.statistics) > 0
    statistics = run.statistics if tested else run.nis
    dof = np.sum(run.verdicts != Verdict.MISSING, axis=1) if tested else run.dof
    limits = np.array([Gate(1.0 - alpha).threshold(int(d)) if d > 0 else np.nan for d in dof])
    test.plot(run.times, statistics, ".", color=FILTERED_COLOUR, markersize=3.5)
    test.plot(run.times, limits, color=REJECTED_COLOUR, linewidth=1.0, label=f"exceeded with probability {alpha:g}")
    test.set_yscale("log")
    test.tick_params(which="both", labelsize=8)
    test.set_ylabel("test statistic" if tested else "NIS", fontsize=8)
    test.set_xlabel("time (s)", fontsize=8)
    test.legend(loc="lower right", fontsize=7, framealpha=0.9)
    for ax in axes:
        tidy(ax)
        _draw_restarts(ax, run)
    handles, names = axes[0].get_legend_handles_labels()
    axes[0].set_title(title, loc="left", fontsize="medium", pad=10)
    axes[0].legend(
        handles, names, loc="lower right", bbox_to_anchor=(1.0, 1.02), ncols=len(names), frameon=False, fontsize=8
    )
    return axes


def plot_noise(
    run: FilterRun, *, sensor: Sensor | None = None, title: str = "", axes: Sequence[Axes] | None = None
) -> tuple[Axes, ...]:
    """Draw the standard deviations that a run with `adapt` was working with: of the motion above, of the sensor below.

    Args:
        run: of a filter with `adapt`.
        sensor: gives the channels their names and the values that R began with.
        title: of the picture.
        axes: draw here instead of in a new figure: of the motion, and of the sensor.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed; the message says how to.
        ParameterError: the run was made without `adapt`.
        DimensionError: there are not two `axes`.
    """
    if len(run.q_hat) == 0:
        msg = "run is invalid: it was made without adapt=, so that it has no estimates of the noise"
        raise ParameterError(msg)
    if axes is None:
        figure = new_figure(layout="constrained", figsize=(9.0, 5.0))
        figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
        axes = figure.subplots(2, 1, sharex=True).tolist()
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter  # noqa: PLC0415

    upper, lower = _require(axes, 2)
    estimated = slice(run.start if len(run) > run.start else 0, None)
    dims = run.q_hat.shape[1]
    unit = {1: "m/s", 2: "m/s²", 3: "m/s³"}.get(len(run.labels) // dims, "unit of the input")
    parts = (
        (upper, run.q_hat, [f"axis {name}" for name in run.labels[:dims]], f"motion, root of Q ({unit})"),
        (lower, run.r_hat, [_with_unit(name) for name in _channels(run, sensor)], "sensor, root of R"),
    )
    for ax, covs, names, label in parts:
        stds = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))[estimated]
        for colour, name, std in zip(cycle(COLOURS), names, stds.T, strict=False):
            ax.plot(run.times[estimated], std, color=colour, linewidth=1.3, label=name)
        low, high = float(stds.min(initial=np.inf)), float(stds.max(initial=-np.inf))
        # At least a factor of five, so that what hardly changes looks like it.
        middle, reach = np.sqrt(low * high), max(1.1 * np.sqrt(high / low), np.sqrt(5.0))
        ax.set_yscale("log")
        ax.set_ylim(middle / reach, middle * reach)
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set_ylabel(label, fontsize=8)
        tidy(ax)
        _draw_restarts(ax, run)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    lower.set_xlabel("time (s)", fontsize=8)
    return (upper, lower)


def _require(axes: Sequence[Axes], count: int) -> tuple[Axes, ...]:
    """The axes, if there are as many as panels."""
    if len(axes) == count:
        return tuple(axes)
    msg = f"axes has length {len(axes)}, the picture has {count} panels"
    raise DimensionError(msg)


def _panels(figure: Figure, rows: list[str], title: str) -> list[Axes]:
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


def _draw_plan(
    ax: Axes, run: FilterRun, sensor: Sensor | None, truth: FloatArray | None, smoothed: SmoothedRun | None
) -> None:
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


def _draw_depth(ax: Axes, run: FilterRun, truth: FloatArray | None, smoothed: SmoothedRun | None) -> None:
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


def _draw_error(ax: Axes, run: FilterRun, truth: FloatArray, smoothed: SmoothedRun | None, dims: int) -> None:
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


def _draw_verdicts(ax: Axes, run: FilterRun, channels: list[str]) -> None:
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


def _draw_restarts(ax: Axes, run: FilterRun) -> None:
    for row in run.restarts:
        ax.axvline(run.times[row], color=RESTART_COLOUR, linewidth=1.0, zorder=1)


def _channels(run: FilterRun, sensor: Sensor | None) -> list[str]:
    count = run.innovations.shape[1]
    return [f"channel {i}" for i in range(count)] if sensor is None else list(sensor.labels)


def _with_unit(channel: str) -> str:
    """The channel with its unit, as the sensors of this library name them."""
    units = {"range": "m", "depth": "m", "time": "s", "bearing": "rad", "x": "m", "y": "m", "z": "m"}
    unit = units.get(channel.rstrip("0123456789"))
    return channel if unit is None else f"{channel} ({unit})"


def _positions(truth: ArrayLike, run: FilterRun, dims: int) -> FloatArray:
    out = array(truth, "truth", 2)
    if out.shape[0] != len(run) or out.shape[1] < dims:
        msg = f"truth has shape {out.shape}, the run needs ({len(run)}, {dims} or more)"
        raise DimensionError(msg)
    return out[:, :dims]


def _rejected_innovations(run: FilterRun, sensor: Sensor | None, values: ArrayLike | None) -> FloatArray | None:
    """What was measured minus what was predicted, where it was rejected; else NaN."""
    if sensor is None or values is None or len(run.verdicts) == 0:
        return None
    given = array(values, "values", 2)
    if given.shape != run.innovations.shape or len(run.predicted_means) != len(run):
        msg = f'values have shape {given.shape}, the run {run.innovations.shape}; it must have history="full"'
        raise DimensionError(msg)
    out = np.full(given.shape, np.nan)
    for row in np.flatnonzero((run.verdicts == Verdict.REJECTED).any(axis=1)):
        where = run.verdicts[row] == Verdict.REJECTED
        out[row, where] = (given[row] - sensor.observe(run.predicted_means[row]))[where]
    return out
