"""Measurement-set partitioning for extended targets by local outlier factor and two-level density peaks."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from trackrs.intensity import Birth
from trackrs.lof import LocalOutlierFactor
from trackrs.metric import OSPA
from trackrs.partition import (
    DbscanPartition,
    DistancePartition,
    KMeansPartition,
    TwoLevelPartition,
)
from trackrs.phd import ExtendedGMPHD
from trackrs.plot._figure import COLOURS
from trackrs.report import Scene
from trackrs.reproduce._drawing import draw_over_time, save, sheet, tidy
from trackrs.reproduce._records import Claim, Number, Picture, Reproduction
from trackrs.scenarios import Ellipse, ExtendedTargets, LShape, Rectangle, crossing, parallel
from trackrs.study import Cardinality, Study, StudyResult
from trackrs.tree import TreePartition

if TYPE_CHECKING:
    from pathlib import Path

    from trackrs.partition import _Partitioner
    from trackrs.reproduce._records import Progress

PAPER = "Measurement-set partitioning for extended targets by local outlier factor and two-level density peaks (CFSFDP)"
DEFAULT, DISTANCE, FOUR, TEN, PRINTED, DBSCAN, KMEANS = (
    "default",
    "distance",
    "two-level, k = 4",
    "two-level, k = 10",
    "two-level as printed",
    "DBSCAN",
    "k-means++",
)
CROSSING, SHAPES, PARALLEL = "crossing", "crossing of shapes", "parallel, 80 m"
WINDOW = (45.0, 56.0)  # of the crossing, seconds
# OSPA (c = 60 m, p = 2) and estimated minus true number, each with its half width: findings of the spec, 50 runs (of
# the
# shapes 16). Its default is of an intermediate version for the shapes.
REFERENCE: dict[str, dict[str, tuple[float, float, float, float]]] = {
    CROSSING: {
        DEFAULT: (5.81, 0.16, -0.022, 0.005),
        DISTANCE: (12.25, 0.28, -0.096, 0.013),
        FOUR: (13.30, 0.34, -0.099, 0.010),
        TEN: (20.59, 0.46, -0.390, 0.015),
        DBSCAN: (13.61, 0.26, -0.211, 0.009),
        KMEANS: (33.04, 0.38, 1.569, 0.038),
    },
    SHAPES: {
        DISTANCE: (13.99, 0.44, -0.107, 0.019),
        FOUR: (15.55, 0.51, -0.110, 0.024),
        TEN: (21.47, 0.64, -0.366, 0.027),
        DBSCAN: (15.88, 0.41, -0.258, 0.012),
        KMEANS: (37.96, 0.59, 2.035, 0.075),
    },
    PARALLEL: {
        DEFAULT: (6.34, 0.11, 0.0, 0.002),
        DISTANCE: (15.79, 0.47, 0.111, 0.014),
        FOUR: (16.12, 0.42, 0.024, 0.013),
        TEN: (15.48, 0.42, -0.001, 0.013),
        DBSCAN: (27.39, 0.69, -0.365, 0.018),
        KMEANS: (25.03, 0.42, 0.783, 0.026),
    },
}
FIGURES = {CROSSING: (4, 5, 6), PARALLEL: (7, 8, 9)}


def reproduce(runs: int, seed: int, folder: Path, workers: int | None, progress: Progress) -> Reproduction:
    """Run the paper again."""
    scenes = {CROSSING: crossing(), SHAPES: crossing([Ellipse(), Rectangle(), LShape()]), PARALLEL: parallel()}
    results = {}
    for step, (name, scene) in enumerate(scenes.items()):
        progress(name, step, len(scenes))
        results[name] = Study(scene, filters(scene), [OSPA(60.0), Cardinality()]).run(runs, seed, workers=workers)
    cost = partition_cost(scenes[CROSSING], seed)
    return Reproduction(
        name="extended",
        paper=PAPER,
        summary=(
            "The two-level partition does not beat the distance partition where targets of different density cross, "
            "and "
            "all four methods of the paper count two targets for one there. It beats DBSCAN where targets are close. "
            "As "
            "printed, with a cut-off distance that 2 % of the pairs keep and the centres before the largest gap, it "
            "is the "
            "worst of all. The sum over all cuts of cluster trees with a hypothesis for the group keeps all targets "
            "through the crossing."
        ),
        claims=claims(results, cost),
        numbers=numbers(results),
        pictures=pictures(seed, folder, scenes, results, cost),
        tables={name: result.table(["ospa", "cardinality_error"], DEFAULT) for name, result in results.items()},
        studies=results,
        columns=("ospa", "cardinality_error"),
        baseline=DEFAULT,
        sections=(scene_of(scenes[CROSSING], seed),),
    )


def filters(scene: ExtendedTargets) -> dict[str, ExtendedGMPHD]:
    """Return the filters, told of a scenario what it tells; every target is reported from its first extraction on."""
    default = ExtendedGMPHD(
        scene.motion,
        scene.sensor,
        birth=Birth(scene.births, scene.birth_weight),
        detections_per_target=scene.detections_per_target,
        clutter_density=scene.clutter_density,
        detection_probability=scene.detection_probability,
        confirm_after=1,
    )
    printed = TwoLevelPartition.as_printed()
    return {
        DEFAULT: default,
        DISTANCE: default.replace(partition=DistancePartition()),
        FOUR: default.replace(partition=TwoLevelPartition(), clutter_filter=LocalOutlierFactor(4)),
        TEN: default.replace(partition=TwoLevelPartition(), clutter_filter=LocalOutlierFactor(10)),
        PRINTED: default.replace(partition=printed, clutter_filter=LocalOutlierFactor(10)),
        DBSCAN: default.replace(partition=DbscanPartition()),
        KMEANS: default.replace(partition=KMeansPartition()),
    }


def scene_of(scenario: ExtendedTargets, seed: int) -> Scene:
    """Return one run of the default filter."""
    scans = scenario.draw(seed).scans
    tracks = filters(scenario)[DEFAULT].run(scans)
    sensors = {scans[0].sensor: scenario.sensor}
    return Scene(tracks, "The crossing: one run of the default filter", scans, sensors, truth=scenario.truth)


def partition_cost(scene: ExtendedTargets, seed: int) -> dict[str, float]:
    """Milliseconds for the partitions of one scan, on the average of a run; one thread."""
    rules: dict[str, tuple[_Partitioner, LocalOutlierFactor | None]] = {
        "trees (default)": (TreePartition(), None),
        DISTANCE: (DistancePartition(), None),
        FOUR: (TwoLevelPartition(), LocalOutlierFactor(4)),
        DBSCAN: (DbscanPartition(), None),
        KMEANS: (KMeansPartition(), None),
    }
    noise, scans = scene.sensor.noise(), scene.draw(seed).scans
    out = {}
    for name, (rule, clutter_filter) in rules.items():
        begun = time.thread_time()
        for scan in scans:
            if isinstance(rule, TreePartition):
                rule.trees(scan.values, noise=noise)
            else:
                rule.partitions(scan.values, noise=noise, clutter_filter=clutter_filter)
        out[name] = 1e3 * (time.thread_time() - begun) / len(scans)
    return out


def window_error(result: StudyResult, method: str) -> float:
    """Mean of estimated minus true number while the targets cross."""
    one = result[method]
    inside = (one.times >= WINDOW[0]) & (one.times <= WINDOW[1])
    return float(one.series("cardinality_error")[:, inside].mean())


def numbers(results: dict[str, StudyResult]) -> tuple[Number, ...]:
    """Return ours beside those of the spec."""
    out = []
    for scene, methods in REFERENCE.items():
        for method, (ospa, ospa_half, bias, bias_half) in methods.items():
            for what, column, value, half in (
                ("OSPA, m", "ospa", ospa, ospa_half),
                ("number, estimated minus true", "cardinality_error", bias, bias_half),
            ):
                found = results[scene][method].summary(column)
                out.append(Number(f"{scene}, {method}: {what}", found.mean, found.half_width, value, half))
    return tuple(out)


def claims(results: dict[str, StudyResult], cost: dict[str, float]) -> tuple[Claim, ...]:
    """Return what becomes of the paper's claims."""
    cross, near = results[CROSSING], results[PARALLEL]
    ospa = {one.name: one.summary("ospa").mean for one in cross.methods}
    rivals = (DISTANCE, DBSCAN, KMEANS)
    best = min(rivals, key=lambda name: ospa[name])
    gap = cross.compare(FOUR, best, "ospa")
    bias = {one.name: one.summary("cardinality_error").mean for one in cross.methods}
    close = near.compare(FOUR, DBSCAN, "ospa")
    dbscan = near[DBSCAN].summary("cardinality_error").mean
    during = {name: window_error(cross, name) for name in (FOUR, *rivals, DEFAULT)}
    worst = max(rivals, key=lambda name: ospa[name])
    return (
        Claim(
            "With different densities the two-level partition has the smallest OSPA at a crossing",
            "holds" if gap.high < 0.0 else "does not hold",
            f"two-level with k = 4 {ospa[FOUR]:.1f} m, {best} {ospa[best]:.1f} m (difference {gap.mean:+.2f} m "
            f"[{gap.low:+.2f}, {gap.high:+.2f}], p {gap.p_value:.2g}); as printed {ospa[PRINTED]:.1f} m, the default "
            f"{ospa[DEFAULT]:.1f} m",
        ),
        Claim(
            "It finds the right number of targets while they cross",
            "holds" if abs(during[FOUR]) < 0.1 else "does not hold",
            f"from 45 to 56 s it is {during[FOUR]:+.2f} off, distance {during[DISTANCE]:+.2f}, DBSCAN "
            f"{during[DBSCAN]:+.2f}, "
            f"the default {during[DEFAULT]:+.2f}",
        ),
        Claim(
            "k-means++ overestimates the number and is the worst",
            "holds" if worst == KMEANS and bias[KMEANS] > 0.3 else "does not hold",
            f"{bias[KMEANS]:+.2f} targets and {ospa[KMEANS]:.1f} m at the crossing",
        ),
        Claim(
            "DBSCAN takes close targets for one; the two-level partition does not",
            "holds" if dbscan < -0.2 and close.high < 0.0 else "does not hold",
            f"80 m apart DBSCAN is {dbscan:+.2f} off and the two-level partition {-close.mean:.1f} m better in OSPA "
            f"[{-close.high:.1f}, {-close.low:.1f}]; the distance partition is as good as it "
            f"({near[DISTANCE].summary('ospa').mean:.1f} and {near[FOUR].summary('ospa').mean:.1f} m), the default has "
            f"{near[DEFAULT].summary('ospa').mean:.1f} m",
        ),
        Claim(
            "It takes little more time than DBSCAN, much less than the distance partition and k-means++",
            "holds" if cost[FOUR] < 0.5 * min(cost[DISTANCE], cost[KMEANS]) else "does not hold",
            f"a scan takes {1e3 * cost[FOUR]:.0f} us with its outlier factor, DBSCAN {1e3 * cost[DBSCAN]:.0f}, "
            f"k-means++ "
            f"{1e3 * cost[KMEANS]:.0f}, and all distance partitions {1e3 * cost[DISTANCE]:.0f} by a spanning tree: "
            f"only the "
            "flood fill for every distance is slow",
        ),
    )


