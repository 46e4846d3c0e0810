"""Extended targets, 50 runs: the default filter against the paper's chain and its rivals, on the same runs.

    python benchmarks/extended_targets.py [--runs 50] [--only crossing parallel80 ...] [--seed 6] [--check]

Tables in Markdown: OSPA at c = 60 m, p = 2 and at c = 100 m, p = 1, the mean of estimated minus true cardinality and of
its magnitude, OSPA from 45 to 56 s, each with its 95 % half width; the default against each method, run by run; and in
how many runs every target has the same track at the end of its life as at 40 s, and no other target has it. `--check`
sets them against the figures of an independent implementation (50 other runs, shapes 16).

A track counts from its first extraction (`confirm_after=1`), because those figures are of what is extracted at each
time; with the default of 2 a target comes one scan later. Times are CPU time from Python.
"""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np

import trackrs as tr
from trackrs.scenarios import Ellipse, ExtendedTarget, LShape, Rectangle, crossing, extended_targets, parallel

OSPA60, OSPA100 = tr.OSPA(c=60.0, p=2.0), tr.OSPA(c=100.0, p=1.0)
WINDOW = (45.0, 56.0)
IDENTITY_FROM = 40.0  # before anything meets
NEAR = 60.0  # a track farther from a target is not its track
SCORES = ("OSPA60,2", "OSPA100,1", "bias", "|err|", "45-56 s", "confirmed OSPA", "confirmed bias", "kept", "late", "ms")


