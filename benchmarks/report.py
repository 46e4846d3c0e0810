"""How long the page of a report takes to write, to open and to draw, and the picture of it in the documentation.

    python benchmarks/report.py [--picture docs/report.png]

50 tracks over 1,000 scans with 100 detections each, as large as a report is meant to be; then, for the picture, a
recording of the harbour. Needs a Chromium. Frames are drawn by the processor (no graphics card), pixels included.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

import trackrs as tr
from trackrs.config import load_config
from trackrs.io import read_scans, read_truth

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from chromium import Chromium, find_chromium  # noqa: E402 (the tests' own)

SCANS, TRACKS, DETECTIONS = 1000, 50, 100
# Draws every tenth scan and reads a pixel back, so that nothing is left undone.
FRAMES = """(() => {{
    const scene = report.scenes[0];
    Object.assign(scene, {{ tail: '{tail}', history: '{history}', stale: true }});
    const times = [];
    for (let scan = 500; scan < 1000; scan += 10) {{
        scene.clock.scan = scan;
        scene.stale ||= {pan};
        const begun = performance.now();
        scene.draw();
        scene.context.getImageData(0, 0, 1, 1);
        times.push(performance.now() - begun);
    }}
    return times.slice(5);
}})()"""


def large() -> tr.report.Scene:
    """Targets that wander over a plane far from its origin, and clutter."""
    rng = np.random.default_rng(3)
    times = np.arange(float(SCANS))
    heading = rng.uniform(0.0, 2.0 * np.pi, TRACKS) + np.cumsum(rng.normal(0.0, 0.03, (SCANS, TRACKS)), axis=0)
    velocity = 8.0 * np.stack([np.cos(heading), np.sin(heading)], axis=2)
    origin = np.array([5e5, 6e6])
    positions = origin + rng.uniform(-3e3, 3e3, (TRACKS, 2)) + np.cumsum(velocity, axis=0)
    means = np.concatenate([positions, velocity], axis=2).reshape(-1, 4)
    spread = np.diag([80.0, 40.0, 1.0, 1.0])
    spread[0, 1] = spread[1, 0] = 20.0
    tracks = tr.Tracks(
        scan_times=times,
        sensors=("radar",) * SCANS,
        times=np.repeat(times, TRACKS),
        ids=np.tile(np.arange(1, TRACKS + 1, dtype=np.uint64), SCANS),
        means=means,
        covs=np.tile(spread, (SCANS * TRACKS, 1, 1)),
        last_hits=np.repeat(times, TRACKS),
        hits=np.repeat(np.arange(1, SCANS + 1, dtype=np.uint64), TRACKS),
        labels=("x", "y", "vx", "vy"),
        offsets=np.arange(SCANS + 1) * TRACKS,
    )
    clutter = origin + rng.uniform(-5e3, 5e3, (SCANS, DETECTIONS - TRACKS, 2))
    reports = np.concatenate([positions + rng.normal(0.0, 20.0, positions.shape), clutter], axis=1)
    return tr.report.Scene(
        tracks,
        title="Large",
        scans=[tr.Scan(time, rows, "radar") for time, rows in zip(times, reports, strict=True)],
        sensors={"radar": tr.PositionSensor(dims=2, std=20.0)},
        motion=tr.ConstantVelocity(dims=2, accel_psd=0.5),
        truth=[tr.Truth(str(k), times, positions[:, k]) for k in range(TRACKS)],
    )


def harbour(path: Path) -> None:
    """The report of one recording, with its score over time."""
    examples = ROOT / "examples"
    folder = examples / "data" / "autoferry" / "scenario03"
    config = load_config(examples / "harbour.toml")
    recording = read_scans(folder / "detections.csv", folder / "scans.csv", config.columns, config.input)
    truth = read_truth(folder / "truth.csv", config.truth)
    tracks = config.make_tracker().run(recording.scans)
    gospa = config.score.make_metric()
    score = tr.evaluate(
        truth,
        tracks,
        [gospa],
        sensor="radar",
        start=config.score.start,
        region=config.score.region,
        centres=recording.platforms,
    )
    scene = tr.report.Scene(
        tracks,
        scans=recording.scans,
        sensors=config.sensors,
        motion=config.motion,
        truth=truth,
        own_ship=recording.platforms,
        region=config.score.region,
        labels=config.plot.labels,
        swap_axes=config.plot.swap_axes,
    )
    curves = tr.report.Curves([tr.report.Line("GOSPA", score.times, score.series[gospa])], y="GOSPA (m)")
    subtitle = "Radar and lidar on a small ferry, Autoferry scenario03"
    tr.report.write_report(path, "Two vessels in a harbour", [scene, curves], subtitle=subtitle)


def main() -> None:
    """Measure, and draw the picture if asked to."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--picture", type=Path, help="where the picture goes, .png")
    arguments = parser.parse_args()
    path = find_chromium()
    if path is None:
        sys.exit("there is no Chromium on this machine")
    browser = Chromium(path)
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        scene = large()
        begun = time.perf_counter()
        tr.report.write_report(page, "Large", [scene])
        print(f"written in {time.perf_counter() - begun:.2f} s, {page.stat().st_size / 1e6:.1f} MB")
        browser.window(1240, 900)
        begun = time.perf_counter()
        browser.open(page)
        print(f"opened in {time.perf_counter() - begun:.2f} s")
        for name, tail, history, pan in (
            ("as it opens", "short", "5", "false"),
            ("whole tails", "whole", "5", "false"),
            ("whole tails, 20 scans of detections", "whole", "20", "false"),
            ("whole tails, while panning", "whole", "5", "true"),
            ("whole tails, all detections, while panning", "whole", "all", "true"),
        ):
            frames = np.array(browser.run(FRAMES.format(tail=tail, history=history, pan=pan)))
            print(f"{name}: {np.median(frames):.1f} ms a frame, 9 of 10 below {np.quantile(frames, 0.9):.1f} ms")
        print(f"load of the machine: {os.getloadavg()[0]:.1f} of {os.cpu_count()}")
        if arguments.picture is not None:
            harbour(page)
            browser.window(1240, 1000)
            browser.open(page)
            browser.run("document.querySelector('details.tracks').open = false")
            browser.run("(() => { const s = report.scenes[0], r = s.rowNow(2);"
                        "s.tip([s.px(s.position[2 * r]), s.py(s.position[2 * r + 1])]); })()")  # fmt: skip
            browser.frame()
            picture = Image.open(io.BytesIO(browser.screenshot(1240, 1170))).convert("RGB")
            picture.save(arguments.picture, optimize=True)
            print(f"{arguments.picture}: {arguments.picture.stat().st_size / 1e3:.0f} kB")
    browser.close()


if __name__ == "__main__":
    main()
