"""Files that are not on a local disk: what is asked of a source, when, and how it is kept.

`Reader` is between a source of `_sources` and the core: it looks into the cache on disk, joins ranges that lie near
each other, and asks for many at once on threads of its own.
"""

from __future__ import annotations

import itertools
import os
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeVar

from nanite_rs import _checks, _core, _sources
from nanite_rs._page_cache import PageCache
from nanite_rs._sources import Identity, Refusal, Source
from nanite_rs.exceptions import FileError
from nanite_rs.stats import TrafficStats

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from concurrent.futures import Future, ThreadPoolExecutor

T = TypeVar("T")
Range = tuple[int, int]

# A coded page has 25 to 65 KiB, and pages follow each other. So a gap of 128 KiB is two to four pages that nobody
# wants: they cost 10 ms at 100 Mbit/s, less than the way to a store and back.
GAP: Final = 128 << 10
# Of what a batch wants a quarter more is read at most: the smallest gaps are closed first.
WASTE: Final = 4
# Some 20 pages. What is longer comes as several requests at once: one connection is seldom as fast as the line.
MOST_REQUEST: Final = 1 << 20
# Requests that are on their way at once, of all meshes of a process.
AT_ONCE: Final = 32
# Pages that the core asks for as a batch, two batches at once: enough to join some, and to keep connections busy
# until the next batch. On a slow line fewer: what was asked for comes before what the next frame wants more.
BATCH: Final = 64
LEAST_BATCH: Final = 8
# Seconds that answers may take beyond the fastest one until the line counts as full.
QUEUED: Final = 0.2
# How often a range is asked for that fails for a passing reason. Pauses begin at 10 ms, about double, and are 5 to
# 10 seconds in all: servers that restart, and lines that are switched, are back by then.
TRIES: Final = 11
# The same of the first request, when somebody waits who may have mistyped the name of a server: 1.3 to 2.6 seconds.
OPENING_TRIES: Final = 9


# ------------------------------------------------------------------------------------------------- joining


@dataclass
class Joined:
    """Ranges that are read as one."""

    start: int
    end: int
    members: list[int] = field(default_factory=list)
    """Which of the ranges, in the order of the file."""
    wasted: int = 0
    """Bytes that nobody wants."""


def joined(ranges: Sequence[Range]) -> list[Joined]:
    """Join ranges that lie near each other; what has the most wanted range comes first.

    Ranges do not overlap. Those that touch are joined, and across gaps up to `GAP`, smallest first, until a quarter
    more would be read than is wanted. No joined range is longer than `MOST_REQUEST`.
    """
    order = sorted(range(len(ranges)), key=lambda i: ranges[i])
    room = sum(end - start for start, end in ranges) // WASTE
    gaps = sorted((ranges[b][0] - ranges[a][1], k) for k, (a, b) in enumerate(itertools.pairwise(order)))
    closed = set()
    for gap, k in gaps:
        if 0 <= gap <= min(GAP, room):
            closed.add(k)
            room -= gap
    out: list[Joined] = []
    for k, i in enumerate(order):
        start, end = ranges[i]
        if k - 1 in closed and end - out[-1].start <= MOST_REQUEST:
            out[-1].wasted += start - out[-1].end
            out[-1].end = end
            out[-1].members.append(i)
        else:
            out.append(Joined(start, end, [i]))
    return sorted(out, key=lambda one: min(one.members))


# ------------------------------------------------------------------------------------------------- threads

_threads: tuple[int, ThreadPoolExecutor] | None = None


def _pool() -> ThreadPoolExecutor:
    """The threads of this process: none is there in one that was forked."""
    global _threads  # noqa: PLW0603
    known = _threads
    if known is None or known[0] != os.getpid():
        from concurrent.futures import ThreadPoolExecutor

        known = (os.getpid(), ThreadPoolExecutor(AT_ONCE, thread_name_prefix="nanite-remote"))
        _threads = known
    return known[1]


def _awaited(future: Future[T], meanwhile: Callable[[], object] | None = None) -> T:
    """Wait for what another thread does while this one looks at signals."""
    from concurrent import futures

    while not future.done():
        futures.wait([future], timeout=0.05)
        if meanwhile is not None:
            meanwhile()
    return future.result()


def watched(
    work: Callable[[], T],
    stop: Callable[[], object] | None = None,
    meanwhile: Callable[[], object] | None = None,
) -> T:
    """Do it on a thread of its own while this one looks at signals.

    Where this one is interrupted, the other is left alone, or is told to stop and waited for.
    """
    from concurrent.futures import ThreadPoolExecutor

    thread = ThreadPoolExecutor(1, thread_name_prefix="nanite-watched")
    try:
        return _awaited(thread.submit(work), meanwhile)
    except BaseException:
        if stop is not None:
            stop()
        raise
    finally:
        thread.shutdown(wait=stop is not None)


