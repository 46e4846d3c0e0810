"""Runs per second of three Monte-Carlo studies against the same ones written by hand in NumPy, and of 2 threads over 1.

    python benchmarks/study_speed.py [--runs 200] [--repeats 3]

The rewritings are what a careful engineer writes in plain NumPy: NPDA and the underwater filter have a leading axis for
the runs, and compute one run after the other or all at once; the PHD filter, whose mixture differs from run to run, is
vectorised over its components. They draw their own random numbers, and do no more than the study needs: no events, no
books, no gaps. Both sides end with the same metric, whose means must agree within their intervals. One core each: BLAS
has one thread.
"""

from __future__ import annotations

import argparse
import os
import time
from itertools import permutations

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402 (after the number of threads is set)

import trackrs as tr  # noqa: E402
from trackrs.study._statistics import summarise  # noqa: E402

C = 60.0


def transpose(matrices):
    return np.swapaxes(matrices, -1, -2)


# --- NPDA: three targets side by side, one report at a time ----------------------------------------------------------


def npda_study():
    scene = tr.scenarios.close_targets()
    tracker = tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_std=2.0),
        sensors={"radar": scene.radar},
        initiator=tr.MofN(3, 5, max_speed=150.0),
        associator=tr.NPDA(),
        gate=tr.Gate(1.0),
        deletion=tr.Deletion(max_misses=100),
        initial=scene.initial,
    )
    return tr.Study(scene, {"npda": tracker}, [tr.OSPA(c=C)]), "ospa", npda_by_hand


def npda_by_hand(runs, rng):
    targets, reports, dt, std = 3, 60, 3.0, np.array([20.0, 1e-3])
    F = np.eye(4) + dt * np.eye(4, k=2)
    G = np.vstack([0.5 * dt**2 * np.eye(2), dt * np.eye(2)])
    Q, R = 4.0 * G @ G.T, np.diag(std**2)
    truth = np.array([[500.0, 1000.0 + 300.0 * i, 100.0, 0.0] for i in range(targets)])
    x = np.tile(truth, (runs, 1, 1))
    P = np.tile(np.diag([100.0, 100.0, 9.0, 9.0]), (runs, targets, 1, 1))
    orders = np.array(list(permutations(range(targets))))
    scores = np.empty((runs, reports))
    H = np.zeros((runs, targets, 2, 4))
    for k in range(reports):
        truth = truth @ F.T
        px, py = truth[k % targets, :2]
        z = np.array([np.hypot(px, py), np.arctan2(py, px)]) + std * rng.standard_normal((runs, 2))
        x, P = x @ F.T, F @ P @ F.T + Q
        range_ = np.hypot(x[..., 0], x[..., 1])
        H[..., 0, :2] = x[..., :2] / range_[..., None]
        H[..., 1, 0], H[..., 1, 1] = -x[..., 1] / range_**2, x[..., 0] / range_**2
        nu = z[:, None] - np.stack([range_, np.arctan2(x[..., 1], x[..., 0])], axis=-1)
        nu[..., 1] = (nu[..., 1] + np.pi) % (2.0 * np.pi) - np.pi
        PHt = P @ transpose(H)
        S = H @ PHt + R
        weighted = np.linalg.solve(S, nu[..., None])
        log_weights = -0.5 * ((nu[..., None] * weighted).sum(axis=(-1, -2)) + np.log(np.linalg.det(S)))
        beta = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))
        beta /= beta.sum(axis=1, keepdims=True)
        K = transpose(np.linalg.solve(S, transpose(PHt)))
        step = (K @ nu[..., None])[..., 0]
        x = x + beta[..., None] * step
        share, spread = beta[..., None, None], (beta * (1.0 - beta))[..., None, None]
        P = P - share * (K @ S @ transpose(K)) + spread * step[..., None] * step[..., None, :]
        squares = np.minimum(((x[:, None, :, :2] - truth[None, :, None, :2]) ** 2).sum(axis=-1), C**2)
        totals = squares[:, np.arange(targets), orders].sum(axis=-1).min(axis=1)
        scores[:, k] = np.sqrt(totals / targets)
    return scores.mean(axis=1)


# --- underwater: a manoeuvring vessel heard by three hydrophones and a depth gauge -----------------------------------

FIRST = 20


