"""The certified problems given to FilterPy, Stone Soup and pykalman: those that each of them can state.

Every function takes what is given and returns the answers that the package has, under their names in the problem; None
where it cannot state the problem. F and Q come from the models of `certify`, rounded to doubles once, so that no peer
suffers from how its motion is put into it.
"""

from __future__ import annotations

import datetime as dt
import math
import sys
import warnings
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent / "certify"))
import models
from arithmetic import exact
from mpmath import mp

mp.dps = 60
EPOCH = dt.datetime(2000, 1, 1)  # noqa: DTZ001 (Stone Soup's times are naive)


def doubles(value):
    return np.array([[float(x) for x in row] for row in value])


class Model:
    """A problem's matrices and functions as doubles, in block order."""

    def __init__(self, given):
        self.given, self.sensor = given, given["sensor"]
        self.x0, self.p0 = np.array(given["initial"]["mean"]), np.array(given["initial"]["cov"])
        exact_sensor = exact(given["sensor"])
        self.r = doubles(models.noise(exact_sensor))
        self.angles = [1] if self.sensor["type"] == "range_bearing" else []
        self.linear = self.sensor["type"] in {"linear", "position", "linear_function"}
        if self.linear:
            self.h = doubles(models.observed(exact_sensor, exact(self.x0.tolist()))[1])
        times = [given["initial"].get("time", 0.0), *given["times"]]
        self.moves = given["motion"]["type"] != "pendulum"
        if self.moves:
            motion = exact(given["motion"])
            steps = [exact(b) - exact(a) for a, b in pairwise(times)]
            pairs = [models.transition(motion, step) for step in steps]
            self.f, self.q = ([doubles(pair[i]) for pair in pairs] for i in range(2))
        self.inputs = given.get("inputs") or [[0.0] * len(self.x0)] * len(given["times"])

    def hx(self, x):
        """Return what the sensor reports of a state."""
        s = self.sensor
        if self.linear:
            return self.h @ x
        if s["type"] == "range_bearing":
            dx, dy = x[0] - s["position"][0], x[1] - s["position"][1]
            return np.array([math.hypot(dx, dy), math.atan2(dy, dx)])
        if s["type"] == "sine":
            return np.array([math.sin(x[0])])
        ranges = [math.dist(x[:3], place) for place in s["hydrophones"]]
        return np.array([*ranges, x[2]])

    def jacobian(self, x):
        """Return its derivative."""
        s, n = self.sensor, len(x)
        if self.linear:
            return self.h
        if s["type"] == "range_bearing":
            dx, dy = x[0] - s["position"][0], x[1] - s["position"][1]
            r = math.hypot(dx, dy)
            return np.array([[dx / r, dy / r, 0.0, 0.0], [-dy / r**2, dx / r**2, 0.0, 0.0]])
        rows = [np.append((x[:3] - place) / math.dist(x[:3], place), np.zeros(n - 3)) for place in s["hydrophones"]]
        return np.array([*rows, np.eye(n)[2]])

    def residual(self, a, b):
        """Return the difference of two reports."""
        out = np.subtract(a, b)
        for i in self.angles:
            out[i] = math.remainder(out[i], 2 * math.pi)
        return out

    @property
    def whole(self):
        """Whether nothing is unobserved."""
        return all(z is not None for row in self.given["values"] for z in row)


def _picked(given, means, covs, nis=None, log_likelihood=None, smoothed=None):
    rows = given["rows"]
    out = {"means": np.array(means)[rows], "covs": np.array(covs)[rows]}
    if nis is not None:
        out["nis"] = np.array(nis)[rows]
    if log_likelihood is not None:
        out["log_likelihood"] = log_likelihood
    if given.get("smooth") and smoothed is not None:
        out |= {"smoothed_means": np.array(smoothed[0])[rows], "smoothed_covs": np.array(smoothed[1])[rows]}
    return out


# --- FilterPy --------------------------------------------------------------------------------------------------------


