"""Pictures of partitions: what is drawn and where; that it looks good is for eyes."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import trackrs as tr
from trackrs.plot import plot_decision_graph, plot_partition

pytestmark = pytest.mark.filterwarnings("error")  # matplotlib warns of a layout that has no room

SCENE = tr.scenarios.crossing()
POINTS = SCENE.draw(seed=7, run=3).scans[39].values
NOISE = SCENE.sensor.noise()
GRAPH = tr.DensityPeakPartition().explain(POINTS, noise=NOISE)
ALONE = "clutter, or alone"


def drawn(axes):
    assert axes.figure.axes == [axes]
    axes.figure.savefig(io.BytesIO(), format="png")
    return axes


def legend(axes):
    found = axes.get_legend()
    return [] if found is None else [text.get_text() for text in found.get_texts()]


def clouds(axes):
    """The points of every cell and its colour; those of what is alone come last."""
    return [(np.asarray(part.get_offsets()), to_hex(part.get_facecolor()[0])) for part in axes.collections]


def of_cells(cells, *columns):
    """What the cells of more than one point should show, and what is alone."""
    sizes = np.bincount(cells)
    points = np.stack(columns, axis=1)
    return [points[cells == i] for i in np.flatnonzero(sizes > 1)], points[sizes[cells] == 1]


def test_partition_shows_every_cell_once():
    axes = drawn(plot_partition(POINTS, GRAPH.labels, axis_labels=("east (m)", "north (m)")))
    cells, alone = of_cells(GRAPH.labels, *POINTS.T)
    found = clouds(axes)
    assert len(found) == len(cells) + 1 == 4
    for (points, _), expected in zip(found, [*cells, alone], strict=True):
        assert np.array_equal(points, expected)
    assert len({colour for _, colour in found}) == 4
    assert legend(axes) == ["cell", ALONE]
    assert axes.get_title(loc="left") == "3 cells"
    assert axes.get_xlabel() == "east (m)"
    assert axes.get_aspect() == 1.0


def test_decision_graph_has_the_colours_of_the_cells():
    axes = drawn(plot_decision_graph(GRAPH, peak_distance=2.0, title="scan 40"))
    assert legend(axes) == ["other points", "peak", ALONE, "threshold, 2 d_c"]
    assert axes.get_title(loc="left") == "scan 40"
    (line,) = axes.lines
    assert line.get_ydata() == [40.0, 40.0]
    (others, _), *peaks, (isolated, _) = clouds(axes)
    assert np.all(others[:, 1] <= 40.0)
    assert np.all(np.vstack([*(points for points, _ in peaks), isolated])[:, 1] > 40.0)
    assert len(others) + len(peaks) + len(isolated) == len(POINTS)
    cells = clouds(drawn(plot_partition(POINTS, GRAPH.labels)))
    assert [colour for _, colour in peaks] == [colour for _, colour in cells[:-1]]
    for k, (points, _) in enumerate(peaks):
        peak = GRAPH.peaks[k]
        assert points.tolist() == [[GRAPH.rho[peak], GRAPH.delta[peak]]]


def test_joined_cells_share_a_colour():
    rng = np.random.default_rng(3)
    points = np.column_stack([np.arange(60.0), rng.normal(0.0, 0.3, 60)])
    levels = tr.TwoLevelPartition(d_c=2.0, beta=0.5).explain(points)
    assert len(levels.graph.peaks) > 2
    assert levels.labels.max() == 0
    (others, _), (peaks, _) = clouds(drawn(plot_decision_graph(levels)))
    assert (len(others), len(peaks)) == (60 - len(levels.graph.peaks), len(levels.graph.peaks))


def test_labels_as_scikit_learn_has_them():
    points = [[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [9.0, 9.0, 5.0]]
    axes = drawn(plot_partition(points, [0, 0, -1], title="one"))
    assert [part.tolist() for part, _ in clouds(axes)] == [[[0.0, 0.0], [1.0, 0.0]], [[9.0, 9.0]]]
    assert axes.get_title(loc="left") == "one"


def test_more_cells_than_colours():
    points = np.repeat(np.arange(18.0), 2)[:, None] * [1.0, 0.5]
    axes = drawn(plot_partition(points, np.repeat(np.arange(18), 2)))
    looks = {(to_hex(part.get_facecolor()[0]), part.get_paths()[0].vertices.tobytes()) for part in axes.collections}
    assert len(looks) == 18


def test_nothing_to_draw():
    empty = np.zeros((0, 2))
    assert legend(drawn(plot_partition(empty, []))) == []
    drawn(plot_decision_graph(tr.DensityPeakPartition(d_c=1.0).explain(empty), peak_distance=2.0))
    one = tr.DensityPeakPartition(d_c=1.0).explain([[1.0, 2.0]])
    assert legend(drawn(plot_decision_graph(one))) == [ALONE]
    same = tr.DensityPeakPartition(percent=2.0).explain(np.ones((5, 2)))
    assert legend(drawn(plot_decision_graph(same))) == ["other points", "peak"]


def test_own_axes():
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert plot_partition(POINTS, GRAPH.labels, ax=left) is left
    assert plot_decision_graph(GRAPH, ax=right) is right
    assert len(left.collections) == 4
    assert len(right.collections) == 5
    assert "matplotlib.pyplot" not in sys.modules


def test_mistakes_are_named(monkeypatch):
    with pytest.raises(tr.DimensionError, match="at least 2 columns, got 1"):
        plot_partition([[1.0]], [0])
    with pytest.raises(tr.DimensionError, match="labels must have length 2"):
        plot_partition([[1.0, 2.0], [3.0, 4.0]], [0])
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r'pip install "trackrs\[plot\]"'):
        plot_decision_graph(GRAPH)
    with pytest.raises(ImportError, match=r'pip install "trackrs\[plot\]"'):
        plot_partition(POINTS, GRAPH.labels)
