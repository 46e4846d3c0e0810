"""What happens in the run of a filter is told, counted and booked."""

from __future__ import annotations

import numpy as np
import pytest

import trackrs as tr

CV = tr.ConstantVelocity(dims=2, accel_psd=0.1)
START = tr.GaussianState(np.zeros(4), 10.0 * np.eye(4))


def trial(condition: float, rng: np.random.Generator, **arguments: object) -> tuple[tr.KalmanFilter, tr.GaussianState]:
    """Return a filter whose noise is I/condition, and where it begins: variances from 1 to 1/condition."""
    turn = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    sensor = tr.LinearSensor(rng.uniform(-1.0, 1.0, (2, 4)), np.eye(2) / condition)
    variances = condition ** (-np.arange(4) / 3.0)
    start = tr.GaussianState(np.zeros(4), np.diag(variances))
    return tr.KalmanFilter(tr.LinearMotion(turn, np.zeros((4, 4))), sensor, **arguments), start


@pytest.mark.parametrize("exponent", [9, 12, 14, 15, 16, 18, 21, 24])
def test_covariances_stay_definite_in_the_default_form(exponent: int) -> None:
    condition, rng = 10.0**exponent, np.random.default_rng(exponent)
    times, escalated = np.arange(1.0, 201.0), 0
    for _ in range(20):
        kf, start = trial(condition, rng)
        values = rng.normal(size=(200, 2)) / np.sqrt(condition)
        run = kf.run(times, values, initial=start)
        assert (run.covs == run.covs.swapaxes(1, 2)).all()
        lowest = np.linalg.eigvalsh(run.covs)
        # Up to 1e14 definite as they stand; beyond, what is given out are products of definite factors.
        assert (lowest[:, 0] >= (0.0 if exponent <= 14 else -1e-15 * lowest[:, -1])).all()
        assert run.ledger.rows_in == run.ledger.used == 200
        roots = kf.replace(form="square_root").run(times, values, initial=start)
        if run.events:
            (event,) = run.events
            assert (event.code, event.row, event.sensor) == ("escalated", 0, "")
            assert event.time == 1.0
            assert run.event_counts == {"escalated": 1}
            # From the same P0 by the same operations.
            assert (run.means == roots.means).all()
            assert (run.covs == roots.covs).all()
            with pytest.raises(tr.StrictError, match="strict mode: escalated at 1 s, row 0"):
                kf.replace(strict=True).run(times, values, initial=start)
            escalated += 1
        else:
            # Rounding of P moves the mean by that part of its standard deviation.
            error = np.abs(run.means[-1] - roots.means[-1]) / np.sqrt(np.diagonal(roots.covs[-1]))
            assert (error <= np.finfo(float).eps * condition).all()
            kf.replace(strict=True).run(times, values, initial=start)
    assert escalated == (0 if exponent <= 14 else 20 if exponent >= 21 else escalated)


def test_units_do_not_escalate() -> None:
    motion = tr.LinearMotion(np.eye(2), np.zeros((2, 2)))
    kf = tr.KalmanFilter(motion, tr.LinearSensor(np.array([[1e8, 1e-8]]), np.eye(1)))
    run = kf.run([1.0, 2.0], [[0.1], [0.2]], initial=tr.GaussianState(np.zeros(2), np.diag([1e-16, 1e16])))
    assert not run.events


def test_a_run_that_escalates_can_be_smoothed_and_looks_ahead() -> None:
    kf = tr.KalmanFilter(tr.ConstantVelocity(dims=1, accel_psd=1e-9), tr.PositionSensor(dims=1, std=1.0))
    start = tr.GaussianState([0.0, 0.0], [[1.0, 1.0], [1.0, 1.0]])
    times = np.arange(5.0)
    values = np.array([[0.3], [1.2], [1.9], [3.1], [4.0]])
    both = [kf, kf.replace(form="square_root")]
    run, roots = (one.run(times, values, initial=start, lead=0.5) for one in both)
    assert run.event_counts == {"escalated": 1}
    for name in ("means", "covs", "predicted_covs", "lead_means", "lead_covs"):
        assert (getattr(run, name) == getattr(roots, name)).all(), name
    assert (run.smooth().covs == roots.smooth().covs).all()


