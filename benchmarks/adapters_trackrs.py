"""trackrs in the peers' benchmark: one adapter per workload, in the form its README asks for."""

from __future__ import annotations

import numpy as np
from common import peer

import trackrs as tr


def blocks(dims: int, order: int) -> np.ndarray:
    """Return where the peers' states, axis by axis, have what trackrs keeps block by block."""
    return np.arange(dims * order).reshape(dims, order).T.ravel()


def linear(d: dict, history: str) -> tuple:
    """Return the Kalman filter of W1 and W3c, ready to run."""
    kf = tr.KalmanFilter(tr.LinearMotion(d["F"], d["Q"]), tr.LinearSensor(d["H"], d["R"]))
    start, times = tr.GaussianState(d["x0"], d["P0"], 0.0), np.arange(1.0, d["T"] + 1.0)
    return lambda: kf.run(times, d["Z"], initial=start, history=history)


@peer("W1", "trackrs", "trackrs", note="means and covariances of every step kept")
def _(d):
    return linear(d, "filtered"), lambda run: (run.means, run.covs[-1])


def batch(d: dict) -> tuple:
    """Return the Kalman filter of W2 with its start, its times and its measurements, tracks first."""
    dims = d["H"].shape[0]
    order = len(d["x0"]) // dims
    motion = tr.ConstantVelocity(dims, accel_psd=0.1) if order == 2 else tr.ConstantAcceleration(dims, jerk_psd=0.05)
    back = blocks(dims, order)
    start = tr.GaussianState(d["x0"][back], d["P0"][np.ix_(back, back)], 0.0)
    values = np.ascontiguousarray(d["Z"].transpose(1, 0, 2))
    return tr.KalmanFilter(motion, tr.PositionSensor(dims, std=1.0)), start, np.arange(1.0, d["T"] + 1.0), values, back


@peer("W2", "trackrs", "trackrs", note="one thread; all means out, tracks first")
def _(d):
    kf, start, times, values, back = batch(d)

    def means(run):
        return run.means[:, :, np.argsort(back)].transpose(1, 0, 2)

    return lambda: kf.run_batch(times, values, initial=start, threads=1), means


@peer("W2", "trackrs(covariances)", "trackrs", note="one thread; all means and covariances out")
def _(d):
    kf, start, times, values, back = batch(d)

    def means(run):
        return run.means[:, :, np.argsort(back)].transpose(1, 0, 2)

    return lambda: kf.run_batch(times, values, initial=start, covs=True, threads=1), means


@peer("W2", "trackrs(resident)", "trackrs", note="one thread; scan by scan, only the last means out")
def _(d):
    kf, start, times, _, back = batch(d)
    scans = [np.ascontiguousarray(scan) for scan in d["Z"]]

    def run():
        tracks = tr.TrackBatch(kf, np.tile(start.mean, (d["B"], 1)), start.cov, threads=1)
        for time, scan in zip(times, scans, strict=True):
            tracks.step(time, scan)
        return tracks.means

    def means(found):
        # Of the last step alone there is something to compare.
        whole = d["Xr"].copy()
        whole[-1] = found[:, np.argsort(back)]
        return whole

    return run, means


@peer("W3c", "trackrs", "trackrs")
def _(d):
    run = linear(d, "full")
    return lambda: run().smooth(), lambda smoothed: smoothed.means


def ranges(d: dict, motion: tr.ConstantAcceleration, history: str, **options: object) -> tuple:
    """Return the extended filter of W3b, ready to run."""
    # The file that runs; importing it by its name would register its peers a second time.
    from __main__ import A3

    order = blocks(3, 3)
    ekf = tr.ExtendedKalmanFilter(motion, tr.RangeArray(A3, range_std=1.0, depth_std=0.5), **options)
    start = tr.GaussianState(d["x0"][order], d["P0"][np.ix_(order, order)], 0.0)
    times = 0.5 * np.arange(1, d["T"] + 1)
    return lambda: ekf.run(times, d["Z"], initial=start, history=history)


def w3b(history: str):
    def adapter(d):
        back = np.argsort(blocks(3, 3))

        def means(run):
            # Of the last state alone there is only the last row to compare.
            return np.concatenate([d["out"][: d["T"] - len(run)], run.means[:, back]])

        return ranges(d, tr.ConstantAcceleration(dims=3, jerk_psd=0.01), history), means

    return adapter


