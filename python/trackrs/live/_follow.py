"""A live run: read, make scans, step, write, and keep a checkpoint that says how far all of that is."""

from __future__ import annotations

import json
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trackrs.config import InputConfig
from trackrs.errors import InternalError, ParameterError, StateError, StrictError
from trackrs.live._arrow import Messages, is_arrow
from trackrs.live._checkpoint import Checkpoint
from trackrs.live._files import PATIENCE, Output, Source
from trackrs.live._lines import Lines, checksum
from trackrs.live._records import Limits, LiveRun
from trackrs.live._refusals import counted, dropped, refusals
from trackrs.live._rows import Refused, RowReader
from trackrs.live._scans import Assembler
from trackrs.live._tracks import track_lines
from trackrs.types import Ledger, Scan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from trackrs.live._lines import Record
    from trackrs.live._records import Tracker
    from trackrs.live._scans import OpenScan
    from trackrs.types import Tracks

ENOUGH = 1 << 20  # bytes of output that wait to be written


def _never() -> bool:
    return False


def follow(
    source: str | Path,
    tracker: Tracker,
    columns: Mapping[str, Sequence[str]],
    *,
    layout: InputConfig = InputConfig(),  # noqa: B008 (frozen)
    out: str | Path | Callable[[Tracks], object] = "-",
    dead_letters: str | Path | None = None,
    checkpoint: str | Path | None = None,
    every: float = 10.0,
    idle: float | None = None,
    wait: bool = True,
    limits: Limits = Limits(),  # noqa: B008 (frozen)
    stop: Callable[[], bool] = _never,
) -> LiveRun:
    """Track what comes in, until it ends or somebody says stop.

    With `checkpoint`, a run that was stopped or killed and is called again in the same way goes on where it was: the
    files `out` and `dead_letters` become, byte for byte, what they had been without the interruption.

    Args:
        source: a file, or "-" for standard input: one JSON object per line, or an Arrow IPC stream (needs pyarrow). To
            go on, standard input must come from its beginning again.
        tracker: the tracker at the beginning. It is left as it is; the result has the one that has seen the scans.
        columns: per sensor, the names of its measurement's components.
        layout: the other names.
        out: file for the confirmed tracks after every scan, one JSON object per line with the names of
            `Tracks.to_table`; "-": standard output; or a function that is called with them.
        dead_letters: file for lines that cannot be used and rows that the tracker refused.
        checkpoint: file that says where the run stands.
        every: seconds between two checkpoints; 0: as often as there is input.
        idle: complete a scan when nothing came for so many seconds. None: a row of a later time completes it, so that
            what comes out depends on the input alone.
        wait: whether a file may grow. If not, its end is the end, as that of standard input always is.
        limits: what is taken in at most.
        stop: asked ten times a second and between pieces of the input.

    Raises:
        StreamError: the input cannot be read, or is not that of the checkpoint; an output cannot be written, is a link,
            or holds something else.
        StateError: the checkpoint is damaged, or of another configuration; or a model in Python cannot be saved.
        ParameterError: two of the files are one.
        StrictError: the tracker is strict, and something was refused.

    Example:
        >>> import trackrs as tr
        >>> tracker = tr.MultiTargetTracker(
        ...     tr.ConstantVelocity(dims=2, accel_psd=0.1),
        ...     sensors={"radar": tr.PositionSensor(dims=2, std=1.0)},
        ...     initiator=tr.MofN(2, 3, max_speed=20.0),
        ... )
        >>> tr.live.follow("reports.ndjson", tracker, {"radar": ("x", "y")}, checkpoint="run.ckpt")  # doctest: +SKIP
    """
    for name, value in {"every": every, "idle": 0.0 if idle is None else idle}.items():
        if not value >= 0.0:
            raise ParameterError(f"{name} = {value} is invalid: must be seconds, not negative")
    into = None if callable(out) else out
    _distinct([source, into, dead_letters, checkpoint])
    path = None if checkpoint is None else Path(checkpoint)
    saved = None if path is None else Checkpoint.load(path)
    with ExitStack() as stack:
        run = _Run(tracker, columns, layout, limits, out if callable(out) else None)
        run.source = stack.enter_context(Source(source, wait=wait))
        head: dict[str, Any] = {}
        if saved is not None:
            try:
                head = run.restore(saved, tracker, (into is not None, dead_letters is not None))
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                text = str(error) if isinstance(error, StateError) else "is no checkpoint that this program has written"
                raise StateError(f"{path}: {text}") from None
        if into is not None:
            run.out = stack.enter_context(Output(into, *head.get("out", ())))
        if dead_letters is not None:
            run.dead = stack.enter_context(Output(dead_letters, *head.get("dead_letters", ())))
        if path is not None and saved is None:
            # From here on a restart knows that the outputs are its own.
            run.begun = tracker.to_bytes()
            run.save(path)
        ended = run.loop(path, every, idle, stop)
        return run.result(ended)


