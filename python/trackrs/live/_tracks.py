"""Tracks as lines of JSON."""

from __future__ import annotations

import json
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trackrs.types import Tracks


def track_lines(tracks: Tracks) -> bytes:
    """Return tracks as lines of JSON, with the names of `Tracks.to_table`."""
    table = tracks.to_table()
    quoted = {sensor: json.dumps(sensor) for sensor in set(tracks.sensors)}
    columns = [column.tolist() for column in table.values()]
    columns[1] = [quoted[sensor] for sensor in columns[1]]
    line = _template(tuple(table))
    # A number as Python shows it is one as JSON has it, unless it is not finite. Encoders take four times as long.
    text = "".join([line % row for row in zip(*columns, strict=True)])
    if ":nan" in text or ":inf" in text or ":-inf" in text:
        rows = zip(*(column.tolist() for column in table.values()), strict=True)
        finite = ([value if isinstance(value, str) or isfinite(value) else None for value in row] for row in rows)
        text = "".join([f"{json.dumps(dict(zip(table, row, strict=True)), separators=(',', ':'))}\n" for row in finite])
    return text.encode()


@lru_cache
def _template(names: tuple[str, ...]) -> str:
    """A line of tracks; the second column is text in quotes."""
    items = [f"{json.dumps(name)}:".replace("%", "%%") + ("%s" if k == 1 else "%r") for k, name in enumerate(names)]
    return f"{{{','.join(items)}}}\n"
