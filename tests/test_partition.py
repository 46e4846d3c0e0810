"""Partitions of points and outlier factors: golden files, textbook formulae written out, odd input."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.cluster.hierarchy import linkage

import trackrs as tr

DATA = Path(__file__).resolve().parent / "data"
ONE = [
    tr.DbscanPartition(eps=1.5),
    tr.DensityPeakPartition(d_c=1.0),
    tr.DensityPeakPartition(percent=2.0, peaks="gap", kernel="cutoff"),
    tr.TwoLevelPartition(d_c=1.0),
    tr.TwoLevelPartition(percent=5.0, peaks=2, border="mean", max_link=3.0),
    tr.TwoLevelPartition.as_printed(),
    tr.DistancePartition(threshold=1.5),
    tr.KMeansPartition(k=3),
]
ALL = [
    *ONE,
    tr.DistancePartition(),
    tr.DistancePartition("difference", detections_per_target=5.0),
    tr.KMeansPartition(),
    tr.TreePartition(),
    tr.TreePartition(["single"], max_extent=4.0),
]


def golden(name):
    return json.loads((DATA / f"{name}.json").read_text())


def blobs(seed, n=120, d=2):
    """Three blobs of unit spread and a tenth of clutter; ties have probability zero."""
    rng = np.random.default_rng(seed)
    centres = 6.0 * rng.standard_normal((3, d))
    points = centres[rng.integers(0, 3, n)] + rng.standard_normal((n, d))
    points[: n // 10] = rng.uniform(-20, 20, (n // 10, d))
    return rng.permutation(points)


def distances(points):
    return np.sqrt(((points[:, None] - points[None]) ** 2).sum(-1))


def sets(labels):
    return {frozenset(np.flatnonzero(labels == label).tolist()) for label in np.unique(labels)}


# --- oracles: the formulae written again -----------------------------------------------------------------------------


def lof_oracle(points, k):
    """The formula as scikit-learn computes it, with what it adds to the mean reachability; there are no ties."""
    d = distances(points)
    np.fill_diagonal(d, np.inf)
    near = np.argsort(d, axis=1)[:, :k]
    reach = np.maximum(np.take_along_axis(d, near, 1), np.sort(d, axis=1)[near, k - 1])
    lrd = 1.0 / (reach.mean(1) + 1e-10)
    return lrd[near].mean(1) / lrd


def dbscan_oracle(points, eps, min_samples):
    """The labels of scikit-learn: clusters grown from core points in the order of indices."""
    near = distances(points) <= eps
    core = near.sum(1) >= min_samples
    labels, clusters = np.full(len(points), -1), 0
    for start in np.flatnonzero(core):
        if labels[start] >= 0:
            continue
        waiting = [start]
        while waiting:
            i = waiting.pop()
            if labels[i] < 0:
                labels[i] = clusters
                waiting += np.flatnonzero(near[i]).tolist() if core[i] else []
        clusters += 1
    return labels


def flood_fill(points, theta):
    near, labels = distances(points) <= theta, np.full(len(points), -1)
    for start in range(len(points)):
        waiting = [start] if labels[start] < 0 else []
        while waiting:
            i = waiting.pop()
            if labels[i] < 0:
                labels[i] = start
                waiting += np.flatnonzero(near[i]).tolist()
    return sets(labels)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("k", [1, 4, 20])
def test_outlier_factor_equals_the_formula_of_scikit_learn(seed, k):
    points = blobs(seed, d=1 + seed % 3)
    for ties in (True, False):
        scores = tr.LocalOutlierFactor(k, include_ties=ties).scores(points)
        # What is added there shifts the ratio by as much, relative to the mean reachability.
        shift = 2e-10 / tr.LocalOutlierFactor(k).explain(points).k_distance.min()
        assert np.allclose(scores, lof_oracle(points, k), rtol=1e-10 + shift, atol=0.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("eps", "min_samples"), [(0.5, 3), (1.0, 1), (1.5, 4), (3.0, 8)])
def test_dbscan_labels_are_those_of_scikit_learn(seed, eps, min_samples):
    points = blobs(seed, d=1 + seed % 3)
    found = tr.DbscanPartition(eps, min_samples)
    assert found.fit_predict(points).tolist() == dbscan_oracle(points, eps, min_samples).tolist()


@pytest.mark.parametrize("seed", range(5))
def test_distance_partitions_equal_flood_fill(seed):
    points = blobs(seed, n=60)
    if seed == 0:
        points = np.round(points)  # many ties, and points that coincide
    bounds = (0.4, 2.5)
    found = tr.DistancePartition(bounds).partitions(points)
    d = np.unique(distances(points))
    expected = []
    for theta in [bounds[0], *d[(d > bounds[0]) & (d <= bounds[1])]]:
        cells = flood_fill(points, theta)
        if cells not in expected:
            expected.append(cells)
    assert [sets(labels) for labels in found.labels] == expected
    assert sets(tr.DistancePartition(threshold=1.3).fit_predict(points)) == flood_fill(points, 1.3)


@pytest.mark.parametrize("kernel", ["gaussian", "cutoff"])
@pytest.mark.parametrize("seed", range(4))
def test_density_peaks_equal_the_formula(seed, kernel):
    points = blobs(seed, n=200, d=1 + seed % 3)
    graph = tr.DensityPeakPartition(percent=3.0, kernel=kernel).explain(points)
    d = distances(points)
    pairs = np.sort(d[np.triu_indices(len(d), 1)])
    assert graph.d_c == pytest.approx(pairs[int(len(pairs) * 0.03 + 0.5) - 1], rel=1e-14)
    rho = np.exp(-((d / graph.d_c) ** 2)).sum(1) - 1 if kernel == "gaussian" else (d < graph.d_c).sum(1) - 1.0
    assert np.allclose(graph.rho, rho, rtol=1e-12, atol=1e-14)
    # The order of points without neighbours is that of their exact densities, which 1 + x - 1 loses.
    order = graph.order
    assert order.tolist() == np.lexsort((np.arange(len(d)), -graph.rho)).tolist()
    for rank, i in enumerate(order[1:], start=1):
        assert graph.delta[i] == d[i, order[:rank]].min()
        assert d[i, graph.nearest_denser[i]] == graph.delta[i]
    assert graph.delta[order[0]] == d[order[0]].max()
    assert graph.nearest_denser[order[0]] == -1


MANY = """
import hashlib, os, sys
if sys.argv[1] == "one":
    os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
