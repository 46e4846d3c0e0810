"""The pose of a head between the frames of a camera: turntable, moving head, recorded head, and the camera itself.

    python examples/helmet.py [--out FOLDER] [--runs N]

The turntable and its table are those of Sun and Zhang (2015): 10 degrees a second, 20 frames a second, predicted to
the middle of every interval; as printed and by default. The moving head shows what their noise rule does to a motion
that is not steady. The recorded head (`examples/data/hmd360`) is fed every second sample and predicted to the one left
out. The camera sees five points of a body: filtered by the pose of each image, or by the image points themselves, of
which two are hidden for a while. Prints the errors and leaves pictures (PNG) in `out/helmet`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

import trackrs as tr
from trackrs import rotation

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

HERE = Path(__file__).resolve().parent
SEED = 1
# Degrees and seconds, as in the paper.
STD, PERIOD, FRAMES, SETTLED = 0.0724, 0.05, 181, 20
# One run of the paper's Table 1, degrees: standard deviations.
PAPER = {"measurement": 0.0724, "prediction": 0.0736, "estimate": 0.0732}


def tidy(ax: Axes) -> None:
    """Draw a light grid and no box."""
    ax.grid(color="#E3E3E3", linewidth=0.5)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8)


def turntable(t: Array) -> Array:
    """Turn steadily."""
    return np.asarray(10.0 * t)


def moving_head(t: Array) -> Array:
    """Shake a head, with a nod twice as fast on top."""
    return np.asarray(30.0 * np.sin(2 * np.pi * 0.5 * t) + 5.0 * np.sin(2 * np.pi * 1.3 * t))


@dataclass(frozen=True, slots=True)
class Angles:
    """One run of one axis, all in degrees."""

    times: Array
    truth: Array
    measured: Array
    estimated: Array
    lead_times: Array
    lead_truth: Array
    predicted: Array

    def errors(self) -> dict[str, Array]:
        """Errors once the filter has settled; the last prediction has no measurement after it."""
        return {
            "measurement": (self.measured - self.truth)[SETTLED:],
            "prediction": (self.predicted - self.lead_truth)[SETTLED:-1],
            "estimate": (self.estimated - self.truth)[SETTLED:],
        }


def axis_filters(jerk_psd: float) -> dict[str, tr.UnscentedKalmanFilter]:
    """The filter as printed and by default."""
    motion, sensor = tr.ConstantAcceleration(dims=1, jerk_psd=jerk_psd), tr.PositionSensor(dims=1, std=STD)
    return {
        "as printed": tr.UnscentedKalmanFilter.as_printed(motion, sensor, r_limits=(1e-9 * STD**2, 1e4)),
        "default": tr.UnscentedKalmanFilter(motion, sensor),
    }


def follow(ukf: tr.UnscentedKalmanFilter, angle: Callable[[Array], Array], count: int, seed: int) -> Angles:
    """Measure an angle with noise, filter it, and predict it to the middle of every interval."""
    times = PERIOD * np.arange(count)
    measured = angle(times) + STD * np.random.default_rng(seed).normal(size=count)
    start = tr.GaussianState([measured[0], 0.0, 0.0], np.diag([STD**2, 1e3, 1e4]), times[0])
    run = ukf.run(times[1:], measured[1:, None], initial=start, lead="midpoint")
    ahead = run.lead_times
    return Angles(times[1:], angle(times[1:]), measured[1:], run.means[:, 0], ahead, angle(ahead), run.lead_means[:, 0])


def table_line(name: str, values: dict[str, float]) -> str:
    """Standard deviations, degrees, and their ratios to that of the measurement."""
    numbers = "".join(f"{values[key]:13.4f}" for key in PAPER)
    return f"{name:24}{numbers}{values['prediction'] / values['measurement']:8.3f}"


def draw_errors(ax: Axes, angles: Angles, rows: slice, title: str) -> None:
    """The paper's figures 3 and 4: errors of measurement, prediction and estimate."""
    ax.plot(angles.times[rows], (angles.measured - angles.truth)[rows], "*", ms=4, label="measured", color="#999999")
    ax.plot(angles.lead_times[rows], (angles.predicted - angles.lead_truth)[rows], "-", lw=1, label="predicted")
    ax.plot(angles.times[rows], (angles.estimated - angles.truth)[rows], "-", lw=1, label="estimated")
    ax.set_title(title, fontsize=9, loc="left")
    ax.set_ylabel("error, degrees", fontsize=8)
    tidy(ax)


