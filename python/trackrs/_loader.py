"""How a configuration file is read: table by table, against the signatures of the classes that it names."""

from __future__ import annotations

import math
import re
import tomllib
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np

from trackrs._kinds import (
    BETWEEN,
    CHOICES,
    GIVEN_ELSEWHERE,
    KINDS,
    LITERAL,
    MOTIONS,
    RECORDS,
    SENSORS,
    TRACKERS,
    Argument,
    arguments_of,
    closest,
    shown,
    snake_case,
)
from trackrs.config import Config, ConfigError, InputConfig, PlotConfig, ScoreConfig, TruthConfig
from trackrs.errors import DimensionError, TrackrsError
from trackrs.gating import Gate
from trackrs.metric import gospa
from trackrs.tracker import MofN, MultiTargetTracker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from trackrs.sensor import Sensor

T = TypeVar("T")

TABLES = ("motion", "sensors", "tracker", "input", "truth", "score", "plot")


def tracker_arguments(kind: str) -> list[Argument]:
    """Return all arguments of a tracker."""
    target = TRACKERS[kind]
    return arguments_of(MultiTargetTracker.__init__ if target is MultiTargetTracker else target)


def _accepted(annotation: str) -> tuple[Callable[[object], bool], str]:
    """What a value must be that may be of several kinds: a test, and the same in words."""
    if annotation in KINDS:
        return KINDS[annotation].accepts, KINDS[annotation].words
    tests: list[Callable[[object], bool]] = []
    words: list[str] = []
    for part in BETWEEN.split(annotation):
        if choices := LITERAL.fullmatch(part):
            known = re.findall(r"['\"](\w+)['\"]", choices[1])
            tests.append(known.__contains__)
            words.append(", ".join(f'"{name}"' for name in known))
        elif part in KINDS:
            tests.append(KINDS[part].accepts)
            words.append(KINDS[part].words)
        elif part in RECORDS:
            words.append("a table")
    return lambda value: any(test(value) for test in tests), " or ".join(words)


