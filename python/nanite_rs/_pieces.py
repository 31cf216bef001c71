"""Sources in pieces: what does not fit in memory, as arrays that lie on disk.

Whatever comes in pieces is written to plain files, an array each, and mapped: the core reads what it needs of them.
They have the form that the core takes, so that nothing is converted in memory: faces are uint32, normals and UVs
float32, colours have four columns, and channels are words of 32 bits under ``channel DTYPE NAME``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _arrays, _channels, _colors, _face_data, _material_files
from nanite_rs.exceptions import ArgumentError, DtypeError, FileError, MeshError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs.material import Material

#: Rows that are read at a time.
ROWS: Final = 1 << 18

#: What pieces may have besides vertices and faces.
ATTRIBUTES: Final = ("normals", "colors", "uvs", "face_materials", "channels", "face_channels")
#: Arrays whose files have their names. Channels may have names that differ in case alone.
_PLAIN: Final = ("vertices", "faces", "normals", "colors", "face_materials", *(f"uvs {k}" for k in range(4)))
#: How the names of arrays of channels begin.
CHANNEL: Final = "channel "
#: How the names of arrays of face channels begin, as callers give them.
FACE_CHANNEL: Final = "face channel "


class Spool:
    """Arrays that grow in files of a folder, and what they are of."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: dict[str, int] = {}
        self._forms: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}
        # Names of channels may be none of files.
        self._files: dict[str, str] = {}
        self._numbered = 0
        # Those that face materials number.
        self._looks: list[Material] = []

    def add_looks(self, looks: Iterable[Material]) -> None:
        """Append materials, of whose images the files are kept in memory, not the pixels."""
        for look in looks:
            _material_files.forget(look)
            self._looks.append(look)

    def take_looks(self) -> list[Material]:
        """Return the materials so far, and have none."""
        looks, self._looks = self._looks, []
        return looks

    def rows(self, name: str) -> int:
        """Return how many rows an array has so far."""
        return self._rows.get(name, 0)

    def names(self, start: str = "") -> list[str]:
        """Return the names of arrays that begin so."""
        return [name for name in self._forms if name.startswith(start)]

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the type of an array."""
        return self._forms[name][0]

    def file(self, name: str) -> Path:
        """Return where an array lies."""
        return self.folder / self._files[name]

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Append rows to an array; all have the form of the first."""
        form = self._forms.setdefault(name, (rows.dtype.newbyteorder("="), rows.shape[1:]))
        if form[1] != rows.shape[1:]:
            raise ArgumentError(f"{name}: rows of shape {rows.shape[1:]}, before of {form[1]}")
        if name not in self._files:
            self._files[name] = self._free(name)
        with open(self.file(name), "ab" if self.rows(name) else "wb") as file:
            np.ascontiguousarray(rows, form[0]).tofile(file)
        self._rows[name] = self.rows(name) + len(rows)

    def _free(self, name: str) -> str:
        """Return the name of a file for an array."""
        if name in _PLAIN:
            return name
        self._numbered += 1
        file = f"array {self._numbered}"
        # Arrays that were there before may be adopted, or are of another build.
        return self._free(name) if (self.folder / file).exists() else file

    def adopt(self, name: str, rows: NDArray[Any]) -> None:
        """Take over an array that lies in the folder."""
        self._rows[name], self._forms[name] = len(rows), (rows.dtype, rows.shape[1:])
        self._files[name] = Path(rows.filename).name  # type: ignore[attr-defined]

    def pad(self, name: str, rows: int, fill: Any) -> None:
        """Append a constant until an array has so many rows."""
        dtype, shape = self._forms[name]
        while (missing := rows - self.rows(name)) > 0:
            self.append(name, np.full((min(missing, ROWS), *shape), fill, dtype))

    def mapped(self, name: str) -> NDArray[Any]:
        """Return what an array has so far."""
        dtype, shape = self._forms[name]
        if not self.rows(name):
            return np.zeros((0, *shape), dtype)
        return np.memmap(self.file(name), dtype, "r", shape=(self.rows(name), *shape))

    def blocks(self, name: str) -> Iterator[NDArray[Any]]:
        """Yield the rows of an array, some at a time; one block where there are none."""
        whole = self.mapped(name)
        for start in range(0, max(len(whole), 1), ROWS):
            yield whole[start : start + ROWS]

    def convert(
        self, name: str, function: Callable[[NDArray[Any]], NDArray[Any]], to: str | None = None
    ) -> None:
        """Put in the place of an array what a function makes of its rows, under another name if one is given."""
        made = "converted" if to is None else to
        for rows in self.blocks(name):
            self.append(made, function(rows))
        self.drop(name)
        if to is None:
            self.rename(made, name)

    def rename(self, name: str, to: str) -> None:
        """Give an array another name."""
        self._rows[to], self._forms[to] = self._rows.pop(name), self._forms.pop(name)
        self._files[to] = self._files.pop(name)

    def drop(self, name: str) -> None:
        """Remove an array."""
        self.file(name).unlink(missing_ok=True)
        self._rows.pop(name, None)
        del self._forms[name], self._files[name]

    # ------------------------------------------------------------------------------------ rows of meshes

    def add_vertices(self, rows: NDArray[Any]) -> None:
        """Append positions; all are float64 from where some are."""
        if self.rows("vertices") and self.dtype("vertices") != rows.dtype:
            if self.dtype("vertices") == np.float32:
                self.convert("vertices", lambda known: known.astype(np.float64))
            rows = rows.astype(np.float64)
        if self.rows("vertices") + len(rows) > 1 << 32:
            raise MeshError("source: more than 2^32 vertices")
        self.append("vertices", rows)

    def add_narrowed(self, rows: NDArray[Any]) -> None:
        """Append positions as float32 where these hold them."""
        single = rows.astype(np.float32)
        self.add_vertices(single if np.array_equal(single, rows, equal_nan=True) else rows)

    def add_colors(self, rows: NDArray[Any], first: int) -> None:
        """Append (N, 4) colours from a vertex on, in the narrowest type that holds all; those before are white."""
        if "colors" in self._forms:
            known = np.zeros((0, 4), self.dtype("colors"))
            dtype = _widest(known.dtype, rows.dtype)
            if dtype != known.dtype:
                self.convert("colors", lambda known: _widened(known, dtype))
            rows = _widened(rows, dtype)
        else:
            self.append("colors", rows[:0])
        self.pad("colors", first, _colors.white(rows.dtype))
        self.append("colors", rows)

    def add_filled(self, name: str, rows: NDArray[Any], first: int) -> None:
        """Append rows of vertices or faces from one on; those before are zero."""
        if name not in self._forms:
            self.append(name, rows[:0])
        self.pad(name, first, 0)
        self.append(name, rows)

    def add_channel(self, name: str, kind: str, words: NDArray[np.uint32], first: int) -> None:
        """Append words of a channel from a vertex on."""
        known = self._channel(name)
        if known is not None and known != kind:
            both = np.result_type(known, kind)
            if both.kind == "f":
                both = np.dtype(np.float32)
            if both.itemsize > 4:
                raise DtypeError(f"channels[{name!r}]: {kind}, before {known}: no labels hold both")
            if both.name != known:
                of_known: str = known
                self.convert(
                    f"{CHANNEL}{known} {name}",
                    lambda rows: _words(values_of(rows, of_known), both),
                    f"{CHANNEL}{both.name} {name}",
                )
            words, kind = _words(values_of(words, kind), both), both.name
        self.add_filled(f"{CHANNEL}{kind} {name}", words, first)

    def add_face_channel(self, name: str, rows: NDArray[Any], first: int) -> None:
        """Append labels or numbers of faces from one on; those before are zero."""
        label = f"{FACE_CHANNEL}{name}"
        if label in self._forms and not np.can_cast(rows.dtype, self.dtype(label)):
            both = np.result_type(rows.dtype, self.dtype(label))
            self.convert(label, lambda known: known.astype(both))
        self.add_filled(label, rows, first)

    def has_channel(self, name: str) -> bool:
        """Whether vertices have a channel of that name."""
        return self._channel(name) is not None

    def _channel(self, name: str) -> str | None:
        for known in self.names(CHANNEL):
            _, dtype, label = known.split(" ", 2)
            if label == name:
                return dtype
        return None

    def complete(self) -> None:
        """Fill in at the end what the last pieces did not have."""
        vertices, faces = self.rows("vertices"), self.rows("faces")
        for name in self.names():
            if name == "face_materials" or name.startswith(FACE_CHANNEL):
                self.pad(name, faces, 0)
            elif name == "colors":
                self.pad(name, vertices, _colors.white(self.dtype(name)))
            elif name not in ("vertices", "faces"):
                self.pad(name, vertices, 0)

    def finish(self, of: list[Any] | None) -> dict[str, NDArray[Any]]:
        """Return all arrays, mapped; ``of`` tells what they were made from."""
        forms = {
            self._files[name]: [dtype.str, [self._rows[name], *shape]]
            for name, (dtype, shape) in self._forms.items()
        }
        names = {file: name for name, file in self._files.items() if file != name}
        table, images = _material_files.encoded(self._looks)
        for number, image in enumerate(images):
            (self.folder / _IMAGE.format(number)).write_bytes(image)
        aside = self.folder / f"{LIST}.part"
        looks = {"table": table, "images": len(images)}
        content = {"of": of, "arrays": forms, "names": names, "materials": looks}
        aside.write_text(json.dumps(content), encoding="utf-8")
        aside.replace(self.folder / LIST)
        return opened(self.folder)


