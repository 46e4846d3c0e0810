"""Filters of states with an attitude: quaternions and image points in, quaternions and honest covariances out."""

import numpy as np
import pytest

import trackrs as tr
from trackrs import rotation

POINTS = [[0.1, 0.0, 0.0], [-0.1, 0.1, 0.02], [0.0, -0.1, 0.05], [-0.1, -0.05, -0.04], [0.05, 0.08, 0.03]]
FILTERS = [tr.ExtendedKalmanFilter, tr.UnscentedKalmanFilter, tr.CubatureKalmanFilter]


def motion():
    return tr.ConstantVelocity(dims=6, accel_psd=[1e-2, 1e-2, 1e-2, 0.5, 0.5, 0.5])


def head(**changes):
    return tr.PoseSensor(**{"position_std": 1e-3, "angle_std": 5e-3, "attitude": "quaternion"} | changes)


def turning_body(count, rng, dt=0.02, pace=1.0):
    """Return times and states of the motion above, from a random start; `pace` scales the first rates."""
    space = slice(3, 6)
    state = np.r_[0.0, 0.0, 1.5, rng.normal(size=3), 0.1 * rng.normal(size=3), pace * rng.normal(size=3)]
    root = np.linalg.cholesky(motion().noise(dt))
    states = []
    for _ in range(count):
        y = motion().transition(dt) @ np.r_[state[:3], np.zeros(3), state[6:]] + root @ rng.normal(size=12)
        y[space] = rotation.turned(state[space], y[space])
        state = y
        states.append(state)
    return dt * np.arange(count), np.array(states)


def reports(sensor, states, rng):
    z = states[:, :6] + np.sqrt(np.diag(sensor.noise())) * rng.normal(size=(len(states), 6))
    z[:, 3:] = rotation.turned(states[:, 3:6], z[:, 3:] - states[:, 3:6])
    return np.c_[z[:, :3], rotation.quaternions_from_vectors(z[:, 3:])]


@pytest.mark.parametrize("form", ["joseph", "square_root"])
@pytest.mark.parametrize("kind", FILTERS)
def test_estimates_are_better_than_reports_and_honest(kind, form):
    sensor, rng = head(), np.random.default_rng(4)
    ukf = kind(motion(), sensor, form=form)
    assert ukf.labels == ("x", "y", "z", "rx", "ry", "rz", "vx", "vy", "vz", "wx", "wy", "wz")
    nees, better = [], []
    for _ in range(40):
        times, states = turning_body(60, rng)
        values = reports(sensor, states, rng)
        run = ukf.run(times, values)
        assert (run.start, run.attitude) == (2, 3)
        assert np.isnan(run.attitudes[:2]).all()
        np.testing.assert_allclose(np.linalg.norm(run.attitudes[2:], axis=1), 1.0, atol=1e-12)
        nees.append(tr.nees(run.errors(states)[-1:], run.covs[-1:]).statistics[0])
        smoothed = run.smooth()
        reported = rotation.between(states[:, 3:6], sensor.measurements(values)[:, 3:])
        errors = [reported, run.errors(states)[:, 3:6], smoothed.errors(states)[:, 3:6]]
        better.append([np.mean(e[10:-10] ** 2) for e in errors])
        np.testing.assert_allclose(smoothed.attitudes[-1], run.attitudes[-1])
    low, high = (tr.Gate(p).threshold(12 * 40) / 40 for p in (0.005, 0.995))
    assert low < np.mean(nees) < high
    raw, filtered, smooth = np.mean(better, axis=0)
    assert smooth < 0.7 * filtered < 0.7 * raw


def test_quaternions_of_either_sign_are_the_same_report():
    rng = np.random.default_rng(1)
    times, states = turning_body(100, rng, pace=3.0)
    values = reports(head(), states, rng)
    flipped = values.copy()
    flipped[:, 3:] *= rng.choice([-1.0, 1.0], 100)[:, None]
    ekf = tr.ExtendedKalmanFilter(motion(), head())
    run, same = ekf.run(times, values), ekf.run(times, flipped)
    np.testing.assert_array_equal(run.means, same.means)
    np.testing.assert_array_equal(run.attitudes, same.attitudes)
    state = run[50]
    update = ekf.update(state, values[51])
    again = ekf.update(state, np.r_[values[51, :3], -values[51, 3:]])
    np.testing.assert_array_equal(update.posterior.mean, again.posterior.mean)


