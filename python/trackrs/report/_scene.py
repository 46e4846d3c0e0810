"""A scene as numbers for the page: positions as 32-bit offsets from its centre, which keep millimetres within 10 km."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trackrs.plot.tracks import scan_positions
from trackrs.report.sections import finite
from trackrs.sensor import PositionSensor, RangeBearing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from trackrs._arrays import FloatArray, IntArray
    from trackrs.motion import Motion
    from trackrs.report.sections import Scene
    from trackrs.sensor import Sensor
    from trackrs.types import Tracks

KINDS = {"f32": "<f4", "f64": "<f8", "i32": "<i4"}


def packed(values: ArrayLike, kind: str) -> dict[str, str]:
    """Return an array as base64 of little-endian numbers: a third longer than the bytes, and any browser reads it."""
    return {kind: base64.b64encode(np.ascontiguousarray(values, dtype=KINDS[kind]).tobytes()).decode("ascii")}


def scene_data(scene: Scene) -> dict[str, Any]:
    """Return everything that the page draws of a scene; the first axis is the one to the right."""
    tracks = scene.tracks
    axes = [1, 0] if scene.swap_axes else [0, 1]
    means = finite(tracks.means[:, axes])
    truth = [finite(target.positions[:, axes]) for target in scene.truth]
    own = None if scene.own_ship is None else finite(np.asarray(scene.own_ship)[:, axes])
    detections = [scan_positions(scan, scene.sensors[scan.sensor]) for scan in scene.scans]
    found = [finite(part[:, axes]) for part in detections if part is not None]
    low, high = _bounds([means, *truth] if own is None else [means, *truth, own], found)
    centre = (low + high) / 2.0
    names, sensor_of_scan = np.unique(np.array(tracks.sensors, dtype=np.str_), return_inverse=True)
    ids, track_of_row = np.unique(tracks.ids, return_inverse=True)
    data: dict[str, Any] = {
        "axes": [scene.labels[k] for k in axes],
        "centre": centre.tolist(),
        "bounds": [*(low - centre).tolist(), *(high - centre).tolist()],
        "times": packed(tracks.scan_times, "f64"),
        "sensors": names.tolist(),
        "scanSensor": packed(sensor_of_scan, "i32"),
        "offsets": packed(tracks.offsets, "i32"),
        "ids": [str(i) for i in ids],
        "track": packed(track_of_row, "i32"),
        "position": packed(means - centre, "f32"),
        "speed": packed(speeds(tracks), "f32"),
        "cov": packed(_triangles(tracks.covs, axes), "f32"),
        "age": packed(tracks.times - tracks.last_hits, "f32"),
        "hits": packed(np.minimum(tracks.hits, 2**31 - 1), "i32"),
        "gateProbability": scene.gate,
        "gate": None,
        "extent": None if tracks.extents is None else packed(_triangles(tracks.extents, axes), "f32"),
        "detections": None,
        "truth": [
            {"id": target.id, "times": packed(target.times, "f64"), "position": packed(path - centre, "f32")}
            for target, path in zip(scene.truth, truth, strict=True)
        ],
        "own": None if own is None else packed(own - centre, "f32"),
        "region": scene.region,
    }
    if scene.motion is not None:
        gates = _gates(scene, scene.motion)
        data["gate"] = packed(np.hstack([gates.centres[:, axes] - centre, _triangles(gates.covs, axes)]), "f32")
    if scene.scans:
        counts = [0 if part is None else len(part) for part in detections]
        points = np.concatenate([*found, np.zeros((0, 2))]) - centre
        data["detections"] = {
            "offsets": packed(np.concatenate([[0], np.cumsum(counts)]), "i32"),
            "position": packed(points, "f32"),
        }
    return data


def speeds(tracks: Tracks) -> FloatArray:
    """Return the speed in the plane of every row (N,), m/s; NaN where the state has no velocity."""
    names = [f"v{label}" for label in tracks.labels[:2]]
    if not set(names) <= set(tracks.labels):
        return np.full(len(tracks), np.nan)
    velocities = finite(tracks.means[:, [tracks.labels.index(name) for name in names]])
    return np.asarray(np.hypot(velocities[:, 0], velocities[:, 1]), dtype=np.float64)


def track_rows(tracks: Tracks) -> list[list[object]]:
    """Return the table of tracks: id, first and last time, scans, reports, mean speed, status."""
    last_scan = int(tracks.offsets[-2]) if len(tracks.offsets) > 1 else 0
    every_speed = speeds(tracks)
    out: list[list[object]] = []
    for number, rows in _rows_by_track(tracks).items():
        speed = every_speed[rows]
        known = speed[~np.isnan(speed)]
        mean = float(known.mean()) if len(known) else None
        status = "ended" if rows[-1] < last_scan else "active"
        first, last = float(tracks.times[rows[0]]), float(tracks.times[rows[-1]])
        out.append([str(number), first, last, len(rows), int(tracks.hits[rows[-1]]), mean, status])
    return out


def _rows_by_track(tracks: Tracks) -> dict[int, IntArray]:
    """The rows of every track in the order of time, by id."""
    ids, begin = np.unique(np.sort(tracks.ids), return_index=True)
    rows = np.split(np.argsort(tracks.ids, kind="stable"), begin[1:])
    return dict(zip(ids.tolist(), rows, strict=False))


def _bounds(paths: list[FloatArray], found: list[FloatArray]) -> FloatArray:
    """Lowest and highest coordinates (2, 2) of tracks, truth and own ship, else of the detections: what opens."""
    for choice in (paths, found):
        points = np.concatenate([*choice, np.zeros((0, 2))])
        points = points[~np.isnan(points).any(axis=1)]
        if len(points):
            low, high = points.min(axis=0), points.max(axis=0)
            margin = 0.06 * max(float((high - low).max()), 1.0)
            return np.stack([low - margin, high + margin])
    return np.array([[-1.0, -1.0], [1.0, 1.0]])


def _triangles(covs: FloatArray, axes: Sequence[int]) -> FloatArray:
    """Variance, covariance and variance of two axes (N, 3)."""
    i, j = axes
    return finite(np.stack([covs[:, i, i], covs[:, i, j], covs[:, j, j]], axis=1).reshape(-1, 3))


@dataclass(frozen=True, slots=True, eq=False)
class _Gates:
    """Where the gates are (N, 2), and the covariances whose 1-sigma ellipses they are (N, 2, 2)."""

    centres: FloatArray
    covs: FloatArray


def _gates(scene: Scene, motion: Motion) -> _Gates:
    """The gate of every row, about the position predicted from the row before of its track; NaN in its first.

    Tracks keep what came after the reports, so the prediction is made again.
    """
    tracks = scene.tracks
    means, states = finite(tracks.means), finite(tracks.covs)
    before = np.full(len(tracks), -1, dtype=np.int64)
    for rows in _rows_by_track(tracks).values():
        before[rows[1:]] = rows[:-1]
    centres, covs = np.full((len(tracks), 2), np.nan), np.full((len(tracks), 2, 2), np.nan)
    known = np.flatnonzero(before >= 0)
    steps, group = np.unique(tracks.times[known] - tracks.times[before[known]], return_inverse=True)
    for k, dt in enumerate(steps.tolist()):
        rows = known[group == k]
        transition, noise = motion.transition(dt)[:2], motion.noise(dt)[:2, :2]
        centres[rows] = means[before[rows]] @ transition.T
        covs[rows] = transition @ states[before[rows]] @ transition.T + noise
    scan_of_row = np.repeat(np.arange(len(tracks.sensors)), np.diff(tracks.offsets))
    sensor_of_row = np.array(tracks.sensors, dtype=np.str_)[scan_of_row]
    for name, sensor in scene.sensors.items():
        rows = known[sensor_of_row[known] == name]
        covs[rows] += _report_covs(scene, sensor, scan_of_row[rows], centres[rows])
    # The threshold of a chi-square with two degrees of freedom has a closed form.
    return _Gates(finite(centres), finite(-2.0 * np.log1p(-scene.gate) * covs))


def _report_covs(scene: Scene, sensor: Sensor, scan_of_row: IntArray, positions: FloatArray) -> FloatArray:
    """Covariance in the plane of a sensor's report of targets there; zero where it does not report positions."""
    if isinstance(sensor, PositionSensor):
        return sensor.noise()[:2, :2]
    if not isinstance(sensor, RangeBearing):
        return np.zeros((2, 2))
    platforms = [scan.platform for scan in scene.scans] or [None] * len(scene.tracks.sensors)
    moved = np.array([np.zeros(2) if where is None else where[:2] for where in platforms])[scan_of_row]
    x, y = (positions - moved - np.asarray(sensor.position)).reshape(-1, 2).T
    reach = np.maximum(np.hypot(x, y), 1e-9)
    # Derivative of the position by range and bearing.
    turns = np.stack([np.stack([x / reach, -y], axis=1), np.stack([y / reach, x], axis=1)], axis=1)
    return np.asarray(turns @ sensor.noise() @ turns.transpose(0, 2, 1), dtype=np.float64)