import numpy as np, trackrs as tr
rng = np.random.default_rng(3)
points = np.concatenate([rng.normal(rng.uniform(0, 300, 2), 4.0, (600, 2)) for _ in range(40)])
points[5_000:5_100] = points[0]
peaks = tr.DensityPeakPartition(d_c=3.0).explain(points)
factors = tr.LocalOutlierFactor(n_neighbors=8).scores(points)
labels = tr.DbscanPartition(eps=1.5, min_samples=4).fit_predict(points)
parts = [peaks.rho, peaks.delta, peaks.nearest_denser, peaks.labels, factors, labels]
print(hashlib.sha256(b"".join(np.asarray(part).tobytes() for part in parts)).hexdigest())
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs a choice of processors")
def test_many_points_have_the_same_bits_on_any_number_of_threads():
    """24,000 points are looked at on as many threads as there are processors, at most five."""
    found = [
        subprocess.run([sys.executable, "-c", MANY, how], check=True, capture_output=True, text=True).stdout
        for how in ("one", "all")
    ]
    assert found[0] == found[1]
    assert len(found[0]) == 65


@pytest.mark.parametrize("seed", range(4))
def test_trees_equal_those_of_scipy(seed):
    points = blobs(seed, n=80, d=1 + seed % 3)
    for name, tree in zip(("single", "ward"), tr.TreePartition().trees(points), strict=True):
        expected = linkage(points, name)
        assert np.allclose(tree.heights, expected[:, 2], rtol=1e-9)
        assert np.array_equal(tree.children, np.sort(expected[:, :2].astype(int), axis=1))
        assert tree.roots.tolist() == [158]
        cuts = tr.TreePartition([name]).partitions(points)
        assert len(cuts) == 80
        assert all(sets(b) != sets(a) and len(sets(b)) == len(sets(a)) - 1 for a, b in pairwise(cuts.labels))


