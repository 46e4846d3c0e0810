"""Pictures of tracks, of filter runs and of partitions. Needs matplotlib: `pip install "trackrs[plot]"`.

Every function takes axes, draws in a new figure where none are given, and returns the axes; several panels are a tuple.
Nothing goes through pyplot, so that nothing global is touched: `plot_tracks(tracks).figure.savefig("tracks.png")`.
"""

from trackrs.plot._figure import require_matplotlib
from trackrs.plot.partitions import plot_decision_graph, plot_partition
from trackrs.plot.runs import plot_innovations, plot_noise, plot_run
from trackrs.plot.tracks import detection_positions, plot_tracks

__all__ = [
    "detection_positions",
    "plot_decision_graph",
    "plot_innovations",
    "plot_noise",
    "plot_partition",
    "plot_run",
    "plot_tracks",
    "require_matplotlib",
]
