"""PLY in pieces: of bytes where all faces are triangles, of text with polygons."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _core, _ply
from nanite_rs._faces import corner_numbers
from nanite_rs._piece_text import Lines, shifted
from nanite_rs._piece_vertices import FileVertices
from nanite_rs._pieces import ROWS
from nanite_rs.exceptions import FormatError, MeshError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs._pieces import Spool


#: Most bytes of a header, which has a line for each property.
_HEAD: Final = 1 << 20

_TYPES: Final = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}

_Columns = dict[str, "tuple[NDArray[Any], NDArray[np.uint32] | None]"]
_Properties = list[tuple[str, ...]]


def _ply_head(path: str) -> tuple[str, list[tuple[str, int, _Properties]], int, int]:
    """Return the format, the elements with their properties, and the byte and the line where rows begin."""
    with open(path, "rb") as file:
        data = file.read(_HEAD)
    first = re.match(rb"[^\r\n]*(\r(?!\n))?", data)
    end = b"\r" if first is not None and first[1] else b"\n"
    at, lines = 0, list[bytes]()
    while (place := data.find(end, at)) >= 0:
        lines.append(data[at:place].strip())
        at = place + 1
        if lines[-1].split()[:1] == [b"end_header"]:
            break
    else:
        _core.read_ply(path, data)
        raise FormatError(f"{path}: the header has no end")
    # The core says what is wrong with it.
    empty = [re.sub(rb"^(element\s+\S+\s+)\d+", rb"\g<1>0", line) for line in lines]
    kind = _core.read_ply(path, b"\n".join([*empty, b""]))["format"]
    elements: list[tuple[str, int, _Properties]] = []
    for line in lines:
        match tuple(line.decode("utf-8", "replace").split()):
            case ("element", name, count, *_):
                elements.append((name, int(count), []))
            case ("property", *rest):
                elements[-1][2].append(tuple(rest[:4] if rest[0] == "list" else rest[:2]))
    return kind, elements, at, len(lines) + 1


def read(path: str, spool: Spool, notes: Notes) -> None:
    """Read PLY: of bytes where all faces are triangles, of text with polygons."""
    kind, elements, offset, line = _ply_head(path)
    lines = Lines(path, offset, line)
    vertices = FileVertices(path, spool, notes)
    total = next((count for name, count, _ in elements if name.lower() == "vertex"), 0)
    seen: set[str] = set()
    for element in elements:
        name, count, properties = element[0].lower(), element[1], element[2]
        if name == "tristrips" and count:
            raise FormatError(f"{path}: strips of triangles are read in memory alone")
        if count and name not in ("vertex", "face"):
            notes.add("elements of PLY that are no part of a mesh", element[0])
        if not properties:
            continue
        if {"vertex", "face"} <= seen:
            break
        seen.add(name)
        if kind == "ascii":
            blocks = _ply_text(path, element, lines)
        else:
            order = ">" if kind == "binary_big_endian" else "<"
            dtype = _ply_row(order, element)
            blocks = _ply_bytes(path, element, dtype, offset)
            offset += count * dtype.itemsize
        for first, columns in blocks:
            if name == "vertex":
                _add_vertices(path, columns, vertices, notes)
            elif name == "face":
                _add_faces(path, first, total, columns, vertices, notes)
    if spool.rows("faces") == vertices.first_face:
        raise MeshError(f"{path}: there are no triangles in it")
    vertices.finish()


def _ply_text(
    path: str, element: tuple[str, int, _Properties], lines: Lines
) -> Iterator[tuple[int, _Columns]]:
    """Yield the number of a row, and columns from there on: a row is a line."""
    name, count, properties = element
    head = "".join(f"property {' '.join(words)}\n" for words in properties)
    done = 0
    while done < count:
        data, rows = lines.rows(count - done)
        # At the end of the file the core says what is missing.
        asked = rows if data else count - done
        text = f"ply\nformat ascii 1.0\nelement {name} {asked}\n{head}end_header\n".encode()
        try:
            (_, _, columns), *_ = _core.read_ply(path, text + data)["elements"]
        except FormatError as error:
            raise shifted(error, lines.line - 1 - text.count(b"\n"), done, count) from None
        lines.passed(data)
        yield done, columns
        done += rows


def _ply_row(order: str, element: tuple[str, int, _Properties]) -> np.dtype[Any]:
    """Return the dtype of a row; lists have three members."""
    fields: list[Any] = []
    for at, words in enumerate(element[2]):
        known = [_TYPES[word.lower()] for word in words[:-1] if word != "list"]
        if words[0] == "list":
            fields += [(f"count {at}", f"{order}{known[0]}"), (words[-1], f"{order}{known[1]}", 3)]
        else:
            fields.append((words[-1], f"{order}{known[0]}"))
    return np.dtype(fields)


def _ply_bytes(
    path: str, element: tuple[str, int, _Properties], dtype: np.dtype[Any], offset: int
) -> Iterator[tuple[int, _Columns]]:
    """Yield the number of a row, and columns from there on."""
    name, count, properties = element
    size = os.path.getsize(path)
    there = min(max(size - offset, 0) // dtype.itemsize, count)
    rows = np.memmap(path, dtype, "r", offset=offset, shape=(there,)) if there else np.zeros(0, dtype)
    for start in range(0, there, ROWS):
        piece = rows[start : start + ROWS]
        columns: _Columns = {}
        for at, words in enumerate(properties):
            values, lengths = piece[words[-1]].astype(dtype[words[-1]].base.newbyteorder("=")), None
            if words[0] == "list":
                lengths = piece[f"count {at}"].astype(np.uint32)
                if (lengths != 3).any():
                    row = int(np.argmax(lengths != 3))
                    raise FormatError(
                        f"{path}: {name}[{start + row}] has {lengths[row]} corners; "
                        "of binary files only those of triangles are read in pieces"
                    )
                values = values.reshape(-1)
            columns[words[-1]] = values, lengths
        yield start, columns
    if there < count:
        raise FormatError(
            f"{path}: byte {offset + there * dtype.itemsize}: element {name}, row {there} of {count}: "
            f"expected {dtype.itemsize} more bytes, but the file ends at byte {size}"
        )


def _add_vertices(path: str, columns: _Columns, vertices: FileVertices, notes: Notes) -> None:
    """Append rows of vertices with what they carry."""
    rows = next((len(values) for values, lengths in columns.values() if lengths is None), 0)
    first = vertices.first + vertices.count()
    source, colors, left = _ply.split_vertices(path, rows, columns, notes)
    vertices.add(source.vertices)
    if source.normals is not None:
        vertices.add_attribute("normals", source.normals, first)
    if colors is not None:
        vertices.add_colors(colors)
    for number, uvs in enumerate(source.uvs):
        vertices.add_attribute(f"uvs {number}", uvs, first)
    for name, values in left.items():
        vertices.add_property(name, values)


def _add_faces(
    path: str, first: int, total: int, columns: _Columns, vertices: FileVertices, notes: Notes
) -> None:
    """Append rows of faces, of which the file has so many vertices."""
    key = next((key for key in _ply.INDICES if key in columns), None)
    values, counts = columns[key] if key is not None else (None, None)
    if values is None or counts is None:
        raise FormatError(f"{path}: element face has no list of vertices")
    corners = corner_numbers(path, values, counts, total, first)
    if vertices.count() < total and (counts != 3).any():
        raise FormatError(f"{path}: polygons before their vertices are read in memory alone")
    begin = vertices.faces()
    polygons = vertices.add_faces(corners, counts)
    of_faces = {name: rows for name, (rows, lengths) in columns.items() if lengths is None}
    for name, (_, lengths) in columns.items():
        if lengths is not None and name != key:
            notes.add("lists of faces", name)
    if _ply.take_colors(of_faces) is not None:
        notes.add("colours of faces", path)
    for name, rows in of_faces.items():
        if rows.dtype.kind == "f" or rows.dtype.itemsize > 4:
            notes.add("properties of faces that are no integers of 32 bits", name)
        else:
            vertices.add_labels(name, rows[polygons], begin)
