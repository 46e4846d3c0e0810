"""A set of points in cells, and the decision graph that density peaks are chosen by."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs._arrays import array
from trackrs.errors import DimensionError
from trackrs.partition import TwoLevels
from trackrs.plot._figure import COLOURS, TRUTH_COLOUR, new_figure, tidy

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    from trackrs._arrays import IntArray
    from trackrs.partition import DecisionGraph

MARKERS = "os^D"  # the next one when the colours are used up
ALONE_COLOUR = "#8A8A8A"
ALONE = "clutter, or alone"


def plot_partition(
    points: ArrayLike,
    labels: ArrayLike,
    *,
    title: str = "",
    axis_labels: Sequence[str] = ("x (m)", "y (m)"),
    ax: Axes | None = None,
) -> Axes:
    """Draw points in the colours of their cells; clutter, and what is a cell of its own, as crosses.

    Args:
        points: (n, d), d at least 2; the first two components are drawn.
        labels: the cell of every point (n,), -1 = clutter: as `fit_predict` gives them, a row of `Partitions.labels`,
            or the `labels` that `explain` keeps, whose colours are those of `plot_decision_graph`.
        title: of the picture.
        axis_labels: of the two components.
        ax: draw here instead of in a new figure.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed; the message says how to.
        DimensionError: there are fewer than two components, or not as many labels as points.
    """
    xy = array(points, "points", 2)
    cells = np.asarray(labels, dtype=np.int64)
    if xy.shape[1] < 2:
        msg = f"points must have at least 2 columns, got {xy.shape[1]}"
        raise DimensionError(msg)
    if cells.shape != (len(xy),):
        msg = f"labels must have length {len(xy)}, that of points, got shape {cells.shape}"
        raise DimensionError(msg)
    ax = new_figure(layout="constrained", figsize=(6.0, 5.4)).add_subplot() if ax is None else ax
    alone = _alone(cells)
    _draw_cells(ax, xy[:, 0], xy[:, 1], cells, alone, size=16.0)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel(axis_labels[0])
    ax.set_ylabel(axis_labels[1])
    number = len(np.unique(cells[~alone]))
    _finish(ax, title or f"{number} cell{'s' * (number != 1)}")
    return ax


def plot_decision_graph(
    explained: DecisionGraph | TwoLevels,
    *,
    peak_distance: float | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Draw the decision graph of density peaks: distance to the nearest denser point over density.

    Peaks have the colours that `plot_partition` gives the cells of `explained.labels`, those of isolated points are
    crosses; after a `TwoLevelPartition` the peaks of joined cells share one colour. The distance is linear up to d_c,
    logarithmic beyond.

    Args:
        explained: what `explain` of a `DensityPeakPartition` or `TwoLevelPartition` returns.
        peak_distance: that of the partition, for the distance rule: its threshold is drawn.
        title: of the picture.
        ax: draw here instead of in a new figure.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed; the message says how to.
    """
    graph = explained.graph if isinstance(explained, TwoLevels) else explained
    ax = new_figure(layout="constrained", figsize=(6.0, 4.2)).add_subplot() if ax is None else ax
    others = np.setdiff1d(np.arange(len(graph.rho)), graph.peaks)
    style: dict[str, Any] = {"color": ALONE_COLOUR, "alpha": 0.7, "linewidths": 0.0, "zorder": 2}
    if len(others) > 0:
        ax.scatter(graph.rho[others], graph.delta[others], 10.0, label="other points", **style)
    cells, alone = explained.labels[graph.peaks], _alone(explained.labels)[graph.peaks]
    _draw_cells(ax, graph.rho[graph.peaks], graph.delta[graph.peaks], cells, alone, size=42.0, name="peak")
    if graph.d_c > 0.0:
        ax.set_yscale("symlog", linthresh=graph.d_c)
    if peak_distance is not None:
        level = peak_distance * graph.d_c
        style = {"color": TRUTH_COLOUR, "linewidth": 1.0, "zorder": 1}
        ax.axhline(level, linestyle="--", label=f"threshold, {peak_distance:g} d_c", **style)
    ax.set_ylim(bottom=0.0)
    ax.margins(x=0.03)
    ax.set_xlabel("density rho")
    ax.set_ylabel("delta, distance to the nearest denser point")
    _finish(ax, title)
    return ax


def _alone(cells: IntArray) -> NDArray[np.bool_]:
    """Which points share their cell with no other."""
    _, inverse, counts = np.unique(cells, return_inverse=True, return_counts=True)
    return np.asarray((counts[inverse] == 1) | (cells < 0), dtype=np.bool_)


def _draw_cells(
    ax: Axes,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    cells: IntArray,
    alone: NDArray[np.bool_],
    *,
    size: float,
    name: str = "cell",
) -> None:
    """Draw each cell in its own colour and marker, then what is alone."""
    for k, cell in enumerate(np.unique(cells[~alone]).tolist()):
        mine = (cells == cell) & ~alone
        marker = MARKERS[cell // len(COLOURS) % len(MARKERS)]
        style: dict[str, Any] = {"color": COLOURS[cell % len(COLOURS)], "linewidths": 0.0, "zorder": 3}
        ax.scatter(x[mine], y[mine], size, marker=marker, label="" if k else name, **style)
    if alone.any():
        style = {"color": ALONE_COLOUR, "linewidths": 0.9, "zorder": 3}
        ax.scatter(x[alone], y[alone], size, marker="x", label=ALONE, **style)


def _finish(ax: Axes, title: str) -> None:
    """Legend above the picture, title above it, grid."""
    ax.set_title(title, loc="left", fontsize="medium", pad=20.0)
    if ax.get_legend_handles_labels()[1]:
        place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
        ax.legend(ncols=4, frameon=False, fontsize=8, **place)
    tidy(ax)
