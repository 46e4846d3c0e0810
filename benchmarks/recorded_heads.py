"""Recorded heads: how well the omitted samples are predicted, and how much that depends on the setting.

    TRACKRS_DATA=FOLDER python benchmarks/recorded_heads.py [--sensitivity]

Every second sample is fed and the one between predicted, where it is at most 50 ms ahead. The error is divided by that
of the best of three extrapolations of the fed samples (hold, linear, quadratic; the best for each trace and figure).
One setting per device. Recordings, in the folder `TRACKRS_DATA`: `hololens_head_6dof` (walking people, position and
attitude; its licence does not let it be part of this project) and `hmd360_orientation` (seated viewers, attitude; MIT,
a minute of it is in `examples/data/hmd360`).
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import trackrs as tr
from trackrs import rotation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

HORIZON = 0.05  # seconds
# The HoloLens samples at a fixed rate and stamps unevenly: its samples are counted. The other device's stamps are real.
HOLOLENS_PERIOD = 0.016484


@dataclass(frozen=True, slots=True)
class Setting:
    """What the filter of one device is made of; six axes with a position, three without."""

    accel_std: tuple[float, ...]
    time_constant: tuple[float, ...]
    accel_psd: tuple[float, ...]
    position_std: float | None
    angle_std: float
    jump: float  # of the recording, not of the head: the screen allows for it as a standard deviation
    period: float | None = None

    def filter(self) -> tr.ExtendedKalmanFilter:
        """Build it."""
        motion = tr.Singer(len(self.accel_std), self.accel_std, self.time_constant, self.accel_psd)
        sensor = tr.PoseSensor(position_std=self.position_std, angle_std=self.angle_std, attitude="quaternion")
        return tr.ExtendedKalmanFilter(motion, sensor, screen=tr.ChiSquareScreen(alpha=1e-3, allowance=self.jump**2))


def both(position: float, angle: float) -> tuple[float, ...]:
    """One value for the axes of the position, one for those of the attitude."""
    return (position,) * 3 + (angle,) * 3


HOLOLENS = Setting(
    accel_std=both(1.5, 2.1),
    time_constant=both(0.15, 0.03),
    accel_psd=both(0.1, 4.0),
    position_std=3e-4,
    angle_std=1e-3,
    jump=0.03,
    period=HOLOLENS_PERIOD,
)
HMD = Setting(
    accel_std=(3.5,) * 3,
    time_constant=(0.025,) * 3,
    accel_psd=(0.2,) * 3,
    position_std=None,
    angle_std=6e-4,
    jump=0.2,
)


@dataclass(frozen=True, slots=True)
class Trace:
    """One recording: times (T,), positions (T, 3) or none, quaternions (T, 4), and these as rotation vectors (T, 3)."""

    name: str
    times: Array
    positions: Array | None
    quaternions: Array
    vectors: Array

    def poses(self) -> Array:
        """What the device reports (T, 7) or (T, 4)."""
        return self.quaternions if self.positions is None else np.hstack([self.positions, self.quaternions])


def recordings(device: str) -> list[Trace]:
    """All traces of a device."""
    traces = []
    for path in sorted((Path(os.environ["TRACKRS_DATA"]) / device).glob("*.csv")):
        table = np.genfromtxt(path, delimiter=",", names=True)
        quaternions = np.stack([table[name] for name in ("qw", "qx", "qy", "qz")], axis=1)
        positions = np.stack([table[f"{a}_m"] for a in "xyz"], axis=1) if "x_m" in table.dtype.names else None
        vectors = rotation.vectors_from_quaternions(quaternions)
        traces.append(Trace(path.stem, table["t_s"], positions, quaternions, vectors))
    return traces


@dataclass(frozen=True, slots=True)
class Score:
    """Errors of the predictions of one trace, of its position (metres) or of its attitude (radians).

    median, p95: the ratio to the best extrapolation. nees: mean normalised squared error per axis, 1 = honest; without
    the rows whose error is a jump of the recording, of which there are `jumps`.
    """

    median: float
    p95: float
    nees: float
    jumps: int


@dataclass(frozen=True, slots=True)
class Result:
    """One trace as predicted."""

    trace: str
    position: Score | None
    angle: Score
    restarts: int


def extrapolated(times: Array, ahead: Array, steps: Array) -> list[Array]:
    """Hold, linear and quadratic extrapolation, each as the way from the last sample (T - 2, 3)."""
    before, last = np.diff(times)[:-1, None], np.diff(times)[1:, None]
    speed, earlier = steps[1:] / last, steps[:-1] / before
    h = ahead[2:, None]
    linear = speed * h
    quadratic = linear + (speed - earlier) / ((last + before) / 2) * (h * h + h * last) / 2
    return [np.zeros_like(speed), linear, quadratic]


def score(error: Array, cov: Array, rivals: list[Array], rows: NDArray[np.bool_], jump: float) -> Score:
    """Compare errors (T, 3) with those of the extrapolations, over the same rows."""
    size = np.linalg.norm(error, axis=1)[rows]
    sizes = [np.linalg.norm(rival, axis=1)[rows[2:]] for rival in rivals]
    squared = np.einsum("ti,ti->t", error, np.linalg.solve(cov, error[:, :, None])[:, :, 0])[rows]
    jumps = size > jump
    return Score(
        median=float(np.median(size) / min(np.median(rival) for rival in sizes)),
        p95=float(np.percentile(size, 95) / min(np.percentile(rival, 95) for rival in sizes)),
        nees=float(squared[~jumps].mean() / 3),
        jumps=int(jumps.sum()),
    )


def predict(trace: Trace, setting: Setting, *, gate: bool = True) -> Result:
    """Feed every second sample, predict the others, compare."""
    pairs = len(trace.times) // 2
    fed, left_out = slice(0, 2 * pairs, 2), slice(1, 2 * pairs, 2)
    times = trace.times
    if setting.period is not None:
        times = tr.regularise(times, setting.period).times
    ekf = setting.filter()
    if not gate:
        ekf = ekf.replace(screen=None)
    poses, ahead = trace.poses(), times[left_out] - times[fed]
    run = ekf.run(times[fed], poses[fed], lead=ahead)
    rows = trace.times[left_out] - trace.times[fed] <= HORIZON
    rows[: max(2, run.start)] = False
    position = None
    if trace.positions is not None:
        known, hidden = trace.positions[fed], trace.positions[left_out]
        ways = extrapolated(trace.times[fed], (trace.times[left_out] - trace.times[fed]), np.diff(known, axis=0))
        rivals = [known[2:] + way - hidden[2:] for way in ways]
        noise = float(setting.position_std or 0.0) ** 2 * np.eye(3)
        position = score(run.lead_means[:, :3] - hidden, run.lead_covs[:, :3, :3] + noise, rivals, rows, setting.jump)
    first = 0 if trace.positions is None else 3
    known, hidden = trace.vectors[fed], trace.vectors[left_out]
    steps = rotation.between(known[:-1], known[1:])
    ways = extrapolated(trace.times[fed], (trace.times[left_out] - trace.times[fed]), steps)
    rivals = [rotation.between(way, rotation.between(known[2:], hidden[2:])) for way in ways]
    noise = setting.angle_std**2 * np.eye(3)
    part = slice(first, first + 3)
    error = np.full_like(hidden, np.nan)
    error[run.start :] = rotation.between(run.lead_means[run.start :, part], hidden[run.start :])
    angle = score(error, run.lead_covs[:, part, part] + noise, rivals, rows, setting.jump)
    return Result(trace.name, position, angle, len(run.restarts))


def lines(results: list[Result]) -> list[str]:
    """A table with one row per trace and their means."""
    rows = [
        "| trace | position median | 95 % | NEES | angle median | 95 % | NEES | jumps | restarts |",
        "|---" * 9 + "|",
    ]
    cells = []
    for result in results:
        scores = [result.position, result.angle]
        numbers = [x for one in scores for x in ((one.median, one.p95, one.nees) if one else (np.nan,) * 3)]
        jumps = max(one.jumps for one in scores if one)
        cells.append([*numbers, float(jumps), float(result.restarts)])
    table = [(result.trace, row) for result, row in zip(results, cells, strict=True)]
    table.append(("mean", np.mean(cells, axis=0).tolist()))
    for name, row in table:
        shown = ["" if np.isnan(x) else f"{x:.3f}" for x in row[:-2]]
        rows.append(f"| {name} | " + " | ".join(shown) + f" | {row[-2]:.3g} | {row[-1]:.2g} |")
    return rows


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sensitivity", action="store_true", help="every parameter halved and doubled")
    arguments = parser.parse_args()
    for device, setting in (("hololens_head_6dof", HOLOLENS), ("hmd360_orientation", HMD)):
        if not (Path(os.environ.get("TRACKRS_DATA", "")) / device).is_dir():
            sys.exit(f"TRACKRS_DATA does not say where {device} is")
        traces = recordings(device)
        print(f"\n{device}\n")
        print("\n".join(lines([predict(trace, setting) for trace in traces])))
        print("\nwithout the jump gate\n")
        print("\n".join(lines([predict(trace, setting, gate=False) for trace in traces])))
        if not arguments.sensitivity:
            continue
        for name in ("accel_std", "time_constant", "accel_psd", "position_std", "angle_std", "jump"):
            value = getattr(setting, name)
            for factor in (0.5, 2.0):
                if value is None:
                    continue
                changed = tuple(factor * x for x in value) if isinstance(value, tuple) else factor * value
                mean = lines([predict(trace, replace(setting, **{name: changed})) for trace in traces])[-1]
                print(f"{name} x {factor}: {mean}")


if __name__ == "__main__":
    main()
