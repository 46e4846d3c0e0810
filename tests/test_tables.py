"""Tables: what is read from them, what is written, and that every fault in them is found where it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import trackrs as tr
from trackrs.config import InputConfig, TruthConfig
from trackrs.io import (
    TableError,
    read_scan_table,
    read_scans,
    read_tracks,
    read_truth,
    replacing,
    write_tracks,
)

COLUMNS = {"radar": ("x", "y"), "lidar": ("x", "y")}
DETECTIONS = "time,sensor,x,y\n0,radar,1,2\n0,radar,3,4\n0.5,lidar,5,\n1,radar,-1e3,7.5\n"
SCANS = "time,sensor,px,py\n0,radar,10,20\n1,radar,11,21\n2,radar,12,22\n0.5,lidar,10.5,20.5\n1,lidar,11,21\n"
PLATFORM = InputConfig(platform=("px", "py"))


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes a file into the working folder, so that messages hold its bare name."""
    monkeypatch.chdir(tmp_path)

    def write(name, text):
        if isinstance(text, str):
            text = text.encode()
        (tmp_path / name).write_bytes(text)
        return name

    return write


def as_parquet(name, text, **types):
    frame = pl.read_csv(text.encode()).cast(types)
    frame.write_parquet(name)
    return name


def plain(recording):
    return [
        (scan.time, scan.sensor, scan.values.tolist(), None if scan.platform is None else scan.platform.tolist())
        for scan in recording.scans
    ]


def fault(call, *args):
    with pytest.raises(TableError) as error:
        call(*args)
    assert "\n" not in str(error.value)
    return str(error.value)


# --- what is read ----------------------------------------------------------------------------------------------------


def test_scans_with_their_platform(write):
    recording = read_scans(write("d.csv", DETECTIONS), write("s.csv", SCANS), COLUMNS, PLATFORM)
    assert str(plain(recording)) == str(
        [
            (0.0, "radar", [[1.0, 2.0], [3.0, 4.0]], [10.0, 20.0]),
            (0.5, "lidar", [[5.0, np.nan]], [10.5, 20.5]),
            (1.0, "radar", [[-1000.0, 7.5]], [11.0, 21.0]),
            (1.0, "lidar", [], [11.0, 21.0]),
            (2.0, "radar", [], [12.0, 22.0]),
        ],
    )
    assert recording.rows == 4
    assert recording.platforms.tolist() == [[10, 20], [10.5, 20.5], [11, 21], [11, 21], [12, 22]]
    table = read_scan_table("s.csv", COLUMNS, PLATFORM)
    assert table.times.tolist() == [scan.time for scan in recording.scans]
    assert table.sensors == tuple(scan.sensor for scan in recording.scans)
    assert np.array_equal(table.platforms, recording.platforms)


def test_scans_without_a_table_of_scans(write):
    recording = read_scans(write("d.csv", DETECTIONS), None, COLUMNS)
    assert [(scan.time, scan.sensor, len(scan)) for scan in recording.scans] == [
        (0.0, "radar", 2),
        (0.5, "lidar", 1),
        (1.0, "radar", 1),
    ]
    assert recording.platforms is None


def test_parquet_gives_the_same(write):
    expected = plain(read_scans(write("d.csv", DETECTIONS), write("s.csv", SCANS), COLUMNS, PLATFORM))
    found = plain(read_scans(as_parquet("d.parquet", DETECTIONS), as_parquet("s.parquet", SCANS), COLUMNS, PLATFORM))
    assert str(found) == str(expected)


