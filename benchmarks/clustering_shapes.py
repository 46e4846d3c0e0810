"""Density peaks on the shape sets of their literature, and what partitions of a scan cost.

    TRACKRS_DATA=FOLDER python benchmarks/clustering_shapes.py [--times]

The sets are `clustering_shapes` in the folder `TRACKRS_DATA` (github.com/gagolews/clustering-data-v1); they are for
research only, so they are no part of this project. The score is the adjusted Rand index, points labelled as noise left
out; where a set has several accepted partitions, the best. Labels are used for scores and the number of peaks only.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

import trackrs as tr

PERCENT = (1.0, 2.0, 4.0)
SETS = ("aggregation", "flame", "jain", "spiral", "r15", "compound", "graves_zigzag_noisy", "graves_ring_outliers")


def shapes_folder() -> Path | None:
    """Where the sets are, if they are anywhere."""
    folder = Path(os.environ.get("TRACKRS_DATA", "")) / "clustering_shapes"
    return folder if "TRACKRS_DATA" in os.environ and folder.is_dir() else None


def load(folder: Path, name: str) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the points of a set and its accepted partitions, label 0 = noise."""
    table = np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True)
    columns = [column for column in table.dtype.names if column.startswith("labels")]
    return np.stack([table["x"], table["y"]], axis=1), [table[column].astype(int) for column in columns]


def adjusted_rand(found: np.ndarray, truth: np.ndarray) -> float:
    """Adjusted Rand index (Hubert, Arabie 1985) over the points that are no noise."""
    found, truth = found[truth != 0], truth[truth != 0]
    table = np.zeros((found.max() + 1, truth.max() + 1))
    np.add.at(table, (found, truth), 1)
    both, rows, columns = ((n * (n - 1) / 2).sum() for n in (table, table.sum(1), table.sum(0)))
    expected = rows * columns / (len(found) * (len(found) - 1) / 2)
    most = (rows + columns) / 2
    return 1.0 if most == expected else float((both - expected) / (most - expected))


def score(points: np.ndarray, truths: list[np.ndarray], **options: object) -> float:
    """Return the best index over the percentages and the accepted partitions; `peaks=None` = their number."""
    best = -1.0
    for truth in truths:
        given = {**options, "peaks": options["peaks"] or len(set(truth[truth != 0]))}
        for percent in PERCENT:
            found = tr.TwoLevelPartition(percent=percent, **given).explain(points)
            labels = found.labels if "beta" in options else found.graph.labels
            best = max(best, adjusted_rand(labels, truth))
    return best


COLUMNS = {
    "number given": {"peaks": None},
    "gap": {"peaks": "gap"},
    "distance": {"peaks": "distance"},
    "distance, merged": {"peaks": "distance", "beta": 1.0},
    "distance, merged at 0.5": {"peaks": "distance", "beta": 0.5},
}


def show_scores(folder: Path) -> None:
    """Print the table."""
    print("| set | points |", " | ".join(COLUMNS), "|")
    print("|---" * (len(COLUMNS) + 2) + "|")
    for name in SETS:
        points, truths = load(folder, name)
        values = (f"{score(points, truths, **options):.3f}" for options in COLUMNS.values())
        print(f"| {name} | {len(points)} |", " | ".join(values), "|")


def scan(rng: np.random.Generator) -> np.ndarray:
    """A scan of the crossing: 10, 20 and 40 measurements of three targets on average, 10 of clutter."""
    time_ = rng.uniform(20.0, 90.0)
    velocity = np.array([[800 / 49, 600 / 49], [900 / 49, -100 / 49], [70 / 3, -70 / 3]])
    centres = (time_ - 50.0) * velocity
    targets = [c + 20.0 * rng.standard_normal((rng.poisson(n), 2)) for c, n in zip(centres, (10, 20, 40), strict=True)]
    return np.concatenate([*targets, rng.uniform(-1000, 1000, (rng.poisson(10), 2))])


def show_times() -> None:
    """Print CPU time per scan, the median of 15 rounds over 100 scans."""
    rng = np.random.default_rng(0)
    scans = [scan(rng) for _ in range(100)]
    noise = 400.0 * np.eye(2)
    lof = tr.LocalOutlierFactor()
    cases = {
        "outlier factor": lambda z: lof.scores(z, noise=noise),
        "two-level": lambda z: tr.TwoLevelPartition().partitions(z, noise=noise),
        "two-level behind the outlier factor": lambda z: tr.TwoLevelPartition().partitions(
            z, noise=noise, clutter_filter=lof
        ),
        "distance, difference": lambda z: tr.DistancePartition("difference").partitions(z, noise=noise),
        "distance, literature": lambda z: tr.DistancePartition("literature").partitions(z, noise=noise),
        "DBSCAN": lambda z: tr.DbscanPartition().partitions(z, noise=noise),
        "k-means, 1 to 20": lambda z: tr.KMeansPartition().partitions(z, noise=noise),
        "trees, single and Ward": lambda z: tr.TreePartition().trees(z, noise=noise),
    }
    print(f"CPU time per scan of {np.mean([len(z) for z in scans]):.0f} points, ms")
    for name, call in cases.items():
        rounds = []
        for _ in range(15):
            start = time.process_time()
            for z in scans:
                call(z)
            rounds.append((time.process_time() - start) / len(scans) * 1e3)
        results = [call(z) for z in scans]
        counts = [len(r) for r in results if isinstance(r, tr.Partitions)]
        print(f"  {name:36} {np.median(rounds):.3f}", f"({np.mean(counts):.1f} partitions)" if counts else "")


def main() -> None:
    """Print the scores, or the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", action="store_true", help="what partitions of a scan cost")
    if parser.parse_args().times:
        show_times()
        return
    folder = shapes_folder()
    if folder is None:
        print("not there; set TRACKRS_DATA to the folder that holds clustering_shapes")
        return
    show_scores(folder)


if __name__ == "__main__":
    main()
