"""Where tiles go: a folder, or one of an object store."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from nanite_rs import _checks, _sources
from nanite_rs._images import beside
from nanite_rs._work_store import WorkStore
from nanite_rs.exceptions import FileError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ROOT: Final = "tileset.json"
"""The file that viewers open; it is written last."""
CONTENT, SUBTREES, IMAGES = "content", "subtrees", "images"
"""Folders beside it."""


class Target(Protocol):
    """What takes files by their names."""

    where: str

    def write(self, name: str, data: bytes) -> None:
        """Write a file."""


class _Folder:
    def __init__(self, folder: Path) -> None:
        self.where, self._folder = str(folder / ROOT), folder

    def write(self, name: str, data: bytes) -> None:
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside(str(path)) as temporary:
            Path(temporary).write_bytes(data)


class _Store:
    def __init__(self, url: str, store: WorkStore) -> None:
        self.where, self._store = f"{url.rstrip('/')}/{ROOT}", store

    def write(self, name: str, data: bytes) -> None:
        path = self._store.here / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        self._store.send([name])
        path.unlink()


@contextmanager
def opened(folder: object, options: Mapping[str, Any] | None, overwrite: bool) -> Iterator[Target]:
    """Yield a folder that holds no tileset, or one that may be replaced."""
    if _sources.is_url(folder):
        url, given = str(folder), _sources.checked_options(folder, options)
        with tempfile.TemporaryDirectory(prefix="nanite-tiles-") as here:
            store = WorkStore(url, given, Path(here))
            if store.holds(ROOT):
                if not overwrite:
                    raise _exists(url)
                store.drop([ROOT])
                old = tuple(f"{name}/" for name in (CONTENT, SUBTREES, IMAGES))
                store.drop(name for name in store.names() if name.startswith(old))
            yield _Store(url, store)
        return
    path = Path(_checks.path_of(folder, "folder"))
    if (path / ROOT).exists():
        if not overwrite:
            raise _exists(str(path))
        (path / ROOT).unlink()
        for name in (CONTENT, SUBTREES, IMAGES):
            shutil.rmtree(path / name, ignore_errors=True)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(error.errno, error.strerror, str(path)) from None
    yield _Folder(path)


def _exists(where: str) -> FileError:
    return FileError(f"{where}: holds a tileset; give overwrite=True to replace it")
