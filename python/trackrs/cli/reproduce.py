"""`trackrs reproduce`: the papers, run again."""

from __future__ import annotations

import sys
import textwrap
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from trackrs.cli._output import plural, print_json
from trackrs.reproduce import PAPERS
from trackrs.reproduce import reproduce as run_again

if TYPE_CHECKING:
    from trackrs.reproduce import Reproduction


@click.command()
@click.argument("paper", type=click.Choice([*PAPERS, "all"]), default="all")
@click.option("--runs", type=click.IntRange(min=2), default=200, show_default=True, help="Of every study.")
@click.option("--seed", type=click.IntRange(0, 2**64 - 1), default=7, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("reproduction"), show_default=True, help="Folder.")
@click.option("--workers", type=click.IntRange(min=1), help="Threads; all processors if not given.")
@click.option("--json", "as_json", is_flag=True, help="Print claims and numbers as JSON.")
def reproduce(paper: str, runs: int, seed: int, out: Path, workers: int | None, as_json: bool) -> None:
    """Run PAPER again, as printed, by default and with its rivals, and say which of its claims hold.

    Figures, tables and a page to look at (report.html) go to --out.
    """
    from trackrs.reproduce._page import write_page

    names = PAPERS if paper == "all" else (paper,)
    with ExitStack() as stack:
        found = run_again(names, runs=runs, seed=seed, out=out, workers=workers, progress=_bar(stack, len(names)))
    page = write_page(out / "report.html", found, runs, seed)
    if as_json:
        papers = [_record(one) for one in found]
        print_json({"runs": runs, "seed": seed, "report": str(page), "papers": papers})
        return
    for one in found:
        _print(one)
    click.echo(f"{plural(runs, 'run')} of every study, seed {seed}; figures, tables and the page: {page}")


def _record(one: Reproduction) -> dict[str, object]:
    claims, numbers = [asdict(claim) for claim in one.claims], [asdict(n) | {"agrees": n.agrees} for n in one.numbers]
    return {"name": one.name, "paper": one.paper, "claims": claims, "numbers": numbers}


def _print(one: Reproduction) -> None:
    click.echo(one.paper)
    for claim in one.claims:
        click.echo(f"  {claim.verdict.upper():14} {claim.text}")
        click.echo(textwrap.fill(claim.figure, 110, initial_indent=" " * 17, subsequent_indent=" " * 17))
    judged = [n for n in one.numbers if n.agrees is not None]
    agree = sum(bool(n.agrees) for n in judged)
    click.echo(f"  {agree} of {plural(len(judged), 'number')} agree with an independent implementation")
    click.echo("")


class _Steps:
    """A progress bar over the steps of all papers."""

    def __init__(self, stack: ExitStack, papers: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description:24}"), BarColumn(), TimeRemainingColumn())
        self._progress = stack.enter_context(Progress(*columns, console=Console(stderr=True), transient=True))
        self._task = self._progress.add_task("", total=papers)
        self._done = -1

    def __call__(self, what: str, step: int, steps: int) -> None:
        self._done += step == 0
        self._progress.update(self._task, description=what, completed=self._done + step / steps)


def _bar(stack: ExitStack, papers: int) -> _Steps | None:
    return _Steps(stack, papers) if sys.stderr.isatty() else None
