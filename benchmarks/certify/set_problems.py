"""The certified problems of association, intensity filters, sets, points and numbers; see `filter_problems`."""

from __future__ import annotations

from random import Random

from filter_problems import HARD, NASTY, ORDINARY, diagonal


def _of(kind, name, difficulty, what, **given):
    return {"name": name, "kind": kind, "difficulty": difficulty, "what": what, "given": given}


def _association():
    rng = Random(19)  # noqa: S311
    weights = [[0.1, *(round(rng.expovariate(0.5), 4) for _ in range(5))] for _ in range(4)]
    weights[0][3] = weights[2][1] = 0.0
    yield _of("marginals", "jpda", ORDINARY, "4 tracks, 5 reports", weights=weights, log=False, prune=False)
    yield _of("marginals", "jpda_star", ORDINARY, "the same, pruned", weights=weights, log=False, prune=True)

    def power(low, high):
        return float(f"{10.0 ** rng.uniform(low, high):.4e}")

    wide = [[power(-4, 0), *(power(-8, 8) for _ in range(6))] for _ in range(7)]
    yield _of("marginals", "jpda_7x6", HARD, "weights over 16 powers of ten", weights=wide, log=False, prune=False)
    logs = [
        [round(rng.uniform(-5.0, 0.0), 4), *(round(rng.uniform(-6000.0, -4000.0), 3) for _ in range(5))]
        for _ in range(5)
    ]
    for i in range(4):
        logs[i][0] = None if i < 2 else -9000.0
    yield _of("marginals", "jpda_logs", NASTY, "weights from e^-9000 on", weights=logs, log=True, prune=False)

    motion = {"type": "constant_velocity", "dims": 2, "accel_std": [1.0, 1.0]}
    position = {"type": "position", "std": [2.0, 2.0]}
    one = [{"mean": [0.0, 0.0, 10.0, 5.0], "cov": diagonal(9, 9, 4, 4), "time": 0.0}]
    two = [*one, {"mean": [2.0, 6.0, 9.0, 3.0], "cov": diagonal(9, 16, 4, 4), "time": 0.0}]
    scan = {"time": 1.0, "values": [[9.0, 4.0], [12.5, 7.5], [11.0, 9.0]]}
    common = {"motion": motion, "sensor": position, "detection_probability": 0.9, "clutter_density": 1e-3}
    yield _of(
        "tracker", "pda", ORDINARY, "one track, three reports", **common,
        associator={"name": "pda"}, initial=one, scans=[scan],
    )  # fmt: skip
    later = {"time": 2.5, "values": [[25.0, 12.0], [24.0, 10.5]]}
    yield _of(
        "tracker", "jpda_tracks", ORDINARY, "two close tracks, two scans", **common,
        associator={"name": "jpda"}, initial=two, scans=[scan, later],
    )  # fmt: skip
    far = {"time": 1.0, "values": [[310.0, 5.0], [10.0, -297.5], [-205.0, 225.0]]}
    yield _of(
        "tracker", "pda_far", NASTY, "all reports 70 sigma away: densities from e^-2600 on",
        **common | {"clutter_density": 0.0}, associator={"name": "pda"}, initial=one, scans=[far],
    )  # fmt: skip
    radar = {"type": "range_bearing", "position": [0.0, 0.0], "range_std": 20.0, "bearing_std": 1e-3}
    targets = [
        {"mean": [6000.0, 3000.0 + 150.0 * i, -40.0, 10.0 + i], "cov": diagonal(400, 400, 25, 25), "time": 0.0}
        for i in range(3)
    ]
    reports = [{"time": 2.0, "values": [[6670.0, 0.4735]]}, {"time": 3.0, "values": [[6730.0, 0.4895]]}]
    for covariance in ("moment", "paper"):
        yield _of(
            "tracker", f"npda_{covariance}", ORDINARY, "three tracks, reports one at a time",
            motion=motion, sensor=radar, detection_probability=0.9, clutter_density=1e-3,
            associator={"name": "npda", "clutter_probability": 0.125, "covariance": covariance},
            initial=targets, scans=reports,
        )  # fmt: skip


