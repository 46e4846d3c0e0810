"""Quantiles, tests and positions on the Earth.

Chi-square: Abramowitz, Stegun, 26.4. WGS-84: NIMA TR8350.2 (2000).
"""

from __future__ import annotations

from arithmetic import dot, solve
from mpmath import mp, mpf

_SEMI_MAJOR = mpf(6378137)


def _tails(x, dof):
    a = mpf(dof) / 2
    with mp.extradps(20):
        return (
            mp.gammainc(a, 0, x / 2, regularized=True),
            mp.gammainc(a, x / 2, mp.inf, regularized=True),
        )


def chi_square(problem):
    """Kind "chi_square": quantiles, each the root of its own tail, by bisection and Newton steps."""
    out = []
    for p, dof in zip(problem["probabilities"], problem["dof"], strict=True):
        upper = p > mpf("0.5")
        target = mp.log(1 - p if upper else p)
        low, high = mp.mpf("1e-700"), mpf(10) ** 5

        def value(log_x, dof=dof, upper=upper, target=target):
            return mp.log(_tails(mp.exp(log_x), dof)[upper]) - target

        low, high = mp.log(low), mp.log(high)
        sign = value(low) > 0
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if (value(middle) > 0) == sign else (low, middle)
        out.append(mp.exp(mp.findroot(value, (low, high), solver="anderson", tol=mpf(10) ** (-2 * mp.dps + 10))))
    return {"quantiles": ("each", out)}


def nees(problem):
    """Kind "nees"."""
    statistics = [dot(e, solve(p, e)) for e, p in zip(problem["errors"], problem["covs"], strict=True)]
    p_values = [_tails(s, len(e))[1] for s, e in zip(statistics, problem["errors"], strict=True)]
    return {"statistics": ("each", statistics), "p_values": ("each", p_values)}


def _squared_eccentricity():
    f = 1 / mpf("298.257223563")
    return f * (2 - f)


def _ecef(lat, lon, height):
    e2 = _squared_eccentricity()
    normal = _SEMI_MAJOR / mp.sqrt(1 - e2 * mp.sin(lat) ** 2)
    across = (normal + height) * mp.cos(lat)
    return [across * mp.cos(lon), across * mp.sin(lon), (normal * (1 - e2) + height) * mp.sin(lat)]


def to_ecef(problem):
    """Kind "to_ecef"."""
    return {"points": ("row", [_ecef(*position) for position in problem["positions"]])}


def to_geodetic(problem):
    """Kind "to_geodetic": latitude by iteration to the last digit, starting from Bowring's formula."""
    e2 = _squared_eccentricity()
    angles, heights = [], []
    for x, y, z in problem["points"]:
        across = mp.sqrt(x**2 + y**2)

        def misfit(lat, height, across=across, z=z):
            normal = _SEMI_MAJOR / mp.sqrt(1 - e2 * mp.sin(lat) ** 2)
            return [(normal + height) * mp.cos(lat) - across, (normal * (1 - e2) + height) * mp.sin(lat) - z]

        lat = mp.atan2(z, across * (1 - e2))
        lat, height = mp.findroot(
            misfit, (lat, mp.sqrt(across**2 + z**2) - _SEMI_MAJOR), tol=mpf(10) ** (-2 * mp.dps + 20)
        )
        angles.append([lat, mp.atan2(y, x)])
        heights.append(height)
    # A height is a difference of lengths as large as the Earth, and is judged by that.
    return {"angles": ("each", angles), "heights": ([_SEMI_MAJOR] * len(heights), heights)}
