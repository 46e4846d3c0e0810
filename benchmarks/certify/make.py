"""Solve the certified problems with 60-digit arithmetic and write them with their answers to tests/data/certified.

    python benchmarks/certify/make.py            # needs mpmath (1.4.1 was used), and gmpy2 to be quick

Nothing here knows trackrs: the formulas are those of the textbooks, in the modules beside this one. Every problem is
solved twice, with 60 and with 90 digits, and written only where the two agree to 34 digits in the scale of its answers
(the textbook update of a covariance of condition 1e24 loses 24 of the 60).

Its condition is measured: all given numbers are moved by a random share of at most 1e-30 (symmetric matrices stay so),
and the largest relative change of the answers over that share is written. A stable algorithm in doubles loses about its
decimal logarithm of the 16 digits.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from random import Random

import association
import filter_problems
import filters
import intensity
import mpmath
import points
import scalars
import set_problems
from arithmetic import exact
from mpmath import mp, mpf

OUT = Path(__file__).resolve().parent.parent.parent / "tests" / "data" / "certified"
DIGITS, CHECK_DIGITS, AGREE, WRITTEN = 60, 90, mpf(10) ** -34, 32
FAMILIES = filter_problems.FAMILIES | set_problems.FAMILIES
SHARE, TRIALS = mpf(10) ** -30, 4
SOLVERS = {
    "filter": filters.run,
    "marginals": association.marginals,
    "tracker": association.track,
    "phd": intensity.phd,
    "cphd": intensity.cphd,
    "ospa": points.ospa,
    "gospa": points.gospa,
    "density_peaks": points.density_peaks,
    "lof": points.outlier_factors,
    "trees": points.trees,
    "chi_square": scalars.chi_square,
    "nees": scalars.nees,
    "to_ecef": scalars.to_ecef,
    "to_geodetic": scalars.to_geodetic,
}
# An answer below this is as good as 0 in doubles.
NOTHING = mpf("1e-290")


def flat(value):
    return [x for item in value for x in flat(item)] if isinstance(value, list) else [value]


def errors(found, expected, scale):
    """Largest |found - expected| over its scale; see tests/certified_problems.py."""
    if scale == "exact":
        return mpf(0) if found == expected else mp.inf
    if scale == "cov":
        if isinstance(expected[0][0], list):
            return max(errors(a, b, scale) for a, b in zip(found, expected, strict=True))
        deviations = [mp.sqrt(expected[i][i]) for i in range(len(expected))]
        units = [a * b for a in deviations for b in deviations]
    elif scale == "row":
        return max(
            max(abs(a - b) for a, b in zip(x, y, strict=True)) / max(map(abs, y))
            for x, y in zip(found, expected, strict=True)
        )
    elif scale == "each":
        units = [max(abs(x), NOTHING) for x in flat(expected)]
    else:
        units = flat(scale)
    return max(abs(a - b) / u for a, b, u in zip(flat(found), flat(expected), units, strict=True))


def moved(value, rng):
    """The given numbers, each times 1 + up to `SHARE` either way."""
    if isinstance(value, dict):
        return {key: moved(item, rng) for key, item in value.items()}
    if isinstance(value, list):
        out = [moved(item, rng) for item in value]
        square = bool(value) and all(isinstance(row, list) and len(row) == len(value) for row in value)
        if square and all(value[i][j] == value[j][i] for i in range(len(value)) for j in range(i)):
            for i in range(len(value)):
                for j in range(i):
                    out[i][j] = out[j][i]
        return out
    return value * (1 + SHARE * rng.randint(-1000, 1000) / 1000) if isinstance(value, mpf) else value


def written(value):
    if isinstance(value, list):
        return [written(item) for item in value]
    return mp.nstr(value, WRITTEN, strip_zeros=False, min_fixed=-4, max_fixed=20) if isinstance(value, mpf) else value


def certified(problem):
    solver = SOLVERS[problem["kind"]]
    mp.dps = CHECK_DIGITS
    check = solver(exact(problem["given"]))
    mp.dps = DIGITS
    given = exact(problem["given"])
    answers = solver(given)
    for name, (scale, value) in answers.items():
        off = errors(value, check[name][1], scale)
        if off > AGREE:
            raise ArithmeticError(f"{problem['name']}: {name} has no 34 digits: {mp.nstr(off, 3)}")
    rng, condition = Random(1), dict.fromkeys(answers, mpf(0))  # noqa: S311
    for _ in range(TRIALS):
        other = solver(moved(given, rng))
        for name, (scale, value) in answers.items():
            condition[name] = max(condition[name], errors(other[name][1], value, scale) / SHARE)
    known = {
        name: {"scale": rounded(scale), "condition": float(mp.nstr(condition[name], 2)), "value": written(value)}
        for name, (scale, value) in answers.items()
    }
    return problem | {"answers": known}


def rounded(scale):
    """A scale as doubles of few digits: it judges an error, it is no answer."""
    if isinstance(scale, list):
        return [rounded(item) for item in scale]
    return scale if isinstance(scale, str) else float(mp.nstr(scale, 4))


def text(value, indent=0):
    """JSON with one line per list of numbers."""
    if isinstance(value, dict):
        inner = ",\n".join(f"{' ' * (indent + 1)}{json.dumps(k)}: {text(v, indent + 1)}" for k, v in value.items())
        return f"{{\n{inner}\n{' ' * indent}}}"
    if isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        inner = ",\n".join(" " * (indent + 1) + text(item, indent + 1) for item in value)
        return f"[\n{inner}\n{' ' * indent}]"
    return json.dumps(value, allow_nan=False)


def main(families):
    OUT.mkdir(parents=True, exist_ok=True)
    provenance = {
        "script": "benchmarks/certify/make.py",
        "mpmath": mpmath.__version__,
        "digits": DIGITS,
        "agreeing_with": f"{CHECK_DIGITS} digits, to 34",
        "written": WRITTEN,
    }
    count = 0
    for family in families:
        problems = []
        for problem in FAMILIES[family]():
            problems.append(certified(problem))
            conditions = (f"{name} {answer['condition']:.0e}" for name, answer in problems[-1]["answers"].items())
            print(f"{family:12} {problem['name']:24} {problem['difficulty']:9}", *conditions, flush=True)
        count += len(problems)
        (OUT / f"{family}.json").write_text(text({"provenance": provenance, "problems": problems}) + "\n")
    print(count, "problems")


if __name__ == "__main__":
    main(sys.argv[1:] or FAMILIES)
