"""Files that are written to URLs: made on disk, then sent, and seen when they are whole.

What is sent to a store goes in parts, several at once. The store joins them in one step, and drops them when
something goes wrong. A file that was there before stays until then.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import tempfile
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final
from urllib.parse import urlsplit

from nanite_rs import _advice, _remote, _sources
from nanite_rs._progress import Progress, reporter
from nanite_rs.exceptions import ArgumentError, FileError, ForkError, UsageWarning

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    Report = Callable[[int, int], object] | None

# S3 takes parts from 5 MiB. Smaller ones cost more requests, larger ones memory: each part on its way is in it.
PART: Final = 8 << 20
# S3, its relatives and Google take so many; Azure takes more.
MOST_PARTS: Final = 10_000
# Parts that are on their way at once: one connection is seldom as fast as the line.
PARTS_AT_ONCE: Final = 8
# How often a request is tried again, with pauses from a tenth of a second up to 15 seconds: for about a minute.
RETRIES: Final = 10
# The same before anything is built, when somebody waits: for about a second.
_RETRIES_BEFORE: Final = 3
# Bytes each second of the slowest line that a part gets through in time: 1 Mbit/s.
_SLOWEST: Final = 125_000


def part_size(total: int) -> int:
    """Bytes of each part but the last, of a file of so many bytes."""
    return max(PART, -(-total // MOST_PARTS))


class _Stopped(Exception):  # noqa: N818
    """Somebody does not want the rest to be sent."""


class _Parts:
    """The parts of a file, until somebody stops them."""

    def __init__(self, file: BinaryIO, total: int) -> None:
        self._file, self.total = file, total
        self.size = part_size(total)
        """Bytes of each but the last."""
        self.given = 0
        """Bytes that were taken to be sent."""
        self.stopped = False

    def __iter__(self) -> Iterator[bytes]:
        while True:
            if self.stopped:
                # obstore drops what has arrived, and raises this.
                raise _Stopped
            if not (data := self._file.read(self.size)):
                return
            self.given += len(data)
            yield data


class _Bucket(_sources.ObjectStore):
    """An object that obstore writes."""

    use, absent = "writing", "there is no such bucket or container"

    def __init__(self, url: str, options: Mapping[str, Any], retries: int, part: int = 0) -> None:
        pauses = {"max_retries": retries, "retry_timeout": timedelta(minutes=10)}
        # The time of a request is that of a part on its way, beside the others.
        seconds = 30 + PARTS_AT_ONCE * part // _SLOWEST
        super().__init__(url, {"retry_config": pauses, **options}, {"timeout": f"{seconds}s"})

    def put(self, data: Any, part: int = PART) -> None:
        try:
            self._claim()
            self._obstore.put(self._store, self._path, data, chunk_size=part, max_concurrency=PARTS_AT_ONCE)
        except (_Stopped, ForkError):
            raise
        except Exception as error:  # obstore's own and Python's
            raise self._refusal(error) from None


class _Target:
    """Where a file is sent to."""

    name: str
    """What errors call it."""
    local: Path | None = None
    """Where it is on this machine."""
    ahead = 0
    """Bytes that are taken before the first of them have arrived."""
    sent = False

    def try_out(self) -> None:
        """Raise `Refusal` where it cannot be written, if that can be found out without a trace."""

    def put(self, parts: _Parts) -> None:
        """Write it, whole or not at all; raise `Refusal`."""
        raise NotImplementedError

    def send(self, path: Path, report: Report) -> None:
        """Write a file while this thread looks at signals and says how far it is."""
        with path.open("rb") as file:
            parts = _Parts(file, path.stat().st_size)

            def work() -> None:
                self.put(parts)
                self.sent = True

            def stop() -> None:
                parts.stopped = True

            def meanwhile() -> None:
                if report is not None:
                    report(max(parts.given - self.ahead * parts.size, 0), parts.total)

            _remote.watched(work, stop, meanwhile)
        if report is not None:
            report(parts.total, parts.total)


class _ToStore(_Target):
    """An object of a store that obstore knows."""

    def __init__(self, url: str, options: Mapping[str, Any]) -> None:
        self._url, self._options = url, options
        self._before = _Bucket(url, options, _RETRIES_BEFORE)
        self.name, self.ahead = self._before.name, PARTS_AT_ONCE

    def try_out(self) -> None:
        """Begin an upload in parts and drop it: it needs the bucket and the right to write, and leaves nothing."""
        nothing = _Parts(io.BytesIO(), 0)
        nothing.stopped = True
        with contextlib.suppress(_Stopped):
            _remote.watched(lambda: self._before.put(nothing))

    def put(self, parts: _Parts) -> None:
        bucket = _Bucket(self._url, self._options, RETRIES, parts.size)
        # One part needs one request.
        bucket.put(b"".join(parts) if parts.total <= parts.size else parts, parts.size)


class _ToFileSystem(_sources.FileSystem, _Target):
    """A file of a file system that fsspec knows. What could be tried out without a trace depends on it."""

    use, absent = "writing", "there is no such folder"

    def __init__(self, url: str, options: Mapping[str, Any]) -> None:
        # Of its own: what others write by the same file system is not part of the transaction.
        super().__init__(url, {"skip_instance_cache": True, **options})
        protocols = self._files.protocol
        if "file" in ((protocols,) if isinstance(protocols, str) else protocols):
            # It is written as those of paths are: beside the target, and renamed.
            self.local = Path(self._path)

    def put(self, parts: _Parts) -> None:
        with self._plain_errors(), self._files.transaction, self._files.open(self._path, "wb") as target:
            for data in parts:
                target.write(data)


def _target(url: str, options: Mapping[str, Any]) -> _Target:
    scheme = _sources.written_scheme(url)
    if scheme not in _sources.STORES:
        return _ToFileSystem(url, options)
    if not urlsplit(url).path.strip("/"):
        raise ArgumentError(f"path: {_sources.shown(url)} names a bucket and no file in it")
    return _ToStore(url, options)


@contextlib.contextmanager
def written(
    where: str,
    options: Mapping[str, Any] | None = None,
    *,
    folder: str | None = None,
    progress: Progress = None,
) -> Iterator[Path]:
    """Yield where a file is made: a path itself, or of a URL one that is sent when the block has ended well.

    Before, it is tried out whether the URL can be written. A file that cannot be sent is kept.

    Parameters
    ----------
    where : str
        A path or a URL.
    options : mapping, optional
        Of a URL: what its store or file system takes.
    folder : str, optional
        Where the file of a URL is made; by default where temporary files are.
    progress : bool or callable, optional
        Who is told how much has been sent.
    """
    known = _sources.checked_options(where, options)
    if not _sources.is_url(where):
        yield Path(where)
        return
    target = _target(where, known)
    if target.local is not None:
        yield target.local
        return
    try:
        target.try_out()
    except _sources.Refusal as refusal:
        raise _sources.raised(refusal, target.name) from None
    try:
        place = Path(tempfile.mkdtemp(prefix="nanite-", dir=folder))
    except OSError as error:
        raise FileError(f"{error.filename or folder}: {error.strerror or error}") from error
    path = place / os.path.basename(target.name.partition("?")[0])
    try:
        yield path
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
    try:
        with reporter(progress, "uploading") as report:
            target.send(path, report)
    except _sources.Refusal as refusal:
        raise refusal.kind(f"{target.name}: {refusal}; the file that was made is kept: {path}") from None
    except BaseException:
        if target.sent:  # before whatever this is
            shutil.rmtree(place, ignore_errors=True)
            raise
        message = f"{target.name}: not written; the file that was made is kept: {path}"
        _advice.warn(message, UsageWarning)
        raise
    shutil.rmtree(place, ignore_errors=True)