for _history in ("filtered", "last", "full"):
    peer("W3b", f"trackrs({_history})", "trackrs")(w3b(_history))


@peer(
    "W3b", "trackrs(adaptive)", "trackrs", note="noise estimated over a window of 20; another estimate, so not compared"
)
def _(d):
    motion = tr.ConstantAcceleration(dims=3, jerk_std=0.1)
    run = ranges(d, motion, "filtered", adapt=tr.LimitedMemoryNoise(window=20))
    return run, lambda _run: d["out"]


def w3(motion: tr.Motion, sensor: tr.Sensor, d: dict, form: str = "joseph") -> tuple:
    """Return the unscented filter of W3, ready to run."""
    ukf = tr.UnscentedKalmanFilter(motion, sensor, kappa=0.0, form=form)
    start, times = tr.GaussianState(d["x0"], d["P0"], 0.0), 0.1 * np.arange(1.0, d["T"] + 1.0)
    return lambda: ukf.run(times, d["Z"], initial=start, history="filtered"), lambda run: run.means


@peer("W3", "trackrs", "trackrs", note="linear models: the Kalman filter that it equals, no points drawn")
def _(d):
    return w3(tr.LinearMotion(d["F"], d["Q"]), tr.LinearSensor(d["H"], d["R"]), d)


@peer("W3", "trackrs(square root)", "trackrs", note="the same in square-root form")
def _(d):
    return w3(tr.LinearMotion(d["F"], d["Q"]), tr.LinearSensor(d["H"], d["R"]), d, "square_root")


@peer("W3", "trackrs(callback)", "trackrs", note="vectorised Python functions, points drawn for each of them")
def _(d):
    turned = d["F"].T.copy()
    motion = tr.CustomMotion(lambda x, _dt: x @ turned, d["Q"], labels=[f"x{i}" for i in range(18)])
    return w3(motion, tr.CustomSensor(lambda x: x[:, 0::3], d["R"]), d)


@peer("W5lof", "trackrs", "trackrs")
def _(d):
    lof = tr.LocalOutlierFactor(20, include_ties=False)
    return lambda: lof.scores(d["X"]), lambda scores: scores


@peer("W5dbscan", "trackrs", "trackrs")
def _(d):
    dbscan = tr.DbscanPartition(d["eps"], d["min_samples"])
    return lambda: dbscan.fit_predict(d["X"]), lambda labels: labels


@peer("W5kmeans", "trackrs", "trackrs", note="to convergence, at most 100 iterations")
def _(d):
    kmeans = tr.KMeansPartition(d["k"])

    def centred(labels):
        centres = np.array([d["X"][labels == label].mean(0) for label in range(labels.max() + 1)])
        return centres, labels

    return lambda: kmeans.fit_predict(d["X"]), centred


def w5dpeaks(kernel: str, kind: str):
    def adapter(d):
        # Cells are found too, which the peers leave out.
        peaks = tr.DensityPeakPartition(d["dc"], kernel=kernel, peaks=d["k"])
        return lambda: peaks.explain(d["X"]), lambda g: (kind, g.rho, g.delta, g.d_c)

    return adapter


for _kernel, _kind in (("cutoff", "cut"), ("gaussian", "gauss")):
    peer("W5dpeaks", f"trackrs({_kernel})", "trackrs", note="any kernel in O(n) memory")(w5dpeaks(_kernel, _kind))


@peer("W8ospa", "trackrs", "trackrs")
def _(d):
    return lambda: tr.ospa(d["X"], d["Y"], c=100.0, p=2.0), lambda r: r.total


@peer("W8gospa", "trackrs", "trackrs")
def _(d):
    return lambda: tr.gospa(d["X"], d["Y"], c=100.0, p=2.0), lambda r: r.total


@peer("W9", "trackrs", "trackrs")
def _(d):
    return lambda: tr.assign(d["D"]), lambda r: (np.arange(len(r.columns)), r.columns)


@peer("W6", "trackrs", "trackrs", note="exact")
def _(d):
    return lambda: tr.association.marginals(d["L"]), lambda r: r.probabilities


