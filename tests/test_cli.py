"""The command line: what it prints, that files hold what memory holds, a mistake is one line and leaves nothing."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import trackrs as tr
from trackrs.cli import main
from trackrs.cli import track as command
from trackrs.config import load_config
from trackrs.io import read_scan_table, read_scans, read_tracks, read_truth

ROOT = Path(__file__).resolve().parent.parent
HARBOUR = ROOT / "examples" / "harbour.toml"
DATA = ROOT / "examples" / "data" / "autoferry" / "scenario13"

CONFIG = """
[motion]
type = "constant_velocity"
dims = 2
accel_psd = 0.1

[sensors.radar]
type = "position"
dims = 2
std = 1.0
columns = ["x", "y"]

[tracker.initiator]
m = 2
n = 3
max_speed = 20.0

[tracker.deletion]
max_misses = 2

[truth]
columns = ["x", "y"]

[score]
c = 10.0
"""
SCANS = "time,sensor\n" + "".join(f"{k},radar\n" for k in range(12))
DETECTIONS = "time,sensor,x,y\n" + "".join(f"{k},radar,{5 * k},0\n{k},radar,100,{3 * k}\n" for k in range(8))
TRUTH = "time,target_id,x,y\n0,a,0,0\n11,a,55,0\n0,b,100,0\n11,b,100,33\n"
TRACK_ARGS = ["track", "d.csv", "--scans", "s.csv", "--config", "c.toml", "--out", "o.csv"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with a small scene."""
    monkeypatch.chdir(tmp_path)
    for name, text in {"c.toml": CONFIG, "d.csv": DETECTIONS, "s.csv": SCANS, "t.csv": TRUTH}.items():
        Path(name).write_text(text)


pytestmark = pytest.mark.usefixtures("folder")


def files():
    return {path.name: path.read_bytes() for path in Path().iterdir() if path.is_file()}


def refused(capsys, args, *culprits):
    """Runs a command that must fail: exit code 2, one line with the culprits, nothing left behind."""
    before = files()
    assert main(args) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("trackrs: error: ")
    assert printed.err.count("\n") == 1
    assert printed.err.endswith("\n")
    for culprit in culprits:
        assert culprit in printed.err
    assert files() == before
    return printed.err


# --- what it does ----------------------------------------------------------------------------------------------------


def test_summary(capsys):
    assert main(TRACK_ARGS) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert "d.csv: 12 scans of radar, 0 s to 11 s" in printed.out
    assert "rows     16 in: 16 used, 0 rejected, 0 late, 0 duplicate" in printed.out
    assert "events   none" in printed.out
    assert "tracks   2 confirmed" in printed.out
    assert "written  o.csv" in printed.out
    assert files().keys() == {"c.toml", "d.csv", "s.csv", "t.csv", "o.csv"}


