"""Radar and lidar scans of a harbour, recorded from a small ferry, become tracks; the tracks are scored against truth.

    python examples/harbour.py [--out FOLDER] [--config examples/harbour_jipda.toml]

Tracks the five recordings of `examples/data/autoferry` with the one parameter set of `examples/harbour.toml` (global
nearest neighbour; `harbour_jipda.toml` has the same with existence probabilities), prints a
table, and leaves per recording its tracks (CSV) and a picture (PNG) in `out/harbour`. The same in Rust:
`cargo run --release --example harbour`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import trackrs as tr
from trackrs.config import Config, load_config
from trackrs.io import read_scans, read_truth, write_tracks
from trackrs.plot import detection_positions, plot_tracks

HERE = Path(__file__).resolve().parent
SCENARIOS = ("scenario02", "scenario03", "scenario05", "scenario13", "scenario16")


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    scenario: str
    scans: int
    detections: int
    tracks: int
    gospa: float
    localisation: float
    missed: float
    false: float
    held: float
    false_per_minute: float
    switches: int
    nees: float
    milliseconds: float


@dataclass(frozen=True, slots=True)
class Column:
    """How one value of a row is printed, as wide as its heading."""

    name: str
    head: str
    form: str


COLUMNS = (
    Column("scenario", "scenario  ", "10"),
    Column("scans", "scans", "5"),
    Column("detections", "detections", "10"),
    Column("tracks", "tracks", "6"),
    Column("gospa", "GOSPA m", "7.2f"),
    Column("localisation", "local. m2", "9.1f"),
    Column("missed", "missed m2", "9.1f"),
    Column("false", "false m2", "8.1f"),
    Column("held", " held", "5.0%"),
    Column("false_per_minute", "false/min", "9.2f"),
    Column("switches", "switches", "8"),
    Column("nees", "NEES", "4.2f"),
    Column("milliseconds", "  ms", "4.0f"),
)


def track(scenario: str, config: Config, out: Path) -> Row:
    """Track one recording, score and draw it."""
    folder = HERE / "data" / "autoferry" / scenario
    recording = read_scans(folder / "detections.csv", folder / "scans.csv", config.columns, config.input)
    truth = read_truth(folder / "truth.csv", config.truth)

    tracker = config.make_tracker()
    begun = time.perf_counter()
    tracks = tracker.run(recording.scans)
    milliseconds = 1e3 * (time.perf_counter() - begun)

    gospa = config.score.make_metric()
    score = tr.evaluate(
        truth,
        tracks,
        [gospa],
        sensor=config.score.sensor,
        start=config.score.start,
        region=config.score.region,
        centres=recording.platforms,
    )
    write_tracks(tracks, out / f"{scenario}.csv")
    axes = plot_tracks(
        tracks,
        detections=detection_positions(recording.scans, config.sensors),
        truth=truth,
        own_ship=recording.platforms,
        region=config.score.region,
        labels=config.plot.labels,
        swap_axes=config.plot.swap_axes,
        title=f"Autoferry {scenario}: two vessels seen from a ferry",
    )
    axes.figure.savefig(out / f"{scenario}.png")
    return Row(
        scenario=scenario,
        scans=len(recording.scans),
        detections=recording.rows,
        tracks=len(np.unique(tracks.ids)),
        gospa=score.mean[gospa],
        localisation=score.localisation,
        missed=score.missed,
        false=score.false_tracks,
        held=score.all_held,
        false_per_minute=score.false_per_minute,
        switches=score.switches,
        nees=score.nees,
        milliseconds=milliseconds,
    )


def mean_or_total(rows: list[Row]) -> Row:
    """The last line: counts and times are summed, scores averaged over the recordings."""
    summed = {"scans", "detections", "tracks", "switches", "milliseconds"}
    columns = {name: [getattr(row, name) for row in rows] for name in Row.__slots__ if name != "scenario"}
    values = {name: sum(column) if name in summed else float(np.mean(column)) for name, column in columns.items()}
    return Row("mean/total", **values)


def main() -> None:
    """Track all recordings and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/harbour"), help="folder of the results (%(default)s)")
    parser.add_argument("--config", type=Path, default=HERE / "harbour.toml", help="(%(default)s)")
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    config = load_config(arguments.config)
    rows = [track(scenario, config, out) for scenario in SCENARIOS]

    print("  ".join(column.head for column in COLUMNS))
    for row in [*rows, mean_or_total(rows)]:
        print("  ".join(format(getattr(row, column.name), column.form) for column in COLUMNS))
    print("GOSPA: p = 2, c = 30 m, alpha = 2; the next three are the parts of its square. held: both targets at once.")
    print(f"Tracks and pictures: {out}")


if __name__ == "__main__":
    main()