def test_scans_joined_by_id(write):
    layout = InputConfig(scan="id")
    detections = write("d.csv", "id,time,sensor,x,y\nB,1,radar,3,4\nA,0,radar,1,2\n")
    scans = write("s.csv", "id,time,sensor\nA,0,radar\nB,1,radar\nC,2,radar\n")
    recording = read_scans(detections, scans, COLUMNS, layout)
    assert [scan.values.tolist() for scan in recording.scans] == [[[1.0, 2.0]], [[3.0, 4.0]], []]
    write("d.csv", "id,time,sensor,x,y\nB,1,radar,3,4\nX,0,radar,1,2\n")
    assert fault(read_scans, detections, scans, COLUMNS, layout).startswith(
        'd.csv, line 3, column "id": there is no scan X'
    )
    write("d.csv", "id,time,sensor,x,y\nB,1.5,radar,3,4\n")
    assert 'd.csv, line 2, column "time": 1.5 s, but scan B is at 1.0 s' in fault(
        read_scans, detections, scans, COLUMNS, layout
    )
    write("d.csv", "id,time,sensor,x,y\nB,1,lidar,3,4\n")
    assert 'd.csv, line 2, column "sensor": scan B is of radar, not of lidar' in fault(
        read_scans, detections, scans, COLUMNS, layout
    )
    write("s.csv", "id,time,sensor\nA,0,radar\nA,1,radar\n")
    assert 's.csv, line 3, column "id": scan A stands twice' in fault(read_scans, detections, scans, COLUMNS, layout)


def test_ignored_sensors(write):
    text = "time,sensor,x,y\n0,camera,abc,\n0,radar,1,2\n"
    layout = InputConfig(ignore_sensors=("camera",))
    recording = read_scans(write("d.csv", text), write("s.csv", "time,sensor\n,camera\n0,radar\n"), COLUMNS, layout)
    assert plain(recording) == [(0.0, "radar", [[1.0, 2.0]], None)]
    assert recording.ignored == {"camera": 1}


def test_forms_of_csv(write):
    """A byte order mark, line ends of Windows, quotes, spaces, blank lines, and a header alone."""
    text = '\ufeff\r\ntime , sensor,"x",y\r\n\r\n0,"radar", 1 ,+2e0\r\n,,,\r\n'
    recording = read_scans(write("d.csv", text), None, COLUMNS)
    assert plain(recording) == [(0.0, "radar", [[1.0, 2.0]], None)]
    recording = read_scans(write("d.csv", "time,sensor,x,y\n"), write("s.csv", "time,sensor\n0,radar\n"), COLUMNS)
    assert plain(recording) == [(0.0, "radar", [], None)]


def test_sort_on_request(write):
    layout = InputConfig(unsorted="sort")
    scans = write("s.csv", "time,sensor\n2,radar\n0,radar\n1,radar\n")
    recording = read_scans(write("d.csv", "time,sensor,x,y\n1,radar,1,2\n0,radar,3,4\n"), scans, COLUMNS, layout)
    assert [(scan.time, len(scan)) for scan in recording.scans] == [(0.0, 1), (1.0, 1), (2.0, 0)]
    assert [scan.time for scan in read_scans("d.csv", None, COLUMNS, layout).scans] == [0.0, 1.0]


