"""Sigma-point filters, models by Python functions, and the square-root form."""

from __future__ import annotations

import numpy as np
import pytest

import trackrs as tr

RNG = np.random.default_rng(4)


def turn(states, dt):
    x, y, vx, vy, w = states.T
    c, s = np.cos(w * dt), np.sin(w * dt)
    vx, vy = c * vx - s * vy, s * vx + c * vy
    return np.stack([x + dt * vx, y + dt * vy, vx, vy, w], axis=1)


def polar(states):
    return np.stack([np.hypot(states[:, 0], states[:, 1]), np.arctan2(states[:, 1], states[:, 0])], axis=1)


LABELS = ("x", "y", "vx", "vy", "w")
Q = np.diag([0.01, 0.01, 0.05, 0.05, 1e-4])
R = np.diag([1.0, 1e-4])
START = tr.GaussianState([-50.0, 5.0, 3.0, -4.0, 0.1], np.diag([4.0, 4.0, 1.0, 1.0, 0.01]))


def course(count=40):
    state, times, values = START.mean.copy()[None], 0.5 * np.arange(1, count + 1), []
    rng = np.random.default_rng(1)
    for _ in times:
        state = turn(state, 0.5)
        values.append(polar(state)[0] + rng.normal(size=2) * np.sqrt(np.diag(R)))
    return times, np.array(values)


def models():
    return tr.CustomMotion(turn, Q, labels=LABELS), tr.CustomSensor(polar, R, angles=(1,))


