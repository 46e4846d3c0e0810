"""An Arrow IPC stream cut into records. Needs pyarrow.

A stream is a schema and then batches of rows, each in a message that says how long it is; pyarrow gets a message only
when all of it is there. Unlike a line, a damaged message cannot be left out: what comes after it cannot be found.

Small messages can stand for more than memory holds (compressed, views of one text a million times, rows of nothing):
such are refused before they are unpacked.
"""

from __future__ import annotations

import struct
from math import isnan
from typing import Any, NoReturn

import numpy as np

from trackrs.live._files import StreamError
from trackrs.live._lines import TAIL, Record, checksum

START = b"\xff\xff\xff\xff"
HEAD = 8  # bytes: the mark and the length of the metadata
METADATA, BODY = 1 << 20, 1 << 26  # most bytes of a message
NAME = 1000  # most bytes of a name of a sensor
DICTIONARY, BATCH = 2, 3  # kinds of messages


def is_arrow(first: bytes) -> bool:
    """Whether a stream begins as Arrow IPC does, and no UTF-8 text can."""
    return first.startswith(START)


def _pyarrow() -> Any:  # noqa: ANN401 (pyarrow has no types)
    try:
        import pyarrow as pa  # noqa: PLC0415 (only such streams need it)
    except ImportError:
        raise ImportError('Arrow streams need pyarrow: pip install "trackrs[arrow]"', name="pyarrow") from None
    return pa


class Messages:
    """Cuts an Arrow IPC stream into records.

    Args:
        longest: most rows of a batch.
        name: of the stream, for errors.
        skip_to: bytes that were done with before; the stream is gone through from its beginning again.
        number: rows in those.
        known: checksum of the end of those.
    """

    def __init__(self, longest: int, name: str, skip_to: int = 0, number: int = 0, known: int = 0) -> None:
        self._arrow = _pyarrow()
        self.offset, self.number, self.tail = 0, number, b""
        self._longest, self._name, self._skip_to, self._known = longest, name, skip_to, known
        self._buffer = bytearray()
        self._ready = _Ready()
        self._reader: Any = None

    def feed(self, data: bytes) -> list[Record]:
        """Return the records of the batches that are whole now."""
        self._buffer += data
        out: list[Record] = []
        while len(self._buffer) >= HEAD:
            length = self._length()
            if length is None or len(self._buffer) < length:
                break
            skipped = self.offset < self._skip_to
            message = bytes(self._buffer[:length])
            del self._buffer[:length]
            records = self._message(message, skipped=skipped)
            self.offset += length
            self.tail = (self.tail + message[-TAIL:])[-TAIL:]
            if skipped and self.offset >= self._skip_to and checksum(self.tail) != self._known:
                raise StreamError(f"{self._name}: is not the input that the checkpoint has read; give the same again")
            out += records
        return out

    def end(self) -> list[Record]:
        """Return nothing: batches are whole, or the stream was cut off."""
        if self.offset < self._skip_to:
            text = f"ends at byte {self.offset}, but the checkpoint stands at byte {self._skip_to}"
            raise StreamError(f"{self._name}: {text}; give the same input again")
        if self._buffer:
            self._fail("is cut off")
        return []

    def _fail(self, what: str) -> NoReturn:
        raise StreamError(f"{self._name}: the Arrow message at byte {self.offset} {what}")

    def _length(self) -> int | None:
        """Length of the message at the beginning of the buffer, if that is there."""
        mark, metadata = struct.unpack_from("<4si", self._buffer)
        if mark != START or not 0 <= metadata <= METADATA:
            self._fail("is damaged, or no message of an Arrow IPC stream")
        if metadata == 0 or len(self._buffer) < HEAD + metadata:
            return HEAD if metadata == 0 else None
        try:
            table = _Table.root(bytes(self._buffer[HEAD : HEAD + metadata]))
            kind, body = table.number(1, "<B"), table.number(3, "<q")
            if kind in {DICTIONARY, BATCH}:
                batch = table.table(2) if kind == BATCH else table.table(2).table(1)
                rows, compressed = batch.number(0, "<q"), batch.position(3) is not None
                if compressed or not 0 <= rows <= self._longest:
                    self._fail("is compressed" if compressed else f"has {rows} rows, {self._longest} are allowed")
        except (struct.error, IndexError):
            self._fail("is damaged")
        if not 0 <= body <= BODY:
            self._fail(f"has {body} bytes, {BODY} are allowed")
        return HEAD + int(metadata) + body

    def _message(self, message: bytes, *, skipped: bool) -> list[Record]:
        """The records of a message; none but batches have any."""
        if len(message) == HEAD:  # the end of a stream; another may follow
            self._reader = None
            return []
        self._ready.data += message
        records: list[Record] = []
        try:
            if self._reader is None:
                self._reader = self._arrow.ipc.open_stream(self._arrow.PythonFile(self._ready, mode="r"))
            elif _Table.root(message[HEAD:]).number(1, "<B") == BATCH:
                batch = self._reader.read_next_batch()
                batch.validate(full=True)
                if not skipped:
                    columns = {field.name: self._values(batch.column(i)) for i, field in enumerate(batch.schema)}
                    for row in range(batch.num_rows):
                        self.number += 1
                        fields = {name: values[row] for name, values in columns.items()}
                        records.append(Record(self.number, self.offset, fields, b""))
        except (self._arrow.ArrowException, StopIteration, OSError, struct.error, IndexError) as error:
            if isinstance(error, StreamError):
                raise
            self._fail(f"cannot be read: {str(error).splitlines()[0] if str(error) else 'is damaged'}")
        return records

    def _values(self, column: Any) -> list[Any]:  # noqa: ANN401 (pyarrow has no types)
        """The values of a column; what is neither number nor text is an empty list, as nothing else is asked for."""
        types, kind = self._arrow.types, column.type
        words = column.dictionary if types.is_dictionary(kind) else column
        if types.is_string(words.type) or types.is_large_string(words.type) or types.is_string_view(words.type):
            if self._longest_text(words) > NAME:
                self._fail(f"has a text of more than {NAME} bytes")
        elif not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_null(kind)):
            return [[]] * len(column)
        values: list[Any] = column.to_pylist()
        # NaN is "not observed", as it is in other tables; in lines of JSON that is null.
        return [None if isinstance(value, float) and isnan(value) else value for value in values]

    def _longest_text(self, texts: Any) -> int:  # noqa: ANN401
        if self._arrow.types.is_string_view(texts.type):
            views = np.frombuffer(texts.buffers()[1] or b"", "<i4")[4 * texts.offset :: 4]
            return int(views[: len(texts)].max(initial=0))
        import pyarrow.compute as pc  # noqa: PLC0415

        return int(pc.max(pc.binary_length(texts)).as_py() or 0)


