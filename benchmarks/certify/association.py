"""Association probabilities by enumeration of every joint event, and the trackers' steps that follow from them.

Fortmann, Bar-Shalom, Scheffe (1983); Blom, Bloem (2000) for JPDA*; Bar-Shalom, Tse (1975) for PDA; Liu, Xie, Huang
(2009) for NPDA.
"""

from __future__ import annotations

from arithmetic import add, log_normal, outer, scaled
from filters import corrected, estimates, look, mixture, predict
from mpmath import mp, mpf


def events(weights):
    """Every joint event that is possible: the choice of each track (0: none) and its weight."""
    choice = []

    def extend(i, used, weight):
        if i == len(weights):
            yield tuple(choice), weight
            return
        for j, w in enumerate(weights[i]):
            if w != 0 and (j == 0 or not used >> j & 1):
                choice.append(j)
                yield from extend(i + 1, used | (1 << j if j else 0), weight * w)
                choice.pop()

    return extend(0, 0, mpf(1))


def joint(weights, *, prune=False):
    """Probabilities (T, 1 + M) and the logarithm of the total weight."""
    found = events(weights)
    if prune:
        best = {}
        for choice, weight in found:
            alike = (frozenset(i for i, j in enumerate(choice) if j), frozenset(j for j in choice if j))
            if alike not in best or weight > best[alike][1]:
                best[alike] = choice, weight
        found = best.values()
    sums = [[mpf(0)] * len(row) for row in weights]
    total = mpf(0)
    for choice, weight in found:
        total += weight
        for i, j in enumerate(choice):
            sums[i][j] += weight
    return [[s / total for s in row] for row in sums], mp.log(total)


def marginals(problem):
    """Kind "marginals"."""
    weights = problem["weights"]
    if problem["log"]:
        weights = [[mpf(0) if w is None else mp.exp(w) for w in row] for row in weights]
    probabilities, log_total = joint(weights, prune=problem["prune"])
    return {"probabilities": ("each", probabilities), "log_total": ("each", log_total)}


def _updates(sensor, state, values):
    """For every report: the log density and the state updated by it."""
    out = []
    for z in values:
        innovation, s, cross = look(sensor, state, z)
        out.append((log_normal(innovation, s), corrected(state, innovation, s, cross)))
    return out


def _sequential(problem, tracks, z):
    """NPDA: one report shared out among all tracks."""
    sensor, rule = problem["sensor"], problem["associator"]
    found = [_updates(sensor, state, [z])[0] for state in tracks]
    likelihoods = [mp.exp(log) for log, _ in found]
    clutter = rule["clutter_probability"]
    if clutter is None:
        detection, density = problem["detection_probability"], problem["clutter_density"]
        rest = density * (1 - detection) / detection
        betas = [f / (rest + sum(likelihoods)) for f in likelihoods]
    else:
        betas = [(1 - clutter) * f / sum(likelihoods) for f in likelihoods]
    out = []
    for beta, prior, (_, updated) in zip(betas, tracks, found, strict=True):
        step = add(updated[0], prior[0], -1)
        share = {"moment": beta, "paper": beta**2, "joseph": beta * (2 - beta)}[rule["covariance"]]
        cov = add(scaled(prior[1], 1 - share), scaled(updated[1], share))
        if rule["covariance"] == "moment":
            cov = add(cov, scaled(outer(step, step), beta * (1 - beta)))
        out.append((add(prior[0], scaled(step, beta)), cov))
    return out


def _together(problem, tracks, values):
    """PDA, JPDA and JPDA*: the mean over the events of a whole scan."""
    detection, density = problem["detection_probability"], problem["clutter_density"]
    found = [_updates(problem["sensor"], state, values) for state in tracks]
    # Weights times the density of clutter, which is common to all events where it can be: then it may be 0.
    rows = [[(1 - detection) * density, *(detection * mp.exp(log) for log, _ in each)] for each in found]
    name = problem["associator"]["name"]
    if name == "pda":
        shares = [[w / sum(row) for w in row] for row in rows]
    else:
        shares, _ = joint([[w / density for w in row] for row in rows], prune=name == "jpda_star")
    out = []
    for state, each, betas in zip(tracks, found, shares, strict=True):
        parts = [(betas[0], state), *((b, updated) for b, (_, updated) in zip(betas[1:], each, strict=True))]
        out.append(mixture([(b, s) for b, s in parts if b > 0]))
    return out


def track(problem):
    """Kind "tracker": tracks that are known from the beginning, all reports in every gate."""
    tracks = [(initial["mean"], initial["cov"]) for initial in problem["initial"]]
    time = problem["initial"][0]["time"]
    for scan in problem["scans"]:
        tracks = [predict(problem["motion"], state, scan["time"] - time) for state in tracks]
        if problem["associator"]["name"] == "npda":
            for z in scan["values"]:
                tracks = _sequential(problem, tracks, z)
        else:
            tracks = _together(problem, tracks, scan["values"])
        time = scan["time"]
    return estimates(tracks)
