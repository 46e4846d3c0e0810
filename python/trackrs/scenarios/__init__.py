"""Scenarios: truth, and what the sensors would have reported of it, drawn from seeded streams.

Run k with seed s has the same bits on every machine, whatever runs were drawn before: its random numbers come from the
bits of NumPy's `PCG64(SeedSequence(s, spawn_key=(k,)))`.
"""

from trackrs.scenarios._close_targets import CloseReports, CloseTargets, close_targets
from trackrs.scenarios._extended_targets import (
    Blob,
    Ellipse,
    ExtendedDetections,
    ExtendedTarget,
    ExtendedTargets,
    LShape,
    Rectangle,
    Shape,
    crossing,
    extended_targets,
    parallel,
)
from trackrs.scenarios._turning import Angles, Turning, moving_head, turntable
from trackrs.scenarios._underwater import Course, Leg, Recording, Underwater, underwater

__all__ = [
    "Angles",
    "Blob",
    "CloseReports",
    "CloseTargets",
    "Course",
    "Ellipse",
    "ExtendedDetections",
    "ExtendedTarget",
    "ExtendedTargets",
    "LShape",
    "Leg",
    "Recording",
    "Rectangle",
    "Shape",
    "Turning",
    "Underwater",
    "close_targets",
    "crossing",
    "extended_targets",
    "moving_head",
    "parallel",
    "turntable",
    "underwater",
]
