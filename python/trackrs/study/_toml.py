"""A study from a TOML file, for `trackrs study`; docs/studies.md shows two of them.

| table            | content                                                                               |
|------------------|---------------------------------------------------------------------------------------|
| `[scenario]`     | `type`, one of `trackrs.scenarios`, and its arguments                                  |
| `[methods.NAME]` | `type`, a tracker or a filter, and its arguments, `motion` and `sensor` among them     |
| `[common]`       | what holds for every method that does not say otherwise                                |
| `[[metrics]]`    | `type` and arguments of each metric                                                    |
| `[study]`        | `runs` and `seed`                                                                      |

What neither `[common]` nor the method says is taken from the scenario, as far as it knows: sensor, motion, initial
states, births, rates and clutter.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trackrs import scenarios
from trackrs._kinds import (
    FILTERS,
    GIVEN_ELSEWHERE,
    MOTIONS,
    SENSORS,
    TRACKERS,
    Argument,
    arguments_of,
    shown,
    snake_case,
)
from trackrs._loader import Loader, tracker_arguments
from trackrs.errors import TrackrsError
from trackrs.intensity import Birth
from trackrs.metric import GOSPA, OSPA
from trackrs.scenarios import (
    Blob,
    CloseTargets,
    Ellipse,
    ExtendedTarget,
    ExtendedTargets,
    LShape,
    Rectangle,
    Turning,
    Underwater,
)
from trackrs.sensor import PositionSensor
from trackrs.study._metrics import Cardinality, Identity, LeadError, PositionError
from trackrs.study._study import Study

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from trackrs.study._metrics import Metric

SCENARIOS: dict[str, Callable[..., Any]] = {
    make.__name__: make
    for make in (
        scenarios.close_targets,
        scenarios.crossing,
        scenarios.extended_targets,
        scenarios.moving_head,
        scenarios.parallel,
        scenarios.turntable,
        scenarios.underwater,
    )
}
METRICS: dict[str, Callable[..., Metric]] = {
    "ospa": OSPA,
    "gospa": GOSPA,
    **{snake_case(kind.__name__): kind for kind in (Cardinality, Identity, PositionError, LeadError)},
}
SHAPES: dict[str, Callable[..., Any]] = {"blob": Blob, "ellipse": Ellipse, "rectangle": Rectangle, "l_shape": LShape}
TABLES = ("scenario", "common", "methods", "metrics", "study")
NO_TABLE = {"course"}  # arguments of scenarios that no file holds


@dataclass(frozen=True, slots=True)
class RunConfig:
    """How often, and with which random numbers.

    Args:
        runs: how many.
        seed: of the study.
    """

    runs: int = 200
    seed: int = 0


@dataclass(frozen=True, slots=True)
class StudyConfig:
    """A file of a study.

    Attributes:
        path: the file.
        study: what it describes.
        runs: how many it asks for.
        seed: that it asks for.
    """

    path: Path
    study: Study
    runs: int
    seed: int


def load_study(path: str | Path) -> StudyConfig:
    """Read a file of a study.

    Raises:
        ConfigError: the file is missing or no TOML, a table or key is missing or unknown, a value has the wrong type or
            is outside its domain, or scenario, methods and metrics do not go together.
    """
    return _StudyLoader(Path(path)).study()


class _StudyLoader(Loader):
    """Reads one file of a study."""

    def study(self) -> StudyConfig:
        document = self.document()
        self.known_keys(document, TABLES, "", "table")
        scene = self.scenario(self.required(document, "scenario"))
        common = self.table(document, "common") or {}
        methods = {}
        for name, own in self.required(document, "methods").items():
            where = f"[methods.{name}]"
            if not isinstance(own, dict):
                self.fail("", f': "methods.{name}" must be a table, {where}, got {shown(own)}')
            methods[name] = self.method(scene, common | own, where)
        if not methods:
            self.fail("[methods]", ": names no method; add a table such as [methods.default]")
        metrics = document.get("metrics")
        if not isinstance(metrics, list) or not metrics or not all(isinstance(table, dict) for table in metrics):
            self.fail("", ": no [[metrics]]; add a table with a type for each")
        scores = [self.model(METRICS, table, "[[metrics]]") for table in metrics]
        asked = self.build(RunConfig, self.table(document, "study") or {}, "[study]")
        try:
            study = Study(scene, methods, scores)
        except TrackrsError as error:
            self.fail("", f": {error}")
        return StudyConfig(self.path, study, asked.runs, asked.seed)

    def required(self, document: Mapping[str, Any], name: str) -> dict[str, Any]:
        table = self.table(document, name)
        if table is None:
            self.fail("", f": no table [{name}]; add one (docs/studies.md shows how)")
        return table

    def scenario(self, table: Mapping[str, Any]) -> Any:  # noqa: ANN401 (one of the scenarios)
        where = "[scenario]"
        if "type" not in table:
            self.fail(where, f': "type" is missing (there are: {", ".join(SCENARIOS)})')
        make = SCENARIOS[self.choice(table["type"], SCENARIOS, f"{where} type")]
        arguments = [argument for argument in arguments_of(make) if argument.name not in NO_TABLE]
        self.known_keys(table, ["type", *(argument.name for argument in arguments)], where)
        given = {}
        for argument in arguments:
            if argument.name in table:
                given[argument.name] = self.scene_value(table[argument.name], argument, where)
            elif argument.required:
                self.fail(where, f': "{argument.name}" is missing')
        return self.core(lambda: make(**given), where)

    def scene_value(self, value: Any, argument: Argument, where: str) -> Any:  # noqa: ANN401 (as TOML has it)
        name, annotation = argument.name, argument.annotation
        if name == "array":
            return self.choice(value, ["bats", "toss"], f"{where} array")
        if name == "shapes":
            tables = value if isinstance(value, list) else [value]
            shapes = [self.shape(table, f"{where[:-1]}.shapes]") for table in tables]
            return shapes if isinstance(value, list) else shapes[0]
        if annotation == "Sequence[ExtendedTarget]":
            if not isinstance(value, list) or not all(isinstance(table, dict) for table in value):
                self.fail(where, f" {name} = {shown(value)} is invalid: must be a list of tables")
            return [self.target(table, f"{where[:-1]}.targets]") for table in value]
        if name == "swings":
            return self.value(value, Argument(name, "ArrayLike", required=True), where)
        return self.value(value, argument, where)

    def shape(self, table: Any, where: str) -> Any:  # noqa: ANN401
        if not isinstance(table, dict):
            self.fail(where, f": must be a table with a type, got {shown(table)}")
        return self.model(SHAPES, table, where)

    def target(self, table: Mapping[str, Any], where: str) -> ExtendedTarget:
        plain = {name: value for name, value in table.items() if name not in {"start", "shape"}}
        start = self.value(table.get("start"), Argument("start", "Sequence[float]", required=True), where)
        arguments = [a for a in arguments_of(ExtendedTarget) if a.name not in {"start", "shape"}]
        more = self.records(arguments, plain, where, ["start", "shape"])
        if "shape" in table:
            more["shape"] = self.shape(table["shape"], f"{where[:-1]}.shape]")
        return self.core(lambda: ExtendedTarget(start, **more), where)

    def method(self, scene: Any, table: Mapping[str, Any], where: str) -> Any:  # noqa: ANN401 (any method)
        scans = isinstance(scene, CloseTargets | ExtendedTargets)
        known = TRACKERS if scans else FILTERS
        if "type" not in table:
            self.fail(where, f': "type" is missing (there are: {", ".join(known)})')
        kind = self.choice(table["type"], known, f"{where} type")
        facts = _facts(scene)
        for name, kinds in (("motion", MOTIONS), ("sensor", SENSORS)):
            own = self.table(table, name)
            if own is not None:
                facts[name] = self.model(kinds, own, f"{where[:-1]}.{name}]")
            elif name not in facts:
                self.fail(where, f': "{name}" is missing, and the scenario knows none')
        arguments = tracker_arguments(kind) if scans else arguments_of(FILTERS[kind])
        taken = {argument.name for argument in arguments}
        more = ["type", "motion", "sensor", *(["initial"] if "initial" in taken else [])]
        if "initial" in table and table["initial"] != "none":
            self.fail(where, f' initial = {shown(table["initial"])} is invalid: must be "none", or left out')
        if table.get("initial") == "none":
            facts.pop("initial", None)
        free = [argument for argument in arguments if argument.name not in GIVEN_ELSEWHERE]
        facts |= self.records(
            free, {name: value for name, value in table.items() if name not in more}, where, (), facts
        )
        if kind == "multi_target":
            facts["sensors"] = {"radar": facts.pop("sensor")}
        return self.core(lambda: known[kind](**{k: v for k, v in facts.items() if k in taken}), where, free)


def _facts(scene: object) -> dict[str, Any]:
    """What a scenario knows of the arguments of a method."""
    match scene:
        case CloseTargets(radar=radar, initial=initial):
            return {"sensor": radar, "initial": initial}
        case ExtendedTargets():
            return {
                "motion": scene.motion,
                "sensor": scene.sensor,
                "birth": Birth(scene.births, scene.birth_weight),
                "detections_per_target": scene.detections_per_target,
                "detection_probability": scene.detection_probability,
                "clutter_density": scene.clutter_density,
            }
        case Underwater(array=array):
            return {"sensor": array}
        case Turning(std=std):
            return {"sensor": PositionSensor(dims=1, std=std)}
    return {}