def test_rows_and_events_of_a_screened_run() -> None:
    kf = tr.KalmanFilter(CV, tr.PositionSensor(dims=2, std=1.0), screen=tr.ChiSquareScreen(alpha=1e-6))
    values = np.zeros((6, 2))
    values[1, 0] = 1e4
    values[2] = 1e4
    values[3] = np.nan
    values[4, 1] = np.nan
    run = kf.run(np.arange(6.0), values, initial=START)
    assert [(event.code, event.row, event.time) for event in run.events] == [("screened", 1, 1.0), ("screened", 2, 2.0)]
    assert run.events[0].reason.startswith("components 0 rejected")
    assert run.event_counts == {"screened": 2}
    assert run.ledger == tr.Ledger(rows_in=6, used=4, late=0, duplicate=0, rejected={"not_observed": 1, "screened": 1})
    with pytest.raises(tr.StrictError, match="screened at 1 s, row 1"):
        kf.replace(strict=True).run(np.arange(6.0), values, initial=START)
    # Missing is not wrong.
    kf.replace(strict=True).run(np.arange(3.0), values[3:], initial=START)


def test_rows_before_a_start_are_booked() -> None:
    kf = tr.KalmanFilter(CV, tr.PositionSensor(dims=2, std=1.0))
    values = np.zeros((8, 2))
    assert not kf.run(np.arange(8.0), values).events
    values[1] = np.nan
    run = kf.run(np.arange(8.0), values)
    assert run.start == 4
    (event,) = run.events
    assert (event.code, event.row) == ("not_started", 4)
    assert run.ledger == tr.Ledger(rows_in=8, used=6, late=0, duplicate=0, rejected={"not_started": 2})


def test_history_and_pieces_change_no_count() -> None:
    kf = tr.KalmanFilter(CV, tr.PositionSensor(dims=2, std=1.0), screen=tr.ChiSquareScreen(alpha=0.05, restart=False))
    values = np.random.default_rng(1).normal(size=(3000, 2))
    runs = [
        kf.run(np.arange(3000.0), values, initial=START, history=history) for history in ("full", "filtered", "last")
    ]
    rejected = (runs[0].verdicts == tr.Verdict.REJECTED).any(axis=1)
    assert runs[0].event_counts == {"screened": rejected.sum()}
    assert [event.row for event in runs[0].events] == np.flatnonzero(rejected)[-1000:].tolist()
    assert all(run.events == runs[0].events and run.ledger == runs[0].ledger for run in runs)


def test_a_restart_is_an_event() -> None:
    array = tr.RangeArray([[0, 0, 250], [1000, 0, 252], [500, 866, 248], [300, 300, 100]], range_std=1.0, depth_std=0.3)
    ekf = tr.ExtendedKalmanFilter(tr.ConstantAcceleration(dims=3, jerk_std=0.05), array, screen=tr.ChiSquareScreen())
    path = np.column_stack([np.arange(40.0), np.full(40, 5.0), np.full(40, 60.0)])
    path[20:, 0] += 400.0
    run = ekf.run(np.arange(40.0), [array.observe(position) for position in path])
    assert run.restarts
    assert [event.row for event in run.events if event.code == "restarted"] == list(run.restarts)
    assert run.event_counts["restarted"] == len(run.restarts)
    ledger = run.ledger
    assert ledger.rows_in == 40 == ledger.used + sum(ledger.rejected.values()) + ledger.waiting


def test_a_track_of_a_batch_escalates_alone() -> None:
    kf = tr.KalmanFilter(CV, tr.PositionSensor(dims=2, std=1.0))
    covs = np.tile(np.eye(4), (9, 1, 1))
    covs[4, 0, 2] = covs[4, 2, 0] = 1.0 - 1e-15
    values = np.random.default_rng(3).normal(size=(9, 5, 2))
    batch = tr.TrackBatch(kf, np.zeros((9, 4)), covs)
    out = batch.run(np.arange(5.0), values, covs=True)
    assert np.flatnonzero(out.escalated).tolist() == np.flatnonzero(batch.escalated).tolist() == [4]
    run = kf.run(np.arange(5.0), values[4], initial=tr.GaussianState(np.zeros(4), covs[4]))
    assert run.event_counts == {"escalated": 1}
    assert (out.means[4] == run.means).all()
    assert out.covs is not None
    assert (out.covs[4] == run.covs).all()
    strict = tr.TrackBatch(kf.replace(strict=True), np.zeros((9, 4)), covs)
    with pytest.raises(tr.StrictError, match="escalated at 0 s, row 0"):
        strict.run(np.arange(5.0), values)
    assert strict.time == 0.0
    assert (strict.covs == covs).all()