def test_kmeans_ends_at_a_fixed_point_whatever_the_range():
    points = blobs(1)
    found = tr.KMeansPartition((1, 8), seed=3).partitions(points)
    for k, labels in enumerate(found.labels, start=1):
        centres = np.array([points[labels == label].mean(0) for label in np.unique(labels)])
        assert np.array_equal(((points[:, None] - centres) ** 2).sum(-1).argmin(1), labels)
        assert np.array_equal(tr.KMeansPartition(k, seed=3).fit_predict(points), labels)


# --- golden files ----------------------------------------------------------------------------------------------------


def test_records_match_the_golden_files():
    for case in golden("et_lof")["cases"]:
        found = tr.LocalOutlierFactor(case["k"], include_ties=case["include_ties"]).explain(case["points"])
        for name, key in (("k_distance", "kdist"), ("reachability_density", "lrd"), ("factors", "lof")):
            assert np.allclose(getattr(found, name), np.array(case[key], float), rtol=1e-9)
    case = next(c for c in golden("et_cfsfdp")["cases"] if c["name"] == "B_gauss_dc20_kappa1_mean")
    found = tr.TwoLevelPartition(d_c=20.0, peak_distance=1.0, border="mean").explain(case["points"])
    assert np.allclose(found.graph.rho, case["rho"], rtol=1e-9)
    assert np.allclose(found.graph.delta, case["delta"], rtol=1e-9)
    assert found.graph.peaks.tolist() == case["peaks"]
    assert found.graph.labels.tolist() == case["lab0"]
    assert found.labels.tolist() == case["lab"]
    border = np.array(case["rho_bord"], float)
    assert np.allclose(found.border_density, border[tuple(found.borders.T)], rtol=1e-9)
    assert np.isfinite(border).sum() == 2 * len(found.borders)


def test_the_chain_of_the_paper():
    file = golden("et_partition")
    for case in file["two_level"]:
        found = tr.TwoLevelPartition().partitions(
            file["points"], noise=file["R"], clutter_filter=tr.LocalOutlierFactor(case["k"])
        )
        assert sorted(cell.tolist() for cell in found.cells(0)) == sorted(map(sorted, case["partition"]))
    assert tr.TwoLevelPartition.as_printed() == tr.TwoLevelPartition(percent=2.0, peaks="gap", beta=1.0, border="max")


# --- properties ------------------------------------------------------------------------------------------------------

NO_TIES = [p for p in ALL if not isinstance(p, (tr.KMeansPartition, tr.DbscanPartition))]
NO_TIES.remove(tr.DensityPeakPartition(percent=2.0, peaks="gap", kernel="cutoff"))  # equal densities are ties
NO_TIES.remove(tr.DistancePartition("difference", detections_per_target=5.0))  # k-means


@pytest.mark.parametrize("partitioner", NO_TIES, ids=repr)
def test_the_order_of_points_makes_no_difference(partitioner):
    for seed in range(5):
        points = blobs(seed)
        order = np.random.default_rng(seed).permutation(len(points))
        filters = tr.LocalOutlierFactor()
        plain = partitioner.partitions(points, clutter_filter=filters).labels
        turned = partitioner.partitions(points[order], clutter_filter=filters).labels
        back = np.empty_like(turned)
        back[:, order] = turned
        assert [sets(a) for a in plain] == [sets(b) for b in back]


@pytest.mark.parametrize("partitioner", ALL, ids=repr)
def test_noise_whitens(partitioner):
    """Points stretched by a matrix, and the noise with them, fall into the same cells."""
    points = blobs(2)
    stretch = np.array([[3.0, 0.0], [1.0, 0.5]])
    noise = stretch @ stretch.T
    scale = np.sqrt(np.trace(noise) / 2.0)
    plain = partitioner.partitions(scale * points, noise=scale**2 * np.eye(2))
    turned = partitioner.partitions(points @ stretch.T, noise=noise)
    assert np.array_equal(plain.labels, turned.labels)


def test_sub_partitions_split_what_is_too_large():
    points = np.concatenate([np.zeros((10, 1)), np.full((10, 1), 1.0), [[50.0]]]) + 0.001 * np.arange(21)[:, None]
    found = tr.DistancePartition(threshold=2.0, detections_per_target=10.0).partitions(points)
    assert [list(map(len, found.cells(i))) for i in range(len(found))] == [[20, 1], [10, 10, 1]]


