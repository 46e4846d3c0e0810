"""The examples and the README's code run as they stand."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from trackrs.io import read_tracks

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
SCENARIOS = ["scenario02", "scenario03", "scenario05", "scenario13", "scenario16"]


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def run(command, folder, **kwargs):
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300, **kwargs)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def test_quickstart(tmp_path):
    lines = run([sys.executable, ROOT / "examples" / "quickstart.py"], tmp_path).splitlines()
    assert lines[0].startswith("60 scans, ")
    assert lines[0].endswith(", 2 tracks")
    assert [line.split(":")[0] for line in lines[1:]] == ["track 1", "track 2"]


@pytest.mark.timeout(300)
def test_harbour(tmp_path):
    out = run([sys.executable, ROOT / "examples" / "harbour.py", "--out", tmp_path / "out"], tmp_path)
    lines = out.splitlines()
    assert lines[0].split()[:4] == ["scenario", "scans", "detections", "tracks"]
    assert [line.split()[0] for line in lines[1:7]] == [*SCENARIOS, "mean/total"]
    assert len({len(line) for line in lines[:7]}) == 1
    assert lines[6].split()[1:3] == ["1608", "3473"]
    names = {f"{scenario}{suffix}" for scenario in SCENARIOS for suffix in (".csv", ".png")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    for line in lines[1:6]:
        scenario, tracks = line.split()[0], int(line.split()[3])
        found = read_tracks(tmp_path / "out" / f"{scenario}.csv")
        assert len(set(found.ids.tolist())) == tracks


def test_close_targets(tmp_path):
    command = [sys.executable, ROOT / "examples" / "close_targets.py", "--out", tmp_path / "out", "--runs", "4"]
    lines = run(command, tmp_path).splitlines()
    right = {
        line[:30].strip(): [int(share.strip("%")) for share in line.split() if share.endswith("%")]
        for line in lines[1:6]
    }
    assert right.pop('"JPDAF" as printed (figure 4)') == [0, 0]
    assert {share[0] for share in right.values()} == {100}
    assert right["JPDA"][1] == 0 < right["JPDA, coalescence-free"][1]
    assert (tmp_path / "out" / "close_targets.png").stat().st_size > 10_000


def test_extended_targets(tmp_path):
    command = [sys.executable, ROOT / "examples" / "extended_targets.py", "--out", tmp_path / "out", "--runs", "2"]
    lines = run(command, tmp_path).splitlines()
    tables = {lines[k].split()[0]: lines[k + 1 : k + 7] for k in (0, 7)}
    for name, table in tables.items():
        ospa = {line[:22].strip(): float(line.split()[-3]) for line in table}
        assert ospa.pop("default") < min(ospa.values())
        assert max(ospa, key=ospa.__getitem__) == "two-level as printed", name
        assert {ospa["distance"] < 20.0, ospa["two-level, k = 4"] < 20.0, ospa["k-means++"] > 20.0} == {True}
    pictures = {f"{name}_{part}.png" for name in tables for part in ("scores", "tracks")} | {"cells.png"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == pictures
    assert min(path.stat().st_size for path in (tmp_path / "out").iterdir()) > 10_000


@pytest.mark.timeout(300)
def test_underwater(tmp_path):
    out = run([sys.executable, ROOT / "examples" / "underwater.py", "--out", tmp_path / "out", "--runs", "3"], tmp_path)
    lines = out.splitlines()
    assert lines[0].split()[:2] == ["array", "gross"]
    assert [line.split()[:2] for line in lines[1:5]] == [["bats", "0%"], ["bats", "5%"], ["toss", "0%"], ["toss", "5%"]]
    assert len({len(line) for line in lines[:5]}) == 1
    parts = ("", "_innovations", "_noise")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        f"{a}{p}.png" for a in ("bats", "toss") for p in parts
    }
    for line in lines[1:5]:
        filtered, smoothed = map(float, line.split()[2:4])
        assert smoothed < filtered < 1.8

    # `cargo test` leaves the twin in the target folder; one that is older than the sources is another program.
    twin = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release" / "examples" / "underwater"
    changed = max(file.stat().st_mtime for file in (ROOT / "rust" / "trackrs").rglob("*.rs"))
    if not twin.exists() or twin.stat().st_mtime < changed:
        pytest.skip("the Rust example is not built: cargo test builds it")
    without_time = [
        [line.rsplit(maxsplit=1)[0] for line in table]
        for table in (lines[1:5], run([twin, "3"], ROOT).splitlines()[1:5])
    ]
    assert without_time[0] == without_time[1]


def test_live(tmp_path):
    lines = run([sys.executable, ROOT / "examples" / "live.py"], tmp_path).splitlines()
    assert [line.split(";")[0] for line in lines[:2]] == ["killed after 70 lines", "killed after 130 lines"]
    assert "1 bad line (1 not_json)" in lines[3]
    assert lines[-2] == "exit code 143"
    assert " bytes equal those of the run in one piece" in lines[-1]


def test_readme_python():
    tracks, hydrophones, head, extended = blocks("python")
    shown = run([sys.executable, "-c", tracks], ROOT)
    assert [line.split()[0] for line in shown.splitlines()] == ["1", "2"]
    filtered, smoothed, rejected = run([sys.executable, "-c", hydrophones], ROOT).split()
    assert float(smoothed) < float(filtered) < 1.5
    assert int(rejected) > 10
    assert len(re.findall(r"-?\d\.\d+", run([sys.executable, "-c", head], ROOT))) == 7
    numbers, score = run([sys.executable, "-c", extended], ROOT).splitlines()
    before, after = re.findall(r"\[[\d, ]+\]", numbers)
    assert before == after
    assert float(re.findall(r"\d+\.\d+", score)[-1]) < 8.0


def test_readme_commands(tmp_path):
    (commands,) = [block for block in blocks("sh") if "trackrs track" in block]
    (tmp_path / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
    here = tmp_path / "run"
    here.mkdir()
    for name in ("data", "harbour.toml"):
        (here / name).symlink_to(ROOT / "examples" / name)
    commands = commands.replace("cd examples\n", "").replace("trackrs ", f'"{sys.executable}" -c "$MAIN" ')
    main = "import sys; from trackrs.cli import main; sys.exit(main())"
    out = run(["sh", "-e", "-c", commands], here, env={**os.environ, "MAIN": main})
    assert "written  tracks.csv, tracks.png" in out
    assert "GOSPA" in out


def test_readme_links():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target
    assert {path.name for path in (ROOT / "docs").glob("*.png") if path.stat().st_size > 200_000} == set()


def test_radio_ranges(tmp_path):
    lines = run(
        [sys.executable, ROOT / "examples" / "radio_ranges.py", "--out", tmp_path / "out"], tmp_path
    ).splitlines()
    assert lines[0] == "3529 ranges in 1932 s, none for 97 s"
    assert [line.split("  ")[0] for line in lines[1:3]] == ["ranges only", "with odometry*"]
    assert lines[3].startswith("* The recorded headings equal those of the truth")
    assert (tmp_path / "out" / "radio_ranges.png").stat().st_size > 10_000


def test_helmet(tmp_path):
    out = run([sys.executable, ROOT / "examples" / "helmet.py", "--out", tmp_path / "out", "--runs", "5"], tmp_path)
    lines = out.splitlines()
    table = {line[:24].strip(): [float(x) for x in line[24:].split()] for line in lines[2:5]}
    assert table["paper, Table 1 (one run)"] == [0.0724, 0.0736, 0.0732, 1.017]
    assert table["as printed"][3] == pytest.approx(1.03, abs=0.02)
    assert table["default"][1] < 0.0435
    assert table["default"][2] < 0.0405
    predicted, held = (float(line.split()[2].rstrip(",")) for line in lines if " median " in line)
    assert predicted < 0.6 * held
    rms = {line[:32].strip(): [float(x) for x in re.findall(r"\d+\.\d+", line)] for line in lines if " mm " in line}
    loose, tight = (np.array(rms[f"{name:20}all seen"]) for name in ("pose of each image", "image points"))
    assert (tight <= 1.02 * loose).all()
    assert rms[f"{'image points':20}two hidden"][1] < 1.5
    pictures = {"turntable.png", "moving_head.png", "recorded_head.png", "camera.png"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == pictures
