"""Gates of many tracks and reports, against the definition."""

from __future__ import annotations

import numpy as np
import pytest

import trackrs as tr


def scene(dims, tracks=40, reports=90, side=25.0):
    rng = np.random.default_rng(dims)
    roots = rng.normal(size=(tracks, dims, dims))
    covs = roots @ roots.transpose(0, 2, 1) + np.eye(dims)
    return (
        rng.uniform(0, side, (tracks, dims)),
        (covs + covs.transpose(0, 2, 1)) / 2,
        rng.uniform(0, side, (reports, dims)),
    )


@pytest.mark.parametrize("dims", [1, 2, 3, 4, 6])
def test_distances_and_pairs_are_those_of_the_definition(dims):
    means, covs, reports = scene(dims)
    reports[5, 0] = np.nan
    difference = reports[None] - means[:, None]
    expected = np.einsum("tmi,tij,tmj->tm", difference, np.linalg.inv(covs), difference)
    found = tr.squared_distances(means, covs, reports)
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    gate = tr.Gate(0.999)
    pairs = gate.pairs(means, covs, reports)
    tracks, near = np.nonzero(found <= gate.threshold(dims))
    assert np.array_equal(pairs.tracks, tracks)
    assert np.array_equal(pairs.reports, near)
    assert np.array_equal(pairs.distances, found[tracks, near])
    assert len(pairs) == len(near)
    assert dims > 3 or len(near)
    assert not pairs.tracks.flags.writeable


def test_a_given_array_is_filled_and_returned():
    means, covs, reports = scene(2)
    out = np.empty((40, 90))
    assert tr.squared_distances(means, covs, reports, out=out) is out
    assert np.array_equal(out, tr.squared_distances(means, covs, reports))
    for bad in (np.empty((90, 40)), np.empty((40, 90), np.float32), np.empty((90, 40)).T, np.empty((40, 180))[:, ::2]):
        with pytest.raises(tr.DimensionError, match="out must be"):
            tr.squared_distances(means, covs, reports, out=bad)
    out.setflags(write=False)
    with pytest.raises(tr.DimensionError, match="writeable"):
        tr.squared_distances(means, covs, reports, out=out)


def test_nothing_is_a_case_too():
    means, covs, reports = scene(2)
    assert len(tr.Gate().pairs(means, covs, np.zeros((0, 2)))) == 0
    assert len(tr.Gate().pairs(np.zeros((0, 2)), np.zeros((0, 2, 2)), reports)) == 0
    assert tr.squared_distances(means, covs, np.zeros((0, 2))).shape == (40, 0)


def test_mistakes_are_named():
    means, covs, reports = scene(2)
    with pytest.raises(tr.DimensionError, match="columns of reports"):
        tr.Gate().pairs(means, covs, reports[:, :1])
    with pytest.raises(tr.DimensionError, match="covs"):
        tr.Gate().pairs(means, covs[:3], reports)
    with pytest.raises(tr.NotPositiveDefiniteError, match="covariance of track 2"):
        tr.Gate().pairs(means, np.where(np.arange(40)[:, None, None] == 2, -covs, covs), reports)
    with pytest.raises(tr.NonFiniteError, match="means"):
        tr.squared_distances(np.full((40, 2), np.nan), covs, reports)
