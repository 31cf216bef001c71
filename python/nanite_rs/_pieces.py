"""Sources in pieces: what does not fit in memory, as arrays that lie on disk.

Whatever comes in pieces is written to plain files, an array each, and mapped: the core reads what it needs of them.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _ply
from nanite_rs._asset import Notes
from nanite_rs.exceptions import ArgumentError, DtypeError, FileError, FormatError, MeshError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

#: Rows that are read at a time.
ROWS: Final = 1 << 18
#: Endings of files that are read in pieces.
ENDINGS: Final = ("ply", "stl")

#: What pieces may have besides vertices and faces, a row for each vertex; and the last one for each face.
ATTRIBUTES: Final = ("normals", "colors", "uvs", "face_materials")

_STL_HEAD: Final = 84
_STL_ROW: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])


class Spool:
    """Arrays that grow in files of a folder, and what they are of."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._rows: dict[str, int] = {}
        self._forms: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}

    def rows(self, name: str) -> int:
        """Return how many rows an array has so far."""
        return self._rows.get(name, 0)

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the type of an array."""
        return self._forms[name][0]

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Append rows to an array; all have the form of the first."""
        form = self._forms.setdefault(name, (rows.dtype, rows.shape[1:]))
        if form[1] != rows.shape[1:]:
            raise ArgumentError(f"{name}: rows of shape {rows.shape[1:]}, before of {form[1]}")
        with open(self._folder / name, "ab" if self.rows(name) else "wb") as file:
            np.ascontiguousarray(rows, form[0]).tofile(file)
        self._rows[name] = self.rows(name) + len(rows)

    def finish(self, of: list[Any] | None) -> dict[str, NDArray[Any]]:
        """Return all arrays, mapped; ``of`` tells what they were made from."""
        forms = {
            name: [dtype.str, [self._rows[name], *shape]] for name, (dtype, shape) in self._forms.items()
        }
        aside = self._folder / f"{LIST}.part"
        aside.write_text(json.dumps({"of": of, "arrays": forms}), encoding="utf-8")
        aside.replace(self._folder / LIST)
        return opened(self._folder)


#: What arrays a folder has.
LIST: Final = "arrays.json"