# --- faults ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("detections", "expected"),
    [
        ("", "d.csv: the file is empty"),
        ("\n\n", "d.csv: the file is empty"),
        ("time,sensor,x\n0,radar,1\n", 'd.csv: no column "y" (there are: time, sensor, x)'),
        ("time,sensor,x,Y\n0,radar,1,2\n", 'd.csv: no column "y"'),
        ("time,sensr,x,y\n0,radar,1,2\n", 'd.csv: no column "sensor"; did you mean "sensr"? (there are: '),
        ("time,sensor,x,y,y\n0,radar,1,2,3\n", 'd.csv: column "y" stands twice'),
        ("time;sensor;x;y\n0;radar;1;2\n", 'd.csv: no column "sensor" (there are: time;sensor;x;y)'),
        ("time,sensor,x,y\n0,radar,1,2\n1,radar,abc,2\n", 'd.csv, line 3, column "x": "abc" is no number'),
        ("\ntime,sensor,x,y\n\n0,radar,1,2\n\n1,radar,1,2m\n", 'd.csv, line 6, column "y": "2m" is no number'),
        (
            'time,sensor,x,y,note\n0,radar,1,2,"a\nb"\n1,radar,1,"1,5",\n',
            'd.csv, line 4, column "y": "1,5" is no number',
        ),
        ("time,sensor,x,y\r\n0,radar,1,2\r\n1,radar,1,x\r\n", 'd.csv, line 3, column "y": "x" is no number'),
        ("time,sensor,x,y\n0,radar,inf,2\n", 'd.csv, line 2, column "x": inf is not finite'),
        ("time,sensor,x,y\n0,radar,1e999,2\n", 'd.csv, line 2, column "x": 1e999 is not finite'),
        ("time,sensor,x,y\n0,radar,1,2\n,radar,1,2\n", 'd.csv, line 3, column "time": has no number'),
        ("time,sensor,x,y\n0,radar,1,2\nnan,radar,1,2\n", 'd.csv, line 3, column "time": has no number'),
        (
            "time,sensor,x,y\n0,radar,1,2\n2020-01-01,radar,1,2\n",
            'd.csv, line 3, column "time": "2020-01-01" is no number',
        ),
        ("time,sensor,x,y\n0,radar,1,2\n0,,1,2\n", 'd.csv, line 3, column "sensor": is empty'),
        ("time,sensor,x,y\n0,radar,1,2\n0,sonar,1,2\n", 'd.csv, line 3, column "sensor": unknown sensor "sonar"'),
        ("time,sensor,x,y\n0,radar,1,2\n0,radar,1\n", "d.csv, line 3: has 3 cells, the header 4"),
        ("time,sensor,x,y\n0,radar,1,2\n0,radar,1,2,3\n", "d.csv, line 3: has 5 cells, the header 4"),
        ('time,sensor,x,y\n0,radar,1,2\n0,"radar,1,2\n', "d.csv, line 3: unexpected end of data"),
        (b"time,sensor,x,y\n0,radar,1,2\n0,r\xe4dar,1,2\n", "d.csv, line 3: is not UTF-8 text"),
        (
            "time,sensor,x,y\n0,radar,1,2\n5,radar,1,2\n",
            'd.csv, line 3, column "time": radar has no scan at 5.0 s in s.csv',
        ),
    ],
)
def test_fault_in_detections(write, detections, expected):
    write("s.csv", SCANS)
    assert expected in fault(read_scans, write("d.csv", detections), "s.csv", COLUMNS)


@pytest.mark.parametrize(
    ("scans", "expected"),
    [
        ("", "s.csv: the file is empty"),
        ("time,sensor,px,py\n", "s.csv: has no scans"),
        ("time,sensor,px\n0,radar,1\n", 's.csv: no column "py"'),
        (
            "time,sensor,px,py\n0,radar,1,2\n2,radar,1,2\n0.5,lidar,1,2\n1,radar,1,2\n",
            's.csv, line 5, column "time": radar goes back from 2.0 s (line 3) to 1.0 s; sort the table',
        ),
        (
            "time,sensor,px,py\n0,radar,1,2\n0,lidar,1,2\n\n0,radar,1,2\n",
            's.csv, line 5, column "time": radar already has a scan at 0.0 s (line 2)',
        ),
        ("time,sensor,px,py\n0,radar,1,\n", 's.csv, line 2, column "py": has no number'),
        ("time,sensor,px,py\n0,radar,1,-inf\n", 's.csv, line 2, column "py": -inf is not finite'),
        ("time,sensor,px,py\n0,sonar,1,2\n", 's.csv, line 2, column "sensor": unknown sensor "sonar"'),
        ("time,sensor,px,py\nx,radar,1,2\n", 's.csv, line 2, column "time": "x" is no number'),
    ],
)
def test_fault_in_scans(write, scans, expected):
    write("d.csv", DETECTIONS)
    assert expected in fault(read_scans, "d.csv", write("s.csv", scans), COLUMNS, PLATFORM)
    assert expected in fault(read_scan_table, "s.csv", COLUMNS, PLATFORM)


def test_repeated_times_stay_wrong_when_sorted(write):
    write("s.csv", "time,sensor\n1,radar\n0,radar\n1,radar\n")
    assert 's.csv, line 4, column "time": radar already has a scan at 1.0 s (line 2)' in fault(
        read_scan_table, "s.csv", COLUMNS, InputConfig(unsorted="sort")
    )


