"""The multi-target tracker: batch and stream, saving, events, the ledger, several sensors."""

from __future__ import annotations

import itertools
import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest

import trackrs as tr

RADAR = tr.PositionSensor(dims=2, std=2.0)


def make_tracker(**changes):
    arguments = {
        "motion": tr.ConstantVelocity(dims=2, accel_psd=0.2),
        "sensors": {"radar": RADAR, "lidar": tr.PositionSensor(dims=2, std=0.5)},
        "initiator": tr.MofN(3, 5, max_speed=20.0),
        "clutter_map": tr.ClutterMap(radius=5.0, dwell=10.0),
        "max_gap": 60.0,
    }
    return tr.MultiTargetTracker(**(arguments | changes))


def make_scans(seed=0, steps=60, clutter=3):
    """Two crossing targets, a static echo and clutter, seen by a slow radar and a fast lidar of short range."""
    rng = np.random.default_rng(seed)
    scans = []
    for k in range(steps):
        time = 0.5 * k
        truth = np.array([[-100.0 + 6.0 * time, 0.5 * time], [-80.0 + 5.0 * time, 100.0 - 6.0 * time]])
        sensor = "radar" if k % 3 == 0 else "lidar"
        std = 2.0 if sensor == "radar" else 0.5
        seen = truth[rng.random(2) < 0.9]
        rows = [seen + rng.normal(0.0, std, seen.shape), rng.uniform(-150.0, 150.0, (rng.poisson(clutter), 2))]
        rows.append(np.array([[40.0, -40.0]]) + rng.normal(0.0, std, (1, 2)))
        scans.append(tr.Scan(time, np.concatenate(rows), sensor=sensor))
    return scans


def same(a, b):
    """Whether two results hold the same bits."""
    names = ("times", "ids", "means", "covs", "last_hits", "hits", "offsets")
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in names)


def test_step_and_run_agree_bit_for_bit():
    scans = make_scans()
    batch = make_tracker().run(scans)
    stream = make_tracker()
    for k, scan in enumerate(scans):
        tracks = stream.step(scan)
        rows = slice(batch.offsets[k], batch.offsets[k + 1])
        assert np.array_equal(tracks.ids, batch.ids[rows])
        assert np.array_equal(tracks.means, batch.means[rows])
        assert np.array_equal(tracks.covs, batch.covs[rows])
    assert len(batch) > 60


def test_two_crossing_targets_keep_their_ids():
    moving = tr.MofN(3, 5, max_speed=20.0, min_displacement=10.0)
    tracks = make_tracker(initiator=moving).run(make_scans(clutter=0))
    assert sorted(tracks.history) == [1, 2]
    first, second = (tracks.history[i][-1].state.mean[:2] for i in (1, 2))
    ends = np.array([[77.0, 14.75], [67.5, -77.0]])
    distances = np.linalg.norm(np.array([first, second])[:, None] - ends[None], axis=-1)
    assert sorted(distances.argmin(axis=1)) == [0, 1]
    assert distances.min(axis=1).max() < 3.0


def test_saved_tracker_goes_on_bit_for_bit():
    scans = make_scans()
    whole = make_tracker().run(scans)
    for cut in range(0, len(scans), 7):
        tracker = make_tracker()
        tracker.run(scans[:cut])
        data = tracker.to_bytes()
        resumed = tr.MultiTargetTracker.from_bytes(data)
        assert resumed.to_bytes() == data
        rest = resumed.run(scans[cut:])
        rows = slice(whole.offsets[cut], None)
        assert np.array_equal(rest.ids, whole.ids[rows])
        assert np.array_equal(rest.means, whole.means[rows])
        assert np.array_equal(rest.covs, whole.covs[rows])


def test_pickle_goes_through_the_saved_bytes():
    scans = make_scans()
    tracker = make_tracker()
    tracker.run(scans[:30])
    copy = pickle.loads(pickle.dumps(tracker))
    assert same(copy.run(scans[30:]), tracker.run(scans[30:]))


def test_altered_bytes_are_refused():
    data = make_tracker().to_bytes()
    rng = np.random.default_rng(1)
    for _ in range(500):
        altered = bytearray(data)
        altered[rng.integers(len(data))] ^= int(rng.integers(1, 256))
        with pytest.raises(tr.StateError):
            tr.MultiTargetTracker.from_bytes(bytes(altered))
        with pytest.raises(tr.StateError):
            tr.MultiTargetTracker.from_bytes(data[: rng.integers(len(data))])