# --- odd input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("partitioner", ALL, ids=repr)
def test_few_or_coincident_or_collinear_points(partitioner):
    noise = np.eye(2)
    none = partitioner.partitions(np.empty((0, 2)), noise=noise, clutter_filter=tr.LocalOutlierFactor())
    assert none.labels.shape[1] == 0
    assert none.cells(0) == []
    assert partitioner.partitions([[1.0, 2.0]], noise=noise).labels[0].tolist() == [0]
    same = partitioner.partitions(np.full((50, 2), 3.0), noise=noise, clutter_filter=tr.LocalOutlierFactor())
    assert same.labels[-1].tolist() == [0] * 50
    line = partitioner.partitions(np.outer(np.arange(30.0), [1.0, 2.0]), noise=noise)
    assert line.labels.shape[1] == 30
    for labels in line.labels:
        assert np.array_equal(np.unique(labels), np.arange(labels.max() + 1))


@pytest.mark.parametrize("partitioner", ONE, ids=repr)
def test_one_partition_has_labels(partitioner):
    points = blobs(0)
    labels = partitioner.fit_predict(points, noise=np.eye(2))
    assert not labels.flags.writeable
    cells = sets(np.where(labels < 0, -1 - np.arange(len(labels)), labels))
    assert cells == sets(partitioner.partitions(points, noise=np.eye(2)).labels[0])
    assert len(partitioner.fit_predict(np.empty((0, 2)), noise=np.eye(2))) == 0


def test_outlier_factor_of_few_points():
    lof = tr.LocalOutlierFactor(10)
    assert lof.scores(np.empty((0, 2))).shape == (0,)
    assert lof.scores([[1.0, 2.0]]).tolist() == [1.0]
    assert lof.scores(np.zeros((40, 2))).tolist() == [1.0] * 40
    assert lof.scores([[0.0], [1.0], [3.0]]).shape == (3,)


POINTS = [[0.0, 0.0], [1.0, 0.0]]


@pytest.mark.parametrize(
    ("partitioner", "points", "noise", "error", "message"),
    [
        (tr.DbscanPartition(-1.0), POINTS, None, tr.ParameterError, "eps = -1"),
        (tr.DbscanPartition(np.nan), POINTS, None, tr.ParameterError, "eps = NaN"),
        (tr.DbscanPartition(), POINTS, None, tr.ParameterError, "eps = none is invalid: must be given"),
        (tr.DbscanPartition(1.0, 0), POINTS, None, tr.ParameterError, "min_samples = 0"),
        (tr.DbscanPartition(1.0, -3), POINTS, None, tr.ParameterError, "min_samples = -3"),
        (tr.DensityPeakPartition(d_c=0.0), POINTS, None, tr.ParameterError, "d_c = 0"),
        (tr.DensityPeakPartition(), POINTS, None, tr.ParameterError, "d_c = none"),
        (tr.DensityPeakPartition(1.0, 2.0), POINTS, None, tr.ParameterError, "percent = 2"),
        (tr.DensityPeakPartition(percent=0.0), POINTS, None, tr.ParameterError, "percent = 0"),
        (tr.DensityPeakPartition(1.0, peaks=0), POINTS, None, tr.ParameterError, "peaks = 0"),
        (tr.DensityPeakPartition(1.0, peaks="most"), POINTS, None, tr.ParameterError, 'peaks = "most"'),
        (tr.DensityPeakPartition(1.0, kernel="box"), POINTS, None, tr.ParameterError, 'kernel = "box"'),
        (tr.DensityPeakPartition(1.0, peak_distance=-1), POINTS, None, tr.ParameterError, "peak_distance = -1"),
        (tr.DensityPeakPartition(1.0, max_link=0), POINTS, None, tr.ParameterError, "max_link = 0"),
        (tr.TwoLevelPartition(1.0, beta=0.0), POINTS, None, tr.ParameterError, "beta = 0"),
        (tr.TwoLevelPartition(1.0, border="min"), POINTS, None, tr.ParameterError, 'border = "min"'),
        (tr.DistancePartition("both"), POINTS, None, tr.ParameterError, 'thresholds = "both"'),
        (tr.DistancePartition((2.0, 1.0)), POINTS, None, tr.ParameterError, "thresholds = 1"),
        (tr.DistancePartition(threshold=-1.0), POINTS, None, tr.ParameterError, "thresholds = -1"),
        (tr.DistancePartition(probabilities=(0.3, 1.0)), POINTS, None, tr.ParameterError, "probabilities = 1"),
        (tr.DistancePartition(detections_per_target=0.0), POINTS, None, tr.ParameterError, "detections_per_target = 0"),
        (tr.KMeansPartition(0), POINTS, None, tr.ParameterError, "k = 0"),
        (tr.KMeansPartition((3, 2)), POINTS, None, tr.ParameterError, "k = 2"),
        (tr.TreePartition([]), POINTS, None, tr.ParameterError, "linkages = none"),
        (tr.TreePartition("ward"), POINTS, None, tr.ParameterError, 'linkages = "ward"'),
        (tr.TreePartition(["median"]), POINTS, None, tr.ParameterError, 'linkages = "median"'),
        (tr.TreePartition(max_extent=0.0), POINTS, None, tr.ParameterError, "max_extent = 0"),
        (tr.TreePartition(), [[0.0, np.nan]], None, tr.NonFiniteError, "points is not finite at index 1"),
        (tr.TreePartition(), [[0.0, 1e200]], None, tr.ParameterError, "points = 1"),
        (tr.TreePartition(), [0.0, 1.0], None, tr.DimensionError, "points must have 2 dimensions"),
        (tr.TreePartition(), np.empty((3, 0)), None, tr.ParameterError, "points"),
        (tr.TreePartition(), POINTS, [[1.0]], tr.DimensionError, "noise has shape"),
        (tr.TreePartition(), POINTS, [[1.0, 0.0], [0.0, -1.0]], tr.NotPositiveDefiniteError, "noise is not positive"),
        (tr.TreePartition(), POINTS, np.zeros((2, 2)), tr.NotPositiveDefiniteError, "noise is not positive"),
        (tr.TreePartition(), POINTS, [[1.0, np.nan], [0.0, 1.0]], tr.NonFiniteError, "noise is not finite"),
        (tr.TreePartition(), POINTS, [[1.0, 0.5], [0.0, 1.0]], tr.ParameterError, "noise = the matrix"),
    ],
)
def test_mistakes_are_named(partitioner, points, noise, error, message):
    with pytest.raises(error) as found:
        partitioner.partitions(points, noise=noise)
    assert message in str(found.value)


