"""Comparisons as a table with a scale per metric: an interval for every method, drawn without a script."""

from __future__ import annotations

import math
import operator
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trackrs.report.sections import Comparison, Interval, MethodScore

TICKS = 4  # on a scale, about


def comparison_html(comparison: Comparison) -> str:
    """Return the table of a comparison, the metrics one after the other."""
    metrics = list(dict.fromkeys(score.metric for score in comparison.scores))
    methods = list(dict.fromkeys(score.method for score in comparison.scores))
    against = f"difference to {comparison.reference}" if comparison.reference else "difference"
    head = ("method", "mean and 95 % interval", "", against, "p")
    columns = "".join(f'<th scope="col">{escape(name)}</th>' for name in head)
    bodies = []
    for metric in metrics:
        scores = [score for score in comparison.scores if score.metric == metric]
        scale = _Scale(scores)
        rows = "".join(_row(score, scale, methods.index(score.method)) for score in scores)
        bodies.append(
            f'<tbody><tr class="metric"><th scope="rowgroup" colspan="5">{escape(metric)}</th></tr>{rows}'
            f'<tr class="scale"><td></td><td>{scale.axis()}</td><td colspan="3"></td></tr></tbody>'
        )
    return f"{wide(comparison.title)}<table><thead><tr>{columns}</tr></thead>{''.join(bodies)}</table></div>"


def wide(name: str) -> str:
    """Return the beginning of a box that scrolls, with the keyboard too, where its table is wider than the page."""
    return f'<div class="wide" tabindex="0" role="region" aria-label="{escape(name or "Table")}">'


def number(value: object, digits: int | None = None) -> str:
    """Return a number with so many decimals, else with four digits; whole numbers in full; a dash where not finite."""
    try:
        text = str(operator.index(value))  # type: ignore[arg-type]
    except TypeError:
        figure = float(value)  # type: ignore[arg-type]
        if not math.isfinite(figure):
            return "–"
        if digits is None:
            # Times and coordinates keep all that comes before the point.
            text = f"{figure:.0f}" if 1e4 <= abs(figure) < 1e15 else f"{figure:.4g}"
        else:
            text = f"{figure:.{digits}f}"
    return text.replace("-", "\N{MINUS SIGN}")


def _row(score: MethodScore, scale: _Scale, place: int) -> str:
    difference = "–" if score.difference is None else _interval(score.difference, sign="+")
    p = "–" if score.p_value is None else _p(score.p_value)
    return (
        f'<tr><th scope="row">{escape(score.method)}</th><td>{scale.mark(score.score, place)}</td>'
        f'<td class="number">{_interval(score.score)}</td><td class="number">{difference}</td>'
        f'<td class="number">{p}</td></tr>'
    )


def _interval(value: Interval, sign: str = "") -> str:
    plus = sign if value.mean > 0 else ""
    if not (math.isfinite(value.low) and math.isfinite(value.high)):
        return plus + number(value.mean)
    # Two digits of the interval's width are what the numbers are known to.
    width = value.high - value.low
    digits = min(max(1 - math.floor(math.log10(width)), 0), 12) if width > 0 else None
    mean, low, high = (number(each, digits) for each in (value.mean, value.low, value.high))
    return f"{plus}{mean} <small>[{low}, {high}]</small>"


def _p(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    return "&lt; 0.001" if value < 1e-3 else f"{value:.3f}"


class _Scale:
    """Where values stand on the scale of one metric, in per cent of its width."""

    def __init__(self, scores: list[MethodScore]) -> None:
        values = [each for score in scores for each in (score.score.mean, score.score.low, score.score.high)]
        values = [value for value in values if math.isfinite(value)] or [0.0]
        low, high = min(values), max(values)
        width = (high - low) or abs(high) or 1.0
        self.low, self.width = low - 0.06 * width, 1.12 * width
        raw = self.width / TICKS
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= raw)
        first = math.ceil(self.low / step)
        last = math.floor((self.low + self.width) / step)
        self.ticks = [k * step for k in range(first, last + 1)]

    def at(self, value: float) -> str:
        return f"{100.0 * (value - self.low) / self.width:.2f}%"

    def mark(self, value: Interval, place: int) -> str:
        lines = "".join(f'<line class="grid" x1="{x}" x2="{x}" y1="0" y2="100%"/>' for x in map(self.at, self.ticks))
        if math.isfinite(value.low) and math.isfinite(value.high):
            lines += f'<line class="bar" x1="{self.at(value.low)}" x2="{self.at(value.high)}" y1="50%" y2="50%"/>'
        if math.isfinite(value.mean):
            lines += f'<circle cx="{self.at(value.mean)}" cy="50%" r="5"/>'
        return f'<svg class="interval c{place % 8}" aria-hidden="true">{lines}</svg>'

    def axis(self) -> str:
        texts = "".join(f'<text x="{self.at(tick)}" y="12">{number(tick)}</text>' for tick in self.ticks)
        return f'<svg class="axis" aria-hidden="true">{texts}</svg>'