def test_a_scan_twice_and_every_row_twice_change_nothing():
    scans = make_scans()
    plain = make_tracker().run(scans)
    tracker = make_tracker()
    for k, scan in enumerate(scans):
        tracker.step(tr.Scan(scan.time, np.repeat(scan.values, 2, axis=0), sensor=scan.sensor))
        tracks = tracker.step(tr.Scan(scan.time, np.repeat(scan.values, 2, axis=0), sensor=scan.sensor))
        assert np.array_equal(tracks.means, plain.means[plain.offsets[k] : plain.offsets[k + 1]])
    rows = sum(len(scan) for scan in scans)
    assert tracker.ledger == tr.Ledger(rows_in=4 * rows, used=rows, late=0, duplicate=3 * rows, rejected={})


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("field", ["value", "time", "platform"])
def test_one_bad_number_anywhere_leaves_the_tracks_as_they_were(value, field):
    scans = make_scans(steps=30)
    plain = make_tracker()
    plain.run(scans)
    for position in range(1, 30, 5):
        tracker = make_tracker()
        tracker.run(scans[:position])
        time, good = scans[position - 1].time, scans[position - 1]
        if field == "value":
            bad = tr.Scan(time, [[value, value]], sensor="radar")
            if np.isnan(value):
                # All-NaN is a row without a measurement; the scan itself is an empty one, which counts misses.
                tracker_empty = tr.MultiTargetTracker.from_bytes(tracker.to_bytes())
                assert same(tracker.step(bad), tracker_empty.step(tr.Scan(time, [], sensor="radar")))
                assert tracker.ledger.rejected == {"not_observed": 1}
                continue
        elif field == "time":
            bad = tr.Scan(value, good.values, sensor="radar")
        else:
            bad = tr.Scan(time, good.values, sensor="radar", platform=[value, 0.0])
        before = tracker.to_bytes()
        if field != "value":
            tracker.step(bad)
            assert tracker.event_counts == {"bad_scan": 1}
            assert tracker.to_bytes() != before  # the event itself is remembered
            assert same(tracker.run(scans[position:]), _rest(scans, position))
        else:
            tracker.step(bad)
            assert tracker.event_counts == {"non_finite": 1}
        assert tracker.ledger.rows_in == tracker.ledger.used + sum(tracker.ledger.rejected.values())


def _rest(scans, position):
    tracker = make_tracker()
    tracker.run(scans[:position])
    return tracker.run(scans[position:])


def test_late_unknown_and_misshapen_scans_become_events():
    tracker = make_tracker()
    tracker.step(tr.Scan(5.0, [[0.0, 0.0]], sensor="radar"))
    tracker.step(tr.Scan(4.0, [[0.0, 0.0], [1.0, 1.0]], sensor="radar"))
    tracker.step(tr.Scan(6.0, [[0.0, 0.0]], sensor="sonar"))
    tracker.step(tr.Scan(6.0, [[0.0, 0.0, 0.0]], sensor="radar"))
    tracker.step(tr.Scan(6.5, [[0.0, 0.0]], sensor="radar", platform=[0.0]))
    assert tracker.event_counts == {"late_scan": 1, "unknown_sensor": 1, "wrong_size": 1, "bad_scan": 1}
    late = tracker.events[0]
    assert (late.code, late.time, late.sensor, late.row) == ("late_scan", 4.0, "radar", None)
    assert late.reason == "the tracker stands at 5 s"
    ledger = tracker.ledger
    assert (ledger.rows_in, ledger.used, ledger.late) == (6, 1, 2)
    assert ledger.rejected == {"unknown_sensor": 1, "wrong_size": 1, "bad_scan": 1}


def test_run_refuses_what_step_drops():
    scan = tr.Scan(1.0, [[0.0, 0.0]], sensor="radar")
    with pytest.raises(tr.TimeError, match=r"0\.5 s is before 1 s"):
        make_tracker().run([scan, tr.Scan(0.5, [], sensor="radar")])
    with pytest.raises(tr.UnknownSensorError, match='unknown sensor "sonar": this tracker has "lidar", "radar"'):
        make_tracker().run([tr.Scan(1.0, [], sensor="sonar")])
    with pytest.raises(tr.StrictError, match="non_finite at 1 s"):
        make_tracker(strict=True).step(tr.Scan(1.0, [[np.inf, 0.0]], sensor="radar"))


def test_every_pattern_of_empty_scans():
    """Fault 10: 4,096 patterns of empty and non-empty scans over 12 times."""
    reports = [tr.Scan(float(k), [[2.0 * k, 0.0]], sensor="radar") for k in range(12)]
    empty = [tr.Scan(float(k), np.zeros((0, 2)), sensor="radar") for k in range(12)]
    for pattern in itertools.product((0, 1), repeat=12):
        tracker = make_tracker(clutter_map=None)
        tracks = tracker.run([(empty[k], reports[k])[hit] for k, hit in enumerate(pattern)])
        assert len(tracks.offsets) == 13
        assert (len(tracks) > 0) == _three_of_five(pattern), pattern
        assert np.isfinite(tracks.means).all()


