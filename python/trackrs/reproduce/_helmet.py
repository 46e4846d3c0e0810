"""Sun, Zhang 2015: pose prediction method for a moving helmet based on Kalman filtering."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trackrs.filter import UnscentedKalmanFilter
from trackrs.lead import choose_jerk_psd
from trackrs.motion import ConstantAcceleration
from trackrs.plot._figure import COLOURS
from trackrs.report import Table
from trackrs.reproduce._drawing import save, sheet, tidy
from trackrs.reproduce._records import Claim, Number, Picture, Reproduction, number
from trackrs.scenarios import Turning, moving_head, turntable
from trackrs.sensor import PositionSensor
from trackrs.study import LeadError, PositionError, Study, StudyResult
from trackrs.study._statistics import Summary, summarise

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from trackrs._arrays import FloatArray
    from trackrs.reproduce._records import Progress

PAPER = "Sun, Zhang (2015), Pose prediction method for a moving helmet based on Kalman filtering"
SETTLED = 20  # steps before it do not count
PRINTED, DEFAULT, SCALED = "as printed", "default", "density scaled by the innovations"
# Table 1 of the paper, one run, degrees: largest, smallest, mean, standard deviation.
TABLE_1 = {
    "measurement": (0.1177, -0.1367, -0.0018, 0.0724),
    "prediction": (0.1214, -0.1447, -0.0014, 0.0736),
    "estimate": (0.1177, -0.1367, -0.0016, 0.0732),
}
ROWS = ("largest", "smallest", "mean", "standard deviation")
# The spec does not say over how many runs it averages the moving head: taken for one.
ONE = 1


def reproduce(runs: int, seed: int, folder: Path, workers: int | None, progress: Progress) -> Reproduction:
    """Run the paper again."""
    table, head = turntable(), moving_head()
    choice = choose_jerk_psd(amplitude=5.0, frequency=1.3, period=0.05, std=head.std)
    studies, spreads = {}, {}
    for step, (name, scene, psd) in enumerate((("turntable", table, 1.0), ("moving head", head, choice.psd))):
        progress(name, step, 2)
        studies[name] = Study(scene, filters(psd), [PositionError(SETTLED), LeadError(first=SETTLED)]).run(
            runs, seed, workers=workers
        )
        spreads[name] = errors(scene, studies[name], seed)
    return Reproduction(
        name="helmet",
        paper=PAPER,
        summary=(
            "Table 1 comes out as printed: prediction and estimate are as accurate as the measurement, because "
            "equation "
            "(19) has the wrong sign. R falls to nothing, the gain becomes 1 and the estimate is the measurement. The "
            "same filter with fixed noise halves both errors on the turntable. On a head that moves, which the paper "
            "does not try, the printed noise rule predicts no better than holding the last measurement."
        ),
        claims=claims(spreads),
        numbers=numbers(spreads),
        pictures=pictures(seed, folder, table, head, choice.psd),
        tables={name: text(studies[name], spreads[name]) for name in studies},
        studies=studies,
        columns=("lead_error", "error"),
        baseline=DEFAULT,
        sections=(table_1(spreads["turntable"]),),
    )


def filters(jerk_psd: float) -> dict[str, UnscentedKalmanFilter]:
    """Return the filter as printed and by default; degrees."""
    motion, sensor = ConstantAcceleration(dims=1, jerk_psd=jerk_psd), PositionSensor(dims=1, std=turntable().std)
    return {
        PRINTED: UnscentedKalmanFilter.as_printed(motion, sensor, r_limits=(1e-9 * turntable().std ** 2, 1e4)),
        DEFAULT: UnscentedKalmanFilter(motion, sensor),
    }


def errors(scene: Turning, result: StudyResult, seed: int) -> dict[str, FloatArray]:
    """Errors (R, S) once the filters have settled; the last prediction has no measurement after it."""
    measured = np.stack([scene.draw(seed, int(run)).values[:, 0] for run in result.runs]) - scene.truth(scene.times)
    out = {"measurement": measured[:, SETTLED:]}
    # What needs no filter: the middle of the interval from the last one, two, three measurements.
    middle = scene.truth(scene.times[SETTLED:-1] + 0.5 * (scene.times[1] - scene.times[0]))
    values = measured + scene.truth(scene.times)
    now, before, earlier = (values[:, SETTLED - back : -1 - back] for back in (0, 1, 2))
    out["hold"] = now - middle
    out["linear"] = 1.5 * now - 0.5 * before - middle
    out["quadratic"] = 1.875 * now - 1.25 * before + 0.375 * earlier - middle
    for one in result.methods:
        out[f"{one.name}: prediction"] = one.series("lead_error")[:, SETTLED:-1]
        out[f"{one.name}: estimate"] = one.series("error")[:, SETTLED:]
    return out


def spread(errors: FloatArray) -> Summary:
    """Return the mean of the runs' standard deviations."""
    return summarise(np.std(errors, axis=1, ddof=1))