def pictures(
    seed: int,
    folder: Path,
    scenes: dict[str, ExtendedTargets],
    results: dict[str, StudyResult],
    cost: dict[str, float],
) -> tuple[Picture, ...]:
    """Redraw the figures."""
    out = draw_cells(seed, folder, scenes[SHAPES])
    shown = [DEFAULT, DISTANCE, FOUR, PRINTED, DBSCAN, KMEANS]
    for name, (count, distance, spent) in FIGURES.items():
        result = results[name]
        figure = sheet(9, 3.6)
        ax = tidy(figure.subplots(), "time, s", "targets", name)
        truth = np.sum(np.isfinite(scenes[name].states[:, :, 0]), axis=1)
        ax.step(result[DEFAULT].times, truth, "k--", where="mid", linewidth=1, label="truth")
        draw_over_time(ax, result, "tracks", shown)
        ax.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
        out.append(save(figure, folder, f"figure{count}", f"Figure {count}: number of targets, {name}"))
        figure = sheet(9, 3.6)
        ax = tidy(figure.subplots(), "time, s", "OSPA, m (c = 60 m, p = 2)", name)
        draw_over_time(ax, result, "ospa", shown)
        ax.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
        out.append(save(figure, folder, f"figure{distance}", f"Figure {distance}: OSPA, {name}"))
        figure = sheet(6, 3.2)
        ax = tidy(figure.subplots(), "ms per scan", "", f"{name}: whole filter, one thread")
        names = [one.name for one in result.methods]
        ax.barh(names, [1e3 * np.median(one.seconds) / len(one.times) for one in result.methods], color=COLOURS[0])
        ax.invert_yaxis()
        out.append(save(figure, folder, f"figure{spent}", f"Figure {spent}: computing time, {name}"))
    figure = sheet(6, 2.8)
    ax = tidy(figure.subplots(), "ms per scan", "", "partitions alone, one thread")
    ax.barh(list(cost), list(cost.values()), color=COLOURS[0])
    ax.invert_yaxis()
    out.append(save(figure, folder, "partition_time", "Not in the paper: computing time of the partitions alone"))
    return tuple(out)


