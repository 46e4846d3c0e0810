"""Filters and the smoother in their textbook forms, which at 60 digits need no care for rounding.

Kalman, extended: Bar-Shalom, Li, Kirubarajan (2001), §5.2 and §10.3. Unscented: Julier, Uhlmann (2004); scaled: Wan,
van der Merwe (2000). Smoother: Rauch, Tung, Striebel (1965).
"""

from __future__ import annotations

from arithmetic import add, cholesky, dot, log_normal, outer, scaled, solve, times, transpose
from models import moved, noise, observed, residual, transition
from mpmath import mp, mpf


def predict(motion, state, dt):
    mean, cov = state
    f, q = transition(motion, dt)
    return times(f, mean), add(times(f, cov, transpose(f)), q)


def corrected(prior, innovation, s, cross):
    """X + K ν and P - K S Kᵀ with K = cross S⁻¹, cross (n, m)."""
    mean, cov = prior
    gain = transpose(solve(s, transpose(cross)))
    return add(mean, times(gain, innovation)), add(cov, times(gain, s, transpose(gain)), -1)


def look(sensor, prior, measured=None):
    """Innovation, S and cov(x, z) by the derivative; of the observed components."""
    mean, cov = prior
    expected, h = observed(sensor, mean)
    r = noise(sensor)
    seen = [i for i in range(len(h)) if measured is None or measured[i] is not None]
    h = [h[i] for i in seen]
    r = [[r[i][j] for j in seen] for i in seen]
    cross = times(cov, transpose(h))
    s = add(times(h, cross), r)
    if measured is None:
        return expected, s, cross
    whole = [e if z is None else z for z, e in zip(measured, expected, strict=True)]
    difference = residual(sensor, whole, expected)
    return [difference[i] for i in seen], s, cross


def _points(problem, state):
    """Sigma points with the weights of means and covariances."""
    mean, cov = state
    n = len(mean)
    kappa, alpha, beta = problem["kappa"], problem.get("alpha"), problem.get("beta")
    spread = n + kappa if alpha is None else alpha**2 * (n + kappa)
    centre = 1 - n / spread
    around = [1 / (2 * spread)] * (2 * n)
    of_cov = centre if alpha is None else centre + 1 - alpha**2 + beta
    columns = transpose(cholesky(scaled(cov, spread)))
    points = [mean, *(add(mean, c) for c in columns), *(add(mean, c, -1) for c in columns)]
    return points, [centre, *around], [of_cov, *around]


def _moments(points, images, of_mean, of_cov, mean, *, sensor=None):
    """Mean and covariance of the images, and their covariance with the points; angles as offsets from the first."""

    def offset(image, origin):
        return add(image, origin, -1) if sensor is None else residual(sensor, image, origin)

    offsets = [offset(image, images[0]) for image in images]
    middle = [dot(of_mean, column) for column in transpose(offsets)]
    centred = [add(o, middle, -1) for o in offsets]
    from_mean = [add(p, mean, -1) for p in points]
    m, n = len(middle), len(mean)
    cov = [[sum(w * c[i] * c[j] for w, c in zip(of_cov, centred, strict=True)) for j in range(m)] for i in range(m)]
    rows = list(zip(of_cov, from_mean, centred, strict=True))
    cross = [[sum(w * p[i] * c[j] for w, p, c in rows) for j in range(m)] for i in range(n)]
    return add(images[0], middle), cov, cross


def _unscented_predict(problem, state, dt):
    motion = problem["motion"]
    if motion["type"] != "pendulum":
        return predict(motion, state, dt)
    points, of_mean, of_cov = _points(problem, state)
    images = [moved(motion, point, dt) for point in points]
    mean, cov, _ = _moments(points, images, of_mean, of_cov, state[0])
    return mean, add(cov, motion["Q"])


def _unscented_look(problem, prior, measured):
    sensor = problem["sensor"]
    points, of_mean, of_cov = _points(problem, prior)
    images = [observed(sensor, point)[0] for point in points]
    expected, cov, cross = _moments(points, images, of_mean, of_cov, prior[0], sensor=sensor)
    return residual(sensor, measured, expected), add(cov, noise(sensor)), cross


def run(problem):
    """Kind "filter"."""
    unscented = problem["filter"] in {"unscented", "cubature"}
    initial = problem["initial"]
    state, time = (initial["mean"], initial["cov"]), initial["time"]
    inputs = problem.get("inputs")
    filtered, predicted, steps, nis, total = [], [], [], [], mpf(0)
    for k, (now, measured) in enumerate(zip(problem["times"], problem["values"], strict=True)):
        dt = now - time
        steps.append(dt)
        state = _unscented_predict(problem, state, dt) if unscented else predict(problem["motion"], state, dt)
        if inputs is not None:
            state = add(state[0], inputs[k]), state[1]
        predicted.append(state)
        if any(z is not None for z in measured):
            if unscented:
                innovation, s, cross = _unscented_look(problem, state, measured)
            else:
                innovation, s, cross = look(problem["sensor"], state, measured)
            state = corrected(state, innovation, s, cross)
            nis.append(dot(innovation, solve(s, innovation)))
            total += log_normal(innovation, s)
        else:
            nis.append(None)
        filtered.append(state)
        time = now
    rows = problem["rows"]
    nis = [nis[k] for k in rows if nis[k] is not None]
    out = estimates([filtered[k] for k in rows])
    out |= {"nis": ([max(x, mpf(1)) for x in nis], nis), "log_likelihood": ([max(abs(total), mpf(1))], total)}
    if problem.get("smooth"):
        smoothed = smooth(problem["motion"], filtered, predicted, steps)
        out |= {f"smoothed_{key}": answer for key, answer in estimates([smoothed[k] for k in rows]).items()}
    return out


def estimates(states):
    """Means, each component in units of itself or of its standard deviation, whichever is larger; and covariances."""
    units = [[max(abs(x), mp.sqrt(cov[i][i])) for i, x in enumerate(mean)] for mean, cov in states]
    return {"means": (units, [mean for mean, _ in states]), "covs": ("cov", [cov for _, cov in states])}


def smooth(motion, filtered, predicted, steps):
    out = [filtered[-1]]
    for k in reversed(range(1, len(filtered))):
        mean, cov = filtered[k - 1]
        f, _ = transition(motion, steps[k])
        gain = transpose(solve(predicted[k][1], times(f, cov)))
        ahead = out[0]
        mean = add(mean, times(gain, add(ahead[0], predicted[k][0], -1)))
        cov = add(cov, times(gain, add(ahead[1], predicted[k][1], -1), transpose(gain)))
        out.insert(0, (mean, cov))
    return out


def mixture(parts):
    """Mean and covariance of hypotheses (weight, state)."""
    total = sum(w for w, _ in parts)
    n = len(parts[0][1][0])
    mean = [sum(w * state[0][i] for w, state in parts) / total for i in range(n)]
    cov = None
    for w, state in parts:
        e = add(state[0], mean, -1)
        term = scaled(add(state[1], outer(e, e)), w / total)
        cov = term if cov is None else add(cov, term)
    return mean, cov
