"""A scene for the tests of live running: lines of JSON with whatever a stream may bring."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import trackrs as tr
from trackrs import live

NAMES = ("in.ndjson", "out.ndjson", "dead.ndjson", "run.ckpt")
COLUMNS = {"radar": ("x", "y"), "sonar": ("range", "bearing")}
CONFIG = """
[motion]
type = "constant_velocity"
dims = 2
accel_psd = 0.1

[sensors.radar]
type = "position"
dims = 2
std = 1.0
columns = ["x", "y"]

[sensors.sonar]
type = "range_bearing"
position = [0.0, 0.0]
range_std = 2.0
bearing_std = 0.01
columns = ["range", "bearing"]

[tracker.initiator]
m = 2
n = 3
max_speed = 20.0

[tracker.deletion]
max_misses = 2
"""


def tracker(**changes):
    return tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_psd=0.1),
        {
            "radar": tr.PositionSensor(dims=2, std=1.0),
            "sonar": tr.RangeBearing(position=(0.0, 0.0), range_std=2.0, bearing_std=0.01),
        },
        tr.MofN(2, 3, max_speed=20.0),
        deletion=tr.Deletion(max_misses=2),
        **changes,
    )


def rows(scans, seed=1):
    """Two boats seen by a radar every second, and by a sonar at every third of these times: rows in alternation."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(scans):
        boats = np.array([[50.0 + 5.0 * (k % 40), 20.0], [300.0 - 4.0 * (k % 40), 80.0]]) + rng.normal(size=(2, 2))
        for x, y in boats:
            if rng.random() < 0.9:
                out.append({"time": float(k), "sensor": "radar", "x": x, "y": y})
            if k % 3 == 0:
                seen = {"range": float(np.hypot(x, y)), "bearing": float(np.arctan2(y, x))}
                out.append({"time": float(k), "sensor": "sonar", **seen})
    return out


def lines(scans, seed=1):
    """The same as lines, some of them spoiled, repeated, late, or without any row."""
    rng = np.random.default_rng(seed + 1)
    out = []
    for row in rows(scans, seed):
        line = json.dumps(row).encode()
        out.append(line)
        match rng.integers(40):
            case 0:
                out.append(line)  # a duplicate
            case 1:
                out.append(line[: rng.integers(len(line))])  # cut, or blank
            case 2:
                out.append(json.dumps({**row, "time": row["time"] - 5.0}).encode())  # late
            case 3:
                out.append(b'{"time": %r, "sensor": "radar"}' % row["time"])  # the radar looked
            case 4:
                out.append(b'{"time": %r, "sensor": "radar", "x": null, "y": null}' % row["time"])
            case 5:
                out.append(b'{"time": 1, "sensor": "lidar", "x": "\xff"}')
    return b"".join(line + b"\n" for line in out)


def encoded(records):
    return b"".join(json.dumps(record).encode() + b"\n" for record in records)


def follow(data=None, start=None, **changes):
    """A run over lines that are all there, in the current folder."""
    if data is not None:
        Path("in.ndjson").write_bytes(data)
    settings = {"out": "out.ndjson", "dead_letters": "dead.ndjson", "wait": False} | changes
    return live.follow("in.ndjson", tracker() if start is None else start, COLUMNS, **settings)


def found(name="out.ndjson"):
    return [json.loads(line) for line in Path(name).read_bytes().splitlines()]


def outputs():
    return [Path(name).read_bytes() for name in ("out.ndjson", "dead.ndjson")]


def assert_books(run, data):
    """Every line that is not blank is in one place."""
    assert run.rows_in + run.looks + sum(run.ignored.values()) == sum(bool(line.strip()) for line in data.split(b"\n"))
    ledger = run.ledger
    tracked = ledger.used + ledger.late + ledger.duplicate + sum(ledger.rejected.values())
    assert run.rows_in == tracked + sum(run.bad_lines.values()) + run.waiting
