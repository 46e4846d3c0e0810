"""`trackrs study`: a Monte-Carlo study from a file."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trackrs.cli._output import note, print_json
from trackrs.io import replacing
from trackrs.io._files import check_target, table_suffix, write_table
from trackrs.study._toml import load_study

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from trackrs.report import Section
    from trackrs.study import StudyResult

FILE = click.Path(path_type=Path)
NUMBER = click.IntRange(0, 2**64 - 1)


@click.command()
@click.argument("config", type=FILE)
@click.option("--runs", type=NUMBER, help="How many runs; by default what [study] in the file says, or 200.")
@click.option("--seed", type=NUMBER, help="Seed of the random numbers; by default what the file says, or 0.")
@click.option("--folder", type=FILE, help="Keep finished runs there, and go on from those that are there.")
@click.option("--out", type=FILE, help="Write what every run gave, .csv or .parquet.")
@click.option("--report", type=FILE, help="Write a page with every comparison and every column over time, .html.")
@click.option("--workers", type=click.IntRange(1), help="Threads; by default all processors.")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
def study(
    config: Path,
    runs: int | None,
    seed: int | None,
    folder: Path | None,
    out: Path | None,
    report: Path | None,
    workers: int | None,
    as_json: bool,
) -> None:
    """Run the Monte-Carlo study that CONFIG, a TOML file, describes, and print what it found."""
    given = load_study(config)
    suffix = None
    if out is not None:
        suffix = table_suffix(out)
        check_target(out)
    if report is not None:
        check_target(report)
    runs, seed = given.runs if runs is None else runs, given.seed if seed is None else seed
    begun = time.perf_counter()
    try:
        with progress_bar("runs") as progress:
            result = given.study.run(runs, seed, folder=folder, workers=workers, progress=progress)
    except KeyboardInterrupt:
        if folder is not None:
            note(f"stopped; finished runs are in {folder}, and the same command goes on from there")
        raise
    seconds = time.perf_counter() - begun
    if out is not None and suffix is not None:
        with replacing(out) as file:
            write_table(result.to_table(), file, suffix)
    if report is not None:
        write_page(report, result, config.stem)
    if as_json:
        paths = {"out": None if out is None else str(out), "report": None if report is None else str(report)}
        print_json(summary(result) | {"took": seconds} | paths)
    else:
        click.echo(result.table())


def write_page(path: Path, result: StudyResult, title: str) -> None:
    """Write what there is about a study."""
    from trackrs.report import write_report
    from trackrs.study._sections import comparison, curves

    base, columns = result.methods[0], [column.name for column in result.methods[0].columns]
    sections: list[Section] = [
        comparison(result, columns, base.name, "Methods"),
        *(curves(result, name, name) for name in columns),
    ]
    write_report(path, title, sections, subtitle=f"{len(result.runs)} runs, seed {result.seed}")


@contextmanager
def progress_bar(noun: str) -> Iterator[Callable[[int, int], None] | None]:
    """Give what shows on a terminal how far a study is and how long it still takes."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(noun, total=None)
        yield lambda done, runs: bar.update(task, completed=done, total=runs)


def summary(result: StudyResult) -> dict[str, Any]:
    """Return what `table` shows as one record."""
    methods = {}
    for one in result.methods:
        columns = {}
        for column in one.columns:
            found = one.summary(column.name)
            columns[column.name] = {"mean": found.mean, "low": found.low, "high": found.high, "runs": found.runs}
        methods[one.name] = columns
    base, *others = result.methods
    differences = {}
    for one in others:
        columns = {}
        for column in one.columns:
            gap = result.compare(one.name, base.name, column.name)
            columns[column.name] = {"mean": gap.mean, "low": gap.low, "high": gap.high, "p_value": gap.p_value}
        differences[one.name] = columns
    failures = [{"run": one.run, "method": one.method, "reason": one.reason} for one in result.failures]
    return {
        "runs": len(result.runs),
        "seed": result.seed,
        "methods": methods,
        "baseline": base.name,
        "differences": differences,
        "failures": failures,
    }
