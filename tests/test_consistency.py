"""What a filter says of its errors holds, on targets that move as it assumes."""

from __future__ import annotations

import numpy as np
import pytest

import trackrs as tr

RUNS = 200
JERK = 0.01  # on average these targets stay within the array's depth of view for the 160 s


def share_inside_band(statistics, dof):
    """Share of the epochs whose sum over the runs lies in its 99 % chi-square band; (runs, epochs) with NaN = none."""
    counts = np.sum(~np.isnan(statistics), axis=0)
    sums = np.nansum(statistics, axis=0)
    low, high = (np.array([tr.Gate(p).threshold(dof * n) if n else np.nan for n in counts]) for p in (0.005, 0.995))
    held = counts > 0
    return np.mean((sums[held] >= low[held]) & (sums[held] <= high[held]))


@pytest.mark.parametrize("name", ["bats", "toss"])
def test_innovations_and_errors_are_as_large_as_their_covariances(name):
    """NIS and NEES of self-started runs, averaged over the runs, epoch by epoch."""
    scene = tr.scenarios.underwater(name, jerk_std=JERK)
    ekf = tr.ExtendedKalmanFilter(tr.ConstantAcceleration(dims=3, jerk_std=JERK), scene.array)
    nis, nees = np.full((2, RUNS, len(scene.times)), np.nan)
    for k in range(RUNS):
        recording = scene.draw(11, run=k)
        run = ekf.run(recording.times, recording.values)
        after = slice(run.start + 1, None)
        nis[k, after] = run.nis[after]
        nees[k, run.start :] = tr.nees((run.means - recording.truth)[run.start :], run.covs[run.start :]).statistics
    assert share_inside_band(nis, scene.array.measurement_dim) >= 0.97
    assert share_inside_band(nees, 9) >= 0.97


@pytest.mark.parametrize("name", ["bats", "toss"])
@pytest.mark.parametrize("alpha", [0.01, 0.001])
def test_what_is_right_is_seldom_rejected(name, alpha):
    """False rejections stay below 1.5 alpha, with the recommended allowance and with none."""
    scene = tr.scenarios.underwater(name, jerk_std=JERK)
    for allowance in (None, 0.0):
        screen = tr.ChiSquareScreen(alpha=alpha, allowance=allowance)
        ekf = tr.ExtendedKalmanFilter(tr.ConstantAcceleration(dims=3, jerk_std=JERK), scene.array, screen=screen)
        rejected = tested = 0
        for k in range(RUNS):
            recording = scene.draw(11, run=k)
            run = ekf.run(recording.times, recording.values)
            verdicts = run.verdicts[run.start + 1 :]
            rejected += (verdicts == tr.Verdict.REJECTED).sum()
            tested += (verdicts != tr.Verdict.MISSING).sum()
        assert rejected / tested <= 1.5 * alpha
