"""STL in pieces."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _core, _piece_text, _stl
from nanite_rs._piece_text import Lines, shifted
from nanite_rs._piece_vertices import FileVertices
from nanite_rs._pieces import ROWS
from nanite_rs.exceptions import FormatError, MeshError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs._pieces import Spool


_STL_HEAD: Final = 84
_STL_ROW: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])


def read(path: str, spool: Spool, notes: Notes) -> None:
    """Read STL: a soup of triangles. Which kind it is of is told as by the core."""
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        head = file.read(_STL_HEAD)
    count = int.from_bytes(head[80:], "little")
    vertices = FileVertices(path, spool, notes)
    exact = len(head) == _STL_HEAD and size == _STL_HEAD + count * _STL_ROW.itemsize
    if not exact and b"\0" not in head and head.lstrip()[:5].lower() == b"solid":
        _stl_text(path, vertices)
    else:
        _stl_bytes(path, size, count, vertices)
    vertices.finish()
    if spool.rows("faces") == vertices.first_face:
        raise MeshError(f"{path}: there are no triangles in it")


def _stl_bytes(path: str, size: int, count: int, vertices: FileVertices) -> None:
    there = max(size - _STL_HEAD, 0) // _STL_ROW.itemsize
    if there < count or size < _STL_HEAD:
        raise FormatError(
            f"{path}: byte {size}: the file ends after {there} of the {count} triangles that it promises"
        )
    if not count:
        return
    rows = np.memmap(path, _STL_ROW, "r", offset=_STL_HEAD, shape=(count,))
    pieces = [slice(start, start + ROWS) for start in range(0, count, ROWS)]
    given = any(rows["more"][piece].any() for piece in pieces)
    marked = given and all(_stl.is_marked(rows["more"][piece]) for piece in pieces)
    with open(path, "rb") as file:
        header = file.read(_STL_HEAD)[:-4]
    for piece in pieces:
        first = vertices.faces()
        _add_soup(rows["corners"][piece].reshape(-1, 3), vertices)
        if given:
            attributes = np.asarray(rows["more"][piece])
            colors = _stl.face_colors(attributes, header, marked=marked)
            if colors is None:
                vertices.add_face_property("attributes", attributes, first)
            else:
                vertices.add_colors(list(np.repeat(colors, 3, axis=0).T))


def _add_soup(corners: NDArray[Any], vertices: FileVertices) -> None:
    first = vertices.count()
    vertices.add(corners)
    vertices.add_faces(np.arange(first, first + len(corners)), np.full(len(corners) // 3, 3))


def _stl_text(path: str, vertices: FileVertices) -> None:
    """Read facets, some at a time, each time as a solid of its own."""
    lines, facets, inside = Lines(path), 0, False
    held, ended = b"", False
    while not ended:
        block = lines.block()
        ended = not block
        held += block
        end = held.lower().rfind(b"endfacet") + len(b"endfacet")
        if not ended and end < len(b"endfacet"):
            if len(held) < 4 * _piece_text.BLOCK:
                continue
            end = len(held)
        # What is behind the last facet tells how the file ends.
        data, held = (held, b"") if ended else (held[:end], held[end:])
        text = (b"solid\n" if inside else b"") + data + (b"" if ended else b"\nendsolid\n")
        try:
            corners = _core.read_stl(path, text)["corners"]
        except FormatError as error:
            raise shifted(error, lines.line - 1 - inside, facets) from None
        _add_soup(corners, vertices)
        lines.passed(data)
        facets += len(corners) // 3
        inside = True
