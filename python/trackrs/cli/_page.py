"""What the commands put on a report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackrs.errors import ParameterError
from trackrs.gating import Gate
from trackrs.io._files import check_target
from trackrs.report import Curves, Line, Scene, Section, Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from trackrs.config import Config
    from trackrs.evaluation import Evaluation, Truth
    from trackrs.io import Recording, ScanTable
    from trackrs.tracker import Recorder
    from trackrs.types import Tracks

PAGES = (".html", ".htm")


def check_output(path: Path, inputs: Sequence[Path | None]) -> None:
    """Refuse an output that cannot be written or would destroy an input, before the work.

    Raises:
        ParameterError: it is one of the inputs.
        TableError: it is a folder, or its folder does not exist.
    """
    check_target(path)
    if path.exists() and any(other is not None and other.exists() and other.samefile(path) for other in inputs):
        raise ParameterError(f"{path}: is one of the inputs; name another file")


def check_report(path: Path, inputs: Sequence[Path | None]) -> None:
    """The same for a report, whose name tells what it is."""
    if path.suffix.lower() not in PAGES:
        raise ParameterError(f"{path}: reports end in {' or '.join(PAGES)}, not in {path.suffix!r}; rename it")
    check_output(path, inputs)


def track_sections(
    tracks: Tracks, tracker: Recorder, recording: Recording, config: Config, truth: Sequence[Truth]
) -> list[Section]:
    """What `trackrs track` shows: the scene with detections and gates, and where every row went."""
    gate = config.tracker.get("gate", Gate())
    drawn = isinstance(gate, Gate) and 0.0 < gate.probability < 1.0
    scene = Scene(
        tracks,
        scans=recording.scans,
        sensors=config.sensors,
        motion=config.motion if drawn else None,
        gate=gate.probability if drawn else Gate().probability,
        truth=truth,
        own_ship=recording.platforms,
        region=config.score.region if config.score else None,
        labels=config.plot.labels,
        swap_axes=config.plot.swap_axes,
    )
    ledger = tracker.ledger
    rows: list[list[object]] = [
        ["received", ledger.rows_in],
        ["used", ledger.used],
        *([f"rejected: {code}", count] for code, count in ledger.rejected.items()),
        ["late", ledger.late],
        ["duplicate", ledger.duplicate],
        *([f"left out: {sensor}", count] for sensor, count in recording.ignored.items()),
    ]
    return [scene, Table(["detections", "rows"], rows, title="Where the detections went")]


def evaluate_sections(
    result: Evaluation, tracks: Tracks, truth: Sequence[Truth], config: Config, table: ScanTable | None
) -> list[Section]:
    """What `trackrs evaluate` shows: the scene, the metric over time, all scores, and every target."""
    score = config.score
    assert score is not None  # noqa: S101 (the command has refused that)
    metric, name = score.make_metric(), score.metric.upper()
    scene = Scene(
        tracks,
        truth=truth,
        own_ship=None if table is None else table.platforms,
        region=score.region,
        labels=config.plot.labels,
        swap_axes=config.plot.swap_axes,
    )
    alpha = f", alpha = {score.alpha:g}" if score.metric == "gospa" else ""
    settings = f"c = {score.c:g} m, p = {score.p:g}{alpha}"
    counts = [Line("targets", result.times, result.targets), Line("tracks", result.times, result.tracks)]
    parts: list[list[object]] = [
        [f"localisation (m^{score.p:g})", result.localisation],
        [f"missed (m^{score.p:g})", result.missed],
        [f"false (m^{score.p:g})", result.false_tracks],
    ]
    scores: list[list[object]] = [
        [f"mean {name} (m), {settings}", result.mean[metric]],
        *(parts if score.metric == "gospa" else []),
        ["all targets held (%)", 100.0 * result.all_held],
        ["switches", result.switches],
        ["false tracks", len(result.false_ids)],
        ["false tracks a minute", result.false_per_minute],
        ["RMSE of positions (m)", result.rmse],
        ["mean position NEES", result.nees],
        ["scored scans", len(result.times)],
    ]
    targets = [[t.id, t.present, t.held, t.fragments, t.switches, 100.0 * t.longest] for t in result.per_target]
    heads = ["target", "scans present", "held", "fragments", "switches", "longest by one track (%)"]
    return [
        scene,
        Curves([Line(name, result.times, result.series[metric])], title=f"{name} over time", y=f"{name} (m)"),
        Curves(counts, title="Targets and tracks", y="number"),
        Table(["score", "value"], scores, title="Scores"),
        Table(heads, targets, title="Targets"),
    ]
