"""What a live run reads from and writes to."""

from __future__ import annotations

import contextlib
import os
import select
import stat
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from trackrs.errors import TrackrsError
from trackrs.live._lines import TAIL, checksum

if TYPE_CHECKING:
    from typing import Self

CHUNK = 1 << 16
POLL = 0.05  # seconds between two looks at the end of a file
PATIENCE = 0.1  # longest wait, seconds, before somebody asks whether to stop
FLAGS = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
NO_LINK = getattr(os, "O_NOFOLLOW", 0)


class StreamError(TrackrsError, OSError):
    """The input or an output of a live run cannot be used; the message names it."""

    __str__ = Exception.__str__


class Source:
    """The stream of bytes that comes in.

    Args:
        path: a file, or "-" for standard input.
        wait: whether a file may grow, so that its end is no end.

    Raises:
        StreamError: there is no such file, or it cannot be read.
    """

    def __init__(self, path: str | Path, *, wait: bool) -> None:
        self.name = "standard input" if str(path) == "-" else str(path)
        self.position = 0
        self._close = str(path) != "-"
        try:
            self._fd = os.open(path, os.O_RDONLY | FLAGS) if self._close else 0
            mode = os.fstat(self._fd).st_mode
        except OSError as error:
            raise StreamError(f"{self.name}: cannot be read: {error.strerror}") from None
        if stat.S_ISDIR(mode):
            self.close()
            raise StreamError(f"{self.name}: is a folder; name a file in it")
        self._regular = stat.S_ISREG(mode)
        # A file that is standard input ends where it ends, as it does for every command.
        self._wait = wait and self._close

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, if it is one that was opened here."""
        if self._close:
            os.close(self._fd)

    def read(self, patience: float = PATIENCE) -> bytes | None:
        """Return what is there; nothing, if nothing came for `patience` seconds; None at the end."""
        try:
            if not self._regular and sys.platform != "win32" and not select.select([self._fd], [], [], patience)[0]:
                return b""
            data = os.read(self._fd, CHUNK)
            shrunk = not data and self._regular and os.fstat(self._fd).st_size < self.position
        except OSError as error:
            raise StreamError(f"{self.name}: cannot be read: {error.strerror}") from None
        if shrunk:
            raise StreamError(f"{self.name}: became shorter than the {self.position} bytes that were read of it")
        self.position += len(data)
        if data:
            return data
        if not (self._regular and self._wait):
            return None
        time.sleep(min(POLL, patience))
        return b""

    def skip(self, offset: int, known: int) -> bytes:
        """Go to `offset` and return the bytes before it, whose checksum must be the known one.

        A file is gone through by a step, a stream by reading: it must come from its beginning again.
        """
        tail = b""
        if self._regular:
            size = os.fstat(self._fd).st_size
            if size >= offset:
                os.lseek(self._fd, max(offset - TAIL, 0), os.SEEK_SET)
                self.position = max(offset - TAIL, 0)
        while self.position < offset:
            try:
                data = os.read(self._fd, min(CHUNK, offset - self.position))
            except OSError as error:
                raise StreamError(f"{self.name}: cannot be read: {error.strerror}") from None
            if not data:
                raise StreamError(
                    f"{self.name}: ends at byte {self.position}, but the checkpoint stands at byte {offset}; "
                    "give the same input again, from its beginning"
                )
            self.position += len(data)
            tail = (tail + data)[-TAIL:]
        if checksum(tail) != known:
            raise StreamError(
                f"{self.name}: is not the input that the checkpoint has read: the bytes before {offset} differ; "
                "give the same input again, from its beginning, or remove the checkpoint to begin anew"
            )
        return tail


class Output:
    """A file that is written in order, or standard output.

    Args:
        path: the file, or "-" for standard output. A link is refused.
        offset: bytes to keep of a file that is there; a file without any must be new or empty.
        known: their checksum.

    Raises:
        StreamError: it cannot be written, holds something else, or another process writes it.
    """

    def __init__(self, path: str | Path, offset: int = 0, known: int | None = None) -> None:
        self.name = "standard output" if str(path) == "-" else str(path)
        self.offset, self.tail = 0, b""
        self._close = str(path) != "-"
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | FLAGS | NO_LINK, 0o666) if self._close else 1
            self.regular = self._close and stat.S_ISREG(os.fstat(self._fd).st_mode)
        except OSError as error:
            if self._close and Path(path).is_symlink():
                raise StreamError(f"{path}: is a link, and outputs follow none; name the file itself") from None
            raise StreamError(f"{self.name}: cannot be written: {error.strerror}") from None
        if self.regular:
            try:
                self._lock()
                self._cut(offset, known)
            except BaseException:
                os.close(self._fd)
                raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._close:
            os.close(self._fd)

    def _lock(self) -> None:
        """Keep a second run from writing the file."""
        if sys.platform == "win32":
            return
        import fcntl  # noqa: PLC0415 (not everywhere)

        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StreamError(f"{self.name}: is being written by another run; stop it first") from None
        except OSError:
            return  # a file system without locks

    def _cut(self, offset: int, known: int | None) -> None:
        """Keep the bytes that a checkpoint counts on, and none but those."""
        size = os.fstat(self._fd).st_size
        if known is None and size > 0:
            raise StreamError(
                f"{self.name}: is not empty, and there is no checkpoint that says how much of it to keep; "
                "remove it or name another file"
            )
        if size < offset:
            raise StreamError(
                f"{self.name}: has {size} bytes, but the checkpoint counts on {offset}; put the file back"
            )
        os.lseek(self._fd, max(offset - TAIL, 0), os.SEEK_SET)
        while len(self.tail) < min(offset, TAIL) and (data := os.read(self._fd, min(offset, TAIL) - len(self.tail))):
            self.tail += data
        if known is not None and checksum(self.tail) != known:
            raise StreamError(f"{self.name}: is not the file that the checkpoint counts on; put that one back")
        os.ftruncate(self._fd, offset)
        os.lseek(self._fd, offset, os.SEEK_SET)
        self.offset = offset

    def write(self, data: bytes) -> None:
        """Write all of it."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._fd, rest) :]
        except OSError as error:
            raise StreamError(f"{self.name}: cannot be written: {error.strerror}") from None
        self.offset += len(data)
        self.tail = (self.tail + data[-TAIL:])[-TAIL:]

    def sync(self) -> None:
        """Wait until the file is on the disk."""
        if self.regular:
            try:
                os.fsync(self._fd)
            except OSError as error:
                raise StreamError(f"{self.name}: cannot be written: {error.strerror}") from None


def replace_file(path: Path, data: bytes) -> None:
    """Write a file whole: under another name, to the disk, then into place. What was there stays until then.

    Raises:
        StreamError: it cannot be written; what was there is as it was.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        with contextlib.suppress(FileNotFoundError):
            part.unlink()
        fd = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | FLAGS | NO_LINK, 0o666)
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(fd, rest) :]
            os.fsync(fd)
        finally:
            os.close(fd)
        part.replace(path)
        if sys.platform != "win32":
            folder = os.open(path.parent, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise StreamError(f"{path}: cannot be written: {error.strerror}; what it held before is untouched") from None
