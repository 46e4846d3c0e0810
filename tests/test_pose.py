"""Poses: Singer's motion, rotations, the pose sensor, the camera, and stamps that jitter about a fixed rate."""

from __future__ import annotations

import numpy as np
import pytest

import trackrs as tr
from trackrs.config import ConfigError, load_config

CROSS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [-0.1, 0, 0], [0, -0.1, 0]])


def cross_matrix(v):
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def matrix(v):
    """exp of the cross matrix, by its series."""
    term, total = np.eye(3), np.eye(3)
    for k in range(1, 60):
        term = term @ cross_matrix(v) / k
        total += term
    return total


def matrix_of_quaternion(q):
    w, v = q[0], cross_matrix(q[1:])
    return np.eye(3) + 2 * w * v + 2 * v @ v


# --- Singer ----------------------------------------------------------------------------------------------------------


def test_singer_noise_is_the_integral():
    """Q by Gauss-Legendre quadrature of F(s) g gᵀ F(s)ᵀ, with the white acceleration beside it."""
    motion = tr.Singer(dims=2, accel_std=[3.0, 0.5], time_constant=[0.2, 4.0], accel_psd=[0.1, 0.0])
    assert motion.labels == ("x", "y", "vx", "vy", "ax", "ay")
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for dt in (1e-6, 0.02, 0.4, 2.0):
        total = np.zeros((6, 6))
        for node, weight in zip(nodes, weights, strict=True):
            f = motion.transition(dt * (1 + node) / 2)
            gain = np.zeros((6, 4))
            gain[4, 0], gain[5, 1] = 3.0 * np.sqrt(2 / 0.2), 0.5 * np.sqrt(2 / 4.0)
            gain[2, 2] = np.sqrt(0.1)
            total += weight * dt / 2 * (f @ gain) @ (f @ gain).T
        np.testing.assert_allclose(motion.noise(dt), total, rtol=1e-10, atol=0)


def test_singer_runs_in_a_filter_and_refuses_by_name():
    kf = tr.KalmanFilter(tr.Singer(1, accel_std=1.0, time_constant=1.0), tr.PositionSensor(1, std=0.1))
    start = tr.GaussianState(np.zeros(3), np.eye(3))
    assert np.isfinite(kf.run([0.0, 0.1, 0.2], [[0.0], [0.1], [0.1]], initial=start).means).all()
    with pytest.raises(tr.ParameterError, match="time_constant = 0"):
        tr.Singer(1, accel_std=1.0, time_constant=0.0)
    with pytest.raises(tr.ParameterError, match="accel_psd = -1"):
        tr.Singer(1, accel_std=1.0, time_constant=1.0, accel_psd=-1.0)
    with pytest.raises(tr.DimensionError, match="accel_std"):
        tr.Singer(3, accel_std=[1.0, 1.0], time_constant=1.0)


# --- rotations -------------------------------------------------------------------------------------------------------


def test_rotations_agree_in_all_their_forms():
    rng = np.random.default_rng(4)
    vectors = rng.normal(size=(200, 3))
    vectors *= (rng.uniform(0, np.pi, 200) / np.linalg.norm(vectors, axis=1))[:, None]
    vectors[0] = 0.0
    quaternions = tr.rotation.quaternions_from_vectors(vectors)
    assert (quaternions[:, 0] >= 0).all()
    for v, q in zip(vectors, quaternions, strict=True):
        np.testing.assert_allclose(matrix_of_quaternion(q), matrix(v), atol=1e-13)
    np.testing.assert_allclose(tr.rotation.vectors_from_quaternions(-quaternions), vectors, atol=1e-14)
    angles = tr.rotation.angles_from_vectors(vectors)
    x, y, z = np.eye(3)
    for (a, b, c), v in zip(angles, vectors, strict=True):
        np.testing.assert_allclose(matrix(c * z) @ matrix(b * y) @ matrix(a * x), matrix(v), atol=1e-12)
    np.testing.assert_allclose(tr.rotation.vectors_from_angles(angles), vectors, atol=1e-12)
    turns = tr.rotation.between(vectors[:-1], vectors[1:])
    for a, b, turn in zip(vectors[:-1], vectors[1:], turns, strict=True):
        np.testing.assert_allclose(matrix(turn), matrix(a).T @ matrix(b), atol=1e-13)
    assert tr.rotation.between(vectors[1], vectors[2]).shape == (3,)
    assert not turns.flags.writeable