def draw_cells(seed: int, folder: Path, scene: ExtendedTargets) -> list[Picture]:
    """Redraw figures 2 and 3: outlier factors, decision graph and cells of one scan."""
    from trackrs.plot import plot_decision_graph, plot_partition  # noqa: PLC0415 (Matplotlib waits until it is needed)

    out = []
    values = scene.draw(seed).scans[69].values  # at 70 s the three targets are apart
    noise = scene.sensor.noise()
    outliers = LocalOutlierFactor(4)
    scores, kept = outliers.scores(values, noise=noise), outliers.fit_predict(values, noise=noise) >= 0
    figure = sheet(6, 4.2)
    ax = tidy(figure.subplots(), "x, m", "y, m", "local outlier factor, k = 4; crosses: above 2")
    points = ax.scatter(values[kept, 0], values[kept, 1], c=scores[kept], s=18, cmap="viridis")
    ax.plot(*values[~kept].T, "x", color=COLOURS[1])
    figure.colorbar(points, ax=ax)
    out.append(save(figure, folder, "figure2", "Figure 2: local outlier factors of one scan"))
    two_level = TwoLevelPartition()
    explained = two_level.explain(values[kept], noise=noise)
    labels = np.full(len(values), -1)
    labels[kept] = explained.labels
    figure = sheet(9, 4.0)
    left, middle = figure.subplots(1, 2)
    plot_decision_graph(explained, peak_distance=two_level.peak_distance, ax=left)
    plot_partition(values, labels, ax=middle)
    out.append(save(figure, folder, "figure3", "Figure 3: decision graph and cells of the same scan"))
    return out
