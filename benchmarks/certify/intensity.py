"""One scan of the PHD and the CPHD filter as their papers print them.

Vo, Ma (2006), eqs. 21 to 38; Vo, Vo, Cantoni (2007), eqs. 13 to 20 with the elementary symmetric functions of Λ_z.
"""

from __future__ import annotations

from arithmetic import dot, log_normal, solve
from filters import add, corrected, estimates, look, mixture, predict
from mpmath import mp, mpf


def _predicted(problem):
    dt = problem["scan"]["time"] - problem["time"]
    survival = problem["survival_probability"]
    out = [
        (survival * part["weight"], predict(problem["motion"], (part["mean"], part["cov"]), dt))
        for part in problem["initial"]
    ]
    return out + [(part["weight"], (part["mean"], part["cov"])) for part in problem["births"]]


def _corrections(problem, parts):
    """q_j(z) and the updated states, by components and measurements."""
    out = []
    for _, state in parts:
        row = []
        for z in problem["scan"]["values"]:
            innovation, s, cross = look(problem["sensor"], state, z)
            row.append((mp.exp(log_normal(innovation, s)), corrected(state, innovation, s, cross)))
        out.append(row)
    return out


def _merged(parts, bound):
    """Vo, Ma, table II: the heaviest takes in all within `bound` of it, by the covariance of the other."""
    left, out = sorted(parts, key=lambda part: -part[0]), []
    while left:
        centre = left[0][1][0]

        def near(part, centre=centre):
            e = add(part[1][0], centre, -1)
            return dot(e, solve(part[1][1], e)) <= bound

        members = [left[0], *(part for part in left[1:] if near(part))]
        left = [part for part in left[1:] if not near(part)]
        out.append((sum(w for w, _ in members), mixture(members)))
    return out


def _answers(problem, parts):
    parts = [part for part in parts if part[0] > problem["prune"]]
    if problem["merge"] > 0:
        parts = _merged(parts, problem["merge"])
    parts.sort(key=lambda part: part[1][0])  # by means: weights may agree to the last digit
    return {"weights": ("each", [w for w, _ in parts])} | estimates([state for _, state in parts])


def phd(problem):
    """Kind "phd"."""
    parts = _predicted(problem)
    detection, clutter = problem["detection_probability"], problem["clutter_density"]
    found = _corrections(problem, parts)
    out = [((1 - detection) * w, state) for w, state in parts]
    for z in range(len(problem["scan"]["values"])):
        likelihoods = [detection * w * row[z][0] for (w, _), row in zip(parts, found, strict=True)]
        total = clutter + sum(likelihoods)
        out += [(q / total, row[z][1]) for q, row in zip(likelihoods, found, strict=True)]
    return _answers(problem, out)


def _symmetric(values):
    """Elementary symmetric functions e_0 ... e_m."""
    out = [mpf(1)]
    for value in values:
        out = [a + value * b for a, b in zip([*out, 0], [0, *out], strict=True)]
    return out


def _falling(n, k):
    return mp.factorial(n) / mp.factorial(n - k) if k <= n else mpf(0)


def _upsilon(u, n, values, scale, missed, total):
    """The sum Upsilon^u(n) with Poisson clutter of mean `scale`, whose e^-scale is common to everything."""
    terms = (
        scale ** (len(values) - j) * _falling(n, j + u) * missed ** (n - j - u) / total**n * e
        for j, e in enumerate(_symmetric(values))
        if j + u <= n
    )
    return sum(terms, mpf(0))


def cphd(problem):
    """Kind "cphd"."""
    largest, survival = problem["max_targets"], problem["survival_probability"]
    # Targets known beforehand are there independently of one another; births are Poisson.
    prior = [mpf(1)]
    for part in problem["initial"]:
        w = part["weight"]
        prior = [a * (1 - w) + b * w for a, b in zip([*prior, 0], [0, *prior], strict=True)]
    prior = (prior + [mpf(0)] * largest)[: largest + 1]
    births = sum((part["weight"] for part in problem["births"]), mpf(0))
    staying = [
        sum(
            mp.binomial(many, j) * survival**j * (1 - survival) ** (many - j) * prior[many]
            for many in range(j, largest + 1)
        )
        for j in range(largest + 1)
    ]
    born = [mp.exp(-births) * births**k / mp.factorial(k) for k in range(largest + 1)]
    cardinality = [sum(staying[j] * born[n - j] for j in range(n + 1)) for n in range(largest + 1)]
    parts = _predicted(problem)
    detection, clutter = problem["detection_probability"], problem["clutter_density"]
    found = _corrections(problem, parts)
    count = len(problem["scan"]["values"])
    total = sum(w for w, _ in parts)
    missed = (1 - detection) * total
    # Clutter of mean 1 over a field of view of size 1 / clutter: what both are is common to everything.
    scale = mpf(1)
    ratios = [
        scale / clutter * detection * sum(w * row[z][0] for (w, _), row in zip(parts, found, strict=True))
        for z in range(count)
    ]

    def expected(u, values):
        return sum(_upsilon(u, n, values, scale, missed, total) * rho for n, rho in enumerate(cardinality))

    posterior = [_upsilon(0, n, ratios, scale, missed, total) * rho for n, rho in enumerate(cardinality)]
    norm = sum(posterior)
    of_missed = expected(1, ratios) / norm * (1 - detection)
    out = [(of_missed * w, state) for w, state in parts]
    for z in range(count):
        others = expected(1, ratios[:z] + ratios[z + 1 :]) / norm
        out += [
            (others * detection * scale / clutter * w * row[z][0], row[z][1])
            for (w, _), row in zip(parts, found, strict=True)
        ]
    return _answers(problem, out) | {"cardinality": ("each", [p / norm for p in posterior])}
