"""Do PHD and CPHD count as their own model says? `python benchmarks/cardinality.py [--runs 1000]`.

The truth of every run is drawn from the filters' model: births Poisson, each from one of sixteen Gaussian places,
survival and detection with the filters' probabilities, motion with their noise, clutter uniform. Twenty targets on the
average. Then the sum of the weights is the mean number of targets given the scans, and its mean error over runs zero.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor

import numpy as np

import trackrs as tr

SURVIVAL, DETECTION, BIRTHS, CLUTTER, SIDE, SCANS = 0.95, 0.95, 1.0, 50.0, 2000.0, 60
PLACES = np.array([[x, y] for x in (250.0, 750.0, 1250.0, 1750.0) for y in (250.0, 750.0, 1250.0, 1750.0)])
SPREAD = np.diag([100.0, 100.0, 5.0, 5.0]) ** 2


def filters() -> dict[str, tr.GMPHD | tr.CPHD]:
    """Return the two filters; so that nothing is lost that the model has, little is pruned and no gate is near."""
    births = [tr.GaussianState([*place, 0.0, 0.0], SPREAD, time=0.0) for place in PLACES]
    common = {
        "birth": tr.Birth(births, BIRTHS / len(births)),
        "clutter_density": CLUTTER / SIDE**2,
        "survival_probability": SURVIVAL,
        "detection_probability": DETECTION,
        "gate": tr.Gate(0.99999),
        "prune": 1e-5,
        "max_components": 600,
    }
    models = tr.ConstantVelocity(dims=2, accel_psd=0.1), tr.PositionSensor(dims=2, std=10.0)
    return {"PHD": tr.GMPHD(*models, **common), "CPHD": tr.CPHD(*models, **common)}


def draw(seed: int, run: int) -> tuple[list[tr.Scan], np.ndarray]:
    """Return the scans of one run and the true number of targets in each."""
    rng = np.random.default_rng([seed, run])
    motion = tr.ConstantVelocity(dims=2, accel_psd=0.1)
    transition, noise = motion.transition(1.0), np.linalg.cholesky(motion.noise(1.0))
    states, scans, counts = np.zeros((0, 4)), [], []
    for k in range(SCANS):
        states = states[rng.random(len(states)) < SURVIVAL] @ transition.T
        states = states + rng.standard_normal(states.shape) @ noise.T
        born = PLACES[rng.integers(len(PLACES), size=rng.poisson(BIRTHS))]
        born = np.concatenate([born, np.zeros_like(born)], axis=1)
        states = np.concatenate([states, born + rng.standard_normal(born.shape) @ np.sqrt(SPREAD)])
        seen = states[rng.random(len(states)) < DETECTION, :2]
        seen = seen + 10.0 * rng.standard_normal(seen.shape)
        clutter = rng.uniform(0.0, SIDE, (rng.poisson(CLUTTER), 2))
        scans.append(tr.Scan(float(k), np.concatenate([seen, clutter]), sensor="radar"))
        counts.append(len(states))
    return scans, np.array(counts)


def errors(seed: int, run: int) -> dict[str, np.ndarray]:
    """Return per filter the sum of the weights minus the truth (SCANS,)."""
    scans, truth = draw(seed, run)
    return {name: phd.run(scans).expected_targets - truth for name, phd in filters().items()}


def main() -> None:
    """Run the study and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=7)
    args = parser.parse_args()
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        parts = list(pool.map(errors, [args.seed] * args.runs, range(args.runs), chunksize=10))
    print(f"{args.runs} runs, scans 20 to {SCANS - 1}: sum of the weights minus the number of targets")
    for name in parts[0]:
        found = np.array([part[name] for part in parts])[:, 20:]
        means = found.mean(axis=0)
        interval = 1.96 * found.mean(axis=1).std(ddof=1) / np.sqrt(args.runs)
        print(
            f"{name:5s} mean {found.mean():+.3f} ± {interval:.3f}, worst scan {means[np.abs(means).argmax()]:+.3f}, "
            f"variance {found.var(axis=0, ddof=1).mean():.3f}"
        )


if __name__ == "__main__":
    main()
