"""Assignment and scores from Python, against SciPy and by hand."""

from __future__ import annotations

import itertools
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import linear_sum_assignment

import trackrs as tr

DATA = Path(__file__).parent / "data"


def scipy_optimum(costs):
    """Most pairs first, then the smallest sum: SciPy with a penalty, exact because the costs are whole numbers."""
    penalty = 1e7
    rows, columns = linear_sum_assignment(np.where(np.isinf(costs), penalty, costs))
    kept = np.isfinite(costs[rows, columns])
    return int(kept.sum()), float(costs[rows, columns][kept].sum())


def test_assignment_equals_scipy_on_ten_thousand_problems():
    rng = np.random.default_rng(0)
    for _ in range(10_000):
        shape = rng.integers(1, 9, 2)
        costs = rng.integers(-50, 100, shape).astype(float)
        costs[rng.random(shape) < rng.choice([0.0, 0.2, 0.6])] = np.inf
        solved = tr.assign(costs)
        rows = np.flatnonzero(solved.columns >= 0)
        columns = solved.columns[rows]
        assert len(set(columns.tolist())) == len(columns)
        assert costs[rows, columns].sum() == solved.cost
        assert (len(rows), solved.cost) == scipy_optimum(costs)


def test_assignment_with_real_costs_equals_scipy():
    rng = np.random.default_rng(1)
    for _ in range(300):
        costs = rng.normal(size=rng.integers(1, 60, 2))
        rows, columns = linear_sum_assignment(costs)
        assert tr.assign(costs).cost == pytest.approx(costs[rows, columns].sum(), rel=1e-12, abs=1e-12)


def test_assignment_refuses_nan():
    with pytest.raises(tr.NonFiniteError, match="index 1"):
        tr.assign([[0.0, np.nan]])


def test_gate_thresholds_equal_scipy():
    for dof in (1, 2, 3, 4, 6, 9, 100):
        for probability in (1e-6, 0.01, 0.5, 0.9, 0.99, 0.9999, 1 - 1e-9):
            expected = stats.chi2.ppf(probability, dof)
            assert tr.Gate(probability).threshold(dof) == pytest.approx(expected, rel=1e-10)


def test_ospa_equals_the_golden_values():
    for case in json.loads((DATA / "et_ospa.json").read_text())["cases"]:
        out = tr.ospa(case["X"], case["Y"], c=case["c"], p=case["p"])
        for part in ("total", "localisation", "cardinality"):
            assert getattr(out, part) == pytest.approx(case[part], rel=1e-9, abs=1e-9)


def test_gospa_parts_add_up():
    out = tr.gospa([[0.0, 0.0], [100.0, 0.0]], [[3.0, 4.0], [300.0, 0.0], [-300.0, 0.0]], c=30.0)
    assert [(p.truth, p.estimate, p.distance) for p in out.pairs] == [(0, 0, 5.0)]
    assert (out.localisation, out.missed, out.false_tracks) == (25.0, 450.0, 900.0)
    assert out.total == pytest.approx((25.0 + 450.0 + 900.0) ** 0.5)
    assert tr.gospa([], [], c=30.0).total == 0.0


@pytest.mark.parametrize("c", [5.0, 60.0, 1e4])
@pytest.mark.parametrize("p", [1.0, 2.0])
def test_metrics_of_many_points_equal_the_full_matrix(c, p):
    rng = np.random.default_rng(4)
    x = rng.uniform(0.0, 1000.0, (150, 2))
    y = rng.permutation(np.concatenate([x + rng.normal(0.0, 15.0, x.shape), rng.uniform(0.0, 1000.0, (20, 2))]))
    full = np.linalg.norm(x[:, None] - y[None], axis=2)
    costs = np.minimum(full, c) ** p
    rows, columns = linear_sum_assignment(costs)
    ospa = tr.ospa(x, y, c=c, p=p)
    assert ospa.localisation == pytest.approx((costs[rows, columns].sum() / len(y)) ** (1 / p), rel=1e-12)
    gospa = tr.gospa(y, x, c=c, p=p)
    pairs = full[rows, columns] < c
    assert {(q.estimate, q.truth) for q in gospa.pairs} == set(zip(rows[pairs], columns[pairs], strict=True))
    assert gospa.localisation == pytest.approx(costs[rows, columns][pairs].sum(), rel=1e-12)
    assert pickle.loads(pickle.dumps(gospa)) == gospa


