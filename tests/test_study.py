"""Studies: the same whoever runs them, and what they say is so."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import linear_sum_assignment
from scipy.stats import kstest, t

import trackrs as tr
from studies import RADAR, angle_filter, close_study, nearest, phd, tracker
from trackrs.study import Cardinality, Draw, Identity, LeadError, Part, PositionError
from trackrs.study._statistics import difference, summarise, widening

SEED = 7
OSPA = [tr.OSPA(c=60.0)]


@pytest.fixture(scope="module")
def close():
    return close_study()


@pytest.fixture(scope="module")
def whole(close):
    return close.run(runs=23, seed=SEED, workers=1)


# --- the same whoever runs them --------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [2, 5])
def test_any_number_of_threads_gives_the_same_bytes(close, whole, workers):
    assert close.run(runs=23, seed=SEED, workers=workers).to_bytes() == whole.to_bytes()
    assert close.run(runs=23, seed=SEED + 1, workers=workers).to_bytes() != whole.to_bytes()


@pytest.mark.parametrize("size", [1, 4, 23, 100])
def test_any_chunks_in_any_order_give_the_same_bytes(close, whole, size):
    parts = [chunk.run() for chunk in close.chunks(runs=23, seed=SEED, size=size)]
    np.random.default_rng(size).shuffle(parts)
    sent = [Part.from_bytes(part.to_bytes()) for part in parts]
    assert close.merge(sent, SEED, 23).to_bytes() == whole.to_bytes()
    # Runs that are there twice count once; runs beyond are left out.
    more = [*sent, close.chunk(SEED, 5, 30).run()]
    assert close.merge(more, SEED, 23).to_bytes() == whole.to_bytes()


def test_a_run_alone_is_that_of_the_study(close, whole):
    (values,) = close.chunk(SEED, 17, 1).run().values
    assert_array_equal(values, np.concatenate([one.values[17].ravel() for one in whole.methods]))
    shorter = close.run(runs=5, seed=SEED)
    assert_array_equal(shorter["npda"].values, whole["npda"].values[:5])


def test_a_function_that_calls_a_tracker_gives_its_columns(whole):
    saved = tracker().to_bytes()

    def by_hand(scans):
        return tr.MultiTargetTracker.from_bytes(saved).run(scans)

    mixed = close_study(npda=by_hand, nearest=nearest()).run(runs=23, seed=SEED, workers=2)
    assert mixed.to_bytes() == whole.to_bytes()


def test_positions_of_a_function_are_scored_as_tracks(whole):
    def positions(scans):
        found = tracker().run(scans)
        return [found.means[a:b, :2] for a, b in zip(found.offsets[:-1], found.offsets[1:], strict=True)]

    found = tr.Study(RADAR, {"mine": positions}, [tr.OSPA(c=60.0), Cardinality()]).run(runs=4, seed=SEED)
    assert_array_equal(found["mine"].values, whole["npda"].values[:4, :5])


@dataclass(frozen=True)
class Own:
    """The scenario of the library, seen from outside."""

    scene: object

    def draw(self, seed, run):
        return Draw(self.scene.draw(seed, run).scans(), self.scene.truth[:, :, :2])


def test_a_scenario_of_ones_own_is_as_good_as_a_built_in_one(whole):
    assert close_study(Own(RADAR), npda=tracker(), nearest=nearest()).run(23, SEED).to_bytes() == whole.to_bytes()


def test_extended_targets_are_the_same_in_python():
    scene = tr.scenarios.crossing()

    @dataclass(frozen=True)
    class Mine:
        def draw(self, seed, run):
            return Draw(scene.draw(seed, run).scans, scene.states[:, :, :2])

    first = tr.Study(scene, {"phd": phd(scene)}, OSPA).run(2, SEED)
    assert tr.Study(Mine(), {"phd": phd(scene)}, OSPA).run(2, SEED).to_bytes() == first.to_bytes()
    assert tr.Study(scene, {"phd": phd(scene).run}, OSPA).run(2, SEED).to_bytes() == first.to_bytes()


def test_several_reports_to_a_scan():
    scene = tr.scenarios.close_targets(scan_size=7)
    method = tracker(scene, associator=tr.JPDA(), detection_probability=1.0, clutter_density=0.0)
    native = tr.Study(scene, {"jpda": method}, OSPA).run(3, SEED)
    outside = tr.Study(scene, {"jpda": method.copy().run}, OSPA)
    assert len(native["jpda"].times) == 9
    assert native["jpda"].times[-1] == 180.0
    assert outside.chunk(SEED, 0, 1).run().values.tobytes() == native["jpda"].values[0].tobytes()


def test_methods_are_taken_as_they_stand_and_left_alone():
    live = tracker()
    live.run(RADAR.draw(1).scans()[:20])
    saved = live.to_bytes()
    study = tr.Study(RADAR, {"live": live}, OSPA)
    live.run(RADAR.draw(1).scans()[20:])
    scans = RADAR.draw(SEED).scans()
    expected = tr.MultiTargetTracker.from_bytes(saved)
    result = study.run(2, SEED)
    # Its time is past the first scans: every run fails the same way, with the tracker's own words.
    with pytest.raises(tr.TimeError) as error:
        expected.run(scans)
    assert {failure.reason for failure in result.failures} == {str(error.value)}


# --- what is recorded ------------------------------------------------------------------------------------------------


def ospa(truth, found, c, p):
    m, n = len(truth), len(found)
    if max(m, n) == 0:
        return 0.0, 0.0, 0.0
    distances = np.minimum(np.linalg.norm(truth[:, None] - found[None], axis=2), c) ** p
    near = distances[linear_sum_assignment(distances)].sum() if min(m, n) else 0.0
    parts = np.array([near + c**p * abs(m - n), near, c**p * abs(m - n)])
    return (parts / max(m, n)) ** (1.0 / p)


def identity(truth, found, ids, separation):
    order = [np.flatnonzero(ids == i + 1) for i in range(len(truth))]
    if any(len(rows) == 0 for rows in order):
        return np.nan, 0.0, 0.0, 0.0
    mine = found[[rows[0] for rows in order]]
    apart = np.linalg.norm(mine[:, None] - truth[None], axis=2)
    between = np.linalg.norm(mine[:, None] - mine[None], axis=2)[np.triu_indices(len(truth), 1)]
    owners, together = apart.argmin(axis=1), bool((between < separation).any())
    own = bool((owners == np.arange(len(truth))).all())
    swapped = not own and len(set(owners)) == len(owners)
    return np.sqrt(np.mean(np.diag(apart) ** 2)), own and not together, together, swapped


@pytest.mark.parametrize(("method", "run"), [("npda", 3), ("nearest", 0), ("nearest", 11)])
def test_columns_of_scans_are_those_of_a_rewriting(whole, method, run):
    tracks = {"npda": tracker, "nearest": nearest}[method]().run(RADAR.draw(SEED, run).scans())
    result = whole[method]
    assert [column.name for column in result.columns][:5] == [
        "ospa", "ospa_localisation", "ospa_cardinality", "tracks", "cardinality_error",
    ]  # fmt: skip
    for k, truth in enumerate(RADAR.truth[:, :, :2]):
        rows = slice(tracks.offsets[k], tracks.offsets[k + 1])
        found, ids = tracks.means[rows, :2], tracks.ids[rows]
        expected = [*ospa(truth, found, 60.0, 2.0), len(found), len(found) - 3, *identity(truth, found, ids, 150.0)]
        assert_allclose(result.values[run, :, k], expected, rtol=1e-12, atol=1e-9)


def test_gospa_is_that_of_the_library():
    result = tr.Study(RADAR, {"npda": tracker()}, [tr.GOSPA(c=60.0, p=2.0, alpha=2.0)]).run(2, SEED)
    tracks = tracker().run(RADAR.draw(SEED, 1).scans())
    for k in (0, 30, 59):
        found = tr.gospa(RADAR.truth[k, :, :2], tracks.means[tracks.offsets[k] : tracks.offsets[k + 1], :2], 60.0)
        assert result["npda"].series("gospa")[1, k] == found.total
        assert result["npda"].series("gospa_missed")[1, k] == found.missed


def test_position_errors_are_those_of_a_run():
    scene = tr.scenarios.underwater("bats", gross=0.02)
    motion = tr.ConstantAcceleration(dims=3, jerk_std=0.05)
    ekf = tr.ExtendedKalmanFilter(motion, scene.array, screen=tr.ChiSquareScreen(alpha=1e-3))
    result = tr.Study(scene, {"ekf": ekf}, [PositionError(first=10)]).run(3, SEED)["ekf"]
    recording = scene.draw(SEED, 2)
    run = ekf.run(recording.times, recording.values)
    errors = run.means[:, :3] - recording.truth[:, :3]
    covs = run.covs[:, :3, :3]
    expected = np.array([e @ np.linalg.solve(P, e) for e, P in zip(errors[10:], covs[10:], strict=True)])
    assert np.isnan(result.values[2, :, :10]).all()
    assert_allclose(result.series("error")[2, 10:], np.linalg.norm(errors[10:], axis=1), rtol=1e-12)
    assert_allclose(result.series("nees")[2, 10:], expected, rtol=1e-6)
    assert_array_equal(result.series("nis")[2, 10:], run.nis[10:])


@pytest.mark.parametrize("lead", ["midpoint", 0.1])
def test_lead_errors_are_those_of_a_run(lead):
    scene = tr.scenarios.moving_head(samples=100)
    kalman = angle_filter(scene)
    result = tr.Study(scene, {"kf": kalman}, [LeadError(lead, first=5), PositionError()]).run(2, SEED)["kf"]
    angles = scene.draw(SEED, 1)
    run = kalman.run(angles.times, angles.values, initial=angles.initial, lead=lead)
    errors = run.lead_means[:, 0] - scene.truth(run.lead_times)
    assert_allclose(result.series("lead_error")[1, 5:], errors[5:], rtol=1e-9, atol=1e-12)
    signed = run.means[:, 0] - scene.truth(scene.times)
    assert_allclose(result.series("error")[1], signed, rtol=1e-9, atol=1e-12)


def test_one_number_of_a_run(whole):
    one = whole["nearest"]
    assert_allclose(one.per_run("ospa"), one.series("ospa").mean(axis=1), rtol=1e-13)
    error = one.series("track_error")
    assert_allclose(one.per_run("track_error"), np.sqrt(np.nanmean(error**2, axis=1)), rtol=1e-13)
    assert_array_equal(one.per_run("right"), one.series("right")[:, -1])
    band = one.over_time("ospa")
    assert_allclose(band.mean, one.series("ospa").mean(axis=0), rtol=1e-13)
    assert_allclose(band.half_width, 1.96 * one.series("ospa").std(axis=0, ddof=1) / np.sqrt(23), rtol=1e-12)


# --- statistics ------------------------------------------------------------------------------------------------------


def test_the_widening_is_students():
    for runs in (2, 3, 4, 10, 200):
        expected = np.sqrt(runs / (runs - 1)) * t.ppf(0.975, runs - 1) / 1.959963984540054
        assert_allclose(widening(runs), expected, rtol=2e-3)


@pytest.mark.parametrize("runs", [10, 40])
def test_intervals_cover_what_they_say(runs):
    rng, repeats = np.random.default_rng(runs), 800
    hits = 0
    for _ in range(repeats):
        found = summarise(5.0 + rng.standard_normal(runs))
        hits += found.low <= 5.0 <= found.high
    assert abs(hits / repeats - 0.95) < 3.0 * np.sqrt(0.95 * 0.05 / repeats)


def test_p_values_are_uniform_where_nothing_differs():
    rng = np.random.default_rng(3)
    values = [difference(rng.standard_normal(30), rng.standard_normal(30)).p_value for _ in range(500)]
    assert kstest(values, "uniform").pvalue > 0.01


def test_paired_differences_are_sharper():
    rng = np.random.default_rng(4)
    common = 10.0 * rng.standard_normal(100)
    first, second = common + rng.standard_normal(100), common + 1.0 + rng.standard_normal(100)
    paired = difference(first, second)
    loose = difference(first, rng.permutation(second))
    assert paired.p_value < 1e-3
    assert loose.high - loose.low > 5.0 * (paired.high - paired.low)
    assert_allclose(paired.mean, np.mean(first - second), rtol=1e-13)
    assert paired.low < paired.mean < paired.high < 0.0
    assert paired.below == np.mean(first < second)


def test_few_runs_claim_little():
    alone = summarise(np.array([3.0]))
    assert (alone.mean, alone.runs) == (3.0, 1)
    assert np.isnan([alone.low, alone.high, alone.half_width]).all()
    assert difference(np.array([3.0]), np.array([1.0])).p_value == 1.0
    for runs in range(2, 8):
        gap = difference(np.arange(1.0, runs + 1.0), np.zeros(runs))
        assert gap.p_value >= 2.0 ** (1 - runs)
    nothing = summarise(np.full(3, np.nan))
    assert nothing.runs == 0
    assert np.isnan(nothing.mean)
    assert summarise(np.array([np.nan, 2.0, 2.0])).runs == 2
    assert difference(np.zeros(5), np.zeros(5)).p_value == 1.0


# --- results ---------------------------------------------------------------------------------------------------------


def test_tables(whole):
    table = whole.to_table()
    rows = (table["method"] == "nearest") & (table["column"] == "ospa")
    assert_array_equal(table["value"][rows], whole["nearest"].per_run("ospa"))
    assert_array_equal(table["run"][rows], np.arange(23))
    assert len(table["run"]) == 23 * 2 * 10
    frame = whole.to_frame()
    assert frame.shape == (460, 4)
    assert frame["value"].to_numpy().tobytes() == table["value"].tobytes()
    arrow = pytest.importorskip("pyarrow")
    assert whole.to_arrow().schema.field("value").type == arrow.float64()
    assert whole.to_arrow()["method"].to_pylist() == table["method"].tolist()


def test_the_table_says_what_the_records_say(whole):
    lines = whole.table(columns=["right", "ospa"], baseline="nearest").splitlines()
    assert lines[0].split() == ["method", "right", "ospa", "right:", "minus", "nearest", "p", "ms/run"]
    right, gap = whole["npda"].summary("right"), whole.compare("npda", "nearest", "right")
    assert f"{right.mean:.4g} ±{right.half_width:.2g}" in lines[1]
    assert f"{gap.mean:+.4g} [{gap.low:+.3g}, {gap.high:+.3g}]" in lines[1]
    assert lines[-1].startswith("23 runs, seed 7;")
    assert len(whole.table().splitlines()) == 4
    for mistake in ({"columns": ["speed"]}, {"columns": []}, {"baseline": "best"}):
        with pytest.raises(tr.ParameterError):
            whole.table(**mistake)


def test_no_runs_and_one_run(close):
    none = close.run(runs=0)
    assert none["npda"].values.shape == (0, 9, 60)
    assert len(none.to_table()["run"]) == len(none.to_frame()) == 0
    assert "0 runs" in none.table()
    assert np.isnan(none.compare("npda", "nearest", "ospa").p_value)
    one = close.run(runs=1)
    assert "±" not in one.table().splitlines()[1]
    assert "1 run, seed 0" in one.table()


def test_results_are_joined(whole):
    other = close_study(third=tracker(gate=tr.Gate(0.99))).run(23, SEED)
    joined = whole | other
    assert [one.name for one in joined.methods] == ["npda", "nearest", "third"]
    assert joined.compare("third", "npda", "ospa").runs == 23
    for wrong in (whole, close_study(third=tracker()).run(22, SEED), close_study(third=tracker()).run(23, 8)):
        with pytest.raises(tr.ParameterError):
            whole | wrong


def test_failures_are_counted_and_the_others_go_on(whole):
    def breaks(scans):
        if scans[0].values[0, 0] > RADAR.draw(SEED, 1).values[0, 0]:
            return {}["missing"]
        return tracker().run(scans)

    methods = {"breaks": breaks, "none": lambda scans: None, "short": lambda scans: [], "npda": tracker()}  # noqa: ARG005
    result = close_study(**methods).run(23, SEED)
    assert_array_equal(result["npda"].values, whole["npda"].values)
    broken = [failure for failure in result.failures if failure.method == "breaks"]
    assert 0 < len(broken) < 23
    assert broken[0].reason.startswith("KeyError: 'missing' (test_study.py, line ")
    assert result["breaks"].summary("ospa").runs == 23 - len(broken)
    assert result["none"].summary("ospa").runs == 0
    assert {f.reason for f in result.failures if f.method == "none"} == {
        "it returned NoneType: it must return Tracks, or positions (k, d) at every scan"
    }
    assert "at 0 scans of 60" in next(f.reason for f in result.failures if f.method == "short")
    table = result.table()
    assert table.splitlines()[0].endswith("failed")
    assert table.splitlines()[2].endswith(" 23")
    assert "the first is run 0" in table


def test_a_native_method_that_fails_says_why():
    deaf = tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_std=2.0), {"sonar": RADAR.radar}, tr.MofN(3, 5, max_speed=150.0)
    )
    result = tr.Study(RADAR, {"deaf": deaf, "npda": tracker()}, OSPA).run(3, SEED)
    assert {(f.method, f.run) for f in result.failures} == {("deaf", 0), ("deaf", 1), ("deaf", 2)}
    assert "radar" in result.failures[0].reason
    assert result["npda"].summary("ospa").runs == 3


def test_a_model_written_in_python_takes_part_and_its_mistakes_are_named():
    scene = tr.scenarios.turntable()
    step = np.array([[1.0, scene.times[0], 0.0], [0.0, 1.0, scene.times[0]], [0.0, 0.0, 1.0]])

    def study(calls):
        left = iter(range(calls))

        def move(states, _dt):
            if next(left, None) is None:
                msg = "out of calls"
                raise ValueError(msg)
            return states @ step.T

        sensor = tr.LinearSensor([[1.0, 0.0, 0.0]], [[scene.std**2]])
        mine = tr.ExtendedKalmanFilter(tr.CustomMotion(move, 1e-6 * np.eye(3)), sensor)
        return tr.Study(scene, {"mine": mine, "native": angle_filter(scene)}, [PositionError()])

    result = study(2500).run(20, SEED, workers=1)
    assert result["native"].summary("error").runs == 20
    first = result.failures[0].run
    assert 0 < first < 20
    expected = [(run, "mine", "ValueError: out of calls") for run in range(first, 20)]
    assert [(f.run, f.method, f.reason) for f in result.failures] == expected
    assert result["mine"].summary("error").runs == first
    with pytest.raises(tr.ParameterError, match=r"refers to itself|cannot be told"):
        study(1).digest()


# --- mistakes --------------------------------------------------------------------------------------------------------


def mistakes():
    kalman = angle_filter(tr.scenarios.turntable())
    table = tr.scenarios.turntable()
    yield lambda: tr.Study(RADAR, [tracker()], OSPA), "methods must be a dictionary"
    yield lambda: tr.Study(RADAR, {}, OSPA), "methods must be a dictionary"
    yield lambda: tr.Study(RADAR, {1: tracker()}, OSPA), "method = 1"
    yield lambda: tr.Study(RADAR, {"a": 3}, OSPA), "method = a is invalid"
    yield lambda: tr.Study(RADAR, {"a": kalman}, OSPA), "method = a is invalid: must be a tracker"
    yield lambda: tr.Study(Own(RADAR), {"a": kalman}, OSPA), "method = a is invalid: must be a tracker"
    yield lambda: tr.Study(table, {"a": len}, [PositionError()]), "filters of trackrs"
    yield lambda: tr.Study(RADAR, {"a": tracker()}, tr.OSPA(c=60.0)), "metrics must be a list"
    yield lambda: tr.Study(RADAR, {"a": tracker()}, []), "metrics must be a list"
    yield lambda: tr.Study(RADAR, {"a": tracker()}, [3]), "metric = 3"
    yield lambda: tr.Study(RADAR, {"a": tracker()}, OSPA * 2), "same column twice"
    yield lambda: tr.Study(RADAR, {"a": tracker()}, [tr.OSPA(c=-1.0)]), "= -1 is invalid"
    yield lambda: tr.Study(Own(RADAR), {"a": tracker()}, [tr.OSPA(c=-1.0)]), "= -1 is invalid"
    yield lambda: tr.Study(Own(RADAR), {"a": tracker()}, [PositionError()]), "of one target"
    yield lambda: tr.Study(RADAR, {"a": tracker(initial=())}, [Identity(9.0)]), "all 3 targets"
    yield lambda: tr.Study(table, {"a": kalman}, [LeadError("soon")]), "lead = 'soon'"
    yield lambda: tr.Study(table, {"a": kalman}, [LeadError(-1.0)]), "lead = -1"
    yield lambda: tr.Study(table, {"a": kalman}, [PositionError(-1)]), "first = -1"
    yield lambda: tr.Study(3, {"a": tracker()}, OSPA), "scenario = 3"
    yield lambda: tr.Study(tr.scenarios.CloseTargets, {"a": tracker()}, OSPA), "scenario = "


@pytest.mark.parametrize(("make", "text"), list(mistakes()))
def test_what_does_not_go_together_is_one_line(make, text):
    with pytest.raises(tr.ParameterError) as error:
        make()
    assert text in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"runs": -1}, "runs = -1"),
        ({"runs": 2**60}, "too much for this machine"),
        ({"seed": -1}, "seed = -1"),
        ({"workers": 0}, "workers = 0"),
        ({"engine": "spark"}, "engine = 'spark'"),
        ({"client": 3}, "client"),
        ({"folder": __file__}, "cannot be used"),
    ],
)
def test_mistakes_in_a_call_are_one_line(close, changes, text):
    with pytest.raises(tr.ParameterError) as error:
        close.run(**({"runs": 2} | changes))
    assert text in str(error.value)


def test_mistakes_with_chunks_are_one_line(close):
    for call in (
        lambda: close.chunk(0, -1, 2),
        lambda: close.chunk(0, 2**64 - 1, 2),
        lambda: close.chunks(10, 0, 0),
        lambda: close.merge([], 0, 2),
        lambda: close.merge([close_study(npda=tracker()).chunk(0, 0, 2).run()], 0, 2),
    ):
        with pytest.raises(tr.ParameterError):
            call()


def test_a_scenario_that_fails_is_named_with_its_run(tmp_path):
    class Breaks(Own):
        def draw(self, seed, run):
            if run == 12:
                raise OSError("gone")
            return super().draw(seed, run)

    study = tr.Study(Breaks(RADAR), {"npda": tracker()}, OSPA)
    with pytest.raises(OSError, match="gone") as error:
        study.run(40, SEED, folder=tmp_path, workers=1)
    assert error.value.__notes__ == ["while run 12 of a study with seed 7 was drawn"]
    done = []
    with pytest.raises(OSError, match="gone"):
        study.run(40, SEED, folder=tmp_path, workers=1, progress=lambda n, _: done.append(n))
    assert done[0] > 0


def test_progress_counts_up_to_all(close):
    seen = []
    close.run(31, SEED, progress=lambda done, runs: seen.append((done, runs)))
    counts = [done for done, _ in seen]
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, 31)
    assert {runs for _, runs in seen} == {31}


SLOW = """
import signal, sys, time
# A shell that starts the tests in the background has Ctrl-C ignored by all they start.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, {tests!r})
import trackrs as tr
from studies import close_study
study = close_study()
def progress(done, runs):
    if done > 0:
        print("go", flush=True)
