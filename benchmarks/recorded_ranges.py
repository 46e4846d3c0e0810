"""Recorded radio ranges: what the filter reaches, and how much that depends on each parameter.

    TRACKRS_DATA=FOLDER python benchmarks/recorded_ranges.py [--figure docs/walk_ranges.png]

The robot of `examples/radio_ranges.py` needs nothing. The walking person (five anchors in three dimensions, gross
errors) is `isas_walk_uwb_3d/isas_walk1` in the folder `TRACKRS_DATA`: ISAS-Walk1 of the repository KIT-ISAS/SFUISE (Li,
Cao, Hanebeck, IEEE RA-L 2023), whose licence does not let it be part of this project. Truth is used for scores only.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

import numpy as np

import trackrs as tr

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "examples"))
import radio_ranges  # noqa: E402 (an example is no package)

# A walking person speeds up by some 0.3 m/s² for a second at a time, and hardly up or down. Ranges scatter by a
# decimetre or two where people stand in the way. Between two measurements, a sixteenth of a second, an arm swings by
# two decimetres at most: the allowance.
ACCEL_PSD = (0.1, 0.1, 0.01)
RANGE_STD, BIAS_STD = 0.15, 0.3
SCREEN = tr.ChiSquareScreen(alpha=1e-3, allowance=0.2**2)


def walk_folder() -> Path | None:
    """Where the recording of the walk is, if it is anywhere."""
    folder = Path(os.environ.get("TRACKRS_DATA", "")) / "isas_walk_uwb_3d" / "isas_walk1"
    return folder if "TRACKRS_DATA" in os.environ and folder.is_dir() else None


class Walk:
    """The recording of the walk as arrays."""

    def __init__(self, folder: Path) -> None:
        """Read its tables."""
        anchors, ranges, truth = (
            np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True) for name in ("anchors", "ranges", "truth")
        )
        ids = anchors["anchor_id"].astype(int)
        self.anchors = np.stack([anchors[f"{axis}_m"] for axis in "xyz"], axis=1)
        self.times, rows = np.unique(ranges["t_s"], return_inverse=True)
        self.values = np.full((len(self.times), len(ids)), np.nan)
        self.values[rows, [list(ids).index(int(i)) for i in ranges["anchor_id"]]] = ranges["range_m"]
        tag = [np.interp(self.times, truth["t_s"], truth[f"tag_{axis}_m"]) for axis in "xyz"]
        self.truth = np.stack(tag, axis=1)
        known = json.loads((folder / "alignment.json").read_text())["range_bias_m"]
        self.biases = np.array([known[str(i)] for i in ids])


def walked(
    walk: Walk,
    *,
    known: bool = False,
    accel: float = 1.0,
    range_std: float = RANGE_STD,
    bias_std: float = BIAS_STD,
    alpha: float = SCREEN.alpha,
) -> tr.FilterRun:
    """Track the person; biases estimated, or `known` and subtracted. `accel` multiplies the noise of the motion."""
    array = tr.RangeArray(walk.anchors, range_std, bias_std=None if known else bias_std)
    motion = tr.ConstantVelocity(dims=3, accel_psd=[accel * psd for psd in ACCEL_PSD])
    screen = tr.ChiSquareScreen(alpha=alpha, allowance=SCREEN.allowance)
    ekf = tr.ExtendedKalmanFilter(motion, array, screen=screen)
    return ekf.run(walk.times, walk.values - walk.biases if known else walk.values)


def scores(run: tr.FilterRun, truth: np.ndarray) -> tuple[float, float]:
    """Root mean square position error filtered and smoothed, from the start on, metres."""
    dims = truth.shape[1]
    filtered, smoothed = (
        np.linalg.norm(means[run.start :, :dims] - truth[run.start :], axis=1)
        for means in (run.means, run.smooth().means)
    )
    return float(np.sqrt(np.mean(filtered**2))), float(np.sqrt(np.mean(smoothed**2)))


def show_robot() -> None:
    """Print what the robot's ranges give, and how it changes."""
    recording = radio_ranges.Recording()
    print("robot, ranges only (rows held after the gap left out of both; smoothed over all rows in brackets)")
    for changes in ({}, {"accel_psd": 0.05}, {"accel_psd": 0.2}, {"range_std": 0.3}, {"range_std": 1.2}):
        run = radio_ranges.ranges_only(recording, **changes)
        rows, smoothed, truth = radio_ranges.located(run), run.smooth().means, recording.truth
        every = np.arange(len(run)) >= run.start
        filtered, after = radio_ranges.rms(run.means, truth, rows), radio_ranges.rms(smoothed, truth, rows)
        whole = radio_ranges.rms(smoothed, truth, every)
        held = int(every.sum() - rows.sum())
        print(f"  {changes or 'default'!s:24} filtered {filtered:.3f}  smoothed {after:.3f} ({whole:.3f})  held {held}")
    print("robot with odometry; its recorded headings equal those of the truth, so these figures flatter")
    for changes in ({}, {"slip_psd": 0.0015}, {"slip_psd": 0.006}, {"range_std": 0.3}, {"range_std": 1.2}):
        run = radio_ranges.with_odometry(recording, **changes)
        filtered, after = scores(run, recording.truth)
        print(f"  {changes or 'default'!s:24} filtered {filtered:.3f}  smoothed {after:.3f}")