def _intensity():
    motion = {"type": "constant_velocity", "dims": 2, "accel_psd": [0.5, 0.5]}
    base = {
        "motion": motion,
        "sensor": {"type": "position", "std": [5.0, 5.0]},
        "time": 0.0,
        "survival_probability": 0.97,
        "detection_probability": 0.9,
        "clutter_density": 1e-5,
        "initial": [
            {"weight": 0.9, "mean": [0.0, 0.0, 5.0, 0.0], "cov": diagonal(25, 25, 9, 9)},
            {"weight": 0.7, "mean": [30.0, 10.0, -5.0, 2.0], "cov": diagonal(36, 25, 9, 9)},
            {"weight": 0.4, "mean": [40.0, -20.0, 0.0, 1.0], "cov": diagonal(49, 36, 16, 9)},
        ],
        "births": [{"weight": 0.1, "mean": [10.0, 5.0, 0.0, 0.0], "cov": diagonal(400, 400, 25, 25)}],
        "scan": {"time": 1.0, "values": [[4.0, 1.0], [26.0, 11.0], [38.0, -17.0], [12.0, 20.0]]},
        "prune": 1e-9,
        "merge": 0.0,
    }
    yield _of("phd", "phd", ORDINARY, "four components, four measurements", **base)
    yield _of(
        "phd", "phd_merged", ORDINARY, "the same with pruning and merging", **base | {"prune": 1e-4, "merge": 4.0}
    )
    rng = Random(20)  # noqa: S311
    crowd = [
        {
            "weight": float(f"{10.0 ** rng.uniform(-9, 0):.4e}"),
            "mean": [
                round(rng.uniform(0, 60), 2),
                round(rng.uniform(0, 60), 2),
                round(rng.gauss(0, 3), 2),
                round(rng.gauss(0, 3), 2),
            ],
            "cov": diagonal(30, 40, 9, 9),
        }
        for _ in range(8)
    ]
    values = [[round(rng.uniform(0, 60), 2), round(rng.uniform(0, 60), 2)] for _ in range(6)]
    yield _of(
        "phd", "phd_unequal", HARD, "weights over nine powers of ten, nothing pruned",
        **base | {"initial": crowd, "scan": {"time": 1.0, "values": values}, "prune": 0.0},
    )  # fmt: skip
    gone = {"time": 1.0, "values": [[300.0, 310.0], [-420.0, 30.0]]}
    yield _of(
        "phd", "phd_far", NASTY, "no clutter, measurements 50 sigma from everything: densities from e^-1200 on",
        **base | {"clutter_density": 0.0, "births": [], "scan": gone},
    )  # fmt: skip
    yield _of("cphd", "cphd", ORDINARY, "the step of the first problem", **base | {"max_targets": 20})
    many = [
        {
            "weight": round(rng.uniform(0.3, 0.99), 3),
            "mean": [20.0 * i, 15.0 * (i % 3), 1.0, 0.5],
            "cov": diagonal(30, 40, 9, 9),
        }
        for i in range(9)
    ]
    seen = [[round(20.0 * i + rng.gauss(1, 8), 2), round(15.0 * (i % 3) + rng.gauss(0, 8), 2)] for i in range(9)]
    seen += [[round(rng.uniform(0, 180), 2), round(rng.uniform(-20, 50), 2)] for _ in range(6)]
    yield _of(
        "cphd", "cphd_15", HARD, "nine targets, 15 measurements, up to 60 targets: probabilities down to 1e-145",
        **base | {"initial": many, "scan": {"time": 1.0, "values": seen}, "max_targets": 60},
    )  # fmt: skip


def _metrics():
    rng = Random(21)  # noqa: S311
    points = [[round(rng.uniform(-50, 50), 3), round(rng.uniform(-50, 50), 3)] for _ in range(6)]
    near = [[round(x + rng.gauss(0, 4), 3), round(y + rng.gauss(0, 4), 3)] for x, y in points[:4]]
    yield _of("ospa", "ospa", ORDINARY, "more points on the right", x=near, y=points, c=20.0, p=2.0)
    yield _of(
        "gospa", "gospa_few_estimates", ORDINARY, "two targets missed", truth=points, estimates=near, c=20.0, p=2.0
    )
    yield _of(
        "gospa", "gospa_few_targets", ORDINARY, "more estimates than targets, one too far", c=12.0, p=1.0,
        truth=[*near[:3], [200.0, 0.0]], estimates=points,
    )  # fmt: skip
    far = [[round(1e7 + rng.uniform(-1e4, 1e4), 3), round(-2e7 + rng.uniform(-1e4, 1e4), 3)] for _ in range(5)]
    shifted = [[x + round(10.0 ** -(i + 1), 6), y] for i, (x, y) in enumerate(far)]
    yield _of(
        "ospa", "ospa_order_60", NASTY, "p = 60: powers from 1e-240 to 1e180", x=far, y=shifted[:4], c=1e3, p=60.0
    )
    extents = [[[40.0, 10.0], [10.0, 25.0]], [[16.0, -4.0], [-4.0, 9.0]]]
    other = [[[36.0, 5.0], [5.0, 30.0]], [[10.0, 2.0], [2.0, 12.0]]]
    centres = {"truth": [[0.0, 0.0], [30.0, 5.0]], "c": 20.0, "p": 2.0}
    yield _of(
        "gospa", "gospa_extents", ORDINARY, "ellipses by the Gaussian-Wasserstein distance",
        estimates=[[1.0, 2.0], [28.0, 4.0]], extents=[extents, other], **centres,
    )  # fmt: skip
    alike = [
        [[v * (1.0 + 2.0**-24 * (1 + i + j)) for j, v in enumerate(row)] for i, row in enumerate(x)] for x in extents
    ]
    yield _of(
        "gospa", "gospa_extents_alike", NASTY, "ellipses that differ by a ten-millionth, in the same place",
        estimates=centres["truth"], extents=[extents, alike], **centres,
    )  # fmt: skip