class _Ready:
    """A file of what may be read now."""

    closed = False

    def __init__(self) -> None:
        self.data = bytearray()

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        size = len(self.data) if size < 0 else size
        out = bytes(self.data[:size])
        del self.data[:size]
        return out

    def close(self) -> None:
        self.closed = True


class _Table:
    """A table of a flatbuffer, as far as lengths are needed; reading beyond the bytes is a struct.error."""

    def __init__(self, data: bytes, at: int) -> None:
        self.data, self.at = data, at

    @classmethod
    def root(cls, data: bytes) -> _Table:
        return cls(data, _unpack("<I", data, 0))

    def position(self, field: int) -> int | None:
        """Where a field stands, if it does."""
        index = self.at - _unpack("<i", self.data, self.at)
        entry = 4 + 2 * field
        if entry >= _unpack("<H", self.data, index):
            return None
        offset = _unpack("<H", self.data, index + entry)
        return self.at + offset if offset else None

    def number(self, field: int, form: str) -> int:
        at = self.position(field)
        return 0 if at is None else _unpack(form, self.data, at)

    def table(self, field: int) -> _Table:
        at = self.position(field)
        if at is None:
            raise IndexError
        return _Table(self.data, at + _unpack("<I", self.data, at))


def _unpack(form: str, data: bytes, at: int) -> int:
    if at < 0:
        raise IndexError
    number: int = struct.unpack_from(form, data, at)[0]
    return number
