"""A stream of bytes cut into lines, and where each begins."""

from __future__ import annotations

import zlib
from typing import Any, NamedTuple

from trackrs.live._rows import Refused, parse

TAIL = 4096  # bytes before an offset whose checksum tells whether a stream is the one it was
SHOWN = 200  # bytes of a line that a dead letter shows


class Record(NamedTuple):
    """One record of the stream.

    Attributes:
        number: of the line, or of the row of an Arrow stream, from 1.
        offset: where it begins, bytes.
        fields: names and values; what was wrong with it, if it cannot be read.
        text: the beginning of the line; empty for a row of an Arrow stream.
    """

    number: int
    offset: int
    fields: dict[str, Any] | Refused
    text: bytes


class Lines:
    """Cuts a stream of newline-delimited JSON into records; what is not yet a whole line waits for its rest.

    Args:
        longest: bytes of the longest line that is read; of a longer one only the beginning is kept.
        depth: deepest nesting that is read.
        offset: where in the stream the bytes begin.
        number: lines before that.
        tail: the last bytes before that.
    """

    def __init__(self, longest: int, depth: int, offset: int = 0, number: int = 0, tail: bytes = b"") -> None:
        self.offset, self.number, self.tail = offset, number, tail[-TAIL:]
        self._longest, self._depth = longest, depth
        self._rest = bytearray()  # of a line that is too long, beginning and end
        self._length = 0  # of the rest, what was thrown away included

    @property
    def waiting(self) -> int:
        """Bytes of the line that is not yet whole."""
        return self._length

    def feed(self, data: bytes) -> list[Record]:
        """Return the records that are whole now. Blank lines are skipped."""
        first, *others = data.split(b"\n")
        if not others:
            self._keep(first)
            return []
        begun = bytes(self._rest)
        lines = [(begun + first, self._length + len(first)), *((line, len(line)) for line in others[:-1])]
        self.tail = (self.tail + begun + data[: len(data) - len(others[-1])])[-TAIL:]
        self._rest, self._length = bytearray(), 0
        self._keep(others[-1])
        return [record for line, length in lines if (record := self._record(line, length, 1)) is not None]

    def end(self) -> list[Record]:
        """Return the last line, which nothing ended."""
        line, length = bytes(self._rest), self._length
        self._rest, self._length = bytearray(), 0
        self.tail = (self.tail + line)[-TAIL:]
        record = self._record(line, length, 0) if length else None
        return [] if record is None else [record]

    def _keep(self, data: bytes) -> None:
        self._length += len(data)
        self._rest += data
        if self._length > self._longest and len(self._rest) > SHOWN + TAIL:
            # The beginning is shown, the end is part of the stream's tail.
            del self._rest[SHOWN:-TAIL]

    def _record(self, line: bytes, length: int, ended: int) -> Record | None:
        offset, self.offset = self.offset, self.offset + length + ended
        self.number += 1
        fields: dict[str, Any] | Refused
        if length > self._longest:
            fields = Refused("too_long", f"has {length} bytes, {self._longest} are allowed")
        elif not line.strip():
            return None
        else:
            try:
                fields = parse(line, self._depth)
            except Refused as refused:
                fields = refused
        return Record(self.number, offset, fields, line[:SHOWN])


def checksum(tail: bytes) -> int:
    """Return what a checkpoint knows of the bytes before its offset."""
    return zlib.crc32(tail[-TAIL:])
