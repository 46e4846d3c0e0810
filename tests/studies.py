"""Small studies that several test files run."""

from __future__ import annotations

import trackrs as tr

RADAR = tr.scenarios.close_targets(clutter=0.1)


def tracker(scene=RADAR, **changes):
    settings = {"associator": tr.NPDA(clutter_probability=0.1), "gate": tr.Gate(1.0), "initial": scene.initial}
    return tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_std=2.0),
        sensors={"radar": scene.radar},
        initiator=tr.MofN(3, 5, max_speed=150.0),
        deletion=tr.Deletion(max_misses=100),
        **(settings | changes),
    )


def nearest(scene=RADAR):
    return tracker(scene, associator=tr.NearestNeighbour())


def close_study(scene=RADAR, **methods):
    metrics = [tr.OSPA(c=60.0), tr.study.Cardinality(), tr.study.Identity(150.0)]
    return tr.Study(scene, methods or {"npda": tracker(scene), "nearest": nearest(scene)}, metrics)


def phd(scene, **changes):
    return tr.ExtendedGMPHD(
        scene.motion,
        scene.sensor,
        birth=tr.Birth(scene.births, scene.birth_weight),
        detections_per_target=scene.detections_per_target,
        detection_probability=scene.detection_probability,
        clutter_density=scene.clutter_density,
        **changes,
    )


def angle_filter(scene, **changes):
    motion, sensor = tr.ConstantAcceleration(dims=1, jerk_psd=1.0), tr.PositionSensor(dims=1, std=scene.std)
    return tr.KalmanFilter(motion, sensor, **changes)
