"""Kills a live run again and again, and compares what it leaves with what an uninterrupted run leaves.

`python tests/live_kills.py FOLDER`, with TRACKRS_KILLS for the number of kills (20) and TRACKRS_SEED (1). Half of the
kills hit a run that reads standard input, half one that reads a growing file. Every run is a process of its own,
forked from one that has imported everything; it writes a checkpoint after every piece of input, and is killed after it
has taken in some, at a moment that depends on nothing but chance.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import sys
import time
from pathlib import Path

import live_scene
from trackrs import live
from trackrs.cli import main
from trackrs.config import load_config
from trackrs.live._checkpoint import Checkpoint

PATIENCE = 60.0  # seconds, for a machine under load


def start(args, read_end=None):
    """Run the command in a process of its own and return its id."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            if read_end is not None:
                os.dup2(read_end, 0)
            os.dup2(os.open("log.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
            os.dup2(2, 1)
            code = main(args)
        finally:
            os._exit(code)
    return child


def taken(checkpoint):
    """How many bytes of whole lines the run is done with."""
    saved = Checkpoint.load(checkpoint)
    return -1 if saved is None else saved.head["input"][0]


def kill_one(name, args, data, at, end, rng, grown):
    """Feed a run up to `at`, then in small pieces towards `end`, and kill it on the way."""
    read_end, write_end = os.pipe() if grown is None else (None, None)
    child = start(args, read_end)
    if read_end is not None:
        os.close(read_end)
    into = write_end if grown is None else grown

    def feed(piece):
        with contextlib.suppress(BrokenPipeError):
            while piece:
                piece = piece[os.write(into, piece) :]

    checkpoint, begun = Path(f"{name}.ckpt"), time.monotonic()
    if grown is None:
        feed(data[:at])
    wanted = rng.randrange(1, 6)  # so many pieces, each of them seen to go in, but the last
    for piece in range(wanted):
        size = rng.randrange(1, max((end - at) // wanted, 2))
        feed(data[at : at + size])
        at += size
        whole = data.rfind(b"\n", 0, at) + 1
        while piece < wanted - 1 and taken(checkpoint) < whole:
            done, status = os.waitpid(child, os.WNOHANG)
            assert done == 0, f"the run ended with {os.waitstatus_to_exitcode(status)}: {Path('log.txt').read_text()}"
            assert time.monotonic() - begun < PATIENCE, "the run takes nothing in"
            time.sleep(0.001)
    time.sleep(rng.choice([0.0, rng.expovariate(1e3), rng.expovariate(1e2)]))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if write_end is not None:
        os.close(write_end)
    return at


def campaign(kills, seed):
    """Return what went wrong, in the current folder."""
    Path("config.toml").write_text(live_scene.CONFIG)
    data = live_scene.lines(max(200, 10 * kills), seed)
    Path("input.ndjson").write_bytes(data)
    config = load_config("config.toml")
    rng = random.Random(seed)

    def uninterrupted(source, name, **more):
        live.follow(
            source,
            config.make_tracker(),
            config.columns,
            out=f"{name}.ndjson",
            dead_letters=f"{name}.dead",
            wait=False,
            **more,
        )

    uninterrupted("input.ndjson", "whole")
    wrong, ahead = [], 0
    for mode in ("pipe", "file"):
        args = ["track", "-" if mode == "pipe" else "grown", "--follow", "--config", "config.toml"]
        args += ["--out", f"{mode}.ndjson", "--dead-letters", f"{mode}.dead"]
        args += ["--checkpoint", f"{mode}.ckpt", "--checkpoint-every", "0"]
        grown = None if mode == "pipe" else os.open("grown", os.O_WRONLY | os.O_CREAT, 0o644)
        at = 0
        for kill in range(kills // 2):
            end = len(data) * (kill + 1) // (kills // 2)
            at = kill_one(mode, args, data, at, end, rng, grown)
            saved, size = Checkpoint.load(Path(f"{mode}.ckpt")), Path(f"{mode}.ndjson").stat().st_size
            ahead += saved is None or size != saved.head["out"][0]
        if grown is not None:
            os.write(grown, data[at:])
            os.close(grown)
        uninterrupted("input.ndjson", mode, checkpoint=f"{mode}.ckpt")
        for suffix in ("ndjson", "dead"):
            same = Path(f"{mode}.{suffix}").read_bytes() == Path(f"whole.{suffix}").read_bytes()
            wrong += [] if same else [f"{mode}.{suffix}"]
        assert mode == "pipe" or Path("grown").read_bytes() == data
    sizes = [Path(f"whole.{suffix}").stat().st_size for suffix in ("ndjson", "dead")]
    text = f"{2 * (kills // 2)} kills, {ahead} of them with output ahead of the checkpoint; {len(data)} bytes in"
    return wrong, f"{text}, {sizes[0]} and {sizes[1]} out: {wrong or 'equal'}"


if __name__ == "__main__":
    os.chdir(sys.argv[1])
    found, text = campaign(int(os.environ.get("TRACKRS_KILLS", "20")), int(os.environ.get("TRACKRS_SEED", "1")))
    print(text)
    sys.exit(bool(found))
