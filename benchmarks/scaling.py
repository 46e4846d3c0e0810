"""How cost grows: with targets, with detections, with states, with threads. `python benchmarks/scaling.py`.

Medians of five; what counts is how a column changes from row to row of one table.
"""

from __future__ import annotations

import os
import statistics
import time
from typing import TYPE_CHECKING

import numpy as np

import trackrs as tr

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

REPEATS = 5


def median(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median wall time of some calls after one that warms up, in seconds."""
    work()
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return statistics.median(times)


def scans(targets: int, clutter: int, count: int = 20) -> list[tr.Scan]:
    """Return scans of targets at one density, whatever their number, so that gates hold equally many reports."""
    rng = np.random.default_rng(1)
    side = 100.0 * (targets + clutter) ** 0.5
    place, speed = rng.uniform(0.0, side, (targets, 2)), rng.uniform(-10.0, 10.0, (targets, 2))
    out = []
    for k in range(count):
        seen = place + k * speed + rng.normal(0.0, 2.0, (targets, 2))
        out.append(tr.Scan(float(k), np.concatenate([seen, rng.uniform(0.0, side, (clutter, 2))]), "radar"))
    return out


def tracker_scan(targets: int, clutter: int) -> float:
    """Return the seconds that a scan takes once the tracks are there."""
    tracker = tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_psd=0.1),
        {"radar": tr.PositionSensor(dims=2, std=2.0)},
        tr.MofN(2, 3, max_speed=20.0),
    )
    given = scans(targets, clutter)
    tracker.run(given[:10])
    return median(lambda: tracker.copy().run(given[10:])) / 10.0


def filter_row(n: int) -> float:
    """Return the seconds of a row of a Kalman filter with n states, the last estimate alone kept."""
    rng = np.random.default_rng(n)
    transition = np.eye(n) + 0.1 * np.eye(n, k=n // 2)
    kf = tr.KalmanFilter(tr.LinearMotion(transition, 0.1 * np.eye(n)), tr.LinearSensor(np.eye(2, n), np.eye(2)))
    values, start = rng.normal(size=(2_000, 2)), tr.GaussianState(np.zeros(n), np.eye(n))
    times = np.arange(1.0, 2_001.0)
    return median(lambda: kf.run(times, values, initial=start, history="last")) / 2_000.0


def batch(threads: int) -> float:
    """Return the seconds of 100 steps of 10,000 tracks with constant velocity in the plane."""
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.1), tr.PositionSensor(dims=2, std=1.0))
    values = np.random.default_rng(0).normal(size=(10_000, 100, 2))
    start = tr.GaussianState(np.zeros(4), np.eye(4))
    return median(lambda: kf.run_batch(np.arange(1.0, 101.0), values, initial=start, threads=threads))


def unlike(threads: int) -> float:
    """Return the same of an extended filter, which goes track by track."""
    radar = tr.RangeBearing((0.0, 0.0), range_std=1.0, bearing_std=0.01)
    ekf = tr.ExtendedKalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.1), radar)
    values = np.tile([50.0, 0.9], (2_000, 100, 1))
    start = tr.GaussianState([30.0, 40.0, 0.0, 0.0], np.eye(4))
    return median(lambda: ekf.run_batch(np.arange(1.0, 101.0), values, initial=start, threads=threads))


def rows(title: str, names: str, body: Iterable[tuple[object, ...]]) -> list[str]:
    """Return a table."""
    head = [f"| {names} |", "|" + "---|" * (names.count("|") + 1)]
    return ["", f"### {title}", "", *head, *("| " + " | ".join(map(str, row)) + " |" for row in body)]


def tables() -> list[str]:
    """Measure, and return all tables as lines."""
    out = ["", "## How cost grows"]
    counts = [(n, n // 2) for n in (10, 30, 100, 300, 1000, 3000)]
    found = [(t, c, tracker_scan(t, c)) for t, c in counts]
    body = [(t, c, f"{1e3 * s:.3g}", f"{1e6 * s / (t + t + c):.3g}") for t, c, s in found]
    names = "targets | clutter | ms a scan | us per track and detection"
    out += rows("Tracker, with targets and detections", names, body)
    found = [(100, c, tracker_scan(100, c)) for c in (0, 100, 1_000, 10_000)]
    body = [(t, c, f"{1e3 * s:.3g}", f"{1e6 * s / (t + t + c):.3g}") for t, c, s in found]
    out += rows("Tracker, with clutter", names, body)
    body = [(n, f"{1e6 * filter_row(n):.3g}") for n in (2, 4, 6, 9, 12, 18, 30)]
    out += rows("Kalman filter, with states", "states | us a row", body)
    cores = sorted({1, 2, os.cpu_count() or 1})
    for name, work in (("10,000 Kalman filters in lanes", batch), ("2,000 extended filters", unlike)):
        times = {threads: work(threads) for threads in cores}
        body = [(threads, f"{1e3 * s:.3g}", f"{times[1] / s:.2f}") for threads, s in times.items()]
        out += rows(f"{name}, 100 steps each, with threads", "threads | ms | times as fast", body)
    return out


if __name__ == "__main__":
    print("\n".join(tables()))
