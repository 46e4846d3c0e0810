"""Live running: no input breaks it, no crash loses anything, no damage goes unnoticed."""

from __future__ import annotations

import errno
import os
import random
from math import isnan
from pathlib import Path

import numpy as np
import pytest

import live_scene
import trackrs as tr
from live_scene import COLUMNS, CONFIG, NAMES, assert_books, encoded, follow, outputs, tracker
from trackrs import live
from trackrs.config import InputConfig
from trackrs.live import _files
from trackrs.live._checkpoint import Checkpoint
from trackrs.live._rows import Refused, RowReader, parse


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("config.toml").write_text(CONFIG)


# --- damaged input ---------------------------------------------------------------------------------------------------


@pytest.fixture
def attempt():
    """A run over bytes, without waiting for a disk."""
    with Path("in.ndjson").open("wb", buffering=0) as file:

        def run(data):
            os.pwrite(file.fileno(), data, 0)
            file.truncate(len(data))
            done = follow(out=lambda _: None, dead_letters=None)
            assert_books(done, data)
            return done.bad_lines.keys()

        yield run


def test_every_length_of_an_input(attempt):
    data = live_scene.lines(8)[:1500]
    for length in range(len(data) + 1):
        attempt(data[:length])


def test_every_flipped_byte_of_an_input(attempt):
    data, rng, codes = live_scene.lines(14)[:2000], random.Random(1), set()
    for at in range(len(data)):
        flipped = bytearray(data)
        flipped[at] ^= rng.randrange(1, 256)
        codes |= attempt(bytes(flipped))
    assert codes >= {"not_json", "not_utf8", "missing_column", "unknown_sensor"}


def test_hundred_thousand_mutated_lines():
    """No line does anything but become a row of finite numbers or be refused."""
    rng, reader = random.Random(1), RowReader(COLUMNS, InputConfig())
    seeds = live_scene.lines(40).splitlines()
    specials = [
        b"1e999",
        b"-0",
        b"null",
        b"NaN",
        b"[",
        b"{",
        b'"',
        b"\\",
        b"\x00",
        b"\xff",
        b"9" * 30,
        b"\\ud800",
        b",",
    ]
    outcomes = {"row": 0, "refused": 0}
    for _ in range(100_000):
        line = bytearray(rng.choice(seeds))
        for _ in range(rng.randrange(1, 4)):
            at = rng.randrange(len(line) + 1)
            match rng.randrange(4):
                case 0:
                    line[at : at + 1] = bytes([rng.randrange(256)])
                case 1:
                    del line[at : at + rng.randrange(8)]
                case 2:
                    line[at:at] = rng.choice(specials)
                case 3:
                    line[at:] = rng.choice(seeds)[at:]
        try:
            row = reader.row(parse(bytes(line), 64))
        except Refused:
            outcomes["refused"] += 1
        else:
            assert np.isfinite(row.time)
            assert row.values is None or all(isnan(value) or np.isfinite(value) for value in row.values)
            outcomes["row"] += 1
    assert min(outcomes.values()) > 10_000


# --- a crash ---------------------------------------------------------------------------------------------------------


class Crash(BaseException):
    """The process is gone."""


