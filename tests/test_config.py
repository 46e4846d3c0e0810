"""The TOML file: what it becomes, and that every mistake in it is one line with file, table and key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import trackrs as tr
from trackrs import _kinds as kinds
from trackrs import _loader
from trackrs import config as module
from trackrs.config import ConfigError, load_config

ROOT = Path(__file__).resolve().parent.parent

GOOD = """
[motion]
type = "constant_velocity"
dims = 2
accel_psd = [0.3, 0.2]

[sensors.radar]
type = "position"
dims = 2
std = 6.0
columns = ["x", "y"]

[sensors.sonar]
type = "range_bearing"
position = [0, 0]
range_std = 5.0
bearing_std = 0.01
columns = ["range", "bearing"]

[tracker]
gate = 0.95
associator = "nearest_neighbour"
max_gap = 30.0
max_tracks = 50
strict = true
initiator = {m = 2, n = 3, max_speed = 12, min_displacement = 10.0}

[tracker.deletion]
max_misses = 4

[tracker.clutter_map]
radius = 10.0
dwell = 15.0

[input]
time = "t"
scan = "scan"
platform = ["own_x", "own_y"]
ignore_sensors = ["camera"]
unsorted = "sort"

[truth]
columns = ["x", "y"]

[score]
c = 30.0
sensor = "radar"
region = 250.0

