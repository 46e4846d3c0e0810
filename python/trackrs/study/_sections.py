"""What a report shows of a study."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackrs.report import Comparison, Curves, Interval, Line, MethodScore

if TYPE_CHECKING:
    from collections.abc import Sequence

    from trackrs.study._result import StudyResult


def comparison(result: StudyResult, columns: Sequence[str], baseline: str, title: str) -> Comparison:
    """Return methods and columns side by side, with the differences to one method."""
    scores = []
    for column in columns:
        for one in result.methods:
            found = one.summary(column)
            score = Interval(found.mean, found.low, found.high)
            if one.name == baseline:
                scores.append(MethodScore(column, one.name, score))
                continue
            gap = result.compare(one.name, baseline, column)
            scores.append(MethodScore(column, one.name, score, Interval(gap.mean, gap.low, gap.high), gap.p_value))
    return Comparison(scores, title, baseline)


def curves(result: StudyResult, column: str, title: str) -> Curves:
    """Return a column over time, of all methods."""
    lines = []
    for one in result.methods:
        band = one.over_time(column)
        low, high = band.mean - band.half_width, band.mean + band.half_width
        lines.append(Line(one.name, band.times, band.mean, low, high))
    return Curves(lines, title, y=column, timed=False)