class Loader:
    """Reads one file; its methods know the file's name and say it in every error."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def fail(self, where: str, what: str) -> NoReturn:
        raise ConfigError(f"{self.path}{', ' if where else ''}{where}{what}")

    def load(self) -> Config:
        document = self.document()
        self.known_keys(document, TABLES, "", "table")
        motion = self.model(MOTIONS, self.required(document, "motion"), "[motion]")
        sensors, columns = self.sensors(self.required(document, "sensors"))
        layout = self.build(InputConfig, self.table(document, "input") or {}, "[input]")
        truth, score = self.table(document, "truth"), self.table(document, "score")
        tracker = self.required(document, "tracker")
        # The hyphen is as good as the underscore.
        named = str(tracker.pop("type", "multi_target")).replace("-", "_")
        kind = self.choice(named, TRACKERS, "[tracker] type")
        config = Config(
            path=self.path,
            motion=motion,
            sensors=sensors,
            columns=columns,
            kind=kind,
            tracker=self.tracker(kind, tracker),
            input=layout,
            truth=None if truth is None else self.build(TruthConfig, truth, "[truth]"),
            score=None if score is None else self.build(ScoreConfig, score, "[score]"),
            plot=self.build(PlotConfig, self.table(document, "plot") or {}, "[plot]"),
        )
        self.check(config, score or {})
        return config

    def document(self) -> dict[str, Any]:
        text = ""
        try:
            text = self.path.read_text(encoding="utf-8")
            return tomllib.loads(text)
        except FileNotFoundError:
            raise ConfigError(f"{self.path}: no such file; check the name") from None
        except UnicodeDecodeError:
            raise ConfigError(f"{self.path}: not UTF-8 text") from None
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be read: {error.strerror}") from None
        except tomllib.TOMLDecodeError as error:
            found = re.fullmatch(r"(.*) \(at (line \d+, column \d+|end of document)\)", str(error), re.DOTALL)
            what, place = found.groups() if found else (str(error), "")
            last = f"line {text.rstrip().count(chr(10)) + 1}"
            self.fail(last if place == "end of document" else place, f": not valid TOML: {what[:1].lower()}{what[1:]}")

    def known_keys(self, table: Mapping[str, Any], known: Iterable[str], where: str, noun: str = "key") -> None:
        known = list(known)
        for key in table:
            if key not in known:
                self.fail(where, f': unknown {noun} "{key}"{closest(key, known)} (there are: {", ".join(known)})')

    def table(self, parent: Mapping[str, Any], name: str) -> dict[str, Any] | None:
        """A table of the file, if it is there."""
        table = parent.get(name)
        if not isinstance(table, dict | None):
            self.fail("", f': "{name}" must be a table, got {shown(table)}')
        return table

    def required(self, document: Mapping[str, Any], name: str) -> dict[str, Any]:
        """A table of the file that must be there."""
        table = self.table(document, name)
        if table is None:
            self.fail("", f": no table [{name}]; add one (examples/harbour.toml shows how)")
        return table

    def values(
        self, target: Callable[..., Any], table: Mapping[str, Any], where: str, more: Iterable[str]
    ) -> dict[str, Any]:
        """The table as arguments of `target`, checked by its signature. Keys in `more` belong to somebody else."""
        arguments = arguments_of(target)
        self.known_keys(table, [*more, *(argument.name for argument in arguments)], where)
        out = {}
        for argument in arguments:
            if argument.name in table:
                out[argument.name] = self.value(table[argument.name], argument, where)
            elif argument.required:
                self.fail(where, f': "{argument.name}" is missing')
        return out

    def value(self, value: Any, argument: Argument, where: str) -> Any:  # noqa: ANN401 (as TOML has it)
        annotation = argument.annotation.removesuffix(" | None")
        if argument.takes_none and value == "none":
            return None
        if choices := LITERAL.fullmatch(annotation):
            return self.choice(value, re.findall(r"['\"](\w+)['\"]", choices[1]), f"{where} {argument.name}")
        accepts, words = _accepted(annotation)
        if not accepts(value):
            words = f'{words}, or "none"' if argument.takes_none else words
            self.fail(where, f" {argument.name} = {shown(value)} is invalid: must be {words}")
        if annotation == "float":
            return float(value)
        return tuple(value) if annotation.startswith("tuple[") else value

    def choice(self, value: object, known: Iterable[str], where: str) -> str:
        known = list(known)
        if not isinstance(value, str) or value not in known:
            hint = closest(value, known) if isinstance(value, str) else ""
            self.fail(where, f" = {shown(value)} is unknown{hint} (there are: {', '.join(known)})")
        return value

    def build(self, target: Callable[..., T], table: Mapping[str, Any], where: str, more: Iterable[str] = ()) -> T:
        arguments = self.values(target, table, where, more)
        try:
            return target(**arguments)
        except TrackrsError as error:
            self.fail(where, f" {error}")

    def model(self, kinds: Mapping[str, Callable[..., T]], table: Mapping[str, Any], where: str, *more: str) -> T:
        if "type" not in table:
            self.fail(where, f': "type" is missing (there are: {", ".join(kinds)})')
        kind = self.choice(table["type"], kinds, f"{where} type")
        return self.build(kinds[kind], table, where, ["type", *more])

    def sensors(self, tables: Mapping[str, Any]) -> tuple[dict[str, Sensor], dict[str, tuple[str, ...]]]:
        if not tables:
            self.fail("[sensors]", ": names no sensor; add a table such as [sensors.radar]")
        sensors, columns = {}, {}
        for name, table in tables.items():
            where = f"[sensors.{name}]"
            if not isinstance(table, dict):
                self.fail("", f': "sensors.{name}" must be a table, {where}, got {shown(table)}')
            sensor = self.model(SENSORS, table, where, "columns")
            if "columns" not in table:
                self.fail(where, ': "columns" is missing: name the columns of the detections, one per component')
            names = self.value(table["columns"], Argument("columns", "tuple[str, ...]", required=True), where)
            if len(names) != sensor.measurement_dim:
                labels = ", ".join(sensor.labels)
                self.fail(where, f" columns: {len(names)} named, {sensor.measurement_dim} needed, for {labels}")
            sensors[name], columns[name] = sensor, names
        return sensors, columns

    def tracker(self, kind: str, table: Mapping[str, Any]) -> dict[str, Any]:
        """The arguments of a tracker that a file can hold: numbers, and records of numbers."""
        arguments = [a for a in tracker_arguments(kind) if a.name not in GIVEN_ELSEWHERE]
        return self.records(arguments, table, "[tracker]", ["type"])

    def records(
        self,
        arguments: Iterable[Argument],
        table: Mapping[str, Any],
        where: str,
        more: Iterable[str] = (),
        given: Iterable[str] = (),
    ) -> dict[str, Any]:
        """The table as arguments that may be records of their own.

        Keys in `more` belong to somebody else; arguments in `given` need not be there.
        """
        arguments, out = list(arguments), {}
        self.known_keys(table, [*more, *(argument.name for argument in arguments)], where)
        for argument in arguments:
            name, annotation = argument.name, argument.annotation.removesuffix(" | None")
            record = RECORDS.get(BETWEEN.split(annotation)[-1])
            if name not in table:
                if argument.required and name not in given:
                    self.fail(where, f': "{name}" is missing')
            elif record is not None and (isinstance(table[name], dict) or annotation in RECORDS):
                out[name] = self.build(record, self.table(table, name) or {}, f"{where[:-1]}.{name}]")
            elif name in CHOICES:
                out[name] = self.kind(name, table[name], where)
            elif name == "gate":
                out[name] = Gate(self.value(table[name], Argument(name, "float", required=False), where))
            else:
                out[name] = self.value(table[name], argument, where)
        return out

    def kind(self, name: str, value: object, where: str) -> object:
        """A record of a kind that is named alone, or by "type" in a table of its own; counting hits needs no name."""
        kinds, here = CHOICES[name], f"{where[:-1]}.{name}]"
        if not isinstance(value, dict):
            return self.build(kinds[self.choice(value, kinds, f"{where} {name}")], {}, here)
        table = {"type": snake_case(MofN.__name__)} | value if name == "initiator" else value
        return self.model(kinds, table, here)

    # --- what single tables cannot know ---

    def check(self, config: Config, score: Mapping[str, Any]) -> None:
        """Check what concerns several tables at once, and what the core checks when a tracker is built."""
        layout, n = config.input, config.motion.state_dim
        for name, sensor in config.sensors.items():
            alone = partial(MultiTargetTracker, config.motion, {name: sensor}, MofN(1, 1, 1.0))
            self.core(alone, f"[sensors.{name}]")
            if layout.platform:
                platform = np.zeros(len(layout.platform))
                try:
                    sensor.observe(np.full(n, 1.0), platform)
                except DimensionError as error:
                    self.fail("[input]", f" platform does not fit [sensors.{name}]: {error}")
                except TrackrsError:
                    pass  # the sensor cannot see this one state: nothing wrong with it
            if name in layout.ignore_sensors:
                self.fail(
                    "[input]", f' ignore_sensors: "{name}" has a model in [sensors.{name}]; remove one of the two'
                )
        self.core(config.make_tracker, "[tracker]", tracker_arguments(config.kind))
        if config.score:
            self.check_score(config, config.score, score)
        if len(config.plot.labels) != 2:
            self.fail("[plot]", f" labels: {len(config.plot.labels)} given, 2 needed")

    def check_score(self, config: Config, score: ScoreConfig, table: Mapping[str, Any]) -> None:
        where = "[score]"
        alpha = 2.0 if score.metric == "ospa" else score.alpha
        self.core(lambda: gospa([[0.0]], [[0.0]], score.c, score.p, alpha), where)
        if score.metric == "ospa" and "alpha" in table:
            self.fail(where, " alpha: OSPA has none; remove it")
        if score.sensor is not None:
            self.choice(score.sensor, config.sensors, f"{where} sensor")
        if score.start is not None and not math.isfinite(score.start):
            self.fail(where, f" start = {score.start} is invalid: must be finite")
        if score.region is None:
            return
        if not (score.region > 0 and math.isfinite(score.region)):
            self.fail(where, f" region = {score.region} is invalid: must be finite and positive")
        platform = config.input.platform
        if not platform:
            self.fail(where, " region: needs its centre; name the platform's columns in [input] platform, or remove it")
        if config.truth and len(config.truth.columns) != len(platform):
            self.fail("[input]", f" platform: {len(platform)} columns, but [truth] has {len(config.truth.columns)}")

    def core(self, build: Callable[[], T], where: str, arguments: Iterable[Argument] = ()) -> T:
        """Let the core check, and put its finding where the user wrote the value, perhaps in one of these arguments."""
        try:
            return build()
        except TrackrsError as error:
            text = str(error)
            culprit = text.split(" ", 1)[0]
            if culprit == "probability":
                gates = [argument.name for argument in arguments if argument.name == "gate"]
                text = text.replace(culprit, "gate", 1) if gates else text
            for argument in arguments:
                record = RECORDS.get(BETWEEN.split(argument.annotation.removesuffix(" | None"))[-1])
                records = [record] if record else CHOICES.get(argument.name, {}).values()
                if any(culprit in {item.name for item in arguments_of(record)} for record in records):
                    self.fail(f"{where[:-1]}.{argument.name}]", f" {text}")
            self.fail(where, f" {text}")
