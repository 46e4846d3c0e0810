"""Studies on a Dask cluster: the numbers of this process, whatever happens to workers."""

from __future__ import annotations

import os
import signal

import pytest

import trackrs as tr
from studies import close_study
from trackrs.study import _engines

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")  # those of Dask are not ours

SEED = 7
RUNS = 600


@pytest.fixture(scope="module")
def close():
    return close_study()


@pytest.fixture(scope="module")
def whole(close):
    return close.run(RUNS, SEED).to_bytes()


@pytest.fixture
def short(monkeypatch):
    """Chunks of 20 runs, however fast this machine is."""

    def learn(cutter, _seconds, _runs):
        cutter._per_run = 0.005

    monkeypatch.setattr(_engines, "REMOTE_SECONDS", 0.1)
    monkeypatch.setattr(_engines, "TRIAL_SECONDS", 0.02)
    monkeypatch.setattr(_engines.Cutter, "learn", learn)


def test_a_worker_is_killed_midway_on_an_existing_cluster(close, whole, short, tmp_path):  # noqa: ARG001
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.wait_for_workers(2)
        before = client.run(os.getpid)
        seen = []

        def progress(done, _runs):
            if seen and not seen[-1]["killed"] and done > RUNS // 10:
                os.kill(next(iter(before.values())), signal.SIGKILL)
                seen.append({"done": done, "killed": True})
            else:
                seen.append({"done": done, "killed": bool(seen) and seen[-1]["killed"]})

        found = close.run(RUNS, SEED, engine="dask", client=client, progress=progress, folder=tmp_path)
        assert found.to_bytes() == whole
        killed = [step["done"] for step in seen if step["killed"]]
        assert killed[0] < RUNS
        # Something was on the lost worker: after the kill more than one chunk was still to come.
        assert len(killed) > 3
        after = client.run(os.getpid)
        assert set(after.values()) != set(before.values())
        # The folder of one engine is the folder of the other.
        again = close.run(RUNS, SEED, folder=tmp_path, progress=lambda done, _: seen.append(done))
        assert seen[-1] == RUNS
        assert again.to_bytes() == whole


def test_a_cluster_of_its_own(close, whole, short):  # noqa: ARG001
    assert close.run(RUNS, SEED, engine="dask", workers=1).to_bytes() == whole


def test_a_short_study_needs_no_cluster(close, monkeypatch):
    monkeypatch.setattr(distributed, "LocalCluster", None)
    assert close.run(2, SEED, engine="dask").to_bytes() == close.run(2, SEED).to_bytes()


def test_a_client_must_be_one(close):
    with pytest.raises(tr.ParameterError, match="client = 3"):
        close.run(2, SEED, engine="dask", client=3)


def test_chunks_last_as_long_as_they_should():
    cutter = _engines.Cutter([(0, 1000), (2000, 500)])
    assert cutter.cut(1.0) == (0, 1)
    cutter.learn(0.01, 1)
    pieces = []
    while (piece := cutter.cut(1.0)) is not None:
        pieces.append(piece)
    assert [runs for _, runs in pieces[:9]] == [100] * 9
    assert pieces[9] == (901, 99)
    assert sum(runs for _, runs in pieces) == 1499
    tapering = _engines.Cutter([(0, 1000)])
    tapering.learn(0.01, 1)
    sizes = []
    while (piece := tapering.cut(1.0, 2)) is not None:
        sizes.append(piece[1])
    assert sizes == sorted(sizes, reverse=True)
    assert (sizes[0], sizes[-1], sum(sizes)) == (100, 1, 1000)
