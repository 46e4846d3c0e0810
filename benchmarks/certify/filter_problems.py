"""The certified problems of filters and the smoother: what is given, and how difficult it is.

Ordinary: as users have them. Hard: condition numbers of 1e6 to 1e8, long chains, weights over many powers of ten.
Nasty: 1e10 to 1e14 (square roots to 1e24), catastrophic cancellation, singular to rounding, below the smallest double.
"""

from __future__ import annotations

import math
from random import Random

ORDINARY, HARD, NASTY = "ordinary", "hard", "nasty"


def diagonal(*values):
    return [[float(v) if i == j else 0.0 for j in range(len(values))] for i, v in enumerate(values)]


def _draws(seed, n, spread, digits=3):
    rng = Random(seed)  # noqa: S311 (numbers, no secrets)
    return [round(rng.gauss(0.0, spread), digits) for _ in range(n)]


def _line(seed, steps, start, velocity, std, dt=1.0, digits=3):
    """Times, and noisy positions on a line."""
    noise = _draws(seed, steps * len(start), std, digits)
    times = [round(dt * (k + 1), 6) for k in range(steps)]
    values = [
        [
            round(s + v * t + noise[k * len(start) + i], digits)
            for i, (s, v) in enumerate(zip(start, velocity, strict=True))
        ]
        for k, t in enumerate(times)
    ]
    return times, values


def _matrix(seed, rows, columns, digits=3):
    flat = _draws(seed, rows * columns, 1.0, digits)
    return [flat[i * columns : (i + 1) * columns] for i in range(rows)]


