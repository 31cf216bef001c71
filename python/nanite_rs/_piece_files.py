"""Files that are read in pieces, some megabytes at a time, and many files as one source.

Text goes to the core's own readers, some lines at a time, so that numbers and errors are those of files that fit.
"""

from __future__ import annotations

import os
import re
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _piece_gltf, _piece_obj, _piece_ply, _piece_stl, io
from nanite_rs._flatten import flattened
from nanite_rs._pieces import ROWS, Spool, add_piece, settle_face_channels, spooled
from nanite_rs.exceptions import ArgumentError, DtypeError, FormatError, NaniteError
from nanite_rs.material import Material

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes, Source


#: Endings of files that are read in pieces.
ENDINGS: Final = ("ply", "stl", "obj", "glb", "gltf")
#: A file takes less memory to build than so many times its size, once it is not compressed.
_OF_SIZE: Final = 16


def fits(path: str, limit: int) -> bool:
    """Whether a file is read as a whole; one that cannot be looked at is, and whoever reads it says why not."""
    try:
        gltf = io.ending(Path(path)) in (("glb", False), ("gltf", False))
        size = _piece_gltf.size_of(path) if gltf else os.path.getsize(path)
    except (NaniteError, OSError):
        return True
    return size * _OF_SIZE <= limit


def of_file(path: str, folder: Path, notes: Notes) -> dict[str, NDArray[Any]]:
    """Read a file piece by piece, unless it was before.

    Raises
    ------
    FormatError
        It is none that can be read so.
    """
    one = _reader(path)

    def read(spool: Spool) -> None:
        one(path, spool, notes)
        spool.complete()
        settle_face_channels(spool, notes)

    return spooled([path], folder, read)


def _reader(path: str) -> Callable[[str, Spool, Notes], None]:
    ending, packed = io.ending(Path(path))
    if ending not in ENDINGS or packed:
        some = ", ".join(f".{name}" for name in ENDINGS)
        raise FormatError(
            f"{path}: {os.path.getsize(path):,} bytes; of files that may not fit in memory, only {some} are read"
        )
    return {"ply": _piece_ply.read, "stl": _piece_stl.read, "obj": _piece_obj.read}.get(
        ending, _piece_gltf.read
    )


def files_of(folder: str) -> list[str]:
    """Return the files of a folder that are meshes by their endings, in the order of the numbers in their names."""
    with os.scandir(folder) as found:
        names = [entry.name for entry in found if entry.is_file() and not entry.name.startswith(".")]
    names = [name for name in names if io.ending(Path(name))[0] in io.READERS]
    if not names:
        some = ", ".join(f".{name}" for name in sorted(io.READERS))
        raise ArgumentError(f"{folder}: there are no files in it that end in {some}")
    return [os.path.join(folder, name) for name in sorted(names, key=_natural)]


def _natural(name: str) -> tuple[Any, ...]:
    """Return what puts tile_2 before tile_10."""
    words = re.split(r"(\d+)", name.lower())
    return tuple((int(word), "") if k % 2 else (0, word) for k, word in enumerate(words)), name


def of_files(paths: list[str], folder: Path, limit: int, notes: Notes) -> dict[str, NDArray[Any]]:
    """Read files one after the other, those that are small as a whole, unless they were before."""
    whole = [fits(path, limit) for path in paths]

    def read(spool: Spool) -> None:
        looks = _Looks()
        for path, small in zip(paths, whole, strict=True):
            with _named(path):
                if small:
                    _add_file(path, spool, notes, looks)
                else:
                    first = spool.rows("faces")
                    _reader(path)(path, spool, notes)
                    looks.follow(spool, first)
        looks.finish(spool)
        spool.complete()
        settle_face_channels(spool, notes)

    return spooled(paths, folder, read, of=[whole])


@contextmanager
def _named(path: str) -> Iterator[None]:
    """Say in errors in which file the fault is."""
    try:
        yield
    except (ArgumentError, DtypeError) as error:
        # Those of readers say it already.
        if path in str(error):
            raise
        raise type(error)(f"{path}: {error}") from error


def _add_file(path: str, spool: Spool, notes: Notes, looks: _Looks) -> None:
    """Append a file that fits."""
    asset = io.read_asset(path)
    source = flattened(asset)
    notes.merge(asset.notes)
    first = spool.rows("faces")
    attributes = {
        "normals": source.normals,
        "colors": source.colors,
        "uvs": source.uvs,
        "channels": source.channels,
    }
    given = {name: rows for name, rows in attributes.items() if rows is not None}
    if source.face_channels:
        given["face_channels"] = source.face_channels
    add_piece(spool, source.vertices, source.faces, given, narrow=True)
    looks.add(spool, source, first)


class _Looks:
    """The materials of many files in one table, as those of the parts of one file."""

    def __init__(self) -> None:
        self._table: dict[tuple[Any, ...], int] = {}
        self._files = 0

    def add(self, spool: Spool, source: Source, first: int) -> None:
        """Append the face materials of a file."""
        self._files += 1
        own = source.face_materials
        looks = source.materials or (Material(),)
        if own is None:
            numbers = np.full(len(source.faces), self._number(looks[0], None), np.int32)
        else:
            numbers = self._numbers(np.asarray(own), looks)
        spool.add_filled("face_materials", numbers, first)

    def _numbers(self, own: NDArray[Any], looks: Sequence[Material]) -> NDArray[np.int32]:
        """Return the numbers in this table of those in that of a file."""
        values, places = np.unique(own, return_inverse=True)
        several = len(looks) > 1
        table = [
            self._number(looks[min(max(value, 0), len(looks) - 1)], None if several else (self._files, value))
            for value in values.tolist()
        ]
        return np.array(table, np.int32)[places.reshape(-1)]

    def _number(self, look: Material, value: Any) -> int:
        return self._table.setdefault((look, value), len(self._table))

    def follow(self, spool: Spool, first: int) -> None:
        """Give faces from one on the numbers behind those before; they are in the spool, if they have any."""
        self._files += 1
        looks = spool.take_looks() or [Material()]
        count = spool.rows("faces")
        if spool.rows("face_materials") <= first:
            self._fill(spool, first, count, self._number(looks[0], None))
            return
        rows = np.memmap(spool.file("face_materials"), np.int32, "r+", shape=(spool.rows("face_materials"),))
        for start in range(first, len(rows), ROWS):
            part = rows[start : start + ROWS]
            part[:] = self._numbers(part, looks)
        rows.flush()

    def _fill(self, spool: Spool, first: int, count: int, number: int) -> None:
        spool.add_filled("face_materials", np.zeros(0, np.int32), first)
        spool.pad("face_materials", count, number)

    def finish(self, spool: Spool) -> None:
        """Keep the looks, and drop what says nothing."""
        if len(self._table) < 2 and "face_materials" in spool.names():
            spool.drop("face_materials")
        looks = [look for look, _ in self._table]
        spool.add_looks(looks if len(set(looks)) > 1 else looks[:1])
