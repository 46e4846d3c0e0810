"""Close targets, 500 runs: which association holds three targets side by side, without clutter and in it.

    python benchmarks/close_targets.py [--runs 500] [--clutter 0 0.05 0.1 0.2]

The table of section 5 of the NPDA spec. Right: at the end each track's nearest truth is its own, and no two estimates
are closer than half the separation. rms: of the position, over targets and the times after every third report.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

import trackrs as tr

MOTION = tr.ConstantVelocity(dims=2, accel_std=2.0)
GATE = 1.0 - np.exp(-8.0)  # d² <= 16
SEED = 2009


@dataclass(frozen=True, slots=True)
class Rival:
    """An association and the scans it works on."""

    name: str
    associator: object
    size: int = 1


RIVALS = (
    Rival("NPDA paper", tr.NPDA(covariance="paper")),
    Rival("NPDA", tr.NPDA()),
    Rival("JPDAF as printed", tr.PDA()),
    Rival("JPDA single", tr.JPDA()),
    Rival("JPDA* single", tr.JPDA(coalescence_free=True)),
    Rival("NN by distance", tr.NearestNeighbour(by="distance")),
    Rival("NN by likelihood", tr.NearestNeighbour()),
    Rival("JPDA scan", tr.JPDA(), 3),
    Rival("JPDA* scan", tr.JPDA(coalescence_free=True), 3),
    Rival("GNN scan", tr.GlobalNearestNeighbour(), 3),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of all runs of one rival.

    Attributes:
        errors: (runs, times, targets) position errors, metres.
        right, coalesced, swapped: (runs,) at the end.
    """

    errors: np.ndarray
    right: np.ndarray
    coalesced: np.ndarray
    swapped: np.ndarray

    @property
    def rms(self) -> float:
        """Root of the mean square of all errors."""
        return float(np.sqrt(np.mean(self.errors**2)))


def track(
    scene: tr.scenarios.CloseTargets, rival: Rival, reports: tr.scenarios.CloseReports, clutter: float
) -> np.ndarray:
    """The means (times, targets, 4) after every third report."""
    settings: dict[str, object] = {"clutter_density": 0.0, "detection_probability": 1.0, "gate": tr.Gate(1.0)}
    associator = rival.associator
    if clutter > 0.0:
        # The density of false reports, r / area per metre and radian, where the middle target is on the average.
        middle = scene.truth[:, scene.truth.shape[1] // 2, :2]
        density = clutter * rival.size * np.linalg.norm(middle, axis=1).mean() / scene.clutter_area
        detection = (1.0 - clutter) * rival.size / len(scene.initial)
        settings = {"clutter_density": density, "detection_probability": detection, "gate": tr.Gate(GATE)}
        if isinstance(associator, tr.NPDA):
            associator = tr.NPDA(clutter, associator.covariance, associator.bookkeeping)
    tracker = tr.MultiTargetTracker(
        MOTION,
        sensors={"radar": scene.radar},
        initiator=tr.MofN(64, 64, max_speed=1e6),
        associator=associator,
        deletion=tr.Deletion(max_misses=1_000_000),
        initial=scene.initial,
        **settings,
    )
    tracks = tracker.run(reports.scans(rival.size))
    ours = np.isin(tracks.ids, np.arange(1, len(scene.initial) + 1))
    means = tracks.means[ours].reshape(len(tracks.scan_times), -1, 4)
    return means[2::3] if rival.size == 1 else means


def study(rival: Rival, separation: float, runs: int, clutter: float = 0.0, order: str = "cyclic") -> Outcome:
    """Track all runs."""
    scene = tr.scenarios.close_targets(separation=separation, clutter=clutter, order=order)
    truth = scene.truth[2::3, :, :2]
    errors, right, coalesced, swapped = [], [], [], []
    for run in range(runs):
        estimates = track(scene, rival, scene.draw(SEED, run), clutter)[:, :, :2]
        errors.append(np.linalg.norm(estimates - truth, axis=-1))
        last = estimates[-1]
        nearest = np.linalg.norm(last[:, None] - truth[-1][None], axis=-1).argmin(axis=1)
        between = np.linalg.norm(last[:, None] - last[None], axis=-1)
        apart = between[np.triu_indices(len(last), 1)].min() >= separation / 2
        own = np.array_equal(nearest, np.arange(len(last)))
        right.append(own and apart)
        coalesced.append(not apart)
        swapped.append(not own and len(set(nearest.tolist())) == len(last))
    return Outcome(np.array(errors), np.array(right), np.array(coalesced), np.array(swapped))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=500, help="(%(default)s)")
    parser.add_argument("--clutter", type=float, nargs="*", default=[0.0, 0.05, 0.1, 0.2], help="(%(default)s)")
    arguments = parser.parse_args()
    for clutter in arguments.clutter:
        print(f"P_c = {clutter:g}: rms m / right / coalesced / swapped, {arguments.runs} runs")
        separations = (50.0, 100.0, 150.0, 200.0, 300.0, 500.0, 1000.0) if clutter == 0.0 else (150.0, 300.0)
        print("d m".ljust(6) + "".join(rival.name.center(25) for rival in RIVALS))
        for separation in separations:
            cells = []
            for rival in RIVALS:
                out = study(rival, separation, arguments.runs, clutter)
                shares = " ".join(f"{share.mean():.3f}" for share in (out.right, out.coalesced, out.swapped))
                cells.append(f"{out.rms:6.1f} {shares}".center(25))
            print(f"{separation:<6g}" + "".join(cells), flush=True)


if __name__ == "__main__":
    main()