def _widest(*dtypes: np.dtype[Any]) -> np.dtype[Any]:
    """Return the type of colours that holds all."""
    return max(dtypes, key=lambda dtype: (dtype.kind == "f", dtype.itemsize))


def _widened(colors: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    like = _colors.alike([colors, np.zeros((0, 4), dtype)])[0]
    return colors if like is None else like


def values_of(words: NDArray[np.uint32], dtype: str) -> NDArray[Any]:
    """Return the values of a channel, of its words."""
    target = np.dtype(dtype)
    stored: type[Any] = {"f": np.float32, "i": np.int32}.get(target.kind, np.uint32)
    return np.asarray(words.view(stored).astype(target, copy=False))


def core_words(name: str, values: Any) -> tuple[str, str, NDArray[np.uint32]]:
    """Return a channel as the core takes it: its name, its type, and its words."""
    return _channels.pack({name: values}, len(values))[0]


def _words(values: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[np.uint32]:
    return core_words("", values.astype(dtype))[2]


#: What arrays a folder has.
LIST: Final = "arrays.json"
#: Files of images.
_IMAGE: Final = "image {}"


def opened(folder: Path, of: list[Any] | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of a folder, mapped; none where they are not there, or were made from something else."""
    try:
        found = json.loads((folder / LIST).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    if of is not None and found["of"] != of:
        return {}
    out: dict[str, NDArray[Any]] = {}
    for file, (dtype, rows) in found["arrays"].items():
        shape = tuple(rows)
        mapped = np.memmap(folder / file, dtype, "r", shape=shape) if shape[0] else np.zeros(shape, dtype)
        out[found["names"].get(file, file)] = mapped
    return out


def looks(folder: Path) -> tuple[Material, ...]:
    """Return the materials of what is in a folder."""
    if not (folder / LIST).exists():
        return ()
    found = json.loads((folder / LIST).read_text(encoding="utf-8"))["materials"]

    def read(number: int) -> bytes:
        return (folder / _IMAGE.format(number)).read_bytes()

    return _material_files.decoded(found["table"], found["images"], read, str(folder))


def files(folder: Path) -> set[str]:
    """Return the names of the files of the arrays of a folder."""
    if not (folder / LIST).exists():
        return set()
    found = json.loads((folder / LIST).read_text(encoding="utf-8"))
    images = (_IMAGE.format(number) for number in range(found["materials"]["images"]))
    return {LIST, *images, *(name for name, (_, rows) in found["arrays"].items() if rows[0])}


def in_folder(arrays: Mapping[str, NDArray[Any]], folder: Path, of: list[Any]) -> Mapping[str, NDArray[Any]]:
    """Return arrays that lie in a folder, where other processes see them; write them unless they were before."""
    # Maps have resolved names.
    there = {
        name: rows
        for name, rows in arrays.items()
        if Path(getattr(rows, "filename", None) or "").parent == folder.resolve()
    }
    if len(there) == len(arrays):
        return arrays
    known = opened(folder, of)
    if known:
        return known
    spool = Spool(folder)
    for name, whole in arrays.items():
        if name in there:
            spool.adopt(name, whole)
            continue
        for start in range(0, max(len(whole), 1), ROWS):
            rows = whole[start : start + ROWS]
            if name == "faces":
                rows = _face_rows(rows, start, len(arrays["vertices"]))
            spool.append(name, rows)
    return spool.finish(of)


def _face_rows(rows: NDArray[Any], first: int, vertices: int) -> NDArray[np.uint32]:
    """Return faces as the core takes them, or say which refers to no vertex."""
    if len(rows) and (rows.min() < 0 or rows.max() >= vertices):
        bad = (rows < 0) | (rows >= vertices)
        row = int(np.argmax(bad.any(axis=1)))
        number = rows[row][bad[row]][0]
        raise MeshError(f"faces[{first + row}] refers to vertex {number}, but there are {vertices} vertices")
    return rows.astype(np.uint32, copy=False)


def identity(path: str) -> list[Any]:
    """Return what tells a file from what it was before."""
    status = os.stat(path)
    return [os.path.abspath(path), status.st_size, status.st_mtime_ns]


def spooled(
    paths: list[str], folder: Path, read: Callable[[Spool], None], *, of: list[Any] | None = None
) -> dict[str, NDArray[Any]]:
    """Return what reading files writes, unless it was written before from the same files."""
    before = [identity(path) for path in paths]
    whole = [*before, *(of or [])]
    known = opened(folder, whole)
    if known:
        return known
    # Without it what is half written is not taken for whole.
    (folder / LIST).unlink(missing_ok=True)
    spool = Spool(folder)
    read(spool)
    for path, then in zip(paths, before, strict=True):
        if identity(path) != then:
            raise FileError(f"{path}: the file changed while it was read")
    return spool.finish(whole)


# ------------------------------------------------------------------------------------------- what a core takes


def core(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays as the core takes them. They have its form but for vertices and faces."""
    channels = []
    for name in arrays:
        if name.startswith(CHANNEL):
            _, dtype, label = name.split(" ", 2)
            channels.append((label, dtype, np.asarray(arrays[name])))
    out: dict[str, Any] = {
        name: None if arrays.get(name) is None else np.asarray(arrays[name])
        for name in ("vertices", "faces", "normals", "colors", "face_materials")
    }
    return {**out, "uvs": uvs_of(arrays), "channels": channels}


def arguments(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays as `NaniteMesh.from_arrays` takes them."""
    out = core(arrays)
    out["channels"] = {name: values_of(words, dtype) for name, dtype, words in out["channels"]}
    start = len(FACE_CHANNEL)
    of_faces = {name[start:]: rows for name, rows in arrays.items() if name.startswith(FACE_CHANNEL)}
    return {**out, "face_channels": of_faces or None}


def uvs_of(arrays: Mapping[str, Any]) -> list[NDArray[np.float32]]:
    """Return UV sets in their order."""
    return [np.asarray(arrays[name]) for name in sorted(arrays) if name.startswith("uvs ")]


# --------------------------------------------------------------------------------------------------- pieces


def of_pieces(pieces: Iterable[Any], folder: Path, *, shared: bool = False) -> dict[str, NDArray[Any]]:
    """Gather pieces: each ``(vertices, faces)`` or ``(vertices, faces, attributes)``.

    Faces count the vertices of their piece from 0, or ``shared``, those of all pieces.
    """
    (folder / LIST).unlink(missing_ok=True)
    spool = Spool(folder)
    known: set[str] | None = None
    ends = []
    for number, piece in enumerate(pieces):
        where = f"source: piece {number}"
        if not isinstance(piece, tuple | list) or not 2 <= len(piece) <= 3:
            raise DtypeError(f"{where}: expected (vertices, faces) or (vertices, faces, attributes)")
        attributes = piece[2] if len(piece) == 3 else {}
        if not isinstance(attributes, Mapping):
            raise DtypeError(f"{where}: expected a mapping of attributes, not {type(attributes).__name__}")
        # What is None is not there, as in `NaniteMesh.from_arrays`.
        attributes = {name: rows for name, rows in attributes.items() if rows is not None}
        try:
            found = add_piece(spool, np.asarray(piece[0]), np.asarray(piece[1]), attributes, shared=shared)
        except (ArgumentError, DtypeError, MeshError) as error:
            raise type(error)(f"{where}: {error}") from None
        if known is not None and known != found:
            raise ArgumentError(f"{where}: has {sorted(found)}, pieces before {sorted(known)}")
        known = found
        ends.append(spool.rows("faces"))
    if known is None:
        raise MeshError("source: there are no pieces")
    if shared:
        _check_shared(spool, ends)
    return spool.finish(None)


def _check_shared(spool: Spool, ends: list[int]) -> None:
    """Raise where a face refers to a vertex that no piece has; ``ends`` has the end of each piece's faces."""
    count, at = spool.rows("vertices"), 0
    for rows in spool.blocks("faces"):
        bad = (rows >= count).any(axis=1)
        if bad.any():
            row = at + int(np.argmax(bad))
            piece = int(np.searchsorted(ends, row, side="right"))
            first = ends[piece - 1] if piece else 0
            raise MeshError(
                f"source: piece {piece}: faces[{row - first}] refers to vertex {rows[row - at].max()}, but all "
                f"pieces together have {count} vertices"
            )
        at += len(rows)


def add_piece(
    spool: Spool,
    vertices: NDArray[Any],
    faces: NDArray[Any],
    attributes: Mapping[str, Any],
    *,
    narrow: bool = False,
    shared: bool = False,
) -> set[str]:
    """Append a piece, which counts its vertices from 0, or those of all; return the names of what it has."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind != "f":
        raise ArgumentError(f"vertices must be (N, 3) floats, not {vertices.dtype}{vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise ArgumentError(f"faces must be (M, 3) integers, not {faces.dtype}{faces.shape}")
    first, first_face = spool.rows("vertices"), spool.rows("faces")
    for start in range(0, max(len(faces), 1), ROWS):
        rows = _face_rows(faces[start : start + ROWS], start, 1 << 32 if shared else len(vertices))
        spool.append("faces", (rows.astype(np.int64) + (0 if shared else first)).astype(np.uint32))
    if narrow:
        spool.add_narrowed(vertices)
    else:
        spool.add_vertices(vertices if vertices.dtype == np.float32 else vertices.astype(np.float64))
    return _add_attributes(spool, attributes, first, len(vertices), first_face, len(faces))


def _add_attributes(
    spool: Spool, attributes: Mapping[str, Any], first: int, vertices: int, first_face: int, faces: int
) -> set[str]:
    """Append attributes of so many vertices and faces; return the names of what there is."""
    found = set()
    for name, given in attributes.items():
        if name == "face_channels":
            for label, rows in _face_data.checked(given, faces).items():
                spool.add_face_channel(label, rows, first_face)
                found.add(f"face_channels[{label!r}]")
            continue
        if name not in ATTRIBUTES:
            raise ArgumentError(f"{name!r} is none of {', '.join(ATTRIBUTES)}")
        if name == "channels":
            for label, kind, words in _channels.pack(given, vertices):
                spool.add_channel(label, kind, words, first)
                found.add(f"channels[{label!r}]")
            continue
        for label, rows in formed(name, given).items():
            count = faces if name == "face_materials" else vertices
            if len(rows) != count:
                raise ArgumentError(f"{name} has {len(rows)} rows, not {count}")
            if name == "colors":
                spool.add_colors(rows, first)
            else:
                spool.add_filled(label, rows, first_face if name == "face_materials" else first)
            found.add(label)
    return found


def formed(name: str, given: Any) -> dict[str, NDArray[Any]]:
    """Return an attribute in the form of the core, by the names of its arrays."""
    if name == "colors":
        rows = np.asarray(given)
        # A part of them may be dark, which says nothing about the whole.
        if rows.dtype in (np.uint8, np.uint16) and rows.ndim == 2 and rows.shape[1] in (3, 4):
            return {name: _colors.opaque(rows)}
    none = dict.fromkeys(("normals", "colors", "uvs", "face_materials"))
    # Vertices and faces are no part of what is looked at.
    made = _arrays.core_arrays(np.zeros((0, 3)), np.zeros((0, 3), int), {**none, name: given}, None)
    if name == "uvs":
        return {f"uvs {number}": rows for number, rows in enumerate(made["uvs"])}
    if name == "normals" and (made[name].ndim != 2 or made[name].shape[1] != 3):
        raise ArgumentError(f"normals: expected shape (N, 3), found {made[name].shape}")
    return {name: made[name]}


# --------------------------------------------------------------------------------------------------- arrays


def is_lazy(value: object) -> bool:
    """Whether it is an array that is read by slices, such as one of zarr, h5py or Dask."""
    return not isinstance(value, np.ndarray) and all(
        hasattr(value, name) for name in ("shape", "dtype", "__getitem__")
    )


def _rows_of(value: Any, start: int, stop: int) -> NDArray[Any]:
    return np.asarray(value[start:stop])


def _taken(value: Any, name: str) -> Any:
    if is_lazy(value):
        return value
    # Lists of whole numbers are labels.
    return np.asarray(value) if name in ("channels", "face_materials") else _arrays.as_array(value, name)


def of_arrays(
    vertices: Any, faces: Any, attributes: Mapping[str, Any], folder: Path, limit: int
) -> dict[str, Any]:
    """Return arrays in the form of the core: as they are where they have it or are small, or else on disk.

    What is no NumPy array is read slice by slice.
    """
    given = _listed(vertices, faces, attributes)
    vertex_count, face_count = (
        given[name].shape[0] if given[name].ndim else 0 for name in ("vertices", "faces")
    )
    out: dict[str, Any] = {}
    size = sum(rows.nbytes for rows in given.values() if isinstance(rows, np.ndarray))
    in_memory = size * 4 <= limit
    spool = Spool(folder)
    for name, rows in given.items():
        count = face_count if name in ("faces", "face_materials") else vertex_count
        if name not in ("vertices", "faces") and (not rows.shape or rows.shape[0] != count):
            raise ArgumentError(f"source: {name} has shape {tuple(rows.shape)}; expected {count} rows")
        if is_lazy(rows) or not (in_memory or _has_form(name, rows)):
            (folder / LIST).unlink(missing_ok=True)
            for start in range(0, max(rows.shape[0], 1), ROWS):
                _append(spool, name, _rows_of(rows, start, start + ROWS), start, vertex_count)
        elif name in ("vertices", "faces"):
            out[name] = rows  # the core checks them
        elif name.startswith(CHANNEL):
            label, kind, words = core_words(name[len(CHANNEL) :], rows)
            out[f"{CHANNEL}{kind} {label}"] = words
        else:
            out[name] = next(iter(formed(name.partition(" ")[0], rows).values()))
    if spool.names():
        out |= spool.finish(None)
    for name, rows in (attributes.get("face_channels") or {}).items():
        out[f"{FACE_CHANNEL}{name}"] = rows
    return out


def _listed(vertices: Any, faces: Any, attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays that a caller gave by the names that they have here, but for channels of faces."""
    given: dict[str, Any] = {"vertices": _taken(vertices, "vertices"), "faces": _taken(faces, "faces")}
    for name, rows in attributes.items():
        if rows is None or name == "face_channels":
            continue
        if name not in ATTRIBUTES:
            raise ArgumentError(f"source: {name!r} is none of {', '.join(ATTRIBUTES)}")
        if name == "uvs":
            one = (isinstance(rows, np.ndarray) or is_lazy(rows)) and rows.ndim == 2
            for number, uv in enumerate([rows] if one else rows):
                given[f"uvs {number}"] = _taken(uv, name)
        elif name == "channels":
            if not isinstance(rows, Mapping):
                raise DtypeError(
                    f"channels: expected a mapping of names to arrays, not {type(rows).__name__}"
                )
            for label, values in rows.items():
                given[f"{CHANNEL}{label}"] = _taken(values, name)
        else:
            given[name] = _taken(rows, name)
    return given


def _append(spool: Spool, name: str, rows: NDArray[Any], first: int, vertices: int) -> None:
    """Append a slice of an array that a caller gave."""
    if name == "vertices":
        if rows.ndim != 2 or rows.shape[1] != 3 or rows.dtype.kind != "f":
            raise ArgumentError(f"vertices must be (N, 3) floats, not {rows.dtype}{rows.shape}")
        spool.add_vertices(rows if rows.dtype == np.float32 else rows.astype(np.float64))
    elif name == "faces":
        if rows.ndim != 2 or rows.shape[1] != 3 or rows.dtype.kind not in "iu":
            raise ArgumentError(f"faces must be (M, 3) integers, not {rows.dtype}{rows.shape}")
        spool.append(name, _face_rows(rows, first, vertices))
    elif name.startswith(CHANNEL):
        spool.add_channel(*core_words(name[len(CHANNEL) :], rows), first)
    elif name == "colors":
        spool.add_colors(formed(name, rows)[name], first)
    else:
        plain = name.partition(" ")[0]
        spool.append(name, formed(plain, [rows] if plain == "uvs" else rows).popitem()[1])


def _has_form(name: str, rows: NDArray[Any]) -> bool:
    """Whether an array is taken as it lies there."""
    dtypes: tuple[type[Any], ...] = (np.float32,)
    if name == "vertices":
        dtypes = np.float32, np.float64
    elif name == "faces":
        dtypes = (np.uint32,)
    elif name == "face_materials":
        dtypes = (np.int32,)
    elif name == "colors":
        dtypes = np.uint8, np.uint16
    elif name.startswith(CHANNEL):
        dtypes = np.float32, np.int32, np.uint32
    wide = name != "colors" or (rows.ndim == 2 and rows.shape[1] == 4)
    return wide and any(rows.dtype == dtype for dtype in dtypes) and rows.flags.c_contiguous


# ------------------------------------------------------------------------------------------------ face channels


def has_face_channels(arrays: Mapping[str, Any]) -> bool:
    """Whether faces carry more than materials."""
    return any(name.startswith(FACE_CHANNEL) for name in arrays)


def settle_face_channels(spool: Spool, notes: Notes) -> None:
    """Average numbers to vertices; keep labels that can be told apart: those that differ least stay.

    What vertices have a channel of the name of is called otherwise, as in files that fit.
    """
    start = len(FACE_CHANNEL)
    for name in spool.names(FACE_CHANNEL):
        if spool.has_channel(name[start:]):
            spool.rename(name, f"{FACE_CHANNEL}face_{name[start:]}")
    for name in spool.names(FACE_CHANNEL):
        if spool.dtype(name).kind == "f":
            notes.add("floating-point data of faces, averaged to vertices", name[start:])
            vertices, faces = spool.mapped("vertices"), spool.mapped("faces")
            _add_means(spool, name[start:], vertices, faces, spool.mapped(name))
            spool.drop(name)

    def different(name: str) -> int:
        known: NDArray[Any] | None = None
        for rows in spool.blocks(name):
            known = np.unique(rows if known is None else np.concatenate([known, rows]), axis=0)
            if len(known) > _face_data.MOST:
                break
        return 0 if known is None else len(known)

    kept: list[str] = []
    materials = [name for name in ("face_materials",) if name in spool.names()]
    for name in sorted(spool.names(FACE_CHANNEL), key=different):
        looked = _face_data.Apart()
        try:
            for columns in zip(*(spool.blocks(of) for of in [*materials, *kept, name]), strict=True):
                labels = dict(zip([*kept, name], columns[len(materials) :], strict=True))
                looked.look(columns[0] if materials else None, labels)
            kept.append(name)
        except ArgumentError:
            notes.add("data of faces that differ too much to be kept apart", name[start:])
            spool.drop(name)


def _add_means(spool: Spool, name: str, vertices: Any, faces: Any, values: Any) -> None:
    """Append a channel of vertices: the means of what the faces around them carry. Sums lie on disk."""
    sums: list[Path] = []

    def zeros(count: int) -> NDArray[np.float64]:
        sums.append(spool.folder / f"sums {len(sums)}")
        return np.asarray(np.memmap(sums[-1], np.float64, "w+", shape=(count,)))

    means = _face_data.Means(len(vertices), _face_data.columns_of(values), zeros)
    for first in range(0, len(faces), ROWS):
        part = slice(first, first + ROWS)
        corners = _face_rows(np.asarray(faces[part]), first, len(vertices))
        means.add(vertices[corners], corners, np.asarray(values[part]))
    for first in range(0, len(vertices), ROWS):
        rows = means.rows(slice(first, first + ROWS))
        spool.add_channel(*core_words(name, rows[:, 0] if values.ndim == 1 else rows), first)
    del means
    for path in sums:
        path.unlink()


def apart(arrays: Mapping[str, Any], folder: Path) -> Mapping[str, NDArray[Any]]:
    """Return the arrays of a mesh whose faces carry materials alone: see `_face_data`.

    Numbers are averaged to vertices. By their labels faces are taken apart: parts of them follow each other, with
    the vertices that they use. The core welds those that are equal.
    """
    start = len(FACE_CHANNEL)
    given = {name[start:]: rows for name, rows in arrays.items() if name.startswith(FACE_CHANNEL)}
    labels = _face_data.checked(given, len(arrays["faces"]))
    for name in labels:
        if any(known.split(" ", 2)[-1] == name for known in arrays if known.startswith(CHANNEL)):
            raise ArgumentError(f"face_channels[{name!r}]: channels has one of that name")
    numbers = {name: labels.pop(name) for name in list(labels) if labels[name].dtype.kind == "f"}
    _face_data.warn_of_floats(numbers)
    if numbers:
        (folder / "means").mkdir(parents=True, exist_ok=True)
        averaged = Spool(folder / "means")
        for name, rows in numbers.items():
            _add_means(averaged, name, arrays["vertices"], arrays["faces"], rows)
        arrays = {**arrays, **averaged.finish(None)}
    if not labels:
        return {name: rows for name, rows in arrays.items() if not name.startswith(FACE_CHANNEL)}
    faces, materials = arrays["faces"], arrays.get("face_materials")
    of_vertices = [
        name for name in arrays if name.startswith(("vertices", "normals", "colors", "uvs ", CHANNEL))
    ]

    def parts() -> Iterator[tuple[slice, NDArray[np.int32] | None, dict[str, NDArray[Any]]]]:
        for first in range(0, max(len(faces), 1), ROWS):
            rows = slice(first, first + ROWS)
            own = {name: np.asarray(of[rows]) for name, of in labels.items()}
            yield rows, None if materials is None else np.asarray(materials[rows]), own

    taken = _face_data.Apart()
    for _, of_part, own in parts():
        taken.look(of_part, own)
    folder.mkdir(parents=True, exist_ok=True)
    spool = Spool(folder)
    for part, of_part, own in parts():
        corners = _face_rows(np.asarray(faces[part]), part.start, len(arrays["vertices"]))
        made = taken.taken(corners, of_part, own)
        before = spool.rows("vertices")
        for name in of_vertices:
            spool.append(name, np.asarray(arrays[name][made.vertices]))
        for name, values in made.channels.items():
            spool.add_channel(*core_words(name, values), before)
        spool.append("faces", (made.faces + before).astype(np.uint32))
        spool.append("face_materials", made.numbers)
    if spool.rows("vertices") > 1 << 32:
        raise MeshError("source: more than 2^32 vertices, once faces of different channels are apart")
    return spool.finish(None)