def test_rotations_that_are_none():
    with pytest.raises(tr.ParameterError, match=r"quaternion of row 1 = \(0, 0, 0, 0\) with norm 0"):
        tr.rotation.vectors_from_quaternions([[1.0, 0, 0, 0], [0.0, 0, 0, 0]])
    with pytest.raises(tr.NonFiniteError, match="quaternion of row 0"):
        tr.rotation.vectors_from_quaternions([np.inf, 0, 0, 0])
    assert np.isnan(tr.rotation.vectors_from_quaternions([1.0, np.nan, 0, 0])).all()
    with pytest.raises(tr.DimensionError):
        tr.rotation.vectors_from_quaternions([1.0, 0, 0])
    with pytest.raises(tr.DimensionError, match="start and end"):
        tr.rotation.between([0.0, 0, 0], [[0.0, 0, 0]])


# --- the pose sensor -------------------------------------------------------------------------------------------------


def test_three_angles_are_linear_and_wrap():
    sensor = tr.PoseSensor(position_std=1e-3, angle_std=np.radians(0.07), attitude="euler")
    assert sensor.labels == ("x", "y", "z", "alpha", "beta", "gamma")
    np.testing.assert_allclose(np.diag(sensor.noise()), [1e-6] * 3 + [np.radians(0.07) ** 2] * 3)
    kf = tr.KalmanFilter(tr.ConstantAcceleration(dims=6, jerk_psd=1.0), sensor)
    start = tr.GaussianState(np.r_[np.zeros(5), np.pi - 0.01, np.zeros(12)], np.eye(18) * 1e-4)
    update = kf.update(start, [0, 0, 0, 0, 0, 0.01 - np.pi])
    assert update.innovation[5] == pytest.approx(0.02)
    rows = sensor.measurements([[1.0, 2, 3, 4, 5, np.nan]])
    np.testing.assert_array_equal(rows, [[1.0, 2, 3, 4, 5, np.nan]])
    alone = tr.PoseSensor(angle_std=[0.1, 0.2, 0.3], attitude="euler")
    assert (alone.measurement_dim, alone.labels) == (3, ("alpha", "beta", "gamma"))


