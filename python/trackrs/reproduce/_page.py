"""The papers on one page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackrs.report import Picture, Prose, Table, write_report
from trackrs.study._sections import comparison

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from trackrs.report import Section
    from trackrs.reproduce._records import Number, Reproduction


def write_page(path: Path, found: Sequence[Reproduction], runs: int, seed: int) -> Path:
    """Write the page and return its path."""
    sections: list[Section] = [overview(found)]
    for one in found:
        sections += sections_of(one)
    subtitle = f"{runs} runs of every study, seed {seed}; every number with its 95 % interval"
    write_report(path, "The papers, run again", sections, subtitle=subtitle)
    return path


def overview(found: Sequence[Reproduction]) -> Table:
    """Return all claims."""
    rows = [(one.name, claim.text, claim.verdict, claim.figure) for one in found for claim in one.claims]
    return Table(
        ("paper", "claim", "verdict", "what decides"), rows, "What the papers claim, and what holds", "verdict"
    )


def sections_of(one: Reproduction) -> list[Section]:
    """Return what there is about one paper."""
    judged = [n for n in one.numbers if n.agrees is not None]
    agree = f"{sum(bool(n.agrees) for n in judged)} of {len(judged)} agree with the independent implementation"
    columns = ("number", "printed", "independent", "± independent", "ours", "± ours", "agreement")
    return [
        Prose(one.summary, one.paper),
        *one.sections,
        *(Picture(picture.path, picture.title, picture.title) for picture in one.pictures),
        *(comparison(result, one.columns, one.baseline, title) for title, result in one.studies.items()),
        Table(columns, [row(n) for n in one.numbers], f"Numbers: {agree}", "agreement"),
    ]


def row(n: Number) -> tuple[object, ...]:
    """Return the row of a number."""
    verdict = {None: "", True: "agrees", False: "differs"}[n.agrees]
    half = None if n.reference is None else n.reference_half_width
    return (n.what, n.printed, n.reference, half, n.ours, n.half_width, verdict)
