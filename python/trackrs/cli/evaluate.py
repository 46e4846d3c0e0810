"""`trackrs evaluate`: tracks against truth."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from trackrs.cli._output import note, plural, print_json
from trackrs.cli._page import check_report, evaluate_sections
from trackrs.config import load_config
from trackrs.errors import ParameterError
from trackrs.evaluation import evaluate as score_tracks
from trackrs.io import read_scan_table, read_tracks, read_truth

if TYPE_CHECKING:
    from trackrs.config import ScoreConfig
    from trackrs.evaluation import Evaluation

FILE = click.Path(path_type=Path)


@click.command()
@click.argument("truth", type=FILE)
@click.argument("tracks", type=FILE)
@click.option("--scans", type=FILE, help="Table of scans: tells of scans without tracks, and where the platform was.")
@click.option(
    "--config", "config_path", type=FILE, required=True, help="TOML file with the tables [truth] and [score]."
)
@click.option("--report", type=FILE, help="Write a page with scene, curves and scores, .html.")
@click.option("--json", "as_json", is_flag=True, help="Print the scores as JSON.")
def evaluate(
    truth: Path, tracks: Path, scans: Path | None, config_path: Path, report: Path | None, as_json: bool
) -> None:
    """Score TRACKS, as `trackrs track` writes them, against TRUTH, a table of true positions."""
    if report is not None:
        check_report(report, [truth, tracks, scans, config_path])
    config = load_config(config_path)
    if config.truth is None:
        raise ParameterError(f"{config_path}: no table [truth]; add one that names the columns of {truth}")
    if config.score is None:
        raise ParameterError(
            f'{config_path}: no table [score]; add one, for example with metric = "gospa" and c = 30.0'
        )
    score = config.score
    if score.region is not None and scans is None:
        raise ParameterError(
            f"{config_path}, [score] region is measured from the platform, whose positions stand in the table of "
            "scans: pass it with --scans, or remove region"
        )
    targets = read_truth(truth, config.truth)
    table = None if scans is None else read_scan_table(scans, config.columns, config.input)
    found = read_tracks(tracks, table)
    if table is None:
        note("without --scans, scans without tracks are unknown: scored at the times of the tracks only")
    result = score_tracks(
        targets,
        found,
        [score.make_metric()],
        sensor=score.sensor,
        start=score.start,
        region=score.region,
        centres=None if score.region is None or table is None else table.platforms,
    )
    if report is not None:
        from trackrs.report import write_report

        sections = evaluate_sections(result, found, targets, config, table)
        write_report(report, f"{tracks.name} against {truth.name}", sections, subtitle=_scored(result, score))
    if as_json:
        print_json(_record(result, score) | {"report": None if report is None else str(report)})
    else:
        _print(result, score, truth, tracks)
        if report is not None:
            click.echo(f"  written  {report}")


def _record(result: Evaluation, score: ScoreConfig) -> dict[str, object]:
    return {
        "metric": score.metric,
        "c": score.c,
        "p": score.p,
        "alpha": score.alpha if score.metric == "gospa" else None,
        "scored_scans": len(result.times),
        "mean": result.mean[score.make_metric()],
        "localisation": result.localisation,
        "missed": result.missed,
        "false_tracks": result.false_tracks,
        "all_held": result.all_held,
        "switches": result.switches,
        "false_ids": list(result.false_ids),
        "false_per_minute": result.false_per_minute,
        "rmse": result.rmse,
        "nees": result.nees,
        "targets": [asdict(target) for target in result.per_target],
    }


def _scored(result: Evaluation, score: ScoreConfig) -> str:
    scans = f"{plural(len(result.times), 'scan')}{f' of {score.sensor}' if score.sensor else ''}"
    where = f", within {score.region:g} m of the platform" if score.region else ""
    return f"{scans}, {result.times[0]:.6g} s to {result.times[-1]:.6g} s{where}"


def _print(result: Evaluation, score: ScoreConfig, truth: Path, tracks: Path) -> None:
    alpha = f", alpha = {score.alpha:g}" if score.metric == "gospa" else ""
    click.echo(f"{tracks} against {truth}: {_scored(result, score)}")
    mean = result.mean[score.make_metric()]
    click.echo(f"  {score.metric.upper():9}{mean:.2f} m on average (c = {score.c:g} m, p = {score.p:g}{alpha})")
    if score.metric == "gospa":
        parts = f"localisation {result.localisation:.4g}, missed {result.missed:.4g}, false {result.false_tracks:.4g}"
        click.echo(f"  parts    {parts} (m^{score.p:g})")
    click.echo(f"  held     all targets {100 * result.all_held:.1f} % of the time they were all there")
    click.echo(f"  switches {result.switches}")
    click.echo(f"  false    {plural(len(result.false_ids), 'track')}, {result.false_per_minute:.2f} a minute")
    click.echo(f"  errors   {result.rmse:.2f} m RMSE, position NEES {result.nees:.2f}")
    for target in result.per_target:
        share = (
            f"held {target.held} of {plural(target.present, 'scan')}, longest by one track {100 * target.longest:.0f} %"
        )
        click.echo(f"  target {target.id}: {share}, {plural(target.fragments, 'fragment')}")
