"""Problems solved with 60 digits (benchmarks/certify): how they are read, solved by trackrs, and judged.

The digits of an answer are -log10 of its largest error over a scale, at most 15.9 (a double has no more). The scale is

- "each": every number itself, so that the smallest counts as much as the largest; below 1e-290 that;
- "row": the largest number of a row, for points;
- "cov": of the element (i, j) of a covariance √(P_ii P_jj), whatever the units;
- a list: given beside the answer. Components of a mean are judged by themselves or their standard deviation, whichever
  is larger; NIS and log-likelihoods by themselves or 1; heights by the Earth;
- "exact": must be equal.
"""

from __future__ import annotations

import json
import math
from decimal import Context, Decimal
from pathlib import Path

import numpy as np

import trackrs as tr

FOLDER = Path(__file__).resolve().parent / "data" / "certified"
BARS = {"ordinary": 13.0, "hard": 10.0, "nasty": 6.0}
MOST = 15.9
NOTHING = Decimal("1e-290")
WIDE = Context(prec=50)


def load():
    """Every problem, with the name of its family."""
    return [
        problem | {"family": path.stem}
        for path in sorted(FOLDER.glob("*.json"))
        for problem in json.loads(path.read_text())["problems"]
    ]


# --- judging ---------------------------------------------------------------------------------------------------------


def flat(value):
    return [x for item in value for x in flat(item)] if isinstance(value, list) else [value]


def _units(scale, known):
    numbers = flat(known)
    if scale == "each":
        return [max(abs(x), NOTHING) for x in numbers]
    if scale == "row":
        return [max(map(abs, row)) for row in known for _ in row]
    if scale == "cov":
        return [(cov[i][i] * cov[j][j]).sqrt(WIDE) for cov in known for i in range(len(cov)) for j in range(len(cov))]
    return [Decimal(x) for x in flat(scale)]


def digits(found, answer):
    """Correct digits of one answer."""
    scale = answer["scale"]
    if scale == "exact":
        return MOST if np.array_equal(found, answer["value"]) else 0.0

    def decimals(value):
        return [decimals(item) for item in value] if isinstance(value, list) else Decimal(value)

    known = decimals(answer["value"])
    numbers, expected = np.ravel(found).tolist(), flat(known)
    if len(numbers) != len(expected) or not all(map(math.isfinite, numbers)):
        return 0.0
    off = max(
        WIDE.divide(abs(WIDE.subtract(Decimal(x), c)), unit)
        for x, c, unit in zip(numbers, expected, _units(scale, known), strict=True)
    )
    return MOST if off == 0 else float(np.clip(-off.log10(WIDE), 0.0, MOST))


# --- trackrs ---------------------------------------------------------------------------------------------------------


def motion_of(spec):
    spec = dict(spec)
    kind = spec.pop("type")
    if kind == "linear":
        return tr.LinearMotion(spec["F"], spec["Q"])
    if kind == "linear_function":
        f = np.array(spec["F"])
        return tr.CustomMotion(lambda states, _: states @ f.T, spec["Q"])
    if kind == "pendulum":

        def swing(states, dt):
            angle, rate = states.T
            rate = rate - dt * spec["stiffness"] * np.sin(angle)
            return np.stack([angle + dt * rate, rate], axis=1)

        return tr.CustomMotion(swing, spec["Q"])
    kinds = {
        "constant_velocity": tr.ConstantVelocity,
        "constant_acceleration": tr.ConstantAcceleration,
        "singer": tr.Singer,
    }
    return kinds[kind](**spec)


def sensor_of(spec):
    spec = dict(spec)
    kind = spec.pop("type")
    if kind == "linear":
        return tr.LinearSensor(spec["H"], spec["R"])
    if kind == "linear_function":
        h = np.array(spec["H"])
        return tr.CustomSensor(lambda states: states @ h.T, spec["R"])
    if kind == "sine":
        return tr.CustomSensor(lambda states: np.sin(states[:, :1]), [[spec["std"] ** 2]])
    if kind == "position":
        return tr.PositionSensor(dims=len(spec["std"]), std=spec["std"])
    return {"range_bearing": tr.RangeBearing, "range_array": tr.RangeArray}[kind](**spec)


def states_of(specs):
    return [tr.GaussianState(spec["mean"], spec["cov"], spec.get("time", 0.0)) for spec in specs]


def gaps(values):
    return np.array([[math.nan if z is None else z for z in row] for row in values])


def run_of(given):
    """The filter run of a problem."""
    kinds = {
        "kalman": tr.KalmanFilter,
        "extended": tr.ExtendedKalmanFilter,
        "unscented": tr.UnscentedKalmanFilter,
        "cubature": tr.CubatureKalmanFilter,
    }
    more = {key: given[key] for key in ("kappa", "alpha", "beta") if key in given and given["filter"] == "unscented"}
    kind = kinds[given["filter"]]
    made = kind(motion_of(given["motion"]), sensor_of(given["sensor"]), form=given["form"], **more)
    (initial,) = states_of([given["initial"]])
    return made.run(given["times"], gaps(given["values"]), initial=initial, inputs=given.get("inputs"))


