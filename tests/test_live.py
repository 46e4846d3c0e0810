"""Live running: the same tracks as the batch command, and every line in the books."""

from __future__ import annotations

import json
import random
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import live_scene
import trackrs as tr
from live_scene import COLUMNS, CONFIG, assert_books, encoded, follow, found, tracker
from trackrs import live
from trackrs.cli import main
from trackrs.config import InputConfig, load_config
from trackrs.io import read_scans
from trackrs.live import _files
from trackrs.live._lines import Lines

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "examples" / "data" / "autoferry" / "scenario13"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("config.toml").write_text(CONFIG)


# --- the same as the batch -------------------------------------------------------------------------------------------


def test_equals_the_batch():
    rows = live_scene.rows(60)
    pl.DataFrame(rows).write_csv("in.csv")
    config = load_config("config.toml")
    batch = config.make_tracker().run(read_scans("in.csv", None, config.columns).scans).to_table()
    run = follow(encoded(rows))
    lines = found()
    assert run.track_rows == len(lines) == len(batch["time"]) > 100
    assert list(lines[0]) == list(batch)
    for name, column in batch.items():
        assert [line[name] for line in lines] == column.tolist()
    assert run.ended
    assert run.rows_in == len(rows)
    assert_books(run, encoded(rows))
    assert found("dead.ndjson") == []


def test_equals_the_batch_with_empty_scans_and_a_platform():
    """Lines of the table of scans, each before its detections, say what that table says."""
    config = load_config(ROOT / "examples" / "harbour.toml")
    batch = config.make_tracker().run(
        read_scans(DATA / "detections.csv", DATA / "scans.csv", config.columns, config.input).scans
    )
    scans = pl.read_csv(DATA / "scans.csv").drop("n_detections").sort("t_s", maintain_order=True)
    detections = pl.read_csv(DATA / "detections.csv").partition_by("scan", as_dict=True)
    rows = []
    for scan in scans.to_dicts():
        rows.append(scan)
        rows += detections[(scan["scan"],)].to_dicts() if (scan["scan"],) in detections else []
    Path("in.ndjson").write_bytes(encoded(rows))
    run = live.follow(
        "in.ndjson", config.make_tracker(), config.columns, layout=config.input, out="out.ndjson", wait=False
    )
    assert run.looks == run.scans == scans.height
    lines = found()
    assert len(lines) == len(batch) > 100
    for name, column in batch.to_table().items():
        assert [line[name] for line in lines] == column.tolist()


def test_other_trackers():
    phd = tr.GMPHD(
        tr.ConstantVelocity(dims=2, accel_psd=0.1),
        {"radar": tr.PositionSensor(dims=2, std=1.0)},
        birth=tr.AdaptiveBirth(weight=0.1, max_speed=20.0, min_measurements=1),
        detection_probability=0.9,
        survival_probability=0.99,
        clutter_density=1e-6,
    )
    rows = [row for row in live_scene.rows(30) if row["sensor"] == "radar"]
    scans = [
        tr.Scan(k, [[row["x"], row["y"]] for row in rows if row["time"] == k], "radar")
        for k in sorted({row["time"] for row in rows})
    ]
    Path("in.ndjson").write_bytes(encoded(rows))
    parts = []
    run = live.follow("in.ndjson", phd.start(), {"radar": ("x", "y")}, out=parts.append, wait=False, checkpoint="c")
    assert (
        run.tracker.to_bytes()
        == live.follow(
            "in.ndjson", phd.start(), {"radar": ("x", "y")}, out=parts.append, wait=False, checkpoint="c"
        ).tracker.to_bytes()
    )
    want = phd.start().run(scans)
    np.testing.assert_array_equal(np.concatenate([part.means for part in parts]), want.means)
    assert len(want) > 10


def test_arrow_streams_give_the_same():
    pytest.importorskip("pyarrow")
    rows = live_scene.rows(40)
    follow(encoded(rows))
    frame = pl.DataFrame(rows, infer_schema_length=None)
    for name, table in {
        "plain": frame,
        "dictionary": frame.with_columns(pl.col("sensor").cast(pl.Categorical)),
    }.items():
        with Path(f"{name}.arrow").open("wb") as file:
            for part in table.iter_slices(17):  # one stream behind the other, of one batch each
                part.write_ipc_stream(file)
        run = live.follow(f"{name}.arrow", tracker(), COLUMNS, out=f"{name}.ndjson", wait=False)
        assert run.rows_in == run.ledger.used == len(rows)
        assert Path(f"{name}.ndjson").read_bytes() == Path("out.ndjson").read_bytes()


