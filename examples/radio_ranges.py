"""A robot found by ranges from four radios that come one at a time and are all some per cent too long.

    python examples/radio_ranges.py [--out FOLDER]

Tracks the recording of `examples/data/plaza1`: the filter starts by itself, estimates the scale error of the ranges as
a state, and finds the robot again after 97 s without any. Then once more with the robot's odometry as known inputs.
Prints the errors against the true path, which the filter does not see, and leaves a picture in `out/radio_ranges`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import trackrs as tr

if TYPE_CHECKING:
    from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
DATA = HERE / "data" / "plaza1"
# The ranges scatter by half a metre and are wrong by a few per cent. The mower drives a metre a second and turns within
# seconds. A single range says nothing about manoeuvres, so the test of gross errors allows for none.
RANGE_STD, SCALE_STD, ACCEL_PSD = 0.6, 0.1, 0.1
# With odometry the position wanders only by what the wheels slip.
SLIP_PSD = 0.003
SCREEN = tr.ChiSquareScreen(alpha=1e-3, allowance=0.0)


class Recording:
    """The recording as arrays."""

    def __init__(self, folder: Path = DATA) -> None:
        """Read the tables of a folder."""
        radios = np.genfromtxt(folder / "radios.csv", delimiter=",", names=True)
        table = np.genfromtxt(folder / "ranges.csv", delimiter=",", names=True)
        self.times: NDArray[np.float64] = table["time"]
        self.radios = np.stack([radios["x"], radios["y"]], axis=1)
        # One row per range, NaN for the radios that were not asked.
        self.values = np.where(table["radio"][:, None] == radios["radio"], table["range"][:, None], np.nan)
        self.truth = np.stack([table["x"], table["y"]], axis=1)
        odometry = np.stack([table["odometry_x"], table["odometry_y"]], axis=1)
        self.moved = np.diff(odometry, axis=0, prepend=odometry[:1])

    def array(self, range_std: float = RANGE_STD, scale_std: float = SCALE_STD) -> tr.RangeArray:
        """The radios as a sensor."""
        return tr.RangeArray(self.radios, range_std, scale_std=scale_std)


def ranges_only(recording: Recording, accel_psd: float = ACCEL_PSD, range_std: float = RANGE_STD) -> tr.FilterRun:
    """Track the robot by its ranges. Second order: after a gap the position is as uncertain as the ranges are long."""
    motion = tr.ConstantVelocity(dims=2, accel_psd=accel_psd)
    ekf = tr.ExtendedKalmanFilter(motion, recording.array(range_std), screen=SCREEN, second_order=True)
    return ekf.run(recording.times, recording.values)


def with_odometry(recording: Recording, slip_psd: float = SLIP_PSD, range_std: float = RANGE_STD) -> tr.FilterRun:
    """Track the robot by its ranges and how far it says it has moved."""
    motion = tr.RandomWalk(dims=2, velocity_psd=slip_psd)
    ekf = tr.ExtendedKalmanFilter(motion, recording.array(range_std), screen=SCREEN, second_order=True)
    return ekf.run(recording.times, recording.values, inputs=recording.moved)


def located(run: tr.FilterRun) -> NDArray[np.bool_]:
    """Rows that rest on measurements: not before the start, and not while ranges are held after a gap."""
    rows = np.arange(len(run))
    begins = np.isin(rows, [run.start, *run.restarts])
    held = (run.verdicts == tr.Verdict.MISSING).all(axis=1) & ~begins
    return (rows >= run.start) & ~held


def rms(means: NDArray[np.float64], truth: NDArray[np.float64], rows: NDArray[np.bool_]) -> float:
    """Root mean square distance from the true position over these rows, metres."""
    return float(np.sqrt(np.mean(np.sum((means[rows, :2] - truth[rows]) ** 2, axis=1))))


def report(name: str, run: tr.FilterRun, recording: Recording) -> str:
    """One line about a run."""
    smoothed = run.smooth()
    scale = run.labels.index("scale")
    value, sigma = smoothed.means[-1, scale], np.sqrt(smoothed.covs[-1, scale, scale])
    rows = located(run)
    filtered, after = rms(run.means, recording.truth, rows), rms(smoothed.means, recording.truth, rows)
    late = [f"{recording.times[k]:.0f} s" for k in run.restarts]
    return (
        f"{name:14}  start {recording.times[run.start]:4.1f} s  filtered {filtered:.2f} m  smoothed {after:.2f} m  "
        f"scale {value:.4f} +- {sigma:.4f}  found again at {', '.join(late) or '-'}"
    )


def draw(run: tr.FilterRun, recording: Recording, path: Path) -> None:
    """Picture of the smoothed path and of the scale error."""
    from matplotlib.figure import Figure  # noqa: PLC0415 (only the picture needs it)

    smoothed = run.smooth()
    figure = Figure(figsize=(10.0, 4.6), dpi=90, layout="constrained")
    plan, scale = figure.subplots(1, 2)
    plan.plot(*recording.truth.T, color="#000000", linewidth=0.8, label="truth")
    plan.plot(smoothed.means[:, 0], smoothed.means[:, 1], color="#0072B2", linewidth=0.8, label="smoothed")
    plan.plot(*recording.radios.T, "^", color="#D55E00", label="radios")
    plan.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="A robot by ranges alone")
    plan.legend(loc="lower left")
    index = run.labels.index("scale")
    for result, colour, name in ((run, "#D55E00", "filtered"), (smoothed, "#0072B2", "smoothed")):
        mean, sigma = 100.0 * result.means[:, index], 100.0 * np.sqrt(result.covs[:, index, index])
        scale.plot(run.times, mean, color=colour, linewidth=1.0, label=name)
        scale.fill_between(run.times, mean - 2.0 * sigma, mean + 2.0 * sigma, color=colour, alpha=0.25, linewidth=0.0)
    scale.set(xlabel="time (s)", ylabel="scale error (%)", title="Estimated with its 2-sigma band", ylim=(6.0, 8.5))
    scale.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def main() -> None:
    """Run both filters, print their errors, draw the first."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out") / "radio_ranges", help="folder for the picture")
    out = parser.parse_args().out
    recording = Recording()
    run = ranges_only(recording)
    gap = np.diff(recording.times).max()
    print(f"{len(recording.times)} ranges in {recording.times[-1]:.0f} s, none for {gap:.0f} s")
    print(report("ranges only", run, recording))
    print(report("with odometry*", with_odometry(recording), recording))
    print("* The recorded headings equal those of the truth: this figure flatters.")
    draw(run, recording, out / "radio_ranges.png")


if __name__ == "__main__":
    main()
