"""Runs on disk: what a study has done survives whatever happens to the process.

A folder belongs to one study with one seed: `study.json` names them. Every session appends to a file of its own, one
record for each part that it has finished:

| bytes    | content                                                            |
|----------|--------------------------------------------------------------------|
| 8 8      | first run, number of runs R, u64 little-endian                     |
| 8        | length J of the failures                                           |
| 8 R W    | values                                                             |
| 8 R M    | seconds                                                            |
| J        | failures as JSON: run, method, reason                              |
| 4        | CRC-32 of all before                                               |

A record that was being written when the process died does not fit its checksum: it is left out, and its runs are run
again. As runs are the same whoever runs them, two sessions on one folder do each other no harm.
"""

from __future__ import annotations

import json
import os
import struct
import uuid
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trackrs._arrays import frozen
from trackrs.errors import StateError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import TracebackType
    from typing import Self

    from trackrs._arrays import FloatArray

HEAD = struct.Struct("<QQQ")
SUM = struct.Struct("<I")
FORMAT = 1


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What some runs gave, in the order of their numbers.

    Attributes:
        first: number of the first run.
        values: (R, W) all methods, columns and steps.
        seconds: (R, M) per method.
        failures: run, number of the method, reason.
    """

    first: int
    values: FloatArray
    seconds: FloatArray
    failures: tuple[tuple[int, int, str], ...]

    def to_bytes(self) -> bytes:
        """Return the record."""
        failures = json.dumps(self.failures).encode()
        head = HEAD.pack(self.first, len(self.values), len(failures))
        body = b"".join([head, little(self.values), little(self.seconds), failures])
        return body + SUM.pack(zlib.crc32(body))


def little(values: FloatArray) -> bytes:
    """Return the numbers, least significant byte first."""
    return values.astype("<f8", copy=False).tobytes()


def records(data: bytes, width: int, methods: int) -> Iterator[Part]:
    """Give all whole records; what follows a broken one is lost with it."""
    at = 0
    while at + HEAD.size <= len(data):
        first, runs, length = HEAD.unpack_from(data, at)
        sizes = (8 * runs * width, 8 * runs * methods, length)
        end = at + HEAD.size + sum(sizes)
        if end + SUM.size > len(data) or SUM.unpack_from(data, end)[0] != zlib.crc32(memoryview(data)[at:end]):
            return
        start = at + HEAD.size
        values = np.frombuffer(data, "<f8", runs * width, start).reshape(runs, width)
        seconds = np.frombuffer(data, "<f8", runs * methods, start + sizes[0]).reshape(runs, methods)
        failures = tuple((run, method, reason) for run, method, reason in json.loads(data[end - length : end]))
        yield Part(first, frozen(values), frozen(seconds), failures)
        at = end + SUM.size


class Shards:
    """A folder of finished runs.

    Args:
        folder: it is made where it is missing.
        study: digest of the study.
        seed: of the study.
        width, methods: numbers in a row of values and of seconds.

    Raises:
        StateError: the folder belongs to another study, or holds something else.
    """

    def __init__(self, folder: str | Path, study: str, seed: int, width: int, methods: int) -> None:
        """Claim the folder."""
        self._folder, self._width, self._methods = Path(folder), width, methods
        self._folder.mkdir(parents=True, exist_ok=True)
        mine = {"format": FORMAT, "study": study, "seed": seed, "width": width, "methods": methods}
        self._claim(mine)
        self._path = self._folder / f"runs-{uuid.uuid4().hex}.bin"
        self._file = -1

    def _claim(self, mine: dict[str, object]) -> None:
        label = self._folder / "study.json"
        if not label.exists():
            others = next(self._folder.iterdir(), None)
            if others is not None and not others.name.startswith("study.json"):
                msg = f"{self._folder}: is not empty and holds no study ({others.name}); name another folder"
                raise StateError(msg)
            draft = self._folder / f"study.json.{uuid.uuid4().hex}"
            draft.write_text(json.dumps(mine), encoding="utf-8")
            draft.replace(label)
            return
        try:
            theirs = json.loads(label.read_text(encoding="utf-8"))
        except ValueError as error:
            msg = f"{label}: is not the label of a study: {error}"
            raise StateError(msg) from None
        for name, value in mine.items():
            if theirs.get(name) != value:
                what = {"seed": f"seed {theirs.get('seed')}", "format": "another version of trackrs"}
                msg = f"{self._folder}: holds a study of {what.get(name, 'something else')}; name another folder"
                raise StateError(msg)

    def parts(self) -> list[Part]:
        """Return what is there, in no particular order; some runs may be there twice."""
        files = sorted(self._folder.glob("runs-*.bin"))
        return [part for file in files for part in records(file.read_bytes(), self._width, self._methods)]

    def append(self, part: Part) -> None:
        """Keep a part."""
        if self._file < 0:
            self._file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0))
        data = memoryview(part.to_bytes())
        while data:
            data = data[os.write(self._file, data) :]

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """See that it is on the disk."""
        if self._file >= 0:
            os.fsync(self._file)
            os.close(self._file)
            self._file = -1