def test_fault_without_a_table_of_scans(write):
    write("d.csv", "time,sensor,x,y\n1,radar,1,2\n1,radar,3,4\n0,radar,1,2\n")
    assert 'd.csv, line 4, column "time": radar goes back from 1.0 s (line 3) to 0.0 s' in fault(
        read_scans, "d.csv", None, COLUMNS
    )
    assert "pass it with --scans" in fault(read_scans, "d.csv", None, COLUMNS, PLATFORM)
    write("d.csv", "time,sensor,x,y\n")
    assert "d.csv: has no detections" in fault(read_scans, "d.csv", None, COLUMNS)


def test_fault_of_the_file(write, tmp_path):
    write("detections.csv", DETECTIONS)
    assert (
        fault(read_scans, "detectons.csv", None, COLUMNS) == "detectons.csv: no such file; did you mean detections.csv?"
    )
    assert fault(read_scans, "nowhere/d.csv", None, COLUMNS) == "nowhere/d.csv: no such file; check the name"
    assert "is a folder" in fault(read_scans, tmp_path, None, COLUMNS)
    assert "tables end in .csv or .parquet" in fault(read_scans, write("d.txt", DETECTIONS), None, COLUMNS)
    assert "d.parquet: is no Parquet table" in fault(read_scans, write("d.parquet", DETECTIONS), None, COLUMNS)
    assert "e.parquet: the file is empty" in fault(read_scans, write("e.parquet", ""), None, COLUMNS)


def test_fault_in_parquet(write):
    write("any", "")
    as_parquet("d.parquet", "time,sensor,x,y\n0,radar,1,2\n1,radar,2,3\n", y=pl.String)
    pl.read_parquet("d.parquet").with_columns(y=pl.Series(["1", "abc"])).write_parquet("d.parquet")
    assert 'd.parquet, row 2, column "y": "abc" is no number' in fault(read_scans, "d.parquet", None, COLUMNS)
    pl.read_parquet("d.parquet").with_columns(y=pl.Series([True, False])).write_parquet("d.parquet")
    assert 'd.parquet: column "y" holds Boolean' in fault(read_scans, "d.parquet", None, COLUMNS)
    pl.read_parquet("d.parquet").with_columns(y=pl.Series([None, float("inf")])).write_parquet("d.parquet")
    assert 'd.parquet, row 2, column "y": inf is not finite' in fault(read_scans, "d.parquet", None, COLUMNS)


# --- truth -----------------------------------------------------------------------------------------------------------

TRUTH = TruthConfig(columns=("x", "y"))


def test_truth_is_sorted_and_repeats_are_dropped(write):
    text = "time,target_id,x,y\n1,b,3,4\n0,a,1,2\n0,b,1,2\n1,b,3,4\n0.5,a,5,6\n"
    b, a = read_truth(write("t.csv", text), TRUTH)
    assert (a.id, a.times.tolist(), a.positions.tolist()) == ("a", [0, 0.5], [[1, 2], [5, 6]])
    assert (b.id, b.times.tolist(), b.positions.tolist()) == ("b", [0, 1], [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("time,target_id,x,y\n", "t.csv: has no rows"),
        ("time,target_id,x\n0,a,1\n", 't.csv: no column "y"'),
        ("time,target_id,x,y\n0,a,1,\n", 't.csv, line 2, column "y": has no number'),
        ("time,target_id,x,y\n0,,1,2\n", 't.csv, line 2, column "target_id": is empty'),
        (
            "time,target_id,x,y\n0,a,1,2\n1,a,1,2\n0,a,1,3\n",
            't.csv, line 4, column "x": target a is elsewhere at 0.0 s (line 2)',
        ),
    ],
)
def test_fault_in_truth(write, text, expected):
    assert expected in fault(read_truth, write("t.csv", text), TRUTH)


# --- tracks ----------------------------------------------------------------------------------------------------------


def run(scans):
    tracker = tr.MultiTargetTracker(
        tr.ConstantVelocity(dims=2, accel_psd=0.1),
        sensors={"radar": tr.PositionSensor(dims=2, std=1.0), "lidar": tr.PositionSensor(dims=2, std=0.5)},
        initiator=tr.MofN(2, 3, max_speed=20.0),
        deletion=tr.Deletion(max_misses=2),
    )
    return tracker.run(scans)


