"""What is said of a paper: its claims, its numbers beside ours, its figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from trackrs.report import Section
    from trackrs.study import StudyResult, Summary

Verdict = Literal["holds", "holds in part", "does not hold"]
Progress: TypeAlias = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim of a paper, and what becomes of it.

    Attributes:
        text: what the paper says.
        verdict: whether it holds.
        figure: the number that decides.
    """

    text: str
    verdict: Verdict
    figure: str


@dataclass(frozen=True, slots=True)
class Number:
    """A number of a paper, of an independent implementation of it, and of ours.

    Attributes:
        what: it is of.
        ours: the mean over our runs.
        half_width: of its 95 % interval.
        reference: the same number as the spec of the paper has it, from an independent implementation; None if none.
        reference_half_width: of its 95 % interval.
        printed: as the paper prints it; None if it does not.
    """

    what: str
    ours: float
    half_width: float
    reference: float | None = None
    reference_half_width: float = 0.0
    printed: float | None = None

    @property
    def agrees(self) -> bool | None:
        """Whether the intervals of ours and the reference meet; None without a reference."""
        if self.reference is None:
            return None
        return abs(self.ours - self.reference) <= self.half_width + self.reference_half_width


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure that is redrawn.

    Attributes:
        title: what it shows, and which figure of the paper it is.
        path: of the PNG.
    """

    title: str
    path: Path


@dataclass(frozen=True, slots=True)
class Reproduction:
    """One paper, run again.

    Attributes:
        name: for example "npda".
        paper: authors, title, year.
        summary: what comes out, in a paragraph.
        claims, numbers, pictures: see there.
        tables: texts, by title.
        studies: all results, by title.
        columns: of the studies, the ones that matter.
        baseline: method that the others are compared with.
        sections: of the page: runs to play, tables of the paper.
    """

    name: str
    paper: str
    summary: str
    claims: tuple[Claim, ...]
    numbers: tuple[Number, ...]
    pictures: tuple[Picture, ...]
    tables: dict[str, str]
    studies: dict[str, StudyResult]
    columns: tuple[str, ...]
    baseline: str
    sections: tuple[Section, ...] = ()


def number(
    what: str, found: Summary, reference: float | None = None, runs: int = 200, printed: float | None = None
) -> Number:
    """Return a number beside a reference that is the mean over so many runs, rounded as it is written.

    The reference's interval is ours, scaled by the numbers of runs, and half a unit of its last digit.
    """
    if reference is None:
        return Number(what, found.mean, found.half_width, printed=printed)
    half = found.half_width * float(np.sqrt(max(found.runs, 1) / runs)) + 0.5 * unit(reference)
    return Number(what, found.mean, found.half_width, reference, half, printed)


def unit(value: float) -> float:
    """Return one unit of the last digit that a number is written with."""
    digits = repr(value).partition(".")[2]
    return 1.0 if digits in {"", "0"} else float(10.0 ** -len(digits))
