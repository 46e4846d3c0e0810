"""`trackrs track --follow`: streams, signals, kills, mistakes, memory."""

from __future__ import annotations

import errno
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import live_scene
from live_scene import CONFIG, NAMES, follow, outputs
from trackrs.cli import main
from trackrs.config import load_config
from trackrs.live import _files
from trackrs.live._checkpoint import Checkpoint

ROOT = Path(__file__).resolve().parent.parent
COMMAND = [sys.executable, "-c", "import sys; from trackrs.cli import main; sys.exit(main())", "track"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("config.toml").write_text(CONFIG)


# --- the command -----------------------------------------------------------------------------------------------------

ARGS = ["--follow", "--config", "config.toml", "--out", "out.ndjson", "--dead-letters", "dead.ndjson"]


def spawn(*args, **kwargs):
    return subprocess.Popen([*COMMAND, *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, **kwargs)


def wait_for(condition, process):
    begun = time.monotonic()
    while not condition():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() - begun < 60.0
        time.sleep(0.005)


def test_standard_input_to_standard_output():
    data = live_scene.lines(30)
    follow(data)
    done = subprocess.run(
        [*COMMAND, "-", "--follow", "--config", "config.toml", "--json"], input=data, capture_output=True, check=False
    )
    assert done.returncode == 0
    assert done.stdout == Path("out.ndjson").read_bytes()
    record = json.loads(done.stderr)
    ledger = record["ledger"]
    out = ledger["used"] + ledger["late"] + ledger["duplicate"] + ledger["waiting"]
    assert ledger["rows_in"] == out + sum(ledger["rejected"].values()) + sum(ledger["bad_lines"].values())
    assert record["ended"]
    assert record["offset"] == len(data)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("twice", [False, True])
def test_a_signal_ends_a_growing_file_and_the_run_goes_on(number, code, twice):
    data = live_scene.lines(40)
    follow(data)
    whole = outputs()
    for name in NAMES[1:3]:
        Path(name).unlink()
    middle = len(data) // 2
    assert data[middle - 1 : middle] != b"\n"  # a line is there in part
    Path("in.ndjson").write_bytes(data[:middle])
    process = spawn("in.ndjson", *ARGS, "--checkpoint", "run.ckpt", "--checkpoint-every", "0")
    whole_lines = data.rfind(b"\n", 0, middle) + 1

    def taken():
        saved = Checkpoint.load(Path("run.ckpt"))
        return saved is not None and saved.head["input"][0] == whole_lines

    wait_for(taken, process)
    process.send_signal(number)
    if twice:
        process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == code, err
    assert twice or b"stopped at byte %d" % whole_lines in out
    with Path("in.ndjson").open("ab") as file:
        file.write(data[middle:])
    follow(start=load_config("config.toml").make_tracker(), checkpoint="run.ckpt")
    assert outputs() == whole


def test_kills():
    """Killed at 20 random moments; `TRACKRS_KILLS=1000` for more."""
    done = subprocess.run(
        [sys.executable, ROOT / "tests" / "live_kills.py", "."],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("equal\n")


def refused(capsys, args, *words):
    assert main(["track", *args]) == 2
    err = capsys.readouterr().err.splitlines()
    assert err[-1].startswith("trackrs: error: ")
    for word in words:
        assert word in err[-1]


def test_mistakes_are_one_line(capsys):
    Path("in.ndjson").write_bytes(live_scene.lines(10))
    base = ["in.ndjson", "--follow", "--config", "config.toml"]
    refused(capsys, ["-", "--config", "config.toml", "--out", "o.csv"], "--follow")
    refused(
        capsys, ["in.ndjson", "--config", "config.toml", "--out", "o.csv", "--idle", "1"], "--idle goes with --follow"
    )
    refused(capsys, [*base, "--scans", "s.csv"], "--scans goes without --follow")
    refused(capsys, [*base, "--out", "o.parquet"], "o.parquet", ".ndjson")
    refused(capsys, [*base, "--out", "in.ndjson"], "in.ndjson", "inputs")
    refused(capsys, [*base, "--out", "none/o.ndjson"], "there is no folder none")
    refused(capsys, [*base, "--out", "o.ndjson", "--checkpoint", "o.ndjson"], "o.ndjson", "two places")
    refused(capsys, [*base, "--checkpoint-every", "-1"], "every = -1.0")
    refused(capsys, ["none.ndjson", *base[1:]], "none.ndjson: cannot be read: No such file")
    refused(capsys, [".", *base[1:], "--out", "o.ndjson"], ".: is a folder")
    refused(capsys, [*base, "--out", "/dev/full"], "/dev/full: cannot be written: No space left on device")
    Path("c").write_bytes(b"")
    refused(capsys, [*base, "--out", "o.ndjson", "--checkpoint", "c"], "c: is no checkpoint", "remove it")
    assert Path("c").read_bytes() == b""


def test_no_room_for_the_file():
    """The limit of the file's size stands for a full disk: the system refuses the write in the middle."""
    Path("in.ndjson").write_bytes(live_scene.lines(40))
    args = ["in.ndjson", *ARGS, "--checkpoint", "run.ckpt", "--checkpoint-every", "0"]
    process = spawn(*args, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)))
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert err.decode() == "trackrs: error: out.ndjson: cannot be written: File too large\n"
    assert Path("out.ndjson").stat().st_size == 20_000
    follow(start=load_config("config.toml").make_tracker(), checkpoint="run.ckpt")
    resumed = outputs()
    for name in NAMES[1:]:
        Path(name).unlink()
    follow()
    assert outputs() == resumed


def test_a_folder_that_cannot_be_written(monkeypatch, capsys):
    Path("locked").mkdir()
    Path("locked").chmod(0o555)
    Path("in.ndjson").write_bytes(live_scene.lines(10))
    args = ["in.ndjson", "--follow", "--config", "config.toml"]
    if os.geteuid() == 0:  # nothing is locked for root
        opened = os.open

        def locked(path, flags, *rest):
            if flags & os.O_CREAT and Path(path).parent.name == "locked":
                raise OSError(errno.EROFS, os.strerror(errno.EROFS))
            return opened(path, flags, *rest)

        monkeypatch.setattr(_files.os, "open", locked)
    refused(capsys, [*args, "--out", "locked/o.ndjson"], "locked/o.ndjson: cannot be written")
    refused(
        capsys, [*args, "--out", "o.ndjson", "--checkpoint", "locked/c"], "locked/c: cannot be written", "untouched"
    )


def test_a_reader_that_goes_away():
    process = spawn("-", "--follow", "--config", "config.toml", stdin=subprocess.PIPE)
    process.stdout.close()
    process.stdin.write(live_scene.lines(200))
    process.stdin.close()
    with process.stderr:
        err = process.stderr.read()
    assert process.wait(60) == 2
    assert b"standard output: cannot be written: Broken pipe" in err


MEMORY = """
import json, os, sys
sys.path[:0] = {path!r}
import live_scene
from trackrs import live

def size():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

sizes, seen = [], 0
def count(tracks):
    global seen
    seen += 1
    if seen % 10_000 == 0:
        sizes.append(size())

read, write = os.pipe()
os.dup2(read, 0)
if os.fork() == 0:
    os.close(read)
    line = '{{"time": %d, "sensor": "radar", "x": %r, "y": 20.0}}\\n'
    with open(write, "w") as file:
        for k in range(120_000):
            file.write(line % (k, 0.01 * k))
            if k % 10 == 5:
                file.write("[[\\n" + line % (k - 9, 3.0))
    os._exit(0)
os.close(write)
files = dict(out=count, dead_letters="dead.ndjson", checkpoint="c", every=1)
run = live.follow("-", live_scene.tracker(), live_scene.COLUMNS, **files)
assert run.ledger.late == 12_000, run.ledger
print(json.dumps(sizes))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_memory_is_flat():
    done = subprocess.run(
        [sys.executable, "-c", MEMORY.format(path=sys.path)], capture_output=True, text=True, check=False, cwd="."
    )
    assert done.returncode == 0, done.stderr
    sizes = json.loads(done.stdout)
    assert len(sizes) == 13  # late scans count too
    # In the first 60,000 scans the allocator finds its size; over 400,000 it stays there.
    assert max(sizes) - sizes[5] <= 4 << 20, sizes