[plot]
labels = ["north (m)", "east (m)"]
swap_axes = true
"""


@pytest.fixture
def load(tmp_path):
    def load(text):
        file = tmp_path / "conf.toml"
        file.write_text(text)
        return load_config(file)

    return load


def message(load, text):
    with pytest.raises(ConfigError) as error:
        load(text)
    text = str(error.value)
    assert "\n" not in text
    assert "conf.toml" in text
    return text[text.index("conf.toml") :]


def test_everything_is_read(load):
    config = load(GOOD)
    assert config.motion == tr.ConstantVelocity(dims=2, accel_psd=[0.3, 0.2])
    assert config.sensors["radar"] == tr.PositionSensor(dims=2, std=6.0)
    assert config.sensors["sonar"] == tr.RangeBearing(position=[0, 0], range_std=5.0, bearing_std=0.01)
    assert config.columns == {"radar": ("x", "y"), "sonar": ("range", "bearing")}
    assert config.tracker == {
        "initiator": tr.MofN(2, 3, max_speed=12.0, min_displacement=10.0),
        "associator": tr.NearestNeighbour(),
        "gate": tr.Gate(0.95),
        "deletion": tr.Deletion(max_misses=4),
        "clutter_map": tr.ClutterMap(radius=10.0, dwell=15.0),
        "max_gap": 30.0,
        "max_tracks": 50,
        "strict": True,
    }
    assert config.input.time == "t"
    assert config.input.sensor == "sensor"
    assert config.input.platform == ("own_x", "own_y")
    assert config.input.ignore_sensors == ("camera",)
    assert config.truth.target == "target_id"
    assert config.score.make_metric() == tr.GOSPA(c=30.0, p=2.0, alpha=2.0)
    assert config.plot.swap_axes
    assert isinstance(config.make_tracker(), tr.MultiTargetTracker)


def test_associators_and_initiators_have_kinds(load):
    text = GOOD.replace('associator = "nearest_neighbour"', 'associator = {type = "npda", clutter_probability = 0.1}')
    assert load(text).tracker["associator"] == tr.NPDA(clutter_probability=0.1)
    text = GOOD.replace(
        'associator = "nearest_neighbour"', 'associator = "jipda"\nclutter_density = {radar = 1e-4, sonar = 1}'
    )
    text = text.replace(
        "{m = 2, n = 3, max_speed = 12, min_displacement = 10.0}", '{type = "existence", max_speed = 12}'
    )
    text = text.replace("[tracker.deletion]\nmax_misses = 4\n", "")
    config = load(text)
    assert config.tracker["associator"] == tr.JIPDA()
    assert config.tracker["initiator"] == tr.Existence(max_speed=12.0)
    assert config.tracker["clutter_density"] == {"radar": 1e-4, "sonar": 1}
    assert isinstance(config.make_tracker(), tr.MultiTargetTracker)
    assert "initial = " in message(load, text.replace("max_speed = 12}", "max_speed = 12, initial = 2}"))
    assert "[tracker.initiator]: unknown key" in message(load, text.replace("max_speed = 12}", "max_sped = 12}"))
    assert "[tracker] clutter_density" in message(load, text.replace("{radar = 1e-4, sonar = 1}", '"some"'))
    assert 'clutter_density of "radar"' in message(load, text.replace("radar = 1e-4, ", ""))


def test_none_where_it_is_not_the_default(load):
    npda = 'associator = {type = "npda", clutter_probability = "none"}\nclutter_density = 1e-3'
    text = GOOD.replace('associator = "nearest_neighbour"', npda)
    config = load(text)
    assert config.tracker["associator"] == tr.NPDA(clutter_probability=None)
    assert isinstance(config.make_tracker(), tr.MultiTargetTracker)
    assert 'clutter_density of "radar"' in message(load, text.replace("\nclutter_density = 1e-3", ""))
    assert 'must be a number, or "none"' in message(load, text.replace('"none"', '"density"'))
    # Where None is the default, a key is left out.
    assert message(load, GOOD.replace("max_gap = 30.0", 'max_gap = "none"')).endswith("must be a number")


def test_pairs_of_reports_begin_tracks(load):
    text = GOOD.replace("min_displacement = 10.0}", "min_displacement = 10.0, pair_within = 30}")
    config = load(text)
    assert config.tracker["initiator"] == tr.MofN(2, 3, max_speed=12.0, min_displacement=10.0, pair_within=30.0)
    assert isinstance(config.make_tracker(), tr.MultiTargetTracker)
    assert "[tracker.initiator] pair_within = -1 is invalid" in message(load, text.replace("= 30}", "= -1}"))
    still = text.replace('"constant_velocity"', '"random_walk"').replace("accel_psd", "velocity_psd")
    assert "[tracker.initiator] pair_within = 30 is invalid: must not be given" in message(load, still)


def test_only_models_and_tracker_are_needed(load):
    text = GOOD[: GOOD.index("[tracker]")] + "[tracker.initiator]\nm = 1\nn = 1\nmax_speed = 1"
    config = load(text)
    assert config.truth is None
    assert config.score is None
    assert config.input == module.InputConfig()
    assert config.tracker == {"initiator": tr.MofN(1, 1, 1.0)}


def test_the_example_is_valid():
    config = load_config(ROOT / "examples" / "harbour.toml")
    assert set(config.sensors) == {"radar", "lidar"}
    assert (config.score.c, config.score.p, config.score.alpha) == (30.0, 2.0, 2.0)
    assert (config.score.sensor, config.score.start, config.score.region) == ("radar", 15.0, 250.0)


LINEAR = """[sensors.speed]
type = "linear"
H = [[0, 0, 1, 0], [0, 0, 0, 1]]
R = [[1, 0], [0, 1]]
columns = ["vx", "vy"]

