"""Where Python and the core meet: panics, Ctrl-C inside one call, and forks."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import trackrs as tr

# --- panics ----------------------------------------------------------------------------------------------------------


def test_a_panic_is_one_exception_that_except_exception_catches():
    with pytest.raises(tr.InternalError, match="internal error, please report it: on purpose") as caught:
        tr._trackrs._panic()
    assert isinstance(caught.value, Exception)
    assert isinstance(caught.value, tr.TrackrsError)


def test_a_panic_in_a_thread_leaves_the_others_alone():
    caught = []

    def work():
        try:
            tr._trackrs._panic()
        except tr.TrackrsError as error:
            caught.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [type(error) for error in caught] == [tr.InternalError] * 4
    assert tr.ospa([[0.0]], [[1.0]], c=5.0).total == 1.0


# --- Ctrl-C inside one call ------------------------------------------------------------------------------------------

MOTION = tr.ConstantVelocity(dims=2, accel_psd=0.1)
RADAR = tr.RangeBearing((0.0, 0.0), range_std=1.0, bearing_std=0.01)
START = tr.GaussianState([30.0, 40.0, 0.0, 0.0], np.eye(4))


def a_run(share):
    count = int(2_000_000 * share)
    ukf = tr.UnscentedKalmanFilter(MOTION, RADAR)
    times, values = np.arange(1.0, count + 1), np.tile([50.0, 0.9], (count, 1))
    return lambda: ukf.run(times, values, initial=START, history="last")


def a_smoother(share):
    count = int(60_000 * share)
    motion = tr.ConstantAcceleration(dims=3, jerk_psd=0.1)
    kf = tr.KalmanFilter(motion, tr.PositionSensor(dims=3, std=1.0))
    times = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, count))
    run = kf.run(times, np.zeros((count, 3)), initial=tr.GaussianState(np.zeros(9), np.eye(9)))
    return lambda: run.smooth(20)


def a_tracker(share):
    rng = np.random.default_rng(0)
    scans = [tr.Scan(float(k), rng.uniform(-1e3, 1e3, (60, 2)), "lidar") for k in range(int(5_000 * share))]
    sensors = {"lidar": tr.PositionSensor(dims=2, std=5.0)}
    tracker = tr.MultiTargetTracker(MOTION, sensors, tr.MofN(2, 3, max_speed=50.0))
    return lambda: tracker.run(scans)


def points(count):
    return np.random.default_rng(0).uniform(0.0, 1e3, (count, 2))


def density_peaks(share):
    few = points(int(600_000 * share))
    return lambda: tr.DensityPeakPartition(d_c=10.0).fit_predict(few)


def outlier_factors(share):
    few = points(int(400_000 * share))
    return lambda: tr.LocalOutlierFactor(n_neighbors=20).scores(few)


def dbscan(share):
    few = points(int(600_000 * share))
    return lambda: tr.DbscanPartition(eps=20.0, min_samples=3).fit_predict(few)


def kmeans(share):
    few = points(int(400_000 * share))
    return lambda: tr.KMeansPartition(200).fit_predict(few)


def an_assignment(share):
    size = int(3_000 * share**0.5)
    costs = np.outer(np.arange(1.0, size + 1), np.arange(1.0, size + 1))
    return lambda: tr.association.assign(costs)


def probabilities(share):
    # One report more doubles the subsets of reports.
    size = round(21 + np.log2(share))
    weights = np.random.default_rng(0).uniform(0.1, 1.0, (size, 1 + size))
    return lambda: tr.association.marginals(weights, budget=10**11)


def a_study(share):
    scene = tr.scenarios.turntable(samples=int(400_000 * share))
    motion, sensor = tr.ConstantAcceleration(dims=1, jerk_psd=1.0), tr.PositionSensor(dims=1, std=scene.std)
    kf = tr.KalmanFilter(motion, sensor, adapt=tr.LimitedMemoryNoise(window=20))
    study = tr.Study(scene, {"adaptive": kf}, [tr.study.PositionError()])
    return lambda: study.run(runs=1, seed=7, workers=1)


def a_score(share):
    size = int(6_000 * share**0.5)
    here, there = points(2 * size).reshape(2, size, 2)
    return lambda: tr.ospa(here, there, c=1e6)


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs signals to threads")
@pytest.mark.parametrize(
    "call",
    [
        a_run,
        a_smoother,
        a_tracker,
        density_peaks,
        outlier_factors,
        dbscan,
        kmeans,
        an_assignment,
        probabilities,
        a_score,
        a_study,
    ],
)
def test_an_interrupt_ends_the_call_long_before_its_end(call):
    """The whole would take 20 times what a twentieth took; a half of it is all that is allowed.

    The clock counts the work of this process, also for who interrupts, so that a busy machine changes nothing.
    """

    def interrupt(_number, _frame):
        raise KeyboardInterrupt

    over = threading.Event()

    def wait_and_interrupt(until, thread):
        while time.process_time() < until:
            if over.wait(0.001):
                return
        signal.pthread_kill(thread, signal.SIGALRM)

    part = call(0.05)
    begun = time.process_time()
    part()
    whole = 20.0 * (time.process_time() - begun)
    work = call(1.0)
    old = signal.signal(signal.SIGALRM, interrupt)
    try:
        begun = time.process_time()
        watch = threading.Thread(target=wait_and_interrupt, args=(begun + 0.1 * whole, threading.get_ident()))
        watch.start()
        with pytest.raises(KeyboardInterrupt):
            work()
        taken = time.process_time() - begun
    finally:
        over.set()
        watch.join()
        signal.signal(signal.SIGALRM, old)
    assert taken < 0.5 * whole


# --- threads ---------------------------------------------------------------------------------------------------------

THREADS = 64
SECONDS = float(os.environ.get("TRACKRS_THREAD_SECONDS", "1"))


def test_sixty_four_threads_share_a_filter_a_tracker_and_the_bytes_of_one_thread():
    """Fault 22: values are the same bits in every thread; a tracker takes a step whole, or refuses it as busy."""
    rng = np.random.default_rng(3)
    ukf, times, values = tr.UnscentedKalmanFilter(MOTION, RADAR), np.arange(1.0, 51.0), np.tile([50.0, 0.9], (50, 1))
    few, costs = points(300), rng.uniform(size=(60, 60))
    clusters = tr.DbscanPartition(eps=40.0, min_samples=3)

    def compute():
        run = ukf.run(times, values, initial=START)
        return (
            run.means.tobytes() + clusters.fit_predict(few).tobytes() + tr.association.assign(costs).columns.tobytes()
        )

    def tracker():
        return tr.MultiTargetTracker(
            MOTION, {"lidar": tr.PositionSensor(dims=2, std=5.0)}, tr.MofN(2, 3, max_speed=50.0)
        )

    scans = [tr.Scan(float(k), rng.uniform(-1e3, 1e3, (20, 2)), "lidar") for k in range(10)]
    alone = tracker()
    alone.run(scans)
    expected, shared, end = (compute(), alone.to_bytes()), tracker(), time.monotonic() + SECONDS
    wrong, steps = [], []

    def work():
        taken = 0
        try:
            while time.monotonic() < end:
                own = tracker()
                own.run(scans)
                if (compute(), own.to_bytes()) != expected:
                    wrong.append("other bytes")
                for scan in scans:
                    try:
                        shared.step(scan)
                        taken += 1
                    except tr.BusyError:
                        pass
        except tr.TrackrsError as error:
            wrong.append(error)
        steps.append(taken)

    threads = [threading.Thread(target=work) for _ in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    ledger = shared.ledger
    assert not wrong
    assert ledger.rows_in == 20 * sum(steps)
    assert ledger.rows_in == ledger.used + sum(ledger.rejected.values()) + ledger.late + ledger.duplicate


# --- forks -----------------------------------------------------------------------------------------------------------

FORKS = int(os.environ.get("TRACKRS_FORKS", "20"))

FORKING = """
import os, sys, time
import numpy as np
import trackrs as tr

kf = tr.KalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.1), tr.PositionSensor(dims=2, std=1.0))
values = np.random.default_rng(0).normal(size=(600, 50, 2))
def work():
    start = tr.GaussianState(np.zeros(4), np.eye(4))
    return kf.run_batch(np.arange(1.0, 51.0), values, initial=start, threads=4).means.tobytes()

expected = work()
for k in range(int(sys.argv[1])):
    child = os.fork()
    if child == 0:
        os._exit(0 if work() == expected else 3)
    deadline = time.monotonic() + 30.0
    while (ended := os.waitpid(child, os.WNOHANG)) == (0, 0):
        assert time.monotonic() < deadline, f"fork {k} hangs"
        time.sleep(0.001)
    assert ended[1] == 0, f"fork {k} ended with {ended[1]}"
    assert work() == expected
print("all")
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_children_of_a_process_that_ran_threads_run_them_too():
    done = subprocess.run(
        [sys.executable, "-c", FORKING, str(FORKS)],
        capture_output=True,
        text=True,
        check=False,
        timeout=30 + 30 * FORKS,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "all\n"