def underwater_study():
    scene = tr.scenarios.underwater("bats")
    ekf = tr.ExtendedKalmanFilter(tr.ConstantAcceleration(dims=3, jerk_std=0.05), scene.array)
    study = tr.Study(scene, {"ekf": ekf}, [tr.study.PositionError(first=FIRST)])

    def by_hand(runs, rng):
        return underwater_by_hand(scene, runs, rng)

    return study, "error", by_hand


def underwater_by_hand(scene, runs, rng):
    times, truth, places = scene.times, scene.truth, np.asarray(scene.array.hydrophones)
    m, eye = len(places), np.eye(3)
    ranges = np.linalg.norm(truth[:, None, :3] - places, axis=2)
    exact = np.concatenate([ranges, truth[:, 2:3]], axis=1)
    std = np.array([1.0] * m + [0.3])
    z = exact + std * rng.standard_normal((runs, *exact.shape))
    R = np.diag(std**2)

    def observed(p):
        away = p[:, None] - places
        distances = np.linalg.norm(away, axis=2)
        H = np.zeros((len(p), m + 1, p.shape[1]))
        H[:, :m] = away / distances[..., None]
        H[:, m, 2] = 1.0
        return np.concatenate([distances, p[:, 2:3]], axis=1), H

    # Fixes of the first three epochs by least squares, and a parabola through them.
    fixes = []
    for k in range(3):
        p = np.tile(places.mean(axis=0) + np.array([100.0, 100.0, 0.0]), (runs, 1)) if not fixes else fixes[-1].copy()
        p[:, 2] = z[:, k, m]
        for _ in range(12):
            expected, H = observed(p)
            p = p + normal(H, z[:, k] - expected, std)
        fixes.append(p)
    x = np.concatenate([fixes[2], 1.5 * fixes[2] - 2.0 * fixes[1] + 0.5 * fixes[0], np.zeros((runs, 3))], axis=1)
    P = np.tile(np.diag([4.0] * 3 + [16.0] * 3 + [1.0] * 3), (runs, 1, 1))
    errors = np.empty((runs, len(times)))
    zero = np.zeros((runs, m + 1, 6))
    for k in range(3, len(times)):
        dt = times[k] - times[k - 1]
        F = np.block([[eye, dt * eye, 0.5 * dt**2 * eye], [0 * eye, eye, dt * eye], [0 * eye, 0 * eye, eye]])
        G = np.vstack([dt**3 / 6.0 * eye, 0.5 * dt**2 * eye, dt * eye])
        x, P = x @ F.T, F @ P @ F.T + 0.05**2 * G @ G.T
        expected, H = observed(x[:, :3])
        H = np.concatenate([H, zero], axis=2)
        PHt = P @ transpose(H)
        S = H @ PHt + R
        K = transpose(np.linalg.solve(S, transpose(PHt)))
        x = x + (K @ (z[:, k] - expected)[..., None])[..., 0]
        rest = np.eye(9) - K @ H
        P = rest @ P @ transpose(rest) + K @ R @ transpose(K)
        errors[:, k] = np.linalg.norm(x[:, :3] - truth[k, :3], axis=1)
    return np.sqrt((errors[:, FIRST:] ** 2).mean(axis=1))


def normal(H, residual, std):
    """One step of weighted least squares."""
    A, b = H / std[:, None], residual / std
    return np.linalg.solve(transpose(A) @ A, transpose(A) @ b[..., None])[..., 0]


# --- extended targets: two side by side, distance partitions ---------------------------------------------------------


def extended_study():
    scene = tr.scenarios.parallel()
    phd = tr.ExtendedGMPHD(
        scene.motion,
        scene.sensor,
        birth=tr.Birth(scene.births, scene.birth_weight),
        detections_per_target=tr.DetectionRate(scene.detections_per_target, learnt=False),
        detection_probability=scene.detection_probability,
        clutter_density=scene.clutter_density,
        partition=tr.DistancePartition(),
        superposition=False,
        confirm_after=1,
    )
    study = tr.Study(scene, {"phd": phd}, [tr.OSPA(c=C)])

    def by_hand(runs, _rng):
        return np.array([extended_by_hand(scene, scene.draw(99, run).scans) for run in range(runs)])

    return study, "ospa", by_hand