@pytest.mark.parametrize("kind", [tr.UnscentedKalmanFilter, tr.CubatureKalmanFilter, tr.ExtendedKalmanFilter])
def test_functions_are_models_for_every_filter(kind):
    times, values = course()
    values[5, 1] = np.nan
    values[9] = np.nan
    run = kind(*models()).run(times, values, initial=START, lead="midpoint")
    assert run.labels == LABELS
    assert run.dof.tolist()[5] == 1
    assert run.dof.tolist()[9] == 0
    # 2.5 deg of bearing at 50 m; all within what the covariances say.
    assert np.nanmean(run.nis / np.maximum(run.dof, 1)) < 1.5
    assert np.isfinite(run.smooth().means).all()
    assert (run.lead_times == times + 0.25).all()
    root = kind(*models(), form="square_root").run(times, values, initial=START)
    np.testing.assert_allclose(root.means, run.means, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(root.covs, run.covs, rtol=1e-6, atol=1e-10)


def test_a_function_is_the_built_in_sensor():
    times, values = course()
    motion = tr.ConstantVelocity(dims=2, accel_psd=1.0)
    start = tr.GaussianState(START.mean[:4], START.cov[:4, :4])
    own = tr.RangeBearing((0.0, 0.0), range_std=1.0, bearing_std=0.01)
    custom = tr.CustomSensor(polar, own.noise(), angles=(1,))
    for kind, tolerance in [(tr.UnscentedKalmanFilter, 1e-10), (tr.ExtendedKalmanFilter, 1e-7)]:
        a, b = (kind(motion, sensor).run(times, values, initial=start) for sensor in (own, custom))
        np.testing.assert_allclose(a.means, b.means, rtol=tolerance, atol=tolerance)


def test_a_given_derivative_is_used():
    asked = []

    def slope(states):
        asked.append(states.shape)
        x, y = states[:, 0], states[:, 1]
        r = np.hypot(x, y)
        out = np.zeros((len(states), 2, 4))
        out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = x / r, y / r, -y / r**2, x / r**2
        return out

    motion = tr.ConstantVelocity(dims=2, accel_psd=1.0)
    times, values = course(10)
    start = tr.GaussianState(START.mean[:4], START.cov[:4, :4])
    given, found = (
        tr.ExtendedKalmanFilter(motion, tr.CustomSensor(polar, R, angles=(1,), jacobian=j)).run(
            times, values, initial=start
        )
        for j in (slope, None)
    )
    assert asked == [(1, 4)] * 10
    np.testing.assert_allclose(given.means, found.means, rtol=1e-7)


@pytest.mark.parametrize("kappa", [0.0, 3.0, -5.0])
def test_linear_functions_give_the_kalman_filter(kappa):
    motion, sensor = tr.ConstantAcceleration(dims=2, jerk_psd=0.3), tr.PositionSensor(dims=2, std=0.5)
    custom = tr.CustomMotion(lambda states, dt: states @ motion.transition(dt).T, motion.noise, labels=motion.labels)
    h = np.eye(2, 6)
    seen = tr.CustomSensor(lambda states: states @ h.T, sensor.noise())
    times = np.cumsum(RNG.uniform(0.05, 0.5, 60))
    values = RNG.normal(size=(60, 2)).cumsum(axis=0)
    values[7, 0] = np.nan
    start = tr.GaussianState(np.zeros(6), np.diag([1.0, 1, 4, 4, 1, 1]))
    kalman = tr.KalmanFilter(motion, sensor).run(times, values, initial=start)
    for filter_ in (
        tr.UnscentedKalmanFilter(motion, sensor, kappa=kappa),
        tr.UnscentedKalmanFilter(custom, seen, kappa=kappa),
        tr.UnscentedKalmanFilter(custom, seen, alpha=0.5),
        tr.CubatureKalmanFilter(custom, seen),
        tr.CubatureKalmanFilter(custom, seen, form="square_root"),
        tr.KalmanFilter(motion, sensor, form="square_root"),
    ):
        run = filter_.run(times, values, initial=start)
        np.testing.assert_allclose(run.means, kalman.means, rtol=0, atol=1e-10 * np.abs(kalman.means).max())
        np.testing.assert_allclose(run.covs, kalman.covs, rtol=0, atol=1e-10 * kalman.covs.max())
        assert run.log_likelihood == pytest.approx(kalman.log_likelihood, rel=1e-10)
        np.testing.assert_allclose(run.smooth().means, kalman.smooth().means, atol=1e-8)


def test_what_functions_do_wrong_is_named():
    times, values = course(3)
    motion, sensor = models()

    def run(**changes):
        return tr.UnscentedKalmanFilter(**{"motion": motion, "sensor": sensor, **changes}).run(
            times, values, initial=START
        )

    def bad_shape(states):
        return states[:, :1]

    def not_finite(states):
        return polar(states) * np.nan

    def fails(_states):
        raise KeyError("deep inside")

    with pytest.raises(tr.DimensionError, match=r"output of h of CustomSensor \(bad_shape\) has shape \[11, 1\]"):
        run(sensor=tr.CustomSensor(bad_shape, R))
    with pytest.raises(tr.NonFiniteError, match=r"output of h of CustomSensor \(not_finite\)"):
        run(sensor=tr.CustomSensor(not_finite, R))
    with pytest.raises(KeyError, match="deep inside"):
        run(sensor=tr.CustomSensor(fails, R))
    with pytest.raises(TypeError, match="f of CustomMotion"):
        run(motion=tr.CustomMotion(lambda _states, _dt: "text", Q, labels=LABELS))
    with pytest.raises(ZeroDivisionError):
        run(motion=tr.CustomMotion(turn, lambda _dt: 1 / 0, labels=LABELS))
    with pytest.raises(tr.DimensionError, match="output of noise of CustomMotion"):
        run(motion=tr.CustomMotion(turn, lambda _dt: np.eye(3), labels=LABELS))
    with pytest.raises(tr.DimensionError, match="noise"):
        tr.CustomMotion(turn, np.eye(3), labels=LABELS)
    with pytest.raises(tr.ParameterError, match="angles = 2"):
        tr.CustomSensor(polar, R, angles=(2,))
    # An exception does not linger.
    assert len(run()) == 3


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ({"kappa": -5.0}, "kappa = -5"),
        ({"beta": 2.0}, "beta = 2.0"),
        ({"alpha": 0.0}, "alpha = 0"),
        ({"form": "square_root", "redraw": False}, "form = square_root"),
        ({"form": "square_root", "kappa": -2.0}, "form = square_root"),
        ({"form": "cholesky"}, "form = cholesky"),
        ({"steps": 0}, "steps = 0"),
        ({"steps": 2, "adapt": tr.LimitedMemoryNoise(q_form="full")}, "steps = 2"),
        ({"horizon": -1.0}, "horizon = -1"),
        ({"adapt": tr.NisScaledNoise((1.0, 2.0))}, "adapt = given"),
    ],
)
def test_what_does_not_go_together_is_named(arguments, culprit):
    with pytest.raises(tr.ParameterError, match=culprit):
        tr.UnscentedKalmanFilter(*models(), **arguments)