def _partitions():
    rng = Random(22)  # noqa: S311

    def cloud(centre, n, spread, digits=3):
        return [[round(c + rng.gauss(0, spread), digits) for c in centre] for _ in range(n)]

    points = cloud((0.0, 0.0), 9, 2.0) + cloud((15.0, 5.0), 8, 2.0) + cloud((5.0, 20.0), 3, 8.0)
    yield _of("density_peaks", "density_peaks", ORDINARY, "two clouds and clutter", points=points, d_c=3.0)
    yield _of("lof", "outlier_factors", ORDINARY, "the same points, k = 4", points=points, n_neighbors=4)
    yield _of("trees", "trees", ORDINARY, "the same points: heights of single linkage and of Ward", points=points)
    yield _of(
        "density_peaks", "density_peaks_noise", HARD, "whitened by a noise of condition 1e8", points=points, d_c=5000.0,
        noise=[[1.0e3, 9.9985], [9.9985, 0.1]],
    )  # fmt: skip
    dense = cloud((5e7, -3e7), 10, 0.01, 6) + cloud((5e7 + 4.0, -3e7), 8, 1.0, 6)
    yield _of(
        "lof", "outlier_factors_far", NASTY, "densities 1 : 100, 58,000 km from the origin", points=dense, n_neighbors=4
    )


def _scalars():
    yield _of(
        "chi_square", "gates", ORDINARY, "the usual gates",
        probabilities=[0.5, 0.9, 0.95, 0.99, 0.999, 0.99, 0.999, 0.05], dof=[1, 2, 3, 2, 3, 9, 30, 100],
    )  # fmt: skip
    yield _of(
        "chi_square", "tails", HARD, "quantiles at 1e-300, 1e-12 and 1 - 2^-53",
        probabilities=[1e-300, 1e-300, 1e-12, 1.0 - 2.0**-53, 1.0 - 2.0**-53, 1e-12], dof=[2, 9, 1, 3, 60, 300],
    )  # fmt: skip
    rng = Random(23)  # noqa: S311
    low = [[round(rng.gauss(0, 1), 3) if j <= i else 0.0 for j in range(3)] for i in range(3)]
    cov = [[sum(a * b for a, b in zip(x, y, strict=True)) for y in low] for x in low]
    hilbert = [[1.0 / (i + j + 1) for j in range(8)] for i in range(8)]
    yield _of(
        "nees", "nees", ORDINARY, "with p-values down to 1e-45",
        errors=[[1.0, -0.5, 0.25], [3.0, 20.0, 4.0]], covs=[cov, diagonal(1, 2, 3)],
    )  # fmt: skip
    yield _of(
        "nees", "nees_hilbert", NASTY, "Hilbert's matrix of order 8, condition 1.5e10",
        errors=[[x / 2**11 for x in (1.0, 0.5, 0.25, 0.75, -0.5, 0.125, 0.375, -1.0)]], covs=[hilbert],
    )  # fmt: skip
    places = [[1.107, 0.182, 25.0], [-0.6, 3.1, -10.0], [0.0, -1.5, 8848.0], [1.5, 2.0, 400000.0]]
    yield _of("to_ecef", "to_ecef", ORDINARY, "positions on the Earth", positions=places)
    points = [
        [2799000.0, 515000.0, 5697000.0],
        [6378137.5, 1.0, 1.0],
        [10.0, 2.0, 6356800.0],
        [1.0e7, -2.0e7, 3.0e7],
        [5e5, 4e5, 3e5],
    ]
    yield _of(
        "to_geodetic", "to_geodetic", ORDINARY, "at a pole, on the equator, far out and deep inside", points=points
    )


FAMILIES = {
    "association": _association,
    "intensity": _intensity,
    "metrics": _metrics,
    "partitions": _partitions,
    "scalars": _scalars,
}
