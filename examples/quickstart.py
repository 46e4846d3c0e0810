"""Five lines to tracks: two boats and some clutter, seen by one radar."""

import numpy as np

import trackrs as tr

# What the radar reports: two boats on straight courses, each seen nine times in ten, and two false echoes a scan.
rng = np.random.default_rng(7)
scans = []
for time in range(60):
    boats = np.array([[5.0 * time, 0.0], [300.0 - 4.0 * time, 80.0 + time]])
    seen = boats[rng.random(2) < 0.9]
    clutter = rng.uniform([-50.0, -100.0], [350.0, 250.0], size=(2, 2))
    scans.append(tr.Scan(time, np.vstack([seen + rng.normal(0.0, 2.0, seen.shape), clutter]), sensor="radar"))

# The five lines.
motion = tr.ConstantVelocity(dims=2, accel_psd=0.05)
radar = tr.PositionSensor(dims=2, std=2.0)
tracker = tr.MultiTargetTracker(motion, sensors={"radar": radar}, initiator=tr.MofN(4, 5, max_speed=10.0))
tracks = tracker.run(scans)
table = tracks.to_table()  # a dictionary of columns, for pandas, polars, pyarrow

print(f"{len(scans)} scans, {tracker.ledger.used} detections, {len(np.unique(table['track']))} tracks")
for track in tracks.at(59.0):
    x, y, vx, vy = track.state.mean
    sx, sy, _, _ = track.state.std
    print(f"track {track.id}: x {x:.1f} +- {sx:.1f} m, y {y:.1f} +- {sy:.1f} m, velocity ({vx:.1f}, {vy:.1f}) m/s")
