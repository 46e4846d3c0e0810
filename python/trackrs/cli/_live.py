"""`trackrs track --follow`: detections that go on coming."""

from __future__ import annotations

import os
import signal
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from trackrs.cli._output import counted, note, plural, print_json
from trackrs.cli._page import check_output
from trackrs.errors import ParameterError
from trackrs.live import follow

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from trackrs.config import Config
    from trackrs.live import LiveRun

SIGNALS = (signal.SIGINT, signal.SIGTERM)
TABLES = (".csv", ".parquet")


def follow_detections(
    detections: Path,
    config: Config,
    out: Path | None,
    dead_letters: Path | None,
    checkpoint: Path | None,
    every: float,
    idle: float | None,
    as_json: bool,
) -> int:
    """Run until the input ends, exit code 0, or a signal comes, 128 and its number."""
    if out is not None and out.suffix.lower() in TABLES:
        raise ParameterError(f"{out}: live tracks are lines of JSON, not {out.suffix}; name it .ndjson")
    for path in (out, dead_letters, checkpoint):
        if path is not None:
            check_output(path, [detections, config.path])
    if checkpoint is not None and out is None:
        note("standard output cannot be taken back: after a crash its last lines come twice; --out makes it exact")
    begun = time.perf_counter()
    with _signals() as received:
        run = follow(
            detections,
            config.make_tracker(),
            config.columns,
            layout=config.input,
            out="-" if out is None else out,
            dead_letters=dead_letters,
            checkpoint=checkpoint,
            every=every,
            idle=idle,
            stop=lambda: bool(received),
        )
    record = _record(run, detections, out, dead_letters, checkpoint, time.perf_counter() - begun)
    if as_json:
        print_json(record, err=out is None)
    else:
        _tell(run, record, err=out is None)
    return 128 + received[0] if received else 0


@contextmanager
def _signals() -> Iterator[list[int]]:
    """Take down the first signal; the second ends the process on the spot, which a checkpoint survives as any crash."""
    received: list[int] = []

    def take(number: int, _: object) -> None:
        if received:
            os._exit(128 + number)
        received.append(number)

    before = {number: signal.signal(number, take) for number in SIGNALS}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _record(
    run: LiveRun,
    detections: Path,
    out: Path | None,
    dead_letters: Path | None,
    checkpoint: Path | None,
    seconds: float,
) -> dict[str, Any]:
    ledger = run.ledger
    paths = {"out": out, "dead_letters": dead_letters, "checkpoint": checkpoint}
    return {
        "detections": str(detections),
        "ended": run.ended,
        "offset": run.offset,
        "rows": run.rows_in + sum(run.ignored.values()),
        "ignored": dict(run.ignored),
        "looks": run.looks,
        "scans": run.scans,
        "ledger": {
            "rows_in": run.rows_in,
            "used": ledger.used,
            "rejected": dict(ledger.rejected),
            "late": ledger.late,
            "duplicate": ledger.duplicate,
            "bad_lines": dict(run.bad_lines),
            "waiting": run.waiting + ledger.waiting,
        },
        "events": run.tracker.event_counts,
        "track_rows": run.track_rows,
        "seconds": seconds,
        **{name: None if path is None else str(path) for name, path in paths.items()},
    }


def _tell(run: LiveRun, record: dict[str, Any], *, err: bool) -> None:
    ledger = run.ledger
    bad, where = sum(run.bad_lines.values()), "ended" if run.ended else "stopped"
    lines = [
        f"{record['detections']}: {plural(run.scans, 'scan')}, {where} at byte {run.offset}",
        f"  rows     {run.rows_in} in: {ledger.used} used, {sum(ledger.rejected.values())} rejected"
        + (f" ({counted(ledger.rejected)})" if ledger.rejected else "")
        + f", {ledger.late} late, {ledger.duplicate} duplicate, {plural(bad, 'bad line')}"
        + (f" ({counted(run.bad_lines)})" if bad else "")
        + (f", {waiting} waiting" if (waiting := record["ledger"]["waiting"]) else ""),
        *([f"  left out {counted(run.ignored)}, as [input] ignore_sensors says"] if run.ignored else []),
        f"  events   {counted(record['events']) or 'none'}",
        f"  tracks   {plural(run.track_rows, 'row')}, {record['seconds']:.1f} s",
    ]
    written = ", ".join(record[name] for name in ("out", "dead_letters", "checkpoint") if record[name] is not None)
    for line in [*lines, *([f"  written  {written}"] if written else [])]:
        click.echo(line, err=err)