def study_turntable(runs: int, out: Path) -> None:
    """Table 1 of the paper, and its figures."""
    print(f"turntable, {runs} runs: standard deviations, degrees")
    print(f"{'':24}" + "".join(f"{key:>13}" for key in PAPER) + "   ratio")
    print(table_line("paper, Table 1 (one run)", PAPER))
    figure = Figure(dpi=150, figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 2, sharey=True)
    for row, (name, ukf) in zip(axes, axis_filters(1.0).items(), strict=True):
        parts = [follow(ukf, turntable, FRAMES, SEED + run) for run in range(runs)]
        spread = {key: float(np.mean([np.std(part.errors()[key], ddof=1) for part in parts])) for key in PAPER}
        print(table_line(name, spread))
        draw_errors(row[0], parts[0], slice(None), f"turntable, {name}")
        inside = (parts[0].times >= 3.0) & (parts[0].times <= 5.0)
        first, last = np.flatnonzero(inside)[[0, -1]]
        draw_errors(row[1], parts[0], slice(first, last + 1), "from 3 to 5 s")
    axes[0, 0].legend(fontsize=8, loc="upper right")
    for ax in axes[1]:
        ax.set_xlabel("time, s", fontsize=8)
    figure.savefig(out / "turntable.png")


def study_moving_head(out: Path) -> None:
    """A motion that is not steady: angle above, error below."""
    choice = tr.choose_jerk_psd(amplitude=5.0, frequency=1.3, period=PERIOD, std=STD)
    print("\nmoving head, one minute: rms, degrees")
    figure = Figure(dpi=150, figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for column, (name, ukf) in enumerate(axis_filters(choice.psd).items()):
        angles = follow(ukf, moving_head, 1200, SEED)
        rms = {key: float(np.sqrt(np.mean(error**2))) for key, error in angles.errors().items()}
        print(f"{name:24}" + "".join(f"{key:>14} {rms[key]:.4f}" for key in PAPER))
        part = slice(400, 480)
        above, below = axes[0, column], axes[1, column]
        above.plot(angles.times[part], angles.measured[part], "*", ms=4, color="#999999", label="measured")
        above.plot(angles.lead_times[part], angles.predicted[part], "-", lw=1, label="predicted")
        above.plot(angles.times[part], angles.estimated[part], "-", lw=1, label="estimated")
        above.set_title(f"moving head, {name}", fontsize=9, loc="left")
        above.set_ylabel("angle, degrees", fontsize=8)
        tidy(above)
        draw_errors(below, angles, part, "")
        below.set_xlabel("time, s", fontsize=8)
    axes[0, 0].legend(fontsize=8)
    figure.savefig(out / "moving_head.png")


# A head changes its turning within hundredths of a second and jerks now and then; the headset's noise is below a
# milliradian. A jump of more than this, radians, is the recording's, not the head's.
HEADSET = tr.Singer(dims=3, accel_std=3.5, time_constant=0.025, accel_psd=0.2)
HEADSET_STD, JUMP = 6e-4, 0.2


def headset_filter() -> tr.ExtendedKalmanFilter:
    """One setting for all recordings of the device."""
    sensor = tr.PoseSensor(angle_std=HEADSET_STD, attitude="quaternion")
    return tr.ExtendedKalmanFilter(HEADSET, sensor, screen=tr.ChiSquareScreen(alpha=1e-3, allowance=JUMP**2))


def study_recorded_head(out: Path) -> None:
    """Every second sample of a recorded head, and the one left out as predicted."""
    times, *columns = np.genfromtxt(HERE / "data" / "hmd360" / "user2.csv", delimiter=",", skip_header=1).T
    quaternions = np.stack(columns, axis=1)
    pairs = len(times) // 2
    fed, left_out = slice(0, 2 * pairs, 2), slice(1, 2 * pairs, 2)
    run = headset_filter().run(times[fed], quaternions[fed], lead=times[left_out] - times[fed])
    vectors = rotation.vectors_from_quaternions(quaternions)
    found = slice(run.start, None)
    predicted = rotation.between(run.lead_means[found, :3], vectors[left_out][found])
    held = rotation.between(vectors[fed][found], vectors[left_out][found])
    errors = {
        "prediction": np.degrees(np.linalg.norm(predicted, axis=1)),
        "hold": np.degrees(np.linalg.norm(held, axis=1)),
    }
    print(f"\nrecorded head, {times[-1] - times[0]:.0f} s, predicted by {1e3 * np.median(np.diff(times)):.0f} ms")
    for name, error in errors.items():
        print(f"{name:12} median {np.median(error):.4f}, 95 % below {np.percentile(error, 95):.4f} degrees")
    heading = np.degrees(np.unwrap(rotation.angles_from_vectors(vectors)[:, 2]))
    figure = Figure(dpi=150, figsize=(9, 5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(times, heading, lw=1)
    above.set_ylabel("heading, degrees", fontsize=8)
    above.set_title("a recorded head; every second sample is left out and predicted", fontsize=9, loc="left")
    for name, error in reversed(errors.items()):
        below.plot(times[left_out][found], error, lw=0.6, label=name)
    below.set_ylabel("error, degrees", fontsize=8)
    below.set_xlabel("time, s", fontsize=8)
    below.set_ylim(0.0, 1.2 * float(np.percentile(errors["hold"], 99)))
    below.legend(fontsize=8)
    tidy(above)
    tidy(below)
    figure.savefig(out / "recorded_head.png")


# Five points on the helmet, metres: a centre and a cross; seen from a metre away, its plane tilted by 30 degrees.
CROSS = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [-0.1, 0.0, 0.0], [0.0, -0.1, 0.0]]
CAMERA = tr.CameraSensor(CROSS, intrinsics=(1000.0, 1000.0, 640.0, 480.0), pixel_std=0.3)
HIDDEN = slice(120, 160)


def helmet_path(t: Array) -> Array:
    """Position and rotation vector (T, 6) of a helmet that moves before the camera."""
    sway = np.stack([0.05 * np.sin(2.0 * t), 0.03 * np.sin(2.6 * t), 1.0 + 0.05 * np.sin(1.4 * t)], axis=1)
    tilt = np.stack([0.1 * np.sin(1.8 * t), np.full_like(t, np.radians(30.0)), 0.3 * np.sin(2.2 * t)], axis=1)
    return np.concatenate([sway, rotation.vectors_from_angles(tilt)], axis=1)


def pose_errors(means: Array, truth: Array) -> tuple[Array, Array]:
    """Distances, millimetres, and angles, degrees, between poses."""
    turns = rotation.between(truth[:, 3:6], means[:, 3:6])
    return 1e3 * np.linalg.norm(means[:, :3] - truth[:, :3], axis=1), np.degrees(np.linalg.norm(turns, axis=1))


def study_camera(out: Path) -> None:
    """The whole chain of the paper: image points, pose, prediction; and without the pose in between."""
    times = PERIOD * np.arange(240)
    truth = helmet_path(times)
    rng = np.random.default_rng(SEED)
    images = np.array([CAMERA.observe(pose) for pose in truth]) + CAMERA.pixel_std * rng.normal(size=(len(times), 10))
    images[HIDDEN, 6:] = np.nan  # two of the five points are hidden: no image gives a pose by itself
    poses = np.full((len(times), 7), np.nan)
    spreads = []
    for row, image in enumerate(images):
        if np.isfinite(image).all():
            fix = CAMERA.fix(image)
            poses[row] = [*fix.position, *fix.quaternion]
            spreads.append(np.sqrt(np.diag(fix.cov)))
    spread = np.median(spreads, axis=0)
    motion = tr.ConstantAcceleration(dims=6, jerk_psd=[0.05] * 3 + [3.0] * 3)
    loose = tr.PoseSensor(position_std=spread[:3].tolist(), angle_std=spread[3:].tolist(), attitude="quaternion")
    runs = {
        "pose of each image": tr.UnscentedKalmanFilter(motion, loose).run(times, poses, lead="midpoint"),
        "image points": tr.UnscentedKalmanFilter(motion, CAMERA).run(times, images, lead="midpoint"),
    }
    print("\ncamera: rms errors of estimate and of prediction to the middle of the interval")
    figure = Figure(dpi=150, figsize=(9, 5), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    for name, run in runs.items():
        distance, angle = pose_errors(run.means, truth)
        ahead, turn = pose_errors(run.lead_means, helmet_path(run.lead_times))
        all_seen = np.ones(len(times), dtype=bool)
        all_seen[: SETTLED + run.start] = False
        all_seen[HIDDEN.start : HIDDEN.stop + SETTLED] = False
        for label, rows in {"all seen": all_seen, "two hidden": np.isin(np.arange(len(times)), np.r_[HIDDEN])}.items():
            rms = [float(np.sqrt(np.mean(x[rows] ** 2))) for x in (distance, angle, ahead, turn)]
            estimate, ahead_of = (f"{rms[i]:8.2f} mm {rms[i + 1]:7.3f} degrees" for i in (0, 2))
            print(f"{name:20}{label:12}{estimate}; predicted {ahead_of}")
        axes[0].plot(times, distance, lw=1, label=name)
        axes[1].plot(times, angle, lw=1)
    for ax, unit in zip(axes, ("mm", "degrees"), strict=True):
        ax.axvspan(times[HIDDEN.start], times[HIDDEN.stop - 1], color="#EEEEEE", zorder=0)
        ax.set_yscale("log")
        ax.set_ylabel(f"error, {unit}", fontsize=8)
        tidy(ax)
    axes[0].legend(fontsize=8)
    axes[0].set_title("a helmet seen by a camera; shaded: two of the five points hidden", fontsize=9, loc="left")
    axes[1].set_xlabel("time, s", fontsize=8)
    figure.savefig(out / "camera.png")


def main() -> None:
    """Print the errors and draw the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/helmet"), help="folder of pictures (%(default)s)")
    parser.add_argument("--runs", type=int, default=60, help="runs of the turntable (%(default)s)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    study_turntable(arguments.runs, arguments.out)
    study_moving_head(arguments.out)
    study_recorded_head(arguments.out)
    study_camera(arguments.out)
    print(f"\nPictures: {arguments.out}")


if __name__ == "__main__":
    main()
