"""Ranges of files far away, kept in a folder: several processes share it, and what was used least recently goes."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import threading
import time
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

_ENDING: Final = ".range"
_TEMPORARY: Final = ".tmp"
# Bytes of the checksum behind what is kept.
_SUM: Final = 4
# After writing such a part of the budget a process looks at what others wrote.
_LOOK: Final = 16
# Seconds after which a file that was not finished belongs to a process that was killed.
_STALE: Final = 3600.0


class PageCache:
    """The ranges of one file in a folder that others may use, too.

    A range is one file, written beside its place and then renamed: whoever reads it finds all of it or nothing. Its
    checksum is behind it. Errors of the disk are no errors of reading: what cannot be kept is not kept.
    """

    def __init__(self, folder: str | os.PathLike[str], budget: int, names: Iterable[str]) -> None:
        self._root, self._budget = Path(folder), budget
        self._folder = self._root / hashlib.sha256("\0".join(names).encode()).hexdigest()[:32]
        self._lock = threading.Lock()
        # Looks with the first range.
        self._until_look = 0
        self._root.mkdir(parents=True, exist_ok=True)

    def _place(self, start: int, end: int) -> Path:
        return self._folder / f"{start}-{end}{_ENDING}"

    def get(self, start: int, end: int) -> bytes | None:
        """Return a range, if it is there and whole."""
        place = self._place(start, end)
        try:
            found = place.read_bytes()
        except OSError:
            return None
        data, kept = found[:-_SUM], found[-_SUM:]
        if len(data) != end - start or zlib.crc32(data).to_bytes(_SUM, "little") != kept:
            with contextlib.suppress(OSError):
                place.unlink()
            return None
        with contextlib.suppress(OSError):
            os.utime(place)
        return data

    def put(self, start: int, end: int, data: bytes) -> None:
        """Keep a range."""
        size = len(data) + _SUM
        if size > self._budget:
            return
        self._make_room(size)
        with contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(_TEMPORARY, dir=self._folder)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(data)
                    file.write(zlib.crc32(data).to_bytes(_SUM, "little"))
                os.replace(name, self._place(start, end))
            except BaseException:
                with contextlib.suppress(OSError):
                    os.unlink(name)
                raise

    def _make_room(self, size: int) -> None:
        """Before so many bytes are written, see to it that they fit; now and then."""
        # In a process that was forked nobody may give it back.
        if not self._lock.acquire(timeout=1.0):
            return
        try:
            self._until_look -= size
            if self._until_look >= 0:
                return
            held = self._evict(max(self._budget - self._budget // _LOOK - size, 0))
            # Half of the room that is left, since others may fill it as well.
            self._until_look = max(self._budget - size - held, 0) // 2
        finally:
            self._lock.release()

    def _evict(self, most: int) -> int:
        """Remove what was used least recently until no more than so many bytes are left; return how many are."""
        found: list[tuple[float, int, str]] = []
        now = time.time()
        for path in self._files():
            try:
                status = path.stat()
            except OSError:
                continue
            if path.suffix == _TEMPORARY and now - status.st_mtime > _STALE:
                with contextlib.suppress(OSError):
                    path.unlink()
            else:
                found.append((status.st_mtime, status.st_size, str(path)))
        held = sum(size for _, size, _ in found)
        for _, size, name in sorted(found):
            if held <= most:
                break
            if not name.endswith(_ENDING):
                continue
            with contextlib.suppress(OSError):
                os.unlink(name)
                held -= size
        return held

    def _files(self) -> list[Path]:
        """What is in the folders of all files."""
        out = []
        with contextlib.suppress(OSError):
            for folder in self._root.iterdir():
                with contextlib.suppress(OSError):
                    out += [path for path in folder.iterdir() if path.suffix in {_ENDING, _TEMPORARY}]
        return out