def extended_by_hand(scene, scans):
    """GM-PHD filter for extended targets with distance partitions (Granström, Lundquist, Orguner 2012), one run."""
    rate, pd, ps = scene.detections_per_target, scene.detection_probability, 0.99
    sigma2, density = np.mean(np.square(scene.sensor.std)), scene.clutter_density
    dt = scene.times[1] - scene.times[0]
    F = np.eye(4) + dt * np.eye(4, k=2)
    G = np.vstack([0.5 * dt**2 * np.eye(2), dt * np.eye(2)])
    Q = 4.0 * G @ G.T
    births = (np.stack([b.mean for b in scene.births]), np.stack([b.cov for b in scene.births]))
    # Distances within which 30 to 80 % of the detections of a target lie: chi-square of 2 degrees of freedom.
    low, high = (np.sqrt(-2.0 * np.log(1.0 - p) * sigma2) for p in (0.3, 0.8))
    w, x, P = np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4))
    scores = np.empty(len(scans))
    for k, scan in enumerate(scans):
        w = np.concatenate([ps * w, np.full(len(births[0]), scene.birth_weight)])
        x = np.concatenate([x @ F.T, births[0]])
        P = np.concatenate([F @ P @ F.T + Q, births[1]])
        z = np.asarray(scan.values)
        missed = (1.0 - (1.0 - np.exp(-rate)) * pd) * w
        new_w, new_x, new_P = [missed], [x], [P]
        cells, partitions = distance_partitions(z, low, high)
        found, masses = [], np.empty(len(cells))
        for i, cell in enumerate(cells):
            n = len(cell)
            mean = z[cell].mean(axis=0)
            scatter = ((z[cell] - mean) ** 2).sum()
            S = P[:, :2, :2] + sigma2 / n * np.eye(2)
            nu = mean - x[:, :2]
            inverse = np.linalg.inv(S)
            distance = np.einsum("ji,jik,jk->j", nu, inverse, nu)
            # N(all of the cell) = N(mean) N(scatter): the stacked Gaussian, in O(1) of its size.
            logs = -0.5 * distance - 0.5 * np.log(np.linalg.det(S)) - np.log(2.0 * np.pi)
            logs += -(n - 1) * np.log(2.0 * np.pi * sigma2) - np.log(n) - 0.5 * scatter / sigma2
            logs += -rate + n * np.log(rate / density) + np.log(pd)
            weights = w * np.exp(np.minimum(logs, 700.0))
            masses[i] = np.log((n == 1) + weights.sum() + 1e-300)
            keep = np.flatnonzero(weights > 1e-6 * np.exp(masses[i]))
            K = P[keep][:, :, :2] @ inverse[keep]
            found.append(
                (
                    weights[keep] / np.exp(masses[i]),
                    x[keep] + (K @ nu[keep][..., None])[..., 0],
                    P[keep] - K @ P[keep][:, :2],
                )
            )
        if partitions:
            scores_of = np.array([masses[list(members)].sum() for members in partitions])
            omega = np.exp(scores_of - scores_of.max())
            omega /= omega.sum()
            share = np.zeros(len(cells))
            for o, members in zip(omega, partitions, strict=True):
                share[list(members)] += o
            for s, (weights, means, covs) in zip(share, found, strict=True):
                new_w.append(s * weights)
                new_x.append(means)
                new_P.append(covs)
        w, x, P = reduced(np.concatenate(new_w), np.concatenate(new_x), np.concatenate(new_P))
        estimates = np.repeat(x[w > 0.5, :2], np.round(w[w > 0.5]).astype(int), axis=0)
        scores[k] = pair_ospa(scene.states[k, :, :2], estimates)
    return scores.mean()