def _filterpy_made(given, model):
    from filterpy import kalman

    n, m = len(model.x0), len(model.r)
    kind = given["filter"]
    if given["form"] == "square_root":
        made = kalman.SquareRootKalmanFilter(dim_x=n, dim_z=m)
        # Its root of R is the upper factor of NumPy's lower one; of diagonal matrices they are the same.
        made.H, made.R = model.h, model.r
    elif kind in {"unscented", "cubature"}:
        common = {"dim_x": n, "dim_z": m, "dt": 1.0, "hx": model.hx}
        move = {"fx": lambda x, _, f=None: f @ x}
        if given["motion"]["type"] == "pendulum":

            def swing(x, dt):
                rate = x[1] - dt * given["motion"]["stiffness"] * math.sin(x[0])
                return np.array([x[0] + dt * rate, rate])

            move = {"fx": swing}
        if kind == "cubature":
            made = kalman.CubatureKalmanFilter(**common, **move)
        else:
            kappa = given["kappa"]
            if given.get("alpha") is None:
                points = kalman.JulierSigmaPoints(n, kappa=kappa)
            else:
                points = kalman.MerweScaledSigmaPoints(n, given["alpha"], given["beta"], kappa)
            made = kalman.UnscentedKalmanFilter(**common, **move, points=points, residual_z=model.residual)
        made.R = model.r
    elif kind == "extended":
        made = kalman.ExtendedKalmanFilter(dim_x=n, dim_z=m)
        made.R = model.r
    else:
        made = kalman.KalmanFilter(dim_x=n, dim_z=m)
        made.H, made.R = model.h, model.r
    made.x, made.P = model.x0.copy(), model.p0.copy()
    if kind == "cubature":
        made.x = made.x[:, None]
    return made


def filterpy(problem):
    given = problem["given"]
    if problem["kind"] != "filter":
        return None
    model = Model(given)
    if not model.whole:
        return None
    made = _filterpy_made(given, model)
    kind, times = given["filter"], [given["initial"].get("time", 0.0), *given["times"]]
    means, covs, nis, total = [], [], [], 0.0
    for k, z in enumerate(np.array(given["values"])):
        if kind in {"unscented", "cubature"}:
            made.Q = model.q[k] if model.moves else np.array(given["motion"]["Q"])
            step = times[k + 1] - times[k]
            if model.moves and kind == "unscented":
                made.predict(dt=step, f=model.f[k])
            elif model.moves:
                made.predict(dt=step, fx_args=(model.f[k],))
            else:
                made.predict(dt=step)
            made.update(z[:, None] if kind == "cubature" else z)
        else:
            made.F, made.Q = model.f[k], model.q[k]
            made.predict()
            if kind == "extended":
                made.update(z, model.jacobian, model.hx, residual=model.residual)
            else:
                made.update(z)
        means.append(np.ravel(made.x).copy())
        covs.append(np.array(made.P).copy())
        if given["form"] == "joseph" and kind != "cubature":
            y, s = np.ravel(made.y), made.S
            nis.append(float(y @ made.SI @ y))
            total += -0.5 * (nis[-1] + math.log(np.linalg.det(2 * math.pi * s)))
    smoothed = None
    if given.get("smooth"):
        from filterpy.kalman import rts_smoother

        # It takes the matrices of the step that leads away from a row.
        smoothed = rts_smoother(np.array(means), np.array(covs), model.f[1:] + model.f[:1], model.q[1:] + model.q[:1])
    return _picked(given, means, covs, nis or None, total if nis else None, smoothed)


# --- pykalman --------------------------------------------------------------------------------------------------------


def pykalman(problem):
    given = problem["given"]
    if problem["kind"] != "filter" or given["filter"] != "kalman":
        return None
    model = Model(given)
    gaps = [any(z is None for z in row) and not all(z is None for z in row) for row in given["values"]]
    if any(gaps):
        return None
    import pykalman as package
    from pykalman.sqrt import BiermanKalmanFilter

    # Its initial state is that of the first measurement.
    f, q = model.f, model.q
    first = f[0] @ model.x0, f[0] @ model.p0 @ f[0].T + q[0]
    kind = BiermanKalmanFilter if given["form"] == "square_root" else package.KalmanFilter
    same = all(np.array_equal(q[1], other) for other in q[2:])
    if given["form"] == "square_root" and not same:
        return None  # by factors Q must be one matrix
    made = kind(
        transition_matrices=np.array(f[1:]),
        observation_matrices=model.h,
        transition_covariance=q[1] if same else np.array(q[1:]),
        observation_covariance=model.r,
        initial_state_mean=first[0],
        initial_state_covariance=first[1],
        n_dim_state=len(model.x0),
        n_dim_obs=len(model.r),
    )
    values = np.array(given["values"])
    means, covs = made.filter(values)
    smoothed = made.smooth(values) if given.get("smooth") else None
    return _picked(given, means, covs, None, made.loglikelihood(values), smoothed)


# --- Stone Soup ------------------------------------------------------------------------------------------------------


