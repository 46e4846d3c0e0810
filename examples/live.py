"""A radar that goes on sending, a tracker that is killed twice, and tracks in which nothing of that shows.

A feeder writes one line of JSON per echo into a file. `trackrs track --follow` reads it as it grows, and keeps a
checkpoint. It is killed as hard as processes can be, started again in the same way, and goes on.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

CONFIG = """
[motion]
type = "constant_velocity"
dims = 2
accel_psd = 0.05

[sensors.radar]
type = "position"
dims = 2
std = 2.0
columns = ["x", "y"]

[tracker.initiator]
m = 4
n = 5
max_speed = 10.0
"""
COMMAND = [sys.executable, "-c", "import sys; from trackrs.cli import main; sys.exit(main())", "track"]


def main() -> None:
    """Track the stream once in one piece and once with two kills, and compare."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "config.toml").write_text(CONFIG)
        lines = reports()

        # In one piece: standard input to standard output.
        args = [*COMMAND, "-", "--follow", "--config", "config.toml"]
        whole = subprocess.run(args, cwd=folder, input="".join(lines), capture_output=True, text=True, check=True)  # noqa: S603

        # From a file that grows.
        stream = folder / "reports.ndjson"
        stream.touch()
        args = [*COMMAND, "reports.ndjson", "--follow", "--config", "config.toml", "--out", "tracks.ndjson"]
        args += ["--dead-letters", "bad.ndjson", "--checkpoint", "run.checkpoint", "--checkpoint-every", "0"]
        parts = (lines[:70], lines[70:130], lines[130:])
        for number, part in enumerate(parts, 1):
            run = subprocess.Popen(args, cwd=folder, stdout=subprocess.PIPE, text=True)  # noqa: S603
            before = size(folder)
            with stream.open("a") as file:
                for line in part:
                    file.write(line)
                    file.flush()
                    time.sleep(0.001)
            while size(folder) == before:
                time.sleep(0.01)
            if number < len(parts):
                run.kill()
                run.communicate()
                print(f"killed after {sum(map(len, parts[:number]))} lines; {size(folder)} bytes of tracks so far")
            else:
                wait_for(folder / "tracks.ndjson", whole.stdout.splitlines()[-3])
                run.terminate()
                shown, _ = run.communicate()
                print(f"{shown.strip()}\nexit code {run.returncode}")

        # The run that was stopped still waits for the rest of the last scan.
        tracks = (folder / "tracks.ndjson").read_text()
        rest = whole.stdout.removeprefix(tracks)
        assert whole.stdout.startswith(tracks)  # noqa: S101 (that is the point)
        print(f"{len(tracks)} bytes equal those of the run in one piece; {len(rest)} wait for the end of the last scan")


def reports() -> list[str]:
    """What the radar sends: two boats, each seen nine times in ten, and a false echo a second; one line is broken."""
    rng = np.random.default_rng(7)
    lines = []
    for second in range(60):
        boats = np.array([[5.0 * second, 0.0], [300.0 - 4.0 * second, 80.0 + second]])
        seen = boats[rng.random(2) < 0.9]
        seen += rng.normal(0.0, 2.0, seen.shape)
        for x, y in [*seen.tolist(), *rng.uniform([-50.0, -100.0], [350.0, 250.0], (1, 2)).tolist()]:
            lines.append(json.dumps({"time": float(second), "sensor": "radar", "x": x, "y": y}) + "\n")
    lines.insert(100, '{"time": 33.0, "sensor": "ra\n')
    return lines


def size(folder: Path) -> int:
    """Return how much of the tracks is there."""
    path = folder / "tracks.ndjson"
    return path.stat().st_size if path.exists() else 0


def wait_for(path: Path, line: str) -> None:
    """Wait until a file has a line."""
    while line not in path.read_text():
        time.sleep(0.01)


if __name__ == "__main__":
    main()
