"""Pictures: what is drawn and where; that it looks good is for eyes."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

import trackrs as tr
from trackrs.plot import detection_positions, plot_tracks

SENSORS = {
    "radar": tr.PositionSensor(dims=2, std=1.0),
    "sonar": tr.RangeBearing(position=(1.0, 0.0), range_std=1.0, bearing_std=0.01),
    "speed": tr.LinearSensor([[0.0, 0.0, 1.0, 0.0]], [[1.0]]),
}


@pytest.fixture(scope="module")
def scans():
    rng = np.random.default_rng(5)
    boats = [np.array([[5.0 * k, 0.0], [100.0, 60.0 + 3.0 * k]]) + rng.normal(0.0, 1.0, (2, 2)) for k in range(40)]
    return [tr.Scan(float(k), values, "radar") for k, values in enumerate(boats)]


@pytest.fixture(scope="module")
def tracks(scans):
    motion = tr.ConstantVelocity(dims=2, accel_psd=0.1)
    sensors = {"radar": SENSORS["radar"]}
    return tr.MultiTargetTracker(motion, sensors, initiator=tr.MofN(2, 3, max_speed=20.0)).run(scans)


TRUTH = [
    tr.Truth("a", [0.0, 39.0], [[0.0, 0.0], [195.0, 0.0]]),
    tr.Truth("b", [0.0, 39.0], [[100.0, 60.0], [100.0, 177.0]]),
]


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_detections_in_the_plane():
    nan = np.nan
    scans = [
        tr.Scan(0.0, [[1.0, 2.0], [nan, 3.0]], "radar", platform=[10.0, 20.0]),
        tr.Scan(0.0, [], "radar"),
        tr.Scan(1.0, [[3.0, 4.0]], "radar"),
        tr.Scan(1.0, [[2.0, np.pi / 2], [1.0, nan]], "sonar", platform=[10.0, 20.0]),
        tr.Scan(2.0, [[7.0]], "speed"),
    ]
    found = detection_positions(scans, SENSORS)
    assert found.keys() == {"radar", "sonar"}
    assert found["radar"].tolist() == [[11.0, 22.0], [3.0, 4.0]]
    assert np.allclose(found["sonar"], [[11.0, 22.0]])
    observed = SENSORS["sonar"].observe([11.0, 22.0, 0.0, 0.0], platform=[10.0, 20.0])
    assert np.allclose(observed, [2.0, np.pi / 2])


def test_everything_is_drawn(scans, tracks):
    own = np.stack([np.linspace(40.0, 60.0, 40), np.full(40, 20.0)], axis=1)
    axes = plot_tracks(
        tracks,
        detections=detection_positions(scans, SENSORS),
        truth=TRUTH,
        own_ship=own,
        region=90.0,
        title="two boats",
        labels=("north (m)", "east (m)"),
    )
    figure = axes.figure
    assert isinstance(figure, Figure)
    assert figure.axes == [axes]
    assert legend(axes) == [
        "radar",
        "truth (dot: its start)",
        "own ship (diamond: end)",
        "region (90 m)",
        "track and its id",
        "2 sigma",
    ]
    assert sorted(text.get_text() for text in axes.texts) == ["1", "2"]
    assert axes.get_xlabel() == "north (m)"
    assert axes.get_title(loc="left") == "two boats"
    assert axes.get_aspect() == 1.0
    figure.savefig(io.BytesIO(), format="png")
    assert axes.get_legend().get_window_extent().x0 > axes.get_window_extent().x1


def test_ellipses_hold_two_sigma_and_do_not_overlap(tracks):
    axes = plot_tracks(tracks)
    ellipses = axes.patches
    assert 8 < len(ellipses) < len(tracks) / 2
    for ellipse in ellipses:
        row = np.flatnonzero(np.all(tracks.means[:, :2] == ellipse.center, axis=1))
        std = np.sqrt(np.linalg.eigvalsh(tracks.covs[row[0], :2, :2]))
        assert np.allclose(sorted([ellipse.width, ellipse.height]), 4.0 * std)
    centres = np.array(
        [ellipse.center for ellipse in ellipses if ellipse.get_edgecolor() == ellipses[0].get_edgecolor()]
    )
    widths = np.array([ellipse.width for ellipse in ellipses][: len(centres)])
    gaps = np.hypot(*np.diff(centres, axis=0).T)
    assert np.all(gaps >= (widths[1:] + widths[:-1]) / 2 * 0.999)


def test_swapped_axes(tracks):
    axes = plot_tracks(tracks, labels=("north (m)", "east (m)"), swap_axes=True)
    assert axes.get_xlabel() == "east (m)"
    line = axes.lines[0].get_xydata()
    first = tracks.ids == tracks.ids[0]
    assert np.array_equal(line, tracks.means[first][:, [1, 0]])


def test_limits_hold_tracks_and_truth(tracks):
    axes = plot_tracks(tracks, truth=TRUTH, detections={"radar": [[9999.0, 9999.0]]})
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < 0.0
    assert 195.0 < right < 300.0
    assert bottom < 0.0
    assert 177.0 < top < 300.0


def test_own_axes(tracks):
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert plot_tracks(tracks, ax=right) is right
    assert len(left.lines) == 0
    assert len(right.lines) == 2


def test_nothing_to_draw():
    tracker = tr.MultiTargetTracker(tr.ConstantVelocity(dims=2, accel_psd=0.1), SENSORS, initiator=tr.MofN(2, 3, 9.0))
    empty = tracker.run([tr.Scan(0.0, [], "radar")])
    for more in ({}, {"detections": {"radar": [[1.0, 2.0]]}}, {"detections": {"radar": np.zeros((0, 2))}}):
        axes = plot_tracks(empty, **more)
        assert len(axes.patches) == 0


def test_nothing_global_is_touched(tracks):
    plot_tracks(tracks)
    assert "matplotlib.pyplot" not in sys.modules


def test_without_matplotlib(tracks, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r'pip install "trackrs\[plot\]"'):
        plot_tracks(tracks)
