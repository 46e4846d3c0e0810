"""Three targets side by side, reported one at a time: figures 3 and 4 of the NPDA paper, and what its rivals really do.

    python examples/close_targets.py [--out FOLDER] [--runs N]

The paper shows NPDA holding three targets (figure 3) where "JPDAF" merges them (figure 4). That JPDAF gives every gated
target the report for certain, which is not JPDA: a report is of one target at most. This draws both figures and, beside
them, properly applied JPDA, global nearest neighbour and the coalescence-free JPDA on scans of three reports, at the
paper's separation of 300 m and at 150 m, where association begins to matter. The table is over N runs; the picture
(PNG, in `out/close_targets`) is of the first. `benchmarks/close_targets.py` has the whole study.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import trackrs as tr

SEED = 2009
SEPARATIONS = (300.0, 150.0)


@dataclass(frozen=True, slots=True)
class Rival:
    """An association, and how many reports make a scan."""

    name: str
    associator: tr.association.Associator
    reports: int


RIVALS = (
    Rival("NPDA (figure 3)", tr.NPDA(covariance="paper"), 1),
    Rival('"JPDAF" as printed (figure 4)', tr.PDA(), 1),
    Rival("JPDA", tr.JPDA(), 3),
    Rival("global nearest neighbour", tr.GlobalNearestNeighbour(), 3),
    Rival("JPDA, coalescence-free", tr.JPDA(coalescence_free=True), 3),
)


def track(scene: tr.scenarios.CloseTargets, rival: Rival, run: int) -> np.ndarray:
    """The estimates after every third report, (times, targets, 4)."""
    tracker = tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_std=2.0),
        sensors={"radar": scene.radar},
        initiator=tr.MofN(3, 5, max_speed=1e4),
        associator=rival.associator,
        gate=tr.Gate(1.0),
        deletion=tr.Deletion(max_misses=1000),
        detection_probability=1.0,
        clutter_density=0.0,
        initial=scene.initial,
    )
    scans = scene.draw(SEED, run).scans(rival.reports)
    means = tracker.run(scans).means.reshape(len(scans), len(scene.initial), 4)
    return means[2::3] if rival.reports == 1 else means


def is_right(estimates: np.ndarray, truth: np.ndarray, separation: float) -> bool:
    """Whether at the end each track is nearest to its own target and none has merged with another."""
    nearest = np.linalg.norm(estimates[:, None] - truth[None], axis=-1).argmin(axis=1)
    between = np.linalg.norm(estimates[:, None] - estimates[None], axis=-1)[np.triu_indices(len(truth), 1)]
    return bool((nearest == np.arange(len(truth))).all() and between.min() >= separation / 2)


def main() -> None:
    """Track, print the table and draw the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("out/close_targets"), help="folder of the picture (%(default)s)"
    )
    parser.add_argument("--runs", type=int, default=50, help="(%(default)s)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(16, 6.4), layout="constrained")
    axes = figure.subplots(len(SEPARATIONS), len(RIVALS), sharex=True, sharey="row")
    print(f"{'association':30}" + "".join(f"  {f'd = {d:.0f} m: rms':>17}  {'right':>5}" for d in SEPARATIONS))
    lines = {rival.name: f"{rival.name:30}" for rival in RIVALS}
    for row, separation in zip(axes, SEPARATIONS, strict=True):
        scene = tr.scenarios.close_targets(separation=separation)
        truth = scene.truth[2::3, :, :2]
        for axis, rival in zip(row, RIVALS, strict=True):
            runs = np.stack([track(scene, rival, run)[:, :, :2] for run in range(arguments.runs)])
            rms = np.sqrt(np.mean(np.sum((runs - truth) ** 2, axis=-1)))
            right = np.mean([is_right(run[-1], truth[-1], separation) for run in runs])
            lines[rival.name] += f"  {rms:15.1f} m  {right:5.0%}"
            axis.plot(truth[:, :, 0] / 1e3, truth[:, :, 1] / 1e3, color="0.6", linewidth=3, solid_capstyle="round")
            for target, colour in enumerate(("tab:blue", "tab:orange", "tab:green")):
                x, y = runs[0, :, target].T / 1e3
                axis.plot(x, y, ".-", color=colour, markersize=4, linewidth=1)
            axis.set_title(rival.name if separation == SEPARATIONS[0] else "", fontsize=10)
            axis.annotate(
                f"rms {rms:.0f} m, all right in {right:.0%}", (0.03, 0.03), xycoords="axes fraction", fontsize=8
            )
        row[0].margins(y=0.15)
        row[0].set_ylabel(f"{separation:.0f} m apart\ny (km)")
    for axis in axes[-1]:
        axis.set_xlabel("x (km)")
    figure.suptitle("Three targets side by side, one report every 3 s: truth (grey) and tracks")
    picture = arguments.out / "close_targets.png"
    figure.savefig(picture, dpi=100)
    print("\n".join(lines.values()))
    print("rms: position, after every third report. right: at the end every track is its own target's, none merged.")
    print(f"Picture: {picture}")


if __name__ == "__main__":
    main()
