"""Pictures of filter runs: what is drawn and where; that it looks good is for eyes."""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

import trackrs as tr
from courses import jerk
from trackrs.plot import plot_innovations, plot_noise, plot_run

pytestmark = pytest.mark.filterwarnings("error")  # matplotlib warns of a layout that has no room

SCENE = tr.scenarios.underwater("bats", gross=0.05, missing=0.03)
RECORDING = SCENE.draw(seed=1)
EKF = tr.ExtendedKalmanFilter(
    jerk(), SCENE.array, screen=tr.ChiSquareScreen(alpha=0.01), adapt=tr.LimitedMemoryNoise(window=20)
)
LOST = tr.GaussianState([500.0, 900.0, 80.0, *np.zeros(6)], np.diag([4.0] * 3 + [1.0] * 3 + [0.01] * 3), time=19.0)


@pytest.fixture(scope="module")
def run():
    return EKF.run(RECORDING.times, RECORDING.values)


@pytest.fixture(scope="module")
def restarted():
    run = EKF.run(RECORDING.times[20:], RECORDING.values[20:], initial=LOST)
    assert len(run.restarts) == 1
    return run


@pytest.fixture(scope="module")
def plain():
    times = np.arange(30.0)
    values = np.stack([3.0 * times, times], axis=1)
    start = tr.GaussianState([0.0, 0.0, 3.0, 1.0], np.eye(4))
    sensor = tr.PositionSensor(dims=2, std=1.0)
    return tr.KalmanFilter(tr.ConstantVelocity(dims=2, accel_std=0.5), sensor).run(times, values, initial=start)


def drawn(axes):
    assert all(isinstance(one, Axes) for one in axes)
    figure = axes[0].figure
    figure.savefig(io.BytesIO(), format="png")
    assert tuple(figure.axes) == axes
    return axes


def legend(axes):
    return {text.get_text() for text in axes.get_legend().get_texts()}


def line(axes, label):
    (found,) = [line for line in axes.lines if line.get_label() == label]
    return found.get_xydata()


def test_run_shows_track_depth_error_and_verdicts(run):
    axes = plot_run(run, sensor=SCENE.array, truth=RECORDING.truth, smoothed=run.smooth(), title="bats")
    plan, depth, error, verdicts = drawn(axes)
    scale = "2 sigma, 10 times"
    assert legend(plan) == {"hydrophone", "truth", "smoothed", "filtered", "a channel rejected", scale}
    assert np.array_equal(line(plan, "truth"), SCENE.truth[:, :2])
    assert np.array_equal(line(plan, "hydrophone"), SCENE.array.hydrophones[:, :2])
    assert np.array_equal(line(plan, "filtered"), run.means[:, :2], equal_nan=True)
    rejected = (run.verdicts == tr.Verdict.REJECTED).any(axis=1)
    assert np.array_equal(line(plan, "a channel rejected"), run.means[rejected, :2])
    for ellipse in (patch for patch in plan.patches if isinstance(patch, Ellipse)):
        row = int(np.flatnonzero(np.all(run.means[:, :2] == ellipse.center, axis=1))[0])
        std = np.sqrt(np.linalg.eigvalsh(run.covs[row, :2, :2]))
        assert np.allclose(sorted([ellipse.width, ellipse.height]), 10 * 4.0 * std)
    assert plan.get_aspect() == 1.0
    low, high = depth.get_ylim()
    assert low > high, "depth grows downwards"
    assert error.get_ylim()[0] == 0.0
    assert [label.get_text() for label in verdicts.get_yticklabels()] == ["range0", "range1", "range2", "depth"]
    (mesh,) = verdicts.collections
    shown = np.asarray(mesh.get_array()).reshape(4, 161).T
    assert np.array_equal(shown == 2, run.verdicts == tr.Verdict.REJECTED)
    assert np.array_equal(shown == 0, run.verdicts == tr.Verdict.MISSING)
    assert {round(axes.get_position().x0, 6) for axes in (depth, error, verdicts)} == {
        round(depth.get_position().x0, 6)
    }