def _filter(given):
    run, rows = run_of(given), given["rows"]
    nis = run.nis[rows]
    out = {
        "means": run.means[rows],
        "covs": run.covs[rows],
        "nis": nis[np.isfinite(nis)],
        "log_likelihood": run.log_likelihood,
    }
    if given.get("smooth"):
        smoothed = run.smooth()
        out |= {"smoothed_means": smoothed.means[rows], "smoothed_covs": smoothed.covs[rows]}
    return out


def _marginals(given):
    weights = np.array([[-math.inf if w is None else w for w in row] for row in given["weights"]])
    found = tr.association.marginals(weights, log=given["log"], prune=given["prune"])
    return {"probabilities": found.probabilities, "log_total": found.log_total}


def _tracker(given):
    rule = dict(given["associator"])
    associators = {
        "pda": tr.PDA,
        "jpda": tr.JPDA,
        "npda": tr.NPDA,
    }
    tracker = tr.MultiTargetTracker(
        motion_of(given["motion"]),
        sensors={"radar": sensor_of(given["sensor"])},
        initiator=tr.MofN(3, 5, max_speed=1e6),
        associator=associators[rule.pop("name")](**rule),
        gate=tr.Gate(1.0),
        deletion=tr.Deletion(max_misses=1000),
        detection_probability=given["detection_probability"],
        clutter_density=given["clutter_density"],
        initial=states_of(given["initial"]),
    )
    found = tracker.run([tr.Scan(scan["time"], scan["values"], sensor="radar") for scan in given["scans"]])
    last = found.of_scan(len(given["scans"]) - 1)
    return {"means": [track.state.mean for track in last], "covs": [track.state.cov for track in last]}


def _intensity(given, kind, **more):
    births, initial = states_of(given["births"]), states_of(given["initial"])
    made = kind(
        motion_of(given["motion"]),
        sensor_of(given["sensor"]),
        birth=tr.Birth(births, weights=[part["weight"] for part in given["births"]]),
        clutter_density=given["clutter_density"],
        survival_probability=given["survival_probability"],
        detection_probability=given["detection_probability"],
        prune=given["prune"],
        merge=given["merge"],
        gate=tr.Gate(1.0),
        **more,
    )
    tracker = made.start(initial, weights=[part["weight"] for part in given["initial"]])
    tracker.step(tr.Scan(given["scan"]["time"], given["scan"]["values"], sensor="radar"))
    mixture = tracker.mixture
    order = sorted(range(len(mixture)), key=lambda i: mixture.means[i].tolist())
    out = {"weights": mixture.weights[order], "means": mixture.means[order], "covs": mixture.covs[order]}
    return out if tracker.cardinality is None else out | {"cardinality": tracker.cardinality}


def _gospa(given):
    found = tr.gospa(given["truth"], given["estimates"], given["c"], given["p"], extents=given.get("extents"))
    pairs = [[pair.truth, pair.estimate] for pair in found.pairs]
    parts = {name: getattr(found, name) for name in ("total", "localisation", "missed", "false_tracks")}
    return parts | {"pairs": pairs}


def _ospa(given):
    found = tr.ospa(given["x"], given["y"], given["c"], given["p"])
    return {"total": found.total, "localisation": found.localisation, "cardinality": found.cardinality}


def _density_peaks(given):
    graph = tr.DensityPeakPartition(d_c=given["d_c"]).explain(given["points"], noise=given.get("noise"))
    return {name: getattr(graph, name) for name in ("rho", "delta", "gamma", "order", "nearest_denser")}


def _lof(given):
    found = tr.LocalOutlierFactor(given["n_neighbors"]).explain(given["points"])
    return {name: getattr(found, name) for name in ("k_distance", "reachability_density", "factors")}


def _trees(given):
    single, ward = tr.TreePartition(["single", "ward"]).trees(given["points"])
    return {"single": single.heights, "ward": ward.heights}


def _chi_square(given):
    pairs = zip(given["probabilities"], given["dof"], strict=True)
    return {"quantiles": [tr.Gate(p).threshold(dof) for p, dof in pairs]}


def _nees(given):
    each = [tr.nees([e], [p]) for e, p in zip(given["errors"], given["covs"], strict=True)]
    return {"statistics": [t.statistics[0] for t in each], "p_values": [t.p_values[0] for t in each]}


def _to_geodetic(given):
    found = tr.geodesy.ecef_to_geodetic(given["points"])
    return {"angles": found[:, :2], "heights": found[:, 2]}


SOLVERS = {
    "filter": _filter,
    "marginals": _marginals,
    "tracker": _tracker,
    "phd": lambda given: _intensity(given, tr.GMPHD),
    "cphd": lambda given: _intensity(given, tr.CPHD, max_targets=given["max_targets"]),
    "ospa": _ospa,
    "gospa": _gospa,
    "density_peaks": _density_peaks,
    "lof": _lof,
    "trees": _trees,
    "chi_square": _chi_square,
    "nees": _nees,
    "to_ecef": lambda given: {"points": tr.geodesy.geodetic_to_ecef(given["positions"])},
    "to_geodetic": _to_geodetic,
}


def solved(problem):
    """The correct digits of every answer of trackrs."""
    found = SOLVERS[problem["kind"]](problem["given"])
    return {name: digits(found[name], answer) for name, answer in problem["answers"].items()}