class Pace:
    """How many pages may be asked for as a batch: half as many when a line is full, slowly more when it is not."""

    def __init__(self) -> None:
        self.batch = BATCH
        self._fastest, self._changed = float("inf"), 0.0

    def answered(self, begun: float, ended: float) -> None:
        """Take into account when a request began and ended, seconds."""
        took = ended - begun
        self._fastest = min(self._fastest, took)
        if took <= self._fastest + QUEUED:
            self.batch = min(self.batch + 2, BATCH)
        # Requests that were on their way when the batch became smaller say nothing of that.
        elif begun >= self._changed:
            self.batch = max(self.batch // 2, LEAST_BATCH)
            self._changed = ended


class Reader:
    """Reads batches of ranges for the core."""

    def __init__(self, source: Source, recipe: tuple[Any, ...] | None = None) -> None:
        self.source, self.traffic, self.recipe = source, _core.Traffic(), recipe
        self._pace = Pace()
        self.identity, self._head = self._waited(self._first)
        self._cache: PageCache | None = None
        self._opening, self._stopped = False, False

    def keep(self, folder: str, budget: int) -> None:
        """Keep what is read in a folder."""
        names = (self.source.name, str(self.identity.size), str(self.identity.tag))
        try:
            self._cache = PageCache(folder, budget, names)
        except OSError as error:
            raise FileError(error.errno, f"cache_dir: {error.strerror}", folder) from None

    def expect(self, identity: Identity) -> None:
        """Raise an error where it is another file."""
        try:
            identity.require(self.identity)
        except Refusal as refusal:
            raise _sources.raised(refusal, self.source.name) from None

    def stats(self) -> TrafficStats:
        """Return what reading has cost so far."""
        counts, latency_ms = self.traffic.counts()
        return TrafficStats(**dict(counts), latency_ms=latency_ms)

    def open(self, how: Callable[[_core.Input], T]) -> T:
        """Return what the core makes of the beginning, while this thread looks at signals."""
        size = self.identity.size
        given = _core.Input(self.source.name, size, self._pace.batch, TRIES, self.read, self.traffic)

        def stop() -> None:
            self._stopped = True
            given.stop()

        self._opening = True
        try:
            return watched(lambda: how(given), stop)
        finally:
            self._opening = False

    def _first(self) -> tuple[Identity, bytes]:
        found: tuple[Identity, bytes] = self._counted(
            lambda: self.source.first(_core.FIRST_READ), lambda found: len(found[1])
        )
        return found

    def _waited(self, work: Callable[[], Any]) -> Any:
        """Do it on a thread while this one looks at signals; passing errors are tried again."""
        for pause in [*_core.retry_pauses(OPENING_TRIES), None]:
            future: Future[Any] = _pool().submit(work)
            try:
                return _awaited(future)
            except Refusal as refusal:
                if not refusal.passing or pause is None:
                    raise _sources.raised(refusal, self.source.name) from None
                time.sleep(pause)
            finally:
                future.cancel()
        raise AssertionError  # the last pause is None

    def _counted(self, work: Callable[[], Any], size: Callable[[Any], int], wasted: int = 0) -> Any:
        start = time.perf_counter()
        try:
            found = work()
        except Refusal:
            self.traffic.request(seconds=time.perf_counter() - start, failed=True)
            raise
        end = time.perf_counter()
        self.traffic.request(seconds=end - start, read_bytes=size(found), joined_bytes=wasted)
        self._pace.answered(start, end)
        return found

    def read(self, ranges: list[Range], answers: _core.Answers) -> int:
        """Answer each range, later, from other threads. Return how many the next batch may have."""
        rest = []
        for i, (start, end) in enumerate(ranges):
            if end <= len(self._head):
                answers.give(i, self._head[start:end])
            else:
                rest.append(i)
        if rest and self._cache is not None:
            _pool().submit(self._look_up, ranges, rest, answers)
        elif rest:
            self._ask(ranges, rest, answers)
        # While it opens, the core waits for these and for nothing else: here it can be told to stop.
        while self._opening and any(answers.is_wanted(i) for i in rest):
            if self._stopped:
                for i in rest:
                    answers.fail(i, "ServerError", "opening was stopped", passing=False)
            time.sleep(0.002)
        return self._pace.batch

    def _look_up(self, ranges: list[Range], wanted: list[int], answers: _core.Answers) -> None:
        """Answer what the cache has, and ask for the rest."""
        rest = []
        for i in wanted:
            data = None if self._cache is None else self._cache.get(*ranges[i])
            if data is None:
                rest.append(i)
            else:
                self.traffic.cached(len(data))
                answers.give(i, data)
        self._ask(ranges, rest, answers)

    def _ask(self, ranges: list[Range], wanted: list[int], answers: _core.Answers) -> None:
        for one in joined([ranges[i] for i in wanted]):
            one.members = [wanted[k] for k in one.members]
            _pool().submit(self._request, one, ranges, answers)

    def _request(self, one: Joined, ranges: list[Range], answers: _core.Answers) -> None:
        wanted = [i for i in one.members if answers.is_wanted(i)]
        if not wanted:
            return
        try:
            data: bytes = self._counted(
                lambda: self.source.read(one.start, one.end, self.identity), len, one.wasted
            )
        except Refusal as refusal:
            for i in one.members:
                answers.fail(i, refusal.kind.__name__, str(refusal), refusal.passing)
            return
        except BaseException as error:  # every range has an answer
            for i in one.members:
                answers.fail(i, "InternalError", f"{type(error).__name__}: {error}", passing=False)
            raise
        for i in one.members:
            start, end = ranges[i]
            part = data[start - one.start : end - one.start]
            answers.give(i, part)
            if self._cache is not None:
                self._cache.put(start, end, part)


# ------------------------------------------------------------------------------------------------- opening


def opened(where: Any, cache_dir: Any, cache_bytes: int, storage_options: Mapping[str, Any] | None) -> Reader:
    """Return what reads a URL or a file object."""
    options = _sources.checked_options(where, storage_options, cache_dir)
    folder = None if cache_dir is None else os.path.abspath(_checks.path_of(cache_dir, "cache_dir"))
    budget = _checks.whole(cache_bytes, "cache_bytes", 0)
    recipe = (where, folder, budget, options) if _sources.is_url(where) else None
    reader = Reader(_sources.source_of(where, options), recipe)
    if folder is not None:
        reader.keep(folder, budget)
    return reader
