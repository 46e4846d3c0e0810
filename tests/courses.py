"""The reference course of the underwater paper (section 6 of its spec) and the two hydrophone arrays that hear it."""

from __future__ import annotations

import numpy as np

import trackrs as tr

BATS = tr.scenarios.underwater("bats").array.hydrophones
TOSS = tr.scenarios.underwater("toss").array.hydrophones


def manoeuvre():
    """Times, path and velocity of the reference course."""
    scene = tr.scenarios.underwater()
    return scene.times, scene.truth[:, :3], scene.truth[:, 3:6]


def heard(array, path, rng):
    """Noisy measurements along a path."""
    clean = np.array([array.observe(p) for p in path])
    return clean + rng.normal(size=clean.shape) * np.sqrt(np.diagonal(array.noise()))


def jerk(std=0.1):
    return tr.ConstantAcceleration(dims=3, jerk_std=std)