def _three_of_five(pattern):
    """Whether a track is ever confirmed: 3 hits among its last 5 scans before 3 misses among them."""
    window = []
    for hit in pattern:
        if window or hit:
            window = [*window, hit][-5:]
        if sum(window) >= 3:
            return True
        if window.count(0) >= 3:
            window = []
    return False


def test_tracks_end_after_misses_of_every_sensor_that_saw_them():
    tracker = make_tracker(deletion=tr.Deletion(max_misses=3))
    for k in range(6):
        tracker.step(tr.Scan(float(k), [[3.0 * k, 0.0]], sensor="radar"))
    assert len(tracker.step(tr.Scan(6.0, [], sensor="lidar"))) == 1
    assert [len(tracker.step(tr.Scan(7.0 + k, [], sensor="radar"))) for k in range(3)] == [1, 1, 0]


def test_a_long_gap_ends_all_tracks_with_an_event():
    tracker = make_tracker()
    for k in range(6):
        tracker.step(tr.Scan(float(k), [[3.0 * k, 0.0]], sensor="radar"))
    assert len(tracker.step(tr.Scan(1e6, [], sensor="radar"))) == 0
    assert tracker.event_counts == {"gap_reset": 1}


def test_an_endless_gap_without_a_limit_poisons_nothing():
    tracker = make_tracker(max_gap=None)
    for k in range(6):
        tracker.step(tr.Scan(float(k), [[3.0 * k, 0.0]], sensor="radar"))
    assert len(tracker.step(tr.Scan(1e300, [[0.0, 0.0]], sensor="radar"))) == 0
    assert tracker.event_counts["track_diverged"] == 1


def test_targets_at_rest_need_leave_to_be_confirmed():
    rng = np.random.default_rng(2)
    echo = [tr.Scan(float(k), 50.0 + rng.normal(0.0, 2.0, (1, 2)), sensor="radar") for k in range(60)]
    assert len(make_tracker(clutter_map=None).run(echo)) > 0
    moving = tr.MofN(3, 5, max_speed=20.0, min_displacement=10.0)
    assert len(make_tracker(initiator=moving, clutter_map=None).run(echo)) == 0


def test_clutter_map_keeps_static_echoes_from_starting_tracks():
    rng = np.random.default_rng(3)
    echo = [tr.Scan(float(k), 50.0 + rng.normal(0.0, 1.0, (1, 2)), sensor="radar") for k in range(40)]
    # Fourteen hits in a row take longer than the map needs to know the echo.
    slow = tr.MofN(14, 14, max_speed=20.0)
    assert len(make_tracker(initiator=slow, clutter_map=None).run(echo)) > 0
    assert len(make_tracker(initiator=slow).run(echo)) == 0


def test_a_moving_platform_sees_the_same_world():
    scans = make_scans(clutter=0)
    at_rest = make_tracker().run(scans)
    moved = []
    for scan in scans:
        platform = np.array([3.0 * scan.time, -7.0])
        moved.append(tr.Scan(scan.time, scan.values - platform, sensor=scan.sensor, platform=platform))
    on_board = make_tracker().run(moved)
    np.testing.assert_allclose(on_board.means, at_rest.means, atol=1e-9)


def test_range_bearing_from_a_moving_platform():
    radar = tr.RangeBearing(position=(0.0, 0.0), range_std=3.0, bearing_std=0.01)
    tracker = make_tracker(sensors={"radar": radar}, initiator=tr.MofN(3, 5, max_speed=20.0, min_displacement=5.0))
    rng = np.random.default_rng(4)
    for k in range(40):
        time = float(k)
        platform, target = np.array([10.0 * time, 0.0]), np.array([200.0 - 5.0 * time, 30.0 - 2.0 * time])
        z = radar.observe([*target, 0.0, 0.0], platform) + rng.normal(size=2) * [3.0, 0.01]
        tracks = tracker.step(tr.Scan(time, [z], sensor="radar", platform=platform))
    (track,) = tracks
    assert np.linalg.norm(track.state.mean[:2] - target) < 4 * track.state.std[:2].max()
    assert track.state.std[:2].max() < 5.0