def test_arrow_streams_resume_and_are_refused(monkeypatch):
    pa = pytest.importorskip("pyarrow")
    frame = pl.DataFrame(live_scene.rows(40), infer_schema_length=None)
    table = pa.table(frame.to_dict(as_series=False))
    with pa.OSFile("in.arrow", "wb") as file, pa.ipc.new_stream(file, table.schema) as writer:
        for batch in table.to_batches(max_chunksize=10):
            writer.write_batch(batch)
    args = {"out": "out.ndjson", "wait": False}
    live.follow("in.arrow", tracker(), COLUMNS, **args)
    whole, data = Path("out.ndjson").read_bytes(), Path("in.arrow").read_bytes()
    args = {"out": "parts.ndjson", "checkpoint": "c", "every": 0.0, "wait": False}
    calls = iter([False] * 9 + [True])
    with monkeypatch.context() as patch:
        patch.setattr(_files, "CHUNK", 700)
        run = live.follow("in.arrow", tracker(), COLUMNS, **args, stop=lambda: next(calls))
        assert 0 < run.offset < len(data)
        live.follow("in.arrow", tracker(), COLUMNS, **args)
    assert Path("parts.ndjson").read_bytes() == whole

    rng, outcomes = random.Random(1), set()
    for _ in range(300):
        cut = bytearray(data[: rng.randrange(8, len(data))] if rng.random() < 0.3 else data)
        for _ in range(rng.randrange(3)):
            cut[rng.randrange(4, min(len(cut), 3000))] = rng.randrange(256)
        Path("bad.arrow").write_bytes(cut)
        reason = ""
        try:
            live.follow("bad.arrow", tracker(), COLUMNS, out=lambda _: None, wait=False)
        except live.StreamError as error:
            reason = str(error)
        assert not reason or reason.startswith("bad.arrow: the Arrow message at byte ")
        outcomes.add(bool(reason))
    assert outcomes == {False, True}

    def refused(batch, why, **options):
        options = pa.ipc.IpcWriteOptions(**options)
        with pa.OSFile("bomb.arrow", "wb") as file, pa.ipc.new_stream(file, batch.schema, options=options) as writer:
            writer.write_batch(batch)
        with pytest.raises(live.StreamError, match=why):
            live.follow("bomb.arrow", tracker(), COLUMNS, out=lambda _: None, wait=False)

    refused(pa.record_batch({"time": pa.nulls(10**9)}), "1000000000 rows, 100000 are allowed")
    refused(pa.record_batch({"time": pa.array([0.0] * 1000)}), "compressed", compression="zstd")
    refused(pa.record_batch({"sensor": pa.array(["x" * 10**6]).cast(pa.string_view())}), "text of more than 1000")