def rms(errors: FloatArray) -> Summary:
    """Return the mean of the runs' root mean squares."""
    return summarise(np.sqrt(np.mean(errors**2, axis=1)))


def numbers(spreads: dict[str, dict[str, FloatArray]]) -> tuple[Number, ...]:
    """Return ours beside those of the paper and of its spec."""
    table, head = spreads["turntable"], spreads["moving head"]
    out = [
        number("turntable, measurement: standard deviation, degrees", spread(table["measurement"]), 0.0718, 400, 0.0724)
    ]
    printed = {"prediction": (0.0741, 0.0736), "estimate": (0.0718, 0.0732)}
    default = {"prediction": (0.041, None), "estimate": (0.038, None)}
    for method, values in ((PRINTED, printed), (DEFAULT, default)):
        for kind, (reference, paper) in values.items():
            what = f"turntable, {method}, {kind}: standard deviation, degrees"
            out.append(number(what, spread(table[f"{method}: {kind}"]), reference, 400, paper))
    ratio = np.std(table[f"{PRINTED}: prediction"], axis=1) / np.std(table["measurement"], axis=1)
    out.append(
        number("turntable, as printed: prediction over measurement", summarise(ratio), 1.032, 400, 0.0736 / 0.0724)
    )
    for name, reference in (("hold", 1.815), ("linear", 0.316), ("quadratic", 0.183)):
        out.append(number(f"moving head, {name}: rms, degrees", rms(head[name]), reference, ONE))
    out.append(
        number("moving head, as printed, prediction: rms, degrees", rms(head[f"{PRINTED}: prediction"]), 1.835, ONE)
    )
    out.append(
        number("moving head, default, prediction: rms, degrees", rms(head[f"{DEFAULT}: prediction"]), 0.174, ONE)
    )
    out.append(number("moving head, default, estimate: rms, degrees", rms(head[f"{DEFAULT}: estimate"]), 0.071, ONE))
    return tuple(out)


def claims(spreads: dict[str, dict[str, FloatArray]]) -> tuple[Claim, ...]:
    """Return what becomes of the paper's claims."""
    table, head = spreads["turntable"], spreads["moving head"]
    of = {name: spread(values).mean for name, values in table.items()}
    on = {name: rms(values).mean for name, values in head.items()}
    ratio = of[f"{PRINTED}: prediction"] / of["measurement"]
    same = of[f"{PRINTED}: estimate"] / of["measurement"]
    better = of[f"{DEFAULT}: estimate"] / of["measurement"]
    moving = on[f"{PRINTED}: prediction"]
    return (
        Claim(
            "The prediction is about as accurate as the measurement (Table 1)",
            "holds" if ratio < 1.1 else "does not hold",
            f"on the turntable it has {ratio:.3f} times the spread of the measurement (paper: 1.017)",
        ),
        Claim(
            "The filter cannot be better than the measurement, because the noise is not Gaussian",
            "does not hold" if better < 0.9 else "holds",
            f"the noise here is Gaussian and the estimate as printed has {same:.4f} of its spread: the sign of (19) "
            f"makes "
            f"it so; with fixed noise it has {better:.2f}",
        ),
        Claim(
            "Predicting between the frames doubles the rate without loss for a helmet in motion",
            "holds" if moving < 2.0 * on["measurement"] else "does not hold",
            f"on a moving head the prediction as printed is {moving:.2f} degrees off, holding the last measurement "
            f"{on['hold']:.2f}, the default {on[f'{DEFAULT}: prediction']:.3f}",
        ),
    )