@peer("W7", "trackrs", "trackrs", note="one step: intake, prediction, update, reduction, labels, tracks")
def _(d):
    order, side = blocks(2, 2), np.ix_(blocks(2, 2), blocks(2, 2))
    phd = tr.GMPHD(
        tr.LinearMotion(d["F"][side], d["Q"][side]),
        tr.LinearSensor(d["H"][:, order], d["R"]),
        birth=tr.Birth([]),
        clutter_density=d["kappa"],
        survival_probability=0.99,
        detection_probability=0.95,
        gate=tr.Gate(-np.expm1(-8.0)),
        max_components=d["cap"],
    )
    states = [tr.GaussianState(m[order], P[side], 0.0) for m, P in zip(d["m"], d["P"], strict=True)]
    saved = phd.start(states, weights=d["w"]).to_bytes()
    scan = tr.Scan(1.0, d["Z"], sensor="radar")

    # A tracker has a memory: every repetition gets one that stands at the prior, as the peers get their components.
    ready = [tr.IntensityTracker.from_bytes(saved) for _ in range(300)]

    def run():
        tracker = ready.pop() if ready else tr.IntensityTracker.from_bytes(saved)
        return tracker.step(scan)

    def answer(tracks):
        # The weight before pruning is that of a step that prunes nothing, because merging keeps it. Not timed.
        unpruned = phd.replace(prune=0.0, max_components=10_000).start(states, weights=d["w"]).step(scan)
        return unpruned.expected_targets[0], None, tracks.expected_targets[0]

    return run, answer


@peer("W5two", "trackrs", "trackrs", note="outlier factor and partition in two calls")
def _(d):
    noise, lof, two_level = d["scene"].sensor.noise(), tr.LocalOutlierFactor(4), tr.TwoLevelPartition()

    def run():
        inside = lof.fit_predict(d["X"], noise=noise) > 0
        labels = np.full(len(inside), -1)
        labels[inside] = two_level.fit_predict(d["X"][inside], noise=noise)
        return labels

    return run, lambda labels: labels


@peer("W5dist", "trackrs", "trackrs")
def _(d):
    noise, distance = d["scene"].sensor.noise(), tr.DistancePartition("difference")
    return lambda: distance.partitions(d["X"], noise=noise), lambda found: list(found.labels)


@peer("W7ext", "trackrs", "trackrs", note="a tracker read from bytes takes the scan; reading is timed too")
def _(d):
    scene = d["scene"]
    tracker = tr.ExtendedGMPHD(
        scene.motion,
        scene.sensor,
        birth=tr.Birth(scene.births, scene.birth_weight),
        detections_per_target=scene.detections_per_target,
        clutter_density=scene.clutter_density,
    ).start()
    tracker.run(d["before"])
    saved, kind = tracker.to_bytes(), type(tracker)
    return lambda: kind.from_bytes(saved).step(d["scan"]), lambda tracks: tracks


@peer("W10kf", "trackrs", "trackrs", note="GNN, 3 hits in a row to confirm, 5 misses to end, as the hand-written one")
def _(d):
    tracker = tr.MultiTargetTracker(
        tr.ConstantVelocity(2, accel_psd=d["Q"][1, 1]),
        sensors={"radar": tr.PositionSensor(2, std=np.sqrt(d["R"][0, 0]))},
        initiator=tr.MofN(3, 3, max_speed=30.0),
        detection_probability=0.95,
        deletion=tr.Deletion(max_misses=5),
    )
    found = []

    def step(t, reports):
        found[:] = [tracker.step(tr.Scan(t + 1.0, reports, sensor="radar"))]

    return step, lambda: found[0].means[:, :2]


@peer("W4full", "trackrs", "trackrs", note="output buffer reused")
def _(d):
    out = np.empty((d["T"], d["M"]))
    return lambda: tr.squared_distances(d["zp"], d["S"], d["Z"], out=out), lambda r: r


@peer("W4gated", "trackrs", "trackrs", note="grid")
def _(d):
    gate = tr.Gate(0.99)
    return (
        lambda: gate.pairs(d["zp"], d["S"], d["Z"]),
        lambda r: (r.tracks, r.reports, r.distances, d["T"]),
    )