def show_walk(walk: Walk) -> None:
    """Print what the walk gives, and how it changes."""
    for known, title in ((False, "walk, biases estimated"), (True, "walk, biases known")):
        print(title)
        changed = [{"accel": 0.5}, {"accel": 2.0}, {"range_std": 0.075}, {"range_std": 0.3}, {"alpha": 1e-2}]
        if not known:
            changed += [{"bias_std": 0.15}, {"bias_std": 0.6}]
        for changes in ({}, *changed):
            run = walked(walk, known=known, **changes)
            filtered, after = scores(run, walk.truth)
            used = (run.verdicts[run.start + 1 :] == tr.Verdict.USED).sum(axis=1)
            rejected = int((run.verdicts == tr.Verdict.REJECTED).sum())
            print(
                f"  {changes or 'default'!s:24} filtered {filtered:.3f}  smoothed {after:.3f}  start row {run.start}  "
                f"rejected {rejected}  fewest used {used.min()}  restarts {len(run.restarts)}"
            )


def draw_walk(walk: Walk, path: Path) -> None:
    """Picture of the smoothed walk from above and of the biases as the filter learns them."""
    from matplotlib.figure import Figure

    run = walked(walk)
    smoothed = run.smooth()
    figure = Figure(figsize=(10.0, 4.4), dpi=90, layout="constrained")
    plan, biases = figure.subplots(1, 2)
    plan.plot(walk.truth[:, 0], walk.truth[:, 1], color="#000000", linewidth=0.8, label="truth")
    plan.plot(smoothed.means[:, 0], smoothed.means[:, 1], color="#0072B2", linewidth=1.0, label="smoothed")
    plan.plot(walk.anchors[:, 0], walk.anchors[:, 1], "^", color="#D55E00", label="anchors")
    plan.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="A person walking between five anchors")
    plan.legend(loc="lower left")
    colours = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
    for i, colour in enumerate(colours):
        index = run.labels.index(f"bias{i}")
        mean, sigma = run.means[:, index], np.sqrt(run.covs[:, index, index])
        biases.plot(run.times, mean, color=colour, linewidth=1.0, label=f"bias{i}")
        biases.fill_between(run.times, mean - 2.0 * sigma, mean + 2.0 * sigma, color=colour, alpha=0.12, linewidth=0.0)
        biases.axhline(walk.biases[i], color=colour, linewidth=0.8, linestyle=":")
    biases.set(xlabel="time (s)", ylabel="range bias (m)", title="Estimated, 2-sigma; dotted: fitted with the truth")
    biases.set_ylim(-0.6, 0.6)
    biases.legend(ncols=5, loc="upper center", fontsize="small")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def main() -> None:
    """Print both tables, and draw the walk where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, help="where to draw the walk")
    figure = parser.parse_args().figure
    show_robot()
    folder = walk_folder()
    if folder is None:
        print("walk: not there; set TRACKRS_DATA to the folder that holds isas_walk_uwb_3d")
        return
    walk = Walk(folder)
    show_walk(walk)
    if figure is not None:
        draw_walk(walk, figure)


if __name__ == "__main__":
    main()