def test_reports_that_are_no_poses_are_refused_by_row():
    times, states = turning_body(6, np.random.default_rng(2))
    values = reports(head(), states, np.random.default_rng(3))
    ekf = tr.ExtendedKalmanFilter(motion(), head())
    for bad, norm in ([0.0, 0, 0, 0], "norm 0"), ([1.0, 0.2, 0, 0], "norm 1.01"):
        values[4, 3:] = bad
        with pytest.raises(tr.ParameterError, match=f"quaternion of row 4 = .*{norm}"):
            ekf.run(times, values)
        with pytest.raises(tr.ParameterError, match=f"quaternion of row 0 = .*{norm}"):
            ekf.update(tr.GaussianState(states[0], np.eye(12)), values[4])
    with pytest.raises(tr.DimensionError, match="report of the PoseSensor has size 6, expected 7"):
        ekf.run(times, values[:, :6])
    values[4, 3:] = np.nan
    assert ekf.run(times, values).dof[4] == 3
    values[4, 3:] = [np.inf, 0, 0, np.nan]
    with pytest.raises(tr.NonFiniteError):
        ekf.run(times, values)
    with pytest.raises(tr.ParameterError, match="use ExtendedKalmanFilter"):
        tr.KalmanFilter(motion(), head())
    with pytest.raises(tr.DimensionError, match="position"):
        tr.ExtendedKalmanFilter(tr.ConstantVelocity(3, accel_psd=1.0), head())
    straight = tr.KalmanFilter(tr.RandomWalk(1, velocity_psd=1.0), tr.PositionSensor(1, std=1.0))
    with pytest.raises(tr.ParameterError, match="the state x has no attitude"):
        _ = straight.run([0.0, 1.0, 2.0], [[0.0], [0.0], [0.0]]).attitudes
    with pytest.raises(tr.DimensionError, match="truth"):
        ekf.run(times, reports(head(), states, np.random.default_rng(3))).errors(states[1:])


@pytest.mark.parametrize("kind", FILTERS)
def test_a_camera_filter_takes_image_points(kind):
    camera = tr.CameraSensor(POINTS, intrinsics=(1000, 1000, 640, 480), pixel_std=0.3)
    rng = np.random.default_rng(8)
    times, states = turning_body(80, rng)
    values = np.array([camera.observe(state) for state in states]) + 0.3 * rng.normal(size=(80, 10))
    values[20:, 4:8] = np.nan
    ckf = kind(motion(), camera)
    run = ckf.run(times, values)
    assert run.start == 2
    assert run.dof[30] == 6
    nees = tr.nees(run.errors(states)[10:], run.covs[10:]).statistics
    # Chi-square of 12 degrees of freedom is above 52 once in 2 million.
    assert nees.max() < 52.0
    assert run.attitudes.shape == (80, 4)


def test_predictions_ahead_and_their_curve():
    rng = np.random.default_rng(6)
    times, states = turning_body(300, rng)
    values = reports(head(), states, rng)
    ukf = tr.UnscentedKalmanFilter(motion(), head())
    run = ukf.run(times, values, lead=0.06)
    ahead = rotation.between(states[13:, 3:6], run.lead_means[10:-3, 3:6])
    held = rotation.between(states[13:, 3:6], states[10:-3, 3:6])
    assert np.sqrt((ahead**2).mean()) < 0.7 * np.sqrt((held**2).mean())
    truth = np.c_[states[:, :3], rotation.quaternions_from_vectors(states[:, 3:6])]
    curve = tr.lead_curve(ukf, times, values, [0.0, 0.06], truth=(times, truth), skip=10)
    np.testing.assert_allclose(curve.rms[1, 3:], np.sqrt((ahead**2).mean(axis=0)), rtol=1e-6)
    assert (curve.rms[0] < curve.rms[1]).all()
    # Between samples the recorded attitudes are joined by turns at a constant rate.
    spin = np.c_[np.zeros((50, 2)), 0.3 * np.arange(50)]
    quaternions = rotation.quaternions_from_vectors(spin)
    turning = tr.ExtendedKalmanFilter(tr.ConstantVelocity(3, accel_psd=1e-6), tr.PoseSensor(angle_std=1e-3))
    curve = tr.lead_curve(turning, np.arange(50.0), quaternions, [0.5], skip=3)
    assert curve.rms.max() < 1e-6


