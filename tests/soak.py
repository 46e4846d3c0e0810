"""A day of scans: memory and time per scan must not grow.

`python tests/soak.py [SCANS]`: 50 targets seen every second among ten times as much clutter, 86,400 scans if not said
otherwise, which is 4.3 million detections and 43 million false ones. Targets come and go, so that there are always new
tracks. Says every tenth of the way how much memory the process holds and what a scan takes, and fails if memory has
grown by more than 4 MiB since the first tenth, or if not every row is accounted for.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import trackrs as tr

TARGETS, CLUTTER, SIDE, STAY = 50, 500, 5_000.0, 600
GROWTH = 4 << 20


def resident() -> int:
    """Bytes of memory that the process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def main(scans: int) -> int:
    rng = np.random.default_rng(1)
    tracker = tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_psd=0.1),
        {"radar": tr.PositionSensor(dims=2, std=5.0)},
        tr.MofN(3, 4, max_speed=30.0),
        deletion=tr.Deletion(max_misses=3),
    )
    place = rng.uniform(-SIDE, SIDE, (TARGETS, 2))
    speed = rng.uniform(-15.0, 15.0, (TARGETS, 2))
    sizes, speeds, rows, spent = [], [], 0, 0.0
    for k in range(scans):
        gone = rng.random(TARGETS) < 1.0 / STAY
        place[gone] = rng.uniform(-SIDE, SIDE, (gone.sum(), 2))
        place += speed
        speed = np.where(np.abs(place) > SIDE, -np.sign(place) * np.abs(speed), speed)
        seen = place + rng.normal(0.0, 5.0, (TARGETS, 2))
        values = np.concatenate([seen, rng.uniform(-SIDE, SIDE, (CLUTTER, 2))])
        rows += len(values)
        scan = tr.Scan(float(k), values, "radar")
        begun = time.perf_counter()
        held = tracker.step(scan)
        spent += time.perf_counter() - begun
        if (k + 1) % max(scans // 10, 1) == 0:
            sizes.append(resident())
            speeds.append(spent / max(scans // 10, 1))
            spent = 0.0
            print(
                f"{k + 1:6d} scans, {rows:9d} rows, {len(held):3d} tracks: {sizes[-1] / 2**20:.2f} MiB, "
                f"{1e3 * speeds[-1]:.3f} ms a scan",
                flush=True,
            )
    growth = max(sizes[1:]) - sizes[0]
    ledger = tracker.ledger
    print(f"memory: {growth / 2**20:+.2f} MiB since the first tenth; ledger: {ledger}")
    assert growth <= GROWTH, sizes
    assert ledger.rows_in == rows
    return 0


if __name__ == "__main__":
    raise SystemExit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 86_400))