[tracker]
"""


def test_linear_sensor(load):
    text = GOOD.replace("[tracker]\n", LINEAR)
    assert "[input] platform does not fit [sensors.speed]" in message(load, text)
    text = text.replace('platform = ["own_x", "own_y"]', "").replace("region = 250.0", "")
    assert load(text).sensors["speed"].observe([0.0, 0.0, 3.0, 4.0]).tolist() == [3.0, 4.0]
    wrong = text.replace("H = [[0, 0, 1, 0], [0, 0, 0, 1]]", "H = [[1, 0], [0, 1]]")
    assert "[sensors.speed] state of the motion model has size 4, expected 2" in message(load, wrong)
    wrong = text.replace("R = [[1, 0], [0, 1]]", "R = [[-1, 0], [0, 1]]")
    assert "[sensors.speed] R = " in message(load, wrong)


def test_ospa(load):
    text = GOOD.replace("c = 30.0", 'c = 30.0\nmetric = "ospa"')
    assert load(text).score.make_metric() == tr.OSPA(c=30.0, p=2.0)
    assert "[score] alpha" in message(load, text.replace("c = 30.0", "c = 30.0\nalpha = 2.0"))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("std = 6.0", "std = -6.0", "[sensors.radar] std = -6 is invalid: must be finite and positive"),
        ("std = 6.0", "std = nan", "[sensors.radar] std = NaN is invalid"),
        ("range_std = 5.0", "range_std = -5.0", "[sensors.sonar] range_std = -5 is invalid"),
        ("std = 6.0", "std = [1, 2, 3]", "[sensors.radar] std must be a number or 2 numbers"),
        ("std = 6.0", 'std = "six"', '[sensors.radar] std = "six" is invalid: must be a number or a list of numbers'),
        ("std = 6.0", "std = true", "[sensors.radar] std = true is invalid: must be a number"),
        ("std = 6.0", "", '[sensors.radar]: "std" is missing'),
        (
            "std = 6.0",
            "stdd = 6.0",
            '[sensors.radar]: unknown key "stdd"; did you mean "std"? (there are: type, columns,',
        ),
        ('columns = ["x", "y"]', "", '[sensors.radar]: "columns" is missing'),
        ('columns = ["x", "y"]', 'columns = ["x"]', "[sensors.radar] columns: 1 named, 2 needed, for x, y"),
        ('columns = ["x", "y"]', 'columns = "x"', '[sensors.radar] columns = "x" is invalid: must be a list of texts'),
        (
            '"position"',
            '"positon"',
            '[sensors.radar] type = "positon" is unknown; did you mean "position"? (there are: ',
        ),
        (
            'type = "position"',
            "",
            ': "type" is missing (there are: position, range_bearing, range_array, pose, camera, linear)',
        ),
        ('"constant_velocity"', '"constant"', '[motion] type = "constant" is unknown'),
        ("accel_psd = [0.3, 0.2]", "", "[motion] give exactly one of accel_psd"),
        ("accel_psd = [0.3, 0.2]", "accel_psd = -1", "[motion] accel_psd = -1 is invalid"),
        ("[motion]\ntype", "[moton]\ntype", 'unknown table "moton"; did you mean "motion"?'),
        (
            "dims = 2\naccel_psd = [0.3, 0.2]",
            "dims = 1\naccel_psd = 1",
            "[sensors.radar] position of the motion model has size 1",
        ),
        ("gate = 0.95", "gate = 1.5", "[tracker] gate = 1.5 is invalid: must lie between 0 and 1"),
        ("gate = 0.95", "gat = 0.95", '[tracker]: unknown key "gat"; did you mean "gate"?'),
        (
            '"nearest_neighbour"',
            '"nearest_neighbor"',
            '[tracker] associator = "nearest_neighbor" is unknown; did you mean "nearest_neighbour"?',
        ),
        ("m = 2", "m = 0", "[tracker.initiator] m = 0 is invalid: must be at least 1"),
        ("m = 2", "m = -2", "[tracker.initiator] m = -2 is invalid: must be a whole number"),
        ("m = 2", "m = 2.5", "[tracker.initiator] m = 2.5 is invalid: must be a whole number"),
        ("n = 3,", "", '[tracker.initiator]: "n" is missing'),
        ("max_misses = 4", "max_misses = 0", "[tracker.deletion] max_misses = 0 is invalid"),
        ("radius = 10.0", "radius = -1", "[tracker.clutter_map] radius = -1 is invalid"),
        ("max_gap = 30.0", "max_gap = -1", "[tracker] max_gap = -1 is invalid"),
        ("strict = true", "strict = 1", "[tracker] strict = 1 is invalid: must be true or false"),
        ("initiator = {", "initiatr = {", '[tracker]: unknown key "initiatr"; did you mean "initiator"?'),
        ('time = "t"', "time = 3", "[input] time = 3 is invalid: must be text in quotes"),
        (
            'unsorted = "sort"',
            'unsorted = "sorted"',
            '[input] unsorted = "sorted" is unknown; did you mean "sort"? (there are: error, sort)',
        ),
        ('ignore_sensors = ["camera"]', 'ignore_sensors = ["radar"]', '[input] ignore_sensors: "radar" has a model'),
        ('["own_x", "own_y"]', '["own_x"]', "[input] platform does not fit [sensors.radar]"),
        ('platform = ["own_x", "own_y"]', "", "[score] region: needs its centre"),
        ('[truth]\ncolumns = ["x", "y"]', "[truth]", '[truth]: "columns" is missing'),
        ('[truth]\ncolumns = ["x", "y"]', '[truth]\ncolumns = ["x"]', "[input] platform: 2 columns, but [truth] has 1"),
        ("c = 30.0", "c = -30.0", "[score] c = -30 is invalid"),
        ("c = 30.0", "c = 30.0\np = 0.5", "[score] p = 0.5 is invalid"),
        ("c = 30.0", "c = 30.0\nalpha = 3", "[score] alpha = 3 is invalid"),
        ("c = 30.0", "c = 30.0\nstart = inf", "[score] start = inf is invalid"),
        ('sensor = "radar"', 'sensor = "rader"', '[score] sensor = "rader" is unknown; did you mean "radar"?'),
        ("region = 250.0", "region = 0", "[score] region = 0.0 is invalid"),
        ('labels = ["north (m)", "east (m)"]', 'labels = ["north (m)"]', "[plot] labels: 1 given, 2 needed"),
        ("[plot]", "plot = 3\n[motion2]", ""),
        ("gate = 0.95", "gate = ", "line 21, column 8: not valid TOML: "),
        ("swap_axes = true\n", "swap_axes = [1,", "line 52: not valid TOML: "),
    ],
)
def test_every_mistake_is_one_line(load, old, new, expected):
    assert old in GOOD
    text = message(load, GOOD.replace(old, new, 1))
    assert expected in text


@pytest.mark.parametrize("table", ["motion", "sensors", "tracker"])
def test_missing_table(load, table):
    parts = GOOD.split("\n\n")
    text = "\n\n".join(part for part in parts if not part.strip().startswith(f"[{table}"))
    assert f"no table [{table}]" in message(load, text)


def test_table_that_is_none(load):
    assert '"motion" must be a table, got 3' in message(load, "motion = 3\n" + GOOD[GOOD.index("[sensors.radar]") :])
    assert '"sensors.radar" must be a table, [sensors.radar], got 3' in message(
        load, GOOD[: GOOD.index("[sensors.radar]")] + "[sensors]\nradar = 3\n" + GOOD[GOOD.index("[tracker]") :]
    )


def test_no_file(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing\.toml: no such file"):
        load_config(tmp_path / "nothing.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"# \xe4")
    with pytest.raises(ConfigError, match=r"latin.toml: not UTF-8 text"):
        load_config(tmp_path / "latin.toml")


def test_every_argument_has_a_kind():
    """A model whose arguments the file cannot check would fail here, not at a user's."""
    targets = [*kinds.MOTIONS.values(), *kinds.SENSORS.values(), *kinds.RECORDS.values()]
    targets += [kind for choices in kinds.CHOICES.values() for kind in choices.values()]
    targets += [module.InputConfig, module.TruthConfig, module.ScoreConfig, module.PlotConfig]
    arguments = [argument for target in targets for argument in kinds.arguments_of(target)]
    own = kinds.GIVEN_ELSEWHERE | {"gate", *kinds.CHOICES}
    for name in kinds.TRACKERS:
        arguments += [argument for argument in _loader.tracker_arguments(name) if argument.name not in own]
    for argument in arguments:
        for part in kinds.BETWEEN.split(argument.annotation.removesuffix(" | None")):
            known = part in {**kinds.KINDS, **kinds.RECORDS} or kinds.LITERAL.fullmatch(part)
            assert known or argument.annotation.removesuffix(" | None") in kinds.KINDS, argument


