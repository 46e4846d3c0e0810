"""The run of a filter over one target: where it went, what was rejected, and whether innovations and noise agree."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs._arrays import array
from trackrs.errors import DimensionError, ParameterError
from trackrs.gating import Gate
from trackrs.plot._figure import COLOURS, new_figure, tidy
from trackrs.plot._panels import (
    FILTERED_COLOUR,
    REJECTED_COLOUR,
    USED_COLOUR,
    draw_depth,
    draw_error,
    draw_plan,
    draw_restarts,
    draw_verdicts,
    panels,
)
from trackrs.runs import FilterRun, SmoothedRun, Verdict

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

    from trackrs._arrays import FloatArray
    from trackrs.sensor import Sensor


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
        axes = panels(new_figure(layout="constrained", figsize=(10.0 if rows else 6.0, 5.4)), rows, title)
    plan, *strips = _require(axes, 1 + len(rows))
    draw_plan(plan, run, sensor, real, smoothed)
    for name, ax in zip(rows, strips, strict=True):
        if name == "depth":
            draw_depth(ax, run, real, smoothed)
        elif name == "error" and real is not None:
            draw_error(ax, run, real, smoothed, dims)
        else:
            draw_verdicts(ax, run, _channels(run, sensor))
        if name != "verdicts":
            draw_restarts(ax, run)
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
        draw_restarts(ax, run)
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
        draw_restarts(ax, run)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    lower.set_xlabel("time (s)", fontsize=8)
    return (upper, lower)


def _require(axes: Sequence[Axes], count: int) -> tuple[Axes, ...]:
    """The axes, if there are as many as panels."""
    if len(axes) == count:
        return tuple(axes)
    msg = f"axes has length {len(axes)}, the picture has {count} panels"
    raise DimensionError(msg)


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
