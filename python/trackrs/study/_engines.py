"""Who runs the chunks of a study: threads of this process, or a Dask cluster."""

from __future__ import annotations

import os
import time
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from trackrs.study._shards import Part
    from trackrs.study._study import Chunk, Study

LOCAL_SECONDS = 0.1  # of a chunk: so much is lost when the process dies
REMOTE_SECONDS = 1.0  # at least so much, that sending it does not count
RETRIES = 10  # of a chunk whose worker is lost


def processors() -> int:
    """Return how many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Cutter:
    """Cuts runs that are still to do into chunks of about so many seconds."""

    def __init__(self, todo: Sequence[int], seconds: float, workers: int) -> None:
        """Take runs in ascending order."""
        self._todo, self._at, self._target, self._workers = list(todo), 0, seconds, workers
        self._per_run: float | None = None

    def learn(self, seconds: float, runs: int) -> None:
        """Take note of how long runs take."""
        now = seconds / runs
        self._per_run = now if self._per_run is None else 0.5 * (self._per_run + now)

    def cut(self) -> tuple[int, int] | None:
        """Return first run and number of the next chunk."""
        left = len(self._todo) - self._at
        if left == 0:
            return None
        size = 1
        if self._per_run is not None:
            # Towards the end smaller ones, so that no worker waits long for the last.
            size = int(min(self._target / max(self._per_run, 1e-9), left / (2 * self._workers)))
        first, count = self._todo[self._at], 1
        while count < size and self._at + count < len(self._todo) and self._todo[self._at + count] == first + count:
            count += 1
        self._at += count
        return first, count


def local(study: Study, seed: int, todo: Sequence[int], workers: int) -> Iterator[Part]:
    """Run in threads; the interpreter is free while they compute."""
    cutter = Cutter(todo, LOCAL_SECONDS, workers)
    running: set[Future[tuple[Part, float]]] = set()
    pool = ThreadPoolExecutor(workers, thread_name_prefix="study")

    def timed(chunk: Chunk) -> tuple[Part, float]:
        begun = time.perf_counter()
        part = chunk.run()
        return part, time.perf_counter() - begun

    def fill() -> None:
        while len(running) < workers + 1:
            piece = cutter.cut()
            if piece is None:
                return
            running.add(pool.submit(timed, study.chunk(seed, *piece)))

    try:
        fill()
        while running:
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                running.discard(future)
                part, seconds = future.result()
                cutter.learn(seconds, len(part.values))
                fill()
                yield part
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def dask(study: Study, seed: int, todo: Sequence[int], workers: int, client: Any) -> Iterator[Part]:  # noqa: ANN401
    """Run on the workers of a Dask client, or of a local cluster that is started for it."""
    try:
        from distributed import Client, LocalCluster, as_completed  # noqa: PLC0415 (only this engine needs it)
    except ImportError:
        msg = 'engine="dask" needs distributed: pip install "trackrs[dask]"'
        raise ImportError(msg) from None
    with ExitStack() as stack:
        if client is None:
            cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
            client = stack.enter_context(Client(stack.enter_context(cluster)))
        # One run here tells how many make a chunk.
        cutter = Cutter(todo, REMOTE_SECONDS, workers)
        piece = cutter.cut()
        if piece is None:
            return
        begun = time.perf_counter()
        part = study.chunk(seed, *piece).run()
        cutter.learn(time.perf_counter() - begun, len(part.values))
        yield part
        chunks = []
        while (piece := cutter.cut()) is not None:
            chunks.append(study.chunk(seed, *piece))
        futures = client.map(run_chunk, chunks, pure=False, retries=RETRIES)
        for future in as_completed(futures):
            yield future.result()
            future.release()


def run_chunk(chunk: Chunk) -> Part:
    """Run a chunk, wherever it is."""
    return chunk.run()