def test_initial_states_are_tracks_from_the_beginning():
    start = tr.GaussianState([0.0, 0.0, 3.0, 0.0], np.diag([4.0, 4.0, 1.0, 1.0]), time=0.0)
    tracker = make_tracker(initial=[start])
    tracks = tracker.step(tr.Scan(1.0, [[3.1, 0.0]], sensor="radar"))
    assert [track.id for track in tracks] == [1]
    for k in range(2, 8):
        tracks = tracker.step(tr.Scan(float(k), [], sensor="radar"))
    assert len(tracks) == 1  # the lidar has not missed it yet
    for k in range(8, 14):
        tracks = tracker.step(tr.Scan(float(k), [], sensor="lidar"))
    assert len(tracks) == 0


def test_initial_states_of_different_times_meet_at_the_latest():
    motion = tr.ConstantVelocity(dims=2, accel_psd=0.2)
    cov = np.diag([4.0, 4.0, 1.0, 1.0])
    early, late = (tr.GaussianState([0.0, 0.0, 3.0, 0.0], cov, time=t) for t in (0.0, 2.0))
    tracks = make_tracker(initial=[early, late]).step(tr.Scan(2.0, [], sensor="radar"))
    np.testing.assert_allclose(tracks.means[:, 0], [6.0, 0.0])
    F = motion.transition(2.0)
    np.testing.assert_allclose(tracks.covs[0], F @ cov @ F.T + motion.noise(2.0))
    np.testing.assert_allclose(tracks.covs[1], cov)


def test_two_trackers_have_their_own_ids():
    one, two = make_tracker(), make_tracker()
    for k in range(6):
        first = one.step(tr.Scan(float(k), [[3.0 * k, 0.0]], sensor="radar"))
        second = two.step(tr.Scan(float(k), [[0.0, 3.0 * k], [50.0, 3.0 * k]], sensor="radar"))
    assert first.ids.tolist() == [1]
    assert second.ids.tolist() == [1, 2]


def test_the_table_has_one_row_per_track_and_scan():
    tracks = make_tracker().run(make_scans())
    table = tracks.to_table()
    assert {len(column) for column in table.values()} == {len(tracks)}
    assert list(table)[:9] == ["time", "sensor", "track", "x", "y", "vx", "vy", "last_hit", "hits"]
    np.testing.assert_array_equal(table["cov_vx_x"], tracks.covs[:, 2, 0])
    last = tracks.at(1e9)
    assert [track.id for track in last] == table["track"][table["time"] == tracks.scan_times[-1]].tolist()
    assert tracks.at(-1.0) == []


def test_parameters_are_checked_by_name():
    with pytest.raises(tr.ParameterError, match="n = 2 is invalid: must lie between m and 64"):
        make_tracker(initiator=tr.MofN(3, 2, max_speed=1.0))
    with pytest.raises(tr.ParameterError, match="max_speed = -1"):
        make_tracker(initiator=tr.MofN(2, 3, max_speed=-1.0))
    with pytest.raises(tr.ParameterError, match=r"probability = 1\.5"):
        make_tracker(gate=tr.Gate(1.5))
    with pytest.raises(tr.ParameterError, match="max_misses = 0"):
        make_tracker(deletion=tr.Deletion(max_misses=0))
    with pytest.raises(tr.ParameterError, match="dwell = 0"):
        make_tracker(clutter_map=tr.ClutterMap(radius=1.0, dwell=0.0))
    with pytest.raises(tr.ParameterError, match="m = -1"):
        make_tracker(initiator=tr.MofN(-1, 2, max_speed=1.0))
    with pytest.raises(tr.ParameterError, match="max_tracks = 0"):
        make_tracker(max_tracks=0)
    with pytest.raises(tr.ParameterError, match="dims = -1"):
        tr.PositionSensor(dims=-1, std=1.0)
    with pytest.raises(tr.ParameterError, match="sensors = empty"):
        make_tracker(sensors={})
    with pytest.raises(tr.DimensionError, match="position of the motion model"):
        make_tracker(sensors={"radar": tr.PositionSensor(dims=3, std=1.0)})


def test_use_by_two_threads_at_once_is_refused_or_correct():
    """Fault 22: a second thread gets `BusyError` or its turn, never a torn state."""
    tracker = make_tracker()
    failures = []

    def work():
        for scan in make_scans(steps=200):
            try:
                tracker.step(scan)
            except tr.BusyError:
                continue
            except tr.TrackrsError as error:
                failures.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    ledger = tracker.ledger
    assert not failures
    assert ledger.rows_in == ledger.used + ledger.late + ledger.duplicate