def test_restarts_are_marked_and_break_the_line(restarted):
    plan, depth, _, verdicts = drawn(plot_run(restarted, sensor=SCENE.array, truth=RECORDING.truth[20:]))
    (row,) = restarted.restarts
    assert np.array_equal(line(plan, "restart"), restarted.means[[row], :2])
    track = line(plan, "filtered")
    assert np.isnan(track[row]).all()
    assert np.array_equal(track[row + 1], restarted.means[row, :2])
    for axes in (depth, verdicts):
        assert any(np.array_equal(mark.get_xdata(), [restarted.times[row]] * 2) for mark in axes.lines)


def test_run_without_extras(plain):
    (plan,) = drawn(plot_run(plain))
    assert legend(plan) == {"filtered", "2 sigma"}
    assert "0 s" in {text.get_text() for text in plan.texts}
    assert len(drawn(plot_run(plain, truth=plain.means))) == 2


def test_innovations_with_band_and_test(run):
    *channels, test = drawn(plot_innovations(run, sensor=SCENE.array, values=RECORDING.values))
    assert [axes.get_ylabel() for axes in channels] == ["range0 (m)", "range1 (m)", "range2 (m)", "depth (m)"]
    for i, axes in enumerate(channels):
        assert np.array_equal(line(axes, "innovation")[:, 1], run.innovations[:, i], equal_nan=True)
        beyond = {m.get_marker(): len(m.get_xdata()) for m in axes.lines if m.get_marker() in "x^v"}
        assert sum(beyond.values()) == np.sum(run.verdicts[:, i] == tr.Verdict.REJECTED)
    assert test.get_ylabel() == "test statistic"
    limits = line(test, "exceeded with probability 0.01")[:, 1]
    dof = np.sum(run.verdicts != tr.Verdict.MISSING, axis=1)
    expected = [tr.Gate(0.99).threshold(int(d)) if d else np.nan for d in dof]
    assert np.array_equal(limits, expected, equal_nan=True)


def test_innovations_without_screen(plain):
    *_, test = drawn(plot_innovations(plain))
    assert test.get_ylabel() == "NIS"
    assert np.array_equal(test.lines[0].get_ydata(), plain.nis)


def test_noise_traces(run):
    upper, lower = drawn(plot_noise(run, sensor=SCENE.array))
    assert upper.get_ylabel() == "motion, root of Q (m/s³)"
    z = line(upper, "axis z")
    assert np.array_equal(z[:, 1], np.sqrt(run.q_hat[run.start :, 2, 2]))
    depth = line(lower, "depth (m)")
    assert np.array_equal(depth[:, 1], np.sqrt(run.r_hat[run.start :, 3, 3]))


def test_one_row_and_mistakes(run, plain):
    last = EKF.run(RECORDING.times, RECORDING.values, history="last")
    for axes in (plot_run(last), plot_innovations(last), plot_noise(last)):
        drawn(axes)
    with pytest.raises(tr.ParameterError, match="adapt="):
        plot_noise(plain)
    with pytest.raises(tr.DimensionError, match=r"truth has shape \(2, 3\), the run needs \(161, 3 or more\)"):
        plot_run(run, truth=np.zeros((2, 3)))
    with pytest.raises(tr.DimensionError, match=r"values have shape \(2, 4\)"):
        plot_innovations(run, sensor=SCENE.array, values=np.zeros((2, 4)))
    kf = tr.KalmanFilter(tr.RandomWalk(dims=1, velocity_psd=1.0), tr.PositionSensor(dims=1, std=1.0))
    one = kf.run([0.0], [[1.0]], initial=tr.GaussianState([0.0], [[1.0]]))
    with pytest.raises(tr.ParameterError, match="have no position x, y"):
        plot_run(one)


def test_own_axes(run):
    figure = Figure()
    panels = figure.subplots(5, 2)
    left, right = tuple(panels[:, 0]), tuple(panels[:, 1])
    assert plot_innovations(run, sensor=SCENE.array, axes=left) == left
    assert plot_noise(run, axes=right[:2]) == right[:2]
    assert plot_run(run, truth=RECORDING.truth, axes=right[1:]) == right[1:]
    assert all(axes.lines or axes.collections for axes in figure.axes)
    for draw, count in ((plot_run, 3), (plot_innovations, 5), (plot_noise, 2)):
        with pytest.raises(tr.DimensionError, match=f"axes has length 1, the picture has {count} panels"):
            draw(run, axes=left[:1])