def distance_partitions(z, low, high):
    """All different partitions by linking points closer than some distance, as tuples of cells of one list."""
    count = len(z)
    if count == 0:
        return [], []
    apart = np.sqrt(((z[:, None] - z[None]) ** 2).sum(axis=-1))
    # Single linkage, by the edges of the minimum spanning tree (Prim).
    best, via, inside = apart[0].copy(), np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
    inside[0] = True
    edges = []
    for _ in range(count - 1):
        j = int(np.argmin(np.where(inside, np.inf, best)))
        edges.append((best[j], int(via[j]), j))
        inside[j] = True
        closer = apart[j] < best
        best[closer], via[closer] = apart[j][closer], j
    edges.sort()
    labels = list(range(count))
    groups = {i: [i] for i in range(count)}
    known, cells, partitions, at = {}, [], [], 0
    inner = sorted({low, *(edge[0] for edge in edges if low < edge[0] < high)})
    for threshold in inner:
        while at < len(edges) and edges[at][0] <= threshold:
            a, b = labels[edges[at][1]], labels[edges[at][2]]
            for i in groups[b]:
                labels[i] = a
            groups[a] = groups[a] + groups.pop(b)
            at += 1
        members = []
        for group in groups.values():
            key = frozenset(group)
            if key not in known:
                known[key] = len(cells)
                cells.append(np.array(group))
            members.append(known[key])
        partitions.append(tuple(members))
    return cells, partitions


def reduced(w, x, P):
    """Prune and merge."""
    keep = w > 1e-4
    w, x, P = w[keep], x[keep], P[keep]
    out = []
    while len(w) and len(out) < 100:
        j = int(np.argmax(w))
        gap = x - x[j]
        near = np.einsum("ji,ik,jk->j", gap, np.linalg.inv(P[j]), gap) <= 4.0
        total = w[near].sum()
        mean = w[near] @ x[near] / total
        away = x[near] - mean
        cov = np.einsum("j,jik->ik", w[near], P[near] + away[:, :, None] * away[:, None]) / total
        out.append((total, mean, cov))
        w, x, P = w[~near], x[~near], P[~near]
    if not out:
        return np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4))
    return np.array([o[0] for o in out]), np.stack([o[1] for o in out]), np.stack([o[2] for o in out])


def pair_ospa(truth, found):
    """OSPA of two targets, p = 2."""
    truth = truth[~np.isnan(truth[:, 0])]
    m, n = len(truth), len(found)
    if max(m, n) == 0:
        return 0.0
    small, large = (truth, found) if m <= n else (found, truth)
    squares = np.minimum(((small[:, None] - large[None]) ** 2).sum(axis=-1), C**2)
    best = min(squares[np.arange(len(small)), list(p)].sum() for p in permutations(range(len(large)), len(small)))
    return np.sqrt((best + C**2 * abs(m - n)) / max(m, n))


# --- the comparison --------------------------------------------------------------------------------------------------


def best_time(work, repeats, clock):
    """The shortest of some tries: what else runs on the machine only ever adds."""
    taken = []
    for _ in range(repeats):
        begun = clock()
        out = work()
        taken.append(clock() - begun)
    return min(taken), out


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    print(
        "| study | trackrs | NumPy, run by run | NumPy, all runs at once | 2 threads over 1 | mean, trackrs | NumPy |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, make, share, together in (
        ("NPDA", npda_study, 1, True),
        ("underwater", underwater_study, 1, True),
        ("extended", extended_study, 5, False),
    ):
        study, column, by_hand = make()
        hand = max(given.runs // share, 10)
        study.run(10, 7, workers=1)
        one, result = best_time(lambda s=study: s.run(given.runs, 7, workers=1), given.repeats, time.process_time)
        whole, values = best_time(
            lambda h=by_hand, n=hand: h(n, np.random.default_rng(8)), given.repeats, time.process_time
        )
        single = hand / whole
        if together:
            few = given.runs // 20
            alone, _ = best_time(
                lambda h=by_hand, n=few: [h(1, np.random.default_rng(k)) for k in range(n)],
                given.repeats,
                time.process_time,
            )
            single = few / alone
        wall = {}
        for workers in (1, 2):
            count = 4 * given.runs // share
            wall[workers], _ = best_time(
                lambda s=study, n=workers, r=count: s.run(r, 7, workers=n), given.repeats, time.perf_counter
            )
        mine, theirs = result.methods[0].summary(column), summarise(values)
        agree = abs(mine.mean - theirs.mean) <= np.hypot(mine.half_width, theirs.half_width)
        print(
            f"| {name} | {given.runs / one:,.0f} runs/s | {single:,.1f} runs/s "
            f"| {f'{hand / whole:,.0f} runs/s' if together else ''} | {wall[1] / wall[2]:.2f} "
            f"| {mine.mean:.3f} ±{mine.half_width:.2g} m "
            f"| {theirs.mean:.3f} ±{theirs.half_width:.2g} m{'' if agree else ' (differ)'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