def test_nearest_and_global_nearest_neighbour_differ_where_they_should():
    """Two tracks, two reports, both nearest to the first track."""
    starts = [tr.GaussianState([x, 0.0, 0.0, 0.0], np.diag([1.0, 1.0, 0.01, 0.01])) for x in (0.0, 4.0)]
    scan = tr.Scan(0.0, [[2.1, 0.0], [-2.0, 0.0]], sensor="radar")
    ends = {}
    for associator in (tr.NearestNeighbour(), tr.GlobalNearestNeighbour()):
        tracker = make_tracker(associator=associator, initial=starts, gate=tr.Gate(0.9999))
        ends[associator.name] = tracker.step(scan).means[:, 0]
    assert ends["global_nearest"][0] < 0.0 < ends["global_nearest"][1] < 4.0
    assert ends["nearest"][1] in (4.0, pytest.approx(4.0 - 1.9 / 5.0))


@pytest.mark.parametrize("name", ["extended", "second_order", "unscented"])
def test_every_track_has_the_filter_that_was_asked_for(name):
    """One target without clutter: the track is that of the filter run on the same reports."""
    motion = tr.ConstantVelocity(dims=2, accel_psd=0.1)
    sonar = tr.RangeArray([[0.0, 0.0], [40.0, 0.0], [0.0, 30.0]], range_std=1.0)
    times = np.arange(1.0, 21.0)
    rng = np.random.default_rng(4)
    truth = np.stack([-30.0 + 2.0 * times, 20.0 - 0.5 * times], axis=1)
    values = np.array([sonar.observe(p) for p in truth]) + rng.normal(size=(len(times), 3))
    start = tr.GaussianState([-30.0, 20.0, 2.0, -0.5], np.diag([25.0, 25.0, 1.0, 1.0]), 0.0)
    filters = {
        "extended": tr.ExtendedKalmanFilter(motion, sonar),
        "second_order": tr.ExtendedKalmanFilter(motion, sonar, second_order=True),
        "unscented": tr.CubatureKalmanFilter(motion, sonar),
    }
    run = filters[name].run(times, values, initial=start)
    tracker = tr.MultiTargetTracker(
        motion,
        {"sonar": sonar},
        tr.MofN(2, 3, max_speed=20.0),
        filter=name,
        gate=tr.Gate(1.0),
        associator=tr.JPDA(),
        clutter_density=0.0,
        detection_probability=1.0,
        initial=[start],
    )
    tracks = tracker.run([tr.Scan(t, [z], sensor="sonar") for t, z in zip(times, values, strict=True)])
    np.testing.assert_allclose(tracks.means[tracks.ids == 1], run.means, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(tracks.covs[tracks.ids == 1], run.covs, rtol=1e-8, atol=1e-9)
    other = tr.MultiTargetTracker.from_bytes(tracker.to_bytes())
    assert other.to_bytes() == tracker.to_bytes()
    with pytest.raises(tr.ParameterError, match="filter = particle"):
        tr.MultiTargetTracker(motion, {"sonar": sonar}, tr.MofN(2, 3, max_speed=20.0), filter="particle")
    with pytest.raises(tr.ParameterError, match="by = guess"):
        tr.MultiTargetTracker(
            motion, {"sonar": sonar}, tr.MofN(2, 3, max_speed=20.0), associator=tr.NearestNeighbour(by="guess")
        )


HUGE = """
from pathlib import Path
import numpy as np
import trackrs as tr

rng = np.random.default_rng(0)
tracker = tr.MultiTargetTracker(
    tr.ConstantVelocity(dims=2, accel_psd=0.1),
    {"radar": tr.PositionSensor(dims=2, std=5.0)},
    tr.MofN(2, 3, max_speed=30.0),
)
place = rng.uniform(-5e3, 5e3, (100, 2))
for k in range(5):
    seen = place + rng.normal(0.0, 5.0, (100, 2))
    clutter = rng.uniform(-5e5, 5e5, (1_000_000 if k > 2 else 0, 2))
    tracks = tracker.step(tr.Scan(float(k), np.concatenate([seen, clutter]), "radar"))
held = np.array([track.state.mean[:2] for track in tracks])
apart = np.linalg.norm(held[:, None] - place[None], axis=2).min(axis=0)
assert (apart < 20.0).all(), apart.max()
assert tracker.event_counts.keys() == {"track_limit"}
assert tracker.ledger.rows_in == 2_000_500
# The most that this process has had; what getrusage says begins with that of its parent.
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(status["VmHWM"].split()[0])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="counts memory as Linux does")
def test_a_million_reports_are_one_scan_more_in_bounded_memory():
    """100 targets are held through two scans of a million false reports each, in less than a gigabyte."""
    done = subprocess.run([sys.executable, "-c", HUGE], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) * 1024 < 1_000_000_000
