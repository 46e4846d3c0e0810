"""Tracks in clutter of 10 to 50 false reports a scan: track loss, false tracks and GOSPA, with intervals.

    python benchmarks/tracks_in_clutter.py [--runs 50] [--clutter 10 20 35 50] [--rivals "NPDA 4/6" "NPDA 4/6 pairs"]

Six targets at 10 to 20 m/s begin at random over a square of 1 km in the first 20 of 100 scans of 1 s and stay. A sensor
reports positions (10 m) with P_D = 0.9, and false ones uniform over the square. GOSPA: c = 50 m, p = 2,
alpha = 2. Lost: share of the truth's time after its tenth scan at which no confirmed track is within 50 m of it. A
confirmed track is false if it is within 50 m of a truth for less than half of its life. Where hits are counted a track
is confirmed after 8 of 10, because 4 of 6 drown in false tracks. "Pairs" begin tracks from two reports of at most 2 s.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

import trackrs as tr

SIDE, SCANS, TARGETS, STD, P_D, SPEED, SEED = 1000.0, 100, 6, 10.0, 0.9, 25.0, 11
MOTION = tr.ConstantVelocity(dims=2, accel_psd=0.5)
SENSORS = {"radar": tr.PositionSensor(dims=2, std=STD)}
CUT = 50.0
# A quarter of what a report begins with in the densest clutter: joint sums over still fainter tracks take seconds.
DROP = 3e-4
RIVALS = (
    *("GNN", "GNN 4/6", "GNN 4/6 pairs", "NPDA 4/6", "NPDA 4/6 pairs"),
    *("JPDA", "JPDA*", "JIPDA", "JIPDA*"),
)


@dataclass(frozen=True, slots=True)
class Scene:
    """Truth (target, scan, 4), NaN before its birth, and the scans."""

    truth: np.ndarray
    scans: list[tr.Scan]


def draw(run: int, clutter: float) -> Scene:
    """One run's truth and scans."""
    rng = np.random.default_rng([SEED, run])
    truth = np.full((TARGETS, SCANS, 4), np.nan)
    for target in truth:
        birth = int(rng.integers(0, 20))
        heading, speed = rng.uniform(0, 2 * np.pi), rng.uniform(10, 20)
        velocity = speed * np.array([np.cos(heading), np.sin(heading)])
        middle = rng.uniform(0.25 * SIDE, 0.75 * SIDE, 2)
        start = middle - velocity * 0.25 * (SCANS - birth)
        for k in range(birth, SCANS):
            target[k] = [*(start + velocity * (k - birth)), *velocity]
    scans = []
    for k in range(SCANS):
        alive = truth[~np.isnan(truth[:, k, 0]), k, :2]
        seen = alive[rng.random(len(alive)) < P_D]
        false = rng.uniform(0, SIDE, (rng.poisson(clutter), 2))
        scans.append(tr.Scan(float(k), np.concatenate([seen + rng.normal(0, STD, seen.shape), false]), "radar"))
    return Scene(truth, scans)


def make_tracker(name: str, clutter: float) -> tr.MultiTargetTracker:
    """One of the rivals."""
    counting = {"initiator": tr.MofN(8, 10, max_speed=SPEED)}
    few = tr.MofN(4, 6, max_speed=SPEED)
    pairs = tr.MofN(4, 6, max_speed=SPEED, pair_within=2.0)
    npda = tr.NPDA(clutter_probability=None)
    # New targets per scan over new targets and false reports per scan.
    births = TARGETS / SCANS
    believing = {"initiator": tr.Existence(SPEED, births / (births + clutter), 0.95, drop=DROP, lifetime=300.0)}
    associator, settings = {
        "GNN 4/6": (tr.GlobalNearestNeighbour(), {"initiator": few}),
        "GNN 4/6 pairs": (tr.GlobalNearestNeighbour(), {"initiator": pairs}),
        "NPDA 4/6": (npda, {"initiator": few}),
        "NPDA 4/6 pairs": (npda, {"initiator": pairs}),
        "GNN": (tr.GlobalNearestNeighbour(), counting),
        "JPDA": (tr.JPDA(), counting),
        "JPDA*": (tr.JPDA(coalescence_free=True), counting),
        "JIPDA": (tr.JIPDA(), believing),
        "JIPDA*": (tr.JIPDA(coalescence_free=True), believing),
    }[name]
    return tr.MultiTargetTracker(
        MOTION,
        SENSORS,
        associator=associator,
        gate=tr.Gate(0.99),
        detection_probability=P_D,
        clutter_density=clutter / SIDE**2,
        **settings,
    )


@dataclass(frozen=True, slots=True)
class Score:
    """Of one run."""

    gospa: float
    lost: float
    confirmed: int
    false: int


def score(scene: Scene, tracks: tr.Tracks) -> Score:
    """Compare the tracks with the truth."""
    near: dict[int, list[bool]] = {}
    gospas, held, total = [], 0, 0
    for k in range(SCANS):
        rows = slice(tracks.offsets[k], tracks.offsets[k + 1])
        positions, ids = tracks.means[rows, :2], tracks.ids[rows]
        alive = scene.truth[~np.isnan(scene.truth[:, k, 0]), k, :2]
        gospas.append(tr.gospa(alive, positions, c=CUT, p=2.0, alpha=2.0).total)
        distances = (
            np.linalg.norm(positions[:, None] - alive[None], axis=-1) if len(alive) else np.full((len(ids), 1), np.inf)
        )
        for identity, distance in zip(ids.tolist(), distances.min(axis=1, initial=np.inf), strict=True):
            near.setdefault(identity, []).append(bool(distance <= CUT))
        old = k >= 10 and ~np.isnan(scene.truth[:, k - 10, 0])
        if np.any(old):
            for position in scene.truth[old, k, :2]:
                held += bool((np.linalg.norm(positions - position, axis=1) <= CUT).any())
                total += 1
    false = sum(np.mean(flags) < 0.5 for flags in near.values())
    return Score(float(np.mean(gospas)), 1.0 - held / total, len(near), int(false))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=50, help="(%(default)s)")
    parser.add_argument("--clutter", type=float, nargs="*", default=[10.0, 20.0, 35.0, 50.0], help="(%(default)s)")
    parser.add_argument("--rivals", nargs="*", default=RIVALS, choices=RIVALS, metavar="NAME", help=f"of {RIVALS}")
    arguments = parser.parse_args()
    print(
        f"{arguments.runs} runs, mean ± 95 %: GOSPA m, lost share, false tracks a run, false share of confirmed tracks"
    )
    for clutter in arguments.clutter:
        scenes = [draw(run, clutter) for run in range(arguments.runs)]
        gnn = np.full(arguments.runs, np.nan)
        for name in arguments.rivals:
            scores = [score(scene, make_tracker(name, clutter).run(scene.scans)) for scene in scenes]
            gospas = np.array([s.gospa for s in scores])
            if name == "GNN":
                gnn = gospas
            confirmed, false = sum(s.confirmed for s in scores), sum(s.false for s in scores)
            columns = [gospas, [s.lost for s in scores], [s.false for s in scores], gospas - gnn]
            cells = [f"{np.mean(c):7.3f} ± {1.96 * np.std(c) / np.sqrt(len(c)):.3f}" for c in columns]
            print(
                f"{clutter:4g} {name:15}" + "   ".join(cells[:3]) + f"   {false}/{confirmed} = {false / confirmed:.3f}"
                f"   GOSPA - GNN {cells[3]}",
                flush=True,
            )


if __name__ == "__main__":
    main()