def test_every_model_has_a_name():
    public = (getattr(tr, name) for name in tr.__all__)
    # A file cannot hold functions.
    classes = {value for value in public if isinstance(value, type)} - {tr.CustomMotion, tr.CustomSensor}
    assert set(kinds.MOTIONS.values()) == {c for c in classes if issubclass(c, tr.ConstantVelocity.__base__)}
    assert set(kinds.SENSORS.values()) == {c for c in classes if issubclass(c, tr.PositionSensor.__base__)}


INTENSITY = (
    GOOD[: GOOD.index("[tracker]")]
    + """
[tracker]
type = "extended-phd"
clutter_density = {radar = 1e-6, sonar = 1e-3}
detections_per_target = {mean = 12, shape = 8}
partition = {type = "distance", thresholds = [1.0, 2.0]}
clutter_filter = {n_neighbors = 4}
birth = {type = "given", means = [[0, 0, 0, 0], [50, 0, 0, 0]], std = [50, 50, 10, 10], weights = 0.05}
merge = 3.0
"""
)


def test_extents_are_a_record_for_sensors_of_positions(load):
    text = """
[motion]
type = "constant_velocity"
dims = 2
accel_std = 2.0

[sensors.radar]
type = "position"
columns = ["x", "y"]
dims = 2
std = 20.0

[tracker]
type = "extended-phd"
clutter_density = 1e-6
detections_per_target = 10
birth = {type = "adaptive", weight = 0.05, max_speed = 30}
extent = {axes = [60, 40], certainty = 8}
"""
    assert load(text).tracker["extent"] == tr.Extent([60, 40], certainty=8)
    with pytest.raises(ConfigError, match="linearly"):
        load(INTENSITY + "extent = {axes = [60, 40], certainty = 8}\n")
    with pytest.raises(ConfigError, match="axes"):
        load(text.replace("axes = [60, 40], ", ""))


