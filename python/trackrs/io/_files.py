"""A table file: CSV or Parquet in, errors that say where; and files written whole or not at all."""

from __future__ import annotations

import contextlib
import csv
import difflib
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from trackrs.errors import TrackrsError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from types import ModuleType

    import polars as pl
    from numpy.typing import NDArray

    from trackrs._arrays import FloatArray, IntArray

SUFFIXES = (".csv", ".parquet")


class TableError(TrackrsError, ValueError):
    """A table cannot be used; the message names file, line, column and remedy."""


def polars() -> ModuleType:
    """Return the module polars.

    Raises:
        ImportError: it is not installed; the message says how to.
    """
    try:
        import polars as pl  # noqa: PLC0415 (only tables need it)
    except ImportError:
        raise ImportError('tables need polars: pip install "trackrs[cli]"', name="polars") from None
    return pl


# --- reading ---


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A file as a data frame. Columns go by their place in it, because names may repeat; `header` has the names."""

    path: Path
    frame: pl.DataFrame
    header: tuple[str, ...]

    @classmethod
    def read(cls, path: Path) -> Table:
        if not path.exists():
            neighbours = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
            close = difflib.get_close_matches(path.name, neighbours, n=1)
            hint = f"did you mean {path.with_name(close[0])}?" if close else "check the name"
            raise TableError(f"{path}: no such file; {hint}")
        if path.is_dir():
            raise TableError(f"{path}: is a folder; name a table in it")
        suffix = table_suffix(path)
        try:
            if path.stat().st_size == 0:
                raise TableError(f"{path}: the file is empty; a table begins with the names of its columns")
            return cls._csv(path) if suffix == ".csv" else cls._parquet(path)
        except OSError as error:
            raise TableError(f"{path}: cannot be read: {error.strerror or error}") from None

    @classmethod
    def _csv(cls, path: Path) -> Table:
        pl = polars()
        try:
            frame = pl.read_csv(path, infer_schema=False)
        except pl.exceptions.NoDataError:
            raise TableError(f"{path}: the file is empty; a table begins with the names of its columns") from None
        except pl.exceptions.PolarsError as error:
            what = _csv_fault(path) or f": is no CSV table: {str(error).splitlines()[0]}"
            raise TableError(f"{path}{what}") from None
        header = tuple(name.strip() for name in next(_records(path)).cells)
        frame.columns = [str(i) for i in range(frame.width)]
        text = pl.col(pl.String).str.strip_chars()
        frame = frame.with_columns(pl.when(text != "").then(text)).with_row_index("row")
        frame = frame.filter(~pl.all_horizontal(pl.exclude("row").is_null()))
        # A line that ends early looks like one whose last cells are empty.
        if frame[:, -1].null_count() and (fault := _csv_fault(path)):
            raise TableError(f"{path}{fault}")
        return cls(path, frame, header)

    @classmethod
    def _parquet(cls, path: Path) -> Table:
        pl = polars()
        try:
            frame = pl.read_parquet(path)
        except pl.exceptions.PolarsError as error:
            raise TableError(f"{path}: is no Parquet table: {str(error).splitlines()[0]}") from None
        except pl.exceptions.PanicException:  # no Exception, hence not among the errors above
            raise TableError(f"{path}: is damaged: polars cannot read it; write it anew") from None
        header = tuple(frame.columns)
        frame.columns = [str(i) for i in range(frame.width)]
        return cls(path, frame.with_row_index("row"), header)

    def __len__(self) -> int:
        return self.frame.height

    def fail(self, what: str) -> NoReturn:
        raise TableError(f"{self.path}: {what}")

    def fail_at(self, row: int, column: str, what: str) -> NoReturn:
        raise TableError(f'{self.path}, {self.line(row)}, column "{column}": {what}')

    def line(self, row: int) -> str:
        """Where a row stands in the file."""
        index = int(self.frame["row"][int(row)])
        if self.path.suffix.lower() != ".csv":
            return f"row {index + 1}"
        for number, record in enumerate(_records(self.path)):
            if number == index + 1:
                return f"line {record.line}"
        return f"row {index + 1}"

    def column(self, name: str) -> pl.Series:
        if name not in self.header:
            close = difflib.get_close_matches(name, self.header, n=1)
            hint = f'; did you mean "{close[0]}"?' if close else ""
            what = f'no column "{name}"{hint} (there are: {", ".join(self.header)})'
            self.fail(f"{what}; rename one, or correct the name in the configuration")
        if self.header.count(name) > 1:
            self.fail(f'column "{name}" stands twice in the header; rename one of the two')
        return self.frame[str(self.header.index(name))]

    def text(self, name: str, rows: IntArray | None = None) -> list[str]:
        """A column of names, or some of its rows."""
        pl = polars()
        rows = np.arange(len(self)) if rows is None else rows
        series = self.column(name).gather(rows)
        absent = np.flatnonzero(series.is_null().to_numpy())
        if len(absent):
            self.fail_at(rows[absent[0]], name, "is empty; fill in or remove the row")
        out: list[str] = series.cast(pl.String).to_list()
        return out

    def numbers(self, name: str, rows: IntArray | None = None, *, missing: bool = False) -> FloatArray:
        """A column of finite numbers, or some of its rows; NaN where a cell is empty, if that is allowed."""
        pl = polars()
        series = self.column(name)
        rows = np.arange(len(self)) if rows is None else rows
        series = series.gather(rows)
        if not (series.dtype == pl.String or series.dtype.is_numeric() or series.dtype == pl.Null):
            self.fail(f'column "{name}" holds {series.dtype}, where numbers are needed; convert it')
        values = series.cast(pl.Float64, strict=False)
        text = np.flatnonzero((values.is_null() & series.is_not_null()).to_numpy())
        if len(text):
            self.fail_at(rows[text[0]], name, f'"{series[int(text[0])]}" is no number; correct or remove it')
        out = values.to_numpy().astype(np.float64)  # null becomes NaN
        infinite = np.flatnonzero(np.isinf(out))
        if len(infinite):
            remedy = "leave the cell empty if nothing was observed" if missing else "correct or remove the row"
            self.fail_at(rows[infinite[0]], name, f"{series[int(infinite[0])]} is not finite; {remedy}")
        absent = np.flatnonzero(np.isnan(out))
        if len(absent) and not missing:
            self.fail_at(rows[absent[0]], name, "has no number; fill in or remove the row")
        return out

    def counts(self, name: str) -> NDArray[np.uint64]:
        """A column of whole numbers."""
        pl = polars()
        series = self.column(name)
        values = series.cast(pl.UInt64, strict=False)
        wrong = np.flatnonzero(values.is_null().to_numpy())
        if len(wrong):
            cell = series[int(wrong[0])]
            shown = "an empty cell" if cell is None else f'"{cell}"'
            self.fail_at(wrong[0], name, f"{shown} is no whole number; correct or remove it")
        return values.to_numpy().astype(np.uint64)


@dataclass(frozen=True, slots=True)
class _Record:
    """A record of a CSV file and the line it begins on."""

    line: int
    cells: list[str]


def _records(path: Path) -> Iterator[_Record]:
    """The records of a CSV file as polars counts them: blank lines before the header do not count, later ones do."""
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        reader, line, begun = csv.reader(file), 1, False
        while True:
            try:
                cells = next(reader, None)
            except csv.Error:
                return
            if cells is None:
                return
            if cells or begun:
                yield _Record(line, cells)
                begun = True
            line = reader.line_num + 1


def _csv_fault(path: Path) -> str | None:
    """Where a CSV file breaks the rules, or None."""
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            try:
                line.decode("utf-8")
            except UnicodeDecodeError:
                return f", line {number}: is not UTF-8 text; save the table as UTF-8"
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader, start, width = csv.reader(file, strict=True), 1, 0
        try:
            for cells in reader:
                width = width or len(cells)
                if cells and len(cells) != width:
                    return f", line {start}: has {len(cells)} cells, the header {width}; complete or remove the line"
                start = reader.line_num + 1
        except csv.Error as error:
            return f", line {start}: {error}; look for a quote that is not closed"
    return None


# --- writing ---


def write_table(columns: Mapping[str, NDArray[Any]], file: Path, suffix: str) -> None:
    """Write columns into a file, as CSV or Parquet by `suffix`."""
    frame = polars().DataFrame(columns)
    if suffix == ".csv":
        frame.write_csv(file)
    else:
        frame.write_parquet(file)


def check_target(path: Path) -> None:
    """Refuse a path where no file can be, before the work that leads to it.

    Raises:
        TableError: it is a folder, or its folder does not exist.
    """
    if path.is_dir():
        raise TableError(f"{path}: is a folder; name a file in it")
    if not path.parent.is_dir():
        raise TableError(f"{path}: there is no folder {path.parent}; create it first")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a new file in the folder of `path` that takes its place at the end, and disappears if that is not reached.

    Raises:
        TableError: the file cannot be written.
    """
    check_target(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.touch()
    except OSError as error:
        raise TableError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise TableError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        part.unlink(missing_ok=True)


def table_suffix(path: Path) -> str:
    """Return the suffix of a table.

    Raises:
        TableError: it is neither CSV nor Parquet.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise TableError(f"{path}: tables end in {' or '.join(SUFFIXES)}, not in {suffix!r}; rename it")
    return suffix
