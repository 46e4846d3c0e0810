"""Runs on disk: what a study has done survives whatever happens to the process.

A folder belongs to one study with one seed: `study.json` names them. Every process appends to a file of its own, one
record for each part that it has finished:

| bytes    | content                                                            |
|----------|--------------------------------------------------------------------|
| 8        | mark of a record                                                   |
| 8 8      | first run, number of runs R, u64 little-endian as all numbers here |
| 8 8      | width W of a row of values, number of methods M                    |
| 8        | length J of the failures                                           |
| 8 R W    | values                                                             |
| 8 R M    | seconds                                                            |
| J        | failures as JSON: run, method, reason                              |
| 4        | CRC-32 of all before                                               |

A record that was being written when the process died, or that has been damaged since, does not fit its checksum: it is
left out, reading goes on at the next mark, and its runs are run again. As runs are the same whoever runs them, two
processes on one folder do each other no harm.
"""

from __future__ import annotations

import json
import os
import struct
import uuid
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trackrs._arrays import frozen
from trackrs.errors import ParameterError, StateError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import TracebackType
    from typing import Self

    from trackrs._arrays import FloatArray

MARK = b"\x93runs\r\n\x1a"
HEAD = struct.Struct("<8s5Q")
SUM = struct.Struct("<I")
LABEL, FORMAT = "study.json", 1


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
    values: FloatArray = field(repr=False)
    seconds: FloatArray = field(repr=False)
    failures: tuple[tuple[int, int, str], ...]

    def to_bytes(self) -> bytes:
        """Return the record: data only, with a checksum."""
        failures = json.dumps(self.failures).encode()
        sizes = (len(self.values), self.values.shape[1], self.seconds.shape[1], len(failures))
        head = HEAD.pack(MARK, self.first, *sizes)
        body = b"".join([head, little(self.values), little(self.seconds), failures])
        return body + SUM.pack(zlib.crc32(body))

    @classmethod
    def from_bytes(cls, data: bytes) -> Part:
        """Return the part of a record.

        Raises:
            StateError: the bytes are truncated, altered or foreign.
        """
        found = _record(data, 0)
        if found is None or found[1] != len(data):
            msg = "these bytes are not a part of a study, or were truncated or altered"
            raise StateError(msg)
        return found[0]


def little(values: FloatArray) -> bytes:
    """Return the numbers, least significant byte first."""
    return values.astype("<f8", copy=False).tobytes()


def records(data: bytes) -> Iterator[Part]:
    """Give all whole records."""
    at = 0
    while (at := data.find(MARK, at)) >= 0:
        found = _record(data, at)
        if found is None:
            at += 1
        else:
            part, at = found
            yield part


def _record(data: bytes, at: int) -> tuple[Part, int] | None:
    """The record that begins there and where it ends, if it is whole."""
    if len(data) - at < HEAD.size + SUM.size:
        return None
    mark, first, runs, width, methods, length = HEAD.unpack_from(data, at)
    start, sizes = at + HEAD.size, (8 * runs * width, 8 * runs * methods, length)
    end = start + sum(sizes)
    if mark != MARK or end + SUM.size > len(data) or SUM.unpack_from(data, end)[0] != zlib.crc32(data[at:end]):
        return None
    values = np.frombuffer(data, "<f8", runs * width, start).reshape(runs, width)
    seconds = np.frombuffer(data, "<f8", runs * methods, start + sizes[0]).reshape(runs, methods)
    failures = tuple((run, method, reason) for run, method, reason in json.loads(data[end - length : end]))
    return Part(first, frozen(values), frozen(seconds), failures), end + SUM.size


class Shards:
    """A folder of finished runs.

    Args:
        folder: it is made where it is missing.
        study: digest of the study.
        seed: of the study.
        width, methods: numbers in a row of values and of seconds.

    Raises:
        StateError: the folder belongs to another study, or holds something else.
        ParameterError: it cannot be made.
    """

    def __init__(self, folder: str | Path, study: str, seed: int, width: int, methods: int) -> None:
        """Claim the folder."""
        self._folder, self._shape = Path(folder), (width, methods)
        mine = {"format": FORMAT, "study": study, "seed": seed, "width": width, "methods": methods}
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._claim(mine)
        except OSError as error:
            msg = f"folder = {str(folder)!r} cannot be used: {error.strerror}"
            raise ParameterError(msg) from None
        self._path = self._folder / f"runs-{uuid.uuid4().hex}.bin"
        self._file = -1

    def _claim(self, mine: dict[str, object]) -> None:
        label = self._folder / LABEL
        if not label.exists():
            # Drafts of labels may be there, of processes that begin at the same time or have died.
            others = [file.name for file in self._folder.iterdir() if not file.name.startswith(LABEL)]
            if others:
                msg = f"{self._folder}: is not empty and holds no study ({min(others)}); name another folder"
                raise StateError(msg)
            draft = self._folder / f"{LABEL}.{uuid.uuid4().hex}"
            draft.write_text(json.dumps(mine), encoding="utf-8")
            draft.replace(label)
        try:
            theirs = json.loads(label.read_text(encoding="utf-8"))
        except ValueError:
            theirs = None
        if not isinstance(theirs, dict):
            msg = f"{label}: is not the label of a study; name another folder"
            raise StateError(msg)
        for name, value in mine.items():
            if theirs.get(name) != value:
                what = {"seed": f"a study with seed {theirs.get('seed')}", "format": "a study of another version"}
                msg = f"{self._folder}: holds {what.get(name, 'another study')}; name another folder"
                raise StateError(msg)

    def parts(self) -> list[Part]:
        """Return what is there, in no particular order; some runs may be there twice."""
        files = sorted(self._folder.glob("runs-*.bin"))
        parts = (part for file in files for part in records(file.read_bytes()))
        return [part for part in parts if (part.values.shape[1], part.seconds.shape[1]) == self._shape]

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
