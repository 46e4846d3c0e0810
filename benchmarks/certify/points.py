"""Metrics between sets by enumeration of every assignment, and partitions of points by their definitions.

OSPA: Schuhmacher, Vo, Vo (2008); GOSPA: Rahmathullah, Garcia-Fernandez, Svensson (2017); Gaussian-Wasserstein: Yang,
Baum, Granström (2016). Density peaks: Rodriguez, Laio (2014); local outlier factor: Breunig, Kriegel, Ng, Sander
(2000); trees: Gower, Ross (1969), Ward (1963).
"""

from __future__ import annotations

from itertools import permutations

from arithmetic import add, cholesky, solve, times, transpose
from mpmath import mp, mpf


def distance(a, b):
    return mp.sqrt(sum((x - y) ** 2 for x, y in zip(a, b, strict=True)))


def _wasserstein(x, y):
    """tr(X + Y - 2 (X^½ Y X^½)^½) by the eigenvalues of X Y."""
    low = cholesky(x)
    inner = times(transpose(low), y, low)
    values = mp.eigsy(mp.matrix(inner), eigvals_only=True)
    trace = sum(x[i][i] + y[i][i] for i in range(len(x)))
    return trace - 2 * sum(mp.sqrt(v) for v in values)


def ospa(problem):
    """Kind "ospa"."""
    few, many = sorted((problem["x"], problem["y"]), key=len)
    c, p = problem["c"], problem["p"]
    costs = [[min(c, distance(a, b)) ** p for b in many] for a in few]
    best = min(
        sum((costs[i][j] for i, j in enumerate(chosen)), mpf(0)) for chosen in permutations(range(len(many)), len(few))
    )
    surplus = c**p * (len(many) - len(few))
    parts = {"total": best + surplus, "localisation": best, "cardinality": surplus}
    return {name: ("each", (value / len(many)) ** (1 / mpf(p))) for name, value in parts.items()}


def gospa(problem):
    """Kind "gospa"; alpha = 2, so that the parts are defined."""
    truth, estimates, c, p = problem["truth"], problem["estimates"], problem["c"], problem["p"]
    apart = [[distance(a, b) for b in estimates] for a in truth]
    if problem.get("extents"):
        xs, ys = problem["extents"]
        apart = [[mp.sqrt(apart[i][j] ** 2 + _wasserstein(x, y)) for j, y in enumerate(ys)] for i, x in enumerate(xs)]
    best = None

    def extend(i, used, cost, pairs):
        nonlocal best
        if i == len(truth):
            whole = cost + c**p / 2 * (len(estimates) - len(used))
            if best is None or whole < best[0]:
                best = whole, pairs
            return
        extend(i + 1, used, cost + c**p / 2, pairs)
        for j in range(len(estimates)):
            if j not in used and apart[i][j] < c:
                extend(i + 1, {*used, j}, cost + apart[i][j] ** p, [*pairs, (i, j)])

    extend(0, set(), mpf(0), [])
    whole, pairs = best
    return {
        "total": ("each", whole ** (1 / mpf(p))),
        "localisation": ("each", sum((apart[i][j] ** p for i, j in pairs), mpf(0))),
        "missed": ("each", c**p / 2 * (len(truth) - len(pairs))),
        "false_tracks": ("each", c**p / 2 * (len(estimates) - len(pairs))),
        "pairs": ("exact", [list(pair) for pair in pairs]),
    }


def _whitened(problem):
    """The points, in units in which noise is isotropic with the same mean variance."""
    points, cov = problem["points"], problem.get("noise")
    if cov is None:
        return points, None
    s = mp.sqrt(sum(cov[i][i] for i in range(len(cov))) / len(cov))
    low = cholesky(cov)
    return [[s * x for x in solve(low, point)] for point in points], s


def density_peaks(problem):
    """Kind "density_peaks", Gaussian kernel."""
    points, s = _whitened(problem)
    d_c = problem["d_c"] if problem["d_c"] is not None else s
    n = len(points)
    d = [[distance(a, b) for b in points] for a in points]
    rho = [sum(mp.exp(-((d[i][j] / d_c) ** 2)) for j in range(n) if j != i) for i in range(n)]
    order = sorted(range(n), key=lambda i: -rho[i])
    delta, nearest = [None] * n, [None] * n
    delta[order[0]], nearest[order[0]] = max(d[order[0]]), -1
    for place, i in enumerate(order[1:], start=1):
        nearest[i] = min(order[:place], key=lambda j: d[i][j])
        delta[i] = d[i][nearest[i]]
    return {
        "rho": ("each", rho),
        "delta": ("each", delta),
        "gamma": ("each", [r * t for r, t in zip(rho, delta, strict=True)]),
        "order": ("exact", order),
        "nearest_denser": ("exact", nearest),
    }


def outlier_factors(problem):
    """Kind "lof"."""
    points, _ = _whitened(problem)
    n, k = len(points), problem["n_neighbors"]
    d = [[distance(a, b) for b in points] for a in points]
    near = [sorted((j for j in range(n) if j != i), key=lambda j: d[i][j])[:k] for i in range(n)]
    k_distance = [d[i][near[i][-1]] for i in range(n)]
    lrd = [k / sum(max(k_distance[j], d[i][j]) for j in near[i]) for i in range(n)]
    factors = [sum(lrd[j] for j in near[i]) / k / lrd[i] for i in range(n)]
    return {
        "k_distance": ("each", k_distance),
        "reachability_density": ("each", lrd),
        "factors": ("each", factors),
    }


def trees(problem):
    """Kind "trees": the heights at which clusters merge, by merging the two nearest clusters again and again."""
    points, _ = _whitened(problem)
    out = {}
    for linkage in ("single", "ward"):
        clusters, heights = [[i] for i in range(len(points))], []

        def apart(a, b, linkage=linkage):
            if linkage == "single":
                return min(distance(points[i], points[j]) for i in a for j in b)
            centre_a, centre_b = ([sum(x) / len(c) for x in zip(*(points[i] for i in c), strict=True)] for c in (a, b))
            size = mpf(2) * len(a) * len(b) / (len(a) + len(b))
            return mp.sqrt(size * sum(x**2 for x in add(centre_a, centre_b, -1)))

        while len(clusters) > 1:
            pairs = ((i, j) for j in range(len(clusters)) for i in range(j))
            height, i, j = min((apart(clusters[i], clusters[j]), i, j) for i, j in pairs)
            heights.append(height)
            clusters[i] += clusters.pop(j)
        out[linkage] = ("each", heights)
    return out