def test_mistakes_of_outlier_factors_and_of_single_partitions():
    for lof, text in [
        (tr.LocalOutlierFactor(0), "n_neighbors = 0"),
        (tr.LocalOutlierFactor(2, -1.0), "threshold = -1"),
    ]:
        with pytest.raises(tr.ParameterError, match=text):
            lof.scores(POINTS)
        with pytest.raises(tr.ParameterError, match=text):
            tr.DbscanPartition(1.0).partitions(POINTS, clutter_filter=lof)
    with pytest.raises(tr.ParameterError, match="threshold = none"):
        tr.DistancePartition().fit_predict(POINTS)
    with pytest.raises(tr.ParameterError, match="k = a range"):
        tr.KMeansPartition().fit_predict(POINTS)


# --- many points -----------------------------------------------------------------------------------------------------


def peak_memory_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.mark.parametrize("same", [False, True])
def test_many_points_in_little_memory(same):
    """A matrix of the distances of 20 000 points would take 3.2 GB, one of bits 50 MB."""
    points = np.zeros((20_000, 2)) if same else np.random.default_rng(0).uniform(0, 2000, (20_000, 2))
    before = peak_memory_mb()
    assert len(tr.LocalOutlierFactor().scores(points)) == len(points)
    for partitioner in [
        tr.DbscanPartition(20.0),
        tr.DensityPeakPartition(percent=0.1),
        tr.TwoLevelPartition(d_c=10.0),
        tr.DistancePartition(threshold=10.0),
        tr.KMeansPartition(k=10),
    ]:
        labels = partitioner.fit_predict(points)
        assert len(labels) == len(points)
        assert not same or (labels == 0).all()
    assert peak_memory_mb() - before < 40


def test_too_many_labels_are_refused():
    points = np.random.default_rng(0).uniform(0, 1e4, (8000, 2))
    with pytest.raises(tr.ParameterError, match="too many labels"):
        tr.DistancePartition((0.0, 1e5)).partitions(points)
    with pytest.raises(tr.ParameterError, match="too many labels"):
        tr.TreePartition().partitions(points)
