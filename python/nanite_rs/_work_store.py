"""Work folders in object stores: what a block reads is fetched, and what it made is sent.

The core works in a folder on disk. Where the work folder is a URL, each process has one of its own, and the store
has all files. So workers need not share a disk, and a build goes on from the store where its machine is gone.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol
from uuid import uuid4

from nanite_rs import _sources
from nanite_rs.exceptions import FileError, MissingFileError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

# Files that are on their way at once.
AT_ONCE: Final = 8
# Seconds between two looks at whether a task is still wanted: each is a request.
LOOK: Final = 5.0


class _Place(Protocol):
    """A folder of a store, by names below it."""

    name: str

    def put(self, path: Path, name: str) -> None: ...

    def get(self, name: str, path: Path) -> None: ...

    def names(self) -> Iterator[str]: ...

    def holds(self, name: str) -> bool: ...

    def drop(self, names: list[str]) -> None: ...

    def clear(self) -> None: ...


class _Bucket(_sources.ObjectStore):
    """A folder of a store that obstore knows."""

    use, absent = "writing", "there is no such bucket or container"

    def __init__(self, url: str, options: Mapping[str, Any]) -> None:
        pauses = {"max_retries": 10, "retry_timeout": timedelta(minutes=10)}
        super().__init__(url, {"retry_config": pauses, **options})

    def _key(self, name: str) -> str:
        return f"{self._path}/{name}"

    @contextmanager
    def _plain(self) -> Iterator[None]:
        self._claim()
        try:
            yield
        except OSError:  # of files on disk
            raise
        except Exception as error:  # obstore's own
            raise self._refusal(error) from None

    def put(self, path: Path, name: str) -> None:
        with self._plain():
            self._obstore.put(self._store, self._key(name), path)

    def get(self, name: str, path: Path) -> None:
        try:
            with self._plain():
                stream = self._obstore.get(self._store, self._key(name)).stream()
                with path.open("wb") as file:
                    for data in stream:
                        file.write(data)
        except FileNotFoundError as error:
            raise self._refusal(error) from None

    def names(self) -> Iterator[str]:
        with self._plain():
            for some in self._obstore.list(self._store, f"{self._path}/"):
                yield from (entry["path"][len(self._path) + 1 :] for entry in some)

    def holds(self, name: str) -> bool:
        try:
            with self._plain():
                self._obstore.head(self._store, self._key(name))
        except FileNotFoundError:
            return False
        return True

    def drop(self, names: list[str]) -> None:
        with self._plain(), suppress(FileNotFoundError):
            self._obstore.delete(self._store, [self._key(name) for name in names])

    def clear(self) -> None:
        if names := list(self.names()):
            self.drop(names)


class _Folder(_sources.FileSystem):
    """A folder of a file system that fsspec knows."""

    use, absent = "writing", "there is no such folder"

    def _key(self, name: str) -> str:
        return f"{self._path}/{name}"

    def put(self, path: Path, name: str) -> None:
        with self._plain_errors():
            self._files.makedirs(self._key(name).rpartition("/")[0], exist_ok=True)
            self._files.put_file(str(path), self._key(name))

    def get(self, name: str, path: Path) -> None:
        with self._plain_errors():
            self._files.get_file(self._key(name), str(path))

    def names(self) -> Iterator[str]:
        with self._plain_errors():
            self._files.invalidate_cache()
            for key in self._files.find(self._path):
                yield key.lstrip("/")[len(self._path.lstrip("/")) + 1 :]

    def holds(self, name: str) -> bool:
        with self._plain_errors():
            self._files.invalidate_cache()
            return bool(self._files.exists(self._key(name)))

    def drop(self, names: list[str]) -> None:
        with self._plain_errors(), suppress(FileNotFoundError):
            self._files.rm([self._key(name) for name in names])

    def clear(self) -> None:
        with self._plain_errors():
            self._files.invalidate_cache()
            if self._files.exists(self._path):
                self._files.rm(self._path, recursive=True)


class WorkStore:
    """The files of a work folder: some here, all in a store."""

    def __init__(self, url: str, options: Mapping[str, Any], here: Path) -> None:
        scheme = _sources.written_scheme(url)
        self.url, self.options, self.here = url, dict(options), here
        kind = _Bucket if scheme in _sources.STORES else _Folder
        self._place: _Place = kind(url.rstrip("/"), options)

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Raise what refusals are, with the name of the folder."""
        try:
            yield
        except _sources.Refusal as refusal:
            raise _sources.raised(refusal, self._place.name) from None

    def _each(self, work: Callable[[str], object], names: Iterable[str]) -> None:
        with self._named(), ThreadPoolExecutor(AT_ONCE) as threads:
            for _ in threads.map(work, names):
                pass

    def fetch(self, names: Iterable[str], *, again: bool = False, optional: bool = False) -> None:
        """Fetch files that are not here; ``again``, or that may have changed; ``optional``, or are nowhere."""

        def one(name: str) -> None:
            path = self.here / name
            if path.exists() and not again:
                return
            path.parent.mkdir(parents=True, exist_ok=True)
            # Several threads, or processes, may want it.
            aside = path.with_name(f"{path.name}-{uuid4().hex}.part")
            try:
                self._place.get(name, aside)
                aside.replace(path)
            except _sources.Refusal as refusal:
                if not (optional and refusal.kind is MissingFileError):
                    raise
            finally:
                aside.unlink(missing_ok=True)

        self._each(one, names)

    def send(self, names: Iterable[str]) -> None:
        """Send files that are here: the last one when all others are there."""
        *others, last = names
        self._each(lambda name: self._place.put(self.here / name, name), others)
        self._each(lambda name: self._place.put(self.here / name, name), [last])

    def names(self) -> set[str]:
        """Return the names of what is there."""
        with self._named():
            return set(self._place.names())

    def holds(self, name: str) -> bool:
        """Whether a file is there."""
        with self._named():
            return self._place.holds(name)

    def drop(self, names: Iterable[str]) -> None:
        """Remove files there."""
        some = sorted(names)
        if some:
            with self._named():
                self._place.drop(some)

    def remove(self) -> None:
        """Remove all there."""
        with self._named():
            self._place.clear()

    # --------------------------------------------------------------------------------------------- tokens

    def set(self, token: str) -> str:
        """Say that tasks are wanted; return what they are given to look at."""
        (self.here / token).touch()
        self.send([token])
        return token

    def clear(self, token: str) -> None:
        """Say that they are not."""
        (self.here / token).unlink(missing_ok=True)
        self.drop([token])

    def interrupt_check(self, token: str) -> Callable[..., None]:
        """Return what raises once a task is not wanted any more."""
        looked = -LOOK

        def check(*_: int) -> None:
            nonlocal looked
            now = time.monotonic()
            if now - looked < LOOK:
                return
            looked = now
            if not self.holds(token):
                raise FileError(f"{self._place.name}: {token} is not there: the task was cancelled")

        return check


class _Mirror:
    """The folder of a process, and who works in it."""

    def __init__(self) -> None:
        self.folder = tempfile.mkdtemp(prefix="nanite-work-")
        self.users = 0


_mirrors: dict[str, _Mirror] = {}
_lock = threading.Lock()


@contextmanager
def mirrored(url: str, options: Mapping[str, Any]) -> Iterator[WorkStore]:
    """Yield a work folder of this process, which it has until it works for another build, or ends."""
    with _lock:
        for other in [other for other, mirror in _mirrors.items() if other != url and not mirror.users]:
            shutil.rmtree(_mirrors.pop(other).folder, ignore_errors=True)
        if url not in _mirrors:
            _mirrors[url] = _Mirror()
        mirror = _mirrors[url]
        mirror.users += 1
    try:
        yield WorkStore(url, options, Path(mirror.folder))
    finally:
        with _lock:
            mirror.users -= 1


def forget() -> None:
    """Remove the folders of this process."""
    with _lock:
        for url in [url for url, mirror in _mirrors.items() if not mirror.users]:
            shutil.rmtree(_mirrors.pop(url).folder, ignore_errors=True)
