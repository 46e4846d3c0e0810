"""PHD and CPHD filters for point targets."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import trackrs as tr

PS, PD, GATE, PRUNE, U = 0.97, 0.92, 0.9995, 1e-5, 4.0
KAPPA = 20.0 / 1000.0**2


def textbook(weights, means, covs, points, births, model):
    """One step as Vo and Ma (2006) print it: their tables I to III in NumPy, all components with all measurements."""
    f, q, h, r, gate = model
    w = np.concatenate([PS * weights, births[0]])
    m = np.concatenate([means @ f.T, births[1]])
    p = np.concatenate([f @ covs @ f.T + q, births[2]]) if len(weights) else births[2]
    out_w, out_m, out_p = [(1 - PD) * w], [m], [p]
    s = h @ p @ h.T + r
    k = p @ h.T @ np.linalg.inv(s)
    updated = p - k @ h @ p
    for z in points:
        e = z - m @ h.T
        d2 = np.einsum("ji,jik,jk->j", e, np.linalg.inv(s), e)
        density = np.exp(-0.5 * d2) / np.sqrt(np.linalg.det(2 * np.pi * s)) * (d2 <= gate)
        share = PD * w * density
        out_w.append(share / (KAPPA + share.sum()))
        out_m.append(m + np.einsum("jab,jb->ja", k, e))
        out_p.append(updated)
    w, m, p = np.concatenate(out_w), np.concatenate(out_m), np.concatenate(out_p)
    keep = w > PRUNE
    w, m, p = w[keep], m[keep], p[keep]
    left, merged = list(range(len(w))), []
    while left:
        j = max(left, key=lambda i: (w[i], -i))
        group = [i for i in left if (m[i] - m[j]) @ np.linalg.solve(p[i], m[i] - m[j]) <= U]
        left = [i for i in left if i not in group]
        total = w[group].sum()
        mean = w[group] @ m[group] / total
        e = m[group] - mean
        cov = np.einsum("i,iab->ab", w[group], p[group] + e[:, :, None] * e[:, None, :]) / total
        merged.append((total, mean, cov))
    return tuple(np.array(column) for column in zip(*merged, strict=True))


def births():
    cov = np.diag([100.0, 100.0, 10.0, 10.0]) ** 2
    return [tr.GaussianState([x, y, 0.0, 0.0], cov, time=0.0) for x, y in ((250, 250), (750, 250), (500, 750))]


def scene(seed, scans=25, targets=4):
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform(200, 800, (targets, 2)), rng.normal(0, 8, (targets, 2))], axis=1)
    out = []
    for t in range(scans):
        seen = x[rng.random(targets) < PD, :2]
        points = seen + 10.0 * rng.standard_normal(seen.shape)
        points = np.concatenate([points, rng.uniform(0, 1000, (rng.poisson(20), 2))])
        out.append(tr.Scan(float(t), points[rng.permutation(len(points))], sensor="radar"))
        x[:, :2] += x[:, 2:]
    return out


def make(kind=tr.GMPHD, **changes):
    arguments = {
        "birth": tr.Birth(births(), 0.05),
        "clutter_density": KAPPA,
        "survival_probability": PS,
        "detection_probability": PD,
        "gate": tr.Gate(GATE),
        "prune": PRUNE,
        "merge": U,
        "max_components": 1000,
    }
    motion, sensor = tr.ConstantVelocity(dims=2, accel_psd=0.5), tr.PositionSensor(dims=2, std=10.0)
    return kind(motion, sensor, **(arguments | changes))


def test_every_step_is_the_textbooks():
    phd = make()
    motion = phd.motion
    gate = -2.0 * np.log1p(-GATE)
    model = (motion.transition(1.0), motion.noise(1.0), np.eye(2, 4), 100.0 * np.eye(2), gate)
    born = (np.full(3, 0.05), np.array([b.mean for b in births()]), np.array([b.cov for b in births()]))
    tracker = phd.start()
    weights, means, covs = np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4))
    for scan in scene(1):
        weights, means, covs = textbook(weights, means, covs, scan.values, born, model)
        tracker.step(scan)
        found = tracker.mixture
        # Copies of one component stand apart here, because each has a label of its own.
        whole = {}
        for w, m, p in zip(found.weights, found.means, found.covs, strict=True):
            total, _, _ = whole.get(m.tobytes(), (0.0, m, p))
            whole[m.tobytes()] = (total + w, m, p)
        assert len(whole) == len(weights)
        left = list(whole.values())
        for w, m, p in zip(weights, means, covs, strict=True):
            at = min(range(len(left)), key=lambda i: np.abs(left[i][1] - m).sum() + abs(left[i][0] - w))
            total, mean, cov = left.pop(at)
            np.testing.assert_allclose(total, w, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(mean, m, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(cov, p, rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("kind", [tr.GMPHD, tr.CPHD])
def test_targets_are_found_and_keep_their_ids(kind):
    tracks = make(kind).run(scene(3, scans=40))
    assert len(tracks.of_scan(39)) == 4
    assert abs(tracks.expected_targets[-5:].mean() - 4) < 0.5
    last = {track.id for track in tracks.of_scan(39)}
    assert len(last & {track.id for track in tracks.of_scan(25)}) >= 3


@pytest.mark.parametrize("kind", [tr.GMPHD, tr.CPHD])
def test_scan_by_scan_is_the_run(kind):
    scans = scene(5)
    whole = make(kind).run(scans)
    tracker = make(kind).start()
    for k, scan in enumerate(scans):
        step = tracker.step(scan)
        assert [t.id for t in step] == [t.id for t in whole.of_scan(k)]
        expected = [t.state.mean for t in whole.of_scan(k)]
        assert np.array_equal(step.means, np.reshape(expected, (-1, 4)))
        tracker = pickle.loads(pickle.dumps(tracker))
    assert tracker.ledger.rows_in == sum(len(scan.values) for scan in scans)


def test_the_cardinality_is_a_distribution_with_the_mass_as_mean():
    tracker = make(tr.CPHD, max_targets=30, prune=0.0, max_components=100_000, merge=1e-9).start()
    for scan in scene(4, scans=4):
        tracker.step(scan)
        rho = tracker.cardinality
        assert rho.shape == (31,)
        np.testing.assert_allclose(rho.sum(), 1.0, rtol=1e-12)
        np.testing.assert_allclose(rho @ np.arange(31), tracker.mixture.weights.sum(), rtol=1e-6)
    assert make().start().cardinality is None


def test_several_sensors_take_turns():
    sensors = {"radar": tr.PositionSensor(dims=2, std=10.0), "sonar": tr.RangeBearing((0, 0), 10.0, 0.01)}
    phd = make(sensor_set := tr.GMPHD)
    phd = sensor_set(
        phd.motion,
        sensors,
        birth=tr.Birth(births(), 0.05),
        clutter_density={"radar": 1e-6, "sonar": 1e-3},
        detection_probability={"radar": 0.9, "sonar": 0.7},
    )
    scans = []
    for t in range(10):
        x = np.array([250.0 + 5.0 * t, 250.0])
        scans.append(tr.Scan(float(t), [x], sensor="radar"))
        scans.append(tr.Scan(float(t), [[np.hypot(*x), np.arctan2(x[1], x[0])]], sensor="sonar"))
    tracks = phd.run(scans)
    (track,) = tracks.of_scan(19)
    np.testing.assert_allclose(track.state.mean[:2], [295.0, 250.0], atol=5.0)
    with pytest.raises(tr.UnknownSensorError, match="lidar"):
        phd.run([tr.Scan(0.0, [[0.0, 0.0]], sensor="lidar")])


@pytest.mark.parametrize("kind", [tr.GMPHD, tr.CPHD])
def test_known_targets_are_there_from_the_beginning(kind):
    states = [tr.GaussianState([300.0 * i, 100.0, 0.0, 0.0], np.eye(4), time=3.0) for i in (1, 2, 3)]
    tracker = make(kind, birth=tr.Birth([]), confirm_after=1).start(states, weights=[1.0, 1.0, 0.2])
    tracks = tracker.step(tr.Scan(4.0, [[300.0, 100.0], [600.0, 100.0]], sensor="radar"))
    assert len(tracks) == 2
    with pytest.raises(tr.TimeError):
        tracker.run([tr.Scan(3.0, [], sensor="radar")])
    with pytest.raises(tr.ParameterError, match="2 different times"):
        make(kind).start([states[0], tr.GaussianState(states[1].mean, np.eye(4), time=4.0)])
    with pytest.raises(tr.DimensionError, match="initial weights"):
        make(kind).start(states, weights=[1.0])


@pytest.mark.parametrize("kind", [tr.GMPHD, tr.CPHD])
@pytest.mark.parametrize(
    "changes",
    [
        {"detection_probability": 1.0},
        {"survival_probability": 0.0},
        {"survival_probability": 1.0},
        {"clutter_density": 0.0},
        {"birth": tr.Birth([])},
        {"birth": tr.Birth([tr.GaussianState([0, 0, 0, 0], np.eye(4), time=0.0)], 5.0)},
        {"birth": tr.AdaptiveBirth(0.02, max_speed=30.0, min_measurements=1)},
        {"gate": tr.Gate(1.0)},
    ],
)
def test_edges_are_defined(kind, changes):
    scans = [*scene(2, scans=6), tr.Scan(6.0, [], sensor="radar"), tr.Scan(7.0, [], sensor="radar")]
    tracks = make(kind, **changes).run(scans)
    assert np.isfinite(tracks.expected_targets).all()
    assert (tracks.expected_targets >= 0).all()


def test_ten_thousand_detections():
    rng = np.random.default_rng(0)
    scans = [tr.Scan(float(t), rng.uniform(0, 1000, (10_000, 2)), sensor="radar") for t in range(2)]
    for kind in (tr.GMPHD, tr.CPHD):
        found = make(kind, clutter_density=1e-2, max_components=200).run(scans)
        assert np.isfinite(found.expected_targets).all()


@pytest.mark.parametrize(
    ("changes", "culprit"),
    [
        ({"survival_probability": 1.2}, "survival_probability"),
        ({"detection_probability": 0.0}, "detection_probability"),
        ({"clutter_density": -1.0}, "clutter_density"),
        ({"max_components": 0}, "max_components"),
        ({"confirm_after": 0}, "confirm_after"),
        ({"birth": tr.Birth(births(), [0.1, 0.2])}, "birth weights"),
        ({"birth": tr.Birth([tr.GaussianState([0, 0], np.eye(2), time=0.0)])}, "birth state"),
        ({"birth": tr.AdaptiveBirth(0.1, max_speed=-1.0)}, "max_speed"),
        ({"prune": -1.0}, "prune"),
        ({"clutter_density": {"radar": 1.0}}, "clutter_density"),
    ],
)
def test_bad_arguments_name_themselves(changes, culprit):
    with pytest.raises(tr.TrackrsError, match=culprit):
        make(**changes)
    with pytest.raises(tr.TrackrsError, match="max_targets"):
        make(tr.CPHD, max_targets=0)
