"""Problems solved with 60 digits: how many digits trackrs has right, by difficulty."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr
from certified_problems import BARS, FOLDER, MOST, SOLVERS, digits, flat, load, run_of, solved

ROOT = Path(__file__).resolve().parent.parent
PROBLEMS = load()
# What trackrs does not reach although the problem allows it; strict, so that a repair must take its line out.
FAULTS = {
    "smoother_1e8": "P of the filter in Joseph form has lost digits before anything is smoothed; by factors it has not",
}


def marked(problem):
    reason = FAULTS.get(problem["name"])
    marks = () if reason is None else pytest.mark.xfail(strict=True, raises=AssertionError, reason=reason)
    return pytest.param(problem, id=problem["name"], marks=marks)


def named(*kinds):
    return [pytest.param(p, id=p["name"]) for p in PROBLEMS if p["kind"] in kinds]


@pytest.mark.parametrize("problem", [marked(problem) for problem in PROBLEMS])
def test_digits(problem):
    found = solved(problem)
    assert found.keys() == problem["answers"].keys()
    short = {name: round(value, 1) for name, value in found.items() if value < BARS[problem["difficulty"]]}
    assert not short


def test_there_are_forty_problems_of_three_difficulties():
    names = [problem["name"] for problem in PROBLEMS]
    counts = Counter(problem["difficulty"] for problem in PROBLEMS)
    assert len(set(names)) == len(names) >= 40
    assert counts.keys() == BARS.keys()
    assert min(counts.values()) >= 10
    assert {problem["kind"] for problem in PROBLEMS} == SOLVERS.keys()
    assert set(FAULTS) <= set(names)
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 600_000


def test_answers_have_thirty_digits_and_inputs_are_doubles():
    for path in FOLDER.glob("*.json"):
        text = path.read_text()
        data = json.loads(text)
        assert data["provenance"]["digits"] == 60
        assert data["provenance"]["script"] == "benchmarks/certify/make.py"
        assert json.loads(json.dumps(data)) == data
        # What is not in quotes is a double as Python writes it.
        for number in re.findall(r"(?<=[\[ ])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?=[,\]\n])", re.sub(r'"[^"]*"', "", text)):
            assert repr(json.loads(number)) == number
    for problem in PROBLEMS:
        for answer in problem["answers"].values():
            for value in flat(answer["value"]):
                if isinstance(value, str):
                    mantissa = value.lower().partition("e")[0].lstrip("-").replace(".", "").lstrip("0")
                    assert len(mantissa) >= 30 or float(value) == 0.0


def test_the_formulas_of_the_answers_do_not_know_trackrs():
    modules = list((ROOT / "benchmarks" / "certify").glob("*.py"))
    assert modules
    for path in modules:
        assert not re.search(r"^\s*(import|from) +_?trackrs", path.read_text(), re.MULTILINE)


@pytest.mark.parametrize(
    ("scale", "found", "expected"),
    [
        ("each", [1.0, 1.00001e-200], 5.0),
        ("each", [1.0, 1e-200], MOST),
        ("each", [math.nan, 1e-200], 0.0),
        ("each", [1.0], 0.0),
        ([1.0, 1e-190], [1.0, 1.001e-200], 13.0),
    ],
)
def test_digits_are_counted_in_the_scale_of_the_answer(scale, found, expected):
    assert abs(digits(found, {"scale": scale, "value": ["1.0", "1.0e-200"]}) - expected) < 1e-3


def test_digits_of_covariances_have_no_units():
    known = [["4.0e12", "0.0"], ["0.0", "1.0e-12"]]
    found = [[4.0e12, 2e-6], [2e-6, 1.0e-12]]
    assert abs(digits([found], {"scale": "cov", "value": [known]}) - 6.0) < 1e-9
    assert digits([[1, 0]], {"scale": "exact", "value": [[0, 1]]}) == 0.0


def definite(cov):
    """Whether a matrix of doubles is positive definite, without any rounding."""
    rows = [[Fraction(x) for x in row] for row in cov.tolist()]
    for k in range(len(rows)):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return True


@pytest.mark.parametrize("problem", named("filter"))
def test_every_covariance_is_symmetric_and_that_of_joseph_definite(problem):
    run = run_of(problem["given"])
    covs = [*run.covs, *(run.smooth().covs if problem["given"].get("smooth") else ())]
    assert all(np.array_equal(cov, cov.T) for cov in covs)
    if problem["given"]["form"] == "joseph":
        assert all(map(definite, covs))


@pytest.mark.parametrize("problem", [p for p in named("gospa") if p.id not in FAULTS])
def test_gospa_the_other_way_round(problem):
    given = problem["given"]
    extents = given.get("extents")
    there = tr.gospa(given["truth"], given["estimates"], given["c"], given["p"], extents=extents)
    back = tr.gospa(given["estimates"], given["truth"], given["c"], given["p"], extents=extents and extents[::-1])
    assert (there.missed, there.false_tracks) == (back.false_tracks, back.missed)
    assert {(p.truth, p.estimate) for p in there.pairs} == {(p.estimate, p.truth) for p in back.pairs}
    assert there.total == pytest.approx(back.total, rel=1e-14)
    assert all(math.copysign(1.0, part) == 1.0 for part in (there.localisation, there.missed, there.false_tracks))
