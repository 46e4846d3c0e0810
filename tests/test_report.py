"""The page: what is in the file, and the commands that write it."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trackrs as tr
from report_pages import (
    EVIL,
    MOTION,
    PNG,
    RADAR,
    SVG,
    Reader,
    course,
    every_section,
    page_of,
    scene_of,
    tracks_of,
    unpack,
)
from trackrs.cli import main
from trackrs.report import (
    Comparison,
    Curves,
    Interval,
    Line,
    MethodScore,
    Picture,
    Prose,
    Scene,
    Table,
    write_report,
)

# --- the file --------------------------------------------------------------------------------------------------------


def test_a_long_list_of_contents_has_the_texts_only():
    def listed(count):
        chapters = [Table(["a"], [[1]], title="all")]
        for k in range(count):
            chapters += [Prose("text", title=f"chapter {k}"), Table(["a"], [[k]], title=f"numbers {k}")]
        page = io.StringIO()
        write_report(page, "book", chapters)
        return re.findall(r'<li><a href="#section-\d+">([^<]+)</a>', page.getvalue())

    assert listed(2) == ["all", "chapter 0", "numbers 0", "chapter 1", "numbers 1"]
    assert listed(7) == ["all", *(f"chapter {k}" for k in range(7))]


def test_the_page_is_whole():
    page = page_of(*every_section(), subtitle="below")
    reader = Reader(page)
    assert page.startswith("<!doctype html>")
    assert reader.all("html", lang="en")
    assert [attrs["class"] for attrs in reader.all("section")] == [
        "scene",
        "curves",
        "comparison",
        "table",
        "picture",
        "prose",
    ]
    assert {"Title", "below", "Plane", "Claims", "One.", "Two."} <= set(reader.texts)
    assert reader.data.keys() == {"scenes", "curves"}
    links = [attrs["href"] for attrs in reader.all("a")]
    assert links == [f"#section-{k}" for k in range(6)]
    assert len({attrs["id"] for _, attrs in reader.tags if "id" in attrs}) == sum("id" in a for _, a in reader.tags)
    assert all(attrs.get("alt") for attrs in reader.all("img"))
    assert all(attrs.get("type") == "button" for attrs in reader.all("button"))


def test_the_policy_allows_this_page_alone():
    reader = Reader(page_of(*every_section()))
    (policy,) = [attrs["content"] for attrs in reader.all("meta") if "http-equiv" in attrs]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    for rule, body in (("script-src", "script"), ("style-src", "style")):
        digest = base64.b64encode(hashlib.sha256(reader.bodies[body].encode()).digest()).decode()
        assert rules[rule] == f"'sha256-{digest}'"
    # A style of an element's own would be refused, and nothing is fetched.
    assert not any("style" in attrs or "onclick" in attrs for _, attrs in reader.tags)
    for _, attrs in reader.tags:
        for key in ("src", "href"):
            assert attrs.get(key, "#").startswith(("#", "data:"))


def test_names_are_text():
    lines = [Line(EVIL, [0.0, 1.0], [1.0, 2.0])]
    scene = Scene(
        tracks_of(course(3, 2), [0.0, 1.0, 2.0], [1, 2]),
        title=EVIL,
        scans=[tr.Scan(float(k), [[0.0, 0.0]], EVIL) for k in range(3)],
        sensors={EVIL: RADAR},
        truth=[tr.Truth(EVIL, [0.0, 1.0], [[0.0, 0.0], [1.0, 1.0]])],
        labels=(EVIL, EVIL),
    )
    page = page_of(
        scene,
        Curves(lines, EVIL, EVIL, EVIL, band=EVIL),
        Comparison([MethodScore(EVIL, EVIL, Interval(1.0, 0.0, 2.0))], EVIL, EVIL),
        Table([EVIL], [[EVIL]], EVIL, verdict=EVIL),
        Picture(PNG, EVIL, EVIL),
        Prose(EVIL, EVIL),
        title=EVIL,
        subtitle=EVIL,
    )
    reader = Reader(page)
    assert len(reader.all("script")) == 2
    assert [attrs["alt"] for attrs in reader.all("img")] == [EVIL]
    assert reader.texts.count(EVIL) >= 12
    assert reader.data["scenes"][0]["truth"][0]["id"] == EVIL
    assert reader.data["curves"][0]["lines"][0]["name"] == EVIL
    assert "<" not in reader.bodies["application/json"]


def test_numbers_that_are_none_are_gaps():
    means = course(4, 2)
    means[1, 0] = np.nan
    means[2, 1] = np.inf
    covs = np.tile(np.eye(4), (8, 1, 1))
    covs[3] = np.inf
    scene = Scene(tracks_of(means, range(4), [1, 2], covs=covs), motion=MOTION, own_ship=np.full((4, 2), np.nan))
    curves = Curves([Line("a", [0.0, 1.0, 2.0], [1.0, np.nan, np.inf], [0.0, np.nan, -np.inf], [2.0, 3.0, np.inf])])
    comparison = Comparison([MethodScore("m", "a", Interval(np.nan, np.nan, np.inf), None, np.nan)])
    reader = Reader(page_of(scene, curves, comparison, Table(["a"], [[np.nan], [-np.inf], [True]])))
    data = reader.data["scenes"][0]
    position = unpack(data["position"]).reshape(-1, 2)
    assert np.isnan(position).any(axis=1).tolist() == [False, False, True, False, False, True, False, False]
    assert not np.isinf(unpack(data["cov"])).any()
    assert np.isfinite([*data["centre"], *data["bounds"]]).all()
    line = reader.data["curves"][0]["lines"][0]
    assert unpack(line["y"])[0] == 1.0
    assert np.isnan(unpack(line["y"])[1:]).all()


@pytest.mark.parametrize("times", [[], [3.0], [0.0, 1.0]])
def test_no_tracks(times):
    tracks = tracks_of(np.zeros((len(times), 0, 4)), times, [])
    scans = [tr.Scan(time, [], "radar") for time in times]
    data = Reader(page_of(Scene(tracks, scans=scans, sensors={"radar": RADAR}, motion=MOTION))).data["scenes"][0]
    assert data["ids"] == []
    assert unpack(data["offsets"]).tolist() == [0] * (len(times) + 1)
    assert data["bounds"] == [-1.0, -1.0, 1.0, 1.0]


def test_detections_alone_set_the_view():
    tracks = tracks_of(np.zeros((1, 0, 4)), [0.0], [])
    scene = Scene(tracks, scans=[tr.Scan(0.0, [[100.0, 0.0], [300.0, 50.0]], "radar")], sensors={"radar": RADAR})
    data = Reader(page_of(scene)).data["scenes"][0]
    assert data["centre"] == [200.0, 25.0]
    assert data["bounds"][2] - data["bounds"][0] == pytest.approx(200.0 * 1.12)


def test_huge_coordinates_keep_millimetres():
    origin = np.array([500_000.0, 6_000_000.0])
    scene = scene_of(origin=origin)
    data = Reader(page_of(scene)).data["scenes"][0]
    shown = unpack(data["position"]).reshape(-1, 2).astype(float) + data["centre"]
    assert np.abs(shown - scene.tracks.means[:, :2]).max() < 1e-3
    found = unpack(data["detections"]["position"]).reshape(-1, 2).astype(float) + data["centre"]
    assert np.abs(found - np.concatenate([scan.values for scan in scene.scans])).max() < 1e-3


def test_swapped_axes_swap_everything():
    scene = scene_of(own_ship=np.stack([np.arange(30.0), np.zeros(30)], axis=1), labels=("north (m)", "east (m)"))
    plain = Reader(page_of(scene)).data["scenes"][0]
    fields = {
        name: getattr(scene, name) for name in ("tracks", "scans", "sensors", "motion", "truth", "own_ship", "labels")
    }
    data = Reader(page_of(Scene(**fields, swap_axes=True))).data["scenes"][0]
    assert data["axes"] == ["east (m)", "north (m)"]
    assert data["centre"] == plain["centre"][::-1]
    for name, width, order in (("position", 2, [1, 0]), ("own", 2, [1, 0]), ("cov", 3, [2, 1, 0])):
        assert np.array_equal(unpack(data[name]).reshape(-1, width), unpack(plain[name]).reshape(-1, width)[:, order])
    gates = [unpack(each["gate"]).reshape(-1, 5) for each in (data, plain)]
    assert np.array_equal(gates[0], gates[1][:, [1, 0, 4, 3, 2]], equal_nan=True)


def rows_of_gates(scene):
    data = Reader(page_of(scene)).data["scenes"][0]
    gates = unpack(data["gate"]).reshape(-1, 5).astype(float)
    gates[:, :2] += data["centre"]
    return gates


def test_gates_are_predictions_of_the_filter():
    scene = scene_of(count=1, detections=1, gate=0.95)
    gates = rows_of_gates(scene)
    assert np.isnan(gates[0]).all()
    ekf, threshold = tr.ExtendedKalmanFilter(MOTION, RADAR), tr.Gate(0.95).threshold(2)
    for k, before in enumerate(scene.tracks.history[1][:-1]):
        predicted = ekf.predict(before.state, scene.tracks.scan_times[k + 1])
        cov = threshold * (predicted.cov[:2, :2] + np.diag([4.0, 9.0]))
        expected = [*predicted.mean[:2], cov[0, 0], cov[0, 1], cov[1, 1]]
        assert np.allclose(gates[k + 1], expected, rtol=1e-5)


def test_gates_of_range_and_bearing_lie_across_the_ray():
    # A target due north of the radar: bearing errors become errors in y, of reach times the angle.
    means = np.tile([1000.0, 0.0, 0.0, 0.0], (2, 1, 1))
    tracks = tracks_of(means, [0.0, 1.0], [1], covs=np.tile(1e-6 * np.eye(4), (2, 1, 1)))
    radar = tr.RangeBearing(position=(100.0, 0.0), range_std=5.0, bearing_std=0.02)
    scans = [tr.Scan(float(k), [[400.0, 0.0]], "radar", platform=[500.0, 0.0]) for k in range(2)]
    motion = tr.ConstantVelocity(dims=2, accel_psd=1e-9)
    gates = rows_of_gates(Scene(tracks, scans=scans, sensors={"radar": radar}, motion=motion))
    expected = np.array([25.0, 0.0, (400.0 * 0.02) ** 2]) * tr.Gate(0.99).threshold(2)
    assert np.allclose(gates[1, 2:], expected, rtol=1e-4, atol=1e-3)


def test_table_of_tracks():
    means = course(4, 2)
    tracks = tracks_of(means, [0.0, 1.0, 2.0, 3.0], [7, 9])
    keep = np.array([0, 1, 2, 3, 4, 6])  # track 9 ends after the second scan
    cut = {name: getattr(tracks, name)[keep] for name in ("times", "ids", "means", "covs", "last_hits", "hits")}
    tracks = tr.Tracks(
        tracks.scan_times, tracks.sensors, **cut, labels=tracks.labels, offsets=np.array([0, 2, 4, 5, 6])
    )
    reader = Reader(page_of(Scene(tracks)))
    assert [attrs["data-track"] for attrs in reader.all("tr") if "data-track" in attrs] == ["0", "1"]
    text = " ".join(reader.texts)
    speeds = np.hypot(*means[0, :, 2:].T)
    assert f"7 0.00 3.00 4 4 {speeds[0]:.2f} active" in text
    assert f"9 0.00 1.00 2 2 {speeds[1]:.2f} ended" in text


def test_badges_and_numbers():
    rows = [
        ["holds", 1.23456],
        ["does not hold", 123456.789],
        ["<b>", 7],
        ["no", 1e-12],
        ["differs", 0],
        ["", 0],
        [None, 0],
    ]
    reader = Reader(page_of(Table(["verdict", "value"], rows, verdict="verdict")))
    assert [attrs["class"].split() for attrs in reader.all("span") if "badge" in attrs.get("class", "")] == [
        ["badge", "good"],
        ["badge", "bad"],
        ["badge"],
        ["badge"],
        ["badge", "bad"],
    ]
    assert {"1.235", "123457", "7", "<b>"} <= set(reader.texts)


def test_scales_of_a_comparison():
    scores = [
        MethodScore("m", "a", Interval(2.0, 1.0, 3.0)),
        MethodScore("m", "b", Interval(6.0, 5.0, 11.0), Interval(4.0, 3.5, 4.5), 0.03),
    ]
    reader = Reader(page_of(Comparison(scores, reference="a")))
    at = [float(attrs["cx"].rstrip("%")) for attrs in reader.all("circle")]
    bars = [[float(attrs[k].rstrip("%")) for k in ("x1", "x2")] for attrs in reader.all("line", **{"class": "bar"})]
    assert (at[1] - at[0]) / (bars[1][1] - bars[0][0]) == pytest.approx((6.0 - 2.0) / (11.0 - 1.0), abs=1e-3)
    assert 0.0 < bars[0][0] < bars[1][1] < 100.0
    assert {"+4.0 ", "[3.5, 4.5]", "0.030", "difference to a"} <= set(reader.texts)


def test_curves_follow_the_scene_before_them():
    line = [Line("a", [0.0, 1.0], [0.0, 1.0])]
    sections = [Curves(line), scene_of(), Curves(line), scene_of(), Curves(line), Curves(line, timed=False)]
    assert [each["scene"] for each in Reader(page_of(*sections)).data["curves"]] == [0, 0, 1, None]


def test_size_of_a_large_scene():
    page = page_of(scene_of(scans=1000, count=50, detections=100))
    data = Reader(page).data["scenes"][0]
    assert len(unpack(data["position"])) == 2 * 50 * 1000
    assert len(unpack(data["detections"]["position"])) == 2 * 100 * 1000
    assert len(page) < 15e6


def test_where_it_goes(tmp_path):
    path = tmp_path / "page.html"
    write_report(path, "Zürich", [])
    assert "<title>Zürich</title>" in path.read_text(encoding="utf-8")
    write_report(str(path), "again", [])
    assert [each.name for each in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(tr.TrackrsError, match="create it first"):
        write_report(tmp_path / "no" / "page.html", "x", [])
    assert Picture(SVG, "red").kind == "image/svg+xml"
    (tmp_path / "p.png").write_bytes(PNG)
    assert Picture(tmp_path / "p.png", "nothing").kind == "image/png"


def test_what_is_no_section():
    with pytest.raises(tr.ParameterError, match=r"sections\[1\] is a str"):
        page_of(Prose("words"), "words")


def test_what_does_not_belong_together():
    tracks = tracks_of(course(3, 1), range(3), [1])
    line = tracks_of(course(3, 1)[:, :, [0, 2]], range(3), [1], labels=("x", "vx"))
    scans = [tr.Scan(float(k), [[0.0, 0.0]], "radar") for k in range(3)]
    refused = [
        (lambda: Scene(line), "x vx has no second coordinate"),
        (lambda: Scene(tracks, scans=scans[:2], sensors={"radar": RADAR}), "2 given, not the 3"),
        (lambda: Scene(tracks, scans=scans), "none named 'radar'"),
        (lambda: Scene(tracks, gate=1.0), "gate = 1.0"),
        (lambda: Scene(tracks, region=0.0), "region = 0.0"),
        (lambda: Scene(tracks, labels=("x",)), "labels: 1 given"),
        (lambda: Scene(tracks, own_ship=np.zeros((2, 2))), "own_ship"),
        (lambda: Line("a", [0.0], [1.0, 2.0]), "line 'a'"),
        (lambda: Line("a", [0.0], [1.0], low=[0.0]), "low and high"),
        (lambda: Curves([]), "lines is empty"),
        (lambda: Table(["a"], [[1], [1, 2]]), r"rows\[1\] has 2 values"),
        (lambda: Table(["a"], [], verdict="b"), "verdict = 'b' is no column"),
        (lambda: Picture(b"GIF89a", "x"), "neither PNG nor SVG"),
        (lambda: Picture(PNG, " "), "alt is empty"),
    ]
    for make, message in refused:
        with pytest.raises((tr.ParameterError, tr.DimensionError), match=message):
            make()


def test_importing_it_costs_little():
    code = (
        "import sys, trackrs; assert 'trackrs.report' not in sys.modules; trackrs.report.write_report; "
        "print(sorted({'click', 'polars', 'matplotlib', 'rich', 'trackrs.io'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


# --- the command line ------------------------------------------------------------------------------------------------

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
[tracker]
gate = 0.9
[tracker.initiator]
m = 2
n = 3
max_speed = 20.0
[truth]
columns = ["x", "y"]
[score]
c = 10.0
"""
TRACK = ["track", "d.csv", "--scans", "s.csv", "--config", "c.toml", "--out", "o.csv", "--report", "r.html"]
EVALUATE = ["evaluate", "t.csv", "o.csv", "--scans", "s.csv", "--config", "c.toml", "--report", "e.html"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("c.toml").write_text(CONFIG)
    Path("s.csv").write_text("time,sensor\n" + "".join(f"{k},radar\n" for k in range(12)))
    rows = "".join(f"{k},radar,{5 * k},0\n{k},radar,100,{3 * k}\n" for k in range(8))
    Path("d.csv").write_text(f"time,sensor,x,y\n{rows}3,radar,15,0\n")
    Path("t.csv").write_text("time,target_id,x,y\n0,a,0,0\n11,a,55,0\n0,b,100,0\n11,b,100,33\n")


@pytest.mark.usefixtures("folder")
def test_commands_write_pages(capsys):
    assert main([*TRACK, "--truth", "t.csv"]) == 0
    assert "written  o.csv, r.html" in capsys.readouterr().out
    reader = Reader(Path("r.html").read_text(encoding="utf-8"))
    data = reader.data["scenes"][0]
    assert data["gateProbability"] == 0.9
    assert [target["id"] for target in data["truth"]] == ["a", "b"]
    assert unpack(data["detections"]["offsets"])[-1] == 17
    assert {"received", "duplicate"} <= set(reader.texts)
    assert main(EVALUATE) == 0
    assert "written  e.html" in capsys.readouterr().out
    reader = Reader(Path("e.html").read_text(encoding="utf-8"))
    assert [attrs["class"] for attrs in reader.all("section")] == ["scene", "curves", "curves", "table", "table"]
    assert {"o.csv against t.csv", "GOSPA over time", "a", "b", "switches"} <= set(reader.texts)
    assert main([*EVALUATE, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"] == "e.html"


@pytest.mark.usefixtures("folder")
def test_commands_refuse_before_the_work(capsys, monkeypatch):
    before = sorted(Path().iterdir())
    wrong = {"r.txt": ".html", "no/r.html": "create it", ".": "reports end in"}
    for name, culprit in wrong.items():
        for args in (TRACK, EVALUATE):
            assert main([*args[:-1], name]) == 2
            assert culprit in capsys.readouterr().err
    Path("t.html").write_text("mine")
    assert main(["evaluate", "t.html", *EVALUATE[2:-1], "t.html"]) == 2
    assert "one of the inputs" in capsys.readouterr().err
    Path("t.html").unlink()

    def fail(*_args, **_more):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("trackrs.report.write_report", fail)
    assert main(TRACK) == 2
    assert "r.html" in capsys.readouterr().err
    assert sorted(Path().iterdir()) == before


def test_no_address_stands_in_the_template():
    source = "".join(path.read_text() for path in (Path(tr.report.__file__).parent / "page").iterdir())
    assert set(re.findall(r"https?://[\w./]+", source)) == {"http://www.w3.org/2000/svg"}
