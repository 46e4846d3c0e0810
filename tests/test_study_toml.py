"""`trackrs study`: the file becomes the study that the same lines of Python make, and its mistakes are one line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from numpy.testing import assert_allclose

import trackrs as tr
from studies import phd
from trackrs.cli import main
from trackrs.config import ConfigError
from trackrs.scenarios import Ellipse
from trackrs.study._toml import METRICS, SCENARIOS, load_study

ROOT = Path(__file__).resolve().parent.parent
CLOSE, PARALLEL = re.findall(r"```toml\n(.*?)```", (ROOT / "docs/studies.md").read_text(), re.DOTALL)


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "study.toml"
        path.write_text(text)
        return path

    return write


def trackers():
    scene = tr.scenarios.close_targets(separation=150.0)
    common = {
        "motion": tr.ConstantVelocity(dims=2, accel_std=2.0),
        "sensors": {"radar": scene.radar},
        "initiator": tr.MofN(3, 5, max_speed=150.0),
        "deletion": tr.Deletion(max_misses=100),
        "initial": scene.initial,
    }
    methods = {
        "npda": tr.MultiTargetTracker(**common, associator=tr.NPDA(clutter_probability=0.0), gate=tr.Gate(1.0)),
        "nearest": tr.MultiTargetTracker(**common, associator=tr.NearestNeighbour()),
    }
    return tr.Study(scene, methods, [tr.OSPA(c=60.0), tr.study.Identity(75.0)])


def test_the_first_example_of_the_page(file):
    given = load_study(file(CLOSE))
    assert (given.runs, given.seed) == (200, 7)
    assert given.study.run(5, 7).to_bytes() == trackers().run(5, 7).to_bytes()
    assert given.study.digest() == trackers().digest()


def test_the_second_example_of_the_page(file):
    given = load_study(file(PARALLEL))
    assert (given.runs, given.seed) == (50, 0)
    scene = tr.scenarios.parallel(80.0, Ellipse(80.0, 30.0))
    clutter_filter = tr.LocalOutlierFactor(n_neighbors=4, threshold=2.0)
    other = phd(scene, partition=tr.TwoLevelPartition(), clutter_filter=clutter_filter)
    mine = tr.Study(scene, {"default": phd(scene), "density_peaks": other}, [tr.OSPA(c=60.0), tr.study.Cardinality()])
    assert given.study.run(1, 7).to_bytes() == mine.run(1, 7).to_bytes()


ANGLE = """
[scenario]
type = "moving_head"
samples = 100
swings = [[30.0, 0.5]]
[common]
type = "unscented_kalman_filter"
motion = {type = "constant_acceleration", dims = 1, jerk_psd = 10.0}
[methods.default]
[methods.adaptive]
adapt = {type = "residual_noise", r_limits = [1e-6, 1.0]}
screen = {alpha = 0.001}
[methods.printed]
type = "unscented_kalman_filter_as_printed"
r_limits = [1e-12, 1e4]
[methods.square_root]
type = "kalman_filter"
form = "square_root"
sensor = {type = "position", dims = 1, std = 0.1}
[[metrics]]
type = "lead_error"
lead = 0.1
first = 20
"""


def test_filters_of_one_target(file):
    given = load_study(file(ANGLE)).study
    scene = tr.scenarios.moving_head([(30.0, 0.5)], samples=100)
    models = (tr.ConstantAcceleration(dims=1, jerk_psd=10.0), tr.PositionSensor(dims=1, std=scene.std))
    known = (models[0], tr.PositionSensor(dims=1, std=0.1))
    methods = {
        "default": tr.UnscentedKalmanFilter(*models),
        "adaptive": tr.UnscentedKalmanFilter(
            *models, tr.ResidualNoise(r_limits=(1e-6, 1.0)), tr.ChiSquareScreen(alpha=0.001)
        ),
        "printed": tr.UnscentedKalmanFilter.as_printed(*models, r_limits=(1e-12, 1e4)),
        "square_root": tr.KalmanFilter(*known, form="square_root"),
    }
    mine = tr.Study(scene, methods, [tr.study.LeadError(0.1, first=20)])
    assert given.run(3, 7).to_bytes() == mine.run(3, 7).to_bytes()


@pytest.mark.parametrize("kind", SCENARIOS)
def test_every_scenario_can_be_named(file, kind):
    more = 'targets = [{start = [0, 0, 10, 0], shape = {type = "blob"}}]' if kind == "extended_targets" else ""
    if kind == "close_targets":
        more = "[common]\nmotion = {type = 'constant_velocity', dims = 2, accel_std = 1.0}"
    scans = kind in {"close_targets", "crossing", "extended_targets", "parallel"}
    method = 'type = "multi_target"\ninitiator = {m = 2, n = 3, max_speed = 50.0}\ninitial = "none"'
    if not scans:
        dims = 3 if kind == "underwater" else 1
        model = f'motion = {{type = "constant_acceleration", dims = {dims}, jerk_std = 0.1}}'
        method = f'type = "extended_kalman_filter"\n{model}'
    metric = 'type = "cardinality"' if scans else 'type = "position_error"'
    text = f'[scenario]\ntype = "{kind}"\n{more}\n[methods.a]\n{method}\n[[metrics]]\n{metric}'
    result = load_study(file(text)).study.run(1)
    assert np.isfinite(result["a"].per_run("tracks" if scans else "error")).all()


def test_every_metric_can_be_named():
    assert set(METRICS) == {"ospa", "gospa", "cardinality", "identity", "position_error", "lead_error"}


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("[scenario]", "[scene]", 'unknown table "scene"; did you mean "scenario"?'),
        ('type = "close_targets"', "", '[scenario]: "type" is missing'),
        ('"close_targets"', '"close_target"', 'did you mean "close_targets"?'),
        ("separation = 150.0\n", "seperation = 150.0\n", 'unknown key "seperation"; did you mean "separation"?'),
        ("separation = 150.0\n", "separation = -1.0\n", "[scenario] separation = -1"),
        ("separation = 150.0\n", 'separation = "wide"\n', "must be a number"),
        ("[methods.npda]\n", "[methods.npda]\nspeed = 3\n", '[methods.npda]: unknown key "speed"'),
        ('type = "multi_target"\n', "", '[methods.npda]: "type" is missing'),
        ('"multi_target"', '"kalman_filter"', "[methods.npda] type"),
        ("accel_std = 2.0", "accel_std = -2.0", "[methods.npda.motion]"),
        ("motion = {", "emotion = {", '"motion" is missing, and the scenario knows none'),
        ("gate = 1.0", "gate = 2.0", "[methods.npda] gate = 2"),
        ("clutter_probability = 0.0", "clutter_probability = 7", "[methods.npda.associator]"),
        ("gate = 1.0", 'initial = "all"', '[methods.npda] initial = "all" is invalid: must be "none"'),
        ("gate = 1.0", 'initial = "none"', "method = npda is invalid: must begin with all 3 targets"),
        ('type = "ospa"', 'type = "ospax"', '[[metrics]] type = "ospax" is unknown; did you mean "ospa"?'),
        ("c = 60.0", "c = -60.0", "= -60 is invalid"),
        ('type = "identity"\nseparation = 75.0', 'type = "position_error"', "several targets"),
        ("runs = 200", "runs = -200", "[study] runs = -200"),
        ("[study]", "[[metrics]]\ntype = 'ospa'\nc = 1.0\n[study]", "same column twice"),
    ],
)
def test_mistakes_are_one_line(file, capsys, old, new, text):
    assert old in CLOSE
    path = file(CLOSE.replace(old, new))
    with pytest.raises(ConfigError):
        load_study(path)
    assert main(["study", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"trackrs: error: {path}")
    assert text in lines[0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "no table [scenario]"),
        ('[scenario]\ntype = "turntable"', "no table [methods]"),
        ('methods = {}\n[scenario]\ntype = "turntable"', "names no method"),
        ('methods = {a = 3}\n[scenario]\ntype = "turntable"', '"methods.a" must be a table'),
        (CLOSE.split("[[metrics]]")[0], "no [[metrics]]"),
        ("[scenario", "not valid TOML"),
    ],
)
def test_what_is_missing_is_named(file, text, expected):
    with pytest.raises(ConfigError, match=re.escape(expected)):
        load_study(file(text))


def test_the_command_prints_and_writes(file, tmp_path, capsys):
    path, out, folder = file(CLOSE), tmp_path / "runs.parquet", tmp_path / "kept"
    command = ["study", str(path), "--runs", "4", "--workers", "1", "--folder", str(folder)]
    assert main([*command, "--out", str(out)]) == 0
    expected = trackers().run(4, 7)
    lines = capsys.readouterr().out.splitlines()
    cut = [re.sub(r"\s+\S+$", "", line) for line in lines[:3]]
    assert cut == [re.sub(r"\s+\S+$", "", line) for line in expected.table().splitlines()[:3]]
    assert lines[3].startswith("4 runs, seed 7;")
    frame = pl.read_parquet(out).filter((pl.col("method") == "npda") & (pl.col("column") == "ospa"))
    assert_allclose(frame["value"].to_numpy(), expected["npda"].per_run("ospa"), rtol=1e-15)
    assert main([*command[:2], "--runs", "4", "--folder", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["methods"]["npda"]["ospa"]["mean"] == expected["npda"].summary("ospa").mean
    gap = expected.compare("nearest", "npda", "right")
    assert found["differences"]["nearest"]["right"]["p_value"] == gap.p_value
    assert (found["runs"], found["seed"], found["baseline"]) == (4, 7, "npda")


@pytest.mark.parametrize(
    "more",
    [["--runs", "-1"], ["--seed", "x"], ["--workers", "0"], ["--out", "runs.txt"], ["--out", "no/such/dir/r.csv"]],
)
def test_mistakes_in_the_command_are_one_line(file, capsys, more):
    assert main(["study", str(file(CLOSE)), *more]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_folder_of_another_study_is_one_line(file, tmp_path, capsys):
    folder = tmp_path / "kept"
    path = file(CLOSE)
    assert main(["study", str(path), "--runs", "1", "--folder", str(folder)]) == 0
    assert main(["study", str(path), "--runs", "1", "--seed", "8", "--folder", str(folder)]) == 2
    assert "a study with seed 7" in capsys.readouterr().err
    assert main(["study", str(path), "--runs", "1", "--folder", str(path)]) == 2


def test_no_file(capsys):
    assert main(["study", "nothing.toml"]) == 2
    assert "nothing.toml: no such file" in capsys.readouterr().err