def _stone_soup_filter(problem):
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
    from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
    from stonesoup.predictor import kalman as predictors
    from stonesoup.smoother.kalman import KalmanSmoother
    from stonesoup.types.array import CovarianceMatrix, StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState, SqrtGaussianState
    from stonesoup.types.track import Track
    from stonesoup.updater import kalman as updaters

    given = problem["given"]
    model = Model(given)
    if not model.whole or not model.moves or given["sensor"]["type"] in {"range_array", "linear_function"}:
        return None
    n, bearing = len(model.x0), bool(model.angles)
    if bearing and given["filter"] in {"unscented", "cubature"}:
        return None  # its mean of bearings is that of points on the unit circle: another definition, as good
    if bearing:
        sensor = CartesianToBearingRange(
            ndim_state=n,
            mapping=(0, 1),
            noise_covar=CovarianceMatrix(model.r[::-1, ::-1]),
            translation_offset=np.array(given["sensor"]["position"])[:, None],
        )
    elif given["sensor"]["type"] == "position":
        sensor = LinearGaussian(ndim_state=n, mapping=tuple(range(len(model.r))), noise_covar=CovarianceMatrix(model.r))
    else:

        class Dense(LinearGaussian):
            """A linear model by its whole matrix, for which Stone Soup has no class of its own."""

            def matrix(self, **_):
                return model.h

        sensor = Dense(ndim_state=n, mapping=tuple(range(len(model.r))), noise_covar=CovarianceMatrix(model.r))
    roots = given["form"] == "square_root"
    if roots and given.get("smooth"):
        return None  # it has no smoother by factors
    name = "SqrtKalman" if roots else {"kalman": "Kalman", "extended": "ExtendedKalman"}[given["filter"]]
    updater = getattr(updaters, f"{name}Updater")(sensor)
    kind = SqrtGaussianState if roots else GaussianState
    spread = np.linalg.cholesky(model.p0) if roots else model.p0
    start = dt.timedelta(seconds=given["initial"].get("time", 0.0))
    state = kind(StateVector(model.x0), CovarianceMatrix(spread), timestamp=EPOCH + start)
    track, means, covs = Track(), [], []
    for k, (time, z) in enumerate(zip(given["times"], given["values"], strict=True)):
        motion = LinearGaussianTimeInvariantTransitionModel(
            transition_matrix=model.f[k], covariance_matrix=CovarianceMatrix(model.q[k]), control_matrix=None
        )
        predictor = getattr(predictors, f"{name}Predictor")(motion)
        now = EPOCH + dt.timedelta(seconds=time)
        prediction = predictor.predict(state, timestamp=now)
        vector = [z[1], z[0]] if bearing else z
        if bearing:
            from stonesoup.types.angle import Bearing

            vector[0] = Bearing(vector[0])
        detection = Detection(StateVector(vector), timestamp=now, measurement_model=sensor)
        state = updater.update(SingleHypothesis(prediction, detection))
        track.append(state)
        means.append(np.array(state.state_vector, dtype=float).ravel())
        covs.append(np.array(state.covar, dtype=float))
    smoothed = None
    if given.get("smooth"):
        smoothed_track = KalmanSmoother(motion).smooth(track)
        smoothed = (
            [np.array(s.state_vector, dtype=float).ravel() for s in smoothed_track],
            [np.array(s.covar, dtype=float) for s in smoothed_track],
        )
    return _picked(given, means, covs, None, None, smoothed)


def _stone_soup_metric(problem):
    from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
    from stonesoup.types.state import State

    given = problem["given"]
    now = EPOCH

    def states(points):
        return [State(np.array(point)[:, None], timestamp=now) for point in points]

    if problem["kind"] == "ospa":
        found = OSPAMetric(p=given["p"], c=given["c"]).compute_OSPA_distance(states(given["x"]), states(given["y"]))
        return {"total": found.value}
    if given.get("extents"):
        return None
    generator = GOSPAMetric(p=given["p"], c=given["c"])
    found, _ = generator.compute_gospa_metric(states(given["estimates"]), states(given["truth"]))
    parts = {"total": "distance", "localisation": "localisation", "missed": "missed", "false_tracks": "false"}
    return {name: found.value[key] for name, key in parts.items()}


def stone_soup(problem):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if problem["kind"] == "filter":
            return _stone_soup_filter(problem)
        return _stone_soup_metric(problem) if problem["kind"] in {"ospa", "gospa"} else None


PEERS = {"FilterPy": filterpy, "Stone Soup": stone_soup, "pykalman": pykalman}