def test_trackers_by_intensity_have_a_type(load):
    config = load(INTENSITY)
    assert config.kind == "extended_phd"
    assert config.tracker["partition"] == tr.DistancePartition(thresholds=[1.0, 2.0])
    assert config.tracker["detections_per_target"] == tr.DetectionRate(12, shape=8)
    birth = config.tracker["birth"]
    np.testing.assert_array_equal(birth.states[1].mean, [50, 0, 0, 0])
    np.testing.assert_array_equal(birth.states[0].cov, np.diag([2500.0, 2500, 100, 100]))
    assert isinstance(config.make_tracker(), tr.IntensityTracker)
    for kind in ("phd", "cphd"):
        text = (
            GOOD[: GOOD.index("[tracker]")]
            + f"""
[tracker]
type = "{kind}"
gate = 0.999
clutter_density = 1e-6
birth = {{type = "adaptive", weight = 0.05, max_speed = 20.0}}
"""
        )
        assert isinstance(load(text).make_tracker(), tr.IntensityTracker)


@pytest.mark.parametrize(
    ("wrong", "right", "expected"),
    [
        ("extended-phd", "extended-pdh", '[tracker] type = "extended_pdh" is unknown; did you mean "extended_phd"?'),
        ("merge = 3.0", "merges = 3.0", '[tracker]: unknown key "merges"; did you mean "merge"?'),
        ("merge = 3.0", "merge = -3.0", "[tracker] merge"),
        ("thresholds = [1.0, 2.0]", "thresholds = 7", "[tracker.partition] thresholds = 7 is invalid"),
        ('type = "distance"', 'type = "distant"', '"distant" is unknown'),
        ("{mean = 12, shape = 8}", '"many"', '[tracker] detections_per_target = "many" is invalid'),
        ("std = [50, 50, 10, 10]", "std = [50, 50]", "[tracker.birth]"),
        ("sonar = 1e-3", "sonor = 1e-3", "clutter_density"),
        ("clutter_density = {radar = 1e-6, sonar = 1e-3}", "", '[tracker]: "clutter_density" is missing'),
    ],
)
def test_mistakes_in_a_tracker_by_intensity(load, wrong, right, expected):
    assert wrong in INTENSITY
    assert expected in message(load, INTENSITY.replace(wrong, right))
