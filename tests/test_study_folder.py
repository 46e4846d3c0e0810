"""Runs on disk: whatever happens to the process or to the files, the result is the same."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import trackrs as tr
from studies import RADAR, close_study, tracker
from trackrs.study import Part
from trackrs.study._shards import records

SEED = 7
KILLS = 20


@pytest.fixture(scope="module")
def close():
    return close_study()


@pytest.fixture(scope="module")
def whole(close):
    return close.run(runs=30, seed=SEED)


def finished(study, folder, runs=30):
    """The result, and how many runs were there already."""
    counts = []
    result = study.run(runs, SEED, folder=folder, progress=lambda done, _: counts.append(done))
    return result, counts[0]


# Forks, so that trackrs is imported once; the child is killed at a random moment after it has begun.
KILLER = """
import os, random, signal, sys, time
sys.path.insert(0, sys.argv[1])
from studies import close_study
study, chance = close_study(), random.Random(5)
for _ in range(int(sys.argv[4])):
    child = os.fork()
    if child == 0:
        study.run(int(sys.argv[3]), 7, folder=sys.argv[2])
        os._exit(0)
    time.sleep(chance.uniform(0.0, 0.4))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
"""


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="no fork here")
def test_a_study_that_is_killed_again_and_again_ends_the_same(tmp_path, close):
    runs = 1500  # about two seconds of one core
    arguments = [str(Path(__file__).parent), str(tmp_path), str(runs), str(KILLS)]
    subprocess.run([sys.executable, "-c", KILLER, *arguments], check=True, timeout=100)
    files = list(tmp_path.glob("runs-*.bin"))
    assert len(files) > 1
    result, there = finished(close, tmp_path, runs)
    assert there > 0
    assert result.to_bytes() == close.run(runs, SEED).to_bytes()


@pytest.fixture(scope="module")
def record(tmp_path_factory, close, whole):
    """The bytes of a finished study, in chunks of which we know the ends."""
    folder = tmp_path_factory.mktemp("record")
    assert close.run(30, SEED, folder=folder).to_bytes() == whole.to_bytes()
    label = (folder / "study.json").read_text()
    parts = [close.chunk(SEED, first, 10).run() for first in (0, 10, 20)]
    return label, [part.to_bytes() for part in parts]


def test_a_record_cut_anywhere_costs_its_runs_alone(record):
    _, (first, second, last) = record
    before = first + second
    for cut in range(0, len(last), 101):
        assert sum(len(part.values) for part in records(before + last[:cut])) == 20
    for cut in [*range(100), *range(len(last) - 100, len(last))]:
        assert [part.first for part in records(before + last[:cut])] == [0, 10]
        with pytest.raises(tr.StateError):
            Part.from_bytes(last[:cut])
    assert [part.first for part in records(before + last)] == [0, 10, 20]


def test_every_cut_of_a_small_record(close):
    study = tr.Study(tr.scenarios.close_targets(reports=2), {"a": close.methods["npda"]}, [tr.OSPA(c=60.0)])
    first, last = (study.chunk(SEED, k, 1).run().to_bytes() for k in (0, 1))
    for cut in range(len(last)):
        assert [part.first for part in records(first + last[:cut])] == [0]
        assert [part.first for part in records(last[:cut] + first)] == [0]
    for bit in range(8 * len(first)):
        broken = bytearray(first)
        broken[bit // 8] ^= 1 << bit % 8
        assert [part.first for part in records(bytes(broken) + last)] == [1]


@pytest.mark.parametrize("place", ["mark", "first", "runs", "values", "checksum"])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_flipped_bit_costs_the_runs_of_its_record(tmp_path, close, whole, record, place, which):
    label, parts = record
    broken = bytearray(parts[which])
    broken[{"mark": 1, "first": 9, "runs": 18, "values": 900, "checksum": len(broken) - 2}[place]] ^= 16
    (tmp_path / "study.json").write_text(label)
    (tmp_path / "runs-1.bin").write_bytes(b"".join([*parts[:which], bytes(broken), *parts[which + 1 :]]))
    result, there = finished(close, tmp_path)
    assert there == 20
    assert result.to_bytes() == whole.to_bytes()


def test_a_torn_record_is_run_again(tmp_path, close, whole, record):
    label, (first, second, last) = record
    (tmp_path / "study.json").write_text(label)
    (tmp_path / "runs-1.bin").write_bytes(first + last[:-1])
    (tmp_path / "runs-2.bin").write_bytes(second[: len(second) // 2])
    (tmp_path / "study.json.draft-of-the-dead").write_text("{")
    result, there = finished(close, tmp_path)
    assert there == 10
    assert result.to_bytes() == whole.to_bytes()
    again, there = finished(close, tmp_path)
    assert there == 30
    assert again.to_bytes() == whole.to_bytes()


def test_a_finished_folder_is_read_and_goes_on(tmp_path, close, whole):
    close.run(8, SEED, folder=tmp_path)
    result, there = finished(close, tmp_path)
    assert there == 8
    assert result.to_bytes() == whole.to_bytes()
    fewer, there = finished(close, tmp_path, 5)
    assert there == 5
    assert_array_equal(fewer["npda"].values, whole["npda"].values[:5])
    assert (fewer["npda"].seconds == result["npda"].seconds[:5]).all()


def test_failures_are_kept(tmp_path):
    study = tr.Study(RADAR, {"broken": breaks, "npda": tracker()}, [tr.OSPA(c=60.0)])
    first = study.run(6, SEED, folder=tmp_path)
    second, there = finished(study, tmp_path, 6)
    assert there == 6
    assert second.failures == first.failures
    assert second.to_bytes() == first.to_bytes() == study.run(6, SEED).to_bytes()


def breaks(scans):
    msg = f"ünlucky {len(scans)}"
    raise RuntimeError(msg)


def test_folders_of_others_are_refused(tmp_path, close):
    mine = tmp_path / "mine"
    close.run(2, SEED, folder=mine)
    others = {
        "another study": close_study(npda=tracker(gate=tr.Gate(0.9)), nearest=close.methods["nearest"]),
        "with seed 7": close,
    }
    for (text, study), seed in zip(others.items(), (SEED, 8), strict=True):
        with pytest.raises(tr.StateError, match=text):
            study.run(2, seed, folder=mine)
    (mine / "study.json").write_text(json.dumps(json.loads((mine / "study.json").read_text()) | {"format": 0}))
    with pytest.raises(tr.StateError, match="another version"):
        close.run(2, SEED, folder=mine)
    for text in ("", "[1, 2]", "{"):
        (mine / "study.json").write_text(text)
        with pytest.raises(tr.StateError, match="not the label"):
            close.run(2, SEED, folder=mine)
    full = tmp_path / "full"
    full.mkdir()
    (full / "thesis.tex").write_text("years of work")
    with pytest.raises(tr.StateError, match=r"thesis\.tex"):
        close.run(2, SEED, folder=full)
    assert [file.name for file in full.iterdir()] == ["thesis.tex"]


def test_a_method_that_has_changed_is_another_study(tmp_path):
    def study(method):
        return tr.Study(RADAR, {"mine": method}, [tr.OSPA(c=60.0)])

    study(lambda scans: [np.zeros((1, 2))] * len(scans)).run(2, folder=tmp_path)
    study(lambda scans: [np.zeros((1, 2))] * len(scans)).run(3, folder=tmp_path)
    with pytest.raises(tr.StateError, match="another study"):
        study(lambda scans: [np.ones((1, 2))] * len(scans)).run(2, folder=tmp_path)