def opened(folder: Path, of: list[Any] | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of a folder, mapped; none where they are not there, or were made from something else."""
    try:
        found = json.loads((folder / LIST).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    if of is not None and found["of"] != of:
        return {}
    out: dict[str, NDArray[Any]] = {}
    for name, (dtype, rows) in found["arrays"].items():
        shape = tuple(rows)
        out[name] = np.memmap(folder / name, dtype, "r", shape=shape) if shape[0] else np.zeros(shape, dtype)
    return out


def files(folder: Path) -> set[str]:
    """Return the names of the files of the arrays of a folder."""
    if not (folder / LIST).exists():
        return set()
    found = json.loads((folder / LIST).read_text(encoding="utf-8"))
    return {LIST, *(name for name, (_, rows) in found["arrays"].items() if rows[0])}


def in_folder(arrays: Mapping[str, NDArray[Any]], folder: Path, of: list[Any]) -> Mapping[str, NDArray[Any]]:
    """Return arrays that lie in a folder, where other processes see them; write them unless they were before."""
    # Maps have resolved names.
    if all(
        Path(getattr(rows, "filename", None) or "").parent == folder.resolve() for rows in arrays.values()
    ):
        return arrays
    known = opened(folder, of)
    if known:
        return known
    spool = Spool(folder)
    for name, whole in arrays.items():
        for start in range(0, max(len(whole), 1), ROWS):
            rows = whole[start : start + ROWS]
            if name == "faces":
                if len(rows) and rows.min() < 0:
                    row = start + int(np.argmax((rows < 0).any(axis=1)))
                    raise MeshError(f"faces[{row}] refers to vertex {rows[row - start].min()}")
                rows = rows.astype(np.uint32)
            spool.append(name, rows)
    return spool.finish(of)


def identity(path: str) -> list[Any]:
    """Return what tells a file from what it was before."""
    status = os.stat(path)
    return [os.path.abspath(path), status.st_size, status.st_mtime_ns]


def of_file(path: str, ending: str, folder: Path, notes: Notes) -> dict[str, NDArray[Any]]:
    """Read a file piece by piece, unless it was before.

    Raises
    ------
    FormatError
        It is none that can be read so.
    """
    of = identity(path)
    known = opened(folder, of)
    if known:
        return known
    spool = Spool(folder)
    (_of_ply if ending == "ply" else _of_stl)(path, spool, notes)
    if identity(path) != of:
        raise FileError(f"{path}: the file changed while it was read")
    return spool.finish(of)


def of_pieces(pieces: Iterable[Any], folder: Path) -> dict[str, NDArray[Any]]:
    """Gather pieces: each ``(vertices, faces)`` or ``(vertices, faces, attributes)``, which counts from 0."""
    spool = Spool(folder)
    known: set[str] | None = None
    for number, piece in enumerate(pieces):
        where = f"source: piece {number}"
        if not isinstance(piece, tuple | list) or not 2 <= len(piece) <= 3:
            raise DtypeError(f"{where}: expected (vertices, faces) or (vertices, faces, attributes)")
        vertices, faces = np.asarray(piece[0]), np.asarray(piece[1])
        attributes: Mapping[str, Any] = piece[2] if len(piece) == 3 else {}
        _check(where, vertices, faces, attributes)
        if known is not None and known != set(attributes):
            raise ArgumentError(f"{where}: has {sorted(attributes)}, pieces before {sorted(known)}")
        known = set(attributes)
        first = spool.rows("vertices")
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            row = int(np.argmax(((faces < 0) | (faces >= len(vertices))).any(axis=1)))
            raise MeshError(f"{where}: faces[{row}] refers to none of its {len(vertices)} vertices")
        if first + len(vertices) > 1 << 32:
            raise MeshError(f"{where}: more than 2^32 vertices")
        if number == 0 and vertices.dtype != np.float32:
            vertices = vertices.astype(np.float64)
        if number and spool.dtype("vertices") == np.float32 != vertices.dtype:
            raise DtypeError(f"{where}: vertices are {vertices.dtype}, those of pieces before float32")
        spool.append("vertices", vertices)
        spool.append("faces", (faces.astype(np.int64) + first).astype(np.uint32))
        for name, given in attributes.items():
            rows = np.asarray(given)
            spool.append(name, rows.astype(np.int32 if name == "face_materials" else rows.dtype))
    if known is None:
        raise MeshError("source: there are no pieces")
    return spool.finish(None)


def _check(where: str, vertices: NDArray[Any], faces: NDArray[Any], attributes: Mapping[str, Any]) -> None:
    """Check shapes of a piece."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind != "f":
        raise ArgumentError(f"{where}: vertices must be (N, 3) floats, not {vertices.dtype}{vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise ArgumentError(f"{where}: faces must be (M, 3) integers, not {faces.dtype}{faces.shape}")
    for name, rows in attributes.items():
        if name not in ATTRIBUTES:
            raise ArgumentError(f"{where}: {name!r} is none of {', '.join(ATTRIBUTES)}")
        count = len(faces) if name == "face_materials" else len(vertices)
        if len(rows) != count:
            raise ArgumentError(f"{where}: {name} has {len(rows)} rows, not {count}")


def _of_stl(path: str, spool: Spool, notes: Notes) -> None:
    """Read binary STL: a soup of triangles."""
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        head = file.read(_STL_HEAD)
    count = int.from_bytes(head[80:], "little")
    if len(head) < _STL_HEAD or _STL_HEAD + count * _STL_ROW.itemsize > size:
        raise FormatError(f"{path}: only binary STL is read in pieces")
    rows = (
        np.memmap(path, _STL_ROW, "r", offset=_STL_HEAD, shape=(count,)) if count else np.zeros(0, _STL_ROW)
    )
    for start in range(0, max(count, 1), ROWS):
        piece = rows[start : start + ROWS]
        spool.append("vertices", piece["corners"].reshape(-1, 3))
        spool.append("faces", np.arange(3 * start, 3 * (start + len(piece)), dtype=np.uint32).reshape(-1, 3))
        if piece["more"].any():
            notes.add("colours of faces")


_TYPES: Final = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


def _ply_head(path: str) -> tuple[str, list[tuple[str, int, list[tuple[str, ...]]]], int]:
    """Return the byte order, the elements with their properties, and where rows begin."""
    with open(path, "rb") as file:
        lines = iter(file.readline, b"")
        if next(lines, b"").strip() != b"ply":
            raise FormatError(f"{path}: no PLY file")
        order, elements = "", []
        for line in lines:
            words = tuple(line.decode("latin-1").split())
            match words:
                case ("format", kind, *_):
                    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind, "")
                case ("element", name, count):
                    elements.append((name.lower(), int(count), list[tuple[str, ...]]()))
                case ("property", *rest) if elements:
                    elements[-1][2].append(tuple(rest))
                case ("end_header",):
                    break
        else:
            raise FormatError(f"{path}: the header has no end")
        if not order:
            raise FormatError(f"{path}: only binary PLY is read in pieces")
        return order, elements, file.tell()


def _row(path: str, order: str, element: str, properties: list[tuple[str, ...]]) -> np.dtype[Any]:
    """Return the dtype of a row; lists have three members."""
    fields: list[Any] = []
    for at, words in enumerate(properties):
        known = [_TYPES.get(word) for word in words[:-1] if word != "list"]
        if None in known:
            raise FormatError(f"{path}: property {' '.join(words)} has an unknown type")
        if words[0] == "list":
            fields += [(f"count {at}", f"{order}{known[0]}"), (words[-1], f"{order}{known[1]}", 3)]
        else:
            fields.append((words[-1], f"{order}{known[0]}"))
    try:
        return np.dtype(fields)
    except ValueError as error:
        raise FormatError(f"{path}: element {element}: {error}") from None


def _of_ply(path: str, spool: Spool, notes: Notes) -> None:
    """Read binary PLY of triangles."""
    order, elements, offset = _ply_head(path)
    size = os.path.getsize(path)
    for element, count, properties in elements:
        if spool.rows("vertices") and spool.rows("faces"):
            break
        dtype = _row(path, order, element, properties)
        end = offset + count * dtype.itemsize
        if end > size:
            raise FormatError(f"{path}: {size} bytes, where element {element} ends at {end}")
        rows = np.memmap(path, dtype, "r", offset=offset, shape=(count,)) if count else np.zeros(0, dtype)
        for start in range(0, max(count, 1), ROWS):
            piece = rows[start : start + ROWS]
            lists = [words[-1] for words in properties if words[0] == "list"]
            for at, words in enumerate(properties):
                if words[0] == "list" and (wrong := piece[f"count {at}"] != 3).any():
                    row = start + int(np.argmax(wrong))
                    raise FormatError(
                        f"{path}: {element}[{row}] has {piece[f'count {at}'][row - start]} corners; "
                        "only files of triangles are read in pieces"
                    )
            if element == "vertex":
                _vertices(path, piece, spool, notes)
            elif element == "face":
                key = next((name for name in lists if name.lower() in _ply.INDICES), None)
                if key is None:
                    raise FormatError(f"{path}: element face has no list of vertices")
                others = [words[-1] for words in properties if words[-1] != key]
                if others and start == 0:
                    notes.add("properties of faces", ", ".join(others))
                spool.append("faces", piece[key].astype(np.uint32))
        offset = end
    if not spool.rows("vertices") or not spool.rows("faces"):
        raise MeshError(f"{path}: there are no faces")


def _vertices(path: str, piece: NDArray[Any], spool: Spool, notes: Notes) -> None:
    """Append rows of vertices with what they carry."""
    names = list(piece.dtype.names or ())
    single = all(piece.dtype[name].itemsize <= 4 for name in names if name.lower() in ("x", "y", "z"))
    columns: Any = {name: (piece[name], None) for name in names}
    source = _ply.vertices(path, len(piece), columns, Notes())
    spool.append("vertices", source.vertices.astype(np.float32 if single else np.float64))
    for name, rows in (("normals", source.normals), ("colors", source.colors)):
        if rows is not None:
            spool.append(name, rows)
    for number, rows in enumerate(source.uvs):
        spool.append(f"uvs {number}", rows)
    if source.channels:
        notes.add("channels of vertices", ", ".join(source.channels))
