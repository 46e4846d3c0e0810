"""Figures of one look."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from trackrs.plot._figure import COLOURS, new_figure
from trackrs.plot._figure import tidy as tidy_axes
from trackrs.reproduce._records import Picture

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from trackrs.study import Band, StudyResult

DPI = 110  # a page holds many


def sheet(width: float, height: float) -> Figure:
    """Return an empty figure, inches."""
    figure = new_figure(figsize=(width, height), layout="constrained")
    figure.set_dpi(DPI)
    return figure


def tidy(ax: Axes, x: str = "", y: str = "", title: str = "") -> Axes:
    """Name the axes; draw a light grid and no box."""
    tidy_axes(ax)
    ax.set_xlabel(x, fontsize=8)
    ax.set_ylabel(y, fontsize=8)
    ax.set_title(title, fontsize=9, loc="left")
    return ax


def save(figure: Figure | SubFigure, folder: Path, name: str, title: str) -> Picture:
    """Keep a figure as PNG."""
    path = folder / f"{name}.png"
    cast("Figure", figure).savefig(path)
    return Picture(title, path)


def draw_band(ax: Axes, band: Band, label: str, colour: str) -> None:
    """Draw a mean with its interval."""
    ax.plot(band.times, band.mean, color=colour, linewidth=1.2, label=label)
    ax.fill_between(band.times, band.mean - band.half_width, band.mean + band.half_width, color=colour, alpha=0.15)


def draw_over_time(ax: Axes, result: StudyResult, column: str, names: list[str] | None = None) -> None:
    """Draw a column of all methods, or of some."""
    for colour, one in zip(COLOURS * 2, result.methods, strict=False):
        if names is None or one.name in names:
            draw_band(ax, one.over_time(column), one.name, colour)
