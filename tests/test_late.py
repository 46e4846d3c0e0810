"""Scans out of order, clocks that jump, and the health of tracks, as their users see them."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trackrs as tr
from test_tracker import make_scans, make_tracker
from trackrs.config import ConfigError, load_config
from trackrs.io import read_tracks, write_tracks
from trackrs.io._files import TableError

WINDOW = 4.0
DROP = tr.DropLate()
NAMES = ("scan_times", "times", "ids", "means", "covs", "last_hits", "hits", "offsets", "healths", "expected_targets")


def make_phd(late=DROP):
    return tr.GMPHD(
        tr.ConstantVelocity(dims=2, accel_psd=0.2),
        {"radar": tr.PositionSensor(dims=2, std=2.0), "lidar": tr.PositionSensor(dims=2, std=0.5)},
        birth=tr.AdaptiveBirth(0.1, max_speed=20.0, min_measurements=1),
        clutter_density=1e-4,
        late=late,
    )


MAKERS = {
    "points": lambda late=DROP: make_tracker(late=late),
    "existence": lambda late=DROP: make_tracker(
        late=late, initiator=tr.Existence(20.0), associator=tr.JIPDA(), clutter_density=1e-4
    ),
    "one by one": lambda late=DROP: make_tracker(late=late, associator=tr.NPDA()),
    "intensity": lambda late=DROP: make_phd(late).start(),
}


def assert_same(a, b):
    assert a.sensors == b.sensors
    for name in NAMES:
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) is (y is None)
        assert x is None or np.array_equal(x, y), name


def shuffled(scans, seed):
    """None comes more than the window behind another."""
    keys = np.array([scan.time for scan in scans]) + np.random.default_rng(seed).uniform(0.0, WINDOW, len(scans))
    return [scans[k] for k in np.argsort(keys)]


def joined(parts):
    parts = [part for part in parts if len(part.scan_times)]
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in ("scan_times", "ids", "means")}


@pytest.mark.parametrize("policy", [tr.Reorder, tr.Replay])
@pytest.mark.parametrize("kind", MAKERS)
@given(seed=st.integers(0, 2**32), scene=st.integers(0, 20))
@settings(max_examples=8, deadline=None)
def test_any_order_within_the_window_gives_the_sorted_result(kind, policy, seed, scene):
    make = MAKERS[kind]
    scans = make_scans(scene, steps=40)
    expected = make().run(scans)
    mixed = shuffled(scans, seed)
    assert_same(make(policy(WINDOW)).run(mixed), expected)
    tracker = make(policy(WINDOW))
    parts = []
    for k, scan in enumerate(mixed):
        parts.append(tracker.step(scan))
        if policy is tr.Replay:
            sorted_so_far = make()
            found = sorted_so_far.run(sorted(mixed[: k + 1], key=lambda scan: scan.time))
            assert parts[-1].scan_times[0] == found.scan_times[-1]
            last = found.of_scan(k)
            assert [track.id for track in parts[-1]] == [track.id for track in last]
            for one, other in zip(parts[-1], last, strict=True):
                assert np.array_equal(one.state.mean, other.state.mean)
                assert np.array_equal(one.state.cov, other.state.cov)
            assert tracker.ledger == sorted_so_far.ledger
            assert tracker.event_counts == sorted_so_far.event_counts
            assert tracker.events == sorted_so_far.events
        ledger = tracker.ledger
        assert ledger.rows_in == sum(len(s.values) for s in mixed[: k + 1])
        total = ledger.used + ledger.late + ledger.duplicate + ledger.waiting + sum(ledger.rejected.values())
        assert ledger.rows_in == total
        if k % 11 == 5:
            data = tracker.to_bytes()
            tracker = type(tracker).from_bytes(data)
            assert tracker.to_bytes() == data
    parts.append(tracker.flush())
    assert tracker.ledger.waiting == 0
    if policy is tr.Reorder:
        found = joined(parts)
        for name, values in found.items():
            assert np.array_equal(values, getattr(expected, name))


@pytest.mark.parametrize("policy", [tr.Reorder, tr.Replay])
def test_what_comes_after_the_window_is_late_and_counted(policy):
    scans = make_scans(1)
    late = scans[3:6]
    tracker = make_tracker(late=policy(WINDOW))
    kept = [scan for scan in scans if scan not in late]
    found = tracker.run([*kept[:30], *late, *kept[30:]])
    assert_same(found, make_tracker().run(kept))
    assert tracker.ledger.late == sum(len(scan.values) for scan in late)
    assert tracker.event_counts["late_scan"] == 3
    assert "the window 4 s long" in tracker.events[0].reason


def test_scans_of_one_time_stand_by_sensor_and_twice_is_once():
    scans = make_scans(2, steps=30)
    double = [scan for pair in zip(scans, scans, strict=True) for scan in pair]
    other = [tr.Scan(scan.time, scan.values + 0.1, "lidar" if scan.sensor == "radar" else "radar") for scan in scans]
    both = sorted([*double, *other], key=lambda scan: (scan.time, scan.sensor))
    expected = make_tracker().run(both)
    for policy in (tr.Reorder, tr.Replay):
        tracker = make_tracker(late=policy(WINDOW))
        assert_same(tracker.run(shuffled(both, 3)), expected)
        assert tracker.ledger.duplicate == sum(len(scan.values) for scan in scans)


def test_reorder_waits_and_flush_ends_the_waiting():
    tracker = make_tracker(late=tr.Reorder(1.0))
    scans = make_scans(3, steps=6)  # every half second
    counts = [len(tracker.step(scan).scan_times) for scan in scans]
    assert counts == [0, 0, 0, 1, 1, 1]
    assert tracker.ledger.waiting == sum(len(scan.values) for scan in scans[3:])
    assert tracker.flush().scan_times.tolist() == [1.5, 2.0, 2.5]
    assert tracker.flush().scan_times.tolist() == []
    assert make_tracker().flush().scan_times.tolist() == []
    # What was flushed is not gone back to.
    tracker.step(tr.Scan(2.2, [[0.0, 0.0]], "radar"))
    tracker.flush()
    assert tracker.event_counts["late_scan"] == 1


def test_a_run_asks_for_order_only_where_late_scans_are_dropped():
    scans = make_scans(4, steps=10)
    with pytest.raises(tr.TimeError):
        make_tracker().run(scans[::-1])
    for policy in (tr.Reorder, tr.Replay):
        assert_same(make_tracker(late=policy(10.0)).run(scans[::-1]), make_tracker().run(scans))
        with pytest.raises(tr.UnknownSensorError):
            make_tracker(late=policy(10.0)).run([tr.Scan(0.0, [[0.0, 0.0]], "sonar")])
        with pytest.raises(tr.NonFiniteError):
            make_tracker(late=policy(10.0)).run([tr.Scan(np.nan, [[0.0, 0.0]], "radar")])


@pytest.mark.parametrize("window", [0.0, -1.0, np.nan, np.inf])
def test_a_window_is_a_length_of_time(window):
    for policy in (tr.Reorder, tr.Replay):
        with pytest.raises(tr.ParameterError, match="window"):
            make_tracker(late=policy(window))
        with pytest.raises(tr.ParameterError, match="window"):
            make_phd(policy(window))


def shifted(scan, shift):
    return tr.Scan(scan.time + shift, scan.values, scan.sensor)


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize("ahead", [86_400.0, 1e300])
@pytest.mark.parametrize("late", [tr.DropLate(), tr.Reorder(WINDOW), tr.Replay(WINDOW)])
def test_one_stamp_from_the_future_is_taken_back(kind, ahead, late):
    scans = make_scans(5, steps=50)
    good = [scan for k, scan in enumerate(scans) if k != 20]
    expected = MAKERS[kind]().run(good)
    tracker = MAKERS[kind](late)
    parts = [tracker.step(shifted(scan, ahead) if k == 20 else scan) for k, scan in enumerate(scans)]
    parts.append(tracker.flush())
    ends = [list(part) for part in parts if len(part)][-1]
    last = expected.of_scan(len(good) - 1)
    assert [track.id for track in ends][-len(last) :] == [track.id for track in last]
    assert np.array_equal(ends[-1].state.mean, last[-1].state.mean)
    assert tracker.event_counts["future_scan"] == 1
    assert "gap_reset" not in tracker.event_counts
    assert tracker.ledger.rejected["future_scan"] == len(scans[20].values)
    assert tracker.ledger.late == 0


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize("shift", [-3600.0, -1.7e9, 86_400.0])
def test_a_clock_that_is_set_is_followed(kind, shift):
    scans = make_scans(6, steps=90)
    tracker = MAKERS[kind]()
    begin = 1.7e9  # so that the last shift but one goes to the epoch
    for scan in scans[:45]:
        tracker.step(shifted(scan, begin))
    for scan in scans[45:]:
        found = tracker.step(shifted(scan, begin + shift))
    assert len(found) >= 1
    assert found.times[0] == scans[-1].time + begin + shift
    if shift < 0:
        assert tracker.event_counts["clock_set_back"] == 1
        # The radar's scan, every third, made the newest time or the lidar's did: at most six are needed.
        assert tracker.event_counts["late_scan"] <= 5
    else:
        assert tracker.event_counts.get("late_scan", 0) == 0
    assert not any(code == "future_scan" for code in tracker.event_counts)


def test_a_run_may_go_on_from_before_a_stamp_on_trial():
    scans = make_scans(7, steps=40)
    tracker = make_tracker()
    tracker.run([*scans[:20], shifted(scans[20], 1e6)])
    tracker.run(scans[21:])
    assert tracker.event_counts["future_scan"] == 1


# --- configuration and live runs -------------------------------------------------------------------------------------

CONFIG = """
[motion]
type = "constant_velocity"
dims = 2
accel_psd = 0.2
[sensors.radar]
type = "position"
dims = 2
std = 2.0
columns = ["x", "y"]
[sensors.lidar]
type = "position"
dims = 2
std = 0.5
columns = ["x", "y"]
[tracker]
initiator = {m = 3, n = 5, max_speed = 20.0}
"""


def write_config(path, late):
    path.write_text(CONFIG + late)
    return load_config(path)


def test_the_policy_stands_in_the_configuration(tmp_path):
    write = partial(write_config, tmp_path / "config.toml")
    assert write('late = {type = "reorder", window = 2.5}\n').tracker["late"] == tr.Reorder(2.5)
    assert write('late = {type = "replay", window = 2.5}\n').tracker["late"] == tr.Replay(2.5)
    assert write('late = "drop_late"\n').tracker["late"] == tr.DropLate()
    with pytest.raises(ConfigError, match=r"\[tracker.late\].*window"):
        write('late = "reorder"\n')
    with pytest.raises(ConfigError, match="window = -1"):
        write('late = {type = "replay", window = -1.0}\n')


def lines_of(scans):
    rows = [
        {"time": scan.time, "sensor": scan.sensor, "x": float(x), "y": float(y)}
        for scan in scans
        for x, y in scan.values
    ]
    return "".join(json.dumps(row) + "\n" for row in rows)


@pytest.mark.parametrize("late", ["reorder", "replay"])
def test_a_live_run_takes_scans_in_any_order(tmp_path, late):
    config = write_config(tmp_path / "config.toml", f'late = {{type = "{late}", window = {WINDOW}}}\n')
    scans = make_scans(8, steps=40)
    expected = []
    for name, given_scans in (("sorted", scans), ("mixed", shuffled(scans, 1))):
        source, out = tmp_path / f"{name}.ndjson", tmp_path / f"{name}.out"
        source.write_text(lines_of(given_scans))
        run = tr.live.follow(source, config.make_tracker(), config.columns, out=out, wait=False)
        assert run.ended
        assert run.ledger.late == run.ledger.waiting == 0
        expected.append((out.read_bytes().splitlines(), run.tracker.ledger))
    assert expected[0][1] == expected[1][1]
    if late == "reorder":
        assert expected[0][0] == expected[1][0]
    else:
        assert expected[0][0][-1] == expected[1][0][-1]


def test_a_live_run_that_is_stopped_keeps_what_waits(tmp_path):
    config = write_config(tmp_path / "config.toml", f'late = {{type = "reorder", window = {WINDOW}}}\n')
    scans = shuffled(make_scans(9, steps=40), 2)
    text = lines_of(scans)
    follow = partial(tr.live.follow, columns=config.columns, wait=False)
    (tmp_path / "whole.ndjson").write_text(text)
    follow(tmp_path / "whole.ndjson", config.make_tracker(), out=tmp_path / "whole.out")
    source, out, checkpoint = tmp_path / "part.ndjson", tmp_path / "part.out", tmp_path / "part.ckpt"
    source.write_text(text)
    looks = iter([False, False, True])
    pieces = []
    for stop in (lambda: next(looks, True), lambda: False):
        run = follow(source, config.make_tracker(), out=out, checkpoint=checkpoint, every=0.0, stop=stop)
        pieces.append(run)
    assert pieces[1].ended
    assert out.read_bytes() == (tmp_path / "whole.out").read_bytes()


def test_a_live_run_goes_on_past_a_stamp_from_the_future(tmp_path):
    config = write_config(tmp_path / "config.toml", "")
    scans = make_scans(10, steps=30)
    runs = {}
    for name in ("good", "wrong"):
        taken = [shifted(scan, 1e6) if k == 12 else scan for k, scan in enumerate(scans) if k != 12 or name == "wrong"]
        source, out = tmp_path / f"{name}.ndjson", tmp_path / f"{name}.out"
        source.write_text(lines_of(taken))
        runs[name] = tr.live.follow(source, config.make_tracker(), config.columns, out=out, wait=False), out
    good, wrong = (out.read_text().splitlines() for _, out in runs.values())
    # The scan from the future is not complete before the input ends.
    assert wrong[: len(good)] == good
    assert all(json.loads(line)["time"] > 1e6 for line in wrong[len(good) :])
    assert runs["wrong"][0].ledger.late == 0


# --- health ----------------------------------------------------------------------------------------------------------


def test_health_is_typed_and_stands_in_tables(tmp_path):
    rng = np.random.default_rng(0)
    tracker = make_tracker(initiator=tr.MofN(3, 5, max_speed=200.0), deletion=tr.Deletion(30))
    scans = []
    for k in range(60):
        x, y = 10.0 * k, 0.0 if k < 30 else 4.0 * (k - 30) ** 2
        scans.append(tr.Scan(float(k), np.array([[x, y]]) + rng.normal(0.0, 0.5, (1, 2)), "lidar"))
    tracks = tracker.run(scans)
    first = tracks.history[1]
    assert {track.health for track in first if track.state.time < 30} == {tr.Health.HEALTHY}
    assert any(track.health is tr.Health.LOST for track in first if 30 <= track.state.time < 50)
    assert tracker.event_counts["track_lost"] >= 1
    table = tracks.to_table()
    assert set(table["health"]) <= {"healthy", "degraded", "lost"}
    write_tracks(tracks, tmp_path / "tracks.csv")
    back = read_tracks(tmp_path / "tracks.csv")
    assert back.healths.tolist() == tracks.healths.tolist()
    text = (tmp_path / "tracks.csv").read_text()
    (tmp_path / "tracks.csv").write_text(text.replace("healthy", "fine", 1))
    with pytest.raises(TableError, match='"fine" is none of healthy, degraded, lost'):
        read_tracks(tmp_path / "tracks.csv")
    assert make_phd().run(make_scans(0, steps=20)).healths is None