def test_quaternions_become_rotation_vectors():
    sensor = tr.PoseSensor(position_std=[1e-3, 2e-3, 3e-3], angle_std=1e-3)
    rng = np.random.default_rng(1)
    q = rng.normal(size=(50, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    rows = np.c_[rng.normal(size=(50, 3)), q]
    rows[7, 4] = rows[8, 1] = np.nan
    out = sensor.measurements(rows)
    assert out.shape == (50, 6)
    assert not out.flags.writeable
    np.testing.assert_array_equal(out[:, :3], rows[:, :3])
    assert np.isnan(out[7, 3:]).all()
    assert np.isfinite(out[8, 3:]).all()
    np.testing.assert_array_equal(sensor.measurements(np.c_[rows[:, :3], -q])[9:], out[9:])
    np.testing.assert_array_equal(out[9:, 3:], tr.rotation.vectors_from_quaternions(q)[9:])
    # Columns in another order go in unnoticed, lengths do not; nor do rows of another width.
    for bad in ([0.0, 0, 0, 0], [1.0, 0.2, 0, 0]):
        with pytest.raises(tr.ParameterError, match="quaternion of row 1"):
            sensor.measurements([[0, 0, 0, 1.0, 0, 0, 0], [0, 0, 0, *bad]])
    with pytest.raises(tr.DimensionError, match="report of the PoseSensor has size 6, expected 7"):
        sensor.measurements(np.zeros((2, 6)))
    assert tr.PoseSensor(angle_std=1e-3).measurements(np.c_[q[:3]]).shape == (3, 3)
    plain = tr.PositionSensor(2, std=1.0)
    np.testing.assert_array_equal(plain.measurements([[1.0, 2.0]]), [[1.0, 2.0]])


def test_bad_pose_sensors():
    with pytest.raises(tr.ParameterError, match="position_std = 0"):
        tr.PoseSensor(position_std=0.0, angle_std=1.0)
    with pytest.raises(tr.ParameterError, match="angle_std = -1"):
        tr.PoseSensor(angle_std=[1.0, -1.0, 1.0])
    with pytest.raises(tr.DimensionError, match="position_std"):
        tr.PoseSensor(position_std=[1.0, 1.0], angle_std=1.0)
    with pytest.raises(tr.ParameterError, match="attitude = roll"):
        tr.PoseSensor(angle_std=1.0, attitude="roll")
    angles = tr.PoseSensor(position_std=1, angle_std=1, attitude="euler")
    with pytest.raises(tr.DimensionError, match="position of the motion model"):
        tr.KalmanFilter(tr.ConstantVelocity(3, accel_psd=1.0), angles)


def test_configuration_file(tmp_path):
    file = tmp_path / "head.toml"
    text = """
[motion]
type = "singer"
dims = 6
accel_std = 3.0
time_constant = 0.2

[sensors.head]
type = "pose"
position_std = 0.001
angle_std = [0.001, 0.001, 0.002]
attitude = "euler"
columns = ["x", "y", "z", "a", "b", "c"]

[tracker]
max_gap = 30.0
initiator = {m = 2, n = 3, max_speed = 12}
"""
    file.write_text(text)
    config = load_config(file)
    assert config.motion == tr.Singer(6, accel_std=3.0, time_constant=0.2)
    assert config.sensors["head"].labels[3] == "alpha"
    file.write_text(text.replace('"euler"', '"angles"'))
    with pytest.raises(ConfigError, match=r'attitude = "angles" is unknown'):
        load_config(file)
    file.write_text(text.replace('"euler"', '"quaternion"'))
    with pytest.raises(ConfigError, match="must be a rigid body"):
        load_config(file)


# --- the camera ------------------------------------------------------------------------------------------------------


def tilted():
    return np.array([0.0, 0.0, 1.0, np.radians(30.0), 0.0, 0.0])


def test_the_image_is_the_projection():
    matrix_ = [[900.0, 0, 600.0], [0, 1100.0, 500.0], [0, 0, 1]]
    camera = tr.CameraSensor(CROSS, matrix_, pixel_std=0.3)
    state = np.array([0.1, -0.2, 1.5, 0.4, -0.3, 0.2])
    seen = CROSS @ matrix(state[3:]).T + state[:3]
    expected = seen[:, :2] / seen[:, 2:] * [900.0, 1100.0] + [600.0, 500.0]
    np.testing.assert_allclose(camera.observe(state), expected.ravel(), rtol=1e-13)
    short = tr.CameraSensor(CROSS, (900.0, 1100.0, 600.0, 500.0), pixel_std=0.3)
    np.testing.assert_array_equal(short.observe(state), camera.observe(state))
    assert camera.labels[:3] == ("u0", "v0", "u1")


def test_fixes_reach_the_cramer_rao_bound():
    """The bound by numerical derivatives of the projection; 2000 draws leave 1.6 % on a standard deviation."""
    camera = tr.CameraSensor(CROSS, (1000, 1000, 640, 480), pixel_std=0.3)
    truth, rng = tilted(), np.random.default_rng(8)
    q = tr.rotation.quaternions_from_vectors(truth[3:])

    def image(delta):
        seen = CROSS @ (matrix_of_quaternion(q) @ matrix(delta[3:])).T + truth[:3] + delta[:3]
        return (seen[:, :2] / seen[:, 2:] * 1000.0).ravel()

    steps = np.eye(6) * 1e-6
    h = np.array([(image(s) - image(-s)) / 2e-6 for s in steps]).T
    bound = np.sqrt(np.diag(np.linalg.inv(h.T @ h / 0.3**2)))
    errors = []
    for _ in range(2000):
        fix = camera.fix(camera.observe(truth) + 0.3 * rng.normal(size=10))
        assert fix.mirror is None
        assert fix.dof == 4
        turn = tr.rotation.between(truth[3:], tr.rotation.vectors_from_quaternions(fix.quaternion))
        errors.append(np.r_[fix.position - truth[:3], turn])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms < 1.1 * bound).all(), rms / bound
    np.testing.assert_allclose(np.sqrt(np.diag(fix.cov)), bound, rtol=0.1)


def test_a_far_plane_reports_its_mirror():
    camera = tr.CameraSensor(CROSS, (1000, 1000, 640, 480), pixel_std=0.3)
    fix = camera.fix(camera.observe([1.0, 0.5, 10.0, 0.5, 0.3, 0.0]))
    assert fix.mirror is not None
    assert fix.mirror.shape == (7,)
    assert np.linalg.norm(fix.mirror[3:]) == pytest.approx(1.0)
    assert not fix.mirror.flags.writeable
    with pytest.raises(AttributeError):
        fix.dof = 3


def test_images_that_cannot_be():
    camera = tr.CameraSensor(CROSS, (1000, 1000, 640, 480), pixel_std=0.3)
    image = camera.observe(tilted()).copy()
    with pytest.raises(tr.UnobservableError, match="point 0 lies behind the camera"):
        camera.observe([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    image[[0, 5]] = np.nan
    with pytest.raises(tr.UnobservableError, match=r"needs 4 points, 3 seen \(1, 3, 4\)"):
        camera.fix(image)
    line = tr.CameraSensor(CROSS[[0, 1, 3]].repeat(2, axis=0), (1000, 1000, 640, 480), pixel_std=0.3)
    with pytest.raises(tr.UnobservableError, match="collinear"):
        line.fix(line.observe(tilted()))
    with pytest.raises(tr.NonFiniteError):
        camera.fix(np.full(10, np.inf))
    with pytest.raises(tr.DimensionError, match="intrinsics"):
        tr.CameraSensor(CROSS, (1000, 640, 480), pixel_std=0.3)
    with pytest.raises(tr.ParameterError, match="focal length"):
        tr.CameraSensor(CROSS, (1000, -1000, 640, 480), pixel_std=0.3)
    with pytest.raises(tr.ParameterError, match="without skew"):
        tr.CameraSensor(CROSS, np.ones((3, 3)), pixel_std=0.3)
    with pytest.raises(tr.DimensionError, match="points"):
        tr.CameraSensor(CROSS[:, :2], (1000, 1000, 640, 480), pixel_std=0.3)
    with pytest.raises(tr.ParameterError, match="pixel_std"):
        tr.CameraSensor(CROSS, (1000, 1000, 640, 480), pixel_std=0.0)


# --- times -----------------------------------------------------------------------------------------------------------


def test_jittering_stamps_are_counted():
    """60 Hz with stamps up to a third of a step late, a gap of two seconds, and seconds since 1970."""
    rng = np.random.default_rng(2)
    steps = np.arange(4000)
    steps[2500:] += 138
    clean = 1.7e9 + steps / 60.0
    late = np.where(rng.random(4000) < 0.1, rng.uniform(0, 0.33, 4000), rng.normal(0, 0.02, 4000)) / 60.0
    regular = tr.regularise(clean + late)
    np.testing.assert_array_equal(regular.steps, steps)
    assert regular.period == pytest.approx(1 / 60, rel=1e-5)
    assert np.abs(regular.times - clean - late.mean()).max() < 2e-4
    assert len(regular) == 4000
    assert not regular.times.flags.writeable
    given = tr.regularise(clean + late, period=1 / 60)
    assert given.period == 1 / 60
    np.testing.assert_array_equal(given.steps, steps)


def test_bad_times():
    with pytest.raises(tr.TimeError, match="times must not decrease"):
        tr.regularise([0.0, 1.0, 0.5])
    with pytest.raises(tr.NonFiniteError, match="times is not finite at index 1"):
        tr.regularise([0.0, np.nan])
    with pytest.raises(tr.ParameterError, match="number of times"):
        tr.regularise([0.0])
    with pytest.raises(tr.ParameterError, match="period"):
        tr.regularise([0.0, 1.0], period=-1.0)
