"""Workloads of the peers' benchmark that it does not have: a scan of the crossing, about 75 points of three targets.

W5two: outlier factor and two-level partition; W5dist: all distance partitions; W7ext: the scan through the default
filter, prediction, update and labels. No package has them; NumPy and SciPy by hand stand beside the first two.
`run.py` puts this file among the peers' and runs it as one of them.
"""

from __future__ import annotations

import numpy as np
from common import main_args, peer, run_workload, try_import_trackrs, wanted
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.distance import cdist

SCAN = 39  # at 40 s: all three live and are apart
STD, NEIGHBOURS, THRESHOLD, PEAK_DISTANCE = 20.0, 4, 2.0, 2.0
BOUNDS = STD * np.sqrt([1.427, 6.438])  # chi-square quantiles .3 and .8 for two, doubled


def inputs(_size: str) -> dict:
    """The scan, and those before it."""
    import trackrs as tr

    scene = tr.scenarios.crossing()
    scans = scene.draw(seed=7).scans
    return {"scene": scene, "before": scans[:SCAN], "scan": scans[SCAN], "X": scans[SCAN].values}


def sets(labels: np.ndarray) -> set[frozenset[int]]:
    """A partition as a set of sets; -1 alone."""
    return {frozenset(np.flatnonzero(labels == label).tolist()) for label in np.unique(labels)}


def distance_partitions(x: np.ndarray) -> list[np.ndarray]:
    """Cuts of the minimum spanning tree at all distinct lengths between the bounds."""
    tree = minimum_spanning_tree(cdist(x, x)).tocoo()
    inside = np.unique(tree.data[(tree.data > BOUNDS[0]) & (tree.data <= BOUNDS[1])])
    out = []
    for bound in [BOUNDS[0], *inside]:
        cut = tree.copy()
        cut.data = np.where(cut.data <= bound, 1.0, 0.0)
        cut.eliminate_zeros()
        out.append(connected_components(cut, directed=False)[1])
    return out


def two_level(x: np.ndarray) -> np.ndarray:
    """Outlier factor, density peaks by distance, cells joined at borders denser than their mean; -1 = clutter."""
    d = cdist(x, x)
    np.fill_diagonal(d, np.inf)
    near = np.argpartition(d, NEIGHBOURS, axis=1)[:, :NEIGHBOURS]
    radius = np.take_along_axis(d, near, 1).max(1)
    density = 1.0 / np.maximum(radius[near], np.take_along_axis(d, near, 1)).mean(1)
    kept = np.flatnonzero(density[near].mean(1) / density <= THRESHOLD)
    d = d[np.ix_(kept, kept)]
    rho = np.exp(-((d / STD) ** 2)).sum(1)
    order = np.argsort(-rho, kind="stable")
    rank = np.empty(len(order), dtype=int)
    rank[order] = np.arange(len(order))
    denser = np.where(rank[None] < rank[:, None], d, np.inf)
    parent, delta = denser.argmin(1), denser.min(1)
    labels = np.full(len(kept), -1)
    count = 0
    for i in order:
        if delta[i] > PEAK_DISTANCE * STD:
            labels[i], count = count, count + 1
        else:
            labels[i] = labels[parent[i]]
    mean = np.array([rho[labels == label].mean() for label in range(count)])
    i, j = np.nonzero((d < STD) & (labels[:, None] != labels))
    joined = 0.5 * (rho[i] + rho[j]) >= np.minimum(mean[labels[i]], mean[labels[j]])
    graph = np.zeros((count, count))
    graph[labels[i[joined]], labels[j[joined]]] = 1.0
    names = connected_components(graph, directed=False)[1]
    out = np.full(len(x), -1)
    out[kept] = names[labels]
    return out


@peer("W5two", "numpy-handwritten", "numpy")
def _(d: dict) -> tuple:
    return lambda: two_level(d["X"]), lambda labels: labels


@peer("W5dist", "scipy-handwritten", "scipy")
def _(d: dict) -> tuple:
    return lambda: distance_partitions(d["X"]), lambda labels: labels


def check_two(d: dict, labels: np.ndarray) -> tuple[bool, str]:
    """The same cells as by hand."""
    return sets(labels) == sets(two_level(d["X"])), f"{len(sets(labels))} cells"


def check_distance(d: dict, partitions: list) -> tuple[bool, str]:
    """The same partitions as by hand."""
    same = [sets(labels) for labels in partitions] == [sets(labels) for labels in distance_partitions(d["X"])]
    return same, f"{len(partitions)} partitions"


def check_tracks(_d: dict, tracks: object) -> tuple[bool, str]:
    """Three targets."""
    return len(tracks) == 3, f"{len(tracks)} tracks"


def main() -> None:
    """Run what is asked for."""
    arguments = main_args()
    try_import_trackrs()
    for workload, check in (("W5two", check_two), ("W5dist", check_distance), ("W7ext", check_tracks)):
        if wanted(arguments, workload):
            run_workload(
                workload, ["75"], inputs, check, "ms", lambda _d: (1, 1e3), arguments.budget, only=arguments.only
            )


if __name__ == "__main__":
    main()