try:
    study.run(10**6, 7, folder={folder!r}, progress=progress)
except KeyboardInterrupt:
    print("stopped", flush=True)
"""


def test_ctrl_c_keeps_what_is_finished(tmp_path, close):
    script = SLOW.format(tests=str(Path(__file__).parent), folder=str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        while process.stdout.readline().strip() != "go":
            pass
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=60)
    assert "stopped" in out
    counts = []
    result = close.run(3, 7, folder=tmp_path, progress=lambda done, _: counts.append(done))
    assert counts[0] > 0
    assert result.to_bytes() == close.run(3, 7).to_bytes()


def test_stopping_ends_a_run_between_scans():
    scene = tr.scenarios.crossing(clutter=40.0)
    study = tr.Study(scene, {"phd": phd(scene)}, OSPA)
    stop = tr._trackrs.StudyStop()
    parts = []
    thread = threading.Thread(target=lambda: parts.append(study._run(SEED, 0, 10_000, stop)))
    thread.start()
    time.sleep(0.3)
    stop.set()
    thread.join(timeout=30.0)
    assert not thread.is_alive()
    rows = len(parts[0].values)
    assert rows < 10_000
    assert_array_equal(parts[0].values, study._run(SEED, 0, rows, tr._trackrs.StudyStop()).values)