@dataclass(frozen=True, slots=True)
class Scene:
    """A scenario and the published means and half widths of (OSPA60, OSPA100, bias, |err|, window), by method."""

    scenario: tr.scenarios.ExtendedTargets
    published: dict[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    dies_in_group: bool = False


SCENES = {
    "crossing": Scene(
        crossing(),
        {
            "default": ((5.81, 0.16), (5.45, 0.17), (-0.022, 0.005), (0.022, 0.005), (5.7, 0.3)),
            "tree, rate known": ((8.53, 0.21), (8.72, 0.25), (-0.115, 0.008), (0.116, 0.008), (26.9, 1.1)),
            "distance": ((12.25, 0.28), (13.33, 0.30), (-0.096, 0.013), (0.256, 0.010), (39.3, 0.8)),
            "two-level, k = 4": ((13.30, 0.34), (14.63, 0.38), (-0.099, 0.010), (0.294, 0.013), (40.6, 0.7)),
            "two-level, k = 10": ((20.59, 0.46), (22.99, 0.53), (-0.390, 0.015), (0.500, 0.014), (40.7, 0.8)),
            "DBSCAN": ((13.61, 0.26), (15.47, 0.29), (-0.211, 0.009), (0.299, 0.008), (46.7, 0.5)),
            "k-means++": ((33.04, 0.38), (39.00, 0.56), (1.569, 0.038), (1.654, 0.038), (34.5, 1.0)),
        },
    ),
    "parallel80": Scene(
        parallel(),
        {
            "default": ((6.34, 0.11), (6.00, 0.12), (0.0, 0.002), (0.004, 0.002), (6.2, 0.3)),
            "distance": ((15.79, 0.47), (17.21, 0.59), (0.111, 0.014), (0.268, 0.015), (16.1, 1.2)),
            "two-level, k = 4": ((16.12, 0.42), (17.92, 0.52), (0.024, 0.013), (0.246, 0.011), (16.4, 1.4)),
            "two-level, k = 10": ((15.48, 0.42), (17.18, 0.52), (-0.001, 0.013), (0.227, 0.011), (15.8, 1.4)),
            "DBSCAN": ((27.39, 0.69), (34.00, 0.97), (-0.365, 0.018), (0.460, 0.017), (27.4, 1.5)),
            "k-means++": ((25.03, 0.42), (28.83, 0.53), (0.783, 0.026), (0.828, 0.025), (26.1, 1.4)),
        },
    ),
    "parallel70": Scene(parallel(70.0)),
    "shapes": Scene(
        crossing([Ellipse(), Rectangle(), LShape()]),
        {
            "default": ((7.91, 0.57), (7.62, 0.73), (-0.044, 0.023), (0.045, 0.022), (14.5, 4.0)),
            "distance": ((13.99, 0.44), (15.58, 0.57), (-0.107, 0.019), (0.292, 0.024), (45.0, 0.9)),
            "two-level, k = 4": ((15.55, 0.51), (17.50, 0.55), (-0.110, 0.024), (0.341, 0.018), (47.0, 1.0)),
            "two-level, k = 10": ((21.47, 0.64), (24.39, 0.72), (-0.366, 0.027), (0.507, 0.019), (47.2, 0.9)),
            "DBSCAN": ((15.88, 0.41), (18.52, 0.47), (-0.258, 0.012), (0.348, 0.012), (51.2, 0.9)),
            "k-means++": ((37.96, 0.59), (47.30, 0.90), (2.035, 0.075), (2.112, 0.072), (38.8, 1.3)),
        },
    ),
    "start40": Scene(
        extended_targets([ExtendedTarget((-800, 600, 16, 0)), ExtendedTarget((-800, 640, 16, 0))], births=[(-800, 620)])
    ),
    "death80": Scene(
        extended_targets([ExtendedTarget((-800, 600, 16, 0)), ExtendedTarget((-800, 680, 16, 0), last=50.0)]),
        dies_in_group=True,
    ),
}


def methods(scene: tr.scenarios.ExtendedTargets) -> dict[str, tr.ExtendedGMPHD]:
    """The filters, told of a scenario what it tells."""
    default = tr.ExtendedGMPHD(
        scene.motion,
        scene.sensor,
        birth=tr.Birth(scene.births, scene.birth_weight),
        detections_per_target=scene.detections_per_target,
        clutter_density=scene.clutter_density,
        detection_probability=scene.detection_probability,
        confirm_after=1,
    )
    known = tr.DetectionRate(scene.detections_per_target, learnt=False)
    printed = tr.TwoLevelPartition.as_printed()
    return {
        "default": default,
        "tree, rate known": default.replace(superposition=False, detections_per_target=known),
        "distance": default.replace(partition=tr.DistancePartition()),
        "two-level, k = 4": default.replace(partition=tr.TwoLevelPartition(), clutter_filter=tr.LocalOutlierFactor(4)),
        "two-level, k = 10": default.replace(
            partition=tr.TwoLevelPartition(), clutter_filter=tr.LocalOutlierFactor(10)
        ),
        "two-level, printed": default.replace(partition=printed, clutter_filter=tr.LocalOutlierFactor(10)),
        "DBSCAN": default.replace(partition=tr.DbscanPartition()),
        "k-means++": default.replace(partition=tr.KMeansPartition()),
    }


def keeps_identities(tracks: tr.Tracks, truth: tuple[tr.Truth, ...]) -> bool:
    """Whether each target's last track is that of its last extraction up to 40 s, and no other target has it."""
    kept = []
    for target in truth:
        last: dict[bool, int] = {}
        for when, position in zip(target.times, target.positions, strict=True):
            rows = np.flatnonzero(tracks.times == when)
            apart = np.linalg.norm(tracks.means[rows, :2] - position, axis=1)
            if len(rows) and apart.min() <= NEAR:
                last[bool(when <= IDENTITY_FROM)] = int(tracks.ids[rows[apart.argmin()]])
        if len(last) < 2 or last[True] != last[False]:
            return False
        kept.append(last[False])
    return len(set(kept)) == len(kept)


def scans_reported_after_death(tracks: tr.Tracks, truth: tuple[tr.Truth, ...]) -> float:
    """Scans in a row with too many tracks after the end of the target that ends first."""
    ends = [target.times[-1] for target in truth]
    alive = sum(end > min(ends) for end in ends)
    late = 0
    for when in tracks.scan_times[tracks.scan_times > min(ends)]:
        if np.sum(tracks.times == when) <= alive:
            break
        late += 1
    return float(late)


def work(task: tuple[str, int, int]) -> np.ndarray:
    """One run of a scene by all methods, (methods, SCORES)."""
    name, seed, run = task
    scene = SCENES[name].scenario
    scans = scene.draw(seed, run).scans
    out = []
    for phd in methods(scene).values():
        begin = time.process_time()
        tracks = phd.run(scans)
        spent = time.process_time() - begin
        found = tr.evaluate(scene.truth, tracks, [OSPA60, OSPA100])
        error = found.tracks - found.targets
        window = (found.times >= WINDOW[0]) & (found.times <= WINDOW[1])
        confirmed = tr.evaluate(scene.truth, phd.replace(confirm_after=2).run(scans), [OSPA60])
        out.append(
            [
                found.mean[OSPA60],
                found.mean[OSPA100],
                error.mean(),
                np.abs(error).mean(),
                found.series[OSPA60][window].mean(),
                confirmed.mean[OSPA60],
                (confirmed.tracks - confirmed.targets).mean(),
                keeps_identities(tracks, scene.truth),
                scans_reported_after_death(tracks, scene.truth),
                1e3 * spent / len(scans),
            ]
        )
    return np.array(out, dtype=np.float64)


def mean(values: np.ndarray) -> tuple[float, float]:
    """Mean over runs and its 95 % half width."""
    return float(values.mean()), float(1.96 * values.std(ddof=1) / np.sqrt(len(values)))


def cell(values: np.ndarray, digits: int, sign: str = "") -> str:
    """A mean with its half width, for a table."""
    middle, half = mean(values)
    return f"{middle:{sign}.{digits}f} ± {half:.{digits}f}"


def report(name: str, scores: dict[str, np.ndarray]) -> None:
    """Print the table of a scene; scores are (runs, SCORES) by method."""
    default = scores["default"]
    heads = ("", "OSPA 60, 2", "OSPA 100, 1", "bias", "\\|err\\|", "OSPA 45-56 s", "confirmed: OSPA, bias")
    heads += ("default better by", "in", "identities", "ms/scan")
    print(f"\n## {name}, {len(default)} runs\n")
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for method, values in scores.items():
        column = dict(zip(SCORES, values.T, strict=True))
        gain = values[:, 0] - default[:, 0]
        cells = [
            method,
            cell(column["OSPA60,2"], 2),
            cell(column["OSPA100,1"], 2),
            cell(column["bias"], 3, "+"),
            cell(column["|err|"], 3),
            cell(column["45-56 s"], 1),
            f"{column['confirmed OSPA'].mean():.2f}, {column['confirmed bias'].mean():+.3f}",
            *(("", "") if method == "default" else (cell(gain, 2), f"{np.mean(gain > 0):.0%}")),
            f"{column['kept'].mean():.0%}",
            f"{np.median(column['ms']):.2f}",
        ]
        print("| " + " | ".join(cells) + " |")
    if SCENES[name].dies_in_group:
        late = SCORES.index("late")
        means = ", ".join(f"{method} {cell(values[:, late], 2)}" for method, values in scores.items())
        print(f"\nScans with a track too many after the death: {means}.")


def check(name: str, scores: dict[str, np.ndarray]) -> None:
    """Print every published figure beside ours; allowed is 1.5 times the root of the sum of the squared half widths."""
    published = SCENES[name].published
    if not published:
        return
    print("\n| | score | found | published | off / allowed |\n|---|---|---|---|---|")
    for method, figures in published.items():
        for i, (value, half) in enumerate(figures):
            found, width = mean(scores[method][:, i])
            off = (found - value) / (1.5 * np.hypot(half, width))
            verdict = "" if abs(off) <= 1.0 else ", better" if abs(found) < abs(value) else ", WORSE"
            print(f"| {method} | {SCORES[i]} | {found:.3f} ± {width:.3f} | {value} ± {half} | {off:+.2f}{verdict} |")


def main() -> None:
    """Run the scenes and print their tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=50, help="at least 2 (%(default)s)")
    parser.add_argument("--seed", type=int, default=6, help="(%(default)s)")
    parser.add_argument("--only", nargs="*", choices=SCENES, default=list(SCENES), help="scenes (all)")
    parser.add_argument("--check", action="store_true", help="compare with the published figures")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (%(default)s)")
    arguments = parser.parse_args()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for name in arguments.only:
            tasks = [(name, arguments.seed, run) for run in range(arguments.runs)]
            values = np.stack(list(pool.map(work, tasks)), axis=1)
            scores = dict(zip(methods(SCENES[name].scenario), values, strict=True))
            report(name, scores)
            if arguments.check:
                check(name, scores)


if __name__ == "__main__":
    main()