def scene():
    rng = np.random.default_rng(5)
    scans = []
    for k in range(30):
        for sensor in ("radar", "lidar"):
            boats = np.array([[5.0 * k, 0.0], [100.0, 3.0 * k]]) + rng.normal(0.0, 0.7, (2, 2))
            scans.append(tr.Scan(0.1 * k, boats if k < 12 or k > 18 else [], sensor))
    return scans


def assert_equal(a, b):
    assert a.sensors == b.sensors
    assert a.labels == b.labels
    for name in ("scan_times", "times", "ids", "means", "covs", "last_hits", "hits", "offsets"):
        left, right = getattr(a, name), getattr(b, name)
        assert left.dtype == right.dtype, name
        assert left.shape == right.shape, name
        assert left.tobytes() == right.tobytes(), name


def scan_table(scans):
    rows = "".join(f"{scan.time!r},{scan.sensor}\n" for scan in scans)
    Path("scans.csv").write_text(f"time,sensor\n{rows}")
    return read_scan_table("scans.csv", COLUMNS)


@pytest.mark.parametrize("name", ["tracks.csv", "tracks.parquet"])
def test_tracks_come_back_bit_for_bit(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tracks = run(scene())
    assert 0 < len(np.unique(tracks.times)) < 30  # some scans have no track
    write_tracks(tracks, name)
    back = read_tracks(name, scan_table(scene()))
    assert_equal(back, tracks)
    assert not back.means.flags.writeable
    alone = read_tracks(name)
    assert len(alone.scan_times) < len(tracks.scan_times)
    assert np.array_equal(alone.means, tracks.means)


@pytest.mark.parametrize("name", ["tracks.csv", "tracks.parquet"])
def test_no_tracks(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scans = [tr.Scan(float(k), [], "radar") for k in range(3)]
    tracks = run(scans)
    write_tracks(tracks, name)
    assert_equal(read_tracks(name, scan_table(scans)), tracks)
    assert "only the table of scans knows" in fault(read_tracks, name)


def test_fault_in_tracks(write):
    write_tracks(run(scene()), "tracks.csv")
    head, first, *rest = Path("tracks.csv").read_text().splitlines()
    table = scan_table(scene())
    write("t.csv", "\n".join([head, first, *rest, first]))
    assert f't.csv, line {len(rest) + 3}, column "track": track 1 stands twice' in fault(read_tracks, "t.csv", table)
    write("t.csv", "\n".join([head, first.replace(first.split(",")[0], "77.0", 1)]))
    assert 't.csv, line 2, column "time": radar has no scan at 77.0 s' in fault(read_tracks, "t.csv", table)
    write("t.csv", "\n".join([head, first.replace("radar,1,", "radar,1.5,", 1)]))
    assert 't.csv, line 2, column "track": "1.5" is no whole number' in fault(read_tracks, "t.csv", table)
    assert "t.csv: is no table of tracks" in fault(read_tracks, write("t.csv", DETECTIONS))
    write("t.csv", head.replace("cov_vy_vx", "cov"))
    assert 't.csv: no column "cov_vy_vx"' in fault(read_tracks, "t.csv", table)


def test_written_whole_or_not_at_all(tmp_path):
    tracks = run(scene())
    assert "tables end in" in fault(write_tracks, tracks, tmp_path / "tracks.txt")
    assert "there is no folder" in fault(write_tracks, tracks, tmp_path / "no" / "tracks.csv")
    (tmp_path / "folder.csv").mkdir()
    assert "is a folder" in fault(write_tracks, tracks, tmp_path / "folder.csv")
    (tmp_path / "folder.csv").rmdir()
    file = tmp_path / "tracks.csv"
    file.write_text("before")

    def interrupted():
        with replacing(file) as part:
            part.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert file.read_text() == "before"
    assert [path.name for path in tmp_path.iterdir()] == ["tracks.csv"]
    write_tracks(tracks, file)
    assert file.read_text().startswith("time,sensor,track,x,y,vx,vy,last_hit,hits,health,cov_x_x")
    assert [path.name for path in tmp_path.iterdir()] == ["tracks.csv"]


def test_without_polars(monkeypatch, write):
    import sys

    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(ImportError, match=r'pip install "trackrs\[cli\]"'):
        read_scans(write("d.csv", DETECTIONS), None, COLUMNS)
