"""The reference course of the underwater paper (section 6 of its spec) and the two hydrophone arrays that hear it."""

from __future__ import annotations

import numpy as np

import trackrs as tr

BATS = np.array([[0.0, 0.0, 250.0], [1000.0, 0.0, 252.0], [500.0, 866.0, 248.0]])
AZIMUTH = np.radians(15.0 + 60.0 * np.arange(6))
TOSS = np.stack(
    [
        700.0 + 1200.0 * np.cos(AZIMUTH),
        500.0 + 1200.0 * np.sin(AZIMUTH),
        300.0 + np.array([0.0, 12.0, -8.0, 15.0, -12.0, 5.0]),
    ],
    axis=1,
)


def manoeuvre(dt=1.0, fine=20):
    """The reference course: straight, turn, straight, dive, turn back; rates ramp over 2 s inside the legs, 15 m/s."""
    t = np.arange(0.0, 160.0 + dt / 2, dt / fine)

    def between(begin, end):
        return np.clip((t - begin) / 2.0, 0.0, 1.0) - np.clip((t - end + 2.0) / 2.0, 0.0, 1.0)

    rate = np.radians(3.0 * between(40.0, 80.0) - 4.0 * between(130.0, 160.0))
    sink = 3.0 * between(100.0, 130.0)
    course = np.radians(20.0) + np.cumsum(rate) * dt / fine
    level = np.sqrt(225.0 - sink**2)
    velocity = np.stack([level * np.cos(course), level * np.sin(course), sink], axis=1)
    path = np.array([-300.0, -250.0, 50.0]) + np.cumsum(velocity, axis=0) * dt / fine
    return t[::fine], path[::fine], velocity[::fine]


def heard(array, path, rng):
    """Noisy measurements along a path."""
    clean = np.array([array.observe(p) for p in path])
    return clean + rng.normal(size=clean.shape) * np.sqrt(np.diagonal(array.noise()))


def jerk(std=0.1):
    return tr.ConstantAcceleration(dims=3, jerk_std=std)
