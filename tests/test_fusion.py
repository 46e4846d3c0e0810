"""Several arrays: stacked, one after the other, with uncertain survey, and tracks fused by covariance intersection."""

from __future__ import annotations

import numpy as np
import pytest

import trackrs as tr
from courses import BATS, TOSS, heard, jerk, manoeuvre
from trackrs import geodesy
from trackrs.config import load_config

PRESETS = {"bats": tr.RangeArray.bats(BATS), "toss": tr.RangeArray.toss(TOSS)}
STACKED = tr.RangeArray.stack(list(PRESETS.values()))
# Where the measurements of each array stand in those of the stack.
CHANNELS = {"bats": [0, 1, 2, 9], "toss": list(range(3, 9))}


def test_stack_is_the_arrays_one_after_the_other():
    state = [100.0, 200.0, 60.0]
    assert STACKED.labels == (*(f"range{i}" for i in range(9)), "depth")
    for name, channels in CHANNELS.items():
        np.testing.assert_array_equal(STACKED.observe(state)[channels], PRESETS[name].observe(state))
        np.testing.assert_array_equal(STACKED.noise()[np.ix_(channels, channels)], PRESETS[name].noise())
    fix = STACKED.fix(STACKED.observe(state))
    assert fix.dof == 7
    np.testing.assert_allclose(fix.position, state, atol=1e-6)
    # The side of a TOSS array is about the depth, which the stack measures.
    assert (STACKED.side, STACKED.depth_std, STACKED.survey_std) == (None, 0.3, None)
    assert tr.RangeArray.stack([PRESETS["toss"], PRESETS["toss"]]).side == "above"


def test_stack_of_travel_times():
    profile = [[0.0, 1525.0], [300.0, 1500.0]]
    same = [tr.RangeArray(rows, 1.0, sound_speed=profile, survey_std=0.5) for rows in (BATS, TOSS)]
    both = tr.RangeArray.stack(same)
    np.testing.assert_array_equal(both.sound_speed, profile)
    assert both.observe([10.0, 20.0, 30.0])[7] == same[1].observe([10.0, 20.0, 30.0])[4]
    np.testing.assert_array_equal(np.diagonal(both.noise())[3:], np.diagonal(same[1].noise()))
    mixed = tr.RangeArray.stack([tr.RangeArray(BATS, 1.0, sound_speed=c) for c in (1500.0, [1490.0, 1480.0, 1470.0])])
    np.testing.assert_array_equal(mixed.sound_speed, [1500.0] * 3 + [1490.0, 1480.0, 1470.0])
    uniform = tr.RangeArray.stack([tr.RangeArray(BATS, 1.0, sound_speed=1500.0)] * 2)
    assert uniform.sound_speed == 1500.0


def test_arrays_that_do_not_go_together_are_named():
    ranges, times = tr.RangeArray(BATS, 1.0), tr.RangeArray(BATS, 1.0, sound_speed=1500.0)
    with pytest.raises(tr.ParameterError, match="arrays = an empty list"):
        tr.RangeArray.stack([])
    with pytest.raises(tr.ParameterError, match="all measure ranges or all travel times"):
        tr.RangeArray.stack([ranges, times])
    with pytest.raises(tr.DimensionError, match="dimensions of array 1 has size 2, expected 3"):
        tr.RangeArray.stack([ranges, tr.RangeArray(BATS[:, :2], 1.0)])
    with pytest.raises(tr.ParameterError, match="side"):
        tr.RangeArray.stack([PRESETS["toss"], tr.RangeArray(TOSS, 1.0, side="below")])