def tracks_of(rows, scan_times):
    """`Tracks` from (scan, id, x, y) rows."""
    rows = sorted(rows)
    counts = [sum(r[0] == k for r in rows) for k in range(len(scan_times))]
    return tr.Tracks(
        scan_times=np.array(scan_times, dtype=float),
        sensors=("radar",) * len(scan_times),
        times=np.array([scan_times[r[0]] for r in rows], dtype=float),
        ids=np.array([r[1] for r in rows], dtype=np.uint64),
        means=np.array([r[2:] for r in rows], dtype=float).reshape(-1, 2),
        covs=np.tile(np.eye(2), (len(rows), 1, 1)),
        last_hits=np.zeros(len(rows)),
        hits=np.ones(len(rows), dtype=np.uint64),
        labels=("x", "y"),
        offsets=np.concatenate([[0], np.cumsum(counts)]),
    )


def test_evaluation_counts_holds_switches_and_false_tracks():
    times = [0.0, 60.0, 120.0, 180.0]
    truth = [tr.Truth("a", [0.0, 180.0], [[0, 0], [18, 0]]), tr.Truth("b", [0.0, 180.0], [[100, 0], [100, 0]])]
    rows = [(k, 1, 6.0 * k + 3.0, 4.0) for k in range(2)]  # a held by 1, then by 3: a switch
    rows += [(k, 3, 6.0 * k + 3.0, 4.0) for k in range(2, 4)]
    rows += [(k, 2, 100.0, 0.0) for k in range(3)]  # b held, lost at the end
    rows += [(2, 9, -200.0, 0.0)]  # a false track
    metric = tr.GOSPA(c=30.0)
    score = tr.evaluate(truth, tracks_of(rows, times), [metric, tr.OSPA(c=30.0)])
    assert score.all_held == 0.75
    assert score.switches == 1
    assert score.false_ids == (9,)
    assert score.false_per_minute == pytest.approx(1 / 3)
    expected = [25.0, 25.0, 25.0 + 450.0, 25.0 + 450.0]
    np.testing.assert_allclose(score.series[metric], np.sqrt(expected))
    assert score.mean[metric] == pytest.approx(np.mean(np.sqrt(expected)))
    assert (score.missed, score.false_tracks, score.localisation) == (112.5, 112.5, 25.0)
    a, b = score.per_target
    assert (a.present, a.held, a.fragments, a.switches, a.longest) == (4, 4, 2, 1, 0.5)
    assert (b.present, b.held, b.fragments, b.switches, b.longest) == (4, 3, 1, 0, 0.75)
    assert score.rmse == pytest.approx((4 * 25.0 / 7) ** 0.5)
    assert score.nees == pytest.approx(4 * 25.0 / 7)


def test_a_track_or_target_twice_at_one_time_is_named():
    truth, metrics = tr.Truth("a", [0.0, 60.0], [[0, 0], [0, 0]]), [tr.GOSPA(c=30.0)]
    twice = tracks_of([(0, 5, 0.0, 0.0), (1, 5, 0.0, 0.0), (1, 5, 1.0, 0.0)], [0.0, 60.0])
    with pytest.raises(tr.ParameterError, match="track id = 5 twice at 60 s is invalid: must be there once"):
        tr.evaluate([truth], twice, metrics)
    with pytest.raises(tr.ParameterError, match="truth = a is invalid: must be there once"):
        tr.evaluate([truth, truth], tracks_of([(0, 5, 0.0, 0.0)], [0.0]), metrics)


