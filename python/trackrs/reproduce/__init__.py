"""The four papers, run again: their figures and tables redrawn, their numbers beside ours, a verdict on every claim.

Needs Matplotlib: `pip install "trackrs[plot]"`. `docs/papers.md` has what came out.
"""

from __future__ import annotations

import csv
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from trackrs.errors import ParameterError
from trackrs.plot import require_matplotlib
from trackrs.reproduce._records import Claim, Number, Picture, Reproduction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from trackrs.reproduce._records import Progress

PAPERS = ("underwater", "helmet", "extended", "npda")


def reproduce(
    papers: Sequence[str] = PAPERS,
    *,
    runs: int = 200,
    seed: int = 7,
    out: str | Path,
    workers: int | None = None,
    progress: Progress | None = None,
) -> tuple[Reproduction, ...]:
    """Run papers again and leave what comes out in a folder.

    Args:
        papers: which of `PAPERS`.
        runs: of every study.
        seed: of every study.
        out: folder; it is made where it is missing. There will be a folder of figures (PNG) and tables (text) for every
            paper, `claims.csv` and `numbers.csv`.
        workers: threads, None for all processors of this process.
        progress: called with what is done now, the number of the step and the number of steps of a paper.

    Returns:
        One record per paper, in the order given.

    Raises:
        ParameterError: there is no such paper, or `runs` is below 2.
        ImportError: Matplotlib is missing.
    """
    unknown = [name for name in papers if name not in PAPERS]
    if unknown:
        msg = f"papers = {unknown[0]!r} is invalid: there are {', '.join(PAPERS)}"
        raise ParameterError(msg)
    if runs < 2:
        msg = f"runs = {runs} is invalid: must be at least 2, because intervals need two"
        raise ParameterError(msg)
    require_matplotlib()
    folder = Path(out)
    found = []
    for name in papers:
        place = folder / name
        place.mkdir(parents=True, exist_ok=True)
        module = import_module(f"trackrs.reproduce._{name}")
        one: Reproduction = module.reproduce(runs, seed, place, workers, progress or _silent)
        parts = [f"{title}\n\n{table}\n" for title, table in one.tables.items()]
        (place / "tables.txt").write_text("\n".join(parts), encoding="utf-8")
        found.append(one)
    _write(folder / "claims.csv", [("paper", "claim", "verdict", "figure"), *_claim_rows(found)])
    head = ("paper", "number", "printed", "reference", "reference_half_width", "ours", "half_width", "agrees")
    _write(folder / "numbers.csv", [head, *_number_rows(found)])
    return tuple(found)


def _silent(what: str, step: int, steps: int) -> None:
    """Say nothing."""


def _claim_rows(found: Sequence[Reproduction]) -> list[tuple[object, ...]]:
    return [(one.name, claim.text, claim.verdict, claim.figure) for one in found for claim in one.claims]


def _number_rows(found: Sequence[Reproduction]) -> list[tuple[object, ...]]:
    return [
        (
            *(one.name, n.what, n.printed, n.reference),
            *(None if n.reference is None else n.reference_half_width, n.ours, n.half_width, n.agrees),
        )
        for one in found
        for n in one.numbers
    ]


def _write(path: Path, rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([["" if cell is None else cell for cell in row] for row in rows])


__all__ = ["PAPERS", "Claim", "Number", "Picture", "Reproduction", "reproduce"]
