"""What all pictures share: colours, figures without pyplot, ellipses."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from trackrs._arrays import FloatArray

# Distinct on white, in print and for colour-blind readers (Okabe and Ito's order, without yellow and black).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7B3294", "#8C510A")
TRUTH_COLOUR = "#000000"
GRID_COLOUR = "#E3E3E3"
DPI = 150


def require_matplotlib() -> None:
    """Do nothing if matplotlib is installed.

    Raises:
        ImportError: it is not; the message says how to install it.
    """
    if find_spec("matplotlib") is None:
        raise ImportError('pictures need matplotlib: pip install "trackrs[plot]"', name="matplotlib")


def new_figure(**options: Any) -> Figure:  # noqa: ANN401 (those of matplotlib's figure)
    """Return an empty figure that can be saved."""
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 (only pictures need it)
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(dpi=DPI, **options)
    FigureCanvasAgg(figure)
    return figure


def tidy(ax: Axes) -> None:
    """Draw a light grid and no box."""
    ax.grid(color=GRID_COLOUR, linewidth=0.5, zorder=0)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8)


def semi_axes(covs: FloatArray) -> FloatArray:
    """Return the semi-axes of the 2-sigma ellipses of covariances (k, 2, 2), the shorter first (k, 2)."""
    return np.asarray(2.0 * np.sqrt(np.maximum(np.linalg.eigvalsh(covs), 0.0)), dtype=np.float64)


def draw_ellipses(
    ax: Axes, centres: FloatArray, covs: FloatArray, colour: str, spacing: float, scale: float = 1.0
) -> None:
    """Draw 2-sigma ellipses, the last one and those before it that neither overlap nor are closer than `spacing`."""
    from matplotlib.patches import Ellipse  # noqa: PLC0415

    drawn, reach = None, 0.0
    for centre, cov in zip(centres[::-1], covs[::-1], strict=True):
        variances, axes = np.linalg.eigh(cov)
        semi = 2.0 * scale * np.sqrt(np.maximum(variances, 0.0))
        if drawn is not None and np.hypot(*(centre - drawn)) < max(reach + semi[1], spacing):
            continue
        drawn, reach = centre, semi[1]
        angle = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
        style: dict[str, Any] = {"facecolor": (colour, 0.18), "edgecolor": (colour, 0.7), "linewidth": 0.7}
        ax.add_patch(Ellipse((centre[0], centre[1]), 2 * semi[1], 2 * semi[0], angle=angle, zorder=3, **style))