@pytest.mark.parametrize("seed", range(20))
def test_scores_of_tracks_lost_and_found_again_equal_those_counted_by_hand(seed):
    """Pairs by SciPy, scan by scan; holds, fragments and switches counted from the list of who held whom."""
    rng = np.random.default_rng(seed)
    scans, targets, cutoff = 40, 4, 20.0
    times = np.arange(scans, dtype=float)
    paths = np.cumsum(rng.normal(0.0, 8.0, (scans, targets, 2)), axis=0) + rng.uniform(-40, 40, (targets, 2))
    truth = [tr.Truth(str(j), times, paths[:, j]) for j in range(targets)]
    ids, rows, held = list(range(1, targets + 1)), [], [[] for _ in range(targets)]
    for k in range(scans):
        # Tracks are lost for some scans, and found again with the same identity, a new one, or that of another.
        for j in range(targets):
            if rng.random() < 0.1:
                ids[j] = rng.choice([max(ids) + 1, ids[j]])
        if rng.random() < 0.1:
            rng.shuffle(ids)
        seen = [j for j in range(targets) if rng.random() < 0.7]
        found = {int(ids[j]): paths[k, j] + rng.normal(0.0, 4.0, 2) for j in seen}
        rows += [(k, track, *position) for track, position in found.items()]
        if not found:
            continue
        apart = np.linalg.norm(paths[k][:, None] - np.array(list(found.values()))[None], axis=2)
        for j, i in zip(*linear_sum_assignment(np.minimum(apart, cutoff) ** 2), strict=True):
            if apart[j, i] < cutoff:
                held[j].append(list(found)[i])
    score = tr.evaluate(truth, tracks_of(rows, times), [tr.GOSPA(c=cutoff)])
    for target, by in zip(score.per_target, held, strict=True):
        changes = sum(a != b for a, b in itertools.pairwise(by))
        assert (target.held, target.switches, target.fragments) == (len(by), changes, changes + bool(by))
        assert target.longest == max((by.count(track) for track in by), default=0) / scans
    assert set(score.false_ids) == {row[1] for row in rows} - {track for by in held for track in by}


def test_what_is_outside_the_region_does_not_count():
    truth = [tr.Truth("in", [0.0, 60.0], [[10, 0], [10, 0]]), tr.Truth("out", [0.0, 60.0], [[60, 0], [60, 0]])]
    # Track 2 stands just inside but belongs to the target just outside; track 3 is far out; track 4 is false.
    rows = [(k, *row) for k in range(2) for row in ((1, 10.0, 0.0), (2, 45.0, 0.0), (3, 500.0, 0.0), (4, -40.0, 0.0))]
    score = tr.evaluate(
        truth, tracks_of(rows, [0.0, 60.0]), [tr.GOSPA(c=30.0)], region=50.0, centres=[[0.0, 0.0], [0.0, 0.0]]
    )
    assert score.targets.tolist() == [1, 1]
    assert score.tracks.tolist() == [2, 2]
    assert score.false_ids == (4,)
    assert np.isnan(score.all_held)


def test_evaluation_names_what_is_missing():
    truth, tracks = [tr.Truth("a", [0.0], [[0.0, 0.0]])], tracks_of([(0, 1, 0.0, 0.0)], [0.0])
    with pytest.raises(tr.ParameterError, match="metrics is empty"):
        tr.evaluate(truth, tracks, [])
    with pytest.raises(tr.ParameterError, match="region and centres go together"):
        tr.evaluate(truth, tracks, [tr.GOSPA(c=1.0)], region=1.0)
    with pytest.raises(tr.ParameterError, match="nothing to score"):
        tr.evaluate(truth, tracks, [tr.GOSPA(c=1.0)], sensor="sonar")
    with pytest.raises(tr.DimensionError, match="coordinates of a centre has size 3, expected 2"):
        tr.evaluate(truth, tracks, [tr.GOSPA(c=1.0)], region=1.0, centres=[0.0, 0.0, 0.0])
    with pytest.raises(tr.ParameterError, match="c = 0"):
        tr.gospa([[0.0]], [[0.0]], c=0.0)
    with pytest.raises(tr.ParameterError, match="alpha = 3"):
        tr.gospa([[0.0]], [[0.0]], c=1.0, alpha=3.0)
    with pytest.raises(tr.TimeError):
        tr.evaluate([tr.Truth("a", [1.0, 0.0], [[0.0, 0.0]] * 2)], tracks, [tr.GOSPA(c=1.0)])
    with pytest.raises(tr.DimensionError, match="2 times and 1 positions"):
        tr.Truth("a", [0.0, 1.0], [[0.0, 0.0]])
