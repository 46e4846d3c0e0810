"""Where a live run stands, as one file: input, unfinished scans, tracker and outputs.

| bytes | content                                                                        |
|-------|--------------------------------------------------------------------------------|
| 8     | mark                                                                           |
| 4     | version, u32 little-endian as all numbers here                                 |
| 8 8 8 | lengths of head H, of the tracker at the beginning B, of the tracker now T     |
| H     | JSON: offsets, counts, unfinished rows, names of columns                       |
| B     | the tracker at the beginning, as `to_bytes` gives it                           |
| T     | the tracker now                                                                |
| 16    | BLAKE2b of all before                                                          |

The tracker at the beginning tells whether a run that wants to go on is the same run. It is compared after both have
been read and written by the same version, so that a newer version goes on with the files of an older one.
"""

from __future__ import annotations

import hashlib
import json
import stat
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from trackrs.errors import StateError
from trackrs.live._files import StreamError, replace_file

if TYPE_CHECKING:
    from pathlib import Path

MARK = b"\x93live\r\n\x1a"
FRAME = struct.Struct("<8sI3Q")
VERSION = 1
SUM = 16


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """Where a run stands.

    Attributes:
        head: everything but the tracker, as JSON has it.
        begun: bytes of the tracker at the beginning.
        tracker: bytes of the tracker now.
    """

    head: dict[str, Any]
    begun: bytes
    tracker: bytes

    def to_bytes(self) -> bytes:
        """Return the file's content."""
        head = json.dumps(self.head, allow_nan=False, separators=(",", ":")).encode()
        sizes = (len(head), len(self.begun), len(self.tracker))
        body = b"".join([FRAME.pack(MARK, VERSION, *sizes), head, self.begun, self.tracker])
        return body + hashlib.blake2b(body, digest_size=SUM).digest()

    @classmethod
    def from_bytes(cls, data: bytes) -> Checkpoint:
        """Return what the bytes say.

        Raises:
            StateError: they are truncated, altered, foreign or of another version.
        """
        if len(data) < FRAME.size + SUM or not data.startswith(MARK):
            raise StateError("is no checkpoint of a live run, or was cut off")
        _, version, *sizes = FRAME.unpack_from(data)
        if version != VERSION:
            raise StateError(f"is of version {version}, this program reads version {VERSION}")
        whole = len(data) == FRAME.size + sum(sizes) + SUM
        if not whole or hashlib.blake2b(data[:-SUM], digest_size=SUM).digest() != data[-SUM:]:
            raise StateError("is damaged: it was cut off or altered, and nothing of it is used")
        head, begun = FRAME.size + sizes[0], FRAME.size + sizes[0] + sizes[1]
        try:
            content = json.loads(data[FRAME.size : head])
        except (ValueError, RecursionError):
            content = None
        if not isinstance(content, dict):
            raise StateError("is no checkpoint of a live run")
        return cls(content, data[head:begun], data[begun:-SUM])

    def save(self, path: Path) -> None:
        """Write the file whole, in place of the one before.

        Raises:
            StreamError: it cannot be written; the one before is untouched.
        """
        replace_file(path, self.to_bytes())

    @classmethod
    def load(cls, path: Path) -> Checkpoint | None:
        """Return what the file says; None if there is none.

        Raises:
            StateError: it is damaged or no checkpoint.
            StreamError: it cannot be read.
        """
        try:
            data = path.read_bytes() if stat.S_ISREG(path.lstat().st_mode) else None
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StreamError(f"{path}: cannot be read: {error.strerror}") from None
        if data is None:
            raise StreamError(f"{path}: is no file, and checkpoints follow no links; name a file")
        try:
            return cls.from_bytes(data)
        except StateError as error:
            raise StateError(f"{path}: {error}; restore it, or remove it and the outputs to begin anew") from None
