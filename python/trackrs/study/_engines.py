"""Who runs the chunks of a study: threads of this process, or a Dask cluster."""

from __future__ import annotations

import os
import time
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from trackrs import _trackrs
from trackrs.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from trackrs.study._shards import Part
    from trackrs.study._study import Chunk, Study

LOCAL_SECONDS = 0.1  # of a chunk: so much is lost when the process dies
REMOTE_SECONDS = 1.0  # at least so much, that sending it does not count
TRIAL_SECONDS = 0.2  # of runs that show how long one takes, before chunks are sent
PATIENCE = 0.15  # for runs in flight to leave off, seconds
RETRIES = 10  # of a chunk whose workers are lost


def processors() -> int:
    """Return how many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Cutter:
    """Cuts the runs that are still to do into chunks."""

    def __init__(self, todo: Sequence[tuple[int, int]]) -> None:
        """Take first and number of consecutive runs."""
        self._todo = list(reversed(todo))
        self._left = sum(runs for _, runs in todo)
        self._per_run: float | None = None

    def learn(self, seconds: float, runs: int) -> None:
        """Take note of how long runs take."""
        now = seconds / max(runs, 1)
        self._per_run = now if self._per_run is None else 0.5 * (self._per_run + now)

    def cut(self, seconds: float, workers: int = 0) -> tuple[int, int] | None:
        """Return first run and number of the next chunk, of about so many seconds.

        Towards the end smaller ones, so that none of so many workers waits long for the last; with 0 of equal size.
        """
        if not self._todo:
            return None
        size = 1.0 if self._per_run is None else seconds / max(self._per_run, 1e-9)
        if workers:
            size = min(size, self._left / (2 * workers))
        first, runs = self._todo.pop()
        count = max(1, min(int(size), runs))
        if count < runs:
            self._todo.append((first + count, runs - count))
        self._left -= count
        return first, count


def local(study: Study, seed: int, todo: Sequence[tuple[int, int]], workers: int) -> Generator[Part]:
    """Run in threads; the interpreter is free while they compute."""
    cutter, stop = Cutter(todo), _trackrs.StudyStop()
    running: set[Future[tuple[Part, float]]] = set()
    pool = ThreadPoolExecutor(workers, thread_name_prefix="study")

    def timed(chunk: Chunk) -> tuple[Part, float]:
        begun = time.perf_counter()
        part = chunk.study._run(seed, chunk.first, chunk.runs, stop)
        return part, time.perf_counter() - begun

    def fill() -> None:
        while len(running) < workers + 1:
            piece = cutter.cut(LOCAL_SECONDS, workers)
            if piece is None:
                return
            running.add(pool.submit(timed, study.chunk(seed, *piece)))

    try:
        fill()
        while running:
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                part, seconds = future.result()
                running.discard(future)
                cutter.learn(seconds, len(part.values))
                fill()
                yield part
    except GeneratorExit:
        raise
    except BaseException:
        # Ctrl-C, or a scenario that fails: what is finished is kept.
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
        done, _ = wait([future for future in running if not future.cancelled()], timeout=PATIENCE)
        yield from (future.result()[0] for future in done if future.exception() is None)
        raise
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)


def dask(study: Study, seed: int, todo: Sequence[tuple[int, int]], workers: int, client: Any) -> Generator[Part]:  # noqa: ANN401
    """Run on the workers of a Dask client, or of a local cluster that is started for it."""
    try:
        from distributed import Client, KilledWorker, LocalCluster, as_completed  # noqa: PLC0415 (only this engine needs it)
    except ImportError:
        msg = 'engine="dask" needs distributed: pip install "trackrs[dask]"'
        raise ImportError(msg) from None
    if not isinstance(client, Client | None):
        msg = f"client = {client!r} is invalid: must be a distributed.Client"
        raise ParameterError(msg)
    # Some runs here tell how many make a chunk.
    cutter, begun = Cutter(todo), time.perf_counter()
    while (spent := time.perf_counter() - begun) < TRIAL_SECONDS:
        piece = cutter.cut(min(TRIAL_SECONDS - spent, LOCAL_SECONDS))
        if piece is None:
            return
        now = time.perf_counter()
        part = study.chunk(seed, *piece).run()
        cutter.learn(time.perf_counter() - now, len(part.values))
        yield part
    with ExitStack() as stack:
        if client is None:
            cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
            client = stack.enter_context(Client(stack.enter_context(cluster)))
        chunks = {}
        while (piece := cutter.cut(REMOTE_SECONDS)) is not None:
            chunk = study.chunk(seed, *piece)
            chunks[client.submit(run_chunk, chunk, pure=False)] = (chunk, 0)
        try:
            finished = as_completed(list(chunks))
            for future in finished:
                chunk, lost = chunks.pop(future)
                if lost < RETRIES and isinstance(future.exception(), KilledWorker):
                    again = client.submit(run_chunk, chunk, pure=False)
                    chunks[again] = (chunk, lost + 1)
                    finished.add(again)
                    continue
                yield future.result()
        finally:
            client.cancel(list(chunks))


def run_chunk(chunk: Chunk) -> Part:
    """Run a chunk, wherever it is."""
    return chunk.run()
