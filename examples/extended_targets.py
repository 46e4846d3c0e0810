"""Targets that give many detections in a scan: the figures of the extended-target paper, and a filter that does better.

    python examples/extended_targets.py [--out FOLDER] [--runs N] [--seed SEED]

The paper's scenarios: three targets of 10, 20 and 40 detections that meet in the origin at 50 s, and two of 10 side by
side, 80 m apart. The default sums over all cuts of two trees over the detections, learns how many every target gives,
and lets targets that come close share them. The others take one partition, or a range of them, for given: the paper's
two-level chain with parameters that work and as printed, distance, DBSCAN and k-means++. The table is over N runs; the
pictures (PNG, in `out/extended_targets`) show tracks of the first run, and cardinality and OSPA over time averaged over
all. `benchmarks/extended_targets.py` has the whole study.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import trackrs as tr
from trackrs.plot import detection_positions, plot_decision_graph, plot_partition, plot_tracks
from trackrs.scenarios import ExtendedTargets, crossing, parallel

OSPA = tr.OSPA(c=60.0, p=2.0)
DRAWN = ("default", "two-level, k = 4")  # whose tracks are drawn
EVERY = 4  # of so many scans one is drawn
CELLS_AT = 40.0  # seconds, of the scan whose cells are drawn


def filters(scene: ExtendedTargets) -> dict[str, tr.ExtendedGMPHD]:
    """The default, and one argument away the paper's chain and its rivals."""
    default = tr.ExtendedGMPHD(
        scene.motion,
        scene.sensor,
        birth=tr.Birth(scene.births, scene.birth_weight),
        detections_per_target=scene.detections_per_target,
        detection_probability=scene.detection_probability,
        clutter_density=scene.clutter_density,
        confirm_after=1,  # what is extracted is scored, as in the paper
    )
    return {
        "default": default,
        "two-level, k = 4": default.replace(partition=tr.TwoLevelPartition(), clutter_filter=tr.LocalOutlierFactor(4)),
        "two-level as printed": default.replace(
            partition=tr.TwoLevelPartition.as_printed(), clutter_filter=tr.LocalOutlierFactor(10)
        ),
        "distance": default.replace(partition=tr.DistancePartition()),
        "DBSCAN": default.replace(partition=tr.DbscanPartition()),
        "k-means++": default.replace(partition=tr.KMeansPartition()),
    }


def study(name: str, scene: ExtendedTargets, arguments: argparse.Namespace) -> None:
    """Run all filters on the same runs, print their table and draw tracks and scores."""
    tracks_figure, scores_figure = (Figure(figsize=(11, 5.2), layout="constrained") for _ in range(2))
    panels = dict(zip(DRAWN, tracks_figure.subplots(1, len(DRAWN), sharex=True, sharey=True), strict=True))
    count_axis, ospa_axis = scores_figure.subplots(2, 1, sharex=True)
    print(f"{name:22}  {'OSPA m':>6}  {'bias':>6}  {'ms/scan':>7}")
    for method, phd in filters(scene).items():
        counts, distances, spent = [], [], 0.0
        for run in range(arguments.runs):
            scans = scene.draw(arguments.seed, run).scans
            begin = time.process_time()
            tracks = phd.run(scans)
            spent += time.process_time() - begin
            score = tr.evaluate(scene.truth, tracks, [OSPA])
            counts.append(score.tracks)
            distances.append(score.series[OSPA])
            if run == 0 and method in panels:
                detections = detection_positions(scans[::EVERY], {"radar": scene.sensor})
                plot_tracks(tracks, detections=detections, truth=scene.truth, title=method, ax=panels[method])
                panels[method].get_legend().set_visible(method == DRAWN[-1])
        bias = np.mean(np.array(counts) - score.targets)
        per_scan = 1e3 * spent / (arguments.runs * len(scene.times))
        print(f"{method:22}  {np.mean(distances):6.2f}  {bias:+6.3f}  {per_scan:7.2f}")
        count_axis.plot(scene.times, np.mean(counts, axis=0), linewidth=1.2, label=method)
        ospa_axis.plot(scene.times, np.mean(distances, axis=0), linewidth=1.2)
    count_axis.step(scene.times, score.targets, where="mid", color="black", linestyle="--", label="truth")
    count_axis.set_ylabel("targets")
    count_axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    ospa_axis.set_ylabel("OSPA, c = 60 m, p = 2 (m)")
    ospa_axis.set_xlabel("time (s)")
    scores_figure.suptitle(f"{name}: mean of {arguments.runs} run{'s' * (arguments.runs != 1)}")
    tracks_figure.savefig(arguments.out / f"{name}_tracks.png", dpi=100)
    scores_figure.savefig(arguments.out / f"{name}_scores.png", dpi=100)


def draw_cells(scene: ExtendedTargets, arguments: argparse.Namespace) -> None:
    """Decision graph and cells of one scan, clutter taken out before as the paper does."""
    scan = next(scan for scan in scene.draw(arguments.seed).scans if scan.time == CELLS_AT)
    kept = tr.LocalOutlierFactor(4).fit_predict(scan.values, noise=scene.sensor.noise()) >= 0
    two_level = tr.TwoLevelPartition()
    explained = two_level.explain(scan.values[kept], noise=scene.sensor.noise())
    labels = np.full(len(scan), -1)
    labels[kept] = explained.labels
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    plot_decision_graph(explained, peak_distance=two_level.peak_distance, ax=left)
    plot_partition(scan.values, labels, ax=right)
    figure.savefig(arguments.out / "cells.png", dpi=100)


def main() -> None:
    """Print the tables and draw the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("out/extended_targets"), help="folder of the pictures (%(default)s)"
    )
    parser.add_argument("--runs", type=int, default=10, help="(%(default)s)")
    parser.add_argument("--seed", type=int, default=6, help="(%(default)s)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    scenes = {"crossing": crossing(), "parallel": parallel()}
    for name, scene in scenes.items():
        study(name, scene, arguments)
    draw_cells(scenes["crossing"], arguments)
    print("OSPA: c = 60 m, p = 2. bias: estimated minus true number of targets. ms/scan: CPU time.")
    print(f"Pictures: {arguments.out}")


if __name__ == "__main__":
    main()
