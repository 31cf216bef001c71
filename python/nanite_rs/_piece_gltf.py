"""glTF in pieces: the triangles of all nodes where they stand, slice by slice out of mapped buffers."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _colors, _gltf
from nanite_rs._accessors import TYPES, WIDTHS, Document
from nanite_rs._asset import TRIANGLES, UV_SETS, triangles
from nanite_rs._piece_vertices import FileVertices
from nanite_rs._pieces import ROWS
from nanite_rs.exceptions import FileError, FormatError, MeshError, NaniteError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs._pieces import Spool
    from nanite_rs.material import Material


class _Mapped(Document):
    """A document whose buffers are mapped, and read where they are looked at; what was compressed lies aside."""

    def __init__(self, path: str, folder: Path) -> None:
        super().__init__(path, _mapped(path), Path(path).parent)
        self._aside, self._written = folder, 0
        # Instances have them in common.
        self._sparse: dict[int, NDArray[Any]] = {}
        self._draco: dict[str, tuple[NDArray[np.int64], dict[str, NDArray[Any]]] | None] = {}

    def content(self, path: Path, what: str) -> Any:
        """Return the content of a file."""
        try:
            return _mapped(path)
        except OSError as error:
            raise FileError(f"{what}: {path}: {error.strerror or error}") from None

    def aside(self, array: NDArray[Any]) -> NDArray[Any]:
        """Write an array to disk and map it."""
        if not array.size:
            return array
        self._aside.mkdir(exist_ok=True)
        self._written += 1
        file = self._aside / f"array {self._written}"
        np.ascontiguousarray(array).tofile(file)
        return np.memmap(file, array.dtype, "r", shape=array.shape)

    def _decompressed(self, row: dict[str, Any], what: str) -> memoryview | None:
        found = super()._decompressed(row, what)
        return None if found is None else self.aside(np.frombuffer(found, np.uint8)).data

    def accessor(self, index: int) -> NDArray[Any]:
        """Return (count, width) numbers where they lie."""
        if "sparse" not in self.entry("accessors", index):
            return super().accessor(index)
        if index not in self._sparse:
            self._sparse[index] = self.aside(super().accessor(index))
        return self._sparse[index]

    def draco(
        self, packed: dict[str, Any], attributes: dict[str, Any], what: str
    ) -> tuple[NDArray[np.int64], dict[str, NDArray[Any]]] | None:
        """Return faces and attributes out of KHR_draco_mesh_compression; nothing where it need not be used."""
        key = json.dumps([packed, attributes], sort_keys=True)
        if key not in self._draco:
            found = super().draco(packed, attributes, what)
            if found is not None:
                faces, rows = found
                found = self.aside(faces), {name: self.aside(array) for name, array in rows.items()}
            self._draco[key] = found
        return self._draco[key]


def _mapped(path: str | Path) -> memoryview:
    # What is empty cannot be mapped.
    return np.memmap(path, np.uint8, "r").data if Path(path).stat().st_size else memoryview(b"")


def size_of(path: str) -> int:
    """Return how many bytes a file has with all that it refers to, once that is not compressed.

    Raises
    ------
    FormatError
        It is no glTF.
    """
    document = Document(path, _mapped(path), None)
    size = Path(path).stat().st_size
    for row in document.listed(document.json, "buffers"):
        if isinstance(row, dict) and "uri" in row:
            size += document.whole(row, "byteLength", 0)
    stored = 0
    for row in document.listed(document.json, "accessors"):
        if isinstance(row, dict):
            width = WIDTHS.get(str(row.get("type")), 1)
            kind = np.dtype(TYPES.get(row.get("componentType", 0), "<f4"))
            stored += document.whole(row, "count", 0) * width * kind.itemsize
    return max(size, stored)


def read(path: str, spool: Spool, notes: Notes) -> None:
    """Read GLB or glTF without skins and morph targets; each instance has vertices of its own.

    What is compressed is decompressed as a whole: a primitive of Draco, a buffer view of meshoptimizer.
    """
    aside = spool.folder / "decompressed"
    try:
        _read(path, _Mapped(path, aside), spool, notes)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _read(path: str, document: _Mapped, spool: Spool, notes: Notes) -> None:
    before = spool.rows("faces")
    looks: dict[Material, int] = {}
    try:
        if document.listed(document.json, "animations"):
            notes.add("animations, which are not played")
        for what, row, pose, look in _gltf.primitives(document, notes):
            primitive = _Primitive(document, row, pose, what)
            if not primitive.read(path, spool, notes):
                continue
            material = look(primitive.uv_sets())
            if "NORMAL" not in primitive.attributes:
                material = replace(material, smooth=False)
            number = looks.setdefault(material, len(looks))
            if number:
                spool.add_filled("face_materials", np.zeros(0, np.int32), before)
            if "face_materials" in spool.names():
                spool.pad("face_materials", primitive.first_face, 0)
                spool.pad("face_materials", spool.rows("faces"), number)
    except (NaniteError, MemoryError, OSError):
        raise
    except Exception as error:  # whatever else a damaged file makes us trip over
        raise FormatError(f"{path}: damaged glTF: {type(error).__name__}: {error}") from error
    if spool.rows("faces") == before:
        raise MeshError(f"{path}: there are no triangles in it")
    spool.add_looks(looks)


class _Primitive:
    """A primitive in its place."""

    def __init__(self, document: _Mapped, row: dict[str, Any], pose: NDArray[np.float64], what: str) -> None:
        self._document, self._row, self._what = document, row, what
        self._linear, self._shift = pose[:3, :3], pose[:3, 3]
        self._identity = bool(np.array_equal(pose, np.eye(4)))
        self._mirrored = bool(np.linalg.det(self._linear) < 0.0)
        self.attributes = document.member(row, "attributes")
        # Faces and attributes that were compressed with each other.
        self._decoded: NDArray[np.int64] | None = None
        self._unpacked: dict[str, NDArray[Any]] = {}
        self.first_face = 0
        self._count = 0

    def read(self, path: str, spool: Spool, notes: Notes) -> bool:
        """Append what it is; false where it is no triangles."""
        document = self._document
        self.first_face = spool.rows("faces")
        if "POSITION" not in self.attributes:
            notes.add("primitives without positions")
            return False
        packed = document.extension(self._row, "KHR_draco_mesh_compression")
        found = None if packed is None else document.draco(packed, self.attributes, self._what)
        if found is not None:
            self._decoded, self._unpacked = found
        self._count = len(self._stored("POSITION"))
        mode = document.whole(self._row, "mode", TRIANGLES)
        if triangles(np.zeros(0, np.int64), mode) is None:
            notes.add("points and lines")
            return False
        vertices = FileVertices(path, spool, notes)
        for rows in self._numbers("POSITION", (3,)):
            vertices.add(rows if self._identity else rows @ self._linear.T + self._shift)
        for faces in self._faces(mode):
            turned = faces[:, ::-1] if self._mirrored and not self._identity else faces
            vertices.add_faces(turned.reshape(-1), np.full(len(faces), 3))
        self._attributes(vertices, spool, notes)
        vertices.finish()
        return True

    def _attributes(self, vertices: FileVertices, spool: Spool, notes: Notes) -> None:
        at = vertices.first
        if "NORMAL" in self.attributes:
            cross = np.cross
            turn = np.array([cross(self._linear[(k + 1) % 3], self._linear[(k + 2) % 3]) for k in range(3)])
            turn *= -1.0 if self._mirrored else 1.0
            for rows in self._numbers("NORMAL", (3,)):
                vertices.add_attribute("normals", rows if self._identity else rows @ turn.T, at)
                at += len(rows)
        if "COLOR_0" in self.attributes:
            for rows in self._numbers("COLOR_0", (3, 4)):
                unit = np.clip(np.nan_to_num(rows, nan=1.0), 0.0, 1.0)
                spool.append("wide colors", _colors.opaque(unit))
            vertices.narrow_colors(_colors.ALL_DIGITS)
        for number in range(self.uv_sets()):
            at = vertices.first
            for rows in self._uvs(number):
                flipped = rows.astype(np.float64)
                flipped[:, 1] = 1.0 - flipped[:, 1]
                vertices.add_attribute(f"uvs {number}", flipped, at)
                at += len(rows)
        for name in self.attributes:
            if name.startswith("_"):
                self._property(name, vertices, notes)

    def uv_sets(self) -> int:
        """Return how many UV sets it has, those in between that it lacks among them."""
        known = (number for number in range(UV_SETS) if f"TEXCOORD_{number}" in self.attributes)
        return max(known, default=-1) + 1

    def _uvs(self, number: int) -> Iterator[NDArray[np.float32]]:
        if f"TEXCOORD_{number}" in self.attributes:
            yield from self._numbers(f"TEXCOORD_{number}", (2,))
            return
        for start in range(0, self._count, ROWS):
            yield np.zeros((min(ROWS, self._count - start), 2), np.float32)

    def _property(self, name: str, vertices: FileVertices, notes: Notes) -> None:
        document = self._document
        index = document.whole(self.attributes, name)
        row = document.entry("accessors", index)
        if str(row.get("type")).startswith("MAT"):
            notes.add("attributes of vertices", name)
            return
        normalized = row.get("normalized") is True
        stored = self._fitting(name, self._stored(name), (1, 2, 3, 4))
        for start in range(0, len(stored), ROWS):
            rows = stored[start : start + ROWS]
            rows = document.floats(index, rows) if normalized else rows
            vertices.add_property(name, rows[:, 0] if rows.shape[1] == 1 else rows)

    def _stored(self, name: str) -> NDArray[Any]:
        """Return an attribute as it is stored."""
        found = self._unpacked.get(name)
        if found is None:
            found = self._document.accessor(self._document.whole(self.attributes, name))
        return found

    def _numbers(self, name: str, widths: tuple[int, ...]) -> Iterator[NDArray[np.float32]]:
        """Yield an attribute as float32, some rows at a time."""
        document = self._document
        index = document.whole(self.attributes, name)
        stored = self._fitting(name, self._stored(name), widths)
        for start in range(0, len(stored), ROWS):
            yield document.floats(index, stored[start : start + ROWS], always=name.startswith("COLOR_"))

    def _fitting(self, name: str, stored: NDArray[Any], widths: tuple[int, ...]) -> NDArray[Any]:
        if stored.shape[1] not in widths:
            wanted = " or ".join(str(width) for width in widths)
            self._document.fail(
                f"{self._what}: {name} has {stored.shape[1]} numbers a vertex, expected {wanted}"
            )
        if len(stored) != self._count:
            self._document.fail(f"{self._what}: {len(stored)} of {name} for {self._count} vertices")
        return stored

    def _faces(self, mode: int) -> Iterator[NDArray[np.int64]]:
        document = self._document
        if self._decoded is not None:
            for start in range(0, len(self._decoded), ROWS):
                yield np.asarray(self._decoded[start : start + ROWS])
            return
        if "indices" not in self._row:
            step = 3 * ROWS if mode == TRIANGLES else max(self._count, 1)
            for start in range(0, self._count, step):
                yield from self._triangles(np.arange(start, min(start + step, self._count)), mode)
            return
        index = document.whole(self._row, "indices")
        stored = document.accessor(index)
        if stored.dtype.kind != "u" or stored.shape[1] != 1:
            document.fail(f"accessors[{index}]: indices must be unsigned numbers, one each")
        # Strips and fans hang together.
        step = 3 * ROWS if mode == TRIANGLES else max(len(stored), 1)
        for start in range(0, len(stored), step):
            order = stored[start : start + step, 0].astype(np.int64)
            if order.max(initial=0) >= self._count:
                row = start + int(np.argmax(order >= self._count))
                document.fail(
                    f"{self._what}: index {row} is {order[row - start]}, beyond the {self._count} vertices"
                )
            yield from self._triangles(order, mode)

    def _triangles(self, order: NDArray[np.int64], mode: int) -> Iterator[NDArray[np.int64]]:
        faces = triangles(order, mode)
        if faces is not None and len(faces):
            yield faces