def table_1(spreads: dict[str, FloatArray]) -> Table:
    """Return Table 1: the paper's one run, and the means over ours."""
    rows: list[list[object]] = [[f"{kind}, paper (one run)", *values] for kind, values in TABLE_1.items()]
    rows += [[name, *(float(part.mean()) for part in parts(errors))] for name, errors in spreads.items()]
    return Table(("errors, degrees", *ROWS), rows, "Table 1: turntable, the paper's run and the means over ours")


def parts(errors: FloatArray) -> tuple[FloatArray, ...]:
    """Return, per run, what Table 1 has in its columns."""
    return errors.max(axis=1), errors.min(axis=1), errors.mean(axis=1), errors.std(axis=1, ddof=1)


def text(result: StudyResult, spreads: dict[str, FloatArray]) -> str:
    """Return a text of Table 1, averaged over the runs, and of the study."""
    lines = [f"{'errors, degrees':24}" + "".join(f"{row:>20}" for row in ROWS) + f"{'rms':>12}"]
    for name, values in spreads.items():
        cells = "".join(f"{part.mean():20.4f}" for part in parts(values))
        lines.append(f"{name:24}{cells}{rms(values).mean:12.4f}")
    return "\n".join([*lines, "", result.table(["lead_error", "error"], DEFAULT)])


def pictures(seed: int, folder: Path, table: Turning, head: Turning, psd: float) -> tuple[Picture, ...]:
    """Redraw figures 3 and 4, and draw the moving head."""
    out = []
    for name, window, what in (("figure3", (0.0, 9.0), "Figure 3"), ("figure4", (3.0, 5.0), "Figure 4: from 3 to 5 s")):
        figure = sheet(9, 3.4)
        axes = figure.subplots(1, 2, sharey=True)
        for ax, (method, ukf) in zip(axes, filters(1.0).items(), strict=True):
            draw_errors(ax, table, ukf, seed, window)
            tidy(ax, "time, s", "error, degrees", f"turntable, {method}")
        axes[0].legend(fontsize=7)
        out.append(save(figure, folder, name, f"{what}: errors of measurement, prediction and estimate"))
    figure = sheet(9, 3.4)
    axes = figure.subplots(1, 2, sharey=True)
    for ax, (method, ukf) in zip(axes, filters(psd).items(), strict=True):
        draw_errors(ax, head, ukf, seed, (20.0, 24.0))
        tidy(ax, "time, s", "error, degrees", f"moving head, {method}")
    axes[0].legend(fontsize=7)
    out.append(save(figure, folder, "moving_head", "Not in the paper: a head that shakes and nods"))
    return tuple(out)


def draw_errors(ax: Axes, scene: Turning, ukf: UnscentedKalmanFilter, seed: int, window: tuple[float, float]) -> None:
    """Draw what one run's errors are within some time."""
    angles = scene.draw(seed)
    run = ukf.run(angles.times, angles.values, initial=angles.initial, lead="midpoint", history="filtered")
    truth = scene.truth(angles.times)
    series = (
        ("measured", angles.times, angles.values[:, 0] - truth, "*"),
        ("predicted", run.lead_times, run.lead_means[:, 0] - scene.truth(run.lead_times), "-"),
        ("estimated", angles.times, run.means[:, 0] - truth, "-"),
    )
    for (label, times, error, style), colour in zip(series, ("#999999", *COLOURS), strict=False):
        inside = (times >= window[0]) & (times <= window[1])
        ax.plot(times[inside], error[inside], style, color=colour, markersize=4, linewidth=1, label=label)
