"""Joint association and k-best assignment, as Python sees them."""

from __future__ import annotations

import itertools
import json
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr
from trackrs.association import assign_sparse, k_best, marginals


def enumerate_events(weights: np.ndarray) -> tuple[np.ndarray, float]:
    """The definition: every joint event."""
    tracks, columns = weights.shape
    sums, total = np.zeros_like(weights), 0.0
    for event in itertools.product(range(columns), repeat=tracks):
        taken = [column for column in event if column]
        if len(set(taken)) < len(taken):
            continue
        weight = np.prod([weights[track, column] for track, column in enumerate(event)])
        total += weight
        sums[np.arange(tracks), event] += weight
    return sums / total, float(np.log(total))


def test_sparse_assignment_is_that_of_the_full_matrix():
    rng = np.random.default_rng(3)
    for _ in range(100):
        shape = tuple(rng.integers(1, 30, 2).tolist())
        allowed = rng.random(shape) < rng.uniform(0.05, 0.5)
        costs = np.where(allowed, rng.normal(size=shape), np.inf)
        rows, columns = np.nonzero(allowed)
        sparse = assign_sparse(rows, columns, costs[allowed], shape=shape)
        dense = tr.assign(costs)
        np.testing.assert_array_equal(sparse.columns, dense.columns)
        assert sparse.cost == pytest.approx(dense.cost, rel=1e-12, abs=1e-12)


def test_sparse_assignment_refuses():
    with pytest.raises(tr.ParameterError, match=r"\(2, 0\)"):
        assign_sparse([2], [0], [1.0], shape=(2, 1))
    with pytest.raises(tr.ParameterError, match="must lie within"):
        assign_sparse([-1], [0], [1.0], shape=(2, 1))
    with pytest.raises(tr.DimensionError, match="columns"):
        assign_sparse([0], [0, 1], [1.0], shape=(2, 2))
    with pytest.raises(tr.DimensionError, match="rows must be a list of whole numbers"):
        assign_sparse([0.5], [0], [1.0], shape=(2, 2))
    with pytest.raises(tr.NonFiniteError):
        assign_sparse([0], [0], [np.nan], shape=(2, 2))
    assert assign_sparse([], [], [], shape=(2, 0)).columns.tolist() == [-1, -1]


@pytest.mark.parametrize("log", [False, True])
def test_marginals_are_those_of_all_joint_events(log):
    rng = np.random.default_rng(0)
    for _ in range(50):
        tracks, reports = rng.integers(1, 5), rng.integers(0, 5)
        weights = rng.random((tracks, reports + 1)) * (rng.random((tracks, reports + 1)) < 0.7)
        weights[:, 0] = 0.1
        expected, log_total = enumerate_events(weights)
        with np.errstate(divide="ignore"):
            found = marginals(np.log(weights) if log else weights, log=log)
        np.testing.assert_allclose(found.probabilities, expected, rtol=1e-12)
        assert found.log_total == pytest.approx(log_total, rel=1e-12, abs=1e-12)
        assert (found.method, found.error_bound) == ("exact", 0.0)


CASES = json.loads((Path(__file__).parent / "data" / "npda_d300.json").read_text())["cases"]


def of_single_report(logf: np.ndarray, p_d: float = 0.5, density: float | None = None) -> np.ndarray:
    """N17: one report, clutter of this density or, None, no clutter; there the report is sure to be of a track."""
    if density is None:
        logs = np.column_stack([np.full(len(logf), -5e3), logf])
    else:
        logs = np.column_stack([np.full(len(logf), np.log(1 - p_d)), np.log(p_d / density) + logf])
    return marginals(logs, log=True).probabilities[:, 1]


@pytest.mark.parametrize("case", ["npda_paper", "npda_mm", "npda_joseph", "jpda1_lambda0"])
def test_npda_without_clutter_is_jpda_of_single_reports(case):
    for step in CASES[case]["steps"]:
        logf = np.array(step["logf"])
        found = of_single_report(logf)
        weights = np.exp(logf - logf.max())
        np.testing.assert_allclose(found, weights / weights.sum(), rtol=0, atol=1e-14)
        np.testing.assert_allclose(found, step["beta"], rtol=1e-10, atol=1e-10)


def test_jpda_of_single_reports_in_clutter():
    case = CASES["jpda1_lambda1e-3_pd0.3"]
    for step in case["steps"]:
        found = of_single_report(np.array(step["logf"]), case["kw"]["pd"], case["kw"]["lam"])
        np.testing.assert_allclose(found, step["beta"], rtol=1e-10, atol=1e-10)


def test_pda_is_jpda_of_each_track_alone():
    case = CASES["pdaf_lambda1e-3_pd0.3"]
    for step in case["steps"]:
        found = [of_single_report(np.array([f]), case["kw"]["pd"], case["kw"]["lam"])[0] for f in step["logf"]]
        np.testing.assert_allclose(found, step["beta"], rtol=1e-10, atol=1e-10)


def test_jpda_of_scans():
    case = CASES["jpda_scan_pd0.9_lambda1e-3"]
    p_d = case["kw"]["pd"]
    for step in case["steps"]:
        against_clutter = np.array(step["logf"]).T  # the file has reports by targets, and ln λ already taken off
        logs = np.column_stack([np.full(len(against_clutter), np.log(1 - p_d)), np.log(p_d) + against_clutter])
        found = marginals(logs, log=True).probabilities
        np.testing.assert_allclose(found, step["beta"], rtol=1e-9, atol=1e-10)


