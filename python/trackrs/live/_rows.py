"""One record of the stream: a row of the table of detections, or of scans. All else is refused with a reason.

The names are those of the tables that `trackrs.io` reads. A row of the table of scans says that a sensor looked,
whether or not it saw anything: it has none but the columns of time, sensor, scan and platform.
"""

from __future__ import annotations

import json
from math import isfinite, nan
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from trackrs.config import InputConfig

BRACKETS = b"[", b"{"


class Refused(Exception):  # noqa: N818 (it never leaves the module that counts refusals)
    """A record cannot be used.

    Attributes:
        code: why, for counting.
        reason: why, in words.
    """

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code, self.reason = code, reason


class Row(NamedTuple):
    """What a record says.

    Attributes:
        time: seconds.
        sensor: who saw it.
        values: the measurement, NaN = not observed; None: the record only says that the sensor looked.
        platform: position of the platform, if the record has it.
        ignored: whether the sensor is one that is left out on request.
    """

    time: float
    sensor: str
    values: list[float] | None
    platform: list[float] | None = None
    ignored: bool = False


class RowReader:
    """Makes rows of records.

    Args:
        columns: per sensor, the names of its measurement's components.
        layout: names of the other columns.
    """

    def __init__(self, columns: Mapping[str, Sequence[str]], layout: InputConfig) -> None:
        self._columns = {sensor: tuple(names) for sensor, names in columns.items()}
        self._layout = layout
        self._frame = {layout.time, layout.sensor, *layout.platform} | ({layout.scan} if layout.scan else set())

    def row(self, record: Mapping[str, Any]) -> Row:
        """Return what the record says.

        Raises:
            Refused: a column is missing or of the wrong type, a number is not finite, or the sensor is unknown.
        """
        layout = self._layout
        try:
            time, sensor = record[layout.time], record[layout.sensor]
        except KeyError as missing:
            self._missing(record, str(missing.args[0]))
        if type(time) is not float or not isfinite(time):
            time = _number(time, layout.time)
        if type(sensor) is not str:
            sensor = _name(sensor, layout.sensor)
        names = self._columns.get(sensor)
        if names is None:
            if sensor in layout.ignore_sensors:
                return Row(time, sensor, None, ignored=True)
            known = ", ".join(f'"{name}"' for name in self._columns)
            raise Refused("unknown_sensor", f"unknown sensor {_shown(sensor)} (there are: {known})")
        platform = None
        if layout.platform and any(name in record for name in layout.platform):
            platform = [_number(self._value(record, name), name) for name in layout.platform]
        values: list[float] | None = []
        for name in names:
            value = record.get(name, Ellipsis)
            if type(value) is not float or not isfinite(value):
                if value is None:
                    value = nan
                elif value is Ellipsis:
                    if not self._frame.issuperset(record):
                        self._missing(record, name)
                    values = None
                    break
                else:
                    value = _number(value, name)
            values.append(value)  # type: ignore[union-attr]
        return Row(time, sensor, values, platform)

    def _value(self, record: Mapping[str, Any], name: str) -> object:
        if name not in record:
            self._missing(record, name)
        return record[name]

    def _missing(self, record: Mapping[str, Any], name: str) -> NoReturn:
        found = ", ".join(_shown(key) for key in list(record)[:20]) or "none"
        raise Refused("missing_column", f'no column "{name}" (there are: {found})')

    def shown(self, time: float, sensor: str, values: Sequence[float]) -> str:
        """Return a row as the line that says the same."""
        record: dict[str, Any] = {self._layout.time: time, self._layout.sensor: sensor}
        record |= {k: v if isfinite(v) else None for k, v in zip(self._columns[sensor], values, strict=True)}
        return json.dumps(record)


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Refused("wrong_type", f'column "{name}" holds {_shown(value)}, where a number is needed')
    try:
        number = float(value)
    except OverflowError:
        number = float("inf")
    if not isfinite(number):
        raise Refused("not_finite", f'column "{name}" holds a number that is not finite; null means "not observed"')
    return number


def _name(value: object, name: str) -> str:
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise Refused("wrong_type", f'column "{name}" holds {_shown(value)}, where a name is needed')
    try:
        return str(value)
    except ValueError:  # Python does not write out integers of thousands of digits
        raise Refused("wrong_type", f'column "{name}" holds a number of thousands of digits') from None


def _shown(value: object) -> str:
    """A value of a record in words; what is long is cut."""
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    try:
        text = json.dumps(value)
    except (TypeError, ValueError):
        return f"a {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:60]}..."


# --- JSON ---


def _no_constant(name: str) -> NoReturn:
    raise Refused("not_json", f'{name} is no JSON; null means "not observed"')


_decode = json.JSONDecoder(parse_constant=_no_constant).decode


def parse(line: bytes, depth: int) -> dict[str, Any]:
    """Return the object that stands on a line.

    Raises:
        Refused: the line is no UTF-8, no JSON, nested deeper than `depth`, or no object.
    """
    if sum(map(line.count, BRACKETS)) > depth:
        found = _depth(line)
        if found > depth:
            raise Refused("too_deep", f"is nested {found} deep, {depth} are allowed")
    try:
        record = _decode(line.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise Refused("not_utf8", f"is not UTF-8 text: byte {error.start} of the line") from None
    except (ValueError, RecursionError) as error:
        raise Refused("not_json", f"is no JSON: {str(error)[:100]}") from None
    if not isinstance(record, dict):
        raise Refused("not_object", f"holds {_shown(record)}, where an object is needed")
    return record


def _depth(line: bytes) -> int:
    """How deep brackets stand in one another, outside strings, as far as the line is JSON."""
    outside = b"".join(line.replace(rb"\\", b"").replace(rb"\"", b"").split(b'"')[::2])
    codes = np.frombuffer(outside, np.uint8)
    opens, closes = ((codes == a) | (codes == b) for a, b in ((0x5B, 0x7B), (0x5D, 0x7D)))
    return int(np.cumsum(opens.astype(np.int64) - closes).max(initial=0))