def dies_after(monkeypatch, calls):
    """The process dies at its call number `calls` to the system that changes something; half of a write is done."""
    count = [0]

    def wrapped(call, *, write=False):
        def dying(*args):
            count[0] += 1
            if count[0] > calls:
                if write and count[0] == calls + 1:
                    call(args[0], args[1][: len(args[1]) // 2])
                raise Crash
            return call(*args)

        return dying

    monkeypatch.setattr(_files.os, "write", wrapped(os.write, write=True))
    monkeypatch.setattr(_files.os, "fsync", wrapped(lambda _: None))
    monkeypatch.setattr(_files.os, "ftruncate", wrapped(os.ftruncate))
    monkeypatch.setattr(_files.Path, "replace", wrapped(Path.replace))
    monkeypatch.setattr(_files.Path, "unlink", wrapped(Path.unlink))


def test_a_crash_at_every_call_to_the_system(monkeypatch):
    follow(live_scene.lines(12))
    whole = outputs()
    assert all(whole)
    crashes = 0
    for calls in range(10_000):
        for name in NAMES[1:]:
            Path(name).unlink(missing_ok=True)
        try:
            with monkeypatch.context() as patch:
                dies_after(patch, calls)
                patch.setattr(_files, "CHUNK", 250)
                follow(checkpoint="run.ckpt", every=0.0)
            break
        except Crash:
            crashes += 1
        follow(checkpoint="run.ckpt", every=0.0)
        assert outputs() == whole
    assert crashes > 50
    assert outputs() == whole


def test_crash_after_crash(monkeypatch):
    """Dies soon, again and again, and still gets to the end."""
    follow(live_scene.lines(30))
    whole = outputs()
    for name in NAMES[1:3]:
        Path(name).unlink()
    rng, crashes = random.Random(1), 0
    while True:
        try:
            with monkeypatch.context() as patch:
                dies_after(patch, rng.randrange(4, 30))
                patch.setattr(_files, "CHUNK", 150)
                run = follow(checkpoint="run.ckpt", every=0.0)
            break
        except Crash:
            crashes += 1
    assert crashes > 10
    assert outputs() == whole
    assert_books(run, Path("in.ndjson").read_bytes())


def test_a_full_disk_leaves_the_checkpoint(monkeypatch):
    follow(live_scene.lines(16))
    whole = outputs()
    for name in NAMES[1:3]:
        Path(name).unlink()
    write, room = os.write, [0]

    def full(fd, data):
        room[0] -= 1
        if room[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(fd, data)

    for writes in range(5):
        room[0] = writes
        with monkeypatch.context() as patch:
            patch.setattr(_files.os, "write", full)
            patch.setattr(_files, "CHUNK", 150)
            with pytest.raises(live.StreamError, match="No space left on device"):
                follow(checkpoint="run.ckpt", every=0.0)
        Checkpoint.load(Path("run.ckpt"))
        assert not Path(".run.ckpt.part").exists()
    follow(checkpoint="run.ckpt")
    assert outputs() == whole


# --- the checkpoint --------------------------------------------------------------------------------------------------


def stopped(data, after=3):
    """A run that was stopped on the way."""
    calls = iter([False] * after + [True])
    return follow(data, checkpoint="run.ckpt", every=0.0, stop=lambda: next(calls))


def test_every_damage_of_a_checkpoint_is_noticed(monkeypatch):
    monkeypatch.setattr(_files, "CHUNK", 500)
    stopped(live_scene.lines(20))
    good, rng = Path("run.ckpt").read_bytes(), random.Random(1)
    Checkpoint.from_bytes(good)
    for at in range(len(good)):
        bad = bytearray(good)
        bad[at] ^= rng.randrange(1, 256)
        with pytest.raises(tr.StateError):
            Checkpoint.from_bytes(bytes(bad))
        with pytest.raises(tr.StateError):
            Checkpoint.from_bytes(good[:at])
    with pytest.raises(tr.StateError):
        Checkpoint.from_bytes(good + b"\0")
    before = outputs()
    for bad in (b"", good[:-1], good[:100] + b"?" + good[101:], b"time,sensor\n"):
        Path("run.ckpt").write_bytes(bad)
        with pytest.raises(tr.StateError, match=r"run.ckpt: is "):
            follow(checkpoint="run.ckpt")
        assert Path("run.ckpt").read_bytes() == bad
        assert outputs() == before
    saved = Checkpoint.from_bytes(good)
    for head in (
        {},
        {**saved.head, "counts": "abc"},
        {**saved.head, "scans": {"done": 1}},
        {**saved.head, "input": []},
    ):
        Path("run.ckpt").write_bytes(Checkpoint(head, saved.begun, saved.tracker).to_bytes())
        with pytest.raises(tr.StateError, match=r"run.ckpt: is no checkpoint that this program has written"):
            follow(checkpoint="run.ckpt")


def test_resumes_only_what_it_was(monkeypatch):
    monkeypatch.setattr(_files, "CHUNK", 500)
    data = live_scene.lines(20)
    run = stopped(data)
    assert not run.ended
    assert run.waiting > 0
    again = {"checkpoint": "run.ckpt"}

    def refused(error, words, **changes):
        before = [Path(name).read_bytes() for name in NAMES[1:]]
        with pytest.raises(error, match=words):
            follow(**again | changes)
        assert [Path(name).read_bytes() for name in NAMES[1:]] == before

    refused(tr.StateError, "run.ckpt: was written with other models", start=tracker(max_gap=3.0))
    refused(tr.StateError, "other models, parameters or columns", layout=InputConfig(time="t"))
    refused(tr.StateError, "with an output for tracks", out=lambda _: None)
    refused(tr.StateError, "with an output for dead letters", dead_letters=None)
    Path("in.ndjson").write_bytes(data[: run.offset - 1])
    refused(
        live.StreamError,
        f"in.ndjson: ends at byte {run.offset - 1}, but the checkpoint stands at {run.offset}".replace(
            "at ", "at (byte )?"
        ),
    )
    Path("in.ndjson").write_bytes(b" " + data)
    refused(live.StreamError, "in.ndjson: is not the input")
    Path("in.ndjson").write_bytes(data)
    out = Path("out.ndjson").read_bytes()
    Path("out.ndjson").write_bytes(out[:-1])
    refused(live.StreamError, "out.ndjson: has")
    Path("out.ndjson").write_bytes(out.replace(b"radar", b"lidar"))
    refused(live.StreamError, "out.ndjson: is not the file")
    Path("out.ndjson").write_bytes(out)
    assert follow(**again).ended
    with pytest.raises(live.StreamError, match=r"out.ndjson: is not empty"):
        follow()
    with pytest.raises(tr.ParameterError, match="two places"):
        follow(dead_letters="out.ndjson")
    with pytest.raises(tr.ParameterError, match="every = nan"):
        follow(every=float("nan"))


def test_outputs_follow_no_links():
    for name in NAMES[1:]:
        Path("target").write_bytes(b"")
        Path(name).symlink_to("target")
        with pytest.raises(live.StreamError, match=f"{name}: is .*links?"):
            follow(live_scene.lines(3), checkpoint="run.ckpt")
        assert Path("target").read_bytes() == b""
        for each in NAMES[1:]:
            Path(each).unlink(missing_ok=True)


def test_two_runs_do_not_share_an_output():
    def stop():
        with pytest.raises(live.StreamError, match=r"out.ndjson: is being written by another run"):
            follow(dead_letters=None)
        return True

    follow(live_scene.lines(3), stop=stop)


def test_a_model_in_python_cannot_be_saved():
    motion = tr.CustomMotion(lambda x, _: x, lambda _: np.eye(2), labels=("x", "y"))
    start = tr.MultiTargetTracker(motion, {"radar": tr.PositionSensor(dims=2, std=1.0)}, tr.MofN(2, 3, max_speed=20.0))
    Path("in.ndjson").write_bytes(encoded(live_scene.rows(3)))
    with pytest.raises(tr.StateError):
        live.follow("in.ndjson", start, {"radar": ("x", "y")}, out=lambda _: None, checkpoint="c", wait=False)