def test_ledger_and_events_are_reported(capsys):
    text = DETECTIONS + "3,radar,15,0\n4,radar,,\n5,camera,1,2\n"  # a row twice, one without values, one left out
    Path("d.csv").write_text(text)
    Path("c.toml").write_text(CONFIG + '[input]\nignore_sensors = ["camera"]\n')
    assert main([*TRACK_ARGS, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    ledger = record["ledger"]
    assert ledger == {"rows_in": 18, "used": 16, "rejected": {"not_observed": 1}, "late": 0, "duplicate": 1}
    assert ledger["rows_in"] == ledger["used"] + sum(ledger["rejected"].values()) + ledger["late"] + ledger["duplicate"]
    assert record["events"] == {"duplicate": 1, "not_observed": 1}
    assert record["ignored"] == {"camera": 1}
    assert record["rows"] == 19
    assert record["tracks"] == [1, 2]
    assert main(TRACK_ARGS) == 0
    out = capsys.readouterr().out
    assert "rows     18 in: 16 used, 1 rejected (1 not_observed), 0 late, 1 duplicate" in out
    assert "left out 1 camera" in out
    assert "1 duplicate" in out


def test_without_scans_it_says_so(capsys):
    assert main(["track", "d.csv", "--config", "c.toml", "--out", "o.csv"]) == 0
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "empty scans are unknown and cannot count as misses" in printed.err
    assert main(["evaluate", "t.csv", "o.csv", "--config", "c.toml"]) == 0
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "scored at the times of the tracks only" in printed.err


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_files_give_the_numbers_of_memory(suffix, tmp_path, capsys):
    config = load_config(HARBOUR)
    recording = read_scans(DATA / "detections.csv", DATA / "scans.csv", config.columns, config.input)
    truth = read_truth(DATA / "truth.csv", config.truth)
    tracks = config.make_tracker().run(recording.scans)
    score, metric = config.score, config.score.make_metric()
    settings = {"sensor": score.sensor, "start": score.start, "region": score.region, "centres": recording.platforms}
    expected = tr.evaluate(truth, tracks, [metric], **settings)

    stepped = config.make_tracker()
    steps = [stepped.step(scan) for scan in recording.scans]
    assert np.concatenate([step.means for step in steps]).tobytes() == tracks.means.tobytes()
    assert np.concatenate([step.ids for step in steps]).tobytes() == tracks.ids.tobytes()

    out = tmp_path / f"tracks{suffix}"
    files = ["--scans", str(DATA / "scans.csv"), "--config", str(HARBOUR)]
    assert main(["track", str(DATA / "detections.csv"), *files, "--out", str(out)]) == 0
    capsys.readouterr()
    back = read_tracks(out, read_scan_table(DATA / "scans.csv", config.columns, config.input))
    for name in ("scan_times", "times", "ids", "means", "covs", "last_hits", "hits", "offsets"):
        assert getattr(back, name).tobytes() == getattr(tracks, name).tobytes(), name

    assert main(["evaluate", str(DATA / "truth.csv"), str(out), *files, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["mean"] == expected.mean[metric]
    for name in ("localisation", "missed", "false_tracks", "all_held", "switches", "false_per_minute", "rmse", "nees"):
        assert record[name] == getattr(expected, name), name
    assert record["false_ids"] == list(expected.false_ids)
    assert [target["held"] for target in record["targets"]] == [target.held for target in expected.per_target]
    assert main(["evaluate", str(DATA / "truth.csv"), str(out), *files]) == 0
    text = capsys.readouterr().out
    assert f"GOSPA    {expected.mean[metric]:.2f} m on average (c = 30 m, p = 2, alpha = 2)" in text
    assert "within 250 m of the platform" in text


def test_scores_that_are_no_numbers_become_null(capsys):
    Path("t.csv").write_text("time,target_id,x,y\n0,a,900,900\n11,a,900,900\n")
    assert main(TRACK_ARGS) == 0
    capsys.readouterr()
    assert main(["evaluate", "t.csv", "o.csv", "--scans", "s.csv", "--config", "c.toml", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["nees"] is None
    assert record["false_ids"] == [1, 2]


def test_ospa(capsys):
    Path("c.toml").write_text(CONFIG + 'metric = "ospa"\n')
    assert main(TRACK_ARGS) == 0
    capsys.readouterr()
    args = ["evaluate", "t.csv", "o.csv", "--scans", "s.csv", "--config", "c.toml"]
    assert main(args) == 0
    assert "OSPA     " in capsys.readouterr().out
    assert main([*args, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["metric"] == "ospa"


@pytest.mark.parametrize("name", ["p.png", "p.svg", "p.pdf"])
def test_picture(name, capsys):
    assert main([*TRACK_ARGS, "--plot", name, "--truth", "t.csv"]) == 0
    assert f"written  o.csv, {name}" in capsys.readouterr().out
    assert Path(name).read_bytes()[:5] in {b"\x89PNG\r", b"<?xml", b"%PDF-"}
    assert files().keys() == {"c.toml", "d.csv", "s.csv", "t.csv", "o.csv", name}


def test_version_and_help(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"trackrs {tr.__version__}\n"
    for args in (["--help"], ["track", "-h"], ["evaluate", "--help"]):
        assert main(args) == 0
        assert capsys.readouterr().out.startswith("Usage: trackrs")


# --- mistakes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "text", "culprits"),
    [
        ("d.csv", None, ["d.csv", "no such file"]),
        ("s.csv", None, ["s.csv", "no such file"]),
        ("c.toml", None, ["c.toml", "no such file"]),
        ("d.csv", "", ["d.csv", "the file is empty"]),
        ("s.csv", "", ["s.csv", "the file is empty"]),
        ("d.csv", "time,sensor,x\n0,radar,1\n", ["d.csv", 'no column "y"', "there are: time, sensor, x"]),
        (
            "d.csv",
            DETECTIONS.replace("5,radar,25,0", "5,radar,abc,0"),
            ["d.csv, line 12", 'column "x"', '"abc" is no number'],
        ),
        (
            "s.csv",
            SCANS.replace("5,radar", "3.5,radar"),
            ["s.csv, line 7", 'column "time"', "line 6", "sort the table"],
        ),
        ("s.csv", SCANS.replace("5,radar", "4,radar"), ["s.csv, line 7", 'column "time"', "line 6", "remove one"]),
        (
            "d.csv",
            DETECTIONS.replace("5,radar", "5,sonar", 1),
            ["d.csv, line 12", '"sonar"', '"radar"', "[sensors.sonar]"],
        ),
        ("s.csv", SCANS.replace("5,radar", "5,sonar"), ["s.csv, line 7", '"sonar"', "ignore_sensors"]),
        (
            "c.toml",
            CONFIG.replace("accel_psd", "acel_psd"),
            ["c.toml, [motion]", '"acel_psd"', 'did you mean "accel_psd"?'],
        ),
        ("c.toml", CONFIG.replace("std = 1.0", "std = -1.0"), ["c.toml, [sensors.radar] std = -1", "positive"]),
        ("c.toml", CONFIG.replace("[truth]", "[thruth]"), ["c.toml", '"thruth"', 'did you mean "truth"?']),
        ("c.toml", CONFIG.replace("std = 1.0", "std = "), ["c.toml, line 10, column 7", "TOML"]),
        (
            "d.csv",
            DETECTIONS.replace("7,radar", "12,radar"),
            ["d.csv, line 16", "radar has no scan at 12.0 s in s.csv"],
        ),
        ("d.csv", DETECTIONS[:-6], ["d.csv, line 17: has 3 cells, the header 4"]),
    ],
)
def test_mistake_in_a_file(file, text, culprits, capsys):
    if text is None:
        Path(file).unlink()
    else:
        assert text not in {CONFIG, SCANS, DETECTIONS}
        Path(file).write_text(text)
    refused(capsys, [*TRACK_ARGS, "--plot", "p.png"], *culprits)


def test_empty_scan_is_no_mistake(capsys):
    Path("d.csv").write_text("time,sensor,x,y\n")
    assert main(TRACK_ARGS) == 0
    assert "rows     0 in" in capsys.readouterr().out
    assert pl.read_csv("o.csv").height == 0


def test_mistake_on_the_command_line(capsys):
    refused(capsys, [], "missing command", "trackrs --help")
    refused(capsys, ["trak"], "'trak'")
    refused(capsys, ["track"], "'DETECTIONS'", "trackrs track --help")
    refused(capsys, ["track", "d.csv", "--out", "o.csv"], "'--config'")
    refused(capsys, ["track", "d.csv", "--config", "c.toml"], "'--out'")
    refused(capsys, [*TRACK_ARGS, "--colour"], "--colour")
    refused(capsys, [*TRACK_ARGS, "--truth", "t.csv"], "--truth", "--plot")
    refused(capsys, [*TRACK_ARGS, "--plot", "p.txt"], "p.txt", ".png")
    refused(capsys, [*TRACK_ARGS, "--plot", "no/p.png"], "no/p.png", "create it")
    refused(capsys, [*TRACK_ARGS, "--plot", "p.png", "--truth", "no.csv"], "no.csv", "no such file")
    refused(capsys, [*TRACK_ARGS[:-1], "no/o.csv"], "no/o.csv", "create it")
    refused(capsys, [*TRACK_ARGS[:-1], "o.txt"], "o.txt", ".parquet")
    refused(capsys, [*TRACK_ARGS[:-1], "d.csv"], "d.csv", "one of the inputs")
    refused(capsys, [*TRACK_ARGS[:-1], "."], "tables end in")
    refused(capsys, ["evaluate", "t.csv"], "'TRACKS'", "trackrs evaluate --help")


def test_mistake_of_evaluate(capsys):
    assert main(TRACK_ARGS) == 0
    capsys.readouterr()
    args = ["evaluate", "t.csv", "o.csv", "--scans", "s.csv", "--config", "c.toml"]
    refused(capsys, ["evaluate", "no.csv", *args[2:]], "no.csv", "no such file")
    refused(capsys, ["evaluate", "t.csv", "d.csv", *args[3:]], "d.csv", "no table of tracks")
    Path("c.toml").write_text(CONFIG.replace("c = 10.0", 'c = 10.0\nstart = 99.0\nsensor = "radar"'))
    refused(capsys, args, "radar", "99.0 s", "nothing to score")
    Path("c.toml").write_text(CONFIG[: CONFIG.index("[score]")])
    refused(capsys, args, "c.toml", "[score]")
    Path("c.toml").write_text(CONFIG[: CONFIG.index("[truth]")])
    refused(capsys, args, "c.toml", "[truth]")
    Path("c.toml").write_text(CONFIG + 'region = 50.0\n[input]\nplatform = ["px", "py"]\n')
    refused(capsys, [*args[:3], *args[5:]], "c.toml, [score] region", "--scans")
    Path("c.toml").write_text(CONFIG)
    Path("t.csv").write_text(TRUTH + "0,a,5,5\n")
    refused(capsys, args, "t.csv, line 6", "target a is elsewhere", "line 2")


def test_platform_needs_scans(capsys):
    Path("c.toml").write_text(CONFIG + '[input]\nplatform = ["px", "py"]\n')
    refused(capsys, ["track", "d.csv", "--config", "c.toml", "--out", "o.csv"], "d.csv", '"px", "py"', "--scans")


def test_strict_stops_at_the_first_event(capsys):
    Path("c.toml").write_text(CONFIG.replace("[tracker.initiator]", "[tracker]\nstrict = true\n[tracker.initiator]"))
    Path("d.csv").write_text(DETECTIONS + "3,radar,15,0\n")
    refused(capsys, TRACK_ARGS, "strict mode")


def test_failure_while_writing_leaves_both_files_as_they_were(capsys, monkeypatch):
    Path("o.csv").write_text("before")
    Path("p.png").write_text("before")

    def fail(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(command, "_draw", fail)
    refused(capsys, [*TRACK_ARGS, "--plot", "p.png"], "p.png", "No space left on device")


def test_fault_of_trackrs_is_no_mistake(capsys, monkeypatch):
    def fail(*_args):
        raise tr.InternalError("internal error, please report it: a law was broken")

    monkeypatch.setattr(command, "run_in_chunks", fail)
    assert main(TRACK_ARGS) == 1
    assert capsys.readouterr().err == "trackrs: error: internal error, please report it: a law was broken\n"


# --- long work -------------------------------------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("terminal", "patience", "shown"), [(True, 0.0, True), (True, 60.0, False), (False, 0.0, False)]
)
def test_progress_bar(terminal, patience, shown, monkeypatch):
    assert main(TRACK_ARGS) == 0
    expected = Path("o.csv").read_bytes()
    stream = Terminal() if terminal else io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(command, "PATIENCE", patience)
    monkeypatch.setattr(command, "CHUNK", 5)
    assert main(TRACK_ARGS) == 0
    assert ("tracking" in stream.getvalue()) == shown
    assert Path("o.csv").read_bytes() == expected


@pytest.mark.parametrize("chunk", [1, 7, 64, 1000])
def test_chunks_are_one_run(chunk, monkeypatch):
    config = load_config(HARBOUR)
    scans = read_scans(DATA / "detections.csv", DATA / "scans.csv", config.columns, config.input).scans
    whole = config.make_tracker().run(scans)
    monkeypatch.setattr(command, "CHUNK", chunk)
    parts = command.run_in_chunks(config.make_tracker(), scans)
    assert parts.sensors == whole.sensors
    assert parts.labels == whole.labels
    for name in ("scan_times", "times", "ids", "means", "covs", "last_hits", "hits", "offsets"):
        left, right = getattr(parts, name), getattr(whole, name)
        assert left.dtype == right.dtype, name
        assert left.shape == right.shape, name
        assert left.tobytes() == right.tobytes(), name
        assert not left.flags.writeable


COMMAND = "import sys; from trackrs.cli import main; sys.exit(main())"


def spawn(code, *args, **kwargs):
    return subprocess.Popen(
        [sys.executable, "-c", code, *args], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **kwargs
    )


def test_interrupted():
    slow = "import time; from trackrs.cli import track\n"
    slow += "track.run_in_chunks = lambda *_: (print('ready', flush=True), time.sleep(60))\n"
    process = spawn(slow + COMMAND, *TRACK_ARGS)
    assert process.stdout.readline() == "ready\n"
    before = files()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "Traceback" not in out + err
    assert files() == before
    assert "o.csv" not in before


# --- as a process ----------------------------------------------------------------------------------------------------


def test_exit_codes_of_the_process():
    process = spawn(COMMAND, *TRACK_ARGS)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert out.startswith("d.csv: 12 scans")
    process = spawn(COMMAND, "track", "no.csv", *TRACK_ARGS[2:])
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert err == "trackrs: error: no.csv: no such file; did you mean o.csv?\n"


@pytest.mark.skipif(os.name != "posix", reason="installed scripts have another suffix")
def test_the_script_is_installed():
    script = Path(sys.executable).parent / "trackrs"
    out = subprocess.run([script, "--version"], check=True, capture_output=True, text=True).stdout
    assert out == f"trackrs {tr.__version__}\n"


@pytest.mark.parametrize("name", ["click", "polars", "rich"])
def test_without_an_extra(name):
    process = spawn(f"import sys; sys.modules[{name!r}] = None; {COMMAND}", *TRACK_ARGS)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert err == f'trackrs: error: the command line needs {name}: pip install "trackrs[cli]"\n'


def test_without_matplotlib():
    process = spawn(f"import sys; sys.modules['matplotlib'] = None; {COMMAND}", *TRACK_ARGS, "--plot", "p.png")
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert err == 'trackrs: error: pictures need matplotlib: pip install "trackrs[plot]"\n'
    assert "o.csv" not in files()


def test_import_stays_light():
    heavy = "{'click', 'polars', 'rich', 'matplotlib', 'tomllib', 'csv'}"
    code = f"import sys, trackrs; print(sorted({heavy} & set(sys.modules)))"
    process = spawn(code)
    assert process.communicate(timeout=60)[0] == "[]\n"