def test_a_jump_starts_anew_and_noise_is_found():
    rng = np.random.default_rng(9)
    times, states = turning_body(400, rng)
    values = reports(head(), states, rng)
    screened = tr.ExtendedKalmanFilter(motion(), head(), screen=tr.ChiSquareScreen())
    jumped = values.copy()
    turn = np.tile([0.0, 0.9, 0.0], (200, 1))
    moved = rotation.turned(rotation.vectors_from_quaternions(values[200:, 3:]), turn)
    jumped[200:, 3:] = rotation.quaternions_from_vectors(moved)
    jumped[200:, 0] += 0.4
    # Gross errors that do not agree with one another start nothing.
    jumped[50:54, :3] += 3.0 * rng.normal(size=(4, 3))
    run = screened.run(times, jumped)
    assert [row for row in run.restarts if row < 200] == []
    assert 202 <= run.restarts[0] <= 206
    truth = states.copy()
    truth[200:, 3:6] = rotation.turned(states[200:, 3:6], turn)
    truth[200:, 0] += 0.4
    assert np.abs(run.errors(truth)[220:, :6]).max() < 0.03
    assert np.isfinite(run.smooth().covs[run.start :]).all()
    rule = tr.LimitedMemoryNoise(window=150, q_limits=(1e-4, 1e2), r_limits=(1e-8, 1.0))
    adaptive = tr.ExtendedKalmanFilter(motion(), head(angle_std=2e-2), adapt=rule).run(times, values)
    found = np.sqrt(np.diagonal(adaptive.r_hat[-1]))
    np.testing.assert_allclose(found[3:], 5e-3, rtol=0.3)


def test_runs_of_positions_and_angles_start_themselves():
    rng = np.random.default_rng(5)
    times = np.sort(rng.uniform(0, 2, 40))
    kf = tr.KalmanFilter(tr.ConstantAcceleration(dims=2, jerk_psd=1.0), tr.PositionSensor(2, std=0.01))
    path = np.c_[times**2, 3.0 - times]
    run = kf.run(times, path + 0.01 * rng.normal(size=path.shape))
    assert run.start == 2
    assert np.abs(run.means[-1] - [times[-1] ** 2, 3 - times[-1], 2 * times[-1], -1, 2, 0]).max() < 1.0
    euler = tr.KalmanFilter(tr.ConstantVelocity(3, accel_psd=1e-3), tr.PoseSensor(angle_std=1e-3, attitude="euler"))
    angles = np.pi - 0.2 + 0.5 * times[:, None] * [1.0, 0.0, 0.0] + [0.0, 0.1, 0.2]
    run = euler.run(times, np.angle(np.exp(1j * angles)))
    np.testing.assert_allclose(run.means[2:, 3], 0.5, atol=1e-9)
    # From afar the two attitudes of a plane look alike.
    cross = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [-0.1, 0, 0], [0, -0.1, 0]]
    camera = tr.CameraSensor(cross, intrinsics=(1000, 1000, 640, 480), pixel_std=1.0)
    image = camera.observe([0.0, 0.0, 8.0, 0.3, 0.0, 0.0])
    with pytest.raises(tr.UnobservableError, match="two attitudes"):
        tr.ExtendedKalmanFilter(motion(), camera).run(np.arange(5.0), np.tile(image, (5, 1)))
