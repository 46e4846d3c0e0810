"""Targets with an extent: what is learnt of shapes through the sensor's noise, where it stands, mistakes."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import trackrs as tr
from trackrs.io import read_tracks, write_tracks
from trackrs.scenarios import Ellipse, LShape, Rectangle, crossing

EXTENT = tr.Extent(axes=(60.0, 60.0))
SCENE = crossing([Ellipse(), Rectangle(), LShape()])


def extended(extent=EXTENT, sensor=None, **more):
    return tr.ExtendedGMPHD(
        SCENE.motion,
        sensor or tr.PositionSensor(dims=2, std=20.0),
        birth=tr.Birth(SCENE.births, weights=SCENE.birth_weight),
        clutter_density=SCENE.clutter_density,
        detections_per_target=SCENE.detections_per_target,
        extent=extent,
        **more,
    )


def of_target(tracks, scan, target):
    """The track nearest to a target."""
    place = SCENE.states[scan, target, :2]
    return min(tracks.of_scan(scan), key=lambda track: np.hypot(*(track.state.mean[:2] - place)))


def test_shapes_are_learnt_beside_the_noise():
    metric, axes, scores = tr.OSPA(c=60.0, p=2), [], []
    for run in range(12):
        tracks = extended(confirm_after=1).run(SCENE.draw(seed=7, run=run).scans)
        scores.append(tr.evaluate(SCENE.truth, tracks, metrics=[metric]).mean[metric])
        for scan in range(20, 40):
            velocity = SCENE.states[scan, 0, 2:]
            along = velocity / np.hypot(*velocity)
            across = np.array([-along[1], along[0]])
            extent = of_target(tracks, scan, 0).extent
            axes.append([4.0 * np.sqrt(e @ extent @ e) for e in (along, across)])
    assert np.mean(scores) <= 7.5
    assert np.median(axes, axis=0) == pytest.approx([80.0, 30.0], rel=0.2)


def test_where_extents_stand(tmp_path):
    scans = SCENE.draw(seed=1).scans[:30]
    tracker = extended().start()
    tracks = tracker.run(scans)
    assert tracks.extents.shape == (len(tracks), 2, 2)
    assert not tracks.extents.flags.writeable
    assert (np.linalg.eigvalsh(tracks.extents) > 0.0).all()
    assert np.array_equal(tracks.of_scan(29)[0].extent, tracks.extents[tracks.offsets[29]])
    assert tracker.mixture.extents.shape == (len(tracker.mixture), 2, 2)
    table = tracks.to_table()
    assert np.array_equal(table["extent_2_1"], tracks.extents[:, 1, 0])
    write_tracks(tracks, tmp_path / "tracks.csv")
    assert np.array_equal(read_tracks(tmp_path / "tracks.csv").extents, tracks.extents)

    plain = extended(None).start()
    found = plain.run(scans)
    assert found.extents is None
    assert plain.mixture.extents is None
    assert all(track.extent is None for track in found)
    assert "extent_1_1" not in found.to_table()


def test_a_saved_tracker_goes_on_with_its_extents():
    scans = SCENE.draw(seed=2).scans[:20]
    whole = extended().run(scans)
    tracker = extended().start()
    tracker.run(scans[:10])
    rest = pickle.loads(pickle.dumps(tracker)).run(scans[10:])
    assert np.array_equal(rest.extents, whole.extents[whole.offsets[10] :])


def test_targets_start_with_the_extent_of_the_newborn():
    tracker = extended().start([tr.GaussianState(SCENE.states[0, 0], np.eye(4), time=0.0)])
    assert tracker.mixture.extents == pytest.approx(np.diag([225.0, 225.0])[None])


def test_adaptive_birth_and_flat_partitions_learn_extents():
    scans = SCENE.draw(seed=3).scans[:25]
    more = [{"birth": tr.AdaptiveBirth(0.1, max_speed=60.0, min_measurements=4)}, {"partition": tr.DbscanPartition()}]
    for changes in more:
        tracks = extended().replace(**changes).run(scans)
        assert len(tracks.of_scan(24)) >= 2
        long_axis = 4.0 * np.sqrt(np.linalg.eigvalsh(of_target(tracks, 24, 0).extent)[1])
        assert 40.0 < long_axis < 130.0


@pytest.mark.parametrize(
    ("extent", "sensor", "fault"),
    [
        (EXTENT, tr.RangeBearing(position=(0, 0), range_std=20.0, bearing_std=1e-3), "linearly"),
        (tr.Extent(axes=(60.0, 0.0)), None, "axes"),
        (tr.Extent(axes=(60.0, 60.0), certainty=0.0), None, "certainty"),
        (tr.Extent(axes=(60.0, 60.0), time_constant=-1.0), None, "time constant"),
    ],
)
def test_mistakes_are_named(extent, sensor, fault):
    with pytest.raises(tr.ParameterError, match=fault):
        extended(extent, sensor)


def test_an_extent_has_the_dimensions_of_the_position():
    with pytest.raises(tr.DimensionError, match="extent"):
        extended(tr.Extent(axes=(60.0, 60.0, 60.0)))


def root(matrix):
    values, vectors = np.linalg.eigh(matrix)
    return vectors @ np.diag(np.sqrt(values)) @ vectors.T


def test_gospa_of_ellipses_is_that_of_wasserstein_distances():
    rng = np.random.default_rng(4)
    for d in (2, 3):
        places = rng.normal(size=(2, d)) * 5.0
        halves = rng.normal(size=(2, d, d)) * 3.0
        x, y = halves @ halves.transpose(0, 2, 1) + np.eye(d)
        square = np.sum((places[0] - places[1]) ** 2) + np.trace(x + y - 2.0 * root(root(x) @ y @ root(x)))
        found = tr.gospa(places[:1], places[1:], c=100.0, extents=(x[None], y[None]))
        assert found.total == pytest.approx(np.sqrt(square), rel=1e-9)
    none = tr.gospa([], places[1:], c=10.0, extents=([], y[None]))
    assert none.total == pytest.approx(np.sqrt(50.0))
    with pytest.raises(tr.DimensionError, match="extents"):
        tr.gospa(places[:1], places[1:], c=10.0, extents=([], y[None]))
    with pytest.raises(tr.NotPositiveDefiniteError):
        tr.gospa(places[:1], places[1:], c=10.0, extents=(x[None], 0.0 * y[None]))


def test_extents_are_drawn():
    pytest.importorskip("matplotlib")
    from trackrs.plot import plot_tracks

    tracks = extended().run(SCENE.draw(seed=1).scans[:30])
    axes = plot_tracks(tracks, extents=True)
    assert len(axes.patches) > 3
    for ellipse in axes.patches:
        row = np.flatnonzero(np.all(tracks.means[:, :2] == ellipse.center, axis=1))[0]
        whole = 4.0 * np.sqrt(np.linalg.eigvalsh(tracks.extents[row]))
        assert np.allclose(sorted([ellipse.width, ellipse.height]), whole)
    with pytest.raises(tr.ParameterError, match="extents"):
        plot_tracks(extended(None).run([]), extents=True)