def _filter(name, difficulty, what, **problem):
    given = {"filter": "kalman", "form": "joseph"} | problem
    given["initial"] = {"time": 0.0} | given["initial"]
    last = len(given["times"]) - 1
    given.setdefault("rows", sorted({0, last // 2, last}))
    return {"name": name, "kind": "filter", "difficulty": difficulty, "what": what, "given": given}


def _kalman():
    times, values = _line(1, 12, (100.0, -50.0), (5.0, 3.0), 1.0)
    times = [round(t + 0.1 * math.sin(t), 3) for t in times]
    plane = {"type": "constant_velocity", "dims": 2, "accel_psd": [0.1, 0.2]}
    position = {"type": "position", "std": [1.0, 1.5]}
    start = {"mean": [90.0, -40.0, 0.0, 0.0], "cov": diagonal(100, 100, 25, 25)}
    gaps = [list(z) for z in values]
    gaps[2][0] = gaps[5][1] = None
    gaps[7] = [None, None]
    yield _filter(
        "kalman",
        ORDINARY,
        "uneven times, two axes",
        motion=plane,
        sensor=position,
        initial=start,
        times=times,
        values=values,
    )
    yield _filter(
        "kalman_gaps",
        ORDINARY,
        "components and rows not observed, known inputs",
        motion={"type": "constant_velocity", "dims": 2, "accel_std": [0.5, 0.25]},
        sensor=position,
        initial=start,
        times=times,
        values=gaps,
        inputs=[[0.25, 0.0, 0.5, -0.125] if k == 4 else [0.0] * 4 for k in range(12)],
        rows=[2, 7, 11],
    )
    yield _filter(
        "square_root",
        ORDINARY,
        "the first problem by factors",
        form="square_root",
        motion=plane,
        sensor=position,
        initial=start,
        times=times,
        values=values,
    )
    long_times, long_values = _line(2, 400, (0.0,), (2.0,), 1.0, dt=0.25)
    yield _filter(
        "kalman_long",
        HARD,
        "400 updates of position, velocity and acceleration with little noise",
        motion={"type": "constant_acceleration", "dims": 1, "jerk_psd": [1e-6]},
        sensor={"type": "position", "std": [1.0]},
        initial={"mean": [0.0, 0.0, 0.0], "cov": diagonal(1e4, 1e2, 1.0)},
        times=long_times,
        values=long_values,
    )
    yield _filter(
        "singer_short_steps",
        HARD,
        "steps of 1/20,000 of the time constant: the closed forms of F and Q cancel",
        motion={"type": "singer", "dims": 1, "accel_std": [3.0], "time_constant": [20.0], "accel_psd": [0.0]},
        sensor={"type": "position", "std": [0.01]},
        initial={"mean": [0.0, 1.0, 0.0], "cov": diagonal(1e-4, 1e-2, 1.0)},
        times=[round(0.001 * (k + 1), 3) for k in range(12)],
        values=[[z] for z in _draws(3, 12, 0.01, 5)],
    )
    yield _filter(
        "joseph_1e8",
        HARD,
        "dense H, noise 1e-8 of the first variances, 20 updates",
        motion={"type": "linear", "F": diagonal(1, 1, 1, 1), "Q": diagonal(0, 0, 0, 0)},
        sensor={"type": "linear", "H": _matrix(4, 2, 4), "R": diagonal(1e-8, 1e-8)},
        initial={"mean": [0.5, -0.25, 1.0, 2.0], "cov": diagonal(1, 1e-2, 1e-5, 1e-8)},
        times=[float(k + 1) for k in range(20)],
        values=[list(z) for z in zip(_draws(5, 20, 1e-4, 7), _draws(6, 20, 1e-4, 7), strict=True)],
    )
    yield _filter(
        "joseph_1e14",
        NASTY,
        "a start of variance 1e8 against noise of 1e-6, 20 updates",
        motion={"type": "constant_velocity", "dims": 2, "accel_psd": [0.01, 0.01]},
        sensor={"type": "position", "std": [1e-3, 1e-3]},
        initial={"mean": [0.0, 0.0, 0.0, 0.0], "cov": diagonal(1e8, 1e8, 1e4, 1e4)},
        times=[float(k + 1) for k in range(20)],
        values=_line(7, 20, (1000.0, -2000.0), (10.0, 4.0), 1e-3, digits=6)[1],
    )
    # Rounding the exact S to doubles, nothing else, leaves 5.0 digits of the means where cond(S) = 4e9, and 6.8 here.
    for form, exponent, what in (("joseph", 10, "cond(S) = 2e7"), ("square_root", 17, "cond(S) = 3e11, by factors")):
        yield _filter(
            f"nearly_singular_{form}",
            NASTY,
            f"two sensors that see almost the same combination: {what}",
            form=form,
            motion={"type": "linear", "F": diagonal(1, 1), "Q": diagonal(1e-4, 1e-4)},
            sensor={"type": "linear", "H": [[1.0, 1.0], [1.0, 1.0 + 2.0**-exponent]], "R": diagonal(1e-12, 1e-12)},
            initial={"mean": [0.0, 0.0], "cov": diagonal(1, 1)},
            times=[1.0, 2.0],
            values=[[0.75, 0.750002], [0.7512, 0.751203]],
            rows=[0, 1],
        )
    for exponent in (18, 24):
        small = 10.0**-exponent
        yield _filter(
            f"square_root_1e{exponent}",
            NASTY,
            f"dense H, variances and noise down to 1e-{exponent}, 20 updates by factors",
            form="square_root",
            motion={"type": "linear", "F": diagonal(1, 1, 1, 1), "Q": diagonal(0, 0, 0, 0)},
            sensor={"type": "linear", "H": _matrix(8, 2, 4), "R": diagonal(small, small)},
            initial={
                "mean": [0.0, 0.0, 0.0, 0.0],
                "cov": diagonal(1, 10.0 ** -(exponent // 3), 10.0 ** -(2 * exponent // 3), small),
            },
            times=[float(k + 1) for k in range(20)],
            values=[
                [float(f"{a:.6e}"), float(f"{b:.6e}")]
                for a, b in zip(_draws(9, 20, math.sqrt(small), 20), _draws(10, 20, math.sqrt(small), 20), strict=True)
            ],
        )


def _bearings(seed, steps, position, start, velocity, stds, dt=1.0):
    noise = _draws(seed, 2 * steps, 1.0, 4)
    times, values = [dt * (k + 1) for k in range(steps)], []
    for k, t in enumerate(times):
        dx, dy = (s + v * t - p for s, v, p in zip(start, velocity, position, strict=True))
        bearing = math.atan2(dy, dx) + stds[1] * noise[2 * k + 1]
        bearing = math.remainder(bearing, 2 * math.pi)
        values.append([round(math.hypot(dx, dy) + stds[0] * noise[2 * k], 6), round(bearing, 9)])
    return times, values


def _nonlinear():
    motion = {"type": "constant_velocity", "dims": 2, "accel_psd": [0.5, 0.5]}
    radar = {"type": "range_bearing", "position": [10.0, -20.0], "range_std": 5.0, "bearing_std": 0.01}
    times, values = _bearings(11, 10, (10.0, -20.0), (400.0, 300.0), (-8.0, 5.0), (5.0, 0.01))
    start = {"mean": [390.0, 310.0, -5.0, 5.0], "cov": diagonal(400, 400, 25, 25)}
    common = {"motion": motion, "sensor": radar, "initial": start, "times": times, "values": values}
    yield _filter("extended", ORDINARY, "range and bearing", filter="extended", **common)
    yield _filter("unscented", ORDINARY, "range and bearing, kappa 1", filter="unscented", kappa=1.0, **common)
    yield _filter("cubature", ORDINARY, "range and bearing", filter="cubature", kappa=0.0, **common)
    yield _filter(
        "unscented_1e-3",
        NASTY,
        "the scaled form with alpha = 1e-3: weights of a million of either sign",
        filter="unscented",
        kappa=0.0,
        alpha=1e-3,
        beta=2.0,
        **common,
    )
    times, values = _bearings(12, 10, (0.0, 0.0), (-300.0, -6.0), (1.0, 1.5), (2.0, 0.02))
    yield _filter(
        "extended_half_turn",
        ORDINARY,
        "bearings that cross from -pi to pi",
        filter="extended",
        motion=motion,
        sensor={"type": "range_bearing", "position": [0.0, 0.0], "range_std": 2.0, "bearing_std": 0.02},
        initial={"mean": [-305.0, -2.0, 0.0, 1.0], "cov": diagonal(100, 100, 4, 4)},
        times=times,
        values=values,
    )
    hydrophones = [[0.0, 0.0, 250.0], [1000.0, 0.0, 252.0], [500.0, 866.0, 248.0]]
    noise, ranges = _draws(13, 40, 1.0, 3), []
    for k in range(10):
        place = (300.0 + 4.0 * k, 200.0 + 3.0 * k, 60.0 + 0.5 * k)
        row = [round(math.dist(place, h) + noise[4 * k + i], 3) for i, h in enumerate(hydrophones)]
        ranges.append([*row, round(place[2] + 0.3 * noise[4 * k + 3], 3)])
    ranges[4][1] = None
    yield _filter(
        "extended_ranges",
        ORDINARY,
        "three hydrophones and the depth, a range missing",
        filter="extended",
        motion={"type": "constant_velocity", "dims": 3, "accel_psd": [0.1, 0.1, 0.01]},
        sensor={"type": "range_array", "hydrophones": hydrophones, "range_std": [1.0, 1.0, 1.0], "depth_std": 0.3},
        initial={"mean": [290.0, 205.0, 58.0, 0.0, 0.0, 0.0], "cov": diagonal(100, 100, 25, 25, 25, 1)},
        times=[2.0 * (k + 1) for k in range(10)],
        values=ranges,
    )
    times, values = _bearings(14, 6, (0.0, 0.0), (8e4, 6e4), (-200.0, 100.0), (0.1, 1e-3))
    yield _filter(
        "extended_far",
        HARD,
        "100 km away, known to 0.1 m along and 100 m across",
        filter="extended",
        motion={"type": "constant_velocity", "dims": 2, "accel_psd": [1.0, 1.0]},
        sensor={"type": "range_bearing", "position": [0.0, 0.0], "range_std": 0.1, "bearing_std": 1e-3},
        initial={"mean": [80010.0, 60020.0, -190.0, 90.0], "cov": diagonal(1e4, 1e4, 1e2, 1e2)},
        times=times,
        values=values,
    )
    # The mean and what is measured agree to a micrometre and less, so that the linearisation stands still.
    yield _filter(
        "extended_1e12",
        NASTY,
        "1000 km away, known to 1 mm along and 1 km across",
        filter="extended",
        motion={"type": "constant_velocity", "dims": 2, "accel_psd": [1e-6, 1e-6]},
        sensor={"type": "range_bearing", "position": [0.0, 0.0], "range_std": 1e-3, "bearing_std": 1e-3},
        initial={"mean": [8e5, 6e5, 0.0, 1.0], "cov": diagonal(1e6, 1e6, 1.0, 1.0)},
        times=[1.0, 2.0, 3.0],
        values=[[1000000.6, 0.6435016], [1000001.2, 0.6435024], [1000001.8, 0.6435032]],
        rows=[0, 1, 2],
    )
    # A linear model given as functions: all filters must agree, also with much motion noise (points drawn anew).
    f = [[1.0, 0.5], [0.0, 1.0]]
    given = {
        "motion": {"type": "linear_function", "F": f, "Q": [[4.0, 1.0], [1.0, 9.0]]},
        "sensor": {"type": "linear_function", "H": [[1.0, 0.25]], "R": [[0.25]]},
        "initial": {"mean": [1.0, -1.0], "cov": [[2.0, 0.5], [0.5, 1.0]]},
        "times": [0.5 * (k + 1) for k in range(8)],
        "values": [[z] for z in _draws(15, 8, 3.0)],
    }
    yield _filter("unscented_linear", ORDINARY, "a linear model by functions", filter="unscented", kappa=1.0, **given)
    yield _filter(
        "unscented_pendulum",
        ORDINARY,
        "motion and sensor that are no matrices",
        filter="unscented",
        kappa=1.0,
        motion={"type": "pendulum", "stiffness": 9.81, "Q": diagonal(1e-4, 1e-3)},
        sensor={"type": "sine", "std": 0.1},
        initial={"mean": [0.75, 0.0], "cov": diagonal(0.04, 0.25)},
        times=[0.0625 * (k + 1) for k in range(16)],
        values=[[z] for z in _draws(16, 16, 0.5)],
    )


def _smoothing():
    times, values = _line(17, 15, (10.0, 20.0), (1.0, -2.0), 1.0)
    yield _filter(
        "smoother",
        ORDINARY,
        "two axes",
        smooth=True,
        motion={"type": "constant_velocity", "dims": 2, "accel_psd": [0.1, 0.1]},
        sensor={"type": "position", "std": [1.0, 1.0]},
        initial={"mean": [10.0, 20.0, 0.0, 0.0], "cov": diagonal(25, 25, 4, 4)},
        times=times,
        values=values,
    )
    # cond(P⁻) is 4e4, 4e6 and 2e11. Filtered covariances of the last, rounded to doubles, leave 6.1 digits: by factors.
    for name, difficulty, form, variance, std in (
        ("smoother_1e6", HARD, "joseph", 1e4, 0.1),
        ("smoother_1e8", HARD, "joseph", 1e6, 0.1),
        ("smoother_1e8_roots", HARD, "square_root", 1e6, 0.1),
        ("smoother_1e13_roots", NASTY, "square_root", 3e9, 0.01),
    ):
        times, values = _line(18, 20, (300.0,), (2.0,), std, digits=5)
        yield _filter(
            name,
            difficulty,
            f"a start of variance {variance:.0e} against noise of {std**2:.0e}"
            + (", by factors" if form != "joseph" else ""),
            smooth=True,
            form=form,
            motion={"type": "constant_acceleration", "dims": 1, "jerk_psd": [0.01]},
            sensor={"type": "position", "std": [std]},
            initial={"mean": [0.0, 0.0, 0.0], "cov": diagonal(variance, variance / 1e2, variance / 1e4)},
            times=times,
            values=values,
        )


FAMILIES = {"kalman": _kalman, "nonlinear": _nonlinear, "smoothing": _smoothing}