def _distinct(paths: Iterable[str | Path | None]) -> None:
    """Refuse one file in two roles."""
    seen: set[Path] = set()
    for path in paths:
        if path is None or str(path) == "-":
            continue
        place = Path(path).resolve()
        if place in seen:
            raise ParameterError(f"{path}: stands in two places; name another file")
        seen.add(place)


class _Run:
    """A live run and all that it holds."""

    source: Source

    def __init__(
        self,
        tracker: Tracker,
        columns: Mapping[str, Sequence[str]],
        layout: InputConfig,
        limits: Limits,
        call: Callable[[Tracks], object] | None,
    ) -> None:
        self.tracker, self.limits, self.call = tracker.copy(), limits, call
        self.names = json.loads(json.dumps({"columns": columns, "layout": asdict(layout)}))
        self.reader = RowReader(columns, layout)
        self.scans = Assembler(limits.waiting_rows, moving=bool(layout.platform))
        self.cut: Lines | Messages | None = None  # known when the first bytes are there
        self.out: Output | None = None
        self.dead: Output | None = None
        self.begun = b""
        self.begin = tracker.ledger
        self.lines = self.looks = self.stepped = self.track_rows = 0
        self.bad: Counter[str] = Counter()
        self.ignored: Counter[str] = Counter()
        self.ledger = tracker.ledger
        self.tracks: list[bytes] = []
        self.letters: list[bytes] = []
        self.size = 0

    # --- the loop ---

    def loop(self, path: Path | None, every: float, idle: float | None, stop: Callable[[], bool]) -> bool:
        """Go on until the input ends (True) or somebody says stop (False)."""
        heard = kept = time.monotonic()
        first, changed, ended = b"", False, False
        while not ended and not stop():
            data = self.source.read(min(PATIENCE, every or PATIENCE))
            now = time.monotonic()
            if data:
                heard, changed = now, True
                first += data
                if self.cut is not None or len(first) >= 4 or first[:1] != b"\xff":
                    self.take(self.cutter(first).feed(first))
                    first = b""
            elif data is None:
                ended = changed = True
                self.take(self.cutter(first).feed(first))
                self.take(self.cutter(b"").end())
                self.step(self.scans.all())
                self.finish()
            elif idle is not None and not self.scans.empty and now - heard >= idle:
                changed = True
                self.step(self.scans.all())
            self.flush()
            if path is not None and changed and now - kept >= every and not ended:
                self.save(path)
                kept, changed = time.monotonic(), False
        if path is None and not ended:
            # Nothing will go on from here: what has come is used.
            self.step(self.scans.all())
            self.finish()
            self.flush()
        if path is not None and changed:
            self.save(path)
        self.check()
        return ended

    def cutter(self, first: bytes) -> Lines | Messages:
        """What cuts the stream into records, by its first bytes."""
        if self.cut is None:
            limits = self.limits
            if is_arrow(first):
                self.cut = Messages(limits.waiting_rows, self.source.name)
            else:
                self.cut = Lines(limits.line_bytes, limits.depth)
        return self.cut

    def take(self, records: Iterable[Record]) -> None:
        """Make rows and scans of the records, and step the scans that are complete."""
        for record in records:
            self.lines += 1
            try:
                if isinstance(record.fields, Refused):
                    raise record.fields
                row = self.reader.row(record.fields)
                if row.ignored:
                    self.ignored[row.sensor] += 1
                    continue
                if done := self.scans.before(row.time):
                    self.step(done)
                self.scans.put(row, record.number, record.offset)
                self.looks += row.values is None
            except Refused as refused:
                self.bad[refused.code] += 1
                text = record.text.decode("utf-8", "backslashreplace") or str(record.fields)[:200]
                self.letter(record.number, record.offset, refused.code, refused.reason, text)

    def step(self, scans: Iterable[OpenScan]) -> None:
        """Give complete scans to the tracker and write what it says."""
        for scan in scans:
            try:
                found = self.tracker.step(Scan(scan.time, scan.values, scan.sensor, scan.platform))
            except StrictError:
                self.flush()  # what came before is as good as ever
                raise
            self.stepped += 1
            ledger, before = self.tracker.ledger, self.ledger
            if (ledger.late, ledger.duplicate, ledger.rejected) != (before.late, before.duplicate, before.rejected):
                self.tell(scan, found, before, ledger)
            self.ledger = ledger
            self.give(found)

    def finish(self) -> None:
        """Take in the scans that wait for earlier ones."""
        found = self.tracker.flush()
        before, self.ledger = self.ledger, self.tracker.ledger
        if counts := dropped(self.ledger) - dropped(before):
            reason = f"of the scans that waited at the end, the tracker refused {counted(counts)}"
            self.letter(self.lines, 0 if self.cut is None else self.cut.offset, "refused", reason, "")
        if len(found.scan_times):
            self.give(found)

    def give(self, found: Tracks) -> None:
        """Write tracks, or call with them."""
        if len(found):
            self.track_rows += len(found)
            if self.call is None:
                self.tracks.append(track_lines(found))
                self.size += len(self.tracks[-1])
        if self.call is not None:
            self.call(found)
        if self.size > ENOUGH:
            self.flush()

    # --- what goes out ---

    def tell(self, scan: OpenScan, found: Tracks, before: Ledger, after: Ledger) -> None:
        """Write the rows of a scan that the tracker dropped."""
        if self.dead is None:
            return
        for place, row, code, reason in refusals(scan, found, before, after, self.tracker):
            text = f"{scan.sensor} at {scan.time} s" if row is None else self.reader.shown(scan.time, scan.sensor, row)
            self.letter(*place, code, reason, text)

    def letter(self, line: int, offset: int, code: str, reason: str, text: str) -> None:
        """Write a line to the dead letters."""
        if self.dead is None:
            return
        record = {"line": line, "offset": offset, "code": code, "reason": reason, "text": text}
        self.letters.append(json.dumps(record).encode() + b"\n")
        self.size += len(self.letters[-1])
        if self.size > ENOUGH:
            self.flush()

    def flush(self) -> None:
        """Write what waits to be written."""
        if self.tracks and self.out is not None:
            self.out.write(b"".join(self.tracks))
        if self.letters and self.dead is not None:
            self.dead.write(b"".join(self.letters))
        self.tracks.clear()
        self.letters.clear()
        self.size = 0

    # --- the checkpoint ---

    def save(self, path: Path) -> None:
        """Write where the run stands, after the outputs are on the disk."""
        outputs = {"out": self.out, "dead_letters": self.dead}
        for output in outputs.values():
            if output is not None:
                output.sync()
        cut = self.cut
        place = [0, 0, checksum(b"")] if cut is None else [cut.offset, cut.number, checksum(cut.tail)]
        head = {
            **self.names,
            "arrow": isinstance(cut, Messages),
            "input": place,
            "scans": self.scans.to_json(),
            "counts": [self.lines, self.looks, self.stepped, self.track_rows],
            "bad": self.bad,
            "ignored": self.ignored,
            **{name: None if o is None else [o.offset, checksum(o.tail)] for name, o in outputs.items()},
        }
        Checkpoint(head, self.begun, self.tracker.to_bytes()).save(path)

    def restore(self, saved: Checkpoint, tracker: Tracker, outputs: tuple[bool, bool]) -> dict[str, Any]:
        """Stand where the checkpoint says, and return its head."""
        head = saved.head
        for name, here, option in zip(("out", "dead_letters"), outputs, ("tracks", "dead letters"), strict=True):
            if here is not (head[name] is not None):
                state = "with" if head[name] is not None else "without"
                raise StateError(f"was written by a run {state} an output for {option}; call it in the same way")
        same = {name: head[name] for name in self.names} == self.names
        if not same or type(tracker).from_bytes(saved.begun).to_bytes() != tracker.to_bytes():
            raise StateError(
                "was written with other models, parameters or columns; go on with those, or remove it and the outputs"
            )
        self.begun = saved.begun
        self.tracker = type(tracker).from_bytes(saved.tracker)
        self.scans.restore(head["scans"])
        self.lines, self.looks, self.stepped, self.track_rows = head["counts"]
        self.bad.update(head["bad"])
        self.ignored.update(head["ignored"])
        self.ledger = self.tracker.ledger
        offset, number, known = head["input"]
        if head["arrow"]:
            # The schema stands at the beginning, so the stream is gone through again.
            self.cut = Messages(self.limits.waiting_rows, self.source.name, offset, number, known)
        elif offset:
            tail = self.source.skip(offset, known)
            self.cut = Lines(self.limits.line_bytes, self.limits.depth, offset, number, tail)
        return {name: head[name] or () for name in ("out", "dead_letters")}

    # --- the books ---

    def rows_in(self) -> int:
        """Detections, and lines that cannot be read."""
        return self.lines - self.looks - sum(self.ignored.values())

    def booked(self) -> Ledger:
        """Where the rows went that the tracker got in this run; it may have seen others before."""
        now, begin = self.tracker.ledger, self.begin
        return Ledger(
            rows_in=now.rows_in - begin.rows_in,
            used=now.used - begin.used,
            late=now.late - begin.late,
            duplicate=now.duplicate - begin.duplicate,
            waiting=now.waiting - begin.waiting,
            rejected=dict(Counter(now.rejected) - Counter(begin.rejected)),
        )

    def check(self) -> None:
        """The conservation law: no row is lost and none is counted twice."""
        ledger = self.booked()
        booked = ledger.used + ledger.late + ledger.duplicate + ledger.waiting + sum(ledger.rejected.values())
        out = booked + sum(self.bad.values()) + self.scans.waiting
        if out != self.rows_in():
            raise InternalError(f"{self.rows_in()} rows came in and {out} were accounted for")

    def result(self, ended: bool) -> LiveRun:
        """Return what was done."""
        return LiveRun(
            tracker=self.tracker,
            ended=ended,
            offset=self.cut.offset if self.cut is not None else 0,
            rows_in=self.rows_in(),
            ledger=self.booked(),
            bad_lines=dict(self.bad),
            waiting=self.scans.waiting,
            looks=self.looks,
            ignored=dict(self.ignored),
            scans=self.stepped,
            track_rows=self.track_rows,
        )