def test_logarithms_far_from_zero_are_exact():
    found = marginals([[-1e4, 0.0], [-1e4, 0.0]], log=True)
    np.testing.assert_allclose(found.probabilities, 0.5, rtol=1e-15)
    assert found.log_total == pytest.approx(np.log(2.0) - 1e4, rel=1e-15)


def test_pruning_keeps_one_of_two_permutations():
    # Both tracks are seen, each nearer to its own report; crossed over they are half as likely.
    weights = [[1e-9, 2.0, 1.0], [1e-9, 1.0, 1.0]]
    plain, pruned = marginals(weights), marginals(weights, prune=True)
    np.testing.assert_allclose(plain.probabilities[:, 1:], [[2 / 3, 1 / 3], [1 / 3, 2 / 3]], atol=1e-8)
    np.testing.assert_allclose(pruned.probabilities[:, 1:], np.eye(2), atol=1e-8)


def test_the_budget_is_kept_and_announced():
    rng = np.random.default_rng(1)
    weights = np.column_stack([np.full(30, 0.1), rng.random((30, 30))])
    found = marginals(weights)
    assert (found.method, found.error_bound) == ("belief", None)
    np.testing.assert_allclose(found.probabilities.sum(axis=1), 1.0)
    clear = 1e-6 * rng.random((30, 30)) + np.eye(30)
    found = marginals(np.column_stack([np.full(30, 1e-6), clear]))
    assert found.method == "m_best"
    assert 0.0 < found.error_bound <= 0.01
    small = marginals(weights[:5, :6], budget=0)
    assert small.method != "exact"


def test_belief_is_close_to_exact():
    rng = np.random.default_rng(2)
    distances = []
    for _ in range(100):
        weights = np.column_stack([np.full(9, 0.1), 5.0 * np.exp(-0.75 * rng.chisquare(2, (9, 10)))])
        exact, other = marginals(weights), marginals(weights, budget=0)
        distances.append(0.5 * np.abs(exact.probabilities - other.probabilities).sum(axis=1).max())
    assert np.median(distances) <= 0.05


def test_nothing_is_a_legal_scan():
    assert marginals(np.zeros((0, 4))).probabilities.shape == (0, 4)
    np.testing.assert_array_equal(marginals([[0.1], [0.2]]).probabilities, [[1.0], [1.0]])


def test_results_are_read_only():
    found = marginals([[0.1, 1.0]])
    with pytest.raises(FrozenInstanceError):
        found.method = "guess"
    with pytest.raises(ValueError, match="read-only"):
        found.probabilities[0, 0] = 1.0


@pytest.mark.parametrize(
    ("weights", "options", "error", "message"),
    [
        ([[0.1, np.nan]], {}, tr.NonFiniteError, r"weights\[0, 1\]"),
        ([[0.1, 1.0], [-0.1, 1.0]], {}, tr.ParameterError, r"weights\[1, 0\] = -0\.1"),
        ([[0.1, np.inf]], {"log": True}, tr.NonFiniteError, r"weights\[0, 1\]"),
        ([[0.0, 0.0]], {}, tr.ParameterError, r"weights\[0, 0\] = 0"),
        ([[0.0, 1.0], [0.0, 1.0]], {}, tr.ParameterError, r"tracks = \[0, 1\]"),
        ([0.1, 1.0], {}, tr.DimensionError, "weights must have 2 dimensions"),
        (np.zeros((2, 0)), {}, tr.ParameterError, "column 0"),
        ([[0.1, 1.0]], {"budget": -1}, tr.ParameterError, "budget = -1"),
    ],
)
def test_errors_name_the_culprit(weights, options, error, message):
    with pytest.raises(error, match=message):
        marginals(weights, **options)


def test_k_best_is_the_sorted_list_of_all():
    costs = np.random.default_rng(3).normal(size=(3, 4))
    every = sorted(costs[np.arange(3), list(columns)].sum() for columns in itertools.permutations(range(4), 3))
    found = k_best(costs, 1000)
    np.testing.assert_allclose([best.cost for best in found], every, rtol=1e-12, atol=1e-12)
    assert found[0].cost == pytest.approx(tr.assign(costs).cost)
    np.testing.assert_array_equal(found[0].columns, tr.assign(costs).columns)
    assert len(k_best(costs, 5)) == 5
    assert k_best(costs, 0) == ()


def test_k_best_with_misses():
    found = k_best([[1.0, np.inf]], 10, miss_costs=[3.0])
    assert [(best.columns.tolist(), best.cost) for best in found] == [([0], 1.0), ([-1], 3.0)]


def test_k_best_refuses_by_name():
    with pytest.raises(tr.ParameterError, match="k = -1"):
        k_best([[1.0]], -1)
    with pytest.raises(tr.NonFiniteError, match="cost"):
        k_best([[np.nan]], 1)
    with pytest.raises(tr.DimensionError, match="miss costs"):
        k_best([[1.0]], 1, miss_costs=[1.0, 2.0])
