"""`trackrs track`: detections to tracks."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click
import numpy as np

from trackrs.cli._output import counted, note, plural, print_json
from trackrs.cli._page import check_output, check_report, track_sections
from trackrs.config import load_config
from trackrs.errors import ParameterError
from trackrs.io import read_scans, read_truth, replacing
from trackrs.io._files import table_suffix, write_table
from trackrs.types import Tracks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from trackrs.config import Config
    from trackrs.evaluation import Truth
    from trackrs.io import Recording
    from trackrs.tracker import Recorder
    from trackrs.types import Scan

CHUNK = 64  # scans between two looks at the clock
PATIENCE = 1.0  # seconds before a progress bar appears
PICTURES = (".pdf", ".png", ".svg")
FILE = click.Path(path_type=Path)


@click.command()
@click.argument("detections", type=FILE)
@click.option("--scans", type=FILE, help="Table of scans: empty ones, and where the platform was.")
@click.option("--config", "config_path", type=FILE, required=True, help="TOML file: models, tracker, names of columns.")
@click.option(
    "--out", type=FILE, help="Where the tracks go, .csv or .parquet; with --follow .ndjson or standard output."
)
@click.option("--plot", type=FILE, help="Draw the tracks, .png, .svg or .pdf.")
@click.option("--report", type=FILE, help="Write a page that plays the tracks, .html.")
@click.option("--truth", "truth_path", type=FILE, help="Table of true positions, for picture and report.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
@click.option("--follow", is_flag=True, help="DETECTIONS are lines of JSON that go on coming; - is standard input.")
@click.option("--dead-letters", type=FILE, help="With --follow: where lines go that cannot be used.")
@click.option("--checkpoint", type=FILE, help="With --follow: where the run stands; the same command goes on from it.")
@click.option("--checkpoint-every", type=float, default=10.0, show_default=True, help="Seconds between two of them.")
@click.option("--idle", type=float, help="With --follow: complete a scan after so many seconds without input.")
def track(
    detections: Path,
    scans: Path | None,
    config_path: Path,
    out: Path | None,
    plot: Path | None,
    report: Path | None,
    truth_path: Path | None,
    as_json: bool,
    follow: bool,
    dead_letters: Path | None,
    checkpoint: Path | None,
    checkpoint_every: float,
    idle: float | None,
) -> int:
    """Turn DETECTIONS, a table as CSV or Parquet, into confirmed tracks with covariances.

    With --follow they are lines of JSON (or an Arrow IPC stream) from a file that grows or, as -, from standard input.
    """
    live = {"--dead-letters": dead_letters, "--checkpoint": checkpoint, "--idle": idle}
    table = {"--scans": scans, "--plot": plot, "--report": report, "--truth": truth_path}
    for name, value in (table if follow else live).items():
        if value is not None:
            text = f"{name} goes {'without' if follow else 'with'} --follow"
            raise click.UsageError(text, click.get_current_context())
    config = load_config(config_path)
    if follow:
        from trackrs.cli._live import follow_detections

        return follow_detections(detections, config, out, dead_letters, checkpoint, checkpoint_every, idle, as_json)
    if out is None:
        raise click.MissingParameter(None, click.get_current_context(), param_hint="'--out'", param_type="option")
    if str(detections) == "-":
        raise click.UsageError("standard input is read with --follow", click.get_current_context())
    suffix = table_suffix(out)
    _check_outputs(out, plot, report, [detections, scans, config_path, truth_path])
    if truth_path is not None and plot is None and report is None:
        text = "--truth is for the picture and the report: add --plot or --report"
        raise click.UsageError(text, click.get_current_context())
    truth: Sequence[Truth] = []
    if truth_path is not None:
        if config.truth is None:
            raise ParameterError(f"{config_path}: no table [truth]; add one that names the columns of {truth_path}")
        truth = read_truth(truth_path, config.truth)
    recording = read_scans(detections, scans, config.columns, config.input)
    if scans is None:
        note("without --scans, empty scans are unknown and cannot count as misses")
    tracker = config.make_tracker()
    begun = time.perf_counter()
    tracks = run_in_chunks(tracker, recording.scans)
    seconds = time.perf_counter() - begun
    with ExitStack() as files:
        # All files take their places at the end, or none does.
        write_table(tracks.to_table(), files.enter_context(replacing(out)), suffix)
        if plot is not None:
            picture = files.enter_context(replacing(plot))
            _draw(tracks, recording, config, truth, picture, plot, detections.stem)
        if report is not None:
            from trackrs.report import write_report

            with files.enter_context(replacing(report)).open("w", encoding="utf-8") as page:
                about = (
                    f"{detections} with {config_path.name}: {plural(len(recording.scans), 'scan')}, "
                    f"{plural(recording.rows, 'detection')}, {plural(len(np.unique(tracks.ids)), 'track')}"
                )
                sections = track_sections(tracks, tracker, recording, config, truth)
                write_report(page, detections.stem, sections, subtitle=about)
    _summary(tracks, tracker, recording, seconds, detections, out, plot, report, as_json)
    return 0


def run_in_chunks(tracker: Recorder, scans: Sequence[Scan]) -> Tracks:
    """Run the tracker over the scans; a progress bar appears when that takes more than a second on a terminal."""
    parts, begun = [], time.monotonic()
    with ExitStack() as stack:
        bar = None
        for first in range(0, len(scans), CHUNK):
            parts.append(tracker.run(scans[first : first + CHUNK]))
            if bar is None and sys.stderr.isatty() and time.monotonic() - begun > PATIENCE:
                from rich.console import Console
                from rich.progress import Progress

                bar = stack.enter_context(Progress(console=Console(stderr=True), transient=True))
                bar.add_task("tracking", total=len(scans))
            if bar is not None:
                bar.update(bar.task_ids[0], completed=first + CHUNK)
    return _joined(parts) if parts else tracker.run([])


def _joined(parts: Sequence[Tracks]) -> Tracks:
    """One result from those of consecutive chunks."""
    rows = np.cumsum([0, *(len(part) for part in parts)])
    offsets = [part.offsets[:-1] + before for part, before in zip(parts, rows[:-1], strict=True)]
    arrays = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("scan_times", "times", "ids", "means", "covs", "last_hits", "hits")
    }
    arrays["offsets"] = np.append(np.concatenate(offsets), rows[-1])
    for name in ("existences", "expected_targets", "extents", "healths"):
        kept = [getattr(part, name) for part in parts]
        if all(value is not None for value in kept):
            arrays[name] = np.concatenate(kept)
    for value in arrays.values():
        value.setflags(write=False)
    return Tracks(sensors=tuple(name for part in parts for name in part.sensors), labels=parts[0].labels, **arrays)


def _check_outputs(out: Path, plot: Path | None, report: Path | None, inputs: Sequence[Path | None]) -> None:
    """Find out before the work what would fail after it."""
    check_output(out, inputs)
    if plot is not None:
        if plot.suffix.lower() not in PICTURES:
            raise ParameterError(f"{plot}: pictures end in {', '.join(PICTURES)}, not in {plot.suffix!r}; rename it")
        from trackrs.plot import require_matplotlib

        require_matplotlib()
        check_output(plot, inputs)
    if report is not None:
        check_report(report, inputs)


def _draw(
    tracks: Tracks,
    recording: Recording,
    config: Config,
    truth: Sequence[Truth],
    file: Path,
    plot: Path,
    title: str,
) -> None:
    from trackrs.plot import detection_positions, plot_tracks

    axes = plot_tracks(
        tracks,
        detections=detection_positions(recording.scans, config.sensors),
        truth=truth,
        own_ship=recording.platforms,
        region=config.score.region if config.score else None,
        labels=config.plot.labels,
        swap_axes=config.plot.swap_axes,
        title=title,
    )
    cast("Figure", axes.figure).savefig(file, format=plot.suffix[1:].lower())


def _summary(
    tracks: Tracks,
    tracker: Recorder,
    recording: Recording,
    seconds: float,
    detections: Path,
    out: Path,
    plot: Path | None,
    report: Path | None,
    as_json: bool,
) -> None:
    ledger, events = tracker.ledger, tracker.event_counts
    ids = np.unique(tracks.ids).tolist()
    if as_json:
        print_json(
            {
                "detections": str(detections),
                "rows": recording.rows + sum(recording.ignored.values()),
                "ignored": dict(recording.ignored),
                "scans": len(recording.scans),
                "sensors": sorted({scan.sensor for scan in recording.scans}),
                "ledger": {
                    "rows_in": ledger.rows_in,
                    "used": ledger.used,
                    "rejected": dict(ledger.rejected),
                    "late": ledger.late,
                    "duplicate": ledger.duplicate,
                },
                "events": events,
                "tracks": ids,
                "track_rows": len(tracks),
                "seconds": seconds,
                "out": str(out),
                "plot": None if plot is None else str(plot),
                "report": None if report is None else str(report),
            },
        )
        return
    sensors = ", ".join(sorted({scan.sensor for scan in recording.scans}))
    first, last = recording.scans[0].time, recording.scans[-1].time
    click.echo(f"{detections}: {plural(len(recording.scans), 'scan')} of {sensors}, {first:.6g} s to {last:.6g} s")
    rejected = f" ({counted(ledger.rejected)})" if ledger.rejected else ""
    parts = f"{ledger.used} used, {sum(ledger.rejected.values())} rejected{rejected}, {ledger.late} late"
    click.echo(f"  rows     {ledger.rows_in} in: {parts}, {ledger.duplicate} duplicate")
    if recording.ignored:
        click.echo(f"  left out {counted(recording.ignored)}, as [input] ignore_sensors says")
    click.echo(f"  events   {counted(events) or 'none'}")
    click.echo(f"  tracks   {len(ids)} confirmed, {plural(len(tracks), 'row')}, in {1e3 * seconds:.0f} ms")
    click.echo(f"  written  {', '.join(str(path) for path in (out, plot, report) if path is not None)}")
