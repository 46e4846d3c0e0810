"""The documented streams of scenarios, rewritten on NumPy's generator."""

from __future__ import annotations

import numpy as np


class Deviates:
    """The documented streams, rewritten on NumPy's generator."""

    def __init__(self, seed, run):
        self.uniform = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(run,)))).random
        self.spare = None

    def normal(self):
        if self.spare is not None:
            out, self.spare = self.spare, None
            return out
        radius, angle = np.sqrt(-2.0 * np.log(1.0 - self.uniform())), 2.0 * np.pi * self.uniform()
        self.spare = radius * np.sin(angle)
        return radius * np.cos(angle)

    def poisson(self, mean):
        count, time = 0, -np.log(1.0 - self.uniform())
        while time < mean:
            count, time = count + 1, time - np.log(1.0 - self.uniform())
        return count
