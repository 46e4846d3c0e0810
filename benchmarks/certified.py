"""Correct digits of trackrs and its peers on the certified problems, as a table into docs/certified.md.

python benchmarks/certified.py       # needs mpmath, FilterPy, Stone Soup and pykalman beside trackrs
"""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

import numpy as np  # noqa: E402
from certified_peers import PEERS  # noqa: E402

import trackrs as tr  # noqa: E402
from certified_problems import BARS, SOLVERS, digits, load  # noqa: E402

PAGE = ROOT / "docs" / "certified.md"
BEGIN, END = "<!-- measured: begin -->\n", "<!-- measured: end -->"


def scored(problem, solver):
    """Digits of the worst answer, None where the problem cannot be stated, or the name of the error."""
    try:
        found = solver(problem)
    except (ArithmeticError, AssertionError, ValueError, np.linalg.LinAlgError) as error:
        return type(error).__name__
    return None if found is None else min(digits(found[name], problem["answers"][name]) for name in found)


def cell(score, bar):
    if score is None:
        return ""
    if isinstance(score, str):
        return f"*{score}*"
    return f"{score:.1f}" if score >= bar else f"**{score:.1f}**"


def main() -> None:
    solvers = {"trackrs": lambda problem: SOLVERS[problem["kind"]](problem["given"])} | PEERS
    lines = [f"| problem | what | condition | {' | '.join(solvers)} |", "|---|---|---|" + "---|" * len(solvers)]
    problems, short, best = load(), dict.fromkeys(solvers, 0), dict.fromkeys(solvers, 0)
    for difficulty, bar in BARS.items():
        lines.append(f"| **{difficulty}: at least {bar:.0f}** |" + " |" * (2 + len(solvers)))
        for problem in (p for p in problems if p["difficulty"] == difficulty):
            scores = {name: scored(problem, solver) for name, solver in solvers.items()}
            for name, score in scores.items():
                best[name] += score is not None
                short[name] += score is not None and (isinstance(score, str) or score < bar)
            condition = max(answer["condition"] for answer in problem["answers"].values())
            cells = " | ".join(cell(score, bar) for score in scores.values())
            lines.append(f"| `{problem['name']}` | {problem['what']} | {max(condition, 1.0):.0e} | {cells} |")
    lines.append("| stated |  |  | " + " | ".join(str(n) for n in best.values()) + " |")
    lines.append("| short of the bar |  |  | " + " | ".join(str(n) for n in short.values()) + " |")
    packages = {
        "FilterPy": "filterpy",
        "Stone Soup": "stonesoup",
        "pykalman": "pykalman",
        "NumPy": "numpy",
        "mpmath": "mpmath",
    }
    versions = ", ".join(f"{name} {version(package)}" for name, package in packages.items())
    lines += ["", f"trackrs {tr.__version__}, {versions}."]
    text = PAGE.read_text()
    before, rest = text.split(BEGIN)
    PAGE.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + rest.split(END)[1])
    print("\n".join(lines))


if __name__ == "__main__":
    main()
