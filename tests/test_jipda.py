"""JIPDA: tracks begin, are confirmed and end by the probability that there is a target."""

from __future__ import annotations

import numpy as np
import pytest

import trackrs as tr
from trackrs.io import read_tracks, write_tracks

SENSORS = {"radar": tr.PositionSensor(dims=2, std=5.0)}
AREA = 1e6


def make_tracker(clutter=20.0, **changes):
    rule = {"max_speed": 25.0, "initial": 0.05 / (0.05 + clutter), "drop": 1e-4, "lifetime": 300.0}
    return tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_psd=0.2),
        SENSORS,
        tr.Existence(**(rule | changes)),
        associator=tr.JIPDA(),
        detection_probability=0.9,
        clutter_density=clutter / AREA,
    )


def make_scans(seed, clutter=20.0, steps=60, targets=4):
    """Targets that cross a square of 1 km, each seen nine times in ten, and false reports."""
    rng = np.random.default_rng(seed)
    starts = rng.uniform(200.0, 800.0, (targets, 2))
    velocities = rng.uniform(-8.0, 8.0, (targets, 2))
    scans, truth = [], []
    for k in range(steps):
        places = starts + k * velocities
        seen = places[rng.random(targets) < 0.9]
        false = rng.uniform(0.0, 1000.0, (rng.poisson(clutter), 2))
        scans.append(tr.Scan(float(k), np.concatenate([seen + rng.normal(0, 5.0, seen.shape), false]), "radar"))
        truth.append(places)
    return scans, truth


def test_what_it_confirms_is_there():
    """At most 5 % of the tracks confirmed at 0.95 are false, within two standard deviations."""
    confirmed = false = held = 0
    for seed in range(12):
        scans, truth = make_scans(seed)
        tracks = make_tracker().run(scans)
        assert tracks.existences is not None
        assert ((tracks.existences > 0.0) & (tracks.existences <= 1.0)).all()
        for history in tracks.history.values():
            near = [
                np.linalg.norm(truth[int(track.state.time)] - track.state.mean[:2], axis=1).min() < 40.0
                for track in history
            ]
            confirmed += 1
            false += np.mean(near) < 0.5
        last = tracks.of_scan(len(scans) - 1)
        held += sum(any(np.linalg.norm(place - track.state.mean[:2]) < 40.0 for track in last) for place in truth[-1])
    assert false / confirmed <= 0.05 + 2 * np.sqrt(0.05 * 0.95 / confirmed)
    assert held >= 0.9 * 12 * 4


def test_a_target_that_leaves_is_dropped_and_empty_scans_count():
    scans = [tr.Scan(float(k), [[5.0 * k, 0.0]] if k < 20 else [], "radar") for k in range(30)]
    tracks = make_tracker(0.1).run(scans)
    existence = [[track.existence for track in tracks.of_scan(k)] for k in range(30)]
    assert existence[19][0] > 0.99
    falling = [values[0] for values in existence[19:] if values]
    assert (np.diff(falling) < 0.0).all()
    assert existence[-1] == []
    # A miss multiplies the odds by 1 - P_D P_G.
    odds = [r / (1 - r) for r in falling]
    survival = np.exp(-1.0 / 300.0)
    expected = falling[0] * survival
    expected = expected * (1 - 0.9 * 0.99) / (1 - expected * 0.9 * 0.99)
    assert odds[1] == pytest.approx(expected / (1 - expected), rel=1e-9)


def test_existence_decays_with_the_lifetime():
    tracker = make_tracker(0.1, lifetime=10.0)
    tracker.run([tr.Scan(float(k), [[0.0, 0.0]], "radar") for k in range(10)])
    before = next(iter(tracker.step(tr.Scan(10.0, [[0.0, 0.1]], "radar")))).existence
    other = tr.MultiTargetTracker.from_bytes(tracker.to_bytes())
    # A report far off: nothing but the time and the miss lower it.
    soon = next(iter(tracker.step(tr.Scan(10.0, [[400.0, 0.0]], "radar")))).existence
    late = next(iter(other.step(tr.Scan(14.0, [[400.0, 0.0]], "radar")))).existence
    miss = 1 - 0.9 * 0.99

    def after(r):
        return r * miss / (1 - r * (1 - miss))

    assert soon == pytest.approx(after(before), rel=1e-9)
    assert late == pytest.approx(after(before * np.exp(-0.4)), rel=1e-9)


def test_one_target_with_two_echoes_is_one_track():
    rng = np.random.default_rng(3)
    scans = [
        tr.Scan(float(k), np.array([[6.0 * k, -8.0], [6.0 * k, 8.0]]) + rng.normal(0, 2.0, (2, 2)), "radar")
        for k in range(40)
    ]
    assert len(np.unique(make_tracker(1.0).run(scans).ids)) == 2
    assert len(np.unique(make_tracker(1.0, min_separation=30.0).run(scans).ids)) == 1


def test_a_report_that_is_explained_starts_no_track_of_weight():
    """A tentative track competes: one target never becomes two."""
    scans = [tr.Scan(float(k), [[6.0 * k, 0.0]], "radar") for k in range(40)]
    for clutter in (0.1, 1.0, 20.0):
        assert len(np.unique(make_tracker(clutter).run(scans).ids)) == 1


def test_existence_goes_into_tables_and_back(tmp_path):
    scans, _ = make_scans(1)
    tracks = make_tracker().run(scans)
    write_tracks(tracks, tmp_path / "tracks.csv")
    back = read_tracks(tmp_path / "tracks.csv")
    assert np.array_equal(back.existences, tracks.existences)
    assert "existence" in tracks.to_table()
    plain = tr.MultiTargetTracker(tr.ConstantVelocity(dims=2, accel_psd=0.2), SENSORS, tr.MofN(2, 3, 25.0)).run(
        scans[:5]
    )
    assert plain.existences is None
    assert "existence" not in plain.to_table()
    assert all(track.existence is None for track in plain)
