"""Statistics of innovations: one by one, summed, over time; and the starting values that decide the first of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import trackrs as tr
from courses import BATS, heard, jerk, manoeuvre

DATA = Path(__file__).parent / "data"


def linear_run(rng, accel_std=1.0, steps=200, gaps=0.0):
    """A run on truth with `accel_std` 1, consistent if the filter has the same."""
    transition, gain = np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(2)), np.kron([[0.5], [1.0]], np.eye(2))
    states = [rng.normal(size=4)]
    for _ in range(steps - 1):
        states.append(transition @ states[-1] + gain @ rng.normal(size=2))
    values = np.array(states)[:, :2] + rng.normal(size=(steps, 2))
    values[rng.random(values.shape) < gaps] = np.nan
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=2, accel_std=accel_std), tr.PositionSensor(dims=2, std=1.0))
    return kf.run(np.arange(steps), values, initial=tr.GaussianState(np.zeros(4), np.eye(4)))


def test_rank_deficient_golden():
    golden = json.loads((DATA / "chi2_rank_deficient.json").read_text())
    tests = tr.nis([golden["r"]], [golden["D"]])
    assert tests.statistics[0] == pytest.approx(golden["expected"], rel=1e-9)
    assert tests.dof[0] == golden["rank"]
    assert tests.p_values[0] == pytest.approx(stats.chi2.sf(golden["expected"], golden["rank"]), rel=1e-9)


def test_nis_of_a_run_and_nees_agree_with_the_definition():
    run = linear_run(np.random.default_rng(1), gaps=0.2)
    tests = tr.nis(run.innovations, run.innovation_covs)
    np.testing.assert_allclose(tests.statistics, run.nis, rtol=1e-12)
    np.testing.assert_array_equal(tests.dof, run.dof)
    seen = run.dof > 0
    np.testing.assert_allclose(tests.p_values[seen], stats.chi2.sf(run.nis[seen], run.dof[seen]), rtol=1e-9)
    assert np.isnan(tests.p_values[~seen]).all()
    assert (~seen).any()
    whole = tr.nees(run.means, run.covs)
    expected = [m @ np.linalg.solve(p, m) for m, p in zip(run.means, run.covs, strict=True)]
    np.testing.assert_allclose(whole.statistics, expected, rtol=1e-9)
    assert set(whole.dof) == {4}
    with pytest.raises(ValueError, match="read-only"):
        tests.p_values[0] = 0.0


def test_nis_outside_the_range_of_a_singular_covariance():
    cov = [[1.0, 1.0], [1.0, 1.0]]
    tests = tr.nis([[2.0, 2.0], [2.0, -2.0], [2.0, np.nan]], [cov] * 3)
    assert tests.statistics[0] == pytest.approx(4.0)
    assert (tests.statistics[1], tests.p_values[1]) == (np.inf, 0.0)
    assert tests.statistics[2] == pytest.approx(4.0)
    assert tests.dof.tolist() == [1, 1, 1]
    with pytest.raises(tr.ParameterError, match=r"covariance 0.*semidefinite"):
        tr.nis([[1.0, 1.0]], [[[1.0, 2.0], [2.0, 1.0]]])
    with pytest.raises(tr.DimensionError, match="covariances"):
        tr.nis([[1.0, 1.0]], [cov] * 2)


def test_cumulative_sums():
    run = linear_run(np.random.default_rng(2), gaps=0.5)
    filled = np.flatnonzero(run.dof > 0)
    for window in (1, 10, None):
        tests = run.cumulative_test(window)
        for row in (filled[0], 37, 100, 199):
            rows = filled[filled <= row][-(window or 1000) :]
            assert tests.statistics[row] == pytest.approx(run.nis[rows].sum(), rel=1e-12)
            assert tests.dof[row] == run.dof[rows].sum()
            assert tests.p_values[row] == pytest.approx(stats.chi2.sf(tests.statistics[row], tests.dof[row]), rel=1e-9)
    for bad in (0, -3, 2.5, "ten"):
        with pytest.raises(tr.ParameterError, match="window = "):
            run.cumulative_test(bad)


def test_cumulative_test_begins_anew_at_restarts():
    rng = np.random.default_rng(3)
    times, path, _ = manoeuvre()
    array = tr.RangeArray.bats(BATS)
    values = heard(array, path, rng)
    values[60:] = heard(array, path[60:] + np.array([300.0, 0.0, 0.0]), rng)  # the target is elsewhere all at once
    run = tr.ExtendedKalmanFilter(jerk(), array, screen=tr.ChiSquareScreen(alpha=0.01)).run(times, values)
    (restart,) = run.restarts
    tests = run.cumulative_test(10)
    assert np.isnan(tests.statistics[: run.start + 1]).all()
    assert np.isnan(tests.p_values[restart])
    assert tests.dof[restart + 1] == run.dof[restart + 1]
    assert run.whiteness(5).dof == 5 * 16


# Probability of alarm at alpha = 0.01, BATS array, in the independent reference: one test at the onset, and the sums of
# the 3, 10 and 20 measurements from it.
REFERENCE = {("spike", 5.0): (0.84, 0.77, 0.48, 0.27), ("bias", 3.0): (0.29, 0.43, 0.79, 0.86)}


@pytest.mark.parametrize(("kind", "size"), REFERENCE)
def test_single_test_finds_spikes_and_the_sum_finds_biases(kind, size):
    """Alarm rates by simulation against the noncentral chi-square distribution and against the reference.

    The reference says nothing of the place of the target. Here it passes through the array; there all its cells hold to
    0.03 by the noncentral distribution, and that is allowed besides 3.5 Monte-Carlo standard deviations.
    """
    rng = np.random.default_rng(4)
    runs, onset, windows = 400, 25, (1, 3, 10, 20)
    ekf = tr.ExtendedKalmanFilter(jerk(0.03), tr.RangeArray.bats(BATS))
    first = np.array([100.0, 50.0, 60.0, 12.0, 8.8, 1.5, 0.0, 0.0, 0.0])
    spread = np.diag([2.0] * 3 + [4.0] * 3 + [1.0] * 3)
    step = ekf.motion.transition(1.0)
    gain = np.kron([[1.0 / 6.0], [0.5], [1.0]], np.eye(3))
    times = np.arange(onset + windows[-1])
    alarms, power = np.zeros((runs, 4)), np.zeros((runs, 4))
    for k in range(runs):
        states = [first]
        for _ in times[1:]:
            states.append(step @ states[-1] + 0.03 * gain @ rng.normal(size=3))
        values = heard(ekf.sensor, np.array(states)[:, :3], rng)
        start = tr.GaussianState(rng.multivariate_normal(first, spread), spread)
        good = ekf.run(times, values, initial=start, history="filtered")
        values[onset : onset + 1 if kind == "spike" else None, 0] += size
        run = ekf.run(times, values, initial=start, history="filtered")
        shift = tr.nis(run.innovations - good.innovations, run.innovation_covs).statistics[onset:]
        for j, window in enumerate(windows):
            alarms[k, j] = run.cumulative_test(window).p_values[onset + window - 1] < 0.01
            limit = stats.chi2.isf(0.01, 4 * window)
            power[k, j] = stats.ncx2.sf(limit, 4 * window, shift[:window].sum())
    rate = alarms.mean(axis=0)
    error = np.sqrt(rate * (1.0 - rate) / runs)
    assert (np.abs(rate - power.mean(axis=0)) < 3.5 * error).all()
    assert (np.abs(rate - REFERENCE[kind, size]) < 3.5 * error + 0.03).all()


@pytest.mark.parametrize("gaps", [0.0, 0.2])
def test_whiteness_holds_its_level(gaps):
    rng = np.random.default_rng(5)
    found = [linear_run(rng, gaps=gaps).whiteness(10) for _ in range(300)]
    assert {w.dof for w in found} == {40}
    # Kolmogorov's band at 1 %.
    assert stats.kstest([w.p_value for w in found], "uniform").statistic < 1.63 / np.sqrt(300)
    inside = np.mean([np.abs(w.autocorrelations) < w.bands for w in found])
    assert inside == pytest.approx(0.95, abs=3.5 * np.sqrt(0.95 * 0.05 / (300 * 20)))


def test_whiteness_finds_a_wrong_motion_noise_and_its_sign():
    rng = np.random.default_rng(6)
    for accel_std, sign in ((0.3, 1.0), (4.0, -1.0)):
        found = [linear_run(rng, accel_std).whiteness(5) for _ in range(20)]
        assert max(w.p_value for w in found) < 1e-3
        assert sign * np.mean([w.autocorrelations[0] for w in found]) > 0.1
    run = linear_run(rng)
    direct = tr.whiteness(run.innovations, run.innovation_covs, 10)
    assert direct.p_value == run.whiteness().p_value
    assert direct.autocorrelations.shape == direct.bands.shape == (10, 2)
    for lags in (0, 200, 1.5):
        with pytest.raises(tr.ParameterError, match="lags = "):
            run.whiteness(lags)


def fixes_of(golden):
    array = tr.RangeArray.bats(golden["phones"], range_std=1.0, depth_std=0.3)
    return [array.fix(z) for z in golden["L"][:3]]


def test_start_state_golden():
    golden = json.loads((DATA / "underwater_bats_kf.json").read_text())
    fixes, init = fixes_of(golden), golden["init"]
    start = tr.start_state(golden["time"][:3], fixes)
    np.testing.assert_allclose(start.mean, init["x0"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(start.cov, init["D0"], rtol=1e-9, atol=1e-9)
    assert start.time == golden["time"][2]
    paper = tr.start_state(golden["time"][:3], fixes, rule="paper", velocity_std=2.0, accel_std=1.0)
    np.testing.assert_allclose(paper.mean, init["x0_paper_literal"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(paper.cov[:3, :3], init["fix_cov"][2], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(paper.cov[3:, 3:], np.diag([4.0] * 3 + [1.0] * 3))
    assert not paper.cov[:3, 3:].any()


def test_start_state_is_what_a_run_starts_with():
    golden = json.loads((DATA / "underwater_bats_kf.json").read_text())
    ekf = tr.ExtendedKalmanFilter(jerk(), tr.RangeArray.bats(golden["phones"]))
    run = ekf.run(golden["time"], golden["L"])
    assert run.start == 2
    start = tr.start_state(golden["time"][:3], fixes_of(golden), motion=jerk())
    np.testing.assert_array_equal(run.means[2], start.mean)
    np.testing.assert_array_equal(run.covs[2], start.cov)
    two = tr.start_state(golden["time"][1:3], fixes_of(golden)[1:], order=2)
    np.testing.assert_allclose(two.mean[3:], np.subtract(*[golden["init"]["fix"][i] for i in (2, 1)]), rtol=1e-9)


def test_the_rule_of_the_paper_makes_the_first_innovations_too_large():
    """Chi-square per component of the first five innovations, straight course: 1.63 and 0.99 in the reference."""
    rng = np.random.default_rng(7)
    times, path, _ = manoeuvre()
    array = tr.RangeArray.bats(BATS)
    ekf = tr.ExtendedKalmanFilter(jerk(), array)
    rules = {"polynomial": {}, "paper": {"velocity_std": 2.0, "accel_std": 1.0}}
    sums = {rule: [] for rule in rules}
    for _ in range(250):
        values = heard(array, path[:8], rng)
        fixes = [array.fix(z) for z in values[:3]]
        for rule, stds in rules.items():
            start = tr.start_state(times[:3], fixes, rule=rule, **stds)
            run = ekf.run(times[3:8], values[3:8], initial=start)
            sums[rule].append(run.nis.sum() / run.dof.sum())
    error = {rule: np.std(values) / np.sqrt(len(values)) for rule, values in sums.items()}
    assert np.mean(sums["polynomial"]) == pytest.approx(0.99, abs=3.0 * error["polynomial"])
    assert np.mean(sums["paper"]) == pytest.approx(1.63, abs=3.0 * error["paper"])


def test_start_state_names_what_is_wrong():
    fixes = fixes_of(json.loads((DATA / "underwater_bats_kf.json").read_text()))
    with pytest.raises(tr.ParameterError, match='rule = "paper" is invalid: needs velocity_std= and accel_std='):
        tr.start_state([0.0, 1.0, 2.0], fixes, rule="paper", velocity_std=2.0)
    with pytest.raises(tr.ParameterError, match='belong to rule="paper"'):
        tr.start_state([0.0, 1.0, 2.0], fixes, velocity_std=2.0)
    with pytest.raises(tr.ParameterError, match="rule = quadratic"):
        tr.start_state([0.0, 1.0, 2.0], fixes, rule="quadratic")
    with pytest.raises(tr.DimensionError, match="times has size 2, expected 3"):
        tr.start_state([0.0, 1.0], fixes)
    with pytest.raises(tr.DimensionError, match="fixes has size 3, expected 2"):
        tr.start_state([0.0, 1.0, 2.0], fixes, order=2)
    with pytest.raises(tr.TimeError):
        tr.start_state([0.0, 2.0, 1.0], fixes)