def test_arrow_without_pyarrow(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    Path("in.arrow").write_bytes(b"\xff\xff\xff\xff\x00\x00\x00\x00")
    assert main(["track", "in.arrow", "--follow", "--config", "config.toml", "--out", "o.ndjson"]) == 2
    assert 'pip install "trackrs[arrow]"' in capsys.readouterr().err


# --- lines -----------------------------------------------------------------------------------------------------------

GOOD = {"time": 0.0, "sensor": "radar", "x": 1.0, "y": 2.0}


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        (b"time=3", "not_json", "is no JSON"),
        (b'{"time": 1', "not_json", "is no JSON"),
        (b"[1, 2]", "not_object", "a list"),
        (b"null", "not_object", "null"),
        (b'{"time": NaN, "sensor": "radar", "x": 1, "y": 2}', "not_json", "NaN is no JSON"),
        (b'{"time": 1e999, "sensor": "radar", "x": 1, "y": 2}', "not_finite", '"time"'),
        (b'{"time": 1, "sensor": "radar", "x": -1e999, "y": 2}', "not_finite", '"x"'),
        (b'{"time": 1, "sensor": "radar", "x": 1%s, "y": 2}' % (b"0" * 400), "not_finite", '"x"'),
        (b'{"time": 1, "sensor": "radar", "x": 1%s, "y": 2}' % (b"0" * 5000), "not_json", "digits"),
        (b'{"time": "1", "sensor": "radar", "x": 1, "y": 2}', "wrong_type", '"time" holds "1"'),
        (b'{"time": null, "sensor": "radar", "x": 1, "y": 2}', "wrong_type", '"time" holds null'),
        (b'{"time": 1, "sensor": ["radar"], "x": 1, "y": 2}', "wrong_type", '"sensor" holds a list'),
        (b'{"time": 1, "sensor": "radar", "x": true, "y": 2}', "wrong_type", '"x" holds true'),
        (b'{"time": 1, "sensor": "radar", "x": {}, "y": 2}', "wrong_type", '"x" holds a table'),
        (b'{"sensor": "radar", "x": 1, "y": 2}', "missing_column", 'no column "time"'),
        (b'{"time": 1, "x": 1, "y": 2}', "missing_column", 'no column "sensor"'),
        (b'{"time": 1, "sensor": "radar", "x": 1, "Y": 2}', "missing_column", 'no column "y" (there are: "time"'),
        (b'{"time": 1, "sensor": "lidar", "x": 1, "y": 2}', "unknown_sensor", '"lidar" (there are: "radar", "sonar")'),
        (b'{"time": 1, "sensor": "\xff"}', "not_utf8", "byte 23"),
        (b"\xff\xfe{\x00}\x00", "not_utf8", "byte 0"),
        (b"\xef\xbb\xbf{}", "not_json", "is no JSON"),
        (b"[" * 65, "too_deep", "65 deep"),
        (b'{"a":' * 65, "too_deep", "65 deep"),
        (b"[" * 100_000, "too_deep", "100000 deep"),
        (b'"' + b'\\"' * 100 + b'", ' + b"[" * 65, "too_deep", "65 deep"),
        (b'{"x": "%s", "y": 1}' % (b"[" * 1000), "missing_column", "time"),  # brackets in a text are no nesting
        (b"[],[]," * 50 + b"1", "not_json", "Extra data"),
        (b" " * (3 << 20), "too_long", "3145728 bytes, 1048576 are allowed"),
    ],
    ids=lambda value: value[:30].decode("latin-1") if isinstance(value, bytes) else "",
)
def test_a_bad_line_goes_to_the_dead_letters(line, code, words):
    before = encoded([GOOD])
    run = follow(before + line + b"\n" + encoded([{**GOOD, "time": 1.0}]))
    assert run.bad_lines == {code: 1}
    assert run.ledger.used == 2
    (letter,) = found("dead.ndjson")
    assert {name: letter[name] for name in ("line", "offset", "code")} == {
        "line": 2,
        "offset": len(before),
        "code": code,
    }
    assert words in letter["reason"]
    assert letter["text"] == line[:200].decode("utf-8", "backslashreplace")


def test_the_longest_and_the_deepest_line():
    room = (1 << 20) - len(json.dumps({**GOOD, "more": ""}))
    nested = json.loads("[" * 63 + "]" * 63)
    run = follow(encoded([{**GOOD, "more": "." * room}, {**GOOD, "x": 3.0, "more": nested}]))
    assert run.ledger.used == 2
    for name in ("out.ndjson", "dead.ndjson"):
        Path(name).unlink()
    run = follow(encoded([{**GOOD, "more": "." * (room + 1)}, {**GOOD, "x": 3.0, "more": [nested]}]))
    assert run.bad_lines == {"too_long": 1, "too_deep": 1}


def test_rows_that_the_tracker_refuses_are_dead_letters_too():
    rows = [GOOD, GOOD, {**GOOD, "x": None, "y": None}, {**GOOD, "time": 2.0}, {**GOOD, "time": 1.0, "x": 7}]
    rows += [{**GOOD, "time": 3.0, "sensor": "radar"}, {**GOOD, "time": 1.0}]
    rows += [{**GOOD, "time": 4.0}] * 1500
    run = follow(encoded(rows))
    assert_books(run, encoded(rows))
    assert run.ledger.late == 1
    assert run.ledger.duplicate == 1500
    letters = found("dead.ndjson")
    assert [(each["line"], each["code"]) for each in letters[:3]] == [
        (2, "duplicate"),
        (3, "not_observed"),
        (7, "late_scan"),
    ]
    assert json.loads(letters[1]["text"]) == rows[2]
    assert len(letters) == run.ledger.late + run.ledger.duplicate + run.ledger.rejected["not_observed"]


