"""A manoeuvring vessel heard by hydrophones: the filter starts itself, finds gross errors and estimates its noise.

    python examples/underwater.py [--out FOLDER] [--runs N]

Draws N runs of the underwater scenario for each of its arrays, BATS (three hydrophones and the depth) and TOSS (six),
clean and with 5 % of the ranges wrong by 10 to 100 m, prints a table, and leaves pictures (PNG) of the first run with
gross errors of each array in `out/underwater`. The same table in Rust: `cargo run --release --example underwater`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import trackrs as tr
from trackrs.plot import plot_innovations, plot_noise, plot_run

SEED = 1
SETTLED = 12  # errors count from the thirteenth measurement on
MOTION = tr.ConstantAcceleration(dims=3, jerk_std=0.1)


def make_filter(array: tr.RangeArray) -> tr.ExtendedKalmanFilter:
    """One setting for both arrays."""
    adapt, screen = tr.LimitedMemoryNoise(window=20), tr.ChiSquareScreen(alpha=0.01)
    return tr.ExtendedKalmanFilter(MOTION, array, adapt=adapt, screen=screen)


@dataclass(frozen=True, slots=True)
class Score:
    """What one run was like."""

    filtered: float
    smoothed: float
    worst: float
    rejected: int
    tested: int
    found: int
    gross: int
    restarts: int
    milliseconds: float


def score(run: tr.FilterRun, smoothed: tr.SmoothedRun, recording: tr.scenarios.Recording, seconds: float) -> Score:
    """Score a run against the truth."""
    first = max(SETTLED, run.start)
    errors = [(means - recording.truth)[first:, :3] for means in (run.means, smoothed.means)]
    tested = run.verdicts[run.start + 1 :] != tr.Verdict.MISSING
    rejected = run.verdicts[run.start + 1 :] == tr.Verdict.REJECTED
    gross = recording.gross[run.start + 1 :]
    return Score(
        filtered=tr.rmse(errors[0]),
        smoothed=tr.rmse(errors[1]),
        worst=float(np.linalg.norm(errors[0], axis=1).max()),
        rejected=int(rejected.sum()),
        tested=int(tested.sum()),
        found=int((rejected & gross).sum()),
        gross=int(gross.sum()),
        restarts=len(run.restarts),
        milliseconds=1e3 * seconds,
    )


def draw(array: str, run: tr.FilterRun, smoothed: tr.SmoothedRun, scene: tr.scenarios.Underwater, out: Path) -> None:
    """Leave the pictures of the first run."""
    recording = scene.draw(SEED)
    title = f"{array.upper()}: a manoeuvring vessel, 5 % of the ranges wrong by 10 to 100 m"
    pictures = {
        "": plot_run(run, sensor=scene.array, truth=recording.truth, smoothed=smoothed, title=title),
        "_innovations": plot_innovations(run, sensor=scene.array, values=recording.values, title=array.upper()),
        "_noise": plot_noise(run, sensor=scene.array, title=f"{array.upper()}: noise as estimated"),
    }
    for name, axes in pictures.items():
        axes[0].figure.savefig(out / f"{array}{name}.png")


def study(array: str, gross: float, runs: int, out: Path) -> list[Score]:
    """Filter, smooth and score some runs."""
    scene = tr.scenarios.underwater(array, gross=gross)
    ekf = make_filter(scene.array)
    scores = []
    for number in range(runs):
        recording = scene.draw(SEED, run=number)
        begun = time.perf_counter()
        run = ekf.run(recording.times, recording.values)
        seconds = time.perf_counter() - begun
        smoothed = run.smooth()
        scores.append(score(run, smoothed, recording, seconds))
        if gross > 0.0 and number == 0:
            draw(array, run, smoothed, scene, out)
    return scores


def line(array: str, gross: float, scores: list[Score]) -> str:
    """One line of the table: rms as median over the runs, the rest in total."""

    def total(name: str) -> int:
        return sum(getattr(one, name) for one in scores)

    found = f"{total('found')}/{total('gross')}" if gross > 0.0 else "-"
    return "  ".join(
        [
            f"{array:5}",
            f"{gross:5.0%}",
            f"{np.median([one.filtered for one in scores]):10.3f}",
            f"{np.median([one.smoothed for one in scores]):10.3f}",
            f"{max(one.worst for one in scores):7.1f}",
            f"{total('rejected') / total('tested'):9.2%}",
            f"{found:>10}",
            f"{total('restarts'):8}",
            f"{np.mean([one.milliseconds for one in scores]):6.1f}",
        ]
    )


def main() -> None:
    """Print the table and draw the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/underwater"), help="folder of pictures (%(default)s)")
    parser.add_argument("--runs", type=int, default=20, help="runs per line of the table (%(default)s)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    print("array  gross  filtered m  smoothed m  worst m   rejected       found  restarts  ms/run")
    for array in ("bats", "toss"):
        for gross in (0.0, 0.05):
            print(line(array, gross, study(array, gross, arguments.runs, arguments.out)))
    print("filtered, smoothed: rms of the position, median over the runs. found: gross errors that were rejected.")
    print(f"Pictures: {arguments.out}")


if __name__ == "__main__":
    main()