def test_array_by_array_is_the_stack_for_linear_sensors():
    rng = np.random.default_rng(1)
    h = rng.normal(size=(7, 4))
    sensor = tr.LinearSensor(h, np.diag(rng.uniform(0.5, 2.0, 7)))
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.3), sensor)
    start = tr.GaussianState(rng.normal(size=4), np.diag([4.0, 9.0, 1.0, 2.0]), 0.0)
    times, values = np.arange(1.0, 31.0), 5.0 * rng.normal(size=(30, 7))
    stacked = kf.run(times, values, initial=start)
    rows = np.full((30, 2, 7), np.nan)
    rows[:, 0, :3], rows[:, 1, 3:] = values[:, :3], values[:, 3:]
    apart = kf.run(np.repeat(times, 2), rows.reshape(60, 7), initial=start)
    np.testing.assert_allclose(apart.means[1::2], stacked.means, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(apart.covs[1::2], stacked.covs, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(apart.nis.reshape(30, 2).sum(axis=1), stacked.nis, rtol=1e-11)


def test_array_by_array_tracks_as_the_stack_does():
    """Ranges are linearised anew after every row: close, not equal."""
    rng = np.random.default_rng(2)
    times, path, _ = manoeuvre()
    values = heard(STACKED, path, rng)
    ekf = tr.ExtendedKalmanFilter(jerk(), STACKED)
    stacked = ekf.run(times, values)
    rows = np.full((len(times), 2, 10), np.nan)
    for slot, channels in enumerate(CHANNELS.values()):
        rows[:, slot, channels] = values[:, channels]
    after = stacked.start + 1
    apart = ekf.run(np.repeat(times[after:], 2), rows[after:].reshape(-1, 10), initial=stacked[stacked.start])
    difference = (apart.means[1::2] - stacked.means[after:]) / np.sqrt(np.diagonal(stacked.covs[after:], 0, 1, 2))
    assert 0.0 < np.abs(difference).max() < 0.1


def test_stacked_is_best_and_intersection_is_consistent():
    """BATS and TOSS on the reference course with 2 % gross errors: stacked < covariance intersection < single.

    The independent reference has .85, .98 and 1.53 m without restarts, and NEES .78 of the intersection.
    """
    rng = np.random.default_rng(3)
    times, path, _ = manoeuvre()
    sensors = {**PRESETS, "stacked": STACKED}
    screen = tr.ChiSquareScreen(alpha=0.01)
    filters = {name: tr.ExtendedKalmanFilter(jerk(), sensor, screen=screen) for name, sensor in sensors.items()}
    channels = {**CHANNELS, "stacked": list(range(10))}
    rms = {name: [] for name in (*filters, "intersection")}
    nees = []
    for _ in range(20):
        values = heard(STACKED, path, rng)
        gross = rng.random((len(times), 9)) < 0.02
        gross[:3] = False
        values[:, :9] += gross * rng.choice([-1.0, 1.0], gross.shape) * rng.uniform(10.0, 100.0, gross.shape)
        runs = {name: f.run(times, values[:, channels[name]], history="filtered") for name, f in filters.items()}
        late = range(13, len(times))
        fused = [tr.covariance_intersection([runs["bats"][k], runs["toss"][k]]) for k in late]
        for name, run in runs.items():
            rms[name].append(tr.rmse(run.means[13:, :3] - path[13:]))
        errors = np.array([state.mean[:3] for state in fused]) - path[13:]
        rms["intersection"].append(tr.rmse(errors))
        nees.append(tr.nees(errors, [state.cov[:3, :3] for state in fused]).statistics.mean() / 3)
    mean = {name: np.mean(values) for name, values in rms.items()}
    assert mean["stacked"] < mean["intersection"] < min(mean["bats"], mean["toss"])
    # Paired over the runs, by more than its error.
    gain = np.array(rms["intersection"]) - rms["stacked"]
    assert gain.mean() > 3.0 * gain.std() / np.sqrt(len(gain))
    assert mean["stacked"] < 0.86
    assert np.mean(nees) <= 1.0


def test_survey_error_is_not_taken_for_gross_errors():
    """One array 3 m out of place: with `survey_std` the data are kept and the error is smaller, by a third here."""
    rng = np.random.default_rng(4)
    times, path, _ = manoeuvre()
    screen = tr.ChiSquareScreen(alpha=0.01)
    shift = np.array([3.0, 0.0, 0.0])
    true = tr.RangeArray.stack([tr.RangeArray.bats(BATS + shift), PRESETS["toss"]])
    honest = tr.RangeArray.stack([tr.RangeArray.bats(BATS, survey_std=3.0), PRESETS["toss"]])
    rejected, rms = {"exact": [], "honest": []}, {"exact": [], "honest": []}
    for _ in range(8):
        values = heard(true, path, rng)
        for name, sensor in (("exact", STACKED), ("honest", honest)):
            run = tr.ExtendedKalmanFilter(jerk(), sensor, screen=screen).run(times, values, history="filtered")
            rejected[name].append(np.mean(run.verdicts[13:, :3] == tr.Verdict.REJECTED))
            rms[name].append(tr.rmse(run.means[13:, :3] - path[13:]))
    assert np.mean(rejected["honest"]) < 0.01 < np.mean(rejected["exact"])
    assert np.mean(rms["honest"]) < 0.75 * np.mean(rms["exact"])


def test_survey_std_from_a_placement(tmp_path):
    origin = [0.95, 0.18, 0.0]
    elements = np.array([[0.0, 0.0, 0.0], [900.0, 0.0, 5.0], [0.0, 800.0, 5.0], [400.0, 300.0, 20.0]])
    fixes = geodesy.LocalFrame(origin).to_geodetic(elements + np.array([10.0, 20.0, 30.0]))
    placed = geodesy.place_array(elements, fixes, [0.5, 0.5, 1.5], origin)
    largest = np.sqrt(np.linalg.eigvalsh(placed.covs)[:, -1])
    np.testing.assert_allclose(placed.survey_std, largest, rtol=1e-12)
    array = tr.RangeArray(placed.positions, range_std=1.0, survey_std=placed.survey_std)
    np.testing.assert_allclose(np.diagonal(array.noise()), 1.0 + largest**2, rtol=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        array.survey_std[0] = 0.0
    for bad, kind in (([1.0, 2.0], tr.DimensionError), (-1.0, tr.ParameterError), (np.eye(4), tr.DimensionError)):
        with pytest.raises(kind, match="survey_std"):
            tr.RangeArray(placed.positions, range_std=1.0, survey_std=bad)
    file = tmp_path / "sonar.toml"
    file.write_text("""
[motion]
type = "random_walk"
dims = 3
velocity_psd = 0.3

[sensors.array]
type = "range_array"
hydrophones = [[0, 0, 250], [1000, 0, 252], [500, 866, 248]]
range_std = 3.0
survey_std = [4.0, 0.0, 4.0]
columns = ["a", "b", "c"]

[tracker]
initiator = {m = 2, n = 3, max_speed = 12}
""")
    np.testing.assert_array_equal(np.diagonal(load_config(file).sensors["array"].noise()), [25.0, 9.0, 25.0])


def random_state(rng, n=4, time=0.0):
    root = rng.normal(size=(n, n))
    return tr.GaussianState(rng.normal(size=n), root @ root.T + 0.1 * np.eye(n), time)


@pytest.mark.parametrize("criterion", ["trace", "determinant"])
def test_intersection_of_two_against_a_fine_search(criterion):
    rng = np.random.default_rng(5)
    for _ in range(20):
        a, b = random_state(rng), random_state(rng)
        y, z = np.linalg.inv(a.cov), np.linalg.inv(b.cov)

        def cost(cov):
            return np.trace(cov) if criterion == "trace" else np.linalg.slogdet(cov)[1]

        costs = [cost(np.linalg.inv(w * y + (1.0 - w) * z)) for w in np.linspace(0.0, 1.0, 2001)]
        out = tr.covariance_intersection([a, b], criterion=criterion)
        assert cost(out.cov) == pytest.approx(min(costs), rel=1e-5, abs=1e-5)
        assert cost(out.cov) <= min(costs) + 1e-10
        # The mean by its definition, with the weight that the covariance implies.
        weight = np.argmin(costs) / 2000.0
        given = tr.covariance_intersection([a, b], [weight, 1.0 - weight])
        mean = given.cov @ (weight * y @ a.mean + (1.0 - weight) * z @ b.mean)
        np.testing.assert_allclose(given.mean, mean, atol=1e-10)
        np.testing.assert_allclose(out.mean, given.mean, atol=0.02)


def test_intersection_names_what_is_wrong():
    rng = np.random.default_rng(6)
    with pytest.raises(tr.TimeError, match=r"different times, 1\.0 s and 2\.5 s"):
        tr.covariance_intersection([random_state(rng, time=1.0), random_state(rng, time=2.5)])
    with pytest.raises(tr.ParameterError, match="states = an empty list"):
        tr.covariance_intersection([])
    with pytest.raises(tr.ParameterError, match="weights"):
        tr.covariance_intersection([random_state(rng)] * 2, [0.5, 0.6])
    with pytest.raises(tr.ParameterError, match="criterion = volume"):
        tr.covariance_intersection([random_state(rng)], criterion="volume")
    with pytest.raises(tr.NotPositiveDefiniteError, match="covariance of state 1"):
        tr.covariance_intersection([random_state(rng, 2), tr.GaussianState([0.0, 0.0], np.zeros((2, 2)))])
    assert tr.covariance_intersection([random_state(rng, time=7.0)] * 2).time == 7.0
