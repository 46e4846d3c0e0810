"""Shape sets of the density-peak literature. They are not part of the project: these run where `TRACKRS_DATA` says."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
import clustering_shapes

FOLDER = clustering_shapes.shapes_folder()


def test_adjusted_rand_index():
    truth = np.array([1, 1, 1, 2, 2, 2])
    assert clustering_shapes.adjusted_rand(np.array([4, 4, 4, 0, 0, 0]), truth) == 1.0
    # By hand: 2 pairs together in both, 3 and 6 in each, of 15.
    found = np.array([0, 0, 1, 1, 2, 2])
    assert clustering_shapes.adjusted_rand(found, truth) == pytest.approx((2 - 3 * 6 / 15) / ((3 + 6) / 2 - 3 * 6 / 15))


@pytest.mark.skipif(FOLDER is None, reason="TRACKRS_DATA does not say where clustering_shapes is")
@pytest.mark.parametrize("name", ["aggregation", "flame", "spiral", "r15"])
def test_density_peaks_find_the_shapes(name):
    points, truths = clustering_shapes.load(FOLDER, name)
    assert clustering_shapes.score(points, truths, peaks=None) >= 0.99
    if name in {"spiral", "r15"}:
        assert clustering_shapes.score(points, truths, peaks="gap") >= 0.99