def test_a_row_is_late_when_its_scan_is_complete(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("trackrs.live._follow.time.monotonic", lambda: now[0])
    data = encoded([GOOD, {**GOOD, "x": 50.0}])
    with Path("in.ndjson").open("wb") as file:
        file.write(data)
        file.flush()
        looks = []

        def stop():
            looks.append(now[0])
            now[0] += 1.0
            if len(looks) == 8:  # nothing came for five seconds: the scan is complete
                file.write(encoded([{**GOOD, "x": 60.0}, {**GOOD, "sensor": "sonar", "range": 1, "bearing": 0}]))
                file.flush()
            return len(looks) == 12

        run = follow(wait=True, idle=5.0, stop=stop)
    assert run.scans == 2
    assert run.bad_lines == {"late_row": 1}
    assert run.ledger.used == 3
    assert found("dead.ndjson")[0]["line"] == 3


def test_ignored_sensors_numbers_as_names_and_the_platform():
    layout = InputConfig(platform=("px", "py"), ignore_sensors=("camera",))
    sensor = tr.PositionSensor(dims=2, std=1.0)
    start = tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_psd=0.1), {"7": sensor}, tr.MofN(2, 3, max_speed=20.0)
    )
    row = {"time": 0, "sensor": 7, "x": 1, "y": 2}
    rows = [{"time": 0, "sensor": "camera"}, row, {**row, "px": 0.0, "py": 0.0}, row, {**row, "px": 1.0, "py": 0.0}]
    rows += [{"time": 1, "sensor": 7, "px": 5, "py": 6}, {"time": 1, "sensor": 7, "px": 5}]
    Path("in.ndjson").write_bytes(encoded(rows))
    run = live.follow("in.ndjson", start, {"7": ("x", "y")}, layout=layout, dead_letters="dead.ndjson", wait=False)
    assert run.ignored == {"camera": 1}
    assert run.bad_lines == {"no_platform": 1, "two_platforms": 1, "missing_column": 1}
    assert (run.ledger.rows_in, run.looks, run.scans) == (2, 1, 2)


def test_a_strict_tracker_ends_the_run():
    rows = live_scene.rows(20)
    follow(encoded(rows), out="whole.ndjson", dead_letters=None)
    with pytest.raises(tr.StrictError, match="late_scan at 3 s"):
        follow(encoded([*rows, {**rows[0], "time": 3.0}]), start=tracker(strict=True))
    text = Path("out.ndjson").read_text()
    assert text
    assert Path("whole.ndjson").read_text().startswith(text)


def test_a_tracker_that_has_seen_scans_before():
    start = tracker()
    start.step(tr.Scan(-1.0, [[1.0, 2.0], [1.0, 2.0]], "radar"))
    before = start.to_bytes()
    run = follow(encoded([GOOD, {**GOOD, "time": 1.0}]), start=start)
    assert start.to_bytes() == before
    assert (run.ledger.rows_in, run.ledger.duplicate, run.tracker.ledger.rows_in) == (2, 0, 4)


def test_rows_that_wait_are_limited():
    rows = [{**GOOD, "x": float(k)} for k in range(12)]
    run = follow(encoded([*rows, {**GOOD, "time": 1.0}]), limits=live.Limits(waiting_rows=10))
    assert run.bad_lines == {"scan_full": 2}
    assert run.ledger.used == 11


def test_scans_without_order_are_limited():
    rows = [{**GOOD, "time": -float(k)} for k in range(1000)]
    run = follow(encoded(rows))
    assert_books(run, encoded(rows))
    assert run.scans == 1000


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(1, 400), max_size=40), st.integers(0, 5))
def test_lines_do_not_depend_on_how_they_come(sizes, seed):
    data = live_scene.lines(6, seed) + b"x" * 900 + b"\n\n \r\n" + b'{"a": 1}'

    def records(pieces):
        cut = Lines(longest=300, depth=8)
        out = [record for piece in pieces for record in cut.feed(piece)] + cut.end()
        shown = [(r.number, r.offset, str(r.fields), r.text) for r in out]
        return shown, cut.offset, cut.number, cut.tail

    pieces, rest = [], data
    for size in sizes:
        pieces.append(rest[:size])
        rest = rest[size:]
    assert records([*pieces, rest]) == records([data])
    assert records([data])[1:] == (len(data), data.count(b"\n") + 1, data[-4096:])
