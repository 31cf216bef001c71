"""PLY in pieces: text and bytes, polygons and strips, and what faces say of their corners."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from nanite_rs import _core, _piece_text, _ply
from nanite_rs._beside import Pictures
from nanite_rs._faces import corner_numbers
from nanite_rs._piece_text import Lines, shifted
from nanite_rs._piece_vertices import Corners, FileVertices
from nanite_rs.exceptions import FormatError, MeshError
from nanite_rs.material import default_material

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs._pieces import Spool


#: Most bytes of a header, which has a line for each property.
_HEAD: Final = 1 << 20

_Columns = dict[str, "tuple[NDArray[Any], NDArray[np.uint32] | None]"]


class _Element(NamedTuple):
    """Rows of one kind."""

    name: str
    rows: int
    properties: list[tuple[str, ...]]
    """Words of the header: types, and the name."""

    def header(self, kind: str, rows: int) -> bytes:
        """Return a header of this element alone, with so many rows."""
        listed = "".join(f"property {' '.join(words)}\n" for words in self.properties)
        return f"ply\nformat {kind} 1.0\nelement {self.name} {rows}\n{listed}end_header\n".encode()

    def lists(self) -> list[str]:
        """Return the names of lists."""
        return [words[-1] for words in self.properties if words[0] == "list"]

    def scalars(self) -> list[str]:
        """Return the names of all else."""
        return [words[-1] for words in self.properties if words[0] != "list"]


class _Head(NamedTuple):
    """What a header says."""

    kind: str
    elements: list[_Element]
    textures: list[str]
    offset: int
    """The byte where rows begin."""
    line: int
    """The line where rows begin."""


def _head(path: str) -> _Head:
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
    elements: list[_Element] = []
    for line in lines:
        match tuple(line.decode("utf-8", "replace").split()):
            case ("element", name, count, *_):
                elements.append(_Element(name, int(count), []))
            case ("property", *rest):
                elements[-1].properties.append(tuple(rest[:4] if rest[0] == "list" else rest[:2]))
    return _Head(kind, elements, _ply.textures_of(lines), at, len(lines) + 1)


def read(path: str, spool: Spool, notes: Notes) -> None:
    """Read PLY. A row, such as a strip, is read as a whole."""
    head = _head(path)
    there = {element.name.lower(): element for element in head.elements if element.rows}
    wanted = there.keys() & {"vertex", "face", "tristrips"}
    rows: _Text | _Bytes
    rows = _Text(path, head) if head.kind == "ascii" else _Bytes(path, head)
    vertices = FileVertices(path, spool, notes)
    painted = _paints_faces(there)
    wedges = "face" in there and "texcoord" in there["face"].lists() and "tristrips" not in there
    corners = Corners(path, spool, notes, vertices) if painted or wedges else None
    faces = _Faces(path, there, len(head.textures), vertices, corners, notes, painted=painted)
    for element in head.elements:
        name = element.name.lower()
        if element.rows and name not in ("vertex", "face", "tristrips"):
            notes.add("elements of PLY that are no part of a mesh", element.name)
        if not element.properties:
            continue
        if not wanted:
            break
        wanted.discard(name)
        for columns in rows.of(element):
            if name == "vertex":
                _add_vertices(path, columns, vertices if corners is None else corners.source, notes)
            elif name == "face":
                faces.add(columns)
            elif name == "tristrips":
                faces.add_strips(columns)
    if spool.rows("faces") == vertices.first_face:
        raise MeshError(f"{path}: there are no triangles in it")
    if corners is not None:
        corners.finish()
    vertices.finish()
    if head.textures:
        _add_looks(path, head.textures, faces, spool, notes)


def _add_looks(path: str, textures: list[str], faces: _Faces, spool: Spool, notes: Notes) -> None:
    """Append the looks of textures, and that of faces without one."""
    pictures = Pictures(Path(path).parent, True, notes)
    looks = _ply.textured(path, textures, pictures, len(spool.names("uvs ")), notes)
    if not faces.numbered:
        for name in textures[1:]:
            notes.add("textures that no face names", name)
        looks = looks[:1]
    elif faces.outside:
        looks.append(default_material(colored="colors" in spool.names()))
    spool.add_looks(looks)


class _Text:
    """Rows of text: lines."""

    def __init__(self, path: str, head: _Head) -> None:
        self._path, self._lines = path, Lines(path, head.offset, head.line)

    def of(self, element: _Element) -> Iterator[_Columns]:
        """Yield columns of the rows that come next."""
        lines, count, done = self._lines, element.rows, 0
        while done < count:
            data, rows = lines.rows(count - done)
            # At the end of the file the core says what is missing.
            head = element.header("ascii", rows if data else count - done)
            try:
                (_, _, columns), *_ = _core.read_ply(self._path, head + data)["elements"]
            except FormatError as error:
                raise shifted(error, lines.line - 1 - head.count(b"\n"), done, count) from None
            lines.passed(data)
            yield columns
            done += rows


class _Bytes:
    """Rows of bytes."""

    def __init__(self, path: str, head: _Head) -> None:
        self._path, self._kind, self._at = path, head.kind, head.offset

    def of(self, element: _Element) -> Iterator[_Columns]:
        """Yield columns of the rows that come next."""
        count, done, size = element.rows, 0, _piece_text.BLOCK
        while done < count:
            with open(self._path, "rb") as file:
                file.seek(self._at)
                data = file.read(size)
            head = element.header(self._kind, count - done)
            rows, end, cut_off = _core.whole_ply_rows(self._path, head + data)
            if not rows and cut_off and len(data) == size:
                size *= 2
                continue
            if rows:
                head, data = element.header(self._kind, rows), data[:end]
            # Without a row the core says what is wrong.
            try:
                (_, _, columns), *_ = _core.read_ply(self._path, head + data)["elements"]
            except FormatError as error:
                raise shifted(error, 0, done, count, self._at - len(head)) from None
            yield columns
            self._at, done = self._at + end, done + rows


def _paints_faces(there: Mapping[str, _Element]) -> bool:
    """Whether faces have colours that vertices have not."""
    if "face" not in there or "tristrips" in there:
        return False
    nothing = np.zeros(0)
    of_faces, of_vertices = (
        name in there and _ply.take_colors(dict.fromkeys(there[name].scalars(), nothing)) is not None
        for name in ("face", "vertex")
    )
    return of_faces and not of_vertices


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


class _Faces:
    """Faces of a file, with what they carry."""

    def __init__(
        self,
        path: str,
        there: Mapping[str, _Element],
        textures: int,
        vertices: FileVertices,
        corners: Corners | None,
        notes: Notes,
        *,
        painted: bool,
    ) -> None:
        self._path, self._textures, self._notes, self._painted = path, textures, notes, painted
        self._vertices, self._corners = vertices, corners
        # Strips have no properties.
        self._strips = "tristrips" in there
        self._total = there["vertex"].rows if "vertex" in there else 0
        self._polygons = 0
        # Whether faces have numbers of textures, and some of none.
        self.numbered, self.outside = False, False

    def add_strips(self, columns: _Columns) -> None:
        """Append strips of triangles."""
        _, values, lengths = self._listed(columns, "tristrips")
        triangles = _core.strips(np.ascontiguousarray(values, np.int64), lengths).reshape(-1)
        self._append(triangles, np.full(len(triangles) // 3, 3, np.uint32))

    def add(self, columns: _Columns) -> None:
        """Append rows of faces."""
        key, values, counts = self._listed(columns, "face")
        vertices, notes, corners = self._vertices, self._notes, self._corners
        begin, first = vertices.faces(), self._polygons
        polygons = self._append(values, counts)
        of_faces = {name: rows for name, (rows, lengths) in columns.items() if lengths is None}
        wedges = columns.get("texcoord")
        for name, (_, lengths) in columns.items():
            if lengths is not None and name != key and (corners is None or name != "texcoord"):
                notes.add("lists of faces", name)
        if self._strips:
            for name in of_faces:
                notes.add("properties of faces in files with strips", name)
            return
        if self._painted:
            columns_of_colors = _ply.take_colors(of_faces) or []
            vertices.add_colors([np.repeat(column, counts) for column in columns_of_colors])
        if corners is not None and wedges is not None and wedges[1] is not None:
            uvs = _ply.wedges_of(self._path, wedges[0], wedges[1], counts, first)
            if uvs is not None:
                corners.add_uvs(uvs)
            if self._textures and "texnumber" in of_faces:
                self._add_textures(of_faces.pop("texnumber")[polygons], begin)
        for name, rows in of_faces.items():
            vertices.add_face_property(name, rows[polygons], begin)

    def _listed(self, columns: _Columns, element: str) -> tuple[str, NDArray[Any], NDArray[np.uint32]]:
        key = next((key for key in _ply.INDICES if key in columns), None)
        values, counts = columns[key] if key is not None else (None, None)
        if key is None or values is None or counts is None:
            raise FormatError(f"{self._path}: element {element} has no list of vertices")
        return key, values, counts

    def _append(self, values: NDArray[Any], counts: NDArray[np.uint32]) -> NDArray[np.uint32] | slice:
        numbers = corner_numbers(self._path, values, counts, self._total, self._polygons)
        source = self._vertices if self._corners is None else self._corners.source
        if source.count() < self._total and (self._corners is not None or (counts != 3).any()):
            raise FormatError(
                f"{self._path}: polygons, and colours of faces, before their vertices are read in memory alone"
            )
        begin = self._polygons
        self._polygons += len(counts)
        if self._corners is None:
            return self._vertices.add_faces(numbers, counts)
        return self._corners.add_faces(numbers, counts, begin)

    def _add_textures(self, numbers: NDArray[Any], first: int) -> None:
        """Append numbers of textures; faces without one, such as -1, come last."""
        outside = (numbers < 0) | (numbers >= self._textures)
        self.numbered, self.outside = True, self.outside or bool(outside.any())
        self._vertices.add_materials(np.where(outside, self._textures, numbers).astype(np.int32), first)
